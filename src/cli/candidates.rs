//! The tiles that a command compares: read, named, joined by comparison tiles, and scored.

use std::path::PathBuf;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use perceptile::domain::Domain;
use perceptile::kernel::{KernelSpec, KernelTaps};
use perceptile::metric::{Baseline, ScoreOptions, ScoredTile};
use perceptile::settings::whole;
use perceptile::tile::{Tile, TileShape};

use super::exit::{Failure, Misuse};
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

/// Reads the tiles.
///
/// # Errors
/// The first tile that cannot be read.
pub fn read(paths: Vec<PathBuf>, source: &SourceArgs) -> Result<Vec<Candidate>, Failure> {
    let mut candidates: Vec<Candidate> = Vec::new();
    for path in paths {
        let tile = source.read(&path)?;
        let is_free = |name: &String| candidates.iter().all(|it| it.name != *name);
        let name = unused(source::name(&path), is_free);
        candidates.push(Candidate { name, path: Some(path), tile });
    }
    Ok(candidates)
}

/// A name like this one that is free.
pub fn unused(stem: String, is_free: impl Fn(&String) -> bool) -> String {
    (1..)
        .map(|n| if n == 1 { stem.clone() } else { format!("{stem}-{n}") })
        .find(is_free)
        .expect("there is always a larger number")
}

/// Which parts of tiles are looked at.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Parts")]
pub struct PartsArgs {
    /// The first so many samples of every pixel instead of all, such as 4 or 1,2,4: a row for each
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = whole::<usize>)]
    prefix: Vec<usize>,

    /// One frame of so many, from each of the first ones on: a row for each phase of an upscaler that
    /// has so many
    #[arg(long, value_name = "FRAMES", value_parser = whole::<usize>)]
    stride: Option<usize>,
}

impl PartsArgs {
    /// These parts of tiles, or the whole tiles, and comparison tiles in the shapes of those of the
    /// first: of each as many, one after the other.
    ///
    /// # Errors
    /// More samples than a tile has, and a stride that does not divide its frames.
    pub fn of(
        &self,
        candidates: Vec<Candidate>,
        (domain, baselines): (Domain, &[Baseline]),
    ) -> Result<Vec<Candidate>, Misuse> {
        let (first, tiles) = (candidates[0].name.clone(), candidates.len());
        let mut stems: Vec<(String, Baseline)> = Vec::new();
        for &baseline in baselines {
            let is_free = |name: &String| {
                let mut names = candidates.iter().map(|it| &it.name);
                names.all(|it| it != name) && stems.iter().all(|(it, _)| it != name)
            };
            stems.push((unused(baseline.to_string(), is_free), baseline));
        }
        let mut parts = Vec::new();
        for candidate in candidates {
            for samples in self.samples(candidate)? {
                parts.extend(self.phases(samples)?);
            }
        }
        let part = |part: &Candidate| (part.name[first.len()..].to_owned(), part.tile.shape());
        let shapes: Vec<(String, TileShape)> =
            parts[..parts.len() / tiles].iter().map(part).collect();
        for (stem, baseline) in stems {
            parts.extend(shapes.iter().map(|(part, shape)| Candidate {
                name: format!("{stem}{part}"),
                path: None,
                tile: baseline.tile_of(domain, *shape, BASELINE_SEED),
            }));
        }
        Ok(parts)
    }

    /// The flags that say the same.
    pub fn command_line(&self) -> Vec<String> {
        let mut words = Vec::new();
        if !self.prefix.is_empty() {
            let list: Vec<String> = self.prefix.iter().map(usize::to_string).collect();
            words.extend(["--prefix".into(), list.join(",")]);
        }
        words.extend(self.stride.into_iter().flat_map(|n| ["--stride".into(), n.to_string()]));
        words
    }

    fn samples(&self, candidate: Candidate) -> Result<Vec<Candidate>, Misuse> {
        if self.prefix.is_empty() {
            return Ok(vec![candidate]);
        }
        let (name, spp) = (&candidate.name, candidate.tile.shape().spp());
        if let Some(bad) = self.prefix.iter().find(|k| !(1..=spp).contains(*k)) {
            let rule = format!("it must be from 1 to the {spp} samples per pixel of {name}");
            return Err(Misuse(format!("--prefix is {bad}, but {rule}")));
        }
        let part = |&k: &usize| Candidate {
            name: format!("{name}-first-{k}"),
            path: candidate.path.clone(),
            tile: candidate.tile.first(k),
        };
        Ok(self.prefix.iter().map(part).collect())
    }

    fn phases(&self, candidate: Candidate) -> Result<Vec<Candidate>, Misuse> {
        let Some(stride) = self.stride else { return Ok(vec![candidate]) };
        let (name, frames) = (&candidate.name, candidate.tile.shape().frames());
        if stride == 0 || !frames.is_multiple_of(stride) {
            let rule = format!("it must divide the {frames} frames of {name}");
            return Err(Misuse(format!("--stride is {stride}, but {rule}")));
        }
        let part = |phase| Candidate {
            name: format!("{name}-phase-{phase}-of-{stride}"),
            path: candidate.path.clone(),
            tile: candidate.tile.every(stride, phase),
        };
        Ok((0..stride).map(part).collect())
    }
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
