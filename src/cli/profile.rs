//! `perceptile profile`: where time and memory traffic of a run's descent go.

mod scaling;

use std::fmt::Display;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use perceptile::format::write::{self, Existing};
use perceptile::profile::counters::Counters;
use perceptile::profile::machine::Machine;
use perceptile::profile::measure;
use perceptile::profile::picture;
use perceptile::profile::report::Profile;
use perceptile::profile::roofline::Rates;
use perceptile::profile::spans;
use perceptile::profile::subject::Subject;
#[cfg(unix)]
use perceptile::profile::workers::{self, WorkersProfile};
#[cfg(unix)]
use perceptile::run::backend::workers::WorkersOptions;
use perceptile::run::plan::Plan;
use perceptile::solver::Start;
use serde::Serialize;

use super::execution::{self, ExecutionArgs};
use super::exit::Failure;
use super::prepared;
use super::settings::SettingsArgs;
use super::stream;
use scaling::ScalingArgs;

/// Show where time and memory traffic of a run go
///
/// Takes the settings of `optimize` and does some steps of its descent, from a random start, with
/// and without probes. Shows how long the descent takes; time, bytes and operations of each stage, and where it stands under
/// what this machine can do; for layouts of the tile and orders of the draws the cache lines and
/// pages of a draw, and its misses on a model of this machine's caches; what the processor
/// counts, where it is allowed to; and what to do about all that. With workers, also what each of them
/// does, what it waits for and reads of others, and what it costs them to go in step. Writes no
/// tile.
///
/// With --scaling, measures what the parts of a step cost here, and predicts from them what a
/// cluster makes of it.
#[derive(Debug, Args)]
pub struct ProfileArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,

    /// Write what each thread did in a few steps, for Perfetto or chrome://tracing
    #[arg(long, value_name = "JSON")]
    trace: Option<PathBuf>,

    /// Draw stages, roofline and reuse of cache lines; or the speed-up by more ranks
    #[arg(long, value_name = "SVG", visible_alias = "picture")]
    svg: Option<PathBuf>,

    /// Seconds for each measurement, 0.01 to 600
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = parse_seconds)]
    measure: Duration,

    /// Replace files that exist
    #[arg(long)]
    force: bool,

    #[command(flatten)]
    scaling: ScalingArgs,

    #[command(flatten)]
    execution: ExecutionArgs,

    #[command(flatten, next_help_heading = "Settings of the run, as in optimize")]
    settings: SettingsArgs,
}

/// Most events of a trace: some ten megabytes.
const MOST_EVENTS: usize = 120_000;

/// Takes and shows the profile.
///
/// # Errors
/// Wrong settings, outputs that exist or cannot be written, too little memory.
pub fn run(args: &ProfileArgs) -> Result<(), Failure> {
    let nothing_set = args.settings == SettingsArgs::default();
    let (mut options, _) = args.settings.settings.options()?;
    options.validate()?;
    // Only the descent is looked at, from a random start.
    options.polish.steps = 0;
    options.start = Start::Random;
    let threads = args.execution.threads()?;
    let existing = Existing::from_force(args.force);
    if args.scaling.scaling {
        return scaling::run(args, (!nothing_set).then_some(options), threads);
    }
    let plan = Plan::new(&options, args.execution.parallelism()?)?;
    prepared::check(&plan)?;
    let subject = Subject::new(&options, &plan.kernel, threads)?;
    write::probe(args.trace.iter().chain(&args.svg), existing)?;
    let simd = args.execution.simd();
    let machine = Machine::detect();
    let rates = Rates::measure(&machine, simd, threads)?;
    // Counters see the threads that are started after them.
    let mut counters = Counters::open();
    let pool = execution::pool(threads)?;
    #[cfg_attr(not(unix), allow(unused_mut, reason = "workers add to it"))]
    let mut profile = pool
        .install(|| Profile::take(&subject, machine, rates, simd, args.measure, &mut counters))?;
    let most_events = 2 * MOST_EVENTS as u64;
    #[cfg(unix)]
    if plan.parallelism.has_workers() {
        // Nothing is to go wrong with them.
        let options = WorkersOptions {
            arguments: vec![super::WORKER.into()],
            pin: false,
            silence: Duration::from_secs(10),
            replacements: 0,
            faults: None,
            folder: std::env::temp_dir(),
        };
        let step = profile.whole.seconds;
        profile.workers = Some(WorkersProfile::take(&plan, simd, &options, step, args.measure)?);
        if let Some(path) = &args.trace {
            let spans = workers::spans(&plan, simd, &options, MOST_EVENTS)?;
            write::write(path, existing, |out| {
                spans::write_workers(out, threads, &spans, most_events)
            })?;
        }
    }
    if let Some(path) = &args.trace
        && !plan.parallelism.has_workers()
    {
        let (spans, steps) =
            pool.install(|| measure::spans(&subject, simd, &subject.start(), MOST_EVENTS))?;
        write::write(path, existing, |out| {
            spans::write(out, threads, &spans, &steps, most_events)
        })?;
    }
    show(args, &profile, picture::svg)
}

/// Draws what came out, if a picture is wanted, and prints it.
fn show<T: Serialize + Display>(
    args: &ProfileArgs,
    result: &T,
    svg: impl FnOnce(&T) -> String,
) -> Result<(), Failure> {
    if let Some(path) = &args.svg {
        let (picture, existing) = (svg(result), Existing::from_force(args.force));
        write::write(path, existing, |out| out.write_all(picture.as_bytes()))?;
    }
    Ok(stream::show(args.json, result, || result.to_string())?)
}

/// Reads the time of a measurement.
fn parse_seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("`{text}` is not a number of seconds"))?;
    if (0.01..=600.0).contains(&seconds) {
        Ok(Duration::from_secs_f64(seconds))
    } else {
        Err(format!("{text} is not in the range 0.01 to 600"))
    }
}
