//! A run from its start to its tile, by the threads of this process.

use std::time::Instant;

use perceptile_cluster::World;

use crate::gradient::simd::Simd;
use crate::run::begin::Begin;
use crate::run::keeper::Keeper;
use crate::run::observer::{Observer, Progress};
use crate::run::program::{Abandoned, Position, Program, ProgramError, Watch};
use crate::solver::{
    Options, Phase, Record, Recorded, Snapshot, StopReason, Summary, Team, tile_of,
};
use crate::tile::{Region, Tile};

/// Makes a tile.
///
/// `start` is the tile to start from, if the options say so. The same options give the same tile
/// on every machine, with every number of threads and every instruction set.
///
/// # Errors
/// Options outside their ranges, a kernel that does not fit, a starting tile that does not, or
/// too little memory.
pub fn optimize(
    options: &Options,
    start: Option<&Tile>,
    simd: Simd,
    observer: &mut dyn Observer,
) -> Result<(Tile, Summary), ProgramError> {
    let program = Program::new(options, Team::alone())?;
    program.check_batch()?;
    let begin = Begin::new(&program, start)?;
    carry_out(&program, begin, simd, observer, None)
}

/// Carries out a program from where it begins, and writes checkpoints if there is someone to keep
/// them.
///
/// # Errors
/// If there is too little memory, or a checkpoint cannot be read again.
pub fn carry_out(
    program: &Program,
    begin: Begin,
    simd: Simd,
    observer: &mut dyn Observer,
    keeper: Option<&mut Keeper>,
) -> Result<(Tile, Summary), ProgramError> {
    let mut clock = Clock::new();
    let region = Region::whole(program.options.shape);
    let (world, mut storage) = program.storage(region).private()?;
    begin.put(program, &world, &mut storage)?;
    let record = storage.record.clone();
    observer.progress(Progress {
        phase: Phase::Start,
        done: 1,
        of: 1,
        objective: None,
        workers: None,
    });
    let mut watch =
        Alone { program, observer, keeper, record: &record, clock: &mut clock, reason: None };
    let section = program.carry_out(&world, storage, simd, &mut watch)?;
    let reason = watch.reason;
    let shape = program.options.shape;
    let tile = tile_of(&section.slice()[..shape.coordinates()], shape);
    Ok((tile, summary(program, &world, &record.read(), reason, clock.seconds())))
}

/// What a run tells when all its rounds are over.
pub(super) fn summary(
    program: &Program,
    world: &World,
    record: &Recorded,
    reason: Option<StopReason>,
    seconds: Vec<(Phase, f64)>,
) -> Summary {
    let (steps, reason) = program.outcome(world, reason);
    let descended = steps.min(program.options.steps);
    let [objective_before, objective_after] = record.means(descended);
    let convergence = record.curve(descended);
    Summary { reason, steps, objective_before, objective_after, convergence, seconds }
}

/// Watches a run of this process: tells the observer, and stops and keeps it between steps.
struct Alone<'a> {
    program: &'a Program,
    observer: &'a mut dyn Observer,
    keeper: Option<&'a mut Keeper>,
    record: &'a Record,
    clock: &'a mut Clock,
    reason: Option<StopReason>,
}

impl Watch for Alone<'_> {
    fn phase(&mut self, phase: Phase) {
        self.clock.begin(phase);
    }

    fn before_step(
        &mut self,
        world: &World,
        at: Position,
        state: &dyn Snapshot,
    ) -> Result<(), Abandoned> {
        if at.step > 0 {
            self.observer.progress(progress(self.program, &self.record.read(), at));
        }
        let done = self.program.steps_done(at);
        if let Some(reason) = self.observer.stop() {
            self.reason = Some(reason);
            world.board().stop_here();
        }
        if let Some(keeper) = &mut self.keeper
            && (self.reason.is_some() || keeper.is_due(done))
            && let Err(error) = keeper.save(self.program, at, self.record.read(), state)
        {
            self.observer.tell(&format!("no checkpoint was written: {error}"));
        }
        Ok(())
    }
}

/// Where a run stands, for its observer.
pub(super) fn progress(program: &Program, record: &Recorded, at: Position) -> Progress {
    let Options { steps, polish, .. } = program.options;
    let of = if at.phase == Phase::Polish { polish.steps } else { steps };
    let descends = at.phase == Phase::Descent;
    let objective = if descends { record.means(at.step)[1] } else { None };
    Progress { phase: at.phase, done: at.step, of, objective, workers: None }
}

/// Seconds of each phase.
#[derive(Debug)]
pub(super) struct Clock {
    seconds: Vec<(Phase, f64)>,
    phase: Phase,
    since: Instant,
}

impl Clock {
    /// A clock of a run that starts.
    pub fn new() -> Self {
        Self { seconds: Vec::new(), phase: Phase::Start, since: Instant::now() }
    }

    /// A phase begins, and another ends.
    pub fn begin(&mut self, phase: Phase) {
        let now = Instant::now();
        self.seconds.push((self.phase, now.duration_since(self.since).as_secs_f64()));
        (self.phase, self.since) = (phase, now);
    }

    /// Seconds of all phases that took place.
    pub fn seconds(mut self) -> Vec<(Phase, f64)> {
        self.begin(self.phase);
        self.seconds
    }
}
