//! The textures that lie in the repository are what the program makes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use perceptile::format::sidecar::{Sidecar, file_digest};
use perceptile::format::source::TileSource;

use crate::child::output;
use crate::format::{bits, quantized};
use crate::tool::{PROGRAM, PROGRESS};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tiles")
}

#[test]
fn every_texture_has_its_provenance() {
    let mut textures = 0;
    for entry in fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|it| it != "ktx2" && it != "png") {
            continue;
        }
        let stem = path.file_stem().unwrap().to_str().unwrap().replace("-3d", "");
        let sidecar = Sidecar::read(&folder().join(format!("{stem}.json"))).unwrap();
        let frames = (path.extension().unwrap() == "png").then_some(32);
        let tile = TileSource { frames, ..TileSource::new(&path) }.read().unwrap();
        assert_eq!(tile.shape(), sidecar.shape, "{}", path.display());
        assert!(!sidecar.scores.is_null(), "{stem}");
        textures += 1;
    }
    assert_eq!(textures, 6);
}

/// The one that takes the shortest time is made again by the command in its provenance.
#[test]
fn a_texture_is_made_again_by_its_command() {
    let sidecar = Sidecar::read(&folder().join("scalar-60hz.json")).unwrap();
    let room = tempfile::tempdir().unwrap();
    let words = sidecar.command.strip_prefix("perceptile ").unwrap();
    let line = format!("exec \"$0\" {words} --integrands 0 --out again.npy");
    let mut command = Command::new("sh");
    command.args(["-c", &line, PROGRAM]).current_dir(room.path()).env(PROGRESS.0, PROGRESS.1);
    let done = output(&mut command);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let again = room.path().join("again.npy");
    assert_eq!(file_digest(&again).unwrap(), sidecar.sha256);
    let made = TileSource::new(again).read().unwrap();
    let texture = TileSource::new(folder().join("scalar-60hz.ktx2")).read().unwrap();
    assert_eq!(bits(&texture), bits(&quantized(&made, 256.0)));
}
