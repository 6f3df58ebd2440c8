//! A run by the threads of this process.

use std::io;
use std::sync::Arc;

use perceptile_cluster::Worker;

use super::{Backend, Finished};
use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::Simd;
use crate::run::error::RunError;
use crate::run::plan::{Plan, Position};
use crate::run::start::InitialState;
use crate::run::steps::Steps;
use crate::run::summary::ParallelSummary;
use crate::run::watch::{Decision, Watch};
use crate::solver::{Record, Recorded, Storage};
use crate::tile::Regions;

/// The threads of the current pool.
pub struct Threads<'a> {
    pub(super) worker: Arc<Worker>,
    pub(super) record: Arc<Record>,
    pub(super) regions: Regions,
    pub(super) steps: Steps<'a>,
}

impl<'a> Threads<'a> {
    /// Gets a run ready for its first step.
    ///
    /// # Errors
    /// If there is too little memory, or a checkpoint cannot be read again.
    pub fn start(plan: &'a Plan, start: InitialState, simd: Simd) -> Result<Self, RunError> {
        let regions = Regions::whole(plan.options.shape);
        let memory = plan.storage(regions.own()).private()?;
        Self::on(memory, regions, plan, start, simd)
    }

    /// The same on memory for this rank's region.
    pub(super) fn on(
        (worker, mut storage): (Arc<Worker>, Storage),
        regions: Regions,
        plan: &'a Plan,
        start: InitialState,
        simd: Simd,
    ) -> Result<Self, RunError> {
        start.put(plan, &worker, &mut storage)?;
        let record = Arc::clone(&storage.record);
        let steps = Steps::new(plan, Arc::clone(&worker), storage, simd)?;
        Ok(Self { worker, record, regions, steps })
    }
}

impl ArraySource for Threads<'_> {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self.steps.state().array(index, sink)
    }
}

impl Backend for Threads<'_> {
    fn position(&self) -> Option<Position> {
        self.steps.position()
    }

    fn recorded(&self) -> Recorded {
        self.record.read()
    }

    fn obey(&mut self, at: Position, decision: Decision) -> Option<Position> {
        if decision.stop.is_some() {
            self.worker.board().stop_here();
        }
        decision.checkpoint.then_some(at)
    }

    fn advance(&mut self, _: &mut Watch<'_>) -> Result<(), RunError> {
        Ok(self.steps.advance()?)
    }

    fn finish(self) -> Finished {
        let Self { worker, record, regions, steps } = self;
        let section = steps.finish();
        let recorded = record.read();
        Finished { worker, regions, section, recorded, parallel: ParallelSummary::Threads }
    }
}
