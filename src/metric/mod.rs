//! What makes a tile good, in numbers.
//!
//! `integrand` draws the functions on which tiles are tried, `exact` knows their integrals;
//! `perceived` measures the error that the eye sees through a kernel, `uniformity` how evenly the
//! whole tile covers the cube. Lower is better throughout, and white noise stands at 1.

mod exact;
mod fourier;
mod integrand;
mod perceived;
mod scores;
mod stream;
mod uniformity;

pub use integrand::{Class, Domain, Integrand, IntegrandSet, LEAST_VARIANCE, integrand_sets};
pub use perceived::Perceived;
pub use scores::{ClassScore, Ratio, ScoreError, ScoreOptions, Scorer, Scores};
pub use uniformity::{Histogram, histogram, residual};
