//! The tiles that a command compares: read, named, joined by comparison tiles, and scored.

use std::collections::HashSet;
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};
use perceptile::kernel::{KernelSpec, KernelTaps};
use perceptile::metric::{Baseline, ScoreOptions, ScoredTile};
use perceptile::tile::Tile;

use super::exit::Failure;
use super::source::{self, SourceArgs};

/// Seed of the comparison tiles.
const BASELINE_SEED: u64 = 1;

/// A tile that waits for its scores.
pub struct Candidate {
    /// What it is called, other than the others.
    pub name: String,
    /// Where it was read; `None` for a comparison tile.
    pub path: Option<PathBuf>,
    /// The tile.
    pub tile: Tile,
}

/// Reads the tiles, and makes the comparison tiles in the shape of the first.
///
/// # Errors
/// The first tile that cannot be read.
pub fn read(
    paths: Vec<PathBuf>,
    source: &SourceArgs,
    baselines: &[Baseline],
) -> Result<Vec<Candidate>, Failure> {
    let mut names = HashSet::new();
    let mut unused = |stem: String| {
        let name = (1..)
            .map(|n| if n == 1 { stem.clone() } else { format!("{stem}-{n}") })
            .find(|name| !names.contains(name))
            .expect("there is always a larger number");
        names.insert(name.clone());
        name
    };
    let mut candidates: Vec<Candidate> = Vec::new();
    for path in paths {
        let tile = source.read(&path)?;
        let name = unused(source::name(&path));
        candidates.push(Candidate { name, path: Some(path), tile });
    }
    if let Some(shape) = candidates.first().map(|first| first.tile.shape()) {
        for &baseline in baselines {
            let tile = baseline.tile(shape, BASELINE_SEED);
            candidates.push(Candidate { name: unused(baseline.to_string()), path: None, tile });
        }
    }
    Ok(candidates)
}

impl Candidate {
    /// The tile's scores, and the kernel behind which they were measured.
    ///
    /// # Errors
    /// A kernel that does not fit the tile, and options out of range.
    pub fn score(
        &self,
        kernel: &KernelSpec,
        options: ScoreOptions,
        with_spectra: bool,
        progress: &ProgressBar,
    ) -> Result<(ScoredTile, KernelTaps), Failure> {
        let Self { name, path, tile } = self;
        let shape = tile.shape();
        progress.set_message(name.clone());
        let score = || -> Result<_, Failure> {
            let taps = kernel.resolve(shape)?.classes()[0].taps.clone();
            let (name, path) = (name.clone(), path.clone());
            let scored = || progress.inc(1);
            let entry = ScoredTile::of(name, path, tile, &taps, options, with_spectra, scored)?;
            Ok((entry, taps))
        };
        score().map_err(|failure| {
            failure.explained(format_args!("cannot score {name}, a tile of {shape}"))
        })
    }
}

/// A bar on the standard error; without a terminal there, nothing.
pub fn progress(tiles: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} scores, {eta} left: {msg}")
        .expect("a valid template");
    // A tile is scored as it is, and after two quantizations.
    ProgressBar::new(3 * tiles as u64).with_style(style)
}
