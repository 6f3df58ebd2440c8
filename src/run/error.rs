//! Why a run makes no tile.

use perceptile_cluster::codec::CodecError;
use perceptile_cluster::shared::MapError;
#[cfg(unix)]
use perceptile_cluster::{affinity::AffinityError, process::ProcessError};
use thiserror::Error;

use crate::run::folder::FolderError;
use crate::solver::OptionsError;

/// Why a run makes no tile.
#[derive(Debug, Error)]
pub enum RunError {
    /// The options are wrong.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// There is no memory for it.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// The checkpoint that it was to start from cannot be read.
    #[error(transparent)]
    Start(#[from] FolderError),
    /// The run was stopped while its start was made, so there is nothing to keep.
    #[error("the run was stopped while its start was made, so there is no tile yet")]
    Stopped,
    /// The observer has given the run up.
    #[error("the run was given up, so there is no tile")]
    GivenUp,
    /// Another rank failed, which says how.
    #[error("another rank failed")]
    Elsewhere,
    /// Workers cannot be started.
    #[cfg(unix)]
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Workers cannot be bound to processors.
    #[cfg(unix)]
    #[error(transparent)]
    Affinity(#[from] AffinityError),
    /// Workers cannot be sent their task.
    #[error("the kernel is too large for worker processes: {0}")]
    Task(CodecError),
    /// Too many workers were lost.
    #[error("{lost} workers were lost, the last because it {cause}: the run is given up{kept}")]
    Lost {
        /// How many.
        lost: u32,
        /// Why the last.
        cause: String,
        /// Where the run is kept, if it is.
        kept: String,
    },
}
