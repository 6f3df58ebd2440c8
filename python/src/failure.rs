//! Errors of the library as Python's exceptions, with the words of the command.

use std::error::Error;
use std::io;

use perceptile::domain::{DensityError, DomainError};
use perceptile::export::{ExportError, FormError};
use perceptile::format::sidecar::SidecarError;
use perceptile::kernel::{KernelError, ParseError, ResolveProblem, SpecProblem};
use perceptile::run::error::RunError;
use perceptile::select::SelectError;
use perceptile::settings::SettingsError;
use perceptile::solver::OptionsError;
use perceptile::tile::{ShapeError, TileError};
use perceptile::{MemoryError, ScoreError, SourceError, WriteError};
use pyo3::exceptions::{
    PyFileExistsError, PyFileNotFoundError, PyMemoryError, PyOSError, PyRuntimeError, PyTypeError,
    PyValueError,
};
use pyo3::prelude::*;

/// What an exception is of.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// A value that cannot be: the command's exit code 2.
    Value,
    /// No argument has this name.
    Name,
    /// A file that is not there.
    Missing,
    /// A file that cannot be read or written.
    File,
    /// A file that exists.
    Exists,
    /// Too little memory.
    Memory,
    /// Anything else.
    Run,
}

impl Kind {
    fn of(error: &io::Error) -> Self {
        if error.kind() == io::ErrorKind::NotFound { Self::Missing } else { Self::File }
    }
}

/// An error of the library that is some kind of exception.
pub trait Raises: Error {
    /// The kind.
    fn kind(&self) -> Kind;
}

/// An exception on its way.
#[derive(Debug)]
pub struct Failure(PyErr);

impl Failure {
    /// A value that cannot be.
    pub fn value(message: impl Into<String>) -> Self {
        Self(PyValueError::new_err(message.into()))
    }

    /// Something that should not have happened.
    pub fn run(message: impl Into<String>) -> Self {
        Self(PyRuntimeError::new_err(message.into()))
    }
}

impl<E: Raises> From<E> for Failure {
    fn from(error: E) -> Self {
        let mut message = error.to_string();
        let mut source = error.source();
        while let Some(error) = source {
            message += &format!(": {error}");
            source = error.source();
        }
        let message = in_python(&message);
        Self(match error.kind() {
            Kind::Value => PyValueError::new_err(message),
            Kind::Name => PyTypeError::new_err(message),
            Kind::Missing => PyFileNotFoundError::new_err(message),
            Kind::File => PyOSError::new_err(message),
            Kind::Exists => PyFileExistsError::new_err(message),
            Kind::Memory => PyMemoryError::new_err(message),
            Kind::Run => PyRuntimeError::new_err(message),
        })
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        failure.0
    }
}

/// A message with the names of arguments where the command has flags: `--stop-after` is `stop_after`.
fn in_python(message: &str) -> String {
    let mut parts = message.split("--");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let is_flag = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let end = part.find(|c| !is_flag(c)).unwrap_or(part.len());
        let (flag, rest) = part.split_at(end);
        text += &match flag {
            "force" => "force=True".to_owned(),
            "for" => "reads".to_owned(),
            _ => flag.replace('-', "_"),
        };
        text += rest;
    }
    text
}

/// Errors and what they raise: a pattern is looked at if there is more than one.
macro_rules! raises {
    ($($error:ty { $($pattern:pat => $kind:expr),+ $(,)? })+) => {
        $(impl Raises for $error {
            fn kind(&self) -> Kind {
                match self { $($pattern => $kind),+ }
            }
        })+
    };
}

raises! {
    SettingsError {
        Self::Unknown { .. } => Kind::Name,
        Self::Domain(error) => error.kind(),
        Self::Options(error) => error.kind(),
        _ => Kind::Value,
    }
    DomainError { Self::File { .. } => Kind::File, _ => Kind::Value }
    DensityError { _ => Kind::Value }
    OptionsError { Self::Kernel(error) => error.kind(), _ => Kind::Value }
    KernelError {
        Self { problem: ResolveProblem::Table(_), .. } => Kind::File,
        _ => Kind::Value,
    }
    ParseError { _ => Kind::Value }
    SpecProblem { _ => Kind::Value }
    ScoreError { _ => Kind::Value }
    ShapeError { _ => Kind::Value }
    TileError { _ => Kind::Value }
    MemoryError { _ => Kind::Memory }
    RunError {
        Self::Options(error) => error.kind(),
        Self::Memory(_) => Kind::Memory,
        _ => Kind::Run,
    }
    SelectError { Self::Memory(_) => Kind::Memory, _ => Kind::Value }
    FormError { _ => Kind::Value }
    ExportError { Self::Write(error) => error.kind(), _ => Kind::Value }
    SidecarError { Self::Io { error, .. } => Kind::of(error), _ => Kind::Value }
    SourceError {
        Self::Io { error, .. } => Kind::of(error),
        Self::Special { .. } => Kind::File,
        _ => Kind::Value,
    }
    WriteError {
        Self::Exists { .. } | Self::Claimed { .. } | Self::Beside { .. } | Self::Foreign { .. } => {
            Kind::Exists
        },
        _ => Kind::File,
    }
}
