//! Worker processes: flags of every command that has them.

#[cfg(unix)]
use std::path::Path;
use std::time::Duration;

use clap::Args;
use perceptile_cluster::faults::FaultPlan;
#[cfg(unix)]
use perceptile_cluster::process::WorkersOptions;

use super::duration;
use super::exit::Misuse;

/// How workers are used.
#[derive(Debug, Args)]
#[command(next_help_heading = "Running")]
pub struct WorkersArgs {
    /// Bind each worker to cores of its own, in one NUMA node, with its memory there
    #[arg(long, help_heading = "Running")]
    pin: bool,

    /// Workers that may be lost and replaced before the run is given up
    #[arg(long, value_name = "N", default_value_t = 16, help_heading = "Running")]
    replacements: u32,

    /// A worker that gives no sign of life for so long counts as lost
    #[arg(long, value_name = "TIME", default_value = "3s", value_parser = duration::parse_silence, help_heading = "Running")]
    silence: Duration,

    /// Make workers fail on purpose: the mean life of one and the share that hangs, as 500ms,0.25
    #[arg(long, value_name = "PLAN", hide = true)]
    faults: Option<FaultPlan>,
}

impl WorkersArgs {
    /// Checks that so many workers, on so many ranks, go with the flags.
    ///
    /// # Errors
    /// Flags that do not go together.
    pub fn check(&self, workers: usize, ranks: usize) -> Result<(), Misuse> {
        if workers == 0 && (self.pin || self.faults.is_some()) {
            return Err(Misuse("--pin is for worker processes: see --workers".into()));
        }
        if workers > 0 && ranks > 1 {
            return Err(Misuse("ranks have threads and no workers: leave out --workers".into()));
        }
        #[cfg(not(unix))]
        if workers > 0 {
            return Err(super::execution::no_workers());
        }
        Ok(())
    }

    /// The same for who starts them: by a command of this program, with shared memory in a folder if
    /// there is no room where it is fastest.
    #[cfg(unix)]
    pub fn options(&self, command: &str, folder: &Path) -> WorkersOptions {
        WorkersOptions {
            arguments: vec![command.into()],
            pin: self.pin,
            silence: self.silence,
            replacements: self.replacements,
            faults: self.faults,
            folder: folder.to_owned(),
        }
    }
}
