//! The picture that is written beside a tile, and tells whether the tile is good.
//!
//! ```text
//!  one frame | XT slice | error spectrum | an edge as perceived: white noise | tile, error 0.115
//! ```
//!
//! Samples of good and bad tiles look alike. So beside them stand the spectrum of the tile's
//! error, which a good tile has dark inside the kernel's window, and what a viewer sees of one edge
//! that is integrated with white noise and with the tile, at equal contrast, with the tile's score
//! on edges. It is drawn while the tile is written, from coordinates that come in pieces, in a
//! small part of a second for any tile; the same tile has the same picture everywhere.

#[cfg_attr(not(internals), doc(hidden))]
pub mod canvas;
mod edge;
mod font;
mod spectrum;

use crate::domain::Domain;
use crate::format::picture::{Image, PREVIEW};
use crate::format::png::Depth;
use crate::kernel::{KernelTaps, Response};
use crate::metric::{Class, Coordinates, Integrand, IntegrandSet, Scores, figure, integrand_sets};
use crate::tile::TileShape;

use canvas::{Canvas, LINE, Rgb};
use edge::PerceivedEdge;
use spectrum::ErrorSpectrum;

/// Pixels of a tile across and down of which a panel shows samples.
const SHOWN: usize = 64;
/// Pixels of a panel across and down.
const PANEL: usize = 256;
/// Pixels between panels, and around all.
const GAP: usize = 20;
/// Integrands of each class in the spectrum, and edges among which the one that is seen is chosen.
const INTEGRANDS: usize = 8;
/// Levels of gray for one standard deviation of white noise.
const CONTRAST: f64 = 45.0;
/// Parts of the largest amplitude at which the window is drawn: one half, and −20 dB in dashes.
const LEVELS: [f64; 2] = [0.5, 0.1];
/// Pixels of a dash, and of the gap behind it.
const DASH: usize = 6;
const WINDOW: Rgb = [255, 176, 0];

/// A preview that is being gathered from coordinates in C order.
pub struct Preview<'a> {
    shape: TileShape,
    taps: &'a KernelTaps,
    /// Pixels that have come.
    taken: usize,
    /// Coordinates of a pixel that is not complete.
    started: Vec<f32>,
    /// The first dimension of the first sample: of the pixels of frame 0 and of its first row in
    /// all frames, as gray.
    frame: Panel,
    slice: Panel,
    spectrum: ErrorSpectrum,
    edge: PerceivedEdge<'a>,
    /// Whether the kernel sees the frame that comes.
    is_seen: bool,
}

/// Grays of a part of a tile.
struct Panel {
    size: [usize; 2],
    levels: Vec<u8>,
}

impl Panel {
    /// The upper left part of a field of these sizes.
    fn new(width: usize, height: usize) -> Self {
        let size = [width.min(SHOWN), height.min(SHOWN)];
        Self { size, levels: vec![0; size[0] * size[1]] }
    }

    fn put(&mut self, [x, y]: [usize; 2], level: u8) {
        if x < self.size[0] && y < self.size[1] {
            self.levels[y * self.size[0] + x] = level;
        }
    }

    /// The gray at a place; the field repeats beyond its ends.
    fn at(&self, x: usize, y: usize) -> u8 {
        self.levels[y % self.size[1] * self.size[0] + x % self.size[0]]
    }
}

impl<'a> Preview<'a> {
    /// Begins without a coordinate, for a tile of this domain and shape behind this kernel.
    pub fn new((domain, shape): (Domain, TileShape), taps: &'a KernelTaps) -> Self {
        let mut sets = integrand_sets(domain, 0, shape.dims(), INTEGRANDS);
        sets.retain(|set| set.coordinates == Coordinates::All);
        let side = PerceivedEdge::affordable(SHOWN, shape, taps);
        let edge = PerceivedEdge::new(halving_edge(&sets).clone(), taps, shape, side);
        Self {
            shape,
            taps,
            taken: 0,
            started: Vec::new(),
            frame: Panel::new(shape.width(), shape.height()),
            slice: Panel::new(shape.width(), shape.frames()),
            spectrum: ErrorSpectrum::new(sets, shape),
            is_seen: edge.sees(0),
            edge,
        }
    }

    /// Takes the next coordinates; those behind the tile's last are left out.
    pub fn take(&mut self, mut piece: &[f32]) {
        let size = self.shape.spp() * self.shape.dims();
        while !piece.is_empty() && self.taken < self.shape.pixels() {
            if self.started.is_empty() && piece.len() >= size {
                let (samples, rest) = piece.split_at(size);
                self.pixel(samples);
                piece = rest;
                continue;
            }
            let (more, rest) = piece.split_at(piece.len().min(size - self.started.len()));
            self.started.extend_from_slice(more);
            piece = rest;
            if self.started.len() == size {
                let samples = std::mem::take(&mut self.started);
                self.pixel(&samples);
            }
        }
    }

    /// Takes the next pixel.
    fn pixel(&mut self, samples: &[f32]) {
        let shape = self.shape;
        let (width, pixels, dims) = (shape.width(), shape.width() * shape.height(), shape.dims());
        let (t, place) = (self.taken / pixels, self.taken % pixels);
        let (x, y) = (place % width, place / width);
        let level = Depth::Eight.quantize(samples[0]) as u8;
        if t == 0 {
            self.frame.put([x, y], level);
        }
        if y == 0 {
            self.slice.put([x, t], level);
        }
        if t < self.spectrum.frames() {
            self.spectrum.pixel(x, y, samples, dims);
        }
        if self.is_seen {
            self.edge.pixel(x, y, samples, dims);
        }
        self.taken += 1;
        if place + 1 == pixels {
            if t < self.spectrum.frames() {
                self.spectrum.frame();
            }
            // Tiles have fewer frames than 2³¹.
            self.edge.frame(t as i32);
            self.is_seen = self.edge.sees(t as i32 + 1);
        }
    }

    /// Draws the picture, with the score on edges if the tile has been scored.
    pub fn image(&self, scores: Option<&Scores>) -> Image {
        let shape = self.shape;
        let white = self.edge.of_white_noise(shape);
        let score = scores.and_then(|scores| scores.class(Class::Edge, Coordinates::All));
        let [of_white, of_tile] = match score {
            Some(score) => ["white noise, error 1".to_owned(), tile_label(score.perceived.mean)],
            None => ["white noise".to_owned(), "this tile".to_owned()],
        };
        let zoom = PANEL / SHOWN;
        let gray = |panel: &Panel| samples(|x, y| panel.at(x / zoom, y / zoom));
        let (width, height, frames) = (shape.width(), shape.height(), shape.frames());
        let mut panels =
            vec![(["one frame".to_owned(), frame_label(width, height, frames)], gray(&self.frame))];
        if frames > 1 {
            let label = ["XT slice, time down".to_owned(), slice_label(frames)];
            panels.push((label, gray(&self.slice)));
        }
        let label = ["error spectrum".to_owned(), "lines: kernel window".to_owned()];
        panels.push((label, self.spectrum_panel()));
        let perceived = "an edge as perceived:";
        panels.push(([perceived.to_owned(), of_white], seen(&white)));
        panels.push(([perceived.to_owned(), of_tile], seen(&self.edge)));

        let top = GAP + 2 * LINE + LINE / 2;
        let mut canvas = Canvas::new(GAP + panels.len() * (PANEL + GAP), top + PANEL + GAP);
        for (i, ([first, second], pixels)) in panels.iter().enumerate() {
            let left = GAP + i * (PANEL + GAP);
            canvas.text([left, GAP], first);
            canvas.text([left, GAP + LINE + LINE / 6], second);
            for (place, &colour) in pixels.iter().enumerate() {
                canvas.fill([left + place % PANEL, top + place / PANEL], [1; 2], colour);
            }
        }
        canvas.into_image().made_by(PREVIEW)
    }

    /// Amplitude as brightness, white noise's in the middle, with the window's outlines over it.
    fn spectrum_panel(&self) -> Vec<Rgb> {
        let [width, height] = self.spectrum.size();
        let mut pixels = samples(|x, y| {
            let power = self.spectrum.power(x * width / PANEL, y * height / PANEL);
            (127.5 * power.sqrt()).min(255.0) as u8
        });
        let response = Response::spatial(self.taps, PANEL, PANEL);
        let peak = response.magnitude.iter().copied().fold(0.0, f64::max);
        // Frequency 0 is in the middle of its square, not at the square's corner.
        let shift = [PANEL / 2 / width, PANEL / 2 / height];
        for (level, dashed) in LEVELS.into_iter().zip([false, true]) {
            let inside = |x: usize, y: usize| response.magnitude[y * PANEL + x] >= level * peak;
            for (x, y) in (1..PANEL).flat_map(|y| (1..PANEL).map(move |x| (x, y))) {
                let here = inside(x, y);
                let is_line = here != inside(x - 1, y) || here != inside(x, y - 1);
                let is_gap = dashed && (x / DASH + y / DASH) % 2 == 1;
                if is_line && !is_gap {
                    for (x, y) in [(x, y), (x - 1, y), (x, y - 1)] {
                        let (x, y) = ((x + shift[0]) % PANEL, (y + shift[1]) % PANEL);
                        pixels[y * PANEL + x] = WINDOW;
                    }
                }
            }
        }
        pixels
    }
}

/// The edge that halves the cube best, as that is seen best.
fn halving_edge(sets: &[IntegrandSet]) -> &Integrand {
    let unequal = |f: &Integrand| (f.integral() - 0.5).abs();
    let edges = sets.iter().filter(|set| set.class == Class::Edge);
    let edges = edges.flat_map(|set| &set.integrands);
    edges.min_by(|a, b| unequal(a).total_cmp(&unequal(b))).expect("edges are a class")
}

/// A gray panel, row by row.
fn samples(level: impl Fn(usize, usize) -> u8) -> Vec<Rgb> {
    (0..PANEL * PANEL).map(|place| [level(place % PANEL, place / PANEL); 3]).collect()
}

/// What is seen of an edge's error: mid-gray where there is none.
fn seen(edge: &PerceivedEdge) -> Vec<Rgb> {
    let level = |value: f64| (127.5 + CONTRAST * value).clamp(0.0, 255.0) as u8;
    let levels: Vec<u8> = edge.in_deviations_of_white_noise().map(level).collect();
    let side = edge.side();
    samples(|x, y| levels[y * side / PANEL * side + x * side / PANEL])
}

/// Of which tile a frame is.
fn frame_label(width: usize, height: usize, frames: usize) -> String {
    let (across, down) = (width.min(SHOWN), height.min(SHOWN));
    if (across, down) == (width, height) {
        format!("of {width}x{height}x{frames}")
    } else {
        format!("{across}x{down} of {width}x{height}x{frames}")
    }
}

/// How much error a tile has on edges.
fn tile_label(error: f64) -> String {
    format!("tile, error {}", figure(error))
}

/// Which frames a slice shows.
fn slice_label(frames: usize) -> String {
    match frames {
        SHOWN => format!("{frames} frames"),
        ..SHOWN => format!("{frames} frames, repeated"),
        _ => format!("{SHOWN} of {frames} frames"),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use proptest::prelude::*;

    use super::*;
    use crate::kernel::KernelSpec;
    use crate::metric::{Baseline, ScoreOptions};
    use crate::tile::Tile;

    fn taps(text: &str, shape: TileShape) -> KernelTaps {
        let spec: KernelSpec = text.parse().unwrap();
        spec.resolve(shape).unwrap().classes()[0].taps.clone()
    }

    fn drawn(tile: &Tile, taps: &KernelTaps, scores: Option<&Scores>) -> Image {
        let mut preview = Preview::new((Domain::Square, tile.shape()), taps);
        preview.take(tile.samples());
        preview.image(scores)
    }

    /// A panel's upper left corner.
    fn corner(panel: usize) -> [usize; 2] {
        [GAP + panel * (PANEL + GAP), GAP + 2 * LINE + LINE / 2]
    }

    /// The mean square distance of a panel's grays from mid-gray.
    fn unrest(picture: &Image, panel: usize) -> f64 {
        let [left, top] = corner(panel);
        let places = (0..PANEL).flat_map(|y| (0..PANEL).map(move |x| (x, y)));
        let square = |(x, y)| (f64::from(picture.pixel(left + x, top + y)[0]) - 127.5).powi(2);
        places.map(square).sum::<f64>() / (PANEL * PANEL) as f64
    }

    const KERNEL: &str = "gaussian(1.5) * ema(0.5) @ 5x5x4";

    #[test]
    fn samples_stand_in_their_panels() {
        let shape = TileShape::new(9, 70, 3, 2, 2).unwrap();
        let tile = Baseline::White.tile(shape, 1);
        let picture = drawn(&tile, &taps(KERNEL, shape), None);
        assert_eq!(picture.width(), GAP + 5 * (PANEL + GAP));
        let level = |x: usize, y: usize, t: usize| (tile.point(x, y, t, 0)[0] * 256.0) as u8;
        let zoom = PANEL / SHOWN;
        for (x, y) in [(0, 0), (8, 63), (9, 5), (63, 20)] {
            let [left, top] = corner(0);
            let pixel = picture.pixel(left + x * zoom + zoom - 1, top + y * zoom);
            assert_eq!(pixel, [level(x % 9, y, 0); 3]);
            let [left, top] = corner(1);
            let pixel = picture.pixel(left + x * zoom, top + y * zoom + zoom - 1);
            assert_eq!(pixel, [level(x % 9, 0, y % 3); 3]);
        }
    }

    #[test]
    fn a_good_tile_is_told_from_white_noise() {
        // Each value of an even set once in every 4×4 pixels, in an order that differs.
        let shape = TileShape::new(32, 32, 4, 1, 1).unwrap();
        let order = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
        let value = |i: usize| (order[i / 32 % 4 * 4 + i % 4] as f32 + 0.5) / 16.0;
        let good = Tile::new(shape, (0..shape.pixels()).map(value).collect()).unwrap();
        let white = Baseline::White.tile(shape, 7);
        let taps = taps(KERNEL, shape);
        let deviation = CONTRAST * CONTRAST;
        for (tile, is_good) in [(&good, true), (&white, false)] {
            let picture = drawn(tile, &taps, None);
            let [beside, own] = [3, 4].map(|panel| unrest(&picture, panel) / deviation);
            assert!((0.6..1.3).contains(&beside), "{beside}");
            assert_eq!(own < 0.3, is_good, "{own}");
        }
    }

    #[test]
    fn the_score_is_written_if_there_is_one() {
        let shape = TileShape::new(16, 16, 4, 1, 2).unwrap();
        let tile = Baseline::White.tile(shape, 1);
        let taps = taps(KERNEL, shape);
        let scores = Scores::of(
            &tile,
            &taps,
            ScoreOptions { set: 0, integrands: 4, ..ScoreOptions::default() },
        )
        .unwrap();
        let [with, without] = [Some(&scores), None].map(|scores| drawn(&tile, &taps, scores));
        let ink = |picture: &Image, panel: usize| {
            let left = corner(panel)[0];
            let places = (0..corner(0)[1]).flat_map(|y| (left..left + PANEL).map(move |x| (x, y)));
            places.filter(|&(x, y)| picture.pixel(x, y)[0] < 128).count()
        };
        for panel in 0..5 {
            assert_eq!(ink(&with, panel) > ink(&without, panel), panel > 2, "{panel}");
        }
        for panel in 0..5 {
            assert_eq!(unrest(&with, panel), unrest(&without, panel));
        }
    }

    #[test]
    fn a_single_frame_has_no_slice() {
        let shape = TileShape::new(16, 16, 1, 1, 2).unwrap();
        let picture =
            drawn(&Baseline::White.tile(shape, 1), &taps("gaussian(1) @ 3x3x1", shape), None);
        assert_eq!(picture.width(), GAP + 4 * (PANEL + GAP));
    }

    #[test]
    fn labels_fit_their_panels_and_have_all_their_letters() {
        let labels = [
            frame_label(64, 64, 16),
            frame_label(1024, 1024, 16),
            slice_label(16),
            slice_label(64),
            slice_label(1024),
            "an edge as perceived:".into(),
            "lines: kernel window".into(),
            "white noise, error 1".into(),
            tile_label(2.345e-8),
        ];
        for label in labels {
            // Letters are twelve pixels wide.
            assert!(12 * label.chars().count() <= PANEL + GAP / 2, "{label}");
            assert!(label.chars().all(|letter| font::glyph(letter).is_some()), "{label}");
        }
    }

    #[test]
    fn every_tile_has_a_picture_in_no_time() {
        for (width, height, frames, spp, dims) in [
            (1, 1, 1, 1, 1),
            (3, 2, 5, 4, 3),
            (64, 64, 2, 8, 16),
            (300, 1, 70, 1, 2),
            (512, 512, 4, 1, 2),
        ] {
            let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
            let tile = Baseline::White.tile(shape, 1);
            for text in ["none", "column", "frame"] {
                let taps = taps(text, shape);
                let start = Instant::now();
                let picture = drawn(&tile, &taps, None);
                // Debug builds on a machine that others use take far longer than users wait.
                assert!(start.elapsed().as_secs() < 60, "{shape} {text}");
                let panels = if frames > 1 { 5 } else { 4 };
                assert_eq!(picture.width(), GAP + panels * (PANEL + GAP));
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn pieces_of_any_size_make_the_same_picture(
            (width, height, frames) in (1_usize..6, 1_usize..6, 1_usize..6),
            (spp, dims) in (1_usize..4, 1_usize..5),
            sizes in prop::collection::vec(1_usize..40, 1..6),
        ) {
            let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
            let tile = Baseline::White.tile(shape, 1);
            let taps = taps("box(2)", shape);
            let mut pieces = Preview::new((Domain::Square, shape), &taps);
            let mut rest = tile.samples();
            for &size in sizes.iter().cycle() {
                let (piece, others) = rest.split_at(size.min(rest.len()));
                pieces.take(piece);
                rest = others;
                if rest.is_empty() {
                    break;
                }
            }
            // More than there are do no harm.
            pieces.take(&[0.999; 50]);
            prop_assert_eq!(pieces.image(None), drawn(&tile, &taps, None));
        }
    }
}
