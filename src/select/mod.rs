//! A posteriori: chooses, for each pixel and frame of an animation, among candidates that were
//! rendered, so that the error that is left is where the eye and the renderer's temporal filter do
//! not see it (the paper's Eq. 4 with Eq. 3, solved on the pictures themselves; its Figure 5).
//!
//! ```text
//!            plan (what, how, by whom)
//!              │
//!  frames ──► selection ─────────────────────────► picture, scores, state
//!  renders,    │   (the owner; workers, ranks follow)
//!  guide      engine: schedule of waves ──► borders between ranks
//!              │
//!             window: rings of frames ──► visit: footprint, mixture
//!             residual, weights, ...
//! ```
//!
//! The perceived error is r = g_s * g_t * (g_a * R − I): the renderer's temporal filter g_a works on
//! the render R alone, the eye's g_s and g_t on both ([`Filters`]). A sweep visits every pixel and
//! takes the candidate with the least objective Σ w²(r² + λe²), where e = R − I and
//! 1/w² = (g_s * g_t * I)² + 0.01, so that with λ = 0 it is the pRelMSE that the paper measures.
//! λ falls from sweep to sweep ([`Continuation`]). Until its first visit a pixel is the reference, without
//! error, so that it then takes on what those before it have left. From the closest candidates, changes of
//! single pixels end with more error, above all where all that is closest lies on one side of the reference.
//!
//! Animations stream. Sweep k + 1 follows sweep k through the frames at a distance, so that all
//! sweeps go on at once at different frames of a window, in *waves*: in wave n, sweep k visits frame
//! n − k·[`LAG`]. What lies behind the last sweep is done. Nothing that is chosen depends on threads,
//! workers or ranks, or on how much is read ahead.
//!
//! Borders: beyond a picture's sides nothing is seen, before the first frame and behind the last one
//! the reference stands still, and there is no error.

mod borders;
mod engine;
mod faults;
mod filter;
mod footprint;
mod mixture;
mod options;
mod plan;
mod schedule;
mod score;
mod selection;
mod sources;
mod state;
mod strips;
#[cfg(test)]
mod tests;
mod visit;
mod window;
#[cfg(unix)]
pub mod workers;

use std::collections::BTreeMap;

use glam::IVec3;
use perceptile_cluster::shared::MapError;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::kernel::{KernelTaps, Tap};

pub use mixture::{MAX_CANDIDATES, MAX_SUBSET_RENDERS};
pub use options::{Continuation, Norm, SelectOptions};
pub use plan::{Candidates, SelectParallelism, SelectPlan};
pub use schedule::{LAG, RENEWAL};
pub use score::{MethodScores, SelectScores};
pub use selection::{Frame, Selection};
pub use state::SelectState;

/// Why nothing can be selected.
#[derive(Debug, Error)]
pub enum SelectError {
    /// A number of sweeps.
    #[error("there are {sweeps} sweeps, but there must be 1 to {}", SelectOptions::MAX_SWEEPS)]
    Sweeps {
        /// How many.
        sweeps: u32,
    },
    /// λ.
    #[error(
        "the continuation is {from}..{to}, but it must fall, from at most {} to at least 0",
        SelectOptions::MAX_LAMBDA
    )]
    Continuation {
        /// λ of the first sweep.
        from: f64,
        /// λ of the last sweep.
        to: f64,
    },
    /// Renders to choose among.
    #[error("there are {renders} candidates, but there must be 1 to {most}{}", if *subsets { " for their subsets" } else { "" })]
    Renders {
        /// How many.
        renders: usize,
        /// Most of them.
        most: usize,
        /// Whether their subsets are candidates.
        subsets: bool,
    },
    /// Sides, frames or channels of an animation.
    #[error(
        "the animation has {width} × {height} pixels, {frames} frames and {channels} channels, but each must be at least 1, channels 1 or 3, and pixels at most 2^30"
    )]
    Shape {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Frames.
        frames: usize,
        /// Channels.
        channels: usize,
    },
    /// A kernel that is no eye's.
    #[error("the kernel has too many weights to filter whole pictures")]
    Kernel,
    /// A state to go on from.
    #[error("the state is that of another selection")]
    State,
    /// The renderer's filter.
    #[error("the weight of the newest frame is {alpha}, but it must be above 0 and at most 1")]
    Alpha {
        /// The weight.
        alpha: f64,
    },
    /// Too small a picture.
    #[error("{ranks} ranks are too many: a picture of {height} rows has {strips} strips")]
    Ranks {
        /// Ranks.
        ranks: usize,
        /// What a picture is cut into.
        strips: usize,
        /// Rows of a picture.
        height: usize,
    },
    /// There is not enough memory.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// Another rank failed, which says how.
    #[error("another rank failed")]
    Elsewhere,
}

/// The size of an animation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct AnimationShape {
    width: usize,
    height: usize,
    frames: usize,
    channels: usize,
}

impl AnimationShape {
    /// Most pixels of a frame.
    pub const MAX_PIXELS: usize = 1 << 30;

    /// An animation of so many pixels, frames and channels.
    ///
    /// # Errors
    /// Nothing along one axis, channels that are neither 1 nor 3, or more than 2^30 pixels.
    pub fn new(
        width: usize,
        height: usize,
        frames: usize,
        channels: usize,
    ) -> Result<Self, SelectError> {
        let pixels = width.saturating_mul(height);
        let fits = (1..=Self::MAX_PIXELS).contains(&pixels) && frames > 0;
        if !fits || !matches!(channels, 1 | 3) {
            return Err(SelectError::Shape { width, height, frames, channels });
        }
        Ok(Self { width, height, frames, channels })
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Channels: 1 or 3.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Pixels of a frame.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Numbers of a frame.
    pub fn values(&self) -> usize {
        self.pixels() * self.channels
    }
}

/// The filters of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Filters {
    /// The eye's, g_s * g_t: what the reference is seen through.
    pub eye: KernelTaps,
    /// The eye's and the renderer's, g_s * g_t * g_a: what renders are seen through; none without
    /// temporal anti-aliasing.
    pub taa: Option<KernelTaps>,
}

impl Filters {
    /// What part of Σ|g| in time is kept of the eye's filter behind the renderer's, which has no end.
    const KEPT: f64 = 0.97;

    /// The eye's filter, and behind temporal anti-aliasing if the weight of its newest frame is given.
    /// The two together are cut to the newest frames that hold 97 % of Σ|g|, but have at least those
    /// of the eye's.
    ///
    /// # Errors
    /// A weight that is not above 0 and at most 1.
    pub fn new(eye: KernelTaps, alpha: Option<f64>) -> Result<Self, SelectError> {
        let Some(alpha) = alpha else { return Ok(Self { eye, taa: None }) };
        if !(alpha > 0.0 && alpha <= 1.0) {
            return Err(SelectError::Alpha { alpha });
        }
        // So long that what is left out is not noticed.
        const NEGLIGIBLE: f64 = 1e-4;
        const LONGEST: f64 = 4096.0;
        let tail = if alpha < 1.0 { libm::log(NEGLIGIBLE) / libm::log1p(-alpha) } else { 0.0 };
        let tail = tail.min(LONGEST) as i32;
        let mut weights = BTreeMap::new();
        for tap in eye.taps() {
            let mut share = alpha;
            for age in 0..=tail {
                let [x, y, t] = tap.offset.to_array();
                *weights.entry((t - age, y, x)).or_insert(0.0) += tap.weight * share;
                share *= 1.0 - alpha;
            }
        }
        let mut of_frames = BTreeMap::new();
        for (&(t, ..), weight) in &weights {
            *of_frames.entry(t).or_insert(0.0) += f64::abs(*weight);
        }
        let all: f64 = of_frames.values().sum();
        let mut held = 0.0;
        let oldest = of_frames.iter().rev().find(|(_, weight)| {
            held += **weight;
            held >= Self::KEPT * all
        });
        let oldest = oldest.map_or(i32::MIN, |(&t, _)| t).min(eye.bounds().0.z);
        let tap = |((z, y, x), weight)| Tap { offset: IVec3::new(x, y, z), weight };
        let taps = weights.into_iter().filter(|((t, ..), _)| *t >= oldest).map(tap);
        let taa = KernelTaps::new(taps).map_err(|_| SelectError::Kernel)?;
        Ok(Self { eye, taa: Some(taa) })
    }

    /// What renders are seen through.
    pub fn render(&self) -> &KernelTaps {
        self.taa.as_ref().unwrap_or(&self.eye)
    }
}

/// What a kernel's weights are divided by so that a constant picture stays what it is. A kernel that
/// hardly sees one keeps its scale.
fn scale(kernel: &KernelTaps) -> f64 {
    const LEAST: f64 = 0.1;
    if kernel.sum() > LEAST { 1.0 / kernel.sum() } else { 1.0 }
}
