//! Runs: where the solver meets files, processes, signals and people.
//!
//! ```text
//!  phases  (threads of this process) ─┐                   ┌─► solver, round by round
//!  crew    (worker processes)        ─┼─► program ────────┤
//!  worker  (one of them)             ─┤                   └─► Watch: before each step
//!  ranks   (of a cluster)            ─┘
//! ```
//!
//! [`program`] is what every rank does, [`begin`] what it begins with, [`travel`] how that comes to
//! regions and back to files, [`observer`] how a run is watched and stopped, [`keeper`] writes checkpoints to a [`folder`] and reads them again,
//! [`signals`] turns Ctrl-C and SIGTERM into a stop, [`memory`] foresees what a run needs, and
//! [`outputs`] writes what it leaves behind.

pub mod begin;
#[cfg(unix)]
pub mod crew;
pub mod folder;
pub mod keeper;
pub mod memory;
pub mod observer;
pub mod outputs;
pub mod phases;
pub mod program;
pub mod ranks;
pub mod signals;
pub mod travel;
#[cfg(unix)]
pub mod worker;
