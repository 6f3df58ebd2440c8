//! Where a step's time goes: marks between its stages, which cost nothing unless someone listens.

use serde::{Deserialize, Serialize};

/// The stages of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Stage {
    /// Making the draws: pixels, thresholds, directions.
    Draws,
    /// Bringing the subset's samples together.
    Gather,
    /// Projecting them onto a direction.
    Project,
    /// Sorting the projections.
    Rank,
    /// Quantiles, and the differences to them.
    Transport,
    /// Adding gradients to the patch.
    Scatter,
    /// Adding up the patches.
    Reduce,
    /// Moving the samples.
    Adam,
    /// Threads without work while others have some.
    Waiting,
}

impl Stage {
    /// All stages in their order.
    pub const ALL: [Self; 9] = [
        Self::Draws,
        Self::Gather,
        Self::Project,
        Self::Rank,
        Self::Transport,
        Self::Scatter,
        Self::Reduce,
        Self::Adam,
        Self::Waiting,
    ];

    /// Its name as people read it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Draws => "draws",
            Self::Gather => "gather",
            Self::Project => "project",
            Self::Rank => "rank",
            Self::Transport => "transport",
            Self::Scatter => "scatter",
            Self::Reduce => "reduce",
            Self::Adam => "adam",
            Self::Waiting => "waiting",
        }
    }
}

/// Listens to the stages of one thread.
pub trait Probe: Send {
    /// Work begins; what went before is nobody's.
    fn begin(&mut self);

    /// All since the last mark was this stage.
    fn lap(&mut self, stage: Stage);
}

/// Listens to nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unprobed;

impl Probe for Unprobed {
    #[inline(always)]
    fn begin(&mut self) {}

    #[inline(always)]
    fn lap(&mut self, _: Stage) {}
}
