//! The optimizer: from a start to a tile.
//!
//! [`Options`] say what to make and [`start`] where to begin; [`Descent`] is the paper's method, one
//! step at a time, with [`adam`]; [`polish`] goes beyond it; [`warp`] makes the tile uniform. All
//! of them are rounds of jobs on a [`Storage`] that the ranks of a worker share, numbered by
//! [`rounds`]; the loop knows neither files nor screen. Phases hand samples on in line order
//! ([`Samples`]). Worlds that share no memory have a region of the tile each, and send each other
//! halos.

pub mod adam;
pub mod faults;
mod halo;
mod histograms;
mod options;
mod parallelism;
pub mod polish;
pub mod rounds;
mod samples;
mod slots;
pub mod start;
mod state;
mod step;
mod storage;
mod summary;
pub mod warp;

pub use halo::HaloTraffic;
// The profile looks at them, which comes with the command.
#[cfg(feature = "cli")]
pub(crate) use halo::{GradientHalo, ROWS_AT_A_TIME, SampleHalo};
pub use options::{MAX_POLISH_TAPS, Options, OptionsError, Preset, Start};
pub use parallelism::{BLOCKS_PER_THREAD, Parallelism};
pub use samples::Samples;
pub use state::SharedSnapshot;
pub use step::Descent;
#[cfg(feature = "cli")]
pub(crate) use step::around;
pub use storage::{Record, Recorded, Storage, StoragePlan};
pub use summary::{Phase, StopReason, Summary};
