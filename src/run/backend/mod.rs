//! What threads, worker processes and ranks do differently; all else of a run is the
//! [`driver`](crate::run::driver)'s.
//!
//! - [`threads`]: this process does every step, and is looked at before each.
//! - [`workers`]: processes do the steps by themselves; this one only looks at them, and asks them
//!   to stand still for a checkpoint.
//! - [`ranks`]: each does every step with its region, and all agree every so often on what is to
//!   happen.

use std::sync::Arc;

use perceptile_cluster::Worker;

use crate::format::numbers::ArraySource;
use crate::run::error::RunError;
use crate::run::plan::Position;
use crate::run::summary::ParallelSummary;
use crate::run::watch::{Decision, Watch};
use crate::solver::{Record, Storage};

pub mod ranks;
pub mod threads;
#[cfg(unix)]
pub mod workers;

/// Who does the steps of a run. Its state is that of the whole tile, while it stands still.
pub(super) trait Backend: ArraySource {
    /// Whose board says how the run goes, and what the draws of this rank found.
    fn shared(&self) -> (&Arc<Worker>, &Arc<Record>);

    /// Where the run stands; `None` when all steps are over.
    fn position(&self) -> Option<Position>;

    /// Worker processes, and those that were replaced so far, if there are any.
    fn workers(&self) -> Option<(usize, usize)> {
        None
    }

    /// What is to happen on all ranks, if each has decided for itself.
    fn agree(&mut self, _at: Position, decision: Decision, _watch: &Watch<'_>) -> Decision {
        decision
    }

    /// Carries a decision out. Returns where the run stands still for a checkpoint, once it does.
    fn obey(&mut self, at: Position, decision: Decision) -> Option<Position>;

    /// Goes on after a checkpoint.
    fn release(&mut self) {}

    /// Goes on until there is something to look at.
    ///
    /// # Errors
    /// If the run is lost.
    fn advance(&mut self, watch: &mut Watch<'_>) -> Result<(), RunError>;

    /// Makes the tile uniform, when all steps are over. Gives the storage that it lies in, and what
    /// those who did the steps did.
    fn finish(self) -> (Storage, ParallelSummary);
}
