//! Carrying a run out, from its start or from a checkpoint, and leaving its files.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use perceptile::format::sidecar::{self, Sidecar};
use perceptile::format::write::Existing;
use perceptile::gradient::simd::Simd;
use perceptile::metric::{Domain, ScoreOptions, Scorer, Scores};
use perceptile::run::begin::Begin;
#[cfg(unix)]
use perceptile::run::crew::{self, CrewOptions, CrewSummary};
use perceptile::run::keeper::{Every, Keeper};
use perceptile::run::memory;
use perceptile::run::observer::{Observer, Progress};
use perceptile::run::outputs::Outputs;
use perceptile::run::phases;
use perceptile::run::program::Program;
use perceptile::run::ranks::{self as cluster, RanksSummary};
use perceptile::run::signals::Signals;
use perceptile::solver::{Options, Phase, StopReason, Summary};
use perceptile::tile::{Tile, TileShape};
use perceptile_cluster::faults::FaultPlan;
use perceptile_cluster::peers::Peers;
use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

use super::execution::{self, ExecutionArgs};
use super::ranks::{self, Prepared, Told};
use super::settings::Settings;
use super::{Misuse, print};

/// How a run is kept, looked after and ended; of no influence on the tile unless it is stopped.
#[derive(Debug, Args)]
pub struct CarryArgs {
    /// Stop when this time is up, such as 90s, 10m or 2h, and write what there is
    #[arg(long, value_parser = parse_duration)]
    time: Option<Duration>,

    /// Write a checkpoint every so often, such as 60s, 10m or 500steps
    #[arg(long, value_name = "EVERY", default_value = "60s")]
    checkpoint: Every,

    /// Bind each worker to cores of its own, in one NUMA node, with its memory there
    #[arg(long)]
    pin: bool,

    /// Workers that may be lost and replaced before the run is given up
    #[arg(long, value_name = "N", default_value_t = 16)]
    replacements: u32,

    /// A worker that gives no sign of life for so long counts as lost
    #[arg(long, value_name = "TIME", default_value = "3s", value_parser = parse_silence)]
    silence: Duration,

    /// Make workers fail on purpose: the mean life of one and the share that hangs, as 500ms,0.25
    #[arg(long, value_name = "PLAN", hide = true)]
    faults: Option<FaultPlan>,
}

/// What a run was asked for, as its checkpoints keep it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Invocation {
    /// The settings.
    pub settings: Settings,
    /// Where the tile goes.
    pub out: PathBuf,
    /// Integrands of each class that it is scored on.
    pub integrands: usize,
}

/// A run that is ready to be carried out.
pub struct Ready {
    /// What it was asked for.
    pub invocation: Invocation,
    /// What its ranks do.
    pub program: Program,
    /// What it begins with, until it does.
    pub begin: Option<Begin>,
    /// Whether its files may be replaced.
    pub existing: Existing,
    /// Who writes its checkpoints.
    pub keeper: Keeper,
}

impl CarryArgs {
    /// How often a checkpoint is written.
    pub fn checkpoint(&self) -> Every {
        self.checkpoint
    }

    /// Checks that what is asked of workers is asked of workers, and that there are not both
    /// workers and ranks.
    ///
    /// # Errors
    /// Flags that do not go together.
    pub fn check(&self, execution: &ExecutionArgs, ranks: usize) -> Result<(), Misuse> {
        if execution.workers() == 0 && (self.pin || self.faults.is_some()) {
            return Err(Misuse("--pin is for worker processes: see --workers".into()));
        }
        if execution.workers() > 0 && ranks > 1 {
            return Err(Misuse("ranks have threads and no workers: leave out --workers".into()));
        }
        if cfg!(not(unix)) && execution.workers() > 0 {
            return Err(Misuse("there are no worker processes on this system".into()));
        }
        Ok(())
    }

    /// Carries out the run that `prepare` gets ready, if it does, and writes its files; as one of
    /// several ranks, if there are any.
    ///
    /// # Errors
    /// What `prepare` reports, outputs that cannot be written, too little memory, workers that are
    /// lost.
    pub fn run(
        &self,
        execution: &ExecutionArgs,
        peers: Option<Arc<dyn Peers>>,
        prepare: impl FnOnce() -> anyhow::Result<Option<Ready>>,
    ) -> anyhow::Result<ExitCode> {
        // One rank may have workers.
        let Some(peers) = peers.filter(|_| execution.workers() == 0) else {
            let Some(ready) = prepare()? else { return Ok(ExitCode::SUCCESS) };
            let site = self.site(ready.program.team.threads, execution)?;
            let (product, site, ready) = self.make_alone(ready, execution, site)?;
            return finish(product, site, ready);
        };
        // The root says what went wrong while the others still wait for it.
        let code = self.run_as_rank(&peers, execution, prepare);
        let code = code.map_err(|error| match peers.rank() {
            0 => ranks::tell(error),
            _ => Told(super::exit_code(&error)),
        });
        // What the root still does needs the others' cores, not their company.
        peers.rest();
        Ok(code?)
    }

    /// Does what this rank has to do in a run. Whatever goes wrong, all ranks come to an end.
    fn run_as_rank(
        &self,
        peers: &Arc<dyn Peers>,
        execution: &ExecutionArgs,
        prepare: impl FnOnce() -> anyhow::Result<Option<Ready>>,
    ) -> anyhow::Result<ExitCode> {
        match ranks::share(&**peers, execution.threads()?, prepare)? {
            Prepared::Ended(code) => Ok(ExitCode::from(code)),
            Prepared::Root(ready) => {
                let keeps_whole = ready.invocation.integrands > 0;
                let site = self.check_in(peers, &ready.program, execution, keeps_whole)?;
                let (product, site, ready) = make_as_root(peers, *ready, site)?;
                finish(product, site, ready)
            }
            Prepared::Other(program, begin) => {
                let mut site = self.check_in(peers, &program, execution, false)?;
                let Site { pool, simd, watch, .. } = &mut site;
                let made = pool.install(|| {
                    cluster::carry_out(&program, begin, *simd, Arc::clone(peers), watch, None)
                })?;
                made.gather(&mut |_| Ok(()))?;
                Ok(ExitCode::SUCCESS)
            }
        }
    }

    /// What a run needs of this process, on all ranks or on none.
    fn check_in(
        &self,
        peers: &Arc<dyn Peers>,
        program: &Program,
        execution: &ExecutionArgs,
        keeps_whole: bool,
    ) -> anyhow::Result<Site> {
        let site = || {
            memory::check_rank(program, keeps_whole)?;
            let mut site = self.site(program.team.threads, execution)?;
            if peers.rank() > 0 {
                site.watch.bar = ProgressBar::hidden();
            }
            Ok(site)
        };
        ranks::agree(&**peers, site())
    }

    /// What a run needs of this process.
    fn site(&self, threads: usize, execution: &ExecutionArgs) -> anyhow::Result<Site> {
        let signals = Signals::install().context("cannot listen for signals")?;
        let started = Instant::now();
        let watch = Watch {
            bar: progress_bar(),
            signals: signals.clone(),
            deadline: self.time.and_then(|time| started.checked_add(time)),
            phase: Phase::Start,
        };
        let pool = execution::pool(threads)?;
        Ok(Site { pool, simd: execution.simd(), signals, started, watch })
    }

    /// Makes the tile by this process and its workers.
    fn make_alone(
        &self,
        mut ready: Ready,
        execution: &ExecutionArgs,
        mut site: Site,
    ) -> anyhow::Result<(Product, Site, Ready)> {
        let Site { pool, simd, watch, .. } = &mut site;
        let Ready { program, begin, keeper, .. } = &mut ready;
        let begin = begin.take().expect("a run begins once");
        #[cfg(unix)]
        if execution.workers() > 0 {
            let options = self.crew(keeper);
            // The workers end with the thread that starts them: this one.
            let made = crew::carry_out(program, begin, *simd, &options, watch, Some(keeper));
            let (tile, summary, crew) = made?;
            let who = Who::Crew(crew);
            return Ok((Product { tile: TileIn::One(tile), summary, who }, site, ready));
        }
        let made = pool.install(|| phases::carry_out(program, begin, *simd, watch, Some(keeper)));
        let (tile, summary) = made?;
        Ok((Product { tile: TileIn::One(tile), summary, who: Who::Alone }, site, ready))
    }

    #[cfg(unix)]
    fn crew(&self, keeper: &Keeper) -> CrewOptions {
        let beside = keeper.path().parent().filter(|path| !path.as_os_str().is_empty());
        CrewOptions {
            arguments: vec![super::WORKER.into()],
            pin: self.pin,
            silence: self.silence,
            replacements: self.replacements,
            faults: self.faults,
            folder: beside.unwrap_or(Path::new(".")).to_owned(),
        }
    }
}

/// What a run works with in this process.
struct Site {
    pool: ThreadPool,
    simd: Simd,
    signals: Signals,
    started: Instant,
    watch: Watch,
}

/// What a run has made.
struct Product {
    tile: TileIn,
    summary: Summary,
    who: Who,
}

/// Where a tile is.
enum TileIn {
    /// Here.
    One(Tile),
    /// On all ranks.
    Regions(Box<cluster::Made>),
}

/// Who made it, besides the threads of this process.
enum Who {
    Alone,
    #[cfg(unix)]
    Crew(CrewSummary),
    Ranks(RanksSummary),
}

/// Makes the tile as the root of several ranks.
fn make_as_root(
    peers: &Arc<dyn Peers>,
    mut ready: Ready,
    mut site: Site,
) -> anyhow::Result<(Product, Site, Ready)> {
    let Site { pool, simd, watch, .. } = &mut site;
    let Ready { program, begin, keeper, .. } = &mut ready;
    let begin = begin.take().expect("a run begins once");
    let made = pool.install(|| {
        cluster::carry_out(program, begin, *simd, Arc::clone(peers), watch, Some(keeper))
    })?;
    let (summary, who) = (made.summary.clone(), Who::Ranks(made.ranks.clone()));
    Ok((Product { tile: TileIn::Regions(Box::new(made)), summary, who }, site, ready))
}

/// Scores a tile, writes the files of a run and tells of it.
fn finish(product: Product, site: Site, ready: Ready) -> anyhow::Result<ExitCode> {
    let Product { mut tile, summary, who } = product;
    let Site { pool, signals, started, mut watch, .. } = site;
    let Ready { invocation, program, existing, keeper, .. } = ready;
    let options = &program.options;
    let outputs = Outputs::of(&invocation.out);
    watch.bar.finish_and_clear();
    let seconds = started.elapsed().as_secs_f64();
    // A stopped run is to end soon, so it is not scored.
    let is_stopped = summary.reason == StopReason::Interrupted || signals.received().is_some();
    let scores = if invocation.integrands > 0 && !is_stopped {
        if let TileIn::Regions(made) = &tile {
            tile = TileIn::One(whole(made, options.shape)?);
        }
        let score_options =
            ScoreOptions { integrands: invocation.integrands, ..ScoreOptions::default() };
        let taps = &program.kernel.classes()[0].taps;
        match &tile {
            TileIn::One(tile) => {
                let scored =
                    pool.install(|| Scorer::new(options.shape, taps, score_options)?.score(tile));
                Some(scored?)
            }
            TileIn::Regions(_) => None,
        }
    } else {
        None
    };
    let mut told = serde_json::json!({ "options": options, "summary": summary });
    match &who {
        Who::Alone => (),
        #[cfg(unix)]
        Who::Crew(crew) => told["workers"] = serde_json::json!(crew),
        Who::Ranks(ranks) => told["ranks"] = serde_json::json!(ranks),
    }
    let provenance = |sha256| Sidecar {
        format: sidecar::FORMAT,
        program: env!("CARGO_PKG_NAME").into(),
        version: env!("CARGO_PKG_VERSION").into(),
        command: command(&invocation.settings, &summary),
        kernel: options.kernel.to_string(),
        seed: options.seed,
        shape: options.shape,
        options: told,
        created: sidecar::utc(SystemTime::now()),
        seconds,
        sha256,
        scores: serde_json::json!(scores),
        convergence: summary.convergence.clone(),
    };
    match &tile {
        TileIn::One(tile) => outputs.write(tile, existing, provenance)?,
        TileIn::Regions(made) => {
            let mut gathered = false;
            let written = outputs.write_streamed(
                options.shape,
                existing,
                &mut |put| {
                    gathered = true;
                    made.gather(put)
                },
                provenance,
            );
            // Others send their regions, wanted or not.
            if !gathered {
                made.gather(&mut |_| Ok(()))?;
            }
            written?;
        }
    }
    let mut text = report(options, &summary, scores.as_ref(), &outputs, seconds);
    match &who {
        Who::Alone => (),
        #[cfg(unix)]
        Who::Crew(crew) => text += &crew_report(crew),
        Who::Ranks(ranks) => text += &ranks_report(ranks),
    }
    let stopped = matches!(summary.reason, StopReason::Interrupted | StopReason::Time);
    if stopped && keeper.has_saved() {
        text += &format!("to go on    perceptile resume {}\n", keeper.path().display());
    } else if let Err(error) = keeper.remove() {
        watch.tell(&format!("the run's folder is left: {error}"));
    }
    print(&text)?;
    // Another rank may have got the signal.
    let interrupted = (summary.reason == StopReason::Interrupted).then_some(130);
    let code = signals.received().or(interrupted);
    Ok(code.map_or(ExitCode::SUCCESS, |code| ExitCode::from(code as u8)))
}

/// A tile put together from all ranks.
fn whole(made: &cluster::Made, shape: TileShape) -> anyhow::Result<Tile> {
    let mut samples = Vec::with_capacity(shape.coordinates());
    made.gather(&mut |piece| {
        samples.extend_from_slice(piece);
        Ok(())
    })?;
    Ok(Tile::new(shape, samples)?)
}

/// The command that makes the same tile again.
fn command(settings: &Settings, summary: &Summary) -> String {
    let mut settings = settings.clone();
    if summary.reason != StopReason::Completed {
        settings.stop_after = Some(summary.steps);
    }
    let words = ["perceptile".into(), "optimize".into()].into_iter();
    super::line(words.chain(settings.command_line()))
}

/// Shows progress to people, and stops the run for signals and the clock.
struct Watch {
    bar: ProgressBar,
    signals: Signals,
    deadline: Option<Instant>,
    phase: Phase,
}

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) {
        if progress.phase != self.phase {
            self.phase = progress.phase;
            self.bar.reset();
            self.bar.set_length(progress.of.into());
            self.bar.set_prefix(progress.phase.name());
        }
        let mut words = Vec::new();
        if let Some(objective) = progress.objective {
            words.push(format!("objective {objective:.6}"));
        }
        match progress.workers {
            Some((workers, 0)) => words.push(format!("{workers} workers")),
            Some((workers, lost)) => words.push(format!("{workers} workers, {lost} replaced")),
            None => (),
        }
        self.bar.set_message(words.join(", "));
        self.bar.set_position(progress.done.into());
    }

    fn tell(&mut self, message: &str) {
        self.bar.suspend(|| eprintln!("{message}"));
    }

    fn stop(&self) -> Option<StopReason> {
        if self.signals.received().is_some() {
            Some(StopReason::Interrupted)
        } else if self.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            Some(StopReason::Time)
        } else {
            None
        }
    }
}

/// A bar on the standard error stream; hidden if that is no terminal.
fn progress_bar() -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let template = "{prefix:8} {bar:32} {pos}/{len} steps, {per_sec}, ETA {eta}  {msg}";
    ProgressBar::no_length()
        .with_style(ProgressStyle::with_template(template).expect("a valid template"))
}

/// What a run prints when it is over.
fn report(
    options: &Options,
    summary: &Summary,
    scores: Option<&Scores>,
    outputs: &Outputs,
    seconds: f64,
) -> String {
    let mut text = String::new();
    let mut line = |words: String| text += &(words + "\n");
    let reason = match summary.reason {
        StopReason::Completed => "all steps done",
        StopReason::StopAfter => "stopped where asked",
        StopReason::Interrupted => "interrupted: this is the tile so far",
        StopReason::Time => "time is up: this is the tile so far",
    };
    line(format!("{}: {reason}, {} steps in {seconds:.1} s", options.shape, summary.steps));
    if let (Some(before), Some(after)) = (summary.objective_before, summary.objective_after) {
        line(format!("objective   {before:.6} -> {after:.6} (mean W2^2 of a draw)"));
    }
    let phases: Vec<String> = summary
        .seconds
        .iter()
        .map(|(phase, seconds)| format!("{} {seconds:.1} s", phase.name()))
        .collect();
    line(format!("phases      {}", phases.join(", ")));
    if let Some(scores) = scores {
        line("scores      (white noise is 1, lower is better)".into());
        for class in &scores.classes {
            let pairs = if class.domain == Domain::Pairs { ", pairs" } else { "" };
            let name = format!("{}{pairs}", class.class);
            let perceived = class.perceived;
            line(format!("  {name:22} {:.4} +- {:.4}", perceived.mean, perceived.standard_error));
        }
        let histogram = scores.histogram;
        line(format!("  {:22} {:.2}", "bias * sqrt(N)", scores.bias));
        line(format!(
            "  {:22} {:.2}-{:.2} (rms {:.3})",
            "histogram", histogram.smallest, histogram.largest, histogram.rms
        ));
        line(format!("  {:22} {:.3}", "residual", scores.residual));
    }
    line(format!("tile        {}", outputs.tile.display()));
    line(format!("picture     {}", outputs.picture.display()));
    line(format!("provenance  {}", outputs.sidecar.display()));
    text
}

/// What a run by worker processes prints besides.
#[cfg(unix)]
fn crew_report(crew: &CrewSummary) -> String {
    let mut text = format!(
        "workers     {}, {} replaced, imbalance {:.2} (the longest work against the mean)\n",
        crew.workers.len(),
        crew.replaced,
        crew.imbalance
    );
    text += "            work s  waiting s      jobs  of others  MB of others\n";
    for (rank, worker) in crew.workers.iter().enumerate() {
        text += &format!(
            "  {rank:<8} {:>7.1} {:>10.1} {:>9} {:>10} {:>13.1}\n",
            worker.busy,
            worker.waiting,
            worker.jobs,
            worker.taken,
            worker.traffic as f64 / 1e6
        );
    }
    if !crew.faults.is_empty() {
        let faults = crew.faults.iter().map(|(place, count)| format!("{place} {count}"));
        text += &format!("faults      {}\n", faults.collect::<Vec<String>>().join(", "));
    }
    text
}

/// What a run by several ranks prints besides.
fn ranks_report(ranks: &RanksSummary) -> String {
    let mut text = format!(
        "ranks       {}, imbalance {:.2} (the longest work against the mean)\n",
        ranks.ranks.len(),
        ranks.imbalance
    );
    text += "                region   work s  waiting s  MB of halos  peak MB\n";
    for (rank, it) in ranks.ranks.iter().enumerate() {
        let [width, height] = it.size;
        text += &format!(
            "  {rank:<8} {:>11} {:>8.1} {:>10.1} {:>12.1} {:>8.0}\n",
            format!("{width}x{height}"),
            it.busy,
            it.waiting,
            it.traffic as f64 * 1e-6,
            it.peak as f64 * 1e-6
        );
    }
    text
}

/// Reads `90s`, `10m`, `2h` or a number of seconds.
fn parse_duration(text: &str) -> Result<Duration, String> {
    let (number, unit) = match text.find(|c: char| c.is_ascii_alphabetic()) {
        Some(at) => text.split_at(at),
        None => (text, "s"),
    };
    let factor = match unit {
        "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("the unit of `{text}` must be s, m or h")),
    };
    let seconds: f64 = number.parse().map_err(|_| format!("`{text}` is not a time such as 10m"))?;
    Duration::try_from_secs_f64(seconds * factor)
        .map_err(|_| format!("`{text}` is not a time that can pass"))
}

/// Reads the time after which a worker counts as lost.
fn parse_silence(text: &str) -> Result<Duration, String> {
    let time = parse_duration(text)?;
    let range = Duration::from_millis(200)..=Duration::from_secs(3600);
    if range.contains(&time) { Ok(time) } else { Err(format!("{text} is not from 0.2s to 1h")) }
}
