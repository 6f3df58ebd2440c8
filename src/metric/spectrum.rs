//! Power spectra of the error, in space and in space-time.
//!
//! The picture by which noise is judged in the literature: where the error's power is, in XY
//! slices (a frame) and in XT slices (a row of pixels over time). White noise is 1 everywhere. As in
//! `scores`, the power is the mean over the integrands divided by white noise's mean, so that what
//! a kernel lets through of a spectrum is the score.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::ScoreError;
use super::fourier::FieldTransform;
use super::integrand::{Class, Coordinates, Integrand, integrand_sets};
use super::scores::ScoreOptions;
use crate::tile::{Tile, TileShape};

/// Integrands whose spectra are held at a time, so that memory does not grow with their number.
const BATCH: usize = 64;

/// A power spectrum over two axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spectrum {
    /// Frequencies along the first axis (x).
    pub width: usize,
    /// Frequencies along the second axis (y or t).
    pub height: usize,
    /// Power relative to white noise's, row by row; frequency 0 is at `(width / 2, height / 2)`.
    #[serde(skip)]
    pub power: Vec<f32>,
    /// Its averages over rings around frequency 0, outwards.
    pub radial: Vec<Ring>,
}

/// The mean power at one distance from frequency 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ring {
    /// The distance in cycles per pixel (or frame), 0–0.71: the middle of a ring whose width is
    /// one frequency of the longer axis.
    pub frequency: f64,
    /// Mean power over the ring, relative to white noise's.
    pub power: f64,
}

/// The spectra of one class of integrands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClassSpectra {
    /// The class.
    pub class: Class,
    /// Which coordinates its integrands read.
    pub coordinates: Coordinates,
    /// Mean over all frames.
    pub xy: Spectrum,
    /// Mean over all rows of pixels; time is the second axis.
    pub xt: Spectrum,
}

/// The spectra of a tile's error for each class of integrands.
///
/// # Errors
/// A number of integrands out of range.
pub fn spectra(tile: &Tile, options: ScoreOptions) -> Result<Vec<ClassSpectra>, ScoreError> {
    options.validate()?;
    let shape = tile.shape();
    options.domain.check(shape.dims())?;
    let (width, height, frames) = (shape.width(), shape.height(), shape.frames());
    let xy = SliceTransform::new(width, height);
    let xt = SliceTransform::new(width, frames);
    let classes = integrand_sets(options.domain, options.set, shape.dims(), options.integrands)
        .iter()
        .map(|set| {
            let mut sums = [vec![0.0; xy.len()], vec![0.0; xt.len()]];
            for batch in set.integrands.chunks(BATCH) {
                let powers: Vec<[Vec<f64>; 2]> = batch
                    .par_iter()
                    .map(|f| {
                        let (frames, rows) = slices(tile, f);
                        [xy.mean_power(&frames), xt.mean_power(&rows)]
                    })
                    .collect();
                // In order, so that the threads cannot change the sum.
                for power in powers.iter().flat_map(|pair| pair.iter().zip(0..)) {
                    sums[power.1].iter_mut().zip(power.0).for_each(|(sum, p)| *sum += p);
                }
            }
            let variances = set.integrands.iter().map(Integrand::variance).sum::<f64>();
            let white = variances / shape.spp() as f64;
            sums.iter_mut().flatten().for_each(|sum| *sum /= white);
            let [space, time] = &sums;
            ClassSpectra {
                class: set.class,
                coordinates: set.coordinates,
                xy: xy.spectrum(space),
                xt: xt.spectrum(time),
            }
        })
        .collect();
    Ok(classes)
}

/// The error image of an integrand, frame by frame, and the same in the order (y, t, x).
fn slices(tile: &Tile, integrand: &Integrand) -> (Vec<f32>, Vec<f32>) {
    let shape: TileShape = tile.shape();
    let (width, height) = (shape.width(), shape.height());
    let mut errors = vec![0.0_f32; shape.pixels()];
    integrand.errors(tile, &mut errors);
    let rows = (0..height)
        .flat_map(|y| (0..shape.frames()).map(move |t| shape.pixel(0, y, t)))
        .flat_map(|first| errors[first..first + width].iter().copied())
        .collect();
    (errors, rows)
}

/// Transforms of slices of one size.
struct SliceTransform {
    width: usize,
    height: usize,
    plan: FieldTransform<f32>,
}

impl SliceTransform {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, plan: FieldTransform::new(width, height, 1) }
    }

    /// How many frequencies a transform computes; the others are mirror images.
    fn len(&self) -> usize {
        self.plan.columns() * self.height
    }

    /// |F|² / pixels, averaged over the slices, in the order of the transform.
    fn mean_power(&self, slices: &[f32]) -> Vec<f64> {
        let pixels = self.width * self.height;
        let mut workspace = self.plan.workspace();
        let mut field = vec![0.0; pixels];
        let mut sums = vec![0.0; self.len()];
        for slice in slices.chunks_exact(pixels) {
            field.copy_from_slice(slice);
            self.plan.transform(&mut field, &mut workspace);
            for (sum, f) in sums.iter_mut().zip(&workspace.spectrum) {
                *sum += f64::from(f.norm_sqr());
            }
        }
        let factor = 1.0 / slices.len() as f64;
        sums.iter_mut().for_each(|sum| *sum *= factor);
        sums
    }

    /// The whole plane of frequencies from its computed half.
    fn spectrum(&self, half: &[f64]) -> Spectrum {
        let (width, height) = (self.width, self.height);
        let at = |kx: usize, ky: usize| {
            // The transform of a real slice takes complex conjugates at opposite frequencies.
            let (kx, ky) = if kx < self.plan.columns() {
                (kx, ky)
            } else {
                (width - kx, (height - ky) % height)
            };
            half[kx * height + ky]
        };
        // From a place in the picture to a frequency, as the transform counts it and signed.
        let unwrap = |place: usize, size: usize| {
            let signed = place as i64 - (size / 2) as i64;
            (signed.rem_euclid(size as i64) as usize, signed as f64 / size as f64)
        };
        let longer = width.max(height) as f64;
        let mut rings: Vec<(f64, usize)> = Vec::new();
        let mut power = Vec::with_capacity(width * height);
        for row in 0..height {
            let (ky, vertical) = unwrap(row, height);
            for column in 0..width {
                let (kx, horizontal) = unwrap(column, width);
                let value = at(kx, ky);
                power.push(value as f32);
                let distance = (horizontal * horizontal + vertical * vertical).sqrt();
                let ring = (distance * longer).round() as usize;
                if rings.len() <= ring {
                    rings.resize(ring + 1, (0.0, 0));
                }
                rings[ring].0 += value;
                rings[ring].1 += 1;
            }
        }
        let radial = rings
            .iter()
            .enumerate()
            .filter(|(_, (_, count))| *count > 0)
            .map(|(ring, &(sum, count))| Ring {
                frequency: ring as f64 / longer,
                power: sum / count as f64,
            })
            .collect();
        Spectrum { width, height, power, radial }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::baseline::Baseline;
    use super::*;

    #[test]
    fn a_wave_is_two_points_beside_the_centre() {
        for (width, height) in [(8, 6), (7, 5)] {
            let transform = SliceTransform::new(width, height);
            // One slice: 2 periods across and 1 down.
            let wave: Vec<f32> = (0..width * height)
                .map(|i| {
                    let (x, y) = ((i % width) as f64, (i / width) as f64);
                    (TAU * (2.0 * x / width as f64 + y / height as f64)).cos() as f32
                })
                .collect();
            // Its variance is ½: the power of all frequencies is half their number.
            let found = transform.spectrum(&transform.mean_power(&wave));
            let (cx, cy) = (width / 2, height / 2);
            for (i, &power) in found.power.iter().enumerate() {
                let place = ((i % width).wrapping_sub(cx), (i / width).wrapping_sub(cy));
                let peak = place == (2, 1) || place == (0_usize.wrapping_sub(2), usize::MAX);
                let expected = if peak { (width * height) as f32 / 4.0 } else { 0.0 };
                assert!((power - expected).abs() < 1e-4, "{place:?}: {power}");
            }
            let total: f32 = found.power.iter().sum();
            assert!((total - (width * height) as f32 / 2.0).abs() < 1e-3);
        }
    }

    #[test]
    fn white_noise_is_flat_and_a_constant_in_time_is_not() {
        let options = ScoreOptions { set: 3, integrands: 16, ..ScoreOptions::default() };
        let shape = TileShape::new(16, 12, 8, 2, 2).unwrap();
        let white = Baseline::White.tile(shape, 1);
        for class in spectra(&white, options).unwrap() {
            for spectrum in [&class.xy, &class.xt] {
                assert_eq!(spectrum.power.len(), spectrum.width * spectrum.height);
                let mean: f32 = spectrum.power.iter().sum::<f32>() / spectrum.power.len() as f32;
                assert!((mean - 1.0).abs() < 0.15, "{} {mean}", class.class);
                for ring in &spectrum.radial[2..6] {
                    assert!((ring.power - 1.0).abs() < 0.5, "{} {ring:?}", class.class);
                }
            }
        }
        // Every frame the same: all power of the XT slices is in the row of frequency 0.
        let frame = white.samples()[..white.samples().len() / 8].to_vec();
        let still = Tile::new(shape, frame.repeat(8)).unwrap();
        for class in spectra(&still, options).unwrap() {
            let rows: Vec<f32> =
                class.xt.power.chunks(16).map(|row| row.iter().sum::<f32>()).collect();
            for (row, sum) in rows.iter().enumerate() {
                assert_eq!(*sum > 1.0, row == 4, "{} row {row}: {sum}", class.class);
            }
        }
    }

    #[test]
    fn no_integrands_are_refused() {
        let tile = Baseline::White.tile(TileShape::new(4, 4, 1, 1, 1).unwrap(), 1);
        let options = ScoreOptions { set: 0, integrands: 0, ..ScoreOptions::default() };
        assert_eq!(spectra(&tile, options), Err(ScoreError::Integrands(0)));
    }
}
