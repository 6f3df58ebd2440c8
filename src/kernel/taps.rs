//! A kernel as the optimizer and the scores use it: offsets with weights.

use glam::IVec3;
use thiserror::Error;

/// Why a list of taps is not a kernel.
#[derive(Debug, Error, Clone, Copy, PartialEq)]
pub enum TapsError {
    /// There is no tap with a weight other than zero.
    #[error("the kernel has no tap with a weight other than 0")]
    Empty,
    /// A weight is not a finite number.
    #[error("the weight of tap ({}, {}, {}) is {weight}, but weights must be finite", offset.x, offset.y, offset.z)]
    Weight {
        /// Where the tap is.
        offset: IVec3,
        /// Its weight.
        weight: f64,
    },
    /// Two taps have one offset.
    #[error("the kernel has two taps at ({}, {}, {})", offset.x, offset.y, offset.z)]
    Twice {
        /// The offset that they share.
        offset: IVec3,
    },
}

/// One offset of a kernel with its weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tap {
    /// `(dx, dy, dt)` in pixels and frames, from the pixel that is filtered to the one that is
    /// weighted; a frame in the past has a negative `dt`.
    pub offset: IVec3,
    /// Weight of the pixel at that offset; either sign, never 0.
    pub weight: f64,
}

/// The taps of one kernel, sorted by falling magnitude of weight (ties by `dt`, `dy`, `dx`),
/// scaled to Σ|g| = 1. The perceived error at pixel p is Σ weight · error(p + offset).
#[derive(Debug, Clone, PartialEq)]
pub struct KernelTaps {
    taps: Vec<Tap>,
}

impl KernelTaps {
    /// Sorts and scales `taps`; those of weight 0 are left out.
    ///
    /// # Errors
    /// A weight that is not finite, two taps at one offset, or nothing left.
    pub fn new(taps: impl IntoIterator<Item = Tap>) -> Result<Self, TapsError> {
        let mut taps: Vec<Tap> = taps.into_iter().filter(|tap| tap.weight != 0.0).collect();
        if let Some(&Tap { offset, weight }) = taps.iter().find(|tap| !tap.weight.is_finite()) {
            return Err(TapsError::Weight { offset, weight });
        }
        let place = |tap: &Tap| (tap.offset.z, tap.offset.y, tap.offset.x);
        taps.sort_by_key(place);
        if let Some(pair) = taps.windows(2).find(|pair| pair[0].offset == pair[1].offset) {
            return Err(TapsError::Twice { offset: pair[0].offset });
        }
        let mass: f64 = taps.iter().map(|tap| tap.weight.abs()).sum();
        if taps.is_empty() || !(mass > 0.0 && mass.is_finite()) {
            return Err(TapsError::Empty);
        }
        for tap in &mut taps {
            tap.weight /= mass;
        }
        taps.sort_by(|a, b| {
            b.weight.abs().total_cmp(&a.weight.abs()).then(place(a).cmp(&place(b)))
        });
        Ok(Self { taps })
    }

    /// All taps by falling magnitude of weight.
    pub fn taps(&self) -> &[Tap] {
        &self.taps
    }

    /// The smallest box around all offsets: lowest and highest `(dx, dy, dt)`, both included.
    pub fn bounds(&self) -> (IVec3, IVec3) {
        self.taps.iter().fold((IVec3::MAX, IVec3::MIN), |(low, high), tap| {
            (low.min(tap.offset), high.max(tap.offset))
        })
    }
}
