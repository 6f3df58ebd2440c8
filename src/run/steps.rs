//! The steps of a plan, one at a time, as one worker does them with all others.
//!
//! Whoever calls [`Steps::advance`] decides what happens between two steps. Rounds that are over
//! pass by, so that a worker that replaces a lost one catches up by itself.

use std::mem;
use std::sync::Arc;

use perceptile_cluster::{Ends, Worker};

use crate::format::numbers::ArraySource;
use crate::gradient::probe::Unprobed;
use crate::gradient::simd::Simd;
use crate::run::plan::{Plan, Position};
use crate::solver::polish::Polish;
use crate::solver::{Descent, OptionsError, Phase, Record, Storage, rounds, warp};
use crate::tile::Regions;

/// The steps of a plan, from the samples and the moments of a region that lie in its storage.
pub struct Steps<'a> {
    plan: &'a Plan,
    /// Who does the steps.
    pub(super) worker: Arc<Worker>,
    /// What the draws of this rank found.
    pub(super) record: Arc<Record>,
    regions: Regions,
    simd: Simd,
    at: Position,
    stage: Stage,
}

/// The phase that is under way.
enum Stage {
    Descent(Box<Descent>),
    Polish(Box<Polish>),
    /// All steps are over.
    Over(Storage),
    /// Only while one phase hands its storage to the next.
    Between,
}

impl<'a> Steps<'a> {
    /// Before the first step of the plan.
    ///
    /// # Errors
    /// If a step would be too coarse.
    pub fn new(
        plan: &'a Plan,
        worker: Arc<Worker>,
        storage: Storage,
        simd: Simd,
    ) -> Result<Self, OptionsError> {
        let regions = plan.regions(worker.communicator().rank());
        let (record, at) = (Arc::clone(&storage.record), Position::START);
        let mut steps = Self { plan, worker, record, regions, simd, at, stage: Stage::Between };
        steps.start(Phase::Descent, storage)?;
        Ok(steps)
    }

    /// Where the run stands: before a step, or after the last one of a phase. `None` when all steps
    /// are over.
    pub fn position(&self) -> Option<Position> {
        (!matches!(self.stage, Stage::Over(_))).then_some(self.at)
    }

    /// The state before the next step.
    ///
    /// # Panics
    /// If all steps are over.
    pub fn state(&self) -> &dyn ArraySource {
        match &self.stage {
            Stage::Descent(descent) => &**descent,
            Stage::Polish(polish) => &**polish,
            Stage::Over(_) | Stage::Between => panic!("a state of no phase"),
        }
    }

    /// Does the next step; after the last one of a phase, or if the run was stopped, goes on to the
    /// next phase.
    ///
    /// # Errors
    /// If a step would be too coarse.
    ///
    /// # Panics
    /// If all steps are over.
    pub fn advance(&mut self) -> Result<(), OptionsError> {
        let Self { plan, worker, at, stage, .. } = self;
        if at.step < plan.steps_of(at.phase) && plan.goes_on(worker, *at) {
            match stage {
                Stage::Descent(descent) => {
                    descent.step(at.step);
                }
                Stage::Polish(polish) => polish.step(at.step),
                Stage::Over(_) | Stage::Between => panic!("a step of no phase"),
            }
            at.step += 1;
            return Ok(());
        }
        match mem::replace(stage, Stage::Between) {
            Stage::Descent(descent) => self.start(Phase::Polish, descent.leave()),
            Stage::Polish(polish) => self.start(Phase::Warp, polish.leave()),
            Stage::Over(_) | Stage::Between => panic!("all steps are over"),
        }
    }

    /// Makes the tile uniform, when all steps are over. Returns the storage in which the region
    /// lies ([`Storage::into_tile`]).
    ///
    /// # Panics
    /// If a step is still to be done.
    pub fn finish(self) -> Storage {
        let Self { plan, worker, regions, simd, stage, .. } = self;
        let Stage::Over(storage) = stage else { panic!("a step is still to be done") };
        let shape = regions.own().shape();
        let options = &plan.options;
        let layers = plan.kernel.layers(shape.spp());
        let what = (shape, layers.as_slice(), options.domain);
        let storage = warp::warp(&worker, storage, what, options.warp, options.seed, simd);
        // A round without jobs says that all is over, warped or not.
        worker.round(plan.last_round(), Ends::Half, 0..0, (), |_, ()| ());
        storage
    }

    /// Starts a phase, or the next one that has something to do.
    fn start(&mut self, phase: Phase, storage: Storage) -> Result<(), OptionsError> {
        let Self { plan, worker, regions, simd, .. } = self;
        let from = plan.from;
        let step = if from.phase == phase { from.step } else { 0 };
        self.at = Position { phase, step };
        let is_over = worker.board().completed() >= rounds::leave(phase);
        let is_due = plan.steps_of(phase) > 0 && from.phase <= phase && !is_over;
        let how = (*simd, step);
        match phase {
            Phase::Descent if is_due => {
                let what = (plan.gradient(*simd)?, &*regions);
                let (adam, steps) = (plan.options.adam, plan.options.steps);
                let descent =
                    Descent::enter(worker.clone(), storage, what, adam, steps, how, || Unprobed);
                self.stage = Stage::Descent(Box::new(descent));
            }
            Phase::Start | Phase::Descent => return self.start(Phase::Polish, storage),
            Phase::Polish if is_due && plan.goes_on(worker, self.at) => {
                let (kernel, options) = (plan.seen(), plan.options.polish);
                let classes = kernel.classes();
                let place = (&*regions, plan.options.domain);
                let polish = Polish::enter(worker.clone(), storage, place, classes, options, how);
                self.stage = Stage::Polish(Box::new(polish));
            }
            Phase::Polish => return self.start(Phase::Warp, storage),
            Phase::Warp => self.stage = Stage::Over(storage),
        }
        Ok(())
    }
}
