//! The command line: arguments as typed, then as planned, then run.
//!
//! Everything that is printed is printed here; the library never sees a flag.

mod candidates;
mod carry;
mod evaluate;
mod execution;
mod export;
mod kernel;
mod optimize;
mod profile;
mod ranks;
mod report;
mod resume;
mod settings;
mod source;
mod stream;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use perceptile::format::write::WriteError;
use perceptile::kernel::{KernelError, ResolveProblem};
use perceptile::metric::ScoreError;
use perceptile::report::ReportError;
#[cfg(unix)]
use perceptile::run::crew::CrewError;
use perceptile::run::folder::FolderError;
use perceptile::run::memory::MemoryError;
use perceptile::run::program::ProgramError;
use perceptile::solver::OptionsError;

use stream::{print, say};

/// Precompute spatio-temporal sample tiles for Monte Carlo animation rendering.
///
/// Exit codes: 0 done; 1 a file could not be read or written; 2 a wrong argument, option or
/// setting; 3 an output or an unfinished run exists (see --force); 4 the run does not fit into
/// memory; 5 too many workers were lost; 130 or 143 stopped by Ctrl-C or SIGTERM, with the result
/// so far written (a report is made whole or not at all).
#[derive(Debug, Parser)]
#[command(name = "perceptile", version, arg_required_else_help = true)]
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
    Export(export::ExportArgs),
    Profile(Box<profile::ProfileArgs>),
    Report(report::ReportArgs),
    /// Take part in a run as one of its workers; started by a coordinator only
    #[command(name = WORKER, hide = true)]
    Worker,
}

/// The name of the command that makes this program a worker.
const WORKER: &str = "worker";

/// Something is wrong with what was asked for, rather than with the machine.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Misuse(String);

/// Runs the command that the process was started with.
pub fn main() -> ExitCode {
    let launcher = ranks::launcher();
    // Of ranks that are told the same, one answers.
    let is_first = launcher.is_none_or(|launcher| launcher.rank == 0);
    let command = match Arguments::try_parse() {
        Ok(arguments) => arguments.command,
        Err(error) if is_first => error.exit(),
        Err(error) => {
            ranks::let_first_speak();
            return ExitCode::from(error.exit_code() as u8);
        }
    };
    let alone = match &command {
        Command::Optimize(_) | Command::Resume(_) | Command::Worker => Ok(()),
        _ => ranks::check_alone(launcher, "only `optimize` and `resume` are for several"),
    };
    let result = alone.map_err(Into::into).and_then(|()| match command {
        Command::Optimize(args) => optimize::run(*args, ranks::join(launcher)?),
        Command::Resume(args) => resume::run(*args, ranks::join(launcher)?),
        Command::Evaluate(args) => evaluate::run(args).map(|()| ExitCode::SUCCESS),
        Command::Kernel(args) => kernel::run(args).map(|()| ExitCode::SUCCESS),
        Command::Export(args) => export::run(args).map(|()| ExitCode::SUCCESS),
        Command::Profile(args) => profile::run(*args).map(|()| ExitCode::SUCCESS),
        Command::Report(args) => report::run(args),
        Command::Worker => work().map(|()| ExitCode::SUCCESS),
    });
    result.unwrap_or_else(|error| {
        if !is_first && !error.is::<ranks::Told>() {
            ranks::let_first_speak();
            return ExitCode::from(exit_code(&error));
        }
        ExitCode::from(ranks::tell(error).0)
    })
}

/// Takes part in a run.
#[cfg(unix)]
fn work() -> anyhow::Result<()> {
    Ok(perceptile::run::worker::serve(&perceptile::profile::crew::take_part)?)
}

/// There are no workers here.
#[cfg(not(unix))]
fn work() -> anyhow::Result<()> {
    Err(Misuse("there are no worker processes on this system".into()).into())
}

/// Words as one line for a shell.
fn line(words: impl Iterator<Item = String>) -> String {
    let quote = |word: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
        let bare = !word.is_empty() && word.chars().all(plain);
        if bare { word } else { format!("'{}'", word.replace('\'', r"'\''")) }
    };
    words.map(quote).collect::<Vec<String>>().join(" ")
}

/// The exit codes of failures, in one place.
fn exit_code(error: &anyhow::Error) -> u8 {
    if let Some(ranks::Told(code)) = error.downcast_ref() {
        return *code;
    }
    #[cfg(unix)]
    if let Some(error) = error.downcast_ref::<CrewError>() {
        return match error {
            CrewError::Lost { .. } => 5,
            CrewError::Memory(_) | CrewError::Program(ProgramError::Memory(_)) => 4,
            CrewError::Place(_) | CrewError::Program(ProgramError::Options(_)) => 2,
            _ => 1,
        };
    }
    if matches!(
        error.downcast_ref(),
        Some(WriteError::Exists { .. } | WriteError::Beside { .. } | WriteError::Foreign { .. })
    ) || matches!(error.downcast_ref(), Some(FolderError::Unfinished { .. }))
        || matches!(
            error.downcast_ref(),
            Some(
                ReportError::Write(WriteError::Exists { .. })
                    | ReportError::Foreign { .. }
                    | ReportError::Added { .. }
            )
        )
    {
        3
    } else if error.is::<MemoryError>()
        || matches!(error.downcast_ref(), Some(ProgramError::Memory(_)))
    {
        4
    } else if let Some(KernelError { problem: ResolveProblem::Table(_), .. }) = error.downcast_ref()
    {
        1
    } else if error.is::<Misuse>()
        || error.is::<OptionsError>()
        || error.is::<KernelError>()
        || error.is::<ScoreError>()
        || matches!(error.downcast_ref(), Some(ProgramError::Options(_)))
    {
        2
    } else {
        1
    }
}
