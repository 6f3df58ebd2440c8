//! How the command fails: with which exit code, and what it says.
//!
//! Every error that the command can meet knows its exit code here; what has none of its own is a
//! file that could not be read or written.

use std::error::Error;
use std::fmt::{Display, Write as _};
use std::process::ExitCode;

use perceptile::domain::DomainError;
use perceptile::export::{ExportError, FormError};
use perceptile::format::animation::AnimationError;
use perceptile::format::picture::ImageError;
use perceptile::format::source::SourceError;
use perceptile::format::write::WriteError;
use perceptile::kernel::{KernelError, ResolveProblem};
use perceptile::metric::ScoreError;
use perceptile::profile::report::ProfileError;
use perceptile::profile::roofline::RooflineError;
use perceptile::profile::scaling::costs::CostsError;
#[cfg(unix)]
use perceptile::profile::workers::WorkersProfileError;
use perceptile::report::ReportError;
#[cfg(unix)]
use perceptile::run::backend::workers::task::WorkerError;
use perceptile::run::error::RunError;
use perceptile::run::folder::FolderError;
use perceptile::run::memory::MemoryError;
use perceptile::select::SelectError;
#[cfg(unix)]
use perceptile::select::workers::CrewError;
use perceptile::settings::SettingsError;
use perceptile::solver::OptionsError;
use perceptile::tile::ShapeError;
use perceptile_cluster::shared::MapError;

use super::stream::{OutputError, say};

/// What an exit code means.
#[derive(Debug, Clone, Copy)]
pub enum Exit {
    /// A file could not be read or written, or the system refused something.
    Failed = 1,
    /// A wrong argument, option or setting.
    Misuse = 2,
    /// An output or an unfinished run exists, or is in use.
    Exists = 3,
    /// The run does not fit into memory.
    Memory = 4,
    /// Too many workers were lost.
    Lost = 5,
    /// A tile has more error than `evaluate --require` allows.
    Missed = 6,
}

/// Something is wrong with what was asked for, rather than with the machine.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Misuse(pub String);

/// The command has failed.
#[derive(Debug)]
pub struct Failure {
    code: u8,
    /// What there is to say; nothing if it was said already.
    message: Option<String>,
}

/// An error that knows with which exit code it ends the command.
pub trait Exits: Error {
    /// The code.
    fn exit(&self) -> Exit;
}

impl<E: Exits> From<E> for Failure {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut source = error.source();
        while let Some(error) = source {
            let _ = write!(message, ": {error}");
            source = error.source();
        }
        Self { code: error.exit() as u8, message: Some(message) }
    }
}

impl Failure {
    /// A failure that somebody else has reported already.
    pub fn reported(code: u8) -> Self {
        Self { code, message: None }
    }

    /// The system or a library refuses: `what` cannot be done.
    pub fn refused<E: Display>(what: &str) -> impl FnOnce(E) -> Self {
        move |error| Self { code: Exit::Failed as u8, message: Some(format!("{what}: {error}")) }
    }

    /// An output, or something unfinished, is there already.
    pub fn exists(message: String) -> Self {
        Self { code: Exit::Exists as u8, message: Some(message) }
    }

    /// The exit code.
    pub fn code(&self) -> u8 {
        self.code
    }

    /// The same, with words before its message.
    pub fn explained(self, context: impl Display) -> Self {
        Self { message: self.message.map(|message| format!("{context}: {message}")), ..self }
    }

    /// The same, with words after its message.
    pub fn hinted(self, hint: impl Display) -> Self {
        Self { message: self.message.map(|message| format!("{message}{hint}")), ..self }
    }

    /// Says what is wrong, unless that was reported, and gives the exit code.
    pub fn report(self) -> ExitCode {
        if let Some(message) = self.message {
            say(format_args!("error: {message}"));
        }
        ExitCode::from(self.code)
    }
}

/// Errors and their exit codes: a pattern is looked at if there is more than one.
macro_rules! exits {
    ($($error:ty { $($pattern:pat => $exit:expr),+ $(,)? })+) => {
        $(impl Exits for $error {
            fn exit(&self) -> Exit {
                match self { $($pattern => $exit),+ }
            }
        })+
    };
}

exits! {
    Misuse { _ => Exit::Misuse }
    DomainError { Self::File { .. } => Exit::Failed, _ => Exit::Misuse }
    OptionsError { Self::Kernel(error) => error.exit(), _ => Exit::Misuse }
    KernelError {
        Self { problem: ResolveProblem::Table(_), .. } => Exit::Failed,
        _ => Exit::Misuse,
    }
    SettingsError {
        Self::Domain(error) => error.exit(),
        Self::Options(error) => error.exit(),
        _ => Exit::Misuse,
    }
    ScoreError { _ => Exit::Misuse }
    ShapeError { _ => Exit::Misuse }
    WriteError {
        Self::Exists { .. } | Self::Claimed { .. } | Self::Beside { .. } | Self::Foreign { .. } => {
            Exit::Exists
        },
        _ => Exit::Failed,
    }
    ReportError {
        Self::Write(error) => error.exit(),
        Self::Foreign { .. } | Self::Added { .. } => Exit::Exists,
        _ => Exit::Failed,
    }
    FolderError { Self::Unfinished { .. } | Self::InUse { .. } => Exit::Exists, _ => Exit::Failed }
    MemoryError { _ => Exit::Memory }
    MapError { Self::NoMemory { .. } => Exit::Memory, _ => Exit::Failed }
    CostsError { Self::Options(error) => error.exit(), _ => Exit::Failed }
    ProfileError { Self::Memory(error) => error.exit(), _ => Exit::Failed }
    RooflineError { _ => Exit::Failed }
    ImageError { _ => Exit::Failed }
    ExportError { Self::Write(error) => error.exit(), _ => Exit::Misuse }
    FormError { _ => Exit::Misuse }
    SourceError { _ => Exit::Failed }
    AnimationError { Self::Pattern { .. } => Exit::Misuse, _ => Exit::Failed }
    SelectError {
        Self::Memory(error) => error.exit(),
        Self::Elsewhere => Exit::Failed,
        _ => Exit::Misuse,
    }
    OutputError { _ => Exit::Failed }
    serde_json::Error { _ => Exit::Failed }
}

#[cfg(unix)]
exits! {
    RunError {
        Self::Options(error) => error.exit(),
        Self::Memory(error) => error.exit(),
        Self::Lost { .. } => Exit::Lost,
        Self::Affinity(_) => Exit::Misuse,
        _ => Exit::Failed,
    }
    WorkersProfileError {
        Self::Run(error) => error.exit(),
        Self::Options(error) => error.exit(),
        Self::Report(_) => Exit::Failed,
    }
    WorkerError { _ => Exit::Failed }
    CrewError {
        Self::Select(error) => error.exit(),
        Self::Memory(error) => error.exit(),
        Self::Affinity(_) => Exit::Misuse,
        Self::Lost { .. } => Exit::Lost,
        _ => Exit::Failed,
    }
}

#[cfg(not(unix))]
exits! {
    RunError {
        Self::Options(error) => error.exit(),
        Self::Memory(error) => error.exit(),
        Self::Lost { .. } => Exit::Lost,
        _ => Exit::Failed,
    }
}
