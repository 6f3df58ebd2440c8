//! What a selection can go on from: its choices.
//!
//! At a renewal the residual is made anew from what is chosen, so frames can be read again and
//! nothing else need be kept than the choices of the frames in the window, and the sums so far.

use serde::{Deserialize, Serialize};

use super::score::Sums;

/// A selection at a renewal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelectState {
    /// The wave that is next.
    pub(super) wave: usize,
    /// The first frame of the window.
    pub(super) first: usize,
    /// The choices of its frames, pixel by pixel.
    pub(super) choices: Vec<u8>,
    /// Sums of squares of the frames that are scored.
    pub(super) sums: Sums,
    /// How often each candidate was chosen.
    pub(super) chosen: Vec<u64>,
    /// Pixels that changed in each sweep.
    pub(super) changes: Vec<u64>,
    /// Frames that are done.
    pub(super) done: usize,
}

impl SelectState {
    /// Frames that are done.
    pub fn done(&self) -> usize {
        self.done
    }
}
