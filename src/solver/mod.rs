//! The optimizer: from a start to a tile.

pub mod adam;
mod blocks;
pub mod polish;
pub mod start;
mod state;
mod step;
pub mod warp;

pub use state::CellSamples;
pub use step::Descent;
