//! The world of a run: which rank this is, and what all ranks do together.

use crate::local;
use crate::plan::{Combine, Plan};
use crate::word::Word;

/// What all ranks agree on at the end of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commit {
    /// The step holds: go on with its result.
    Done,
    /// A rank failed: do the step again from its start.
    Redo,
    /// Leave the loop with the last step that holds.
    Stop,
}

/// The ranks of a run, seen from one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {
    /// One rank, this process; its blocks are worked on by threads.
    Local,
}

impl World {
    /// This rank's number, from 0.
    pub fn rank(&self) -> usize {
        match self {
            Self::Local => 0,
        }
    }

    /// Number of ranks.
    pub fn size(&self) -> usize {
        match self {
            Self::Local => 1,
        }
    }

    /// Returns when every rank has come here.
    pub fn barrier(&self) {
        match self {
            Self::Local => (),
        }
    }

    /// Replaces every value by its sum over all ranks.
    pub fn sum(&self, _values: &mut [i64]) {
        match self {
            Self::Local => (),
        }
    }

    /// Carries out `plan` on this rank's slice; `mailbox` is scratch that the caller lends.
    ///
    /// All words are read before any is written, so a range may be sent and received into.
    ///
    /// # Panics
    /// If `slice` is not as long as the plan's blocks together.
    pub fn exchange<T: Word>(
        &self,
        plan: &Plan,
        slice: &mut [T],
        combine: Combine,
        mailbox: &mut Vec<T>,
    ) {
        let words: usize = plan.blocks().iter().sum();
        assert_eq!(slice.len(), words, "the slice and the plan's blocks differ in size");
        match self {
            Self::Local => local::exchange(plan, slice, combine, mailbox),
        }
    }

    /// Ends a step: every rank says whether it is to stop, and all learn what holds for all.
    pub fn commit(&self, stop: bool) -> Commit {
        match self {
            Self::Local if stop => Commit::Stop,
            Self::Local => Commit::Done,
        }
    }
}
