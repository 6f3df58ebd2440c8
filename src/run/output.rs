//! What a run leaves behind: the tile, its provenance and its picture.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use crate::domain::Domain;
use crate::format::claim::Claim;
use crate::format::hashed::Hashed;
use crate::format::npy;
use crate::format::numbers::{ArraySource, NumberSink};
use crate::format::sidecar::Sidecar;
use crate::format::write::{self, Existing, WriteError};
use crate::kernel::KernelTaps;
use crate::metric::Scores;
use crate::preview::Preview;
use crate::tile::TileShape;

/// The files of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputFiles {
    /// The tile: `NAME.npy`.
    pub tile: PathBuf,
    /// Its provenance and scores: `NAME.json`.
    pub sidecar: PathBuf,
    /// Its [picture](crate::preview): `NAME.png`.
    pub picture: PathBuf,
}

impl OutputFiles {
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

    /// Which of the files a path is, if it is one of them.
    pub fn find(&self, path: &Path) -> Option<&Path> {
        let whole = |path: &Path| {
            let folder = write::folder_of(path).canonicalize().ok()?;
            Some(folder.join(path.file_name()?))
        };
        let wanted = whole(path)?;
        let files = [&self.tile, &self.sidecar, &self.picture];
        files.into_iter().map(PathBuf::as_path).find(|file| whole(file).as_ref() == Some(&wanted))
    }

    /// Claims all, so that no other run works for the same ones until they are dropped.
    ///
    /// # Errors
    /// The first that another run claims, and as for [`Self::probe`].
    pub fn claim(&self, existing: Existing) -> Result<[Claim; 3], WriteError> {
        self.probe(existing)?;
        let claim = |path| Claim::new(path, existing);
        Ok([claim(&self.tile)?, claim(&self.sidecar)?, claim(&self.picture)?])
    }

    /// Writes all, the tile first: array 0 of `tile`, in C order, which need never be whole here.
    /// `sidecar` says where the tile comes from when its SHA-256 is known. The picture shows the
    /// tile's error behind `kernel`, and its score if it has been scored.
    ///
    /// # Errors
    /// What the system or `tile` reports, and more or fewer coordinates than the shape has: then
    /// there is no file of this tile. Files that exist stay as they are unless they may be replaced.
    pub fn write(
        &self,
        (domain, shape): (Domain, TileShape),
        tile: &dyn ArraySource,
        kernel: &KernelTaps,
        scores: Option<&Scores>,
        existing: Existing,
        sidecar: impl FnOnce(String) -> Sidecar,
    ) -> Result<(), WriteError> {
        let preview = RefCell::new(Preview::new((domain, shape), kernel));
        let seen = |_: usize, sink: &mut dyn NumberSink| {
            tile.array(0, &mut |piece: &[f32]| {
                preview.borrow_mut().take(piece);
                sink.put(piece)
            })
        };
        let mut digest = String::new();
        write::write(&self.tile, existing, |out| {
            let mut hashed = Hashed::new(out);
            npy::write_pieces(shape, &mut hashed, &seen)?;
            digest = hashed.hexadecimal();
            Ok(())
        })?;
        sidecar(digest).write(&self.sidecar, existing)?;
        preview.into_inner().image(scores).save(&self.picture, existing)
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, io};

    use sha2::{Digest, Sha256};

    use super::*;
    use crate::format::sidecar;
    use crate::kernel::KernelSpec;
    use crate::metric::{Baseline, ScoreOptions};

    fn kernel() -> KernelTaps {
        let spec: KernelSpec = "box(2)".parse().unwrap();
        spec.resolve_without_tile().unwrap().classes()[0].taps.clone()
    }

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
    fn runs_that_share_any_file_exclude_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = |name: &str| OutputFiles::of(&folder.path().join(name));
        let claims = outputs("tile.npy").claim(Existing::Keep).unwrap();
        for (name, shared) in [("tile.npy", "tile.npy"), ("tile.other", "tile.json")] {
            let error = outputs(name).claim(Existing::Replace).unwrap_err();
            assert!(matches!(&error, WriteError::Claimed { .. }), "{error}");
            assert!(error.to_string().contains(shared), "{error}");
        }
        outputs("other.npy").claim(Existing::Keep).unwrap();
        // Its own are not in its way.
        let shape = TileShape::new(7, 5, 3, 2, 3).unwrap();
        let tile = Baseline::White.tile(shape, 4);
        let write = |sha256| provenance(shape, sha256);
        let tile_files = outputs("tile.npy");
        tile_files
            .write((Domain::Square, shape), &tile, &kernel(), None, Existing::Keep, write)
            .unwrap();
        drop(claims);
        let error = outputs("tile.npy").claim(Existing::Keep).unwrap_err();
        assert!(matches!(error, WriteError::Exists { .. }), "{error}");
        let twice = outputs("twice.png").claim(Existing::Keep).unwrap_err();
        assert!(matches!(twice, WriteError::Twice { .. }), "{twice}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_tile_in_pieces_leaves_the_files_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let shape = TileShape::new(7, 5, 3, 2, 3).unwrap();
        let tile = Baseline::White.tile(shape, 4);
        let files = |name: &str| {
            let outputs = OutputFiles::of(&folder.path().join(name));
            let read = |path: &Path| fs::read(path).unwrap();
            (outputs.clone(), move || {
                [&outputs.tile, &outputs.sidecar, &outputs.picture].map(|path| read(path))
            })
        };
        let (whole, read) = files("whole.npy");
        let kernel = kernel();
        let scores = Scores::of(
            &tile,
            &kernel,
            ScoreOptions { set: 0, integrands: 2, ..ScoreOptions::default() },
        )
        .unwrap();
        let sidecar = |sha256| provenance(shape, sha256);
        whole
            .write((Domain::Square, shape), &tile, &kernel, Some(&scores), Existing::Keep, sidecar)
            .unwrap();
        let expected = read();
        let mut npy = Vec::new();
        npy::write_tile(&tile, &mut npy).unwrap();
        assert_eq!(expected[0], npy);
        let digest: String =
            Sha256::digest(&npy).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(Sidecar::parse(&expected[1]).unwrap(), provenance(shape, digest));
        let mut png = Vec::new();
        let mut preview = Preview::new((Domain::Square, shape), &kernel);
        preview.take(tile.samples());
        preview.image(Some(&scores)).encode(&mut png).unwrap();
        assert_eq!(expected[2], png);

        for size in [1, 13, 100, shape.coordinates() + 1] {
            let (outputs, read) = files(&format!("{size}.npy"));
            let pieces = |_: usize, sink: &mut dyn NumberSink| {
                tile.samples().chunks(size).try_for_each(|piece| sink.put(piece))
            };
            outputs
                .write(
                    (Domain::Square, shape),
                    &pieces,
                    &kernel,
                    Some(&scores),
                    Existing::Keep,
                    sidecar,
                )
                .unwrap();
            assert_eq!(read(), expected);
        }
    }

    #[test]
    fn a_tile_that_is_not_complete_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let shape = TileShape::new(7, 5, 3, 2, 3).unwrap();
        let outputs = OutputFiles::of(&folder.path().join("tile.npy"));
        let count = shape.coordinates();
        for (count, fails, part) in [
            (count - 1, false, "instead of"),
            (count + 1, false, "more than"),
            (3, true, "the others are gone"),
        ] {
            let pieces = |_: usize, sink: &mut dyn NumberSink| {
                sink.put(&vec![0.5; count])?;
                if fails { Err(io::Error::other("the others are gone")) } else { Ok(()) }
            };
            let error = outputs
                .write((Domain::Square, shape), &pieces, &kernel(), None, Existing::Keep, |_| {
                    panic!("no tile")
                })
                .unwrap_err();
            assert!(error.to_string().contains(part), "{error}");
            assert!(error.to_string().contains("tile.npy"), "{error}");
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }
}
