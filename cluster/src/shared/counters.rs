//! What workers count: for those who watch them, and for the summary of a run.

use std::sync::atomic::AtomicU64;

use crate::shared::section::{Arena, LINE, Words};

/// WorkerCounters of a worker; [`Board::counter`](super::Board::counter) reads them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counter {
    /// Signs of life.
    Beats,
    /// Nanoseconds that its threads worked on jobs.
    Busy,
    /// Nanoseconds that it waited for others' jobs.
    Waiting,
    /// Jobs done.
    Jobs,
    /// Jobs done that are of another worker's share.
    Taken,
    /// Bytes read that another worker wrote.
    Traffic,
}

/// Number of things that are counted for all workers together.
pub(super) const TALLIES: usize = 2 * LINE;

/// The counters of each worker, on a line of their own, and the tallies of all.
#[derive(Debug)]
pub(super) struct WorkerCounters {
    words: Words,
    workers: usize,
}

impl WorkerCounters {
    /// Bytes that they take of an arena; saturating.
    pub fn room(workers: usize) -> usize {
        Arena::room(Self::bytes(workers))
    }

    pub fn new(arena: &mut Arena, workers: usize) -> Self {
        Self { words: arena.take(Self::bytes(workers)).words(), workers }
    }

    fn bytes(workers: usize) -> usize {
        workers.saturating_mul(LINE).saturating_add(TALLIES).saturating_mul(size_of::<u64>())
    }

    /// # Panics
    /// If there is no such worker.
    pub fn of_worker(&self, worker: usize, counter: Counter) -> &AtomicU64 {
        assert!(worker < self.workers, "a counter of worker {worker}");
        &self.words[worker * LINE + counter as usize]
    }

    /// # Panics
    /// If the number is not below [`TALLIES`].
    pub fn tally(&self, number: usize) -> &AtomicU64 {
        assert!(number < TALLIES, "tally {number}");
        &self.words[self.workers * LINE + number]
    }
}
