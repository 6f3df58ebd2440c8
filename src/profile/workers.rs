//! What worker processes make of a descent: what each does, what it waits for, what it reads of
//! the others, and what it costs them to go in step.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant, SystemTime};

use perceptile_cluster::codec::{self, CodecError};
use perceptile_cluster::{Ends, Worker};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::measure::{DETAILED, TRACED};
use super::spans::{Span, SpanProbe};
use crate::gradient::simd::Simd;
use crate::run::backend::workers::{self, WorkersOptions};
use crate::run::driver::{self, Parallel};
use crate::run::error::RunError;
use crate::run::observer::Unobserved;
use crate::run::plan::Plan;
use crate::run::start::InitialState;
use crate::run::summary::{ParallelSummary, WorkersSummary};
use crate::solver::rounds::{self, Part};
use crate::solver::{BLOCKS_PER_THREAD, Descent, OptionsError, Phase, Storage};
use crate::tile::Region;

/// What worker processes make of a descent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorkersProfile {
    /// Threads of each.
    pub threads: usize,
    /// Steps that were done.
    pub steps: u32,
    /// Seconds of a mean step.
    pub step: f64,
    /// Seconds of a step in which there is nothing to do: what it costs to go in step.
    pub synchronisation: f64,
    /// What each worker did in all steps.
    pub workers: WorkersSummary,
}

/// Why worker processes cannot be profiled.
#[derive(Debug, Error)]
pub enum WorkersProfileError {
    /// They do not do what they should.
    #[error(transparent)]
    Run(#[from] RunError),
    /// There is nothing that they could do.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// What they say cannot be read.
    #[error("what a worker reports cannot be read: {0}")]
    Report(#[from] CodecError),
}

/// What workers are asked to do.
#[derive(Debug, Serialize, Deserialize)]
enum Task {
    /// So many steps without any work.
    Idle { steps: u32 },
    /// A few steps, of which each thread keeps at most so many spans.
    Trace { most: usize },
}

/// Steps without work, before those that count and of those.
const IDLE: u32 = 2000;
/// Steps that are done at least, and at most.
const FEWEST: u32 = 20;
const MOST: u32 = 1_000_000;
/// Memory that a report may ask for.
const LIMIT: usize = 1 << 30;

impl WorkersProfile {
    /// Takes the profile of a descent of which a step takes about so many seconds, in about
    /// `time`.
    ///
    /// # Errors
    /// If workers cannot do it.
    pub fn take(
        plan: &Plan,
        simd: Simd,
        options: &WorkersOptions,
        step: f64,
        time: Duration,
    ) -> Result<Self, WorkersProfileError> {
        let start = || InitialState::new(plan, None);
        let steps = (time.as_secs_f64() / step) as u32;
        let steps = steps.clamp(FEWEST, MOST).min(plan.options.steps).max(1);
        let mut some = plan.clone();
        some.options.stop_after = Some(steps);
        some.options.warp.frames = 0;
        let parallel = Parallel::Workers(options.clone());
        let output = driver::run(&some, start()?, simd, parallel, &mut Unobserved, None)?;
        let ParallelSummary::Workers(workers) = output.parallel else {
            unreachable!("a run of workers has a summary of workers")
        };
        let descent = output.summary.seconds.iter().filter(|(phase, _)| *phase == Phase::Descent);
        let seconds: f64 = descent.map(|(_, seconds)| seconds).sum();
        let task = codec::encode(&Task::Idle { steps: IDLE })?;
        let reports = workers::run_task(plan, start()?, simd, options, task)?;
        let mut idle = Vec::new();
        for report in reports {
            idle.push(codec::decode::<f64, LIMIT>(&report)?);
        }
        Ok(Self {
            threads: plan.parallelism.threads,
            steps,
            step: seconds / f64::from(steps),
            synchronisation: idle.into_iter().fold(0.0, f64::max),
            workers,
        })
    }
}

impl fmt::Display for WorkersProfile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { threads, steps, step, synchronisation, workers } = self;
        let count = workers.workers.len();
        let s = if *threads == 1 { "" } else { "s" };
        writeln!(f, "{count} workers of {threads} thread{s}, {steps} steps")?;
        writeln!(
            f,
            "  a step takes {:.1} us, one without work {:.1} us",
            step * 1e6,
            synchronisation * 1e6
        )?;
        writeln!(f, "  imbalance {:.2} (the longest work against the mean)", workers.imbalance)?;
        writeln!(f, "  of a step   work us  waiting us  jobs  of others  KB of others")?;
        let each = 1.0 / f64::from(*steps);
        for (rank, worker) in workers.workers.iter().enumerate() {
            writeln!(
                f,
                "  worker {rank:<4} {:>7.1} {:>11.1} {:>5.1} {:>10.2} {:>13.1}",
                worker.busy * 1e6 * each,
                worker.waiting * 1e6 * each,
                worker.jobs as f64 * each,
                worker.taken as f64 * each,
                worker.traffic as f64 * 1e-3 * each
            )?;
        }
        Ok(())
    }
}

/// What all threads of all workers did in a few steps, with the worker of each: from the moment on
/// at which the first one began.
///
/// # Errors
/// If workers cannot do it.
pub fn spans(
    plan: &Plan,
    simd: Simd,
    options: &WorkersOptions,
    most: usize,
) -> Result<Vec<Vec<Span>>, WorkersProfileError> {
    let start = InitialState::new(plan, None)?;
    let task = codec::encode(&Task::Trace { most: most / plan.parallelism.all_threads() })?;
    let reports = workers::run_task(plan, start, simd, options, task)?;
    let mut workers = Vec::new();
    for report in reports {
        workers.push(codec::decode::<Vec<Span>, LIMIT>(&report)?);
    }
    let origin = workers.iter().flatten().map(|span| span.start).min().unwrap_or_default();
    workers.iter_mut().flatten().for_each(|span| span.start -= origin);
    Ok(workers)
}

/// Does as a worker what [`WorkersProfile::take`] and [`spans`] ask for.
///
/// # Errors
/// A text for the coordinator.
pub fn take_part(
    task: &[u8],
    plan: &Plan,
    worker: Arc<Worker>,
    storage: Storage,
    simd: Simd,
) -> Result<Vec<u8>, String> {
    let report = match codec::decode::<Task, LIMIT>(task).map_err(|error| error.to_string())? {
        Task::Idle { steps } => codec::encode(&idle(plan, &worker, steps)),
        Task::Trace { most } => {
            let spans = trace(plan, worker, storage, simd, most);
            codec::encode(&spans.map_err(|error| error.to_string())?)
        }
    };
    report.map_err(|error| error.to_string())
}

/// Seconds of a step without work: as many rounds and jobs as a step has, and nothing to do.
fn idle(plan: &Plan, worker: &Worker, steps: u32) -> f64 {
    let whole = Region::whole(plan.options.shape);
    let threads = plan.parallelism.all_threads();
    let blocks = plan.partition().block_count(whole, threads * BLOCKS_PER_THREAD);
    let lines = plan.options.shape.height();
    let step = |step| {
        for (part, ends, jobs) in
            [(Part::Gradient, Ends::Half, blocks), (Part::Update, Ends::Step, lines)]
        {
            worker.round(rounds::step(Phase::Descent, step, part), ends, 0..jobs, (), |_, ()| ());
        }
    };
    (0..steps).for_each(step);
    let begin = Instant::now();
    (steps..2 * steps).for_each(step);
    begin.elapsed().as_secs_f64() / f64::from(steps)
}

/// Spans of a few steps, with times since 1970.
fn trace(
    plan: &Plan,
    worker: Arc<Worker>,
    storage: Storage,
    simd: Simd,
    most: usize,
) -> Result<Vec<Span>, OptionsError> {
    let (gradient, regions) = (plan.gradient(simd)?, plan.regions(0));
    let now = Arc::new(AtomicU32::new(0));
    let (zero, since) = (Instant::now(), SystemTime::now());
    let probe = || SpanProbe::new(zero, now.clone(), DETAILED, most);
    let (adam, steps) = (plan.options.adam, plan.options.steps);
    let mut descent =
        Descent::enter(worker, storage, (gradient, &regions), adam, steps, (simd, 0), probe);
    for step in 0..TRACED {
        now.store(step, Ordering::Relaxed);
        descent.step(step);
    }
    let since = since.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let probes = descent.into_probes().into_iter();
    let mut spans: Vec<Span> = probes.flat_map(SpanProbe::into_spans).collect();
    spans.iter_mut().for_each(|span| span.start += since);
    spans.sort_by_key(|span| (span.thread, span.start));
    Ok(spans)
}
