//! Filters rows of whole pictures: Σ g(o) · picture(p + o).
//!
//! Of a kernel's planes (most have one) frames are summed first, pixel by pixel, and then filtered
//! in space, along rows and columns where the plane is a product. All in `f32`, in an order that
//! depends on the kernel alone.

use std::ops::Range;

use glam::IVec3;

use super::SelectError;
use crate::kernel::{KernelPlanes, KernelTaps, Tap};

/// A kernel that is ready to filter.
#[derive(Debug, Clone)]
pub(super) struct Filter {
    planes: Vec<Plane>,
}

/// Weights in space, and the frames that use them.
#[derive(Debug, Clone)]
struct Plane {
    /// Offset of its first column and row.
    x: i64,
    y: i64,
    width: usize,
    height: usize,
    weights: Weights,
    /// Offset and factor of each frame.
    frames: Vec<(i64, f32)>,
}

#[derive(Debug, Clone)]
enum Weights {
    Product {
        row: Vec<f32>,
        column: Vec<f32>,
    },
    /// Row by row.
    Full(Vec<f32>),
}

/// What is seen beyond the borders of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Border {
    /// Nothing.
    Zero,
    /// The pixel at the border.
    Same,
}

/// A sequence of pictures, row by row.
pub(super) trait Rows {
    /// Adds `scale` times a row of a frame to `out`. Frames before the first and behind the last are
    /// asked for as well.
    fn add(&self, frame: i64, row: usize, scale: f32, out: &mut [f32]);
}

/// Rows of the source, and what lies beyond their ends.
#[derive(Debug, Default)]
pub(super) struct FilterScratch {
    source: Vec<f32>,
    rows: Vec<f32>,
}

impl Filter {
    /// A kernel whose weights are multiplied by `scale`.
    ///
    /// # Errors
    /// A kernel whose planes have too many weights.
    pub fn new(kernel: &KernelTaps, scale: f64) -> Result<Self, SelectError> {
        let taken = KernelPlanes::of(kernel).ok_or(SelectError::Kernel)?;
        let single = |weights: &[f64]| weights.iter().map(|&w| w as f32).collect::<Vec<f32>>();
        let planes = taken.planes.iter().enumerate().map(|(index, plane)| Plane {
            x: plane.x.into(),
            y: plane.y.into(),
            width: plane.width,
            height: plane.height,
            weights: match (&plane.row, &plane.column) {
                (Some(row), Some(column)) => {
                    Weights::Product { row: single(row), column: single(column) }
                }
                _ => Weights::Full(single(&plane.weights)),
            },
            frames: taken
                .slices
                .iter()
                .filter(|slice| slice.plane == index)
                .map(|slice| (slice.dt.into(), (slice.scale * scale) as f32))
                .collect(),
        });
        Ok(Self { planes: planes.collect() })
    }

    /// The kernel turned around with its weights squared, after they were multiplied by `scale`:
    /// what a change of a pixel adds to the squares of errors around it.
    ///
    /// # Errors
    /// A kernel whose planes have too many weights.
    pub fn of_squares(kernel: &KernelTaps, scale: f64) -> Result<Self, SelectError> {
        let square =
            |tap: &Tap| Tap { offset: IVec3::ZERO - tap.offset, weight: tap.weight * tap.weight };
        let squares =
            KernelTaps::new(kernel.taps().iter().map(square)).map_err(|_| SelectError::Kernel)?;
        Self::new(&squares, kernel.power() * scale * scale)
    }

    /// Some rows of a filtered frame, to `out`.
    pub fn rows(
        &self,
        source: &impl Rows,
        frame: i64,
        (rows, height): (Range<usize>, usize),
        border: Border,
        scratch: &mut FilterScratch,
        out: &mut [f32],
    ) {
        let width = out.len() / rows.len();
        out.fill(0.0);
        for plane in &self.planes {
            let right = (plane.x + plane.width as i64 - 1).max(0) as usize;
            let left = (-plane.x).max(0) as usize;
            let padded = left + width + right;
            scratch.source.resize(padded, 0.0);
            // Where an output's first column is read.
            let start = (left as i64 + plane.x) as usize;
            let first = rows.start as i64 + plane.y;
            let count = rows.len() + plane.height - 1;
            let product = matches!(plane.weights, Weights::Product { .. });
            let stride = if product { width } else { padded };
            scratch.rows.clear();
            scratch.rows.resize(count * stride, 0.0);
            for (i, target) in scratch.rows.chunks_exact_mut(stride).enumerate() {
                let y = first + i as i64;
                let inside = y.clamp(0, height as i64 - 1);
                if border == Border::Zero && inside != y {
                    continue;
                }
                let line = &mut scratch.source[left..][..width];
                line.fill(0.0);
                for &(dt, scale) in &plane.frames {
                    source.add(frame + dt, inside as usize, scale, line);
                }
                let ends = match border {
                    Border::Zero => [0.0, 0.0],
                    Border::Same => [line[0], line[width - 1]],
                };
                scratch.source[..left].fill(ends[0]);
                scratch.source[left + width..].fill(ends[1]);
                match &plane.weights {
                    Weights::Product { row, .. } => {
                        for (j, &weight) in row.iter().enumerate() {
                            add(&scratch.source[start + j..][..width], weight, target);
                        }
                    }
                    Weights::Full(_) => target.copy_from_slice(&scratch.source),
                }
            }
            for (i, out) in out.chunks_exact_mut(width).enumerate() {
                for dy in 0..plane.height {
                    let line = &scratch.rows[(i + dy) * stride..][..stride];
                    match &plane.weights {
                        Weights::Product { column, .. } => add(line, column[dy], out),
                        Weights::Full(weights) => {
                            for (j, &weight) in
                                weights[dy * plane.width..][..plane.width].iter().enumerate()
                            {
                                add(&line[start + j..][..width], weight, out);
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Adds `weight` times a row to another one.
pub(super) fn add(row: &[f32], weight: f32, out: &mut [f32]) {
    for (out, &value) in out.iter_mut().zip(row) {
        *out += weight * value;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::draw::{Stream, Use};

    struct Pictures {
        width: usize,
        height: usize,
        values: Vec<f32>,
    }

    impl Pictures {
        fn at(&self, x: i64, y: i64, t: i64, border: Border) -> f64 {
            let size = (self.width * self.height) as i64;
            let (inside, row) =
                (x.clamp(0, self.width as i64 - 1), y.clamp(0, self.height as i64 - 1));
            let hidden = border == Border::Zero && (inside != x || row != y);
            let frames = self.values.len() as i64 / size;
            if hidden || t < 0 || t >= frames {
                return 0.0;
            }
            self.values[(t * size + row * self.width as i64 + inside) as usize].into()
        }
    }

    impl Rows for Pictures {
        fn add(&self, frame: i64, row: usize, scale: f32, out: &mut [f32]) {
            let Some(picture) = usize::try_from(frame)
                .ok()
                .and_then(|t| self.values.chunks_exact(self.width * self.height).nth(t))
            else {
                return;
            };
            add(&picture[row * self.width..][..self.width], scale, out);
        }
    }

    proptest! {
        #[test]
        fn rows_are_those_of_the_definition(
            (width, height, frames) in (1_usize..12, 1_usize..12, 1_usize..4),
            taps in prop::collection::vec((-3..4_i32, -3..4_i32, -3..2_i32, -1.0..1.0), 1..12),
            product: bool,
            same: bool,
            seed: u64,
        ) {
            let mut stream = Stream::new(seed, Use::Baseline, 0, 0);
            let values =
                (0..width * height * frames).map(|_| stream.below(1000) as f32 / 1000.0).collect();
            let pictures = Pictures { width, height, values };
            let mut weights = std::collections::BTreeMap::new();
            for &(x, y, t, weight) in &taps {
                if product {
                    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let factor = [1.0, 0.5][dx as usize] * [1.0, -0.25][dy as usize];
                        weights.insert((dx, dy, t), weight * factor);
                    }
                } else {
                    weights.insert((x, y, t), weight);
                }
            }
            let tap = |((x, y, z), weight)| Tap { offset: IVec3::new(x, y, z), weight };
            let Ok(kernel) = KernelTaps::new(weights.into_iter().map(tap)) else { return Ok(()) };
            let border = if same { Border::Same } else { Border::Zero };
            let filter = Filter::new(&kernel, 3.0).unwrap();
            let squares = Filter::of_squares(&kernel, 3.0).unwrap();
            let rows = height / 3..height;
            let mut found = vec![f32::NAN; rows.len() * width];
            let mut of_squares = found.clone();
            let mut scratch = FilterScratch::default();
            for t in 0..frames as i64 {
                let within = (rows.clone(), height);
                filter.rows(&pictures, t, within.clone(), border, &mut scratch, &mut found);
                squares.rows(&pictures, t, within, border, &mut scratch, &mut of_squares);
                for (i, (&found, &square)) in found.iter().zip(&of_squares).enumerate() {
                    let (x, y) = ((i % width) as i64, (rows.start + i / width) as i64);
                    let sum = |sign: i64, weight: fn(f64) -> f64| -> f64 {
                        kernel.taps().iter().map(|tap| {
                            let [dx, dy, dt] = tap.offset.to_array().map(|o| sign * i64::from(o));
                            weight(3.0 * tap.weight) * pictures.at(x + dx, y + dy, t + dt, border)
                        }).sum()
                    };
                    prop_assert!((f64::from(found) - sum(1, |w| w)).abs() < 2e-5);
                    prop_assert!((f64::from(square) - sum(-1, |w| w * w)).abs() < 2e-5);
                }
            }
        }
    }
}
