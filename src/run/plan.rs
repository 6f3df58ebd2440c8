//! The plan of a run: what to make, by how many ranks, workers and threads, and from which step on.
//!
//! Threads of one process, worker processes, one that replaces a lost worker, and ranks all follow
//! the same plan.

use perceptile_cluster::Worker;
use serde::{Deserialize, Serialize};

use crate::draw::{Draws, LevelSets};
use crate::gradient::simd::Simd;
use crate::gradient::{Gradient, Quantum};
use crate::kernel::Kernel;
use crate::solver::{
    Options, OptionsError, Parallelism, Phase, StopReason, StoragePlan, polish, rounds,
};
use crate::tile::{Partition, Reach, Region, Regions};

/// What every rank and every worker of a run has to know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What to make.
    pub options: Options,
    /// The kernel of the options, resolved for their shape.
    pub kernel: Kernel,
    /// How many ranks, workers and threads make it.
    pub parallelism: Parallelism,
    /// Where to start.
    pub from: Position,
}

/// Where a run stands: before a step of a phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Position {
    /// The phase.
    pub phase: Phase,
    /// Steps of the phase that are done.
    pub step: u32,
}

impl Position {
    /// Before the first step of a run.
    pub const START: Self = Self { phase: Phase::Descent, step: 0 };
}

impl Plan {
    /// The plan of a run from its start.
    ///
    /// # Errors
    /// Options outside their ranges, or a kernel that does not suit them.
    pub fn new(options: &Options, parallelism: Parallelism) -> Result<Self, OptionsError> {
        options.validate()?;
        let kernel = options.kernel.resolve(options.shape)?;
        Self { options: options.clone(), kernel, parallelism, from: Position::START }.checked()
    }

    /// The plan, if it can be followed. One that comes from a file may be anything.
    ///
    /// # Errors
    /// Options outside their ranges, or a kernel that does not suit them.
    pub fn checked(self) -> Result<Self, OptionsError> {
        let Self { options, kernel, .. } = &self;
        options.validate()?;
        kernel.check(options.shape)?;
        options.check_kernel(&kernel.folded(options.shape.frames())?)?;
        self.partition().regions(self.parallelism.ranks, 0)?;
        Ok(self)
    }

    /// Checks that a step is not too coarse. This looks at every cell, so it is for tiles that
    /// memory can hold.
    ///
    /// # Errors
    /// Too many draws for one step.
    pub fn check_batch(&self) -> Result<(), OptionsError> {
        self.draws().map(drop)
    }

    /// The cells that draws are made for.
    pub fn partition(&self) -> Partition {
        Partition::new(self.options.shape, self.levels().reach())
    }

    /// The regions of the ranks, as one of them sees them.
    ///
    /// # Panics
    /// If there are not so many, or more than cells, which [`Self::checked`] finds.
    pub fn regions(&self, rank: usize) -> Regions {
        let regions = self.partition().regions(self.parallelism.ranks, rank);
        regions.expect("a plan that was checked")
    }

    /// How far samples see each other in the polish.
    pub fn sight(&self) -> Reach {
        polish::sight(self.seen().classes(), self.options.shape)
    }

    /// The memory that the workers of a rank share, for its region.
    pub fn storage(&self, region: Region) -> StoragePlan {
        let layers = self.kernel.layers(self.options.shape.spp()).len();
        let plan = StoragePlan::new(&self.partition(), region, self.parallelism);
        let plan = plan.with_layers(layers);
        let polished = self.options.polish.steps > 0;
        if polished { plan.with_polish(self.levels().reach().doubled()) } else { plan }
    }

    /// The last round of all.
    pub fn last_round(&self) -> u64 {
        rounds::leave(Phase::Warp)
    }

    /// Steps of the phases before a position, and of its own.
    pub fn steps_done(&self, at: Position) -> u32 {
        let Options { steps, polish, .. } = self.options;
        match at.phase {
            Phase::Start => 0,
            Phase::Descent => at.step.min(steps),
            Phase::Polish => steps.saturating_add(at.step.min(polish.steps)),
            Phase::Warp => steps.saturating_add(polish.steps),
        }
    }

    /// Whether there is no step after a position, whatever the board says.
    pub fn is_last(&self, at: Position) -> bool {
        let Options { steps, polish, stop_after, .. } = self.options;
        let all = steps.saturating_add(polish.steps).min(stop_after.unwrap_or(u32::MAX));
        self.steps_done(at) >= all
    }

    /// Steps of a phase; 0 for a phase that has no steps that can be counted.
    pub fn steps_of(&self, phase: Phase) -> u32 {
        match phase {
            Phase::Descent => self.options.steps,
            Phase::Polish => self.options.polish.steps,
            Phase::Start | Phase::Warp => 0,
        }
    }

    /// Whether a step is to be done, as far as a worker knows.
    pub(super) fn goes_on(&self, worker: &Worker, at: Position) -> bool {
        let limit = self.options.stop_after.is_some_and(|limit| self.steps_done(at) >= limit);
        let round = rounds::step(at.phase, at.step, rounds::Part::Early);
        !limit && worker.board().stopped().is_none_or(|stopped| stopped > round)
    }

    /// Steps that were done in the end, and why no more, if somebody asked for less. To be called
    /// when all rounds are over; `reason` is why the board was asked to stop.
    pub fn outcome(&self, worker: &Worker, reason: Option<StopReason>) -> (u32, StopReason) {
        let all = self.options.steps.saturating_add(self.options.polish.steps);
        let limit = self.options.stop_after.unwrap_or(u32::MAX);
        let stopped = worker.board().stopped().and_then(rounds::position);
        let stopped = stopped.map_or(u32::MAX, |(phase, step)| {
            let step = step.max(if phase == self.from.phase { self.from.step } else { 0 });
            self.steps_done(Position { phase, step })
        });
        let done = all.min(limit).min(stopped);
        let why = match reason {
            _ if done == all => StopReason::Completed,
            Some(reason) if done == stopped && stopped < limit => reason,
            _ => StopReason::StopAfter,
        };
        (done, why)
    }

    /// The kernel as the tile sees it, which repeats in time.
    ///
    /// # Panics
    /// If its weights cancel each other, which [`Self::checked`] finds.
    pub(super) fn seen(&self) -> Kernel {
        self.kernel.folded(self.options.shape.frames()).expect("a plan that was checked")
    }

    /// The level sets of all classes of the kernel that the tile sees.
    fn levels(&self) -> LevelSets {
        LevelSets::of(&self.seen(), self.options.shape.spp())
    }

    /// Its draws, and what their gradients are counted in.
    fn draws(&self) -> Result<(Draws, Quantum), OptionsError> {
        let Options { draw, seed, .. } = self.options;
        let draws = Draws::new(draw, seed, self.levels(), self.options.directions());
        let quantum = Quantum::new(&draws, &self.partition())
            .ok_or(OptionsError::Batch { draws: draw.draws, directions: draw.directions })?;
        Ok((draws, quantum))
    }

    /// What its descent goes by.
    ///
    /// # Errors
    /// If a step would be too coarse.
    pub fn gradient(&self, simd: Simd) -> Result<Gradient, OptionsError> {
        let (draws, quantum) = self.draws()?;
        Ok(Gradient::new(draws, self.partition(), quantum, simd))
    }
}
