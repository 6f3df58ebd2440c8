//! Carrying a run out, from its start or from a checkpoint, and leaving its files.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use perceptile::format::sidecar::{self, Sidecar};
use perceptile::format::write::Existing;
use perceptile::metric::{Domain, ScoreOptions, Scorer, Scores};
use perceptile::run::begin::Begin;
#[cfg(unix)]
use perceptile::run::crew::{self, CrewOptions, CrewSummary};
use perceptile::run::keeper::{Every, Keeper};
use perceptile::run::observer::{Observer, Progress};
use perceptile::run::outputs::Outputs;
use perceptile::run::phases;
use perceptile::run::program::Program;
use perceptile::run::signals::Signals;
use perceptile::solver::{Options, Phase, StopReason, Summary};
use perceptile_cluster::faults::FaultPlan;
use serde::{Deserialize, Serialize};

use super::execution::{self, ExecutionArgs};
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
    /// What it begins with.
    pub begin: Begin,
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

    /// Checks that what is asked of workers is asked of workers.
    ///
    /// # Errors
    /// Flags for workers where there are none.
    pub fn check(&self, execution: &ExecutionArgs) -> Result<(), Misuse> {
        if execution.workers() == 0 && (self.pin || self.faults.is_some()) {
            return Err(Misuse("--pin is for worker processes: see --workers".into()));
        }
        if cfg!(not(unix)) && execution.workers() > 0 {
            return Err(Misuse("there are no worker processes on this system".into()));
        }
        Ok(())
    }

    /// Carries a run out and writes its files.
    ///
    /// # Errors
    /// Outputs that cannot be written, too little memory, workers that are lost.
    pub fn carry_out(&self, ready: Ready, execution: &ExecutionArgs) -> anyhow::Result<ExitCode> {
        let Ready { invocation, program, begin, existing, mut keeper } = ready;
        let outputs = Outputs::of(&invocation.out);
        let options = program.options.clone();
        let signals = Signals::install().context("cannot listen for signals")?;
        let started = Instant::now();
        let mut watch = Watch {
            bar: progress_bar(),
            signals: signals.clone(),
            deadline: self.time.and_then(|time| started.checked_add(time)),
            phase: Phase::Start,
        };
        let simd = execution.simd();
        let pool = execution::pool(program.team.threads)?;
        #[cfg(unix)]
        let (tile, summary, crew) = if execution.workers() > 0 {
            let options = self.crew(&keeper);
            // The workers end with the thread that starts them: this one.
            let made =
                crew::carry_out(&program, begin, simd, &options, &mut watch, Some(&mut keeper));
            let (tile, summary, crew) = made?;
            (tile, summary, Some(crew))
        } else {
            let (tile, summary) = pool.install(|| {
                phases::carry_out(&program, begin, simd, &mut watch, Some(&mut keeper))
            })?;
            (tile, summary, None)
        };
        #[cfg(not(unix))]
        let (tile, summary) = pool
            .install(|| phases::carry_out(&program, begin, simd, &mut watch, Some(&mut keeper)))?;
        watch.bar.finish_and_clear();
        let seconds = started.elapsed().as_secs_f64();
        // A stopped run is to end soon, so it is not scored.
        let score_options =
            ScoreOptions { integrands: invocation.integrands, ..ScoreOptions::default() };
        let scores = (invocation.integrands > 0 && signals.received().is_none())
            .then(|| {
                let taps = &program.kernel.classes()[0].taps;
                pool.install(|| Scorer::new(options.shape, taps, score_options)?.score(&tile))
            })
            .transpose()?;
        #[cfg(unix)]
        let told = serde_json::json!({ "options": options, "summary": summary, "workers": crew });
        #[cfg(not(unix))]
        let told = serde_json::json!({ "options": options, "summary": summary });
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
        };
        outputs.write(&tile, existing, provenance)?;
        let mut text = report(&options, &summary, scores.as_ref(), &outputs, seconds);
        #[cfg(unix)]
        if let Some(crew) = &crew {
            text += &crew_report(crew);
        }
        let stopped = matches!(summary.reason, StopReason::Interrupted | StopReason::Time);
        if stopped && keeper.has_saved() {
            text += &format!("to go on    perceptile resume {}\n", keeper.path().display());
        } else if let Err(error) = keeper.remove() {
            watch.tell(&format!("the run's folder is left: {error}"));
        }
        print(&text)?;
        Ok(signals.received().map_or(ExitCode::SUCCESS, |code| ExitCode::from(code as u8)))
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

/// The command that makes the same tile again.
fn command(settings: &Settings, summary: &Summary) -> String {
    let mut settings = settings.clone();
    if summary.reason != StopReason::Completed {
        settings.stop_after = Some(summary.steps);
    }
    let quote = |word: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
        if word.chars().all(plain) { word } else { format!("'{}'", word.replace('\'', r"'\''")) }
    };
    let words = ["perceptile".into(), "optimize".into()].into_iter();
    words.chain(settings.command_line()).map(quote).collect::<Vec<String>>().join(" ")
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
