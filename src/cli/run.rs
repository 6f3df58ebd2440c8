//! A run that is ready: it is done, its tile is scored, and its files are written.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use perceptile::format::numbers::ArraySource;
use perceptile::metric::{ScoreOptions, Scorer};
use perceptile::run::checkpointer::Every;
use perceptile::run::driver::{self, Output, Parallel};
use perceptile::run::error::RunError;
use perceptile::run::forecast::Forecast;
use perceptile::run::memory;
use perceptile::run::observer::Observer;
use perceptile::run::output::OutputFiles;
use perceptile::run::plan::Plan;
use perceptile::settings::provenance;
use perceptile::solver::{Options, Parallelism, StopReason};
use perceptile::tile::Tile;
use perceptile_cluster::communicator::Communicator;
use rayon::ThreadPool;

use super::display::Shown;
use super::execution::{self, ExecutionArgs};
use super::exit::{Failure, Misuse};
use super::prepared::{Files, Invocation, PreparedRun};
use super::progress::Terminal;
use super::stream::{print, say};
use super::workers::WorkersArgs;
use super::{duration, ranks, summary};

/// By whom a run is done, and how it is kept and ended; of no influence on the tile unless it is
/// stopped.
#[derive(Debug, Args)]
pub struct RunArgs {
    #[command(flatten)]
    pub execution: ExecutionArgs,

    /// Stop when this time is up, such as 90s, 10m or 2h, and write what there is
    #[arg(long, value_parser = duration::parse, help_heading = "Running")]
    time: Option<Duration>,

    /// Write a checkpoint every so often, such as 60s, 10m or 500steps
    #[arg(long, value_name = "EVERY", default_value = "60s", value_parser = duration::parse_every, help_heading = "Files")]
    pub checkpoint: Every,

    #[command(flatten)]
    workers: WorkersArgs,

    /// How progress is shown on the standard error
    #[arg(
        long,
        value_name = "HOW",
        value_enum,
        default_value_t = Shown::Auto,
        env = "PERCEPTILE_PROGRESS",
        help_heading = "Output"
    )]
    progress: Shown,

    /// Say nothing but warnings and errors
    #[arg(long, short, help_heading = "Output")]
    quiet: bool,

    /// Say also what threads, workers or ranks did
    #[arg(long, short, conflicts_with = "quiet", help_heading = "Output")]
    verbose: bool,

    /// Print what was made as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl RunArgs {
    /// How many ranks, workers and threads do the run, as one of so many ranks.
    ///
    /// # Errors
    /// If that would be too many, and flags that do not go together.
    pub fn parallelism(&self, ranks: usize) -> Result<Parallelism, Misuse> {
        let workers = self.execution.workers;
        self.workers.check(workers, ranks)?;
        Ok(Parallelism { ranks, ..self.execution.parallelism()? })
    }

    /// Does the run that the root prepares, if it does, together with all ranks.
    ///
    /// # Errors
    /// What `prepare` reports, outputs that cannot be written, too little memory, workers that are
    /// lost.
    pub fn run(
        &self,
        communicator: &Arc<dyn Communicator>,
        prepare: impl FnOnce() -> Result<Option<PreparedRun>, Failure>,
    ) -> Result<ExitCode, Failure> {
        let shown = if self.quiet { Shown::None } else { self.progress };
        let mut terminal = Terminal::open(shown, communicator.rank() == 0)
            .map_err(Failure::refused("cannot listen for signals"))?;
        let job = ranks::share(&**communicator, || self.execution.threads(), prepare)?;
        let Some(PreparedRun { plan, start, mut files }) = job else {
            return Ok(ExitCode::SUCCESS);
        };
        let pool = ranks::agree(&**communicator, check_in(&plan, files.as_ref()))?;
        let simd = self.execution.simd();
        // A cluster's tile may be larger than one rank can hold.
        let is_foreseen = terminal.is_watched() && plan.parallelism.ranks == 1 && is_long(&plan);
        let forecast = is_foreseen.then(|| pool.install(|| Forecast::of(&plan, simd)).ok());
        let forecast = forecast.flatten();
        terminal.begin(&summary::intent(&plan, forecast.as_ref()), forecast);
        let started = Instant::now();
        terminal.limit(self.time);
        let parallel = self.parallel(&plan, communicator, files.as_ref());
        let checkpointer = files.as_mut().map(|files| &mut files.checkpointer);
        // Workers end with the thread that starts them, which is one of the pool's.
        let output =
            pool.install(|| driver::run(&plan, start, simd, parallel, &mut terminal, checkpointer));
        terminal.clear();
        if let (Err(error @ RunError::Stopped), Some(code)) = (&output, terminal.received()) {
            say(format_args!("error: {error}"));
            return Ok(ExitCode::from(code as u8));
        }
        let output = output?;
        let Some(files) = files else {
            output.discard();
            return Ok(ExitCode::SUCCESS);
        };
        self.finish(&output, &plan, files, &mut terminal, &pool, started)
    }

    /// Scores a tile, writes the files of a run and prints its summary.
    fn finish(
        &self,
        output: &Output,
        plan: &Plan,
        files: Files,
        terminal: &mut Terminal,
        pool: &ThreadPool,
        started: Instant,
    ) -> Result<ExitCode, Failure> {
        let Files { invocation, outputs, existing, checkpointer, claims: _claims } = files;
        let seconds = started.elapsed().as_secs_f64();
        let summary = &output.summary;
        let interrupted = summary.reason == StopReason::Interrupted;
        // A stopped run is to end soon, so it is not scored.
        let is_scored = invocation.integrands > 0 && !interrupted && terminal.received().is_none();
        let tile = is_scored.then(|| output.tile());
        let seen = plan.options.kernel.perceived(plan.options.shape);
        let seen = seen.resolve(plan.options.shape)?;
        let taps = &seen.classes()[0].taps;
        let score = |tile: &Tile| {
            let domain = plan.options.domain;
            let integrands = invocation.integrands;
            let options = ScoreOptions { domain, integrands, ..Default::default() };
            pool.install(|| Scorer::new(plan.options.shape, taps, options)?.score(tile))
        };
        let scores = tile.as_ref().map(score).transpose()?;
        let mut made = None;
        let provenance = |sha256| {
            let Invocation { settings, .. } = &invocation;
            let options = &plan.options;
            let sidecar = provenance(settings, options, output, scores.as_ref(), seconds, sha256);
            made.insert(sidecar).clone()
        };
        let whole = tile.as_ref().map_or(output as &dyn ArraySource, |tile| tile);
        let (shape, scored) = (plan.options.shape, scores.as_ref());
        let written =
            outputs.write((plan.options.domain, shape), whole, taps, scored, existing, provenance);
        output.discard();
        let path = checkpointer.path().display();
        let resume = checkpointer.has_saved().then(|| format!("perceptile resume {path}"));
        written.map_err(|error| match &resume {
            Some(resume) => Failure::from(error).hinted(format_args!("; `{resume}` goes on")),
            None => error.into(),
        })?;
        let made = made.expect("a tile that was written has its provenance");
        let mut text = if self.json {
            summary::json(&made, &outputs)?
        } else if self.quiet {
            String::new()
        } else {
            summary::describe(output, plan, scores.as_ref(), &made, &outputs, self.verbose)
        };
        let stopped = matches!(summary.reason, StopReason::Interrupted | StopReason::Time);
        if let Some(resume) = resume.as_ref().filter(|_| stopped) {
            if !self.json {
                text += &format!("to go on    {resume}\n");
            }
        } else if let Err(error) = checkpointer.remove() {
            terminal.report(&format!("the run's folder is left: {error}"));
        }
        // Another rank may have got the signal.
        let signal = terminal.received().or(interrupted.then_some(130));
        match (print(&text), signal) {
            // A terminal that was closed takes no text.
            (_, Some(code)) => Ok(ExitCode::from(code as u8)),
            (printed, None) => Ok(printed.map(|()| ExitCode::SUCCESS)?),
        }
    }

    /// Who does the steps.
    fn parallel(
        &self,
        plan: &Plan,
        communicator: &Arc<dyn Communicator>,
        files: Option<&Files>,
    ) -> Parallel {
        #[cfg(unix)]
        if plan.parallelism.has_workers() {
            let folder = files.and_then(|files| files.checkpointer.path().parent());
            let folder = folder.filter(|path| !path.as_os_str().is_empty());
            let folder = folder.unwrap_or(Path::new("."));
            return Parallel::Workers(self.workers.options(super::WORKER, folder));
        }
        if plan.parallelism.ranks > 1 {
            Parallel::Ranks(Arc::clone(communicator))
        } else {
            Parallel::Threads
        }
    }
}

/// What a run needs of this process: memory, and threads.
fn check_in(plan: &Plan, files: Option<&Files>) -> Result<ThreadPool, Failure> {
    if plan.parallelism.ranks > 1 {
        memory::check_rank(plan, files.is_some_and(|files| files.invocation.integrands > 0))?;
    }
    Ok(execution::pool(plan.parallelism.threads)?)
}

/// Whether a run takes so long that its phases are worth being timed before: some seconds.
fn is_long(plan: &Plan) -> bool {
    const SHORT: u64 = 1 << 23;
    let Options { draw, steps, .. } = plan.options;
    let draws = u64::from(steps).saturating_mul((draw.draws * draw.directions) as u64);
    draws > SHORT
        || plan.options.polish.steps > 0 && plan.options.shape.pixels() as u64 > SHORT >> 4
}

/// Checks that the run's folder is none of the files that it leaves.
///
/// # Errors
/// The file that it would be.
pub fn check_folder(outputs: &OutputFiles, folder: &Path) -> Result<(), Misuse> {
    match outputs.find(folder) {
        Some(file) => Err(Misuse(format!(
            "{} would be both an output and the run's folder: give another --out or --run-dir",
            file.display()
        ))),
        None => Ok(()),
    }
}
