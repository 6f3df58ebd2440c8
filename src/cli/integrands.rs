//! The integrands that tiles are scored on: flags of every command that scores, with one meaning.

use clap::Args;
use perceptile::metric::ScoreOptions;
use perceptile::settings::whole;

/// Which integrands, and how many.
#[derive(Debug, Clone, Copy, Args)]
#[command(next_help_heading = "Integrands")]
pub struct IntegrandsArgs {
    /// Integrands of each class, 1 to 65536
    #[arg(
        long,
        value_name = "N",
        default_value_t = ScoreOptions::default().integrands,
        value_parser = whole::<usize>
    )]
    integrands: usize,

    /// Number of the set of integrands
    #[arg(
        long,
        value_name = "N",
        default_value_t = ScoreOptions::default().set,
        value_parser = whole::<u64>
    )]
    set: u64,
}

impl IntegrandsArgs {
    /// What the scores of tiles of the square are taken with.
    pub fn options(self) -> ScoreOptions {
        ScoreOptions { set: self.set, integrands: self.integrands, ..ScoreOptions::default() }
    }
}
