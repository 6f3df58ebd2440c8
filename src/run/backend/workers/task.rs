//! What a worker process does: its part in a run, or another task on the memory of one.

use std::sync::Arc;

use perceptile_cluster::Worker;
use perceptile_cluster::codec::{self, CodecError};
use perceptile_cluster::faults::{FaultPlan, FaultSite};
use perceptile_cluster::process::{self, ProcessError};
use perceptile_cluster::shared::{Map, MapError, MapHeader};
use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::gradient::simd::Simd;
use crate::run::plan::Plan;
use crate::run::steps::Steps;
use crate::solver::{OptionsError, Storage, faults};
use crate::tile::Region;

/// The name and version that coordinator and workers must share.
pub(super) const VERSION: &str = concat!("perceptile ", env!("CARGO_PKG_VERSION"));

/// What a coordinator sends to its workers.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Task {
    pub plan: Plan,
    /// What to do in place of the steps of the plan, for who knows what it says.
    pub other: Option<Vec<u8>>,
    /// Of the shared memory.
    pub header: MapHeader,
    /// Whether no vector instructions are to be used.
    pub plain: bool,
    pub faults: Option<FaultPlan>,
    /// Whether there is a core for every thread. Workers that are bound to some do not see it.
    pub spins: bool,
}

/// Most memory that a task may ask for: kernels of millions of taps are long.
const TASK_LIMIT: usize = 1 << 30;

/// Why a worker cannot take part.
#[derive(Debug, Error)]
pub enum WorkerError {
    /// It has no coordinator, or none that it understands.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// What the coordinator sent is no task.
    #[error("what the coordinator asks for cannot be read: {0}")]
    Task(CodecError),
    /// The shared memory cannot be used.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// The system gives no threads.
    #[error("threads cannot be had: {0}")]
    Threads(ThreadPoolBuildError),
    /// The plan cannot be followed.
    #[error(transparent)]
    Options(#[from] OptionsError),
}

/// Does what a coordinator asks for in place of the steps of a plan, on the plan's storage, and says
/// what came of it; or why it cannot.
pub type Other<'a> =
    &'a (dyn Fn(&[u8], &Plan, Arc<Worker>, Storage, Simd) -> Result<Vec<u8>, String> + Sync);

/// Takes part in the run of the coordinator that started this process. To be called by the main
/// thread, before all else.
///
/// # Errors
/// If it cannot; the coordinator knows by then.
pub fn serve(other: Other<'_>) -> Result<(), WorkerError> {
    let mut attached = process::attach(VERSION)?;
    let index = attached.index;
    let prepare = || {
        let task: Task =
            codec::decode::<_, TASK_LIMIT>(&attached.payload).map_err(WorkerError::Task)?;
        let Task { plan, other, header, plain, faults: fault_plan, spins } = task;
        let plan = plan.checked()?;
        let threads = plan.parallelism.threads;
        let pool =
            ThreadPoolBuilder::new().num_threads(threads).build().map_err(WorkerError::Threads)?;
        let region = Region::whole(plan.options.shape);
        let map = Map::open(&attached.memory, header)?;
        let (worker, storage) = plan.storage(region).open(map, index, fault_plan.map(faults::plan));
        worker.let_spin(spins);
        let simd = if plain { Simd::plain() } else { Simd::detect() };
        Ok((plan, other, simd, pool, worker, storage))
    };
    let (plan, task, simd, pool, worker, storage) = match prepare() {
        Ok(prepared) => prepared,
        Err(error) => {
            let error: WorkerError = error;
            attached.fail(&error.to_string())?;
            return Err(error);
        }
    };
    let alive = Arc::clone(&worker);
    attached.ready(move || alive.beat())?;
    worker.fault(FaultSite::ATTACH);
    let report = match task {
        Some(task) => match pool.install(|| other(&task, &plan, worker, storage, simd)) {
            Ok(report) => report,
            Err(text) => return Ok(attached.fail(&text)?),
        },
        None => {
            pool.install(|| {
                let mut steps = Steps::new(&plan, worker, storage, simd)?;
                // The coordinator watches.
                while steps.position().is_some() {
                    steps.advance()?;
                }
                steps.finish();
                Ok::<(), OptionsError>(())
            })?;
            Vec::new()
        }
    };
    Ok(attached.report(report)?)
}
