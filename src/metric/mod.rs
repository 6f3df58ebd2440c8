//! What makes a tile good, in numbers.
//!
//! `integrand` draws the functions on which tiles are tried, `exact` knows their integrals;
//! `perceived` measures the error that the eye sees through a kernel (with `fourier`),
//! `accumulation` what is left of it when frames are averaged, `uniformity` how evenly the whole
//! tile covers the cube; `scores` puts them together, and `scored_tile` those of a tile under
//! its name.
//! `spectrum` shows where the error's power is, `baseline` makes tiles to compare with, and
//! `quantization` what integer textures make of a tile; `figure` writes a score for people. Lower
//! is better throughout, and white noise stands at 1.

mod accumulation;
mod baseline;
mod error;
mod exact;
mod figure;
mod fourier;
mod integrand;
mod perceived;
mod quantization;
mod scored_tile;
mod scores;
mod spectrum;
mod split_mix;
mod uniformity;

pub use accumulation::accumulated_mean_square;
pub use baseline::{Baseline, UnknownBaseline};
pub use error::ScoreError;
pub use figure::{digits, figure, ratio};
pub use integrand::{Class, Coordinates, Integrand, IntegrandSet, LEAST_VARIANCE, integrand_sets};
pub use perceived::{MeanSquares, Perceived, PerceivedWorkspace};
pub use quantization::quantized;
pub use scored_tile::{ScoredTile, ShownScore};
pub use scores::{ClassScore, Ratio, ScoreOptions, Scorer, Scores};
pub use spectrum::{ClassSpectra, Ring, Spectrum, spectra};
pub use uniformity::{Histogram, PairHistogram, histogram, marginals, pair_histograms, residual};
