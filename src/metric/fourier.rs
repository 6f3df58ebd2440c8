//! Discrete Fourier transform of a real field over a tile: x, y and t.
//!
//! The scores only ever need sums over all frequencies, so the result stays in the order in which
//! the last pass leaves it, and nothing is moved back.

use std::sync::Arc;

use realfft::{RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftNum, FftPlanner};

/// Side of the square blocks in which matrices are transposed: two of them fit the first cache.
const BLOCK: usize = 16;

/// The plan of a transform of `frames × height × width` real numbers.
///
/// Real input has a Hermitian transform, so only `columns() = width/2 + 1` frequencies in x are
/// computed. The order of the result is `(kx, ky, kt)`, `kt` fastest.
pub(super) struct FieldTransform<T: FftNum> {
    width: usize,
    height: usize,
    frames: usize,
    across: Arc<dyn RealToComplex<T>>,
    down: Arc<dyn Fft<T>>,
    time: Arc<dyn Fft<T>>,
}

/// What a transform works in; lent by the caller, so that transforming allocates nothing.
pub(super) struct FourierWorkspace<T> {
    /// The result after [`FieldTransform::transform`].
    pub(super) spectrum: Vec<Complex<T>>,
    other: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

impl<T: FftNum> FieldTransform<T> {
    /// Plans the transform of a field of these sizes, each at least 1.
    pub(super) fn new(width: usize, height: usize, frames: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self {
            width,
            height,
            frames,
            across: RealFftPlanner::new().plan_fft_forward(width),
            down: planner.plan_fft_forward(height),
            time: planner.plan_fft_forward(frames),
        }
    }

    /// How many frequencies in x are kept.
    pub(super) fn columns(&self) -> usize {
        self.width / 2 + 1
    }

    /// How often the frequencies of column `kx` stand in the full transform: twice, except where
    /// `kx` is its own mirror image.
    pub(super) fn multiplicity(&self, kx: usize) -> f64 {
        if kx == 0 || 2 * kx == self.width { 1.0 } else { 2.0 }
    }

    /// A workspace for this plan.
    pub(super) fn workspace(&self) -> FourierWorkspace<T> {
        let zero = Complex::new(T::zero(), T::zero());
        let scratch = self
            .across
            .get_scratch_len()
            .max(self.down.get_inplace_scratch_len())
            .max(self.time.get_inplace_scratch_len());
        let len = self.columns() * self.height * self.frames;
        FourierWorkspace {
            spectrum: vec![zero; len],
            other: vec![zero; len],
            scratch: vec![zero; scratch],
        }
    }

    /// Transforms `field` (`frames × height × width` in C order; destroyed) into
    /// `workspace.spectrum`, without any factor.
    ///
    /// # Panics
    /// If the lengths are not those of the plan.
    pub(super) fn transform(&self, field: &mut [T], workspace: &mut FourierWorkspace<T>) {
        let FourierWorkspace { spectrum, other, scratch } = workspace;
        let columns = self.columns();
        assert_eq!(field.len(), self.width * self.height * self.frames, "field of the plan");
        for (row, result) in field.chunks_exact_mut(self.width).zip(other.chunks_exact_mut(columns))
        {
            self.across.process_with_scratch(row, result, scratch).expect("lengths of the plan");
        }
        for (frame, result) in other
            .chunks_exact(columns * self.height)
            .zip(spectrum.chunks_exact_mut(columns * self.height))
        {
            transpose(frame, result, self.height, columns);
        }
        if self.height > 1 {
            self.down.process_with_scratch(spectrum, scratch);
        }
        if self.frames > 1 {
            transpose(spectrum, other, self.frames, columns * self.height);
            std::mem::swap(spectrum, other);
            self.time.process_with_scratch(spectrum, scratch);
        }
    }
}

/// `to[column][row] = from[row][column]`
fn transpose<T: Copy>(from: &[T], to: &mut [T], rows: usize, columns: usize) {
    for first_row in (0..rows).step_by(BLOCK) {
        let last_row = (first_row + BLOCK).min(rows);
        for first_column in (0..columns).step_by(BLOCK) {
            for column in first_column..(first_column + BLOCK).min(columns) {
                for row in first_row..last_row {
                    to[column * rows + row] = from[row * columns + column];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::split_mix::SplitMix;
    use super::*;

    #[test]
    fn the_transform_is_its_definition() {
        for (width, height, frames) in [(4, 3, 2), (5, 2, 3), (1, 4, 1), (2, 1, 5), (1, 1, 1)] {
            let mut stream = SplitMix::new(&[9]);
            let field = stream.point(width * height * frames);
            let plan = FieldTransform::<f64>::new(width, height, frames);
            let mut workspace = plan.workspace();
            plan.transform(&mut field.clone(), &mut workspace);
            for kx in 0..plan.columns() {
                for ky in 0..height {
                    for kt in 0..frames {
                        let mut sum = Complex::new(0.0, 0.0);
                        for (i, value) in field.iter().enumerate() {
                            let (x, y) = (i % width, i / width % height);
                            let t = i / width / height;
                            let turns = (kx * x) as f64 / width as f64
                                + (ky * y) as f64 / height as f64
                                + (kt * t) as f64 / frames as f64;
                            sum += Complex::from_polar(*value, -TAU * turns);
                        }
                        let found = workspace.spectrum[(kx * height + ky) * frames + kt];
                        assert!((found - sum).norm() < 1e-12, "{kx} {ky} {kt}: {found} {sum}");
                    }
                }
            }
        }
    }
}
