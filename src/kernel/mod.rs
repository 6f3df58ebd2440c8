//! The filter g through which error is seen: from its description to its taps.
//!
//! `spec` says what the filter is made of (Eq. 5: spatial × temporal perception × accumulation),
//! `taps` is what the optimizer and the scores use: offsets with weights, sorted by falling
//! magnitude, so that the taps above any threshold are a prefix (Eq. 7).

mod taps;

pub use taps::{KernelTaps, Tap, TapsError};
