//! Where the samples of tiles live that are compared: flags of every command that scores.

use std::path::{Path, PathBuf};

use clap::Args;
use perceptile::domain::{Domain, DomainSpec};
use perceptile::format::sidecar::Sidecar;
use perceptile::run::output::OutputFiles;
use perceptile::tile::TileShape;

use super::candidates::{self, Candidate};
use super::exit::{Failure, Misuse};
use super::source::SourceArgs;

/// The flags that say the domain.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Domain")]
pub struct DomainArgs {
    /// Where the tiles' samples live: square, circle, disk, sphere, hemisphere, cosine or density(FILE);
    /// a vector of length 1 has its components as 0.5 + 0.5 x [default: what the first tile was made for
    /// as its sidecar says, else square]
    #[arg(long, value_name = "DOMAIN")]
    domain: Option<DomainSpec>,

    /// A tile of the square to compare with, mapped to the domain by an equal-area map: of 1 dimension
    /// for the circle, else of 2; may be given several times
    #[arg(long, value_name = "TILE")]
    map: Vec<PathBuf>,
}

impl DomainArgs {
    /// The domain of these tiles, of which the user named `first` first. Their samples are brought to
    /// it as far as rounding left it, and tiles that are mapped join them.
    ///
    /// # Errors
    /// Samples that are not of the domain, tiles that cannot be read or mapped, a density that cannot be
    /// read or is another one than the sidecar says.
    pub fn choose(
        &self,
        first: &Path,
        candidates: &mut Vec<Candidate>,
        source: &SourceArgs,
    ) -> Result<Domain, Failure> {
        let domain = match &self.domain {
            Some(spec) => spec.resolve()?,
            None => {
                let candidate = candidates.iter().find(|it| it.path.as_deref() == Some(first));
                match candidate {
                    Some(candidate) => of_tile(first, candidate.tile.shape())?,
                    None => Domain::Square,
                }
            }
        };
        for candidate in &mut *candidates {
            let adopted = domain.adopt(&candidate.tile);
            candidate.tile = adopted.map_err(|error| {
                Failure::from(error).explained(format_args!("cannot score {}", candidate.name))
            })?;
        }
        for mut candidate in candidates::read(self.map.clone(), source)? {
            let mapped = domain.map(&candidate.tile);
            candidate.tile = mapped.map_err(|error| {
                Failure::from(error).explained(format_args!("cannot map {}", candidate.name))
            })?;
            candidate.name += "-mapped";
            let is_free = |name: &String| candidates.iter().all(|it| it.name != *name);
            candidate.name = candidates::unused(candidate.name, is_free);
            candidates.push(candidate);
        }
        Ok(domain)
    }

    /// The flags that say the same.
    pub fn command_line(&self, domain: Domain) -> Vec<String> {
        let mut words = Vec::new();
        if self.domain.is_some() || !domain.is_square() {
            words.extend(["--domain".to_owned(), domain.to_string()]);
        }
        let map = |path: &PathBuf| ["--map".to_owned(), path.display().to_string()];
        words.extend(self.map.iter().flat_map(map));
        words
    }
}

/// The domain that a tile was made for, as its sidecar says; the square, if there is none.
///
/// # Errors
/// A density that is not where the sidecar says, or is another one.
pub fn of_tile(tile: &Path, shape: TileShape) -> Result<Domain, Failure> {
    let sidecar = || {
        let path = Sidecar::find(tile)?;
        let sidecar = Sidecar::read(&path).ok()?;
        sidecar.describes(tile, shape).then_some((path, sidecar))
    };
    let Some((path, sidecar)) = sidecar() else { return Ok(Domain::Square) };
    let of = |pointer: &str| sidecar.options.pointer(pointer).and_then(|value| value.as_str());
    if let Some(name) = of("/options/domain") {
        return Ok(name.parse()?);
    }
    let said = (of("/options/domain/density/name"), of("/options/domain/density/sha256"));
    let (Some(name), Some(sha256)) = said else { return Ok(Domain::Square) };
    density(&path, name, sha256)
}

/// The density that a sidecar names: where its path says, or beside the sidecar.
fn density(sidecar: &Path, name: &str, sha256: &str) -> Result<Domain, Failure> {
    let beside = Path::new(name).file_name().map(|file| sidecar.with_file_name(file));
    let paths = [Some(PathBuf::from(name)), beside];
    let there: Vec<PathBuf> = paths.into_iter().flatten().filter(|path| path.is_file()).collect();
    let read = |path: &PathBuf| DomainSpec::File(path.display().to_string()).resolve();
    let is_it =
        |domain: &Domain| domain.density().is_some_and(|density| density.sha256() == sha256);
    if let Some(domain) = there.iter().filter_map(|path| read(path).ok()).find(is_it) {
        return Ok(domain);
    }
    let what = format!("{} says that samples have the density `{name}`", sidecar.display());
    let why = match there.first() {
        None => "which is not there".to_owned(),
        Some(path) => format!("but {} is another one", path.display()),
    };
    let hint = "say where it is with --domain density(FILE)";
    Err(Misuse(format!("{what}, {why}; {hint}")).into())
}

/// Checks that no file of a tile is the density that it is made for.
pub fn check_density(outputs: &OutputFiles, domain: Domain) -> Result<(), Misuse> {
    match domain.density().and_then(|density| outputs.find(Path::new(density.name()))) {
        Some(file) => Err(Misuse(format!(
            "the density would be replaced by {}, a file of the tile: give another --out",
            file.display()
        ))),
        None => Ok(()),
    }
}
