//! A run that is ready to start: what to do, what from, and which files are the root's.

use std::path::PathBuf;

use perceptile::format::claim::Claim;
use perceptile::format::write::Existing;
use perceptile::run::checkpointer::Checkpointer;
use perceptile::run::memory;
use perceptile::run::output::OutputFiles;
use perceptile::run::plan::Plan;
use perceptile::run::start::InitialState;
use perceptile::settings::Settings;
use serde::{Deserialize, Serialize};

use super::exit::Failure;

/// What a run was asked for, as its checkpoints keep it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Invocation {
    /// The settings.
    pub settings: Settings,
    /// Where the tile goes, from the root of the file system on: a run can be resumed anywhere.
    pub out: PathBuf,
    /// Integrands of each class that it is scored on.
    pub integrands: usize,
}

/// Checks that a run fits into the memory here, and that its steps are not too coarse.
///
/// # Errors
/// If it does not, or they are.
pub fn check(plan: &Plan) -> Result<(), Failure> {
    // Each of several ranks looks at its memory itself.
    if plan.parallelism.ranks == 1 {
        memory::check(plan)?;
    }
    Ok(plan.check_batch()?)
}

/// A run that is ready to start.
pub struct PreparedRun {
    /// What to do.
    pub plan: Plan,
    /// What from.
    pub start: InitialState,
    /// Its files, which are the root's.
    pub files: Option<Files>,
}

/// The files of a run.
pub struct Files {
    /// What it was asked for.
    pub invocation: Invocation,
    /// The files that it leaves.
    pub outputs: OutputFiles,
    /// Whether they may be replaced.
    pub existing: Existing,
    /// Writes its checkpoints.
    pub checkpointer: Checkpointer,
    /// Keeps other runs from the outputs.
    pub claims: [Claim; 3],
}
