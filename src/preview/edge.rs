//! The error of one edge behind the kernel, in one frame: what a viewer sees of a tile.
//!
//! Frames come one by one and are forgotten, so a tile need never be whole in memory. Every sum
//! has a fixed order, so the picture is the same with every number of threads and on every
//! processor.

use crate::kernel::{KernelTaps, Tap};
use crate::metric::{Baseline, Integrand};
use crate::tile::TileShape;

/// Most products of weights and errors.
const MOST_PRODUCTS: usize = 1 << 30;
/// Most coordinates of the white noise that is drawn beside a tile.
const MOST_COORDINATES: usize = 1 << 25;
/// Fewest pixels across and down, whatever they cost.
const LEAST: usize = 8;
/// Seed of the white noise in the newest frame; older frames have the next ones.
const SEED: u64 = 1;

/// The edge's error in the part of a frame that the kernel can reach, and what the kernel makes
/// of it in frame 0.
pub(super) struct PerceivedEdge<'a> {
    edge: Integrand,
    taps: &'a KernelTaps,
    spp: usize,
    /// Frames after which the tile repeats.
    period: Option<usize>,
    /// Pixels across and down that are seen.
    side: usize,
    /// Pixels of a frame that they depend on, from the upper left corner on.
    part: [usize; 2],
    errors: Vec<f32>,
    sums: Vec<f32>,
}

impl<'a> PerceivedEdge<'a> {
    /// Pixels across and down of which the picture takes no time to speak of, at most `most`.
    pub fn affordable(most: usize, shape: TileShape, taps: &KernelTaps) -> usize {
        let mut side = most;
        let [width, height, frames] = taps.size().map(|n| n as usize);
        let costs = |side: usize| {
            let noise = (side + width).saturating_mul(side + height);
            let noise = noise.saturating_mul(frames * shape.spp() * shape.dims());
            side * side > MOST_PRODUCTS / taps.taps().len() || noise > MOST_COORDINATES
        };
        while side > LEAST && costs(side) {
            side /= 2;
        }
        side
    }

    /// Begins with no error, for the frames of a tile.
    pub fn new(edge: Integrand, taps: &'a KernelTaps, shape: TileShape, side: usize) -> Self {
        let sizes = [shape.width(), shape.height()];
        Self::with_period(edge, taps, shape.spp(), side, sizes, Some(shape.frames()))
    }

    fn with_period(
        edge: Integrand,
        taps: &'a KernelTaps,
        spp: usize,
        side: usize,
        sizes: [usize; 2],
        period: Option<usize>,
    ) -> Self {
        let [width, height, _] = taps.size().map(|n| n as usize);
        let part = [sizes[0].min(side + width - 1), sizes[1].min(side + height - 1)];
        let (errors, sums) = (vec![0.0; part[0] * part[1]], vec![0.0; side * side]);
        Self { edge, taps, spp, period, side, part, errors, sums }
    }

    /// The same of white noise of a tile's samples per pixel and dimensions, which does not repeat.
    pub fn of_white_noise(&self, shape: TileShape) -> Self {
        let Self { taps, spp, side, .. } = *self;
        let whole = [usize::MAX; 2];
        let mut white = Self::with_period(self.edge.clone(), taps, spp, side, whole, None);
        let (low, high) = taps.bounds();
        let [width, height] = white.part;
        let frame = TileShape::new(width, height, 1, spp, shape.dims())
            .expect("a frame that is not larger than a tile");
        for dt in low.z..=high.z {
            let tile = Baseline::White.tile(frame, SEED + u64::from(high.z.abs_diff(dt)));
            let pixels = tile.samples().chunks_exact(spp * shape.dims());
            for (pixel, samples) in pixels.enumerate() {
                white.pixel(pixel % width, pixel / width, samples, shape.dims());
            }
            white.frame(dt);
        }
        white
    }

    /// The taps that see frame `t` from frame 0.
    fn taps_at(&self, t: i32) -> impl Iterator<Item = &'a Tap> + use<'a> {
        let (taps, period) = (self.taps.taps(), self.period);
        taps.iter().filter(move |tap| match period {
            Some(frames) => i64::from(tap.offset.z).rem_euclid(frames as i64) == i64::from(t),
            None => tap.offset.z == t,
        })
    }

    /// Whether the kernel sees frame `t` from frame 0.
    pub fn sees(&self, t: i32) -> bool {
        self.taps_at(t).next().is_some()
    }

    /// Takes a pixel of the present frame, if it counts.
    pub fn pixel(&mut self, x: usize, y: usize, samples: &[f32], dims: usize) {
        let [width, height] = self.part;
        if x < width && y < height {
            let sum: f64 = samples.chunks_exact(dims).map(|point| self.edge.at(point)).sum();
            self.errors[y * width + x] = (sum / self.spp as f64 - self.edge.integral()) as f32;
        }
    }

    /// Ends frame `t`: adds it wherever the kernel sees it from frame 0.
    pub fn frame(&mut self, t: i32) {
        if !self.sees(t) {
            return;
        }
        let seen = self.taps_at(t);
        let Self { taps, side, part, errors, sums, .. } = self;
        // With the columns and rows that follow the last ones, every tap is a plain shift.
        let low = taps.bounds().0;
        let [width, height, _] = taps.size().map(|n| n as usize);
        let columns = *side + width - 1;
        let rows = 0..*side + height - 1;
        let padded: Vec<f32> = rows
            .flat_map(|y| (0..columns).map(move |x| (x, y)))
            .map(|(x, y)| errors[y % part[1] * part[0] + x % part[0]])
            .collect();
        for tap in seen {
            let (x, y) = (tap.offset.x.abs_diff(low.x), tap.offset.y.abs_diff(low.y));
            let weight = tap.weight as f32;
            for (row, sums) in sums.chunks_exact_mut(*side).enumerate() {
                let errors = &padded[(row + y as usize) * columns + x as usize..][..*side];
                sums.iter_mut().zip(errors).for_each(|(sum, error)| *sum += weight * error);
            }
        }
    }

    /// Pixels across and down.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Row by row, in standard deviations of white noise.
    pub fn in_deviations_of_white_noise(&self) -> impl Iterator<Item = f64> {
        let squares: f64 = self.taps.taps().iter().map(|tap| tap.weight * tap.weight).sum();
        let deviation = (self.edge.variance() * squares / self.spp as f64).sqrt();
        self.sums.iter().map(move |&sum| f64::from(sum) / deviation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Domain;
    use crate::kernel::KernelSpec;
    use crate::metric::{Class, integrand_sets};

    fn taps(text: &str) -> KernelTaps {
        let spec: KernelSpec = text.parse().unwrap();
        spec.resolve_without_tile().unwrap().classes()[0].taps.clone()
    }

    fn edge(dims: usize) -> Integrand {
        let mut sets = integrand_sets(Domain::Square, 0, dims, 1).into_iter();
        sets.find(|set| set.class == Class::Edge).unwrap().integrands.remove(0)
    }

    /// What the kernel sees from pixel (x, y) of frame 0, by its definition.
    fn by_definition(
        errors: &[f32],
        shape: TileShape,
        taps: &KernelTaps,
        [x, y]: [usize; 2],
    ) -> f64 {
        let wrap = |at: usize, offset: i32, size: usize| {
            (at as i64 + i64::from(offset)).rem_euclid(size as i64) as usize
        };
        let of = |tap: &Tap| {
            let column = wrap(x, tap.offset.x, shape.width());
            let row = wrap(y, tap.offset.y, shape.height());
            let pixel = shape.pixel(column, row, wrap(0, tap.offset.z, shape.frames()));
            tap.weight * f64::from(errors[pixel])
        };
        taps.taps().iter().map(of).sum()
    }

    #[test]
    fn the_picture_is_the_filtered_error_of_whole_tiles_and_of_parts() {
        let taps = taps("gaussian(1) * ema(0.3) @ 3x5x6");
        let (edge, side) = (edge(3), 16);
        // Smaller than what is seen, larger, and shorter than the kernel.
        for (width, height, frames) in [(7, 5, 4), (40, 30, 9), (40, 5, 6), (3, 5, 1)] {
            let shape = TileShape::new(width, height, frames, 2, 3).unwrap();
            let tile = Baseline::White.tile(shape, 5);
            let mut errors = vec![0.0; shape.pixels()];
            edge.errors(&tile, &mut errors);
            let mut seen = PerceivedEdge::new(edge.clone(), &taps, shape, side);
            for t in 0..frames {
                for y in 0..height {
                    for x in 0..width {
                        let first = shape.pixel(x, y, t) * 6;
                        seen.pixel(x, y, &tile.samples()[first..first + 6], 3);
                    }
                }
                seen.frame(t as i32);
            }
            let squares: f64 = taps.taps().iter().map(|tap| tap.weight * tap.weight).sum();
            let deviation = (edge.variance() * squares / 2.0).sqrt();
            // The picture begins where the kernel's first column and row are the tile's.
            let low = taps.bounds().0;
            for (i, value) in seen.in_deviations_of_white_noise().enumerate() {
                let x = (i % side + low.x.unsigned_abs() as usize) % width;
                let y = (i / side + low.y.unsigned_abs() as usize) % height;
                let expected = by_definition(&errors, shape, &taps, [x, y]) / deviation;
                assert!((value - expected).abs() < 1e-4, "{shape} {i}: {value} {expected}");
            }
        }
    }

    #[test]
    fn white_noise_has_the_deviation_of_white_noise() {
        let taps = taps("gaussian(1) * gaussian_t(1) @ 5x5x5");
        let edge = edge(2);
        let shape = TileShape::new(4, 4, 2, 3, 2).unwrap();
        let white = PerceivedEdge::new(edge, &taps, shape, 64).of_white_noise(shape);
        let squares: f64 = white.in_deviations_of_white_noise().map(|value| value * value).sum();
        assert!((squares / 4096.0 - 1.0).abs() < 0.15, "{squares}");
    }

    #[test]
    fn what_would_take_long_is_smaller() {
        let shape = TileShape::new(64, 64, 16, 1, 2).unwrap();
        let usual = taps("gaussian(2.1) * fovvideovdp(60) @ 7x7x8");
        assert_eq!(PerceivedEdge::affordable(64, shape, &usual), 64);
        let many = TileShape::new(64, 64, 64, 64, 16).unwrap();
        assert!((LEAST..64).contains(&PerceivedEdge::affordable(64, many, &usual)));
        let wide = taps("gaussian(60, radius=250) * box(8)");
        assert!((LEAST..64).contains(&PerceivedEdge::affordable(64, shape, &wide)));
    }
}
