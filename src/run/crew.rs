//! A run by worker processes: this process starts them, looks after them and keeps the run.
//!
//! Workers do all the work; none of it passes through here. A worker that dies or hangs is killed
//! and reaped, what it had claimed is given back, and another takes its place. When too many were
//! lost, this process ends the step that they were in, writes a checkpoint and gives up.

use std::fs::File;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use perceptile_cluster::World;
use perceptile_cluster::codec::{self, CodecError};
use perceptile_cluster::faults::{FaultPlan, Faults, Place};
use perceptile_cluster::place::{self, PlaceError};
use perceptile_cluster::process::{Launch, Loss, ProcessError, Workers, this_program};
use perceptile_cluster::shared::{Counter, Header, Map, MapError, allocate};
use serde::Serialize;
use thiserror::Error;

use crate::gradient::simd::Simd;
use crate::run::begin::Begin;
use crate::run::folder::FolderError;
use crate::run::keeper::Keeper;
use crate::run::observer::Observer;
use crate::run::phases::{Clock, progress, summary};
use crate::run::program::{Abandoned, Position, Program, ProgramError, Watch};
use crate::run::worker::{Errand, VERSION};
use crate::solver::{Onlooker, Phase, Snapshot, StopReason, Storage, Summary, rounds, tile_of};
use crate::tile::{Region, Tile};

/// How worker processes are used.
#[derive(Debug, Clone, PartialEq)]
pub struct CrewOptions {
    /// Arguments that make this program a worker: those of a command that calls
    /// [`serve`](super::worker::serve).
    pub arguments: Vec<String>,
    /// Whether each worker is bound to processors of its own, in one NUMA node.
    pub pin: bool,
    /// How long a worker may give no sign of life.
    pub silence: Duration,
    /// Workers that may be replaced; one more, and the run is given up.
    pub replacements: u32,
    /// Faults made on purpose.
    pub faults: Option<FaultPlan>,
    /// Where shared memory goes if there is no room where it is fastest.
    pub folder: PathBuf,
}

/// What worker processes did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CrewSummary {
    /// Each of them, replacements included with those they replaced.
    pub workers: Vec<WorkerSummary>,
    /// The largest time of work against the mean.
    pub imbalance: f64,
    /// Workers that were replaced.
    pub replaced: u32,
    /// Faults made on purpose, by place; only those that happened.
    pub faults: Vec<(&'static str, u64)>,
}

/// What one worker did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WorkerSummary {
    /// Seconds that its threads worked.
    pub busy: f64,
    /// Seconds that it waited for others.
    pub waiting: f64,
    /// Jobs done.
    pub jobs: u64,
    /// Those of them that were another's by place.
    pub taken: u64,
    /// Bytes read that another worker wrote.
    pub traffic: u64,
}

/// Why worker processes make no tile.
#[derive(Debug, Error)]
pub enum CrewError {
    /// The program cannot be carried out.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// There is no shared memory.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// No file for shared memory can be made.
    #[error("no file for shared memory can be made in {}: {error}", folder.display())]
    File {
        /// Where.
        folder: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// Workers cannot be started.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Workers cannot be bound to processors.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// Workers cannot be told what to do.
    #[error("the kernel is too large for worker processes: {0}")]
    Errand(CodecError),
    /// Too many workers were lost.
    #[error("{lost} workers were lost, the last because it {cause}: the run is given up{kept}")]
    Lost {
        /// How many.
        lost: u32,
        /// Why the last.
        cause: String,
        /// Where the run is kept, if it is.
        kept: String,
    },
}

/// Between two looks at the workers.
const PAUSE: Duration = Duration::from_millis(5);
/// How long a worker may take until it is ready: kernels may be large, machines slow.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long workers may take to end by themselves when all is done; one that hangs is ended then.
const FAREWELL: Duration = Duration::from_millis(300);

/// Carries out a program by worker processes, as many as its team has ranks.
///
/// # Errors
/// If there is too little memory, if a checkpoint cannot be read again, if workers do not start, or
/// if too many are lost.
pub fn carry_out(
    program: &Program,
    begin: Begin,
    simd: Simd,
    options: &CrewOptions,
    observer: &mut dyn Observer,
    keeper: Option<&mut Keeper>,
) -> Result<(Tile, Summary, CrewSummary), CrewError> {
    let mut clock = Clock::new();
    let tell = &mut |text: &str| observer.tell(text);
    let (workers, world, storage) = start(program, begin, simd, options, None, tell)?;
    let mut crew = Crew {
        program,
        options,
        world: &world,
        observer,
        keeper,
        clock: &mut clock,
        reason: None,
        phase: Phase::Start,
        holds: false,
        replaced: 0,
        polish_reach: None,
    };
    let end = crew.look_after(workers, &storage);
    let (reason, replaced) = (crew.reason, crew.replaced);
    let record = storage.record.clone();
    let shape = program.options.shape;
    let section = match end {
        Ok(()) => {
            let frames = program.options.warp.all_frames(shape.dims());
            storage.into_tile(frames)
        }
        Err(loss) => crew.give_up(&loss, storage, simd)?,
    };
    let tile = tile_of(&section.slice()[..shape.coordinates()], shape);
    let summary = summary(program, &world, &record.read(), reason, clock.seconds());
    Ok((tile, summary, crew_summary(&world, replaced)))
}

/// Has workers do something else on the memory of a program. Returns what each of them reported,
/// and what they did.
///
/// # Errors
/// If there is too little memory, if workers do not start, or if one is lost.
pub fn employ(
    program: &Program,
    begin: Begin,
    simd: Simd,
    options: &CrewOptions,
    task: Vec<u8>,
) -> Result<(Vec<Vec<u8>>, CrewSummary), CrewError> {
    let (mut workers, world, _) = start(program, begin, simd, options, Some(task), &mut |_| ())?;
    let lost = |cause| CrewError::Lost { lost: 1, cause, kept: String::new() };
    while workers.pids().iter().any(Option::is_some) {
        let beat = |rank| world.board().counter(rank, Counter::Beats).load(Ordering::Relaxed);
        if let Some(loss) = workers.check(beat).into_iter().next() {
            return Err(lost(loss.cause.to_string()));
        }
        std::thread::sleep(PAUSE);
    }
    let reports = workers.finish(FAREWELL).into_iter().collect::<Option<Vec<Vec<u8>>>>();
    let reports = reports.ok_or_else(|| lost("did not report".into()))?;
    Ok((reports, crew_summary(&world, 0)))
}

/// Starts the workers of a program on memory that holds what it begins with.
fn start(
    program: &Program,
    begin: Begin,
    simd: Simd,
    options: &CrewOptions,
    other: Option<Vec<u8>>,
    tell: &mut dyn FnMut(&str),
) -> Result<(Workers, Arc<World>, Storage), CrewError> {
    let team = program.team;
    let places = options.pin.then(|| place::assign(team.ranks, team.threads)).transpose()?;
    for (rank, place) in places.iter().flatten().enumerate() {
        tell(&format!("worker {rank} runs on {place}"));
    }
    let plan = program.storage(Region::whole(program.options.shape));
    let header = Header { len: plan.bytes() as u64, run: RandomState::new().hash_one(1) };
    let file = region(header.len, &options.folder)?;
    for (rank, place) in places.iter().flatten().enumerate() {
        // Memory lies near whoever touches it first.
        let ranges = plan.shares(rank);
        place::with_bound(place, || allocate(&file, header, &ranges))??;
    }
    let map = Map::create(&file, header)?;
    let (world, mut storage) = plan.open(map, 0, None);
    begin.put(program, &world, &mut storage)?;
    let errand = Errand {
        program: program.clone(),
        other,
        header,
        plain: simd == Simd::plain(),
        faults: options.faults,
        spins: world.spins(),
    };
    let launch = Launch {
        program: this_program()
            .map_err(|error| CrewError::File { folder: "/proc/self".into(), error })?,
        arguments: options.arguments.iter().map(Into::into).collect(),
        workers: team.ranks,
        version: VERSION.into(),
        payload: codec::encode(&errand).map_err(CrewError::Errand)?,
        region: file,
        places,
        patience: PATIENCE,
        silence: options.silence,
    };
    Ok((Workers::start(launch)?, world, storage))
}

/// A file without a name for shared memory: where it is fastest, or else in a folder.
fn region(bytes: u64, folder: &Path) -> Result<File, CrewError> {
    const FASTEST: &str = "/dev/shm";
    let room = |path: &str| {
        let system = rustix::fs::statvfs(path).ok()?;
        system.f_bavail.checked_mul(system.f_frsize)
    };
    let fits = room(FASTEST).is_some_and(|free| free > bytes.saturating_add(1 << 20));
    let folder = if fits { Path::new(FASTEST) } else { folder };
    tempfile::tempfile_in(folder)
        .map_err(|error| CrewError::File { folder: folder.to_owned(), error })
}

/// The workers of a run and what they are doing.
struct Crew<'a> {
    program: &'a Program,
    options: &'a CrewOptions,
    world: &'a Arc<World>,
    observer: &'a mut dyn Observer,
    keeper: Option<&'a mut Keeper>,
    clock: &'a mut Clock,
    reason: Option<StopReason>,
    phase: Phase,
    /// Whether the workers have been asked to wait.
    holds: bool,
    replaced: u32,
    /// How far samples see each other in the polish, once that was needed.
    polish_reach: Option<crate::tile::Reach>,
}

impl Crew<'_> {
    /// Looks after the workers until the last round is over, or too many are lost.
    fn look_after(&mut self, mut workers: Workers, storage: &Storage) -> Result<(), Loss> {
        let board = self.world.board();
        while board.completed() < self.program.last_round() {
            let beat = |rank| board.counter(rank, Counter::Beats).load(Ordering::Relaxed);
            for loss in workers.check(beat) {
                self.replace(loss, &mut workers)?;
            }
            self.follow(storage);
            std::thread::sleep(PAUSE);
        }
        self.at(Position { phase: Phase::Warp, step: 0 });
        workers.finish(FAREWELL);
        Ok(())
    }

    /// Puts another worker in the place of one that is lost.
    fn replace(&mut self, loss: Loss, workers: &mut Workers) -> Result<(), Loss> {
        self.world.board().release_rank(loss.rank);
        if self.replaced == self.options.replacements {
            return Err(loss);
        }
        self.replaced += 1;
        self.observer.tell(&format!("{loss}; another takes its place"));
        let (rank, pid) = (loss.rank, loss.pid);
        workers.replace(rank).map_err(|error| {
            let cause = perceptile_cluster::process::Cause::Failed(error.to_string());
            Loss { rank, pid, cause }
        })
    }

    /// Sees where the run is, and keeps, stops and tells of it.
    fn follow(&mut self, storage: &Storage) {
        let board = self.world.board();
        let round = board.completed();
        let Some((phase, step)) = rounds::position(round) else { return };
        let from = self.program.from;
        let step = if phase == from.phase { step.max(from.step) } else { step };
        let at = self.at(Position { phase, step });
        let mut told = progress(self.program, &storage.record.read(), at);
        told.workers = Some((self.program.team.ranks, self.replaced as usize));
        self.observer.progress(told);
        if self.reason.is_none()
            && let Some(reason) = self.observer.stop()
        {
            self.reason = Some(reason);
        }
        if let Some(keeper) = &self.keeper
            && !self.holds
            && (self.reason.is_some() || keeper.is_due(self.program.steps_done(at)))
        {
            self.holds = true;
            board.ask_hold();
        }
        // Last, so that who stops waits as well, to be written down.
        if self.reason.is_some() {
            board.ask_stop();
        }
        let Some(keeper) = &mut self.keeper else { return };
        if self.holds
            && let Some((phase, step)) = board.held().and_then(rounds::position)
        {
            let reach = match phase {
                Phase::Polish => *self.polish_reach.get_or_insert_with(|| self.program.sight()),
                _ => self.program.partition().reach(),
            };
            let onlooker = Onlooker::new(storage, self.program.options.shape, reach, step);
            let at = Position { phase, step };
            if let Err(error) = keeper.save(self.program, at, storage.record.read(), &onlooker) {
                self.observer.tell(&format!("no checkpoint was written: {error}"));
            }
            // Those that are to stop wait again where they do; when they have, there is no more.
            let stopped = board.stopped().is_some();
            let again = self.reason.is_some() && !stopped;
            self.holds = again || stopped;
            board.release(again);
        }
    }

    /// A position with what is past the last step taken off; the clock goes with it.
    fn at(&mut self, at: Position) -> Position {
        if at.phase != self.phase {
            self.phase = at.phase;
            self.clock.begin(at.phase);
        }
        let of = match at.phase {
            Phase::Descent => self.program.options.steps,
            Phase::Polish => self.program.options.polish.steps,
            Phase::Start | Phase::Warp => 0,
        };
        Position { step: at.step.min(of), ..at }
    }

    /// Ends the step that lost workers were in, writes a checkpoint and says why. If all steps
    /// were over, it makes the tile instead.
    fn give_up(
        self,
        loss: &Loss,
        storage: Storage,
        simd: Simd,
    ) -> Result<perceptile_cluster::shared::Section, CrewError> {
        let Self { program, world, mut keeper, replaced, .. } = self;
        let lost = CrewError::Lost {
            lost: replaced + 1,
            cause: loss.cause.to_string(),
            kept: String::new(),
        };
        for rank in 0..world.size() {
            world.board().release_rank(rank);
        }
        world.board().release(false);
        let record = storage.record.clone();
        let mut last =
            Last { program, record: &record, keeper: keeper.as_deref_mut(), error: None };
        match program.carry_out(world, storage, simd, &mut last) {
            Ok(tile) => Ok(tile),
            Err(ProgramError::Abandoned(_)) => {
                let error = last.error.take();
                let kept = match (error, keeper) {
                    (Some(error), _) => format!(", and no checkpoint was written: {error}"),
                    (None, Some(keeper)) if keeper.has_saved() => {
                        format!("; `perceptile resume {}` goes on", keeper.path().display())
                    }
                    _ => String::new(),
                };
                let CrewError::Lost { lost, cause, .. } = lost else { return Err(lost) };
                Err(CrewError::Lost { lost, cause, kept })
            }
            Err(error) => Err(error.into()),
        }
    }
}

/// Writes a last checkpoint at the end of the step that is under way.
struct Last<'a> {
    program: &'a Program,
    record: &'a crate::solver::Record,
    keeper: Option<&'a mut Keeper>,
    error: Option<FolderError>,
}

impl Watch for Last<'_> {
    fn phase(&mut self, _: Phase) {}

    fn before_step(
        &mut self,
        world: &World,
        at: Position,
        state: &dyn Snapshot,
    ) -> Result<(), Abandoned> {
        // Steps that are over pass by, and after the last one a tile is soon made.
        let next = rounds::step(at.phase, at.step, rounds::Part::Pull);
        if world.board().completed() >= next || self.program.is_last(at) {
            return Ok(());
        }
        if let Some(keeper) = &mut self.keeper {
            self.error = keeper.save(self.program, at, self.record.read(), state).err();
        }
        Err(Abandoned)
    }
}

/// What the counters of a board say.
fn crew_summary(world: &World, replaced: u32) -> CrewSummary {
    let counter = |rank, counter| world.board().counter(rank, counter).load(Ordering::Relaxed);
    let seconds = |rank, what| counter(rank, what) as f64 * 1e-9;
    let workers: Vec<WorkerSummary> = (0..world.size())
        .map(|rank| WorkerSummary {
            busy: seconds(rank, Counter::Busy),
            waiting: seconds(rank, Counter::Waiting),
            jobs: counter(rank, Counter::Jobs),
            taken: counter(rank, Counter::Taken),
            traffic: counter(rank, Counter::Traffic),
        })
        .collect();
    let mean = workers.iter().map(|worker| worker.busy).sum::<f64>() / workers.len() as f64;
    let most = workers.iter().map(|worker| worker.busy).fold(0.0, f64::max);
    let faults = Place::ALL.map(|place| (place.name(), Faults::tally(world.board(), place)));
    CrewSummary {
        imbalance: if mean > 0.0 { most / mean } else { 1.0 },
        workers,
        replaced,
        faults: faults.into_iter().filter(|(_, count)| *count > 0).collect(),
    }
}
