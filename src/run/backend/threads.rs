//! A run by the threads of this process.

use std::io;
use std::sync::Arc;

use perceptile_cluster::Worker;

use super::Backend;
use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::Simd;
use crate::run::error::RunError;
use crate::run::plan::{Plan, Position};
use crate::run::start::InitialState;
use crate::run::steps::Steps;
use crate::run::summary::ParallelSummary;
use crate::run::watch::{Decision, Watch};
use crate::solver::{Record, Storage};
use crate::tile::Region;

/// The threads of the current pool.
pub struct Threads<'a>(Steps<'a>);

impl<'a> Threads<'a> {
    /// Gets a run ready for its first step.
    ///
    /// # Errors
    /// If there is too little memory, or a checkpoint cannot be read again.
    pub fn start(plan: &'a Plan, start: InitialState, simd: Simd) -> Result<Self, RunError> {
        let memory = plan.storage(Region::whole(plan.options.shape)).private()?;
        Self::on(memory, plan, start, simd)
    }

    /// The same on memory for this rank's region.
    pub(super) fn on(
        (worker, mut storage): (Arc<Worker>, Storage),
        plan: &'a Plan,
        start: InitialState,
        simd: Simd,
    ) -> Result<Self, RunError> {
        start.put(plan, &worker, &mut storage)?;
        Ok(Self(Steps::new(plan, worker, storage, simd)?))
    }
}

impl ArraySource for Threads<'_> {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self.0.state().array(index, sink)
    }
}

impl Backend for Threads<'_> {
    fn shared(&self) -> (&Arc<Worker>, &Arc<Record>) {
        (&self.0.worker, &self.0.record)
    }

    fn position(&self) -> Option<Position> {
        self.0.position()
    }

    fn obey(&mut self, at: Position, decision: Decision) -> Option<Position> {
        if decision.stop.is_some() {
            self.0.worker.board().stop_here();
        }
        decision.checkpoint.then_some(at)
    }

    fn advance(&mut self, _: &mut Watch<'_>) -> Result<(), RunError> {
        Ok(self.0.advance()?)
    }

    fn finish(self) -> (Storage, ParallelSummary) {
        (self.0.finish(), ParallelSummary::Threads)
    }
}
