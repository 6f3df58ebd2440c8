//! Why workers cannot be started, or a worker cannot begin, in words for users.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use super::loss::Loss;
use super::message::MessageError;
use crate::affinity::AffinityError;

/// Why workers cannot be started, or a worker cannot begin.
#[derive(Debug, Error)]
pub enum ProcessError {
    /// The system does not show which program this process runs.
    #[error(
        "cannot find this program to start workers from: {} is not there; is /proc mounted? \
         ({error})",
        link.display()
    )]
    NoProgram {
        /// What names the program.
        link: PathBuf,
        /// What the system reports.
        error: io::Error,
    },
    /// No file for shared memory can be made.
    #[error("no file for shared memory can be made in {}: {error}", folder.display())]
    Memory {
        /// Where.
        folder: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The program does not start.
    #[error("cannot start a worker from {}: {error}", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// What the system reports.
        error: io::Error,
    },
    /// A worker ended before all were ready.
    #[error(transparent)]
    Lost(#[from] Loss),
    /// An index that no worker has.
    #[error("there is no worker {worker}: {workers} workers are numbered from 0")]
    Worker {
        /// The index.
        worker: usize,
        /// Number of workers.
        workers: usize,
    },
    /// A worker that was not lost.
    #[error("worker {0} is not lost, so nothing can take its place")]
    Present(usize),
    /// Not processors for each worker.
    #[error("processors are given for {bound} workers, and there are {workers} workers")]
    Affinities {
        /// Number of workers that processors are given for.
        bound: usize,
        /// Number of workers.
        workers: usize,
    },
    /// Standard input is no socket of a coordinator.
    #[error("this command is started by a coordinator, not by hand")]
    ByHand,
    /// The other end of the socket sent something else, or nothing.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The worker cannot be bound to its processors.
    #[error(transparent)]
    Affinity(#[from] AffinityError),
    /// The system refused.
    #[error("cannot {what}: {error}")]
    System {
        /// What was tried.
        what: &'static str,
        /// What the system reports.
        error: io::Error,
    },
}

/// For `map_err`: what was tried when the system refused.
pub(super) fn system<E: Into<io::Error>>(what: &'static str) -> impl FnOnce(E) -> ProcessError {
    move |error| ProcessError::System { what, error: error.into() }
}
