//! The command line: arguments as typed, then as planned, then run.
//!
//! Everything that is printed is printed here; the library never sees a flag.

mod candidates;
mod completions;
mod config;
mod display;
mod domain;
mod duration;
mod evaluate;
mod execution;
mod exit;
mod export;
mod integrands;
mod kernel;
mod man;
mod optimize;
mod perceived;
mod prepared;
mod presets;
mod profile;
mod progress;
mod ranks;
mod report;
mod resume;
mod run;
mod select;
mod settings;
mod source;
mod stream;
mod summary;
mod workers;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
#[cfg(unix)]
use perceptile::{profile::workers::take_part, run::backend::workers::task};
use perceptile_cluster::launcher::Launcher;

use config::MatchError;
use exit::Failure;
use stream::print;

/// Precompute spatio-temporal sample tiles for Monte Carlo animation rendering.
///
/// Exit codes: 0 done; 1 a file could not be read or written; 2 a wrong argument, option or
/// setting; 3 an output or an unfinished run exists (see --force), or another run is making it; 4
/// the run does not fit into memory; 5 too many workers were lost; 6 a tile has more error than
/// evaluate --require allows; 129, 130 or 143 stopped by a closed terminal, Ctrl-C or SIGTERM, with
/// the result so far written (a report is made whole or not at all).
#[derive(Debug, Parser)]
#[command(
    name = "perceptile",
    version = env!("PERCEPTILE_VERSION"),
    after_help = "`perceptile optimize` makes a tile in half a minute: begin there.",
    arg_required_else_help = true
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Optimize(Box<optimize::OptimizeArgs>),
    Resume(Box<resume::ResumeArgs>),
    Evaluate(evaluate::EvaluateArgs),
    Kernel(kernel::KernelArgs),
    Presets(presets::PresetsArgs),
    Select(Box<select::SelectArgs>),
    Export(export::ExportArgs),
    Profile(Box<profile::ProfileArgs>),
    Report(report::ReportArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
    /// Take part in a run as one of its workers; started by a coordinator only
    #[command(name = WORKER, hide = true)]
    Worker,
    /// Take part in a selection as one of its workers; started by a coordinator only
    #[command(name = SELECT_WORKER, hide = true)]
    SelectWorker,
}

impl Command {
    /// Whether several ranks can do it, or it is none's.
    fn is_for_ranks(&self) -> bool {
        use Command::{Optimize, Resume, Select, SelectWorker, Worker};
        matches!(self, Optimize(_) | Resume(_) | Select(_) | SelectWorker | Worker)
    }
}

/// The name of the command that makes this program a worker of a run.
const WORKER: &str = "worker";
/// The same for a selection.
const SELECT_WORKER: &str = "select-worker";

/// Runs the command that the process was started with.
pub fn main() -> ExitCode {
    let launcher = Launcher::detect(|name| std::env::var(name).ok());
    // Ranks with the same arguments fail the same before they can talk. The first one says so; the
    // others leave without a failure, as launchers end all ranks at the first one.
    let is_first = launcher.is_none_or(|launcher| launcher.rank == 0);
    let typed: Vec<OsString> = std::env::args_os().collect();
    let parsed = config::matches(&Arguments::command(), &typed)
        .and_then(|matches| Ok((Arguments::from_arg_matches(&matches)?.command, matches)));
    match parsed.map(|(command, matches)| run(command, &matches, launcher)) {
        Ok(Ok(code)) => code,
        Ok(Err(failure)) | Err(MatchError::File(failure)) if is_first => failure.report(),
        Err(MatchError::Clap(error)) if is_first => error.exit(),
        _ => ExitCode::SUCCESS,
    }
}

/// Runs a command, as one of the ranks of a launcher if there is one.
fn run(
    command: Command,
    matches: &ArgMatches,
    launcher: Option<Launcher>,
) -> Result<ExitCode, Failure> {
    if let (Command::Optimize(args), Some((name, matches))) = (&command, matches.subcommand())
        && args.print_config
    {
        let program = Arguments::command();
        let optimize = program.find_subcommand(name).expect("the command that was matched");
        print(&config::file(optimize, matches, args.effective()?))?;
        return Ok(ExitCode::SUCCESS);
    }
    if !command.is_for_ranks() {
        ranks::check_alone(launcher, "only `optimize`, `resume` and `select` are for several")?;
    }
    let done = |()| ExitCode::SUCCESS;
    match command {
        Command::Optimize(args) => ranks::together(launcher, |ranks| optimize::run(&args, ranks)),
        Command::Resume(args) => ranks::together(launcher, |ranks| resume::run(&args, ranks)),
        Command::Evaluate(args) => evaluate::run(args).map(done),
        Command::Kernel(args) => kernel::run(args).map(done),
        Command::Presets(args) => presets::run(&args).map(done),
        Command::Select(args) => ranks::together(launcher, |ranks| select::run(&args, ranks)),
        Command::Export(args) => export::run(&args).map(done),
        Command::Profile(args) => profile::run(&args).map(done),
        Command::Report(args) => report::run(args),
        Command::Completions(args) => completions::run(&args, Arguments::command()).map(done),
        Command::Man(args) => man::run(&args, Arguments::command()).map(done),
        #[cfg(unix)]
        Command::Worker => Ok(task::serve(&take_part).map(done)?),
        #[cfg(unix)]
        Command::SelectWorker => Ok(perceptile::select::workers::serve().map(done)?),
        #[cfg(not(unix))]
        Command::Worker | Command::SelectWorker => Err(execution::no_workers().into()),
    }
}
