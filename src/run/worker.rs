//! What a worker process does: it takes its part in a run, and ends with it.

use std::sync::Arc;

use perceptile_cluster::World;
use perceptile_cluster::codec::{self, CodecError};
use perceptile_cluster::faults::{FaultPlan, Faults, Place};
use perceptile_cluster::process::{self, ProcessError};
use perceptile_cluster::shared::{Header, Map, MapError};
use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::gradient::simd::Simd;
use crate::run::program::{Abandoned, Position, Program, ProgramError, Watch};
use crate::solver::{Phase, Snapshot, Storage};
use crate::tile::Region;

/// The name and version that coordinator and workers must share.
pub(super) const VERSION: &str = concat!("perceptile ", env!("CARGO_PKG_VERSION"));

/// What a coordinator tells its workers.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Errand {
    pub program: Program,
    /// What to do in place of the program, for who knows what it says.
    pub other: Option<Vec<u8>>,
    /// Of the shared memory.
    pub header: Header,
    /// Whether no vector instructions are to be used.
    pub plain: bool,
    pub faults: Option<FaultPlan>,
    /// Whether there is a core for every thread. Workers that are bound to some do not see it.
    pub spins: bool,
}

/// Most memory that an errand may ask for: kernels of millions of taps are long.
pub(super) const ERRAND_LIMIT: usize = 1 << 30;

/// Why a worker cannot take part.
#[derive(Debug, Error)]
pub enum WorkerError {
    /// It has no coordinator, or none that it understands.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// The coordinator's words are none.
    #[error("what the coordinator asks for cannot be read: {0}")]
    Errand(CodecError),
    /// The shared memory cannot be used.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// The system gives no threads.
    #[error("threads cannot be had: {0}")]
    Threads(ThreadPoolBuildError),
    /// The program cannot be carried out.
    #[error(transparent)]
    Program(#[from] ProgramError),
}

/// Does what a coordinator asks for in place of a program, on the world and the storage of that
/// program, and says what came of it; or why it cannot.
pub type Other<'a> =
    &'a (dyn Fn(&[u8], &Program, Arc<World>, Storage, Simd) -> Result<Vec<u8>, String> + Sync);

/// Takes part in the run of the coordinator that started this process. To be called by the main
/// thread, before all else.
///
/// # Errors
/// If it cannot; the coordinator has been told.
pub fn serve(other: Other<'_>) -> Result<(), WorkerError> {
    let mut attached = process::attach(VERSION)?;
    let rank = attached.rank;
    let prepare = || {
        let errand: Errand =
            codec::decode::<_, ERRAND_LIMIT>(&attached.payload).map_err(WorkerError::Errand)?;
        let Errand { program, other, header, plain, faults, spins } = errand;
        let program = program.checked().map_err(ProgramError::from)?;
        let threads = program.team.threads;
        let pool =
            ThreadPoolBuilder::new().num_threads(threads).build().map_err(WorkerError::Threads)?;
        let region = Region::whole(program.options.shape);
        let map = Map::open(&attached.region, header)?;
        let (world, storage) = program.storage(region).open(map, rank, faults.map(Faults::new));
        world.let_spin(spins);
        let simd = if plain { Simd::plain() } else { Simd::detect() };
        Ok((program, other, simd, pool, world, storage))
    };
    let (program, task, simd, pool, world, storage) = match prepare() {
        Ok(prepared) => prepared,
        Err(error) => {
            let error: WorkerError = error;
            attached.fail(&error.to_string())?;
            return Err(error);
        }
    };
    let alive = world.clone();
    attached.ready(move || alive.beat())?;
    world.fault(Place::Attach);
    let report = match task {
        Some(task) => match pool.install(|| other(&task, &program, world, storage, simd)) {
            Ok(report) => report,
            Err(text) => return Ok(attached.fail(&text)?),
        },
        None => {
            pool.install(|| program.carry_out(&world, storage, simd, &mut Unwatched))?;
            Vec::new()
        }
    };
    Ok(attached.report(report)?)
}

/// The coordinator watches.
struct Unwatched;

impl Watch for Unwatched {
    fn phase(&mut self, _: Phase) {}

    fn before_step(&mut self, _: &World, _: Position, _: &dyn Snapshot) -> Result<(), Abandoned> {
        Ok(())
    }
}
