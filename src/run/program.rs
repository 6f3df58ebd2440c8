//! What every rank of a run does, from its start, or from where it was, to its tile.
//!
//! The program is the same for threads of one process, for worker processes and for one that is
//! started in the place of another: rounds that are over are passed by. Steps are asked for one
//! at a time ([`Watch`]), which is where a run is looked at, written down and ended.

use std::sync::Arc;

use perceptile_cluster::shared::{MapError, Section};
use perceptile_cluster::{Ends, World};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::draw::{Draws, LevelSets};
use crate::gradient::probe::Unprobed;
use crate::gradient::simd::Simd;
use crate::gradient::{Gradient, Quantum};
use crate::kernel::Kernel;
use crate::run::folder::FolderError;
use crate::solver::polish::{self, Polish};
use crate::solver::{
    Descent, Options, OptionsError, Phase, Snapshot, StopReason, Storage, StoragePlan, Team,
    rounds, warp,
};
use crate::tile::{Partition, Reach, Region, Regions};

/// What every rank of a run has to know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Program {
    /// What to make.
    pub options: Options,
    /// The kernel of the options, resolved for their shape.
    pub kernel: Kernel,
    /// Who makes it.
    pub team: Team,
    /// Where to begin.
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

/// Why a run cannot be carried out.
#[derive(Debug, Error)]
pub enum ProgramError {
    /// The options are wrong.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// There is no memory for it.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// What it was to begin with cannot be read.
    #[error(transparent)]
    Begin(#[from] FolderError),
    /// It went wrong on another rank, which says how.
    #[error("another rank failed")]
    Elsewhere,
    /// Whoever watched gave it up.
    #[error(transparent)]
    Abandoned(#[from] Abandoned),
}

/// Said by someone who watches: the run is to end where it is, without a tile.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("the run was given up")]
pub struct Abandoned;

/// Someone who is asked before each step.
pub trait Watch {
    /// A phase begins.
    fn phase(&mut self, phase: Phase);

    /// A step is about to be done, or a phase is over.
    ///
    /// # Errors
    /// If no more is to be done.
    fn before_step(
        &mut self,
        world: &World,
        at: Position,
        state: &dyn Snapshot,
    ) -> Result<(), Abandoned>;
}

impl Program {
    /// The program of a run from its start.
    ///
    /// # Errors
    /// Options outside their ranges, or a kernel that does not suit them.
    pub fn new(options: &Options, team: Team) -> Result<Self, OptionsError> {
        options.validate()?;
        let kernel = options.kernel.resolve(options.shape)?;
        Self { options: options.clone(), kernel, team, from: Position::START }.checked()
    }

    /// The program, if it can be carried out. One that comes from a file may be anything.
    ///
    /// # Errors
    /// Options outside their ranges, or a kernel that does not suit them.
    pub fn checked(self) -> Result<Self, OptionsError> {
        let Self { options, kernel, .. } = &self;
        options.validate()?;
        options.check_kernel(kernel)?;
        kernel.check(options.shape)?;
        self.partition().regions(self.team.regions, 0)?;
        Ok(self)
    }

    /// Checks that a step is not too coarse. This looks at every cell, so it is for tiles that
    /// memory can hold.
    ///
    /// # Errors
    /// Too many draws for one step.
    pub fn check_batch(&self) -> Result<(), OptionsError> {
        self.quantum(&self.draws()).map(|_| ())
    }

    /// The cells that draws are made for.
    pub fn partition(&self) -> Partition {
        Partition::new(self.options.shape, levels(&self.kernel).reach())
    }

    /// The regions of its teams, as one of them sees them.
    ///
    /// # Panics
    /// If there are not so many, or more than cells, which [`Self::checked`] finds.
    pub fn regions(&self, rank: usize) -> Regions {
        let regions = self.partition().regions(self.team.regions, rank);
        regions.expect("a program that was checked")
    }

    /// How far samples see each other in the polish.
    pub fn sight(&self) -> Reach {
        let classes = self.kernel.classes();
        let classes: Vec<_> = classes.iter().map(|class| (class.weight, &class.taps)).collect();
        polish::sight(&classes, self.options.shape.frames())
    }

    /// The memory that the ranks of a team share, for its region.
    pub fn storage(&self, region: Region) -> StoragePlan {
        let plan = StoragePlan::new(&self.partition(), region, self.team);
        let polished = self.options.polish.steps > 0;
        if polished { plan.with_polish(levels(&self.kernel).reach().doubled()) } else { plan }
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

    /// Whether there is no step after a position, whatever a world says.
    pub fn is_last(&self, at: Position) -> bool {
        let Options { steps, polish, stop_after, .. } = self.options;
        let all = steps.saturating_add(polish.steps).min(stop_after.unwrap_or(u32::MAX));
        self.steps_done(at) >= all
    }

    /// Whether a step is to be done, as far as a world knows.
    fn goes_on(&self, world: &World, at: Position) -> bool {
        let limit = self.options.stop_after.is_some_and(|limit| self.steps_done(at) >= limit);
        let round = rounds::step(at.phase, at.step, rounds::Part::Early);
        !limit && world.board().stopped().is_none_or(|stopped| stopped > round)
    }

    /// Steps that were done in the end, and why no more, if somebody asked for less. To be called
    /// when all rounds are over; `reason` is why the board was asked to stop.
    pub fn outcome(&self, world: &World, reason: Option<StopReason>) -> (u32, StopReason) {
        let all = self.options.steps.saturating_add(self.options.polish.steps);
        let limit = self.options.stop_after.unwrap_or(u32::MAX);
        let stopped = world.board().stopped().and_then(rounds::position);
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

    fn draws(&self) -> Draws {
        let Options { draw, seed, shape, .. } = self.options;
        Draws::new(draw, seed, levels(&self.kernel), shape.dims())
    }

    fn quantum(&self, draws: &Draws) -> Result<Quantum, OptionsError> {
        let Options { draw, .. } = self.options;
        Quantum::new(draws, &self.partition())
            .ok_or(OptionsError::Batch { draws: draw.draws, directions: draw.directions })
    }

    /// What its descent goes by.
    ///
    /// # Errors
    /// If a step would be too coarse.
    pub fn gradient(&self, simd: Simd) -> Result<Gradient, OptionsError> {
        let draws = self.draws();
        let quantum = self.quantum(&draws)?;
        Ok(Gradient::new(draws, self.partition(), quantum, simd))
    }

    /// Carries the run out as a rank of a world, from the samples and moments of its region that
    /// lie in the storage. Returns the section in which the region lies then, in line order.
    ///
    /// # Errors
    /// If a step would be too coarse, or the run is given up.
    pub fn carry_out(
        &self,
        world: &Arc<World>,
        mut storage: Storage,
        simd: Simd,
        watch: &mut dyn Watch,
    ) -> Result<Section, ProgramError> {
        let Options { steps, adam, polish: polish_options, warp, seed, .. } = self.options;
        let regions = self.regions(world.peers().rank());
        let shape = regions.own().shape();
        let is_over = |phase| world.board().completed() >= rounds::leave(phase);
        let first = |phase| if self.from.phase == phase { self.from.step } else { 0 };

        let mut at = Position { phase: Phase::Descent, step: first(Phase::Descent) };
        let due = steps > 0 && self.from.phase <= at.phase;
        if due && !is_over(at.phase) {
            watch.phase(at.phase);
            let gradient = self.gradient(simd)?;
            let how = (simd, at.step);
            let world = Arc::clone(world);
            let what = (gradient, &regions);
            let mut descent =
                Descent::enter(world.clone(), storage, what, adam, steps, how, || Unprobed);
            loop {
                watch.before_step(&world, at, &descent)?;
                if at.step >= steps || !self.goes_on(&world, at) {
                    break;
                }
                descent.step(at.step);
                at.step += 1;
            }
            storage = descent.leave();
        }

        at = Position { phase: Phase::Polish, step: first(Phase::Polish) };
        let due = polish_options.steps > 0 && self.from.phase <= at.phase;
        if due && !is_over(at.phase) && self.goes_on(world, at) {
            watch.phase(at.phase);
            let classes = self.kernel.classes();
            let classes: Vec<_> = classes.iter().map(|class| (class.weight, &class.taps)).collect();
            let how = (simd, at.step);
            let mut polish =
                Polish::enter(world.clone(), storage, &regions, &classes, polish_options, how);
            loop {
                watch.before_step(world, at, &polish)?;
                if at.step >= polish_options.steps || !self.goes_on(world, at) {
                    break;
                }
                polish.step(at.step);
                at.step += 1;
            }
            storage = polish.leave();
        }
        watch.phase(Phase::Warp);
        let storage = warp::warp(world, storage, shape, warp, seed, simd);
        // A round without jobs says that all is over, warped or not.
        world.round(self.last_round(), Ends::Half, 0..0, (), |_, ()| ());
        Ok(storage.into_tile(warp.all_frames(shape.dims())))
    }
}

/// The level sets of all classes of a kernel.
pub(crate) fn levels(kernel: &Kernel) -> LevelSets {
    LevelSets::new(kernel.classes().iter().map(|class| (class.weight, &class.taps)))
}
