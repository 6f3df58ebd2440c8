//! A selection by worker processes that share its windows.
//!
//! Workers do all rounds by themselves. After every wave they stand still until this process has taken
//! out the frame that is done and put in the next one. A worker that dies or hangs is killed and
//! reaped, what it left half done is taken back, and another takes its place.

use std::fs::File;
use std::sync::Arc;
use std::time::{Duration, Instant};

use perceptile_cluster::affinity::{self, AffinityError};
use perceptile_cluster::codec::{self, CodecError};
use perceptile_cluster::communicator::Single;
use perceptile_cluster::faults::{FaultPlan, FaultSite};
use perceptile_cluster::process::{
    self, Launch, ProcessError, Workers, WorkersOptions, memory_file, this_program,
};
use perceptile_cluster::shared::{Arena, Map, MapError, MapHeader};
use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::SelectError;
use super::engine::Engine;
use super::faults;
use super::plan::SelectPlan;
use super::selection::Selection;
use crate::gradient::simd::Simd;

/// The name and version that coordinator and workers must share.
const VERSION: &str = concat!("perceptile select ", env!("CARGO_PKG_VERSION"));
/// Between two looks at the workers.
const LOOK: Duration = Duration::from_millis(5);
/// Most memory that a task may ask for: kernels of millions of taps are long.
const TASK_LIMIT: usize = 1 << 30;

/// Why workers cannot do a selection.
#[derive(Debug, Error)]
pub enum CrewError {
    /// The selection is wrong.
    #[error(transparent)]
    Select(#[from] SelectError),
    /// Workers cannot be started, or this process is no worker.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// There is no memory for it.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// Workers cannot be bound to processors.
    #[error(transparent)]
    Affinity(#[from] AffinityError),
    /// What workers are to do cannot be sent or read.
    #[error("what the workers are to do cannot be sent: {0}")]
    Task(CodecError),
    /// The system gives no threads.
    #[error("threads cannot be had: {0}")]
    Threads(ThreadPoolBuildError),
    /// Too many workers were lost.
    #[error("{lost} workers were lost, the last because it {cause}: the same command goes on")]
    Lost {
        /// How many.
        lost: u32,
        /// Why the last.
        cause: String,
    },
}

/// What a coordinator sends to its workers.
#[derive(Debug, Serialize, Deserialize)]
struct Task {
    plan: SelectPlan,
    /// How many selections of this plan there are, one behind the other in memory.
    selections: usize,
    /// The wave to begin with.
    wave: usize,
    header: MapHeader,
    /// Whether no vector instructions are to be used.
    plain: bool,
    faults: Option<FaultPlan>,
    /// Whether there is a core for every thread.
    spins: bool,
}

/// The workers of one or several selections, which take turns.
pub struct Crew {
    plan: SelectPlan,
    simd: Simd,
    options: WorkersOptions,
    file: File,
    header: MapHeader,
    /// The processes, once they are started.
    workers: Option<Workers>,
    /// Selections whose workers are at work or have been.
    begun: Vec<bool>,
    looked: Instant,
    replaced: u32,
}

impl Crew {
    /// Prepares so many selections of a plan on shared memory. The workers are started when the first
    /// wave begins, by the thread that stays as long as they do.
    ///
    /// # Errors
    /// A kernel that is too large, no memory.
    pub fn new(
        plan: &SelectPlan,
        selections: usize,
        simd: Simd,
        options: WorkersOptions,
    ) -> Result<(Self, Vec<Selection>), CrewError> {
        let bytes = plan.foreseen()?.0.saturating_mul(selections);
        let header = MapHeader::new(bytes as u64);
        let (file, folder) = memory_file(header.len, &options.folder)?;
        let mut arena = Arena::new(Map::create(&file, folder, header)?);
        let owner = |_| {
            let engine = engine(plan, &mut arena, (0, None), simd)?;
            Ok(Selection::with_engine(plan, engine))
        };
        let owners = (0..selections).map(owner).collect::<Result<Vec<_>, SelectError>>()?;
        let crew = Self {
            plan: plan.clone(),
            simd,
            options,
            file,
            header,
            workers: None,
            begun: vec![false; selections],
            looked: Instant::now(),
            replaced: 0,
        };
        Ok((crew, owners))
    }

    /// Starts the workers.
    fn launch(&mut self, selections: &[Selection]) -> Result<Workers, CrewError> {
        let parallelism = self.plan.parallelism;
        let (workers, threads) = (parallelism.workers, parallelism.threads);
        let pin = self.options.pin;
        let affinity = pin.then(|| affinity::assign(workers, threads)).transpose()?;
        for selection in selections {
            selection.engine.worker.board().ask_hold();
        }
        let task = Task {
            plan: self.plan.clone(),
            selections: selections.len(),
            wave: selections[0].wave(),
            header: self.header,
            plain: self.simd == Simd::plain(),
            faults: self.options.faults,
            spins: selections[0].engine.worker.spins(),
        };
        let launch = Launch {
            program: this_program()?,
            arguments: self.options.arguments.iter().map(Into::into).collect(),
            workers,
            version: VERSION.into(),
            payload: codec::encode(&task).map_err(CrewError::Task)?,
            memory: self.file.try_clone().map_err(|error| ProcessError::Memory {
                folder: self.options.folder.clone(),
                error,
            })?,
            affinity,
            patience: Launch::PATIENCE,
            silence: self.options.silence,
        };
        Ok(Workers::start(launch)?)
    }

    /// [`Selection::advance`] for the selection of this index, by the workers. `report` hears of those
    /// that are lost.
    ///
    /// # Errors
    /// Workers that do not start, or too many that are lost.
    ///
    /// # Panics
    /// If frames are missing that it needs.
    pub fn advance(
        &mut self,
        selections: &mut [Selection],
        index: usize,
        report: &mut dyn FnMut(&str),
        done: impl FnOnce(usize, &[f32], &[u8]),
    ) -> Result<bool, CrewError> {
        assert!(selections[index].needed().is_empty(), "frames are missing");
        if self.workers.is_none() {
            self.workers = Some(self.launch(selections)?);
        }
        let worker = Arc::clone(&selections[index].engine.worker);
        // In its first wave nobody waits yet, and that all wait behind it is asked already.
        if std::mem::replace(&mut self.begun[index], true) {
            worker.board().release(true);
        }
        loop {
            let event = worker.board().event();
            if worker.board().held().is_some() {
                break;
            }
            if self.looked.elapsed() >= LOOK {
                self.looked = Instant::now();
                self.replace_lost(selections, report)?;
            }
            worker.board().watch(event);
        }
        let wave = selections[index].engine.pass();
        Ok(selections[index].collect(&wave, done))
    }

    /// Replaces workers that are dead or hang.
    fn replace_lost(
        &mut self,
        selections: &[Selection],
        report: &mut dyn FnMut(&str),
    ) -> Result<(), CrewError> {
        let Some(workers) = &mut self.workers else { return Ok(()) };
        for loss in workers.losses(selections[0].engine.worker.board()) {
            for selection in selections {
                selection.engine.worker.board().release_worker(loss.worker);
            }
            if self.replaced == self.options.replacements {
                let (lost, cause) = (self.replaced + 1, loss.cause.to_string());
                return Err(CrewError::Lost { lost, cause });
            }
            self.replaced += 1;
            report(&format!("{loss}; another takes its place"));
            workers.replace(loss.worker)?;
        }
        Ok(())
    }

    /// Lets the workers go when all is done. Returns how many were replaced.
    pub fn finish(self) -> u32 {
        if let Some(workers) = self.workers {
            workers.finish(Workers::FAREWELL);
        }
        self.replaced
    }
}

/// The part of a process in the next selection of shared memory.
fn engine(
    plan: &SelectPlan,
    arena: &mut Arena,
    (index, faults): (usize, Option<FaultPlan>),
    simd: Simd,
) -> Result<Engine, SelectError> {
    let ready = plan.ready()?;
    let window_plan = ready.window(plan, 0);
    let (worker, window) = window_plan.open(arena, index, faults.map(faults::plan));
    let memory = (window_plan, worker, window);
    Ok(Engine::new(ready, memory, Arc::new(Single), (plan.options.norm, simd)))
}

/// Takes part in the selection of the coordinator that started this process. To be called by the main
/// thread, before all else.
///
/// # Errors
/// If it cannot; the coordinator knows by then.
pub fn serve() -> Result<(), CrewError> {
    let mut attached = process::attach(VERSION)?;
    let prepare = || {
        let task = codec::decode::<Task, TASK_LIMIT>(&attached.payload).map_err(CrewError::Task)?;
        let threads = task.plan.parallelism.threads;
        let pool =
            ThreadPoolBuilder::new().num_threads(threads).build().map_err(CrewError::Threads)?;
        let mut arena = Arena::new(Map::open(&attached.memory, task.header)?);
        let simd = if task.plain { Simd::plain() } else { Simd::detect() };
        let engines = (0..task.selections).map(|_| {
            let mut engine = engine(&task.plan, &mut arena, (attached.index, task.faults), simd)?;
            engine.worker.let_spin(task.spins);
            engine.begin_with(task.wave);
            Ok(engine)
        });
        let engines = engines.collect::<Result<Vec<_>, SelectError>>()?;
        Ok::<_, CrewError>((engines, pool))
    };
    let (mut engines, pool) = match prepare() {
        Ok(prepared) => prepared,
        Err(error) => {
            attached.fail(&error.to_string())?;
            return Err(error);
        }
    };
    let alive = Arc::clone(&engines[0].worker);
    attached.ready(move || alive.beat())?;
    engines[0].worker.fault(FaultSite::ATTACH);
    pool.install(|| {
        let mut is_last = false;
        while !is_last {
            for engine in &mut engines {
                is_last = engine.advance().is_last;
            }
        }
    });
    Ok(attached.report(Vec::new())?)
}
