//! What a run leaves behind: the tile, its provenance and its picture.

use std::io;
use std::path::{Path, PathBuf};

use crate::format::hashed::Hashed;
use crate::format::npy;
use crate::format::numbers::Put;
use crate::format::picture::Preview;
use crate::format::sidecar::Sidecar;
use crate::format::write::{self, Existing, WriteError};
use crate::tile::{Tile, TileShape};

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

    /// Writes all, the tile first. `sidecar` says where the tile comes from when its SHA-256 is
    /// known.
    ///
    /// # Errors
    /// What the system reports; files that exist stay as they are unless they may be replaced.
    pub fn write(
        &self,
        tile: &Tile,
        existing: Existing,
        sidecar: impl FnOnce(String) -> Sidecar,
    ) -> Result<(), WriteError> {
        self.write_streamed(tile.shape(), existing, &mut |put| put(tile.samples()), sidecar)
    }

    /// Writes all of a tile that is never whole here: `pieces` hands its coordinates over, in C
    /// order, to what it is called with.
    ///
    /// # Errors
    /// As for [`Self::write`]; what `pieces` reports, and more or fewer coordinates than the shape
    /// has: then there is no file of this tile.
    pub fn write_streamed(
        &self,
        shape: TileShape,
        existing: Existing,
        pieces: &mut dyn FnMut(&mut Put<'_>) -> io::Result<()>,
        sidecar: impl FnOnce(String) -> Sidecar,
    ) -> Result<(), WriteError> {
        let mut preview = Preview::new(shape);
        let mut digest = String::new();
        write::write(&self.tile, existing, |out| {
            let mut hashed = Hashed::new(out);
            npy::write_rows(shape, &mut hashed, &mut |put| {
                pieces(&mut |piece| {
                    preview.take(piece);
                    put(piece)
                })
            })?;
            digest = hashed.hexadecimal();
            Ok(())
        })?;
        sidecar(digest).write(&self.sidecar, existing)?;
        preview.image().save(&self.picture, existing)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use sha2::{Digest, Sha256};

    use super::*;
    use crate::format::picture::preview;
    use crate::format::sidecar;
    use crate::metric::Baseline;

    fn provenance(shape: TileShape, sha256: String) -> Sidecar {
        Sidecar {
            format: sidecar::FORMAT,
            program: "perceptile".into(),
            version: "0".into(),
            command: "perceptile".into(),
            kernel: "none".into(),
            seed: 1,
            shape,
            options: serde_json::Value::Null,
            created: "1970-01-01T00:00:00Z".into(),
            seconds: 0.5,
            sha256,
            scores: serde_json::Value::Null,
            convergence: Vec::new(),
        }
    }

    #[test]
    fn a_tile_in_pieces_leaves_the_files_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let shape = TileShape::new(7, 5, 3, 2, 3).unwrap();
        let tile = Baseline::White.tile(shape, 4);
        let files = |name: &str| {
            let outputs = Outputs::of(&folder.path().join(name));
            let read = |path: &Path| fs::read(path).unwrap();
            (outputs.clone(), move || {
                [&outputs.tile, &outputs.sidecar, &outputs.picture].map(|path| read(path))
            })
        };
        let (whole, read) = files("whole.npy");
        whole.write(&tile, Existing::Keep, |sha256| provenance(shape, sha256)).unwrap();
        let expected = read();
        let mut npy = Vec::new();
        npy::write_tile(&tile, &mut npy).unwrap();
        assert_eq!(expected[0], npy);
        let digest: String =
            Sha256::digest(&npy).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(Sidecar::parse(&expected[1]).unwrap(), provenance(shape, digest));
        let mut png = Vec::new();
        preview(&tile).encode(&mut png).unwrap();
        assert_eq!(expected[2], png);

        for size in [1, 13, 100, shape.coordinates() + 1] {
            let (outputs, read) = files(&format!("{size}.npy"));
            let pieces = &mut |put: &mut Put<'_>| tile.samples().chunks(size).try_for_each(put);
            outputs
                .write_streamed(shape, Existing::Keep, pieces, |sha256| provenance(shape, sha256))
                .unwrap();
            assert_eq!(read(), expected);
        }
    }

    #[test]
    fn a_tile_that_is_not_complete_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let shape = TileShape::new(7, 5, 3, 2, 3).unwrap();
        let outputs = Outputs::of(&folder.path().join("tile.npy"));
        let count = shape.coordinates();
        for (count, fails, part) in [
            (count - 1, false, "instead of"),
            (count + 1, false, "more than"),
            (3, true, "the others are gone"),
        ] {
            let pieces = &mut |put: &mut Put<'_>| {
                put(&vec![0.5; count])?;
                if fails { Err(io::Error::other("the others are gone")) } else { Ok(()) }
            };
            let error = outputs
                .write_streamed(shape, Existing::Keep, pieces, |_| panic!("no tile"))
                .unwrap_err();
            assert!(error.to_string().contains(part), "{error}");
            assert!(error.to_string().contains("tile.npy"), "{error}");
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }
}
