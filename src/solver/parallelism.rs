//! Who makes a tile: how many ranks, workers and threads.

use perceptile_cluster::Worker;
use perceptile_cluster::shared::BoardPlan;
use serde::{Deserialize, Serialize};

use crate::tile::{Block, Partition, Region};

/// Blocks for each thread, so that one who is done can take over from one who is late.
pub const BLOCKS_PER_THREAD: usize = 4;

/// How many ranks, workers and threads make a tile. Nothing of the tile depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parallelism {
    /// Ranks, each with a region of the tile; they share no memory. At least 1.
    pub ranks: usize,
    /// Worker processes that share the memory of a rank; 0 if its own threads do the work.
    pub workers: usize,
    /// Threads of each worker or, without workers, of each rank. At least 1.
    pub threads: usize,
}

impl Parallelism {
    /// Most threads of a process; systems refuse far more of them, some only after having made thousands.
    pub const MAX_THREADS: usize = 1024;

    /// The threads of the current pool, in one process.
    pub fn threads() -> Self {
        Self { ranks: 1, workers: 0, threads: rayon::current_num_threads() }
    }

    /// That of a worker and all others.
    pub(crate) fn of(worker: &Worker) -> Self {
        let BoardPlan { workers, threads, journal, .. } = worker.board().plan();
        let workers = if journal > 0 { workers } else { 0 };
        Self { ranks: worker.communicator().size(), workers, threads }
    }

    /// Whether work is done by processes that can be lost: then changes in place are written to a
    /// journal before.
    pub fn has_workers(&self) -> bool {
        self.workers > 0
    }

    /// Processes that share the memory of a rank, and work on it.
    pub fn processes(&self) -> usize {
        self.workers.max(1)
    }

    /// Threads that share the memory of a rank.
    pub fn all_threads(&self) -> usize {
        self.processes().saturating_mul(self.threads)
    }

    /// The blocks that a region is cut into.
    pub(crate) fn blocks(&self, partition: &Partition, region: Region) -> Vec<Block> {
        partition.blocks(region, self.all_threads() * BLOCKS_PER_THREAD)
    }
}
