//! The optimizer: from a start to a tile.
//!
//! [`Options`] say what to make and [`start`] where to begin; [`Descent`] is the paper's method, one
//! step at a time, with [`adam`]; [`polish`] goes beyond it; [`warp`] makes the tile uniform. The
//! loop knows neither storage nor screen: it works on the cells of one rank and hands samples on
//! in cell order ([`CellSamples`]).

pub mod adam;
mod options;
mod pages;
pub mod polish;
pub mod start;
mod state;
mod step;
mod summary;
pub mod warp;

pub use options::{MAX_POLISH_TAPS, Options, OptionsError, Preset, Start};
pub use state::CellSamples;
pub use step::{BLOCKS_PER_THREAD, Descent};
pub use summary::{Phase, StopReason, Summary};
