//! `perceptile profile`: where time and memory traffic of a run's descent go.

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
use perceptile::run::memory;
use perceptile::run::program::Program;

use super::execution::{self, ExecutionArgs};
use super::print;
use super::settings::Settings;

/// Show where time and memory traffic of a run go
///
/// Takes the settings of `optimize` and does some steps of its descent, from a random start, with
/// and without probes. Shows time, bytes and operations of each stage, and where it stands under
/// what this machine can do; for layouts of the tile and orders of the draws the cache lines and
/// pages of a draw, and its misses on a model of this machine's caches; what the processor
/// counts, where it is allowed to tell; and what to do about all that. Writes no tile.
#[derive(Debug, Args)]
pub struct ProfileArgs {
    #[command(flatten)]
    settings: Settings,

    /// Settings from a TOML file with the names of the flags; flags win
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Print JSON
    #[arg(long)]
    json: bool,

    /// Write what each thread did in a few steps, for Perfetto or chrome://tracing
    #[arg(long, value_name = "JSON")]
    trace: Option<PathBuf>,

    /// Draw stages, roofline and reuse of cache lines
    #[arg(long, value_name = "SVG")]
    svg: Option<PathBuf>,

    /// Seconds for each measurement, 0.01 to 600
    #[arg(long, value_name = "SECONDS", default_value = "1", value_parser = parse_seconds)]
    measure: Duration,

    /// Replace files that exist
    #[arg(long)]
    force: bool,

    #[command(flatten)]
    execution: ExecutionArgs,
}

/// Most events of a trace: some ten megabytes.
const MOST_EVENTS: usize = 120_000;

/// Takes and shows the profile.
///
/// # Errors
/// Wrong settings, outputs that exist or cannot be written, too little memory.
pub fn run(args: ProfileArgs) -> anyhow::Result<()> {
    let settings = match &args.config {
        Some(path) => args.settings.or(Settings::read(path)?),
        None => args.settings,
    };
    let (mut options, _) = settings.options()?;
    options.validate()?;
    // Only the descent is looked at.
    options.polish.steps = 0;
    let threads = args.execution.threads()?;
    let program = Program::new(&options, args.execution.team()?)?;
    memory::check(&program)?;
    let kernel = program.kernel;
    let subject = Subject::new(&options, &kernel, threads)?;
    let existing = Existing::from_force(args.force);
    write::probe(args.trace.iter().chain(&args.svg), existing)?;
    let simd = args.execution.simd();
    let machine = Machine::detect();
    let rates = Rates::measure(&machine, simd, threads)?;
    // Counters see the threads that are started after them.
    let mut counters = Counters::open();
    let pool = execution::pool(threads)?;
    let profile = pool
        .install(|| Profile::take(&subject, machine, rates, simd, args.measure, &mut counters))?;
    if let Some(path) = &args.trace {
        let (spans, steps) =
            pool.install(|| measure::spans(&subject, simd, &subject.start(), MOST_EVENTS))?;
        write::write(path, existing, |out| {
            spans::write(out, threads, &spans, &steps, 2 * MOST_EVENTS as u64)
        })?;
    }
    if let Some(path) = &args.svg {
        let picture = picture::svg(&profile);
        write::write(path, existing, |out| out.write_all(picture.as_bytes()))?;
    }
    if args.json {
        print(&(serde_json::to_string_pretty(&profile)? + "\n"))
    } else {
        print(&profile.to_string())
    }
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
