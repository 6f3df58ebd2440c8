//! A picture of a kernel for people: its frames, its space-time slice and what it lets through.
//!
//! One band per class. Above, the taps frame by frame, newest first, each with its dt below.
//! Underneath, from left to right: the slice (dx, dt) through the largest tap, newest frame on
//! top; |ĝ| over (f_x, f_y) at temporal frequency 0; |ĝ| over (f_x, f_t) at f_y = 0, frequency 0
//! in the middle. Positive taps are red, negative ones blue, by the square root of their part of
//! the largest; offsets without a tap are grey; the pixel that is filtered is outlined. |ĝ| runs
//! from its largest (yellow) to 60 dB below (black).

use std::collections::HashMap;

use glam::IVec3;

use crate::kernel::resolve::Kernel;
use crate::kernel::response::Response;
use crate::kernel::taps::KernelTaps;

/// Space around and between the bands.
const MARGIN: usize = 24;
/// Space between panels.
const GAP: usize = 10;
/// Width of all panels of a row together.
const CONTENT: usize = 8 * FRAME + 7 * GAP;
/// Largest side of the panel of one frame.
const FRAME: usize = 72;
/// Side of the three panels below.
const PLANE: usize = (CONTENT - 2 * GAP) / 3;
/// Largest side of one tap.
const CELL: usize = 20;
/// Most frames that get a panel; of more, every second, third and so on.
const FRAMES: usize = 32;
/// Frequencies across and down.
const FREQUENCIES: usize = PLANE / 2;
/// Range of the responses in dB.
const RANGE: f64 = 60.0;
/// Side of a dot of a digit.
const DOT: usize = 2;
/// Height of a line of digits with its distance from the panel.
const LABEL: usize = 5 * DOT + 6;

type Rgb = [u8; 3];
const PAPER: Rgb = [255; 3];
const INK: Rgb = [60; 3];
const FRAME_LINE: Rgb = [150; 3];
const NO_TAP: Rgb = [226; 3];
const POSITIVE: Rgb = [196, 40, 20];
const NEGATIVE: Rgb = [20, 70, 190];

/// An image of 8-bit sRGB pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

/// Draws the kernel.
pub fn picture(kernel: &Kernel) -> Picture {
    let bands: Vec<Picture> = kernel.classes().iter().map(|class| band(&class.taps)).collect();
    let height = MARGIN + bands.iter().map(|band| band.height + MARGIN).sum::<usize>();
    let mut all = Picture::new(CONTENT + 2 * MARGIN, height);
    let mut top = MARGIN;
    for (i, band) in bands.iter().enumerate() {
        if i > 0 {
            all.fill([MARGIN, top - MARGIN / 2], [CONTENT, 1], FRAME_LINE);
        }
        all.paste([MARGIN, top], band);
        top += band.height + MARGIN;
    }
    all
}

impl Picture {
    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels' red, green and blue, row by row from the top.
    pub fn into_rgb(self) -> Vec<u8> {
        self.rgb
    }

    fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: PAPER.repeat(width * height) }
    }

    /// Fills a rectangle, as far as it lies inside.
    fn fill(&mut self, [left, top]: [usize; 2], [width, height]: [usize; 2], colour: Rgb) {
        for y in top..(top + height).min(self.height) {
            for x in left..(left + width).min(self.width) {
                self.rgb[(y * self.width + x) * 3..][..3].copy_from_slice(&colour);
            }
        }
    }

    /// The border of a rectangle, inside it.
    fn outline(&mut self, [left, top]: [usize; 2], [width, height]: [usize; 2], colour: Rgb) {
        self.fill([left, top], [width, 1], colour);
        self.fill([left, top + height - 1], [width, 1], colour);
        self.fill([left, top], [1, height], colour);
        self.fill([left + width - 1, top], [1, height], colour);
    }

    fn paste(&mut self, [left, top]: [usize; 2], other: &Self) {
        for y in 0..other.height {
            let row = &other.rgb[y * other.width * 3..][..other.width * 3];
            self.rgb[((top + y) * self.width + left) * 3..][..row.len()].copy_from_slice(row);
        }
    }

    /// A whole number, its first digit at `left`.
    fn number(&mut self, [mut left, top]: [usize; 2], number: i32) {
        for character in number.to_string().chars() {
            let dots = character.to_digit(10).map_or(MINUS, |digit| DIGITS[digit as usize]);
            for (row, dots) in dots.into_iter().enumerate() {
                for column in (0..3).filter(|column| dots >> (2 - column) & 1 == 1) {
                    self.fill([left + column * DOT, top + row * DOT], [DOT, DOT], INK);
                }
            }
            left += 4 * DOT;
        }
    }
}

/// Digits of 3 × 5 dots, rows from the top.
const DIGITS: [[u8; 5]; 10] = [
    [0b111, 0b101, 0b101, 0b101, 0b111],
    [0b010, 0b110, 0b010, 0b010, 0b111],
    [0b111, 0b001, 0b111, 0b100, 0b111],
    [0b111, 0b001, 0b111, 0b001, 0b111],
    [0b101, 0b101, 0b111, 0b001, 0b001],
    [0b111, 0b100, 0b111, 0b001, 0b111],
    [0b111, 0b100, 0b111, 0b101, 0b111],
    [0b111, 0b001, 0b010, 0b010, 0b010],
    [0b111, 0b101, 0b111, 0b101, 0b111],
    [0b111, 0b101, 0b111, 0b001, 0b111],
];
const MINUS: [u8; 5] = [0, 0, 0b111, 0, 0];

/// All panels of one class.
fn band(taps: &KernelTaps) -> Picture {
    let weights: HashMap<IVec3, f64> =
        taps.taps().iter().map(|tap| (tap.offset, tap.weight)).collect();
    let largest = taps.taps()[0];
    let (low, high) = taps.bounds();
    let [width, height, frames] = taps.size().map(|n| n as usize);
    let colour = |offset: IVec3| weights.get(&offset).map(|weight| weight / largest.weight.abs());

    let stride = frames.div_ceil(FRAMES);
    let slices: Vec<(i32, Picture)> = (0..frames)
        .step_by(stride)
        .map(|age| {
            let dt = high.z - age as i32;
            let tap = |x, y| IVec3::new(low.x + x, low.y + y, dt);
            (dt, panel([width, height], FRAME, tap, colour))
        })
        .collect();
    let (_, first) = &slices[0];
    let pitch = [first.width.max(4 * DOT * 4) + GAP, first.height + LABEL + GAP];
    let per_row = ((CONTENT + GAP) / pitch[0]).max(1);
    let top = slices.len().div_ceil(per_row) * pitch[1] + GAP;

    let mut band = Picture::new(CONTENT, top + PLANE);
    for (i, (dt, slice)) in slices.iter().enumerate() {
        let corner = [i % per_row * pitch[0], i / per_row * pitch[1]];
        band.paste(corner, slice);
        band.number([corner[0], corner[1] + slice.height + 4], *dt);
    }
    let tap = |x, age| IVec3::new(low.x + x, largest.offset.y, high.z - age);
    let slice = panel([width, frames], PLANE, tap, colour);
    band.paste([(PLANE - slice.width) / 2, top + (PLANE - slice.height) / 2], &slice);
    for (i, response) in [
        Response::spatial(taps, FREQUENCIES, FREQUENCIES),
        Response::space_time(taps, FREQUENCIES, FREQUENCIES),
    ]
    .iter()
    .enumerate()
    {
        band.paste([(i + 1) * (PLANE + GAP), top], &spectrum(response));
    }
    band
}

/// A plane of taps, `side` pixels long at most; where there are more taps than pixels, each pixel
/// shows the largest of its block. `colour` is the part of the largest weight, if there is a tap.
fn panel(
    [columns, rows]: [usize; 2],
    side: usize,
    tap: impl Fn(i32, i32) -> IVec3,
    colour: impl Fn(IVec3) -> Option<f64>,
) -> Picture {
    let block = columns.max(rows).div_ceil(side - 2);
    let shown = [columns.div_ceil(block), rows.div_ceil(block)];
    let cell = ((side - 2) / shown[0].max(shown[1])).min(CELL);
    let mut panel = Picture::new(shown[0] * cell + 2, shown[1] * cell + 2);
    for y in 0..shown[1] {
        for x in 0..shown[0] {
            let mut largest: Option<f64> = None;
            let mut centre = false;
            for j in y * block..((y + 1) * block).min(rows) {
                for i in x * block..((x + 1) * block).min(columns) {
                    let offset = tap(i as i32, j as i32);
                    centre |= offset == IVec3::ZERO;
                    largest = match (largest, colour(offset)) {
                        (Some(a), Some(b)) if a.abs() < b.abs() => Some(b),
                        (a, b) => a.or(b),
                    };
                }
            }
            let corner = [1 + x * cell, 1 + y * cell];
            panel.fill(corner, [cell; 2], largest.map_or(NO_TAP, signed));
            if centre && cell > 2 {
                panel.outline(corner, [cell; 2], INK);
            }
        }
    }
    panel.outline([0, 0], [panel.width, panel.height], FRAME_LINE);
    panel
}

/// White to red for 0 to 1, white to blue for 0 to −1.
fn signed(part: f64) -> Rgb {
    blend(PAPER, if part < 0.0 { NEGATIVE } else { POSITIVE }, part.abs().sqrt())
}

fn blend(from: Rgb, to: Rgb, part: f64) -> Rgb {
    std::array::from_fn(|i| {
        (f64::from(from[i]) + part * (f64::from(to[i]) - f64::from(from[i]))).round() as u8
    })
}

/// A response in dB below its largest value.
fn spectrum(response: &Response) -> Picture {
    /// From 60 dB below to the largest: black, violet, red, yellow.
    const COLOURS: [Rgb; 5] =
        [[0, 0, 0], [60, 15, 110], [175, 45, 90], [245, 130, 30], [252, 250, 165]];
    let cell = PLANE / FREQUENCIES;
    let mut panel = Picture::new(response.columns * cell, response.rows * cell);
    let peak = response.magnitude.iter().fold(f64::MIN_POSITIVE, |peak, &m| peak.max(m));
    for (k, &magnitude) in response.magnitude.iter().enumerate() {
        let level = 1.0 + 20.0 * libm::log10(magnitude / peak) / RANGE;
        let place = level.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
        let lower = (place as usize).min(COLOURS.len() - 2);
        let colour = blend(COLOURS[lower], COLOURS[lower + 1], place - lower as f64);
        let corner = [k % response.columns * cell, k / response.columns * cell];
        panel.fill(corner, [cell; 2], colour);
    }
    panel
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::KernelSpec;
    use crate::tile::TileShape;

    fn draw(spec: &str) -> Picture {
        let shape = TileShape::new(300, 200, 100, 1, 1).unwrap();
        picture(&spec.parse::<KernelSpec>().unwrap().resolve(shape).unwrap())
    }

    fn count(picture: &Picture, colour: Rgb) -> usize {
        picture.rgb.chunks_exact(3).filter(|pixel| *pixel == colour).count()
    }

    #[test]
    fn any_kernel_has_a_picture() {
        for spec in ["none", "column", "frame", "gaussian(20) @ 99%", "1: ema(0.2) + 2: box(100)"] {
            let picture = draw(spec);
            assert!(count(&picture, PAPER) < picture.width() * picture.height(), "{spec}");
            assert_eq!(picture.width() * picture.height() * 3, picture.into_rgb().len(), "{spec}");
        }
    }

    #[test]
    fn signs_have_their_colours() {
        // The largest tap fills whole cells; the last of two taps at 4.5 fps is the largest.
        let causal = draw("fovvideovdp(60)");
        assert!(count(&causal, POSITIVE) > CELL * CELL / 2);
        assert_eq!(count(&causal, NEGATIVE), 0);
        let blue = |picture: &Picture| {
            picture
                .rgb
                .chunks_exact(3)
                .any(|pixel| pixel[2] > pixel[0].saturating_add(15) && pixel[0] > 100)
        };
        assert!(blue(&causal));
        assert!(!blue(&draw("box(5)")));
    }
}
