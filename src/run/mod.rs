//! Runs: where the solver meets files, signals and people.
//!
//! [`phases`] joins the parts of the solver into a run, [`observer`] is how a run is watched and
//! stopped, [`signals`] turns Ctrl-C and SIGTERM into a stop, [`memory`] foresees what a run
//! needs, [`outputs`] writes what it leaves behind, and [`folder`] keeps the checkpoints from which
//! a run that was killed goes on.

pub mod folder;
pub mod memory;
pub mod observer;
pub mod outputs;
pub mod phases;
pub mod signals;
