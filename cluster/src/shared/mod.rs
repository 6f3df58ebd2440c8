//! Memory that several processes see, and who may touch which part of it when.
//!
//! A room of the crate with `unsafe`. [`Map`] is the memory, [`Section`]s are pieces of it
//! that nobody else has, [`Parts`] are what jobs are given of a section, [`Words`] are numbers that
//! anyone may read and write at any time, and [`Board`] deals out the jobs of a round. What makes
//! it safe is one rule: **a part belongs to whoever holds the claim of its job, and to nobody
//! else**; within a process the borrow checker holds everyone to it, between processes the board.
//!
//! ```text
//!  board ──► job ──► journal ─┐
//!    ├─────► orders ──────────┤
//!    ├─────► counters ────────┼──► section ──► map
//!    └─────► event_count ─────┤
//!  parts ──► job (its token) ─┘
//! ```

mod board;
mod counters;
mod event_count;
mod job;
mod journal;
mod map;
mod orders;
mod parts;
mod section;

pub use board::{Board, BoardPlan};
pub use counters::Counter;
pub use job::{Claim, Job, Reversible, Token};
pub use journal::Saver;
pub use map::{Map, MapError, MapHeader, allocate};
pub use parts::{Part, Parts, Shards};
pub use section::{Arena, Section, Words};
