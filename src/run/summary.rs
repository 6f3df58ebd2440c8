//! What those who did the steps of a run did.

use serde::Serialize;

/// What threads, worker processes or ranks did.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ParallelSummary {
    /// The threads of one process: nothing is counted.
    Threads,
    /// Of worker processes.
    Workers(WorkersSummary),
    /// Of ranks.
    Ranks(RanksSummary),
}

/// What worker processes did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorkersSummary {
    /// Each of them, replacements included with those they replaced.
    pub workers: Vec<WorkerSummary>,
    /// The largest time of work against the mean.
    pub imbalance: f64,
    /// Workers that were replaced.
    pub replaced: u32,
    /// Faults made on purpose, by place; only those that happened.
    pub faults: Vec<(&'static str, u64)>,
}

/// What one worker did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WorkerSummary {
    /// Seconds that its threads worked.
    pub busy: f64,
    /// Seconds that it waited for others.
    pub waiting: f64,
    /// Jobs done.
    pub jobs: u64,
    /// Those of them that were another's by place.
    pub taken: u64,
    /// Bytes read that another worker wrote.
    pub traffic: u64,
}

/// What the ranks of a run did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RanksSummary {
    /// Each of them.
    pub ranks: Vec<RankSummary>,
    /// The largest time of work against the mean.
    pub imbalance: f64,
}

/// What one rank did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RankSummary {
    /// Columns and rows of its region.
    pub size: [usize; 2],
    /// Seconds that its threads worked.
    pub busy: f64,
    /// Seconds that it waited for halos of others.
    pub waiting: f64,
    /// Bytes of halos that came from others.
    pub traffic: u64,
    /// The most memory that it had, in bytes; 0 where the system does not say.
    pub peak: u64,
}

/// The largest time of work against the mean; 1 if there was none.
pub(super) fn imbalance(busy: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let mean = busy.clone().sum::<f64>() / busy.len() as f64;
    let most = busy.fold(0.0, f64::max);
    if mean > 0.0 { most / mean } else { 1.0 }
}
