//! What users may set for a run, as flags or in a file: the same names, and the flags win.

use std::path::PathBuf;

use clap::Args;
use perceptile::settings::Settings;

/// The settings of a run.
#[derive(Debug, Clone, PartialEq, Default, Args)]
pub struct SettingsArgs {
    #[command(flatten)]
    pub settings: Settings,

    /// Flags from a TOML file, under their names; what is typed here wins
    #[arg(long, value_name = "FILE", help_heading = "Files")]
    pub config: Option<PathBuf>,
}
