//! Ranks, rounds of jobs and shared memory: how the parts of a run work together.
//!
//! A run is a *world* of ranks (processes) that do *rounds* of jobs on memory that all of them
//! see; [`process`] starts, feeds and watches them, [`place`] binds them to processors. On a cluster
//! there is a world on each machine, and they are [`peers`], which send each other what they need:
//! through MPI, or as threads of one process to try things. The crate knows ranks, bytes and jobs,
//! never what they mean.
//!
//! ```text
//!  World::round ──► Board: which job is free      ◄── release_rank, ask_hold, ask_stop
//!       │           claims, journals, counters          (who looks after the ranks)
//!       ▼
//!  work(job, parts) ──► Parts: what a job may change
//!
//!  World::peers ──► Transfer: messages that are sent again and again
//! ```

pub mod codec;
pub mod faults;
pub mod launcher;
#[cfg(feature = "mpi")]
#[allow(unsafe_code, reason = "the room for it: every block says why it is sound")]
pub mod mpi;
pub mod peers;
pub mod place;
#[cfg(unix)]
pub mod process;
#[allow(unsafe_code, reason = "the room for it: every block says why it is sound")]
pub mod shared;
mod signal;
mod world;

pub use world::{Ends, World};
