//! Starting workers: the memory that they share, what lies in it, and what each is sent.

use std::sync::Arc;

use perceptile_cluster::process::{Launch, Workers, memory_file, this_program};
use perceptile_cluster::shared::{Map, MapHeader, allocate};
use perceptile_cluster::{Worker, affinity, codec};

use super::WorkersOptions;
use super::task::{Task, VERSION};
use crate::gradient::simd::Simd;
use crate::run::error::RunError;
use crate::run::plan::Plan;
use crate::run::start::InitialState;
use crate::solver::Storage;
use crate::tile::Region;

/// Starts the workers of a plan on memory that holds what it starts from.
pub(super) fn launch(
    plan: &Plan,
    start: InitialState,
    simd: Simd,
    options: &WorkersOptions,
    other: Option<Vec<u8>>,
    report: &mut dyn FnMut(&str),
) -> Result<(Workers, Arc<Worker>, Storage), RunError> {
    let (processes, threads) = (plan.parallelism.processes(), plan.parallelism.threads);
    let affinity = options.pin.then(|| affinity::assign(processes, threads)).transpose()?;
    for (index, processors) in affinity.iter().flatten().enumerate() {
        report(&format!("worker {index} runs on {processors}"));
    }
    let storage = plan.storage(Region::whole(plan.options.shape));
    let header = MapHeader::new(storage.bytes() as u64);
    let (file, folder) = memory_file(header.len, &options.folder)?;
    for (index, processors) in affinity.iter().flatten().enumerate() {
        // Memory lies near whoever touches it first.
        let ranges = storage.shares(index);
        affinity::with_bound(processors, || allocate(&file, folder, header, &ranges))??;
    }
    let (worker, mut storage) = storage.open(Map::create(&file, folder, header)?, 0, None);
    start.put(plan, &worker, &mut storage)?;
    let task = Task {
        plan: plan.clone(),
        other,
        header,
        plain: simd == Simd::plain(),
        faults: options.faults,
        spins: worker.spins(),
    };
    let launch = Launch {
        program: this_program()?,
        arguments: options.arguments.iter().map(Into::into).collect(),
        workers: processes,
        version: VERSION.into(),
        payload: codec::encode(&task).map_err(RunError::Task)?,
        memory: file,
        affinity,
        patience: Launch::PATIENCE,
        silence: options.silence,
    };
    Ok((Workers::start(launch)?, worker, storage))
}
