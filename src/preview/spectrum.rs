//! The mean power spectrum of a tile's error over its first frames.
//!
//! That of `metric` is more exact and needs the whole tile. This one takes frame after frame and
//! few integrands, and transforms with plain operations, so that a tile has the same picture on
//! every processor.

use std::f64::consts::TAU;
use std::sync::Arc;

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlannerScalar};

use crate::metric::IntegrandSet;
use crate::tile::TileShape;

/// Most pixels across and down of a frame that are transformed.
const MOST: usize = 128;
/// Most frames.
const FRAMES: usize = 8;
/// Most samples on which integrands are evaluated, as far as one frame has not more.
const EVALUATIONS: usize = 1 << 22;

/// A spectrum that grows with every frame.
pub(super) struct ErrorSpectrum {
    sets: Vec<IntegrandSet>,
    spp: usize,
    /// Pixels across and down of the part that is transformed.
    size: [usize; 2],
    frames: usize,
    /// Where the part ends before the tile does, its ends do not meet: it fades out there, as the
    /// jump would be taken for error of all frequencies.
    fading: [Vec<f64>; 2],
    plans: [Arc<dyn Fft<f64>>; 2],
    /// The errors of all integrands, one after the other.
    errors: Vec<f32>,
    power: Vec<f64>,
    taken: usize,
}

impl ErrorSpectrum {
    /// Begins with no frame.
    pub fn new(sets: Vec<IntegrandSet>, shape: TileShape) -> Self {
        let size = [shape.width().min(MOST), shape.height().min(MOST)];
        let pixels = size[0] * size[1];
        let integrands: usize = sets.iter().map(|set| set.integrands.len()).sum();
        let frames = EVALUATIONS / (integrands * pixels * shape.spp());
        let fading = [(size[0], shape.width()), (size[1], shape.height())];
        let mut planner = FftPlannerScalar::new();
        Self {
            sets,
            spp: shape.spp(),
            size,
            frames: frames.clamp(1, FRAMES),
            fading: fading.map(|(part, whole)| fading_of(part, part < whole)),
            plans: size.map(|n| planner.plan_fft_forward(n)),
            errors: vec![0.0; integrands * pixels],
            power: vec![0.0; pixels],
            taken: 0,
        }
    }

    /// Frames that count.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Takes a pixel of the present frame, if it counts.
    pub fn pixel(&mut self, x: usize, y: usize, samples: &[f32], dims: usize) {
        let [width, height] = self.size;
        if x >= width || y >= height {
            return;
        }
        let integrands = self.sets.iter().flat_map(|set| &set.integrands);
        for (f, errors) in integrands.zip(self.errors.chunks_exact_mut(width * height)) {
            let sum: f64 = samples.chunks_exact(dims).map(|point| f.at(point)).sum();
            errors[y * width + x] = (sum / self.spp as f64 - f.integral()) as f32;
        }
    }

    /// Ends a frame.
    pub fn frame(&mut self) {
        let [width, height] = self.size;
        let mut images = self.errors.chunks_exact(width * height);
        for set in &self.sets {
            let variances: f64 = set.integrands.iter().map(|f| f.variance()).sum();
            // Classes count alike, and white noise has 1.
            let white = variances / self.spp as f64 * (width * height * self.sets.len()) as f64;
            for image in images.by_ref().take(set.integrands.len()) {
                let transformed = transform(image, &self.fading, &self.plans);
                for (power, f) in self.power.iter_mut().zip(&transformed) {
                    *power += f.norm_sqr() / white;
                }
            }
        }
        self.taken += 1;
    }

    /// Frequencies across and down.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Power relative to white noise's; frequency 0 is in column `width / 2` and row `height / 2`.
    pub fn power(&self, column: usize, row: usize) -> f64 {
        let [width, height] = self.size;
        let unwrap = |place: usize, size: usize| (place + size - size / 2) % size;
        // Transforms leave columns behind each other.
        let at = unwrap(column, width) * height + unwrap(row, height);
        self.power[at] / self.taken.max(1) as f64
    }
}

/// Weights of mean square 1 along an axis: Hann's window, or nothing.
fn fading_of(part: usize, fades: bool) -> Vec<f64> {
    let hann = |i: usize| 0.5 - 0.5 * libm::cos(TAU * (i as f64 + 0.5) / part as f64);
    let weights: Vec<f64> = (0..part).map(|i| if fades { hann(i) } else { 1.0 }).collect();
    let square: f64 = weights.iter().map(|w| w * w).sum();
    let scale = (part as f64 / square).sqrt();
    weights.iter().map(|w| w * scale).collect()
}

/// The transform of an image, column behind column.
fn transform(
    image: &[f32],
    [across, down]: &[Vec<f64>; 2],
    [along_x, along_y]: &[Arc<dyn Fft<f64>>; 2],
) -> Vec<Complex<f64>> {
    let (width, height) = (across.len(), down.len());
    let mut rows: Vec<Complex<f64>> = image
        .iter()
        .enumerate()
        .map(|(i, &e)| Complex::from(f64::from(e) * across[i % width] * down[i / width]))
        .collect();
    along_x.process(&mut rows);
    let place = |i: usize| rows[i % height * width + i / height];
    let mut columns: Vec<Complex<f64>> = (0..rows.len()).map(place).collect();
    along_y.process(&mut columns);
    columns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Domain;
    use crate::metric::{Baseline, ScoreOptions, integrand_sets, spectra};
    use crate::tile::Tile;

    fn take(sets: Vec<IntegrandSet>, tile: &Tile) -> ErrorSpectrum {
        let shape = tile.shape();
        let pixel = shape.spp() * shape.dims();
        let mut spectrum = ErrorSpectrum::new(sets, shape);
        for t in 0..spectrum.frames().min(shape.frames()) {
            for y in 0..shape.height() {
                for x in 0..shape.width() {
                    let samples = &tile.samples()[shape.pixel(x, y, t) * pixel..][..pixel];
                    spectrum.pixel(x, y, samples, shape.dims());
                }
            }
            spectrum.frame();
        }
        spectrum
    }

    #[test]
    fn it_is_the_mean_of_the_spectra_of_the_scores() {
        for (width, height, frames, spp) in [(12, 10, 3, 2), (1, 7, 1, 1), (16, 1, 2, 1)] {
            let shape = TileShape::new(width, height, frames, spp, 2).unwrap();
            let tile = Baseline::White.tile(shape, 3);
            let sets = integrand_sets(Domain::Square, 0, 2, 4);
            let found = take(sets, &tile);
            let expected =
                spectra(&tile, ScoreOptions { set: 0, integrands: 4, ..ScoreOptions::default() })
                    .unwrap();
            for (i, (row, column)) in
                (0..height).flat_map(|y| (0..width).map(move |x| (y, x))).enumerate()
            {
                let classes = expected.iter().map(|class| f64::from(class.xy.power[i]));
                let mean = classes.sum::<f64>() / expected.len() as f64;
                let power = found.power(column, row);
                assert!((power - mean).abs() < 1e-4 * (1.0 + mean), "{shape} {i}: {power} {mean}");
            }
        }
    }

    #[test]
    fn a_part_of_a_tile_keeps_the_power_of_white_noise() {
        let tile = Baseline::White.tile(TileShape::new(300, 200, 1, 1, 2).unwrap(), 1);
        let sets = integrand_sets(Domain::Square, 0, 2, 4);
        let spectrum = take(sets, &tile);
        assert_eq!(spectrum.size(), [MOST; 2]);
        let all = (0..MOST).flat_map(|row| (0..MOST).map(move |column| (column, row)));
        let mean: f64 = all.map(|(x, y)| spectrum.power(x, y)).sum::<f64>() / (MOST * MOST) as f64;
        assert!((mean - 1.0).abs() < 0.05, "{mean}");
    }

    #[test]
    fn many_samples_leave_one_frame() {
        let sets = integrand_sets(Domain::Square, 0, 16, 8);
        let frames = |shape: TileShape| ErrorSpectrum::new(sets[..5].to_vec(), shape).frames();
        assert_eq!(frames(TileShape::new(64, 64, 16, 1, 16).unwrap()), FRAMES);
        assert_eq!(frames(TileShape::new(128, 128, 30, 64, 16).unwrap()), 1);
    }
}
