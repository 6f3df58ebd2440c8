//! What a run leaves behind: the tile, its provenance and its picture.

use std::path::{Path, PathBuf};

use crate::format::npy;
use crate::format::picture::preview;
use crate::format::sidecar::Sidecar;
use crate::format::write::{self, Existing, WriteError};
use crate::tile::Tile;

/// The files of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outputs {
    /// The tile: `NAME.npy`.
    pub tile: PathBuf,
    /// Its provenance and scores: `NAME.json`.
    pub sidecar: PathBuf,
    /// Its first frame and XT slice: `NAME.png`.
    pub picture: PathBuf,
}

impl Outputs {
    /// The files that go with a tile's path.
    pub fn of(tile: &Path) -> Self {
        Self {
            tile: tile.to_owned(),
            sidecar: Sidecar::path_of(tile),
            picture: tile.with_extension("png"),
        }
    }

    /// Checks that all could be written, before a run that would be lost otherwise.
    ///
    /// # Errors
    /// The first reason against.
    pub fn probe(&self, existing: Existing) -> Result<(), WriteError> {
        write::probe([&self.tile, &self.sidecar, &self.picture], existing)
    }

    /// Writes all, the tile first.
    ///
    /// # Errors
    /// What the system reports; files that exist stay as they are unless they may be replaced.
    pub fn write(
        &self,
        tile: &Tile,
        sidecar: &Sidecar,
        existing: Existing,
    ) -> Result<(), WriteError> {
        write::write(&self.tile, existing, |out| npy::write_tile(tile, out))?;
        sidecar.write(&self.sidecar, existing)?;
        preview(tile).save(&self.picture, existing)
    }
}
