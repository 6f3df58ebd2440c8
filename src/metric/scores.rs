//! One tile, one kernel, one set of integrands: all scores in one pass.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::integrand::{Class, Domain, Integrand, IntegrandSet, integrand_sets};
use super::perceived::Perceived;
use super::uniformity::{Histogram, histogram, residual};
use crate::kernel::KernelTaps;
use crate::tile::{Tile, TileShape};

/// Most integrands of a class.
const MOST_INTEGRANDS: usize = 1 << 16;

/// Why a tile cannot be scored.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum ScoreError {
    /// The kernel is wider than the tile.
    #[error(
        "the kernel spans {extent} in {axis}, but the tile only {size}: it must not be wider than the tile"
    )]
    Kernel {
        /// `x`, `y` or `t`.
        axis: &'static str,
        /// From the kernel's first tap to its last, both included.
        extent: i64,
        /// The tile's size.
        size: usize,
    },
    /// The number of integrands is out of range.
    #[error("{0} integrands of each class were asked for, but 1 to 65536 are possible")]
    Integrands(usize),
    /// The tile has another shape than the scorer was made for.
    #[error("a tile of {found} was given to the scorer of {expected}")]
    Shape {
        /// The scorer's.
        expected: TileShape,
        /// The tile's.
        found: TileShape,
    },
}

/// Which integrands a tile is scored on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ScoreOptions {
    /// Number of the set of integrands; default 0. Compare tiles only on the same set.
    pub set: u64,
    /// Integrands of each class, 1–65536; default 256. Fewer are quicker and less certain.
    pub integrands: usize,
}

impl Default for ScoreOptions {
    fn default() -> Self {
        Self { set: 0, integrands: 256 }
    }
}

/// A mean square relative to white noise's, over the integrands of a class: 1 is white noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// Mean over the integrands.
    pub mean: f64,
    /// Standard error of that mean: the standard deviation over the integrands / √count. It says
    /// how much the score would move on another set; tiles on one set move together.
    pub standard_error: f64,
}

impl Ratio {
    fn of(ratios: impl ExactSizeIterator<Item = f64> + Clone) -> Self {
        let n = ratios.len() as f64;
        let mean = ratios.clone().sum::<f64>() / n;
        let square: f64 = ratios.map(|ratio| (ratio - mean) * (ratio - mean)).sum();
        Self { mean, standard_error: (square / (n - 1.0).max(1.0) / n).sqrt() }
    }
}

/// The scores of one class of integrands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClassScore {
    /// The class.
    pub class: Class,
    /// Which coordinates its integrands read.
    pub domain: Domain,
    /// The perceived-error ratio: mean over pixels of (g*e)² / (Var f · Σg² / spp).
    pub perceived: Ratio,
    /// Bias·√N: rms over the integrands of (mean over the tile of e)/σ, times the root of the
    /// number of samples in the tile. White noise has 1, in expectation.
    pub bias: f64,
}

/// Everything that is measured of a tile. Lower is better, white noise has 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// The integrands that were used.
    pub options: ScoreOptions,
    /// One score per domain and class.
    pub classes: Vec<ClassScore>,
    /// Bias·√N over all classes together.
    pub bias: f64,
    /// How the whole tile fills the 16×16 cells of each pair of dimensions.
    pub histogram: Histogram,
    /// Rms over pixels and dimensions of (mean over all frames − ½), relative to independent
    /// samples'.
    pub residual: f64,
}

impl Scores {
    /// Scores a tile; for several of one shape, keep a [`Scorer`].
    ///
    /// # Errors
    /// A kernel wider than the tile, or a number of integrands out of range.
    pub fn of(tile: &Tile, kernel: &KernelTaps, options: ScoreOptions) -> Result<Self, ScoreError> {
        Scorer::new(tile.shape(), kernel, options)?.score(tile)
    }

    /// The score of one class, if the tile has that domain.
    pub fn class(&self, class: Class, domain: Domain) -> Option<&ClassScore> {
        self.classes.iter().find(|score| score.class == class && score.domain == domain)
    }
}

/// What scoring tiles of one shape with one kernel needs: integrands, and the kernel's spectrum.
pub struct Scorer {
    options: ScoreOptions,
    perceived: Perceived,
    sets: Vec<IntegrandSet>,
}

/// What is measured with one integrand.
struct Measured {
    perceived: f64,
    /// Squared bias relative to white noise's.
    bias: f64,
}

impl Scorer {
    /// Prepares integrands and kernel for tiles of a shape.
    ///
    /// # Errors
    /// A kernel wider than the tile, or a number of integrands out of range.
    pub fn new(
        shape: TileShape,
        kernel: &KernelTaps,
        options: ScoreOptions,
    ) -> Result<Self, ScoreError> {
        if !(1..=MOST_INTEGRANDS).contains(&options.integrands) {
            return Err(ScoreError::Integrands(options.integrands));
        }
        let perceived = Perceived::new(shape, kernel)?;
        let sets = integrand_sets(options.set, shape.dims(), options.integrands);
        Ok(Self { options, perceived, sets })
    }

    /// Scores a tile. The result does not depend on the number of threads; between machines the
    /// last digits may differ, as the Fourier transform uses what the processor offers.
    ///
    /// # Errors
    /// A tile of another shape than the scorer's.
    pub fn score(&self, tile: &Tile) -> Result<Scores, ScoreError> {
        let (expected, found) = (self.perceived.shape(), tile.shape());
        if expected != found {
            return Err(ScoreError::Shape { expected, found });
        }
        let mut biases = 0.0;
        let mut classes = Vec::with_capacity(self.sets.len());
        for set in &self.sets {
            let measured = self.measure(tile, &set.integrands);
            let bias = Ratio::of(measured.iter().map(|m| m.bias)).mean;
            biases += bias;
            classes.push(ClassScore {
                class: set.class,
                domain: set.domain,
                perceived: Ratio::of(measured.iter().map(|m| m.perceived)),
                bias: bias.sqrt(),
            });
        }
        let residuals = residual(tile);
        let square: f64 = residuals.iter().map(|r| r * r).sum();
        Ok(Scores {
            options: self.options,
            bias: (biases / classes.len() as f64).sqrt(),
            classes,
            histogram: histogram(tile),
            residual: (square / residuals.len() as f64).sqrt(),
        })
    }

    fn measure(&self, tile: &Tile, integrands: &[Integrand]) -> Vec<Measured> {
        let shape = tile.shape();
        integrands
            .par_iter()
            .map_init(
                || (vec![0.0_f32; shape.pixels()], self.perceived.workspace()),
                |(errors, workspace), f| {
                    let bias = f.errors(tile, errors);
                    let squares = self.perceived.mean_squares(errors, workspace);
                    let white = f.variance() / shape.spp() as f64;
                    Measured {
                        perceived: squares.perceived / (white * self.perceived.squares()),
                        bias: bias * bias / f.variance() * shape.samples() as f64,
                    }
                },
            )
            .collect()
    }
}
