//! What ranks, which share no memory, send each other.
//!
//! A [`Communicator`] is how a rank reaches the others. What is sent again and again, between the
//! same ranks and in the same sizes, is a [`Transfer`]: it is set up once and started as often as
//! it is needed. All else is rare: sums of a few integers, and what the root gathers to write it
//! down. As in MPI, all ranks make the same calls in the same order, and rank 0 is the root.

use std::fmt::Debug;

mod in_process;
mod single;

pub use in_process::InProcess;
pub use single::Single;

/// A message of a transfer, as one of its ends sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message {
    /// The rank at the other end, which may be this one.
    pub rank: usize,
    /// Words of four bytes.
    pub words: usize,
}

/// How one of the ranks of a run reaches the others.
pub trait Communicator: Debug + Send + Sync {
    /// This rank's number, from 0.
    fn rank(&self) -> usize;

    /// Number of ranks.
    fn size(&self) -> usize;

    /// Sets up a transfer, together with all ranks. For each message that leaves a rank the other
    /// end expects one of the same length; there is at most one from a rank to another.
    ///
    /// # Panics
    /// If there is no such rank.
    fn transfer(&self, outgoing: &[Message], incoming: &[Message]) -> Box<dyn Transfer>;

    /// Replaces each value by its sum over all ranks; wraps around.
    fn sum(&self, values: &mut [i64]);

    /// Replaces each value by the largest of all ranks.
    fn max(&self, values: &mut [i64]);

    /// Replaces the bytes by those of the root.
    fn broadcast(&self, bytes: &mut Vec<u8>);

    /// Sends words to a rank that receives as many. May wait until it does.
    fn send(&self, to: usize, words: &[u32]);

    /// Receives the next words that a rank sends to this one.
    fn receive(&self, from: usize, words: &mut [u32]);

    /// Waits until all ranks are here, and leaves the processor to others meanwhile.
    fn rest(&self);

    /// Ends all ranks at once, with an exit code; does not return if there are others.
    fn abort(&self, code: u8);
}

/// Messages that are sent and received again and again.
///
/// From [`Self::start`] to [`Self::finish`] the buffers belong to the transfer.
pub trait Transfer: Send {
    /// What the next start sends, message by message.
    ///
    /// # Panics
    /// If the transfer is under way.
    fn outgoing(&mut self) -> Vec<&mut [u32]>;

    /// What was received last, message by message.
    ///
    /// # Panics
    /// If the transfer is under way.
    fn incoming(&self) -> Vec<&[u32]>;

    /// Starts to send and to receive.
    ///
    /// # Panics
    /// If the transfer is under way.
    fn start(&mut self);

    /// Gives messages that are under way a chance to get on. Some networks need it.
    fn progress(&mut self);

    /// Waits until all is sent and received; at once, if nothing is under way.
    fn finish(&mut self);
}
