//! The world of a run: which rank this is, and what all ranks do together.

/// What all ranks agree on at the end of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commit {
    /// The step holds: go on with its result.
    Done,
    /// The step holds, and is to be the last one.
    Stop,
}

/// The ranks of a run, seen from one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {
    /// One rank, this process, whose threads share its memory.
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

    /// Replaces every value by its sum over all ranks.
    pub fn sum(&self, _values: &mut [i64]) {
        match self {
            Self::Local => (),
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
