//! How a run ended, and what came of it.

use serde::{Deserialize, Serialize};

/// The parts of a run, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Making the start, and all tables.
    Start,
    /// Stochastic gradient descent.
    Descent,
    /// Full-batch descent.
    Polish,
    /// The uniformity step.
    Warp,
}

impl Phase {
    /// Its name as people read it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Descent => "descent",
            Self::Polish => "polish",
            Self::Warp => "warp",
        }
    }
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// All steps were done.
    Completed,
    /// The number of steps to stop after was reached.
    StopAfter,
    /// A signal or an observer asked for it.
    Interrupted,
    /// The time was up.
    Time,
}

/// How a run ended, and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Why it ended.
    pub reason: StopReason,
    /// Steps done, of descent and polish together; stopping after as many makes the same tile.
    pub steps: u32,
    /// Mean W₂² of the draws' projections over the first [`Self::WINDOW`] steps of the descent,
    /// in units of the squared side of the cube; none if it did no step.
    pub objective_before: Option<f64>,
    /// The same over the last steps.
    pub objective_after: Option<f64>,
    /// The same of single steps of the descent, four for each doubling of their number: the step,
    /// counted from one, and what its draws found before it moved the samples. Provenance has it in
    /// a field of its own.
    #[serde(skip)]
    pub convergence: Vec<(u32, f64)>,
    /// Wall-clock seconds of every phase that took place.
    pub seconds: Vec<(Phase, f64)>,
}

impl Summary {
    /// Steps that the objective is averaged over.
    pub const WINDOW: usize = 32;
}
