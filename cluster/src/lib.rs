//! Ranks and reductions: how the parts of a run talk to each other.
//!
//! A run is a *world* of ranks. The crate knows ranks and numbers, never what they mean.

pub mod codec;
pub mod place;
#[cfg(unix)]
pub mod process;
mod world;

pub use world::{Commit, World};
