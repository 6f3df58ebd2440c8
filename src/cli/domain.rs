//! Where the samples of tiles live that are compared: flags of every command that scores.

use std::path::{Path, PathBuf};

use clap::Args;
use perceptile::domain::Domain;
use perceptile::format::sidecar::Sidecar;

use super::candidates::{self, Candidate};
use super::exit::Failure;
use super::source::SourceArgs;

/// The flags that say the domain.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Domain")]
pub struct DomainArgs {
    /// Where the tiles' samples live: square, circle, disk, sphere, hemisphere or cosine; a vector of
    /// length 1 has its components as 0.5 + 0.5 x [default: what the first tile was made for as its
    /// sidecar says, else square]
    #[arg(long, value_name = "DOMAIN")]
    domain: Option<Domain>,

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
    /// Samples that are not of the domain, tiles that cannot be read or mapped.
    pub fn choose(
        &self,
        first: &Path,
        candidates: &mut Vec<Candidate>,
        source: &SourceArgs,
    ) -> Result<Domain, Failure> {
        let domain = self.domain.or_else(|| of_sidecar(first, candidates)).unwrap_or_default();
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

/// The domain that a tile was made for, if its sidecar says it.
fn of_sidecar(tile: &Path, candidates: &[Candidate]) -> Option<Domain> {
    let candidate = candidates.iter().find(|it| it.path.as_deref() == Some(tile))?;
    let sidecar = Sidecar::read(&Sidecar::find(tile)?).ok()?;
    let domain = sidecar.options.pointer("/options/domain")?.as_str()?.parse().ok()?;
    sidecar.describes(tile, candidate.tile.shape()).then_some(domain)
}
