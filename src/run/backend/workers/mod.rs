//! A run by worker processes: this process starts them, looks at them and replaces lost ones.
//!
//! Workers do all the steps; no sample passes through here. A worker that dies or hangs is killed
//! and reaped, the jobs that it had claimed are released, and another takes its place. When too
//! many were lost, this process ends the step that they were in, writes a checkpoint and gives up.

use std::cell::OnceCell;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use perceptile_cluster::Worker;
pub use perceptile_cluster::process::WorkersOptions;
use perceptile_cluster::process::{Cause, Workers};
use perceptile_cluster::shared::{Board, Counter};

use super::Backend;
use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::Simd;
use crate::run::error::RunError;
use crate::run::plan::{Plan, Position};
use crate::run::start::InitialState;
use crate::run::steps::Steps;
use crate::run::summary::{ParallelSummary, WorkerSummary, WorkersSummary, imbalance};
use crate::run::watch::{Decision, Watch};
use crate::solver::{Phase, Record, SharedSnapshot, Storage, faults, rounds};
use crate::tile::Reach;

mod launch;
pub mod task;

/// Between two looks at the workers.
const PAUSE: Duration = Duration::from_millis(5);

/// The workers of a run and what they are doing.
pub struct Supervisor<'a> {
    plan: &'a Plan,
    simd: Simd,
    options: WorkersOptions,
    /// The processes; none once the run is given up.
    workers: Option<Workers>,
    worker: Arc<Worker>,
    record: Arc<Record>,
    /// What workers share; none while they are lost, and this process ends their step.
    storage: Option<Storage>,
    /// Whether the workers have been asked to stand still for a checkpoint.
    holds: bool,
    /// Whether they are to stop.
    stops: bool,
    /// Where they stand still.
    held: Option<Position>,
    replaced: u32,
    /// How far samples see each other in the polish, once that was needed.
    sight: OnceCell<Reach>,
}

impl<'a> Supervisor<'a> {
    /// Starts the workers of a plan, as many as its parallelism has.
    ///
    /// # Errors
    /// If there is too little memory, if a checkpoint cannot be read again, or if workers do not
    /// start.
    pub fn start(
        plan: &'a Plan,
        start: InitialState,
        simd: Simd,
        options: WorkersOptions,
        watch: &mut Watch<'_>,
    ) -> Result<Self, RunError> {
        let report = &mut |text: &str| watch.report(text);
        let (workers, worker, storage) = launch::launch(plan, start, simd, &options, None, report)?;
        Ok(Self {
            plan,
            simd,
            options,
            workers: Some(workers),
            worker,
            record: Arc::clone(&storage.record),
            storage: Some(storage),
            holds: false,
            stops: false,
            held: None,
            replaced: 0,
            sight: OnceCell::new(),
        })
    }

    fn board(&self) -> &Board {
        self.worker.board()
    }

    /// Ends the step that lost workers were in, writes a checkpoint and says why. If all steps
    /// were over, makes the tile instead.
    fn give_up(&mut self, cause: &Cause, watch: &mut Watch<'_>) -> Result<(), RunError> {
        // Those that are left are killed and reaped: only what the dead hold can be released.
        drop(self.workers.take());
        let worker = Arc::clone(&self.worker);
        let board = worker.board();
        for index in 0..worker.workers() {
            board.release_worker(index);
        }
        board.release(false);
        let storage = self.storage.take().expect("what workers share");
        let mut steps = Steps::new(self.plan, Arc::clone(&worker), storage, self.simd)?;
        while let Some(at) = steps.position() {
            // Steps that are over pass by, and after the last one a tile is soon made.
            let next = rounds::step(at.phase, at.step, rounds::Part::Gradient);
            if board.completed() < next && !self.plan.is_last(at) {
                let saved = watch.save(at, self.record.read(), steps.state());
                let kept = match (saved, watch.kept()) {
                    (Err(error), _) => format!(", and no checkpoint was written: {error}"),
                    (Ok(()), Some(path)) => {
                        format!("; `perceptile resume {}` goes on", path.display())
                    }
                    (Ok(()), None) => String::new(),
                };
                let (lost, cause) = (self.replaced + 1, cause.to_string());
                return Err(RunError::Lost { lost, cause, kept });
            }
            steps.advance()?;
        }
        self.storage = Some(steps.finish());
        Ok(())
    }
}

impl ArraySource for Supervisor<'_> {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        let (Some(storage), Some(at)) = (&self.storage, self.held) else {
            panic!("a state of workers that do not stand still");
        };
        let reach = match at.phase {
            Phase::Polish => *self.sight.get_or_init(|| self.plan.sight()),
            _ => self.plan.partition().reach(),
        };
        SharedSnapshot::new(storage, self.plan.options.shape, reach, at.step).array(index, sink)
    }
}

impl Backend for Supervisor<'_> {
    fn shared(&self) -> (&Arc<Worker>, &Arc<Record>) {
        (&self.worker, &self.record)
    }

    fn position(&self) -> Option<Position> {
        let round = self.board().completed();
        if round >= self.plan.last_round() {
            return None;
        }
        let from = self.plan.from;
        let Some((phase, step)) = rounds::position(round) else { return Some(from) };
        let step = if phase == from.phase { step.max(from.step) } else { step };
        Some(Position { phase, step: step.min(self.plan.steps_of(phase)) })
    }

    fn workers(&self) -> Option<(usize, usize)> {
        Some((self.worker.workers(), self.replaced as usize))
    }

    fn obey(&mut self, _: Position, decision: Decision) -> Option<Position> {
        if decision.checkpoint && !self.holds {
            self.holds = true;
            self.board().ask_hold();
        }
        // Last, so that who stops waits as well, to be written down.
        if decision.stop.is_some() {
            self.stops = true;
            self.board().ask_stop();
        }
        let (phase, step) =
            self.board().held().filter(|_| self.holds).and_then(rounds::position)?;
        self.held = Some(Position { phase, step });
        self.held
    }

    fn release(&mut self) {
        // Those that are to stop wait again where they do; when they have, there is no more.
        let stopped = self.board().stopped().is_some();
        let again = self.stops && !stopped;
        self.holds = again || stopped;
        self.held = None;
        self.board().release(again);
    }

    fn advance(&mut self, watch: &mut Watch<'_>) -> Result<(), RunError> {
        std::thread::sleep(PAUSE);
        let Some(workers) = &mut self.workers else { return Ok(()) };
        for loss in workers.losses(self.worker.board()) {
            self.worker.board().release_worker(loss.worker);
            if self.replaced == self.options.replacements {
                return self.give_up(&loss.cause, watch);
            }
            self.replaced += 1;
            watch.report(&format!("{loss}; another takes its place"));
            if let Err(error) = workers.replace(loss.worker) {
                return self.give_up(&Cause::Failed(error.to_string()), watch);
            }
        }
        Ok(())
    }

    fn finish(self) -> (Storage, ParallelSummary) {
        if let Some(workers) = self.workers {
            workers.finish(Workers::FAREWELL);
        }
        let storage = self.storage.expect("a run that was given up has no end");
        (storage, ParallelSummary::Workers(summary(&self.worker, self.replaced)))
    }
}

/// Has workers do another task on the memory of a plan. Returns what each of them reported.
///
/// # Errors
/// If there is too little memory, if workers do not start, or if one is lost.
pub fn run_task(
    plan: &Plan,
    start: InitialState,
    simd: Simd,
    options: &WorkersOptions,
    task: Vec<u8>,
) -> Result<Vec<Vec<u8>>, RunError> {
    let (mut workers, worker, _storage) =
        launch::launch(plan, start, simd, options, Some(task), &mut |_| ())?;
    let lost = |cause| RunError::Lost { lost: 1, cause, kept: String::new() };
    while workers.pids().iter().any(Option::is_some) {
        if let Some(loss) = workers.losses(worker.board()).into_iter().next() {
            return Err(lost(loss.cause.to_string()));
        }
        std::thread::sleep(PAUSE);
    }
    let reports = workers.finish(Workers::FAREWELL).into_iter().collect::<Option<Vec<Vec<u8>>>>();
    reports.ok_or_else(|| lost("did not report".into()))
}

/// What the counters of a board say.
fn summary(worker: &Worker, replaced: u32) -> WorkersSummary {
    let counter = |index, counter| worker.board().counter(index, counter).load(Ordering::Relaxed);
    let seconds = |index, what| counter(index, what) as f64 * 1e-9;
    let workers: Vec<WorkerSummary> = (0..worker.workers())
        .map(|index| WorkerSummary {
            busy: seconds(index, Counter::Busy),
            waiting: seconds(index, Counter::Waiting),
            jobs: counter(index, Counter::Jobs),
            taken: counter(index, Counter::Taken),
            traffic: counter(index, Counter::Traffic),
        })
        .collect();
    WorkersSummary {
        imbalance: imbalance(workers.iter().map(|worker| worker.busy)),
        workers,
        replaced,
        faults: faults::tallies(worker.board()),
    }
}
