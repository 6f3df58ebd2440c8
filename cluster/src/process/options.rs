//! How workers are used, whatever they do.

use std::path::PathBuf;
use std::time::Duration;

use crate::faults::FaultPlan;

/// How worker processes are used.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkersOptions {
    /// Arguments that make this program a worker: those of a command that calls
    /// [`attach`](super::attach).
    pub arguments: Vec<String>,
    /// Whether each worker is bound to processors of its own, in one NUMA node.
    pub pin: bool,
    /// How long a worker may give no sign of life.
    pub silence: Duration,
    /// Workers that may be replaced; one more, and the run is given up.
    pub replacements: u32,
    /// Faults made on purpose.
    pub faults: Option<FaultPlan>,
    /// Where shared memory goes if there is no room where it is fastest.
    pub folder: PathBuf,
}
