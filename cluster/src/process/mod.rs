//! Workers as processes: the coordinator starts them, watches them and replaces lost ones.
//!
//! A worker is the same program once more, with a socket as its standard input. Through the
//! socket go only the start ([`Launch`], [`attach`]) and the end ([`Attached::report`]) of its
//! life: its work lies in a file of shared memory, whose descriptor it is sent. The socket is also
//! how a worker notices that its coordinator has gone.

mod coordinator;
mod message;
#[cfg(test)]
mod tests;
mod worker;

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::place::PlaceError;

pub use coordinator::{Cause, Launch, Loss, Workers, this_program};
pub use message::MessageError;
pub use worker::{Attached, attach};

/// Why workers cannot be started, or a worker cannot begin.
#[derive(Debug, Error)]
pub enum ProcessError {
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
    /// A rank that no worker has.
    #[error("there is no rank {rank}: {workers} workers have ranks from 0")]
    Rank {
        /// The rank.
        rank: usize,
        /// Number of workers.
        workers: usize,
    },
    /// A rank whose worker was not lost.
    #[error("the worker of rank {0} is not lost, so nothing can take its place")]
    Present(usize),
    /// Not one place for each worker.
    #[error("there are places for {places} workers, and {workers} workers")]
    Places {
        /// Number of places.
        places: usize,
        /// Number of workers.
        workers: usize,
    },
    /// Standard input is no socket of a coordinator.
    #[error("this command is started by a coordinator, not by hand")]
    ByHand,
    /// The other end of the socket sent something else, or nothing.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The worker cannot run where it is to.
    #[error(transparent)]
    Place(#[from] PlaceError),
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
fn system<E: Into<io::Error>>(what: &'static str) -> impl FnOnce(E) -> ProcessError {
    move |error| ProcessError::System { what, error: error.into() }
}
