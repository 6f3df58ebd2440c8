//! `perceptile optimize`: from options to a tile on the disk.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use perceptile::format::sidecar::{self, Sidecar};
use perceptile::format::source::TileSource;
use perceptile::format::write::Existing;
use perceptile::kernel::Kernel;
use perceptile::metric::{Domain, ScoreOptions, Scorer, Scores};
use perceptile::run::memory;
use perceptile::run::observer::{Observer, Progress};
use perceptile::run::outputs::Outputs;
use perceptile::run::phases;
use perceptile::run::signals::Signals;
use perceptile::solver::{Options, Phase, StopReason, Summary};

use super::execution::{self, ExecutionArgs};
use super::print;
use super::settings::Settings;

/// Make a sample tile
///
/// Writes NAME.npy, the tile (float32, frames x height x width x spp x dims), NAME.json, its
/// provenance and scores, and NAME.png, its first frame beside its XT slice. Without options it
/// makes the best 64x64x16 tile that a minute of two cores allows. The same settings and seed
/// give the same bytes on every machine and with any number of threads.
#[derive(Debug, Args)]
pub struct OptimizeArgs {
    #[command(flatten)]
    settings: Settings,

    /// Settings from a TOML file with the names of the flags; flags win
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Where the tile goes
    #[arg(long, value_name = "NPY", default_value = "tile.npy")]
    out: PathBuf,

    /// Replace files that exist
    #[arg(long)]
    force: bool,

    #[command(flatten)]
    execution: ExecutionArgs,

    /// Stop when this time is up, such as 90s, 10m or 2h, and write what there is
    #[arg(long, value_parser = parse_duration)]
    time: Option<Duration>,

    /// Integrands of each class that the tile is scored on at the end; 0 leaves scores out
    #[arg(long, value_name = "N", default_value_t = ScoreOptions::default().integrands)]
    integrands: usize,

    /// Say what the run would do and need, and stop
    #[arg(long)]
    dry_run: bool,
}

/// Makes the tile.
///
/// # Errors
/// Wrong settings, outputs that exist or cannot be written, too little memory.
pub fn run(args: OptimizeArgs) -> anyhow::Result<ExitCode> {
    let settings = match &args.config {
        Some(path) => args.settings.clone().or(Settings::read(path)?),
        None => args.settings.clone(),
    };
    let (options, start) = settings.clone().options()?;
    options.validate()?;
    let kernel = options.kernel.resolve(options.shape)?;
    options.check_kernel(&kernel)?;
    let score_options = ScoreOptions { integrands: args.integrands, ..ScoreOptions::default() };
    if args.integrands > 0 {
        score_options.validate()?;
    }
    let threads = args.execution.threads()?;
    memory::check(&options, &kernel, threads)?;
    if args.dry_run {
        print(&plan(&options, &kernel, threads))?;
        return Ok(ExitCode::SUCCESS);
    }
    let existing = Existing::from_force(args.force);
    let outputs = Outputs::of(&args.out);
    outputs.probe(existing)?;
    let start = start.map(|path| TileSource::new(path).read()).transpose()?;
    let simd = args.execution.simd();
    let pool = execution::pool(threads)?;
    let signals = Signals::install().context("cannot listen for signals")?;
    let begin = Instant::now();
    let mut watch = Watch {
        bar: progress_bar(),
        signals: signals.clone(),
        deadline: args.time.and_then(|time| begin.checked_add(time)),
        phase: Phase::Start,
    };
    let (tile, summary) =
        pool.install(|| phases::optimize(&options, start.as_ref(), simd, &mut watch))?;
    watch.bar.finish_and_clear();
    let seconds = begin.elapsed().as_secs_f64();
    // A stopped run is to end soon, so it is not scored.
    let scores = (args.integrands > 0 && signals.received().is_none())
        .then(|| {
            let taps = &kernel.classes()[0].taps;
            pool.install(|| Scorer::new(options.shape, taps, score_options)?.score(&tile))
        })
        .transpose()?;
    let provenance = Sidecar {
        format: sidecar::FORMAT,
        program: env!("CARGO_PKG_NAME").into(),
        version: env!("CARGO_PKG_VERSION").into(),
        command: command(&settings, &summary),
        kernel: options.kernel.to_string(),
        seed: options.seed,
        shape: options.shape,
        options: serde_json::json!({ "options": options, "summary": summary }),
        created: sidecar::utc(SystemTime::now()),
        seconds,
        sha256: sidecar::digest(&tile),
        scores: serde_json::json!(scores),
    };
    outputs.write(&tile, &provenance, existing)?;
    print(&report(&options, &summary, scores.as_ref(), &outputs, seconds))?;
    Ok(signals.received().map_or(ExitCode::SUCCESS, |code| ExitCode::from(code as u8)))
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
        if let Some(objective) = progress.objective {
            self.bar.set_message(format!("objective {objective:.6}"));
        } else {
            self.bar.set_message("");
        }
        self.bar.set_position(progress.done.into());
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

/// What `--dry-run` prints.
fn plan(options: &Options, kernel: &Kernel, threads: usize) -> String {
    let mut text = String::new();
    let mut line = |words: String| text += &(words + "\n");
    line(format!("tile        {}", options.shape));
    line(format!("kernel      {}", options.kernel));
    line(format!(
        "work        {} steps of {} draws, {} full-batch steps, {} warp frames",
        options.steps, options.draw.draws, options.polish.steps, options.warp.frames
    ));
    line(format!("memory      {} MB", memory::foreseen(options, kernel, threads) >> 20));
    line(format!("tile file   {:.1} MB", (options.shape.coordinates() * 4) as f64 / 1e6));
    text
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
