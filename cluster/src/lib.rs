//! Ranks, workers and threads: who computes, what they share, and what they send each other.
//!
//! Three words say who computes. A **rank** is what it is in MPI: it has a region of the data for
//! itself and shares no memory with other ranks. A **worker** is a process among those that share
//! the memory of one rank; without worker processes, the rank's own process is its one worker. A
//! **thread** is one of a worker's.
//!
//! The workers of a rank do *rounds* of jobs on memory that all of them see; [`process`] starts,
//! feeds and watches them, and [`affinity`] binds them to processors. Ranks send each other what
//! they need through a [`communicator`]: MPI's, or one of threads, to try things without a
//! cluster. The crate knows ranks, workers, bytes and jobs, never what they mean.
//!
//! ```text
//!  Worker::round ──► Board: which job is free      ◄── release_worker, ask_hold, ask_stop
//!       │           claims, journals, counters          (who looks after the workers)
//!       ▼
//!  work(job, parts) ──► Parts: what a job may change
//!
//!  Worker::communicator ──► Transfer: messages that are sent again and again
//! ```

pub mod affinity;
pub mod codec;
pub mod communicator;
pub mod faults;
mod futex;
pub mod launcher;
#[cfg(feature = "mpi")]
#[allow(unsafe_code, reason = "the room for it: every block says why it is sound")]
pub mod mpi;
#[cfg(unix)]
pub mod process;
#[allow(unsafe_code, reason = "the room for it: every block says why it is sound")]
pub mod shared;
mod worker;

pub use worker::{Ends, Worker};
