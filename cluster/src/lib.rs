//! Ranks, exchange plans and reductions: how the parts of a run talk to each other.
//!
//! A run is a *world* of ranks. Every rank owns a slice of memory cut into *blocks*; a [`Plan`]
//! says which ranges of which block go to which other block, and [`World::exchange`] carries
//! them there, adding or copying. The crate knows bytes and blocks, never what they mean: plans
//! are compiled elsewhere, from geometry that does not reach this far.

mod local;
mod plan;
mod word;
mod world;

pub use plan::{Combine, Endpoint, Message, Plan, PlanError, Segment};
pub use word::Word;
pub use world::{Commit, World};
