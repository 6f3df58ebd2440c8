//! Runs: where the solver meets files, signals and people.
//!
//! [`phases`] joins the parts of the solver into a run, [`observer`] is how a run is watched and
//! stopped, [`signals`] turns Ctrl-C and SIGTERM into a stop, [`memory`] foresees what a run
//! needs, and [`outputs`] writes what it leaves behind.

pub mod begin;
pub mod keeper;
pub mod memory;
pub mod observer;
pub mod outputs;
pub mod phases;
pub mod program;
pub mod signals;
