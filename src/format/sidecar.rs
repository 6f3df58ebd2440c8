//! The provenance of a tile: a JSON file beside it that says what it is, how good it is, and the
//! command that makes it again.
//!
//! `tile.npy` has `tile.json`. The digest ties the two: it is the SHA-256 of the whole `.npy`
//! file, so that `sha256sum tile.npy` checks it without this program.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use super::hashed::Hashed;
use super::npy;
use super::write::{self, Existing, WriteError};
use crate::tile::{Tile, TileShape};

/// The version of the format that is written; earlier ones are read.
pub const FORMAT: u32 = 2;
/// Longest sidecar that is read, in bytes.
const MAX_BYTES: u64 = 16 << 20;

/// Why a sidecar cannot be read.
#[derive(Debug, Error)]
pub enum SidecarError {
    /// Opening or reading failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// No regular file, or one too long.
    #[error(
        "cannot read {}: a sidecar is a file of at most {MAX_BYTES} bytes, not {found}",
        path.display()
    )]
    Size {
        /// The path.
        path: PathBuf,
        /// What is there.
        found: String,
    },
    /// The text is not JSON, or not that of a sidecar.
    #[error("not the provenance of a tile: {0}")]
    Json(serde_json::Error),
    /// A later version of the format.
    #[error("the provenance has format {found}, but this version reads formats 1 to {FORMAT}")]
    Format {
        /// The format that the file says.
        found: u32,
    },
    /// The digest is not one.
    #[error("the digest is {found:?}, but it must have 64 digits of 0-9 and a-f")]
    Digest {
        /// What stands there.
        found: String,
    },
}

/// Where a tile comes from. Unknown and missing fields are errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sidecar {
    /// Version of this format, at most [`FORMAT`].
    pub format: u32,
    /// The program that made the tile.
    pub program: String,
    /// Its version.
    pub version: String,
    /// The command line that makes the tile again.
    pub command: String,
    /// The kernel, in the text form that the command takes.
    pub kernel: String,
    /// The seed of every random number.
    pub seed: u64,
    /// The tile's shape.
    pub shape: TileShape,
    /// All options of the optimizer, those left at their defaults included.
    pub options: Value,
    /// When the tile was finished: UTC, `2026-01-31T23:59:59Z`.
    pub created: String,
    /// How long it took, in seconds.
    pub seconds: f64,
    /// SHA-256 of the tile's `.npy` file, see [`digest`].
    pub sha256: String,
    /// The tile's scores; `null` if they were not measured.
    pub scores: Value,
    /// Single steps of the descent, counted from one, and the mean W₂² of their draws; empty in
    /// format 1.
    #[serde(default)]
    pub convergence: Vec<(u32, f64)>,
}

/// The one field that every version has.
#[derive(Deserialize)]
struct Version {
    format: u32,
}

impl Sidecar {
    /// Where the sidecar of a tile is: `tile.npy` → `tile.json`.
    pub fn path_of(tile: &Path) -> PathBuf {
        tile.with_extension("json")
    }

    /// The sidecar that is there for a tile: the one beside a file, and in a folder of slices the
    /// one that has their name, where [`write_slices`](super::slices::write_slices) and a copy of
    /// the sidecar have the same stem.
    pub fn find(tile: &Path) -> Option<PathBuf> {
        if !tile.is_dir() {
            let path = Self::path_of(tile);
            return (path != tile && path.symlink_metadata().is_ok()).then_some(path);
        }
        let entries = fs::read_dir(tile).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
        let is_json = |path: &PathBuf| path.extension().is_some_and(|it| it == "json");
        let mut named = entries.filter(is_json).filter(|path| Self::has_slices(path));
        let only = named.next()?;
        named.next().is_none().then_some(only)
    }

    /// Whether slices or a strip with the name of a sidecar lie beside it.
    pub fn has_slices(sidecar: &Path) -> bool {
        let Some(stem) = sidecar.file_stem().and_then(|stem| stem.to_str()) else {
            return false;
        };
        let slices = format!("{stem}_f");
        let strips = ["png", "exr"].map(|extension| format!("{stem}.{extension}"));
        let is_picture =
            |name: &str| name.starts_with(&slices) || strips.iter().any(|strip| name == strip);
        let entries = fs::read_dir(write::folder_of(sidecar)).into_iter().flatten().flatten();
        entries.into_iter().any(|entry| entry.file_name().to_str().is_some_and(is_picture))
    }

    /// Whether this is the sidecar of the tile of this shape that was read from a path. A `.npy` file
    /// of floats has the digest; other files are exports, so of them only the shape is compared.
    pub fn describes(&self, path: &Path, shape: TileShape) -> bool {
        let sides = |shape: TileShape| [shape.width(), shape.height(), shape.frames()];
        if is_export(path) {
            sides(self.shape) == sides(shape)
        } else {
            file_digest(path).is_ok_and(|digest| digest == self.sha256)
        }
    }

    /// Reads a sidecar from its text.
    ///
    /// # Errors
    /// Text that is not JSON, a later format, fields that are missing, unknown or of another
    /// type (the message has line and column), a shape that is no tile's, a digest that is none.
    pub fn parse(text: &[u8]) -> Result<Self, SidecarError> {
        let Version { format } = serde_json::from_slice(text).map_err(SidecarError::Json)?;
        if !(1..=FORMAT).contains(&format) {
            return Err(SidecarError::Format { found: format });
        }
        let sidecar: Self = serde_json::from_slice(text).map_err(SidecarError::Json)?;
        let hexadecimal = |c: u8| matches!(c, b'0'..=b'9' | b'a'..=b'f');
        if sidecar.sha256.len() != 64 || !sidecar.sha256.bytes().all(hexadecimal) {
            return Err(SidecarError::Digest { found: sidecar.sha256 });
        }
        Ok(sidecar)
    }

    /// Reads a sidecar from its file.
    ///
    /// # Errors
    /// Those of [`Self::parse`], and what keeps the file from being read.
    pub fn read(path: &Path) -> Result<Self, SidecarError> {
        let io = |error| SidecarError::Io { path: path.to_owned(), error };
        let size = |found| SidecarError::Size { path: path.to_owned(), found };
        // Asked before opening, which would wait for ever on a pipe.
        let metadata = fs::metadata(path).map_err(io)?;
        if !metadata.is_file() {
            return Err(size("something else".to_owned()));
        }
        if metadata.len() > MAX_BYTES {
            return Err(size(format!("one of {} bytes", metadata.len())));
        }
        let mut text = Vec::new();
        File::open(path)
            .and_then(|file| file.take(MAX_BYTES).read_to_end(&mut text))
            .map_err(io)?;
        Self::parse(&text)
    }

    /// Writes the sidecar to a file, indented, with a line feed at the end.
    ///
    /// # Errors
    /// Those of [`write::write`].
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), WriteError> {
        write::write(path, existing, |out| out.write_all(&self.text()?))
    }

    /// The text of the file.
    ///
    /// # Errors
    /// Options or scores that no JSON has, such as maps with other keys than texts.
    pub fn text(&self) -> serde_json::Result<Vec<u8>> {
        let mut text = serde_json::to_vec_pretty(self)?;
        text.push(b'\n');
        Ok(text)
    }
}

/// Whether what lies at a path is an export of a tile, and not the tile itself.
fn is_export(path: &Path) -> bool {
    let is_npy = path.extension().is_some_and(|it| it.eq_ignore_ascii_case("npy"));
    let levels = || {
        let file = File::open(path)?;
        let bytes = file.metadata()?.len();
        Ok::<bool, io::Error>(npy::has_levels(file, bytes))
    };
    path.is_dir() || !is_npy || levels().unwrap_or(false)
}

/// The SHA-256 of a tile's `.npy` file (see [`npy::write_tile`]), as 64 hexadecimal digits.
///
/// It depends on the tile alone, so that equal digests mean equal tiles on every machine.
pub fn digest(tile: &Tile) -> String {
    let mut hashed = Hashed::new(io::sink());
    npy::write_tile(tile, &mut hashed).expect("hashing cannot fail");
    hashed.hexadecimal()
}

/// The SHA-256 of any file, to be held against that of a sidecar.
///
/// # Errors
/// What keeps the file from being read.
pub fn file_digest(path: &Path) -> io::Result<String> {
    let mut hashed = Hashed::new(io::sink());
    io::copy(&mut File::open(path)?, &mut hashed)?;
    Ok(hashed.hexadecimal())
}

/// A point in time as `2026-01-31T23:59:59Z`; times before 1970 count as its first second.
pub fn utc(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs();
    let (mut days, clock) = (seconds / 86_400, seconds % 86_400);
    let leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    // The calendar repeats after 400 years, which leaves few years to walk through.
    const CYCLE: u64 = 146_097;
    let mut year = 1970 + 400 * (days / CYCLE);
    days %= CYCLE;
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let february = 28 + u64::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    format!(
        "{year:04}-{month:02}-{:02}T{:02}:{:02}:{:02}Z",
        days + 1,
        clock / 3600,
        clock / 60 % 60,
        clock % 60
    )
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn example() -> Sidecar {
        Sidecar {
            format: FORMAT,
            program: "perceptile".into(),
            version: "0.1.0".into(),
            command: "perceptile optimize --tile 2x1x1 --seed 18446744073709551615".into(),
            kernel: "gaussian(2.1) * fovvideovdp(60)".into(),
            seed: u64::MAX,
            shape: TileShape::new(2, 1, 1, 1, 1).unwrap(),
            options: json!({ "steps": 100, "rate": 0.1_f64 + 0.2, "name": "naïve \"quote\"" }),
            created: utc(UNIX_EPOCH),
            seconds: 1e-3 / 3.0,
            sha256: digest(&small()),
            scores: Value::Null,
            convergence: vec![(1, 0.1 + 0.2), (2, 1e-9)],
        }
    }

    fn small() -> Tile {
        Tile::new(TileShape::new(2, 1, 1, 1, 1).unwrap(), vec![0.25, 0.75]).unwrap()
    }

    #[test]
    fn a_sidecar_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = Sidecar::path_of(&folder.path().join("a.b.npy"));
        assert_eq!(path.file_name().unwrap(), "a.b.json");
        example().write(&path, Existing::Keep).unwrap();
        assert_eq!(Sidecar::read(&path).unwrap(), example());
        assert!(fs::read_to_string(&path).unwrap().ends_with("}\n"));
        let tile = folder.path().join("tile.npy");
        npy::write_tile(&small(), &mut File::create(&tile).unwrap()).unwrap();
        assert_eq!(file_digest(&tile).unwrap(), example().sha256);
    }

    #[test]
    fn a_sidecar_is_found_beside_a_file_and_among_slices() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        assert_eq!(Sidecar::find(&at("a.npy")), None);
        example().write(&at("a.json"), Existing::Keep).unwrap();
        assert_eq!(Sidecar::find(&at("a.npy")), Some(at("a.json")));
        assert_eq!(Sidecar::find(&at("a.json")), None);
        // In a folder the slices say which one is theirs.
        assert_eq!(Sidecar::find(folder.path()), None);
        fs::write(at("a_f000.png"), "").unwrap();
        fs::write(at("b.json"), "").unwrap();
        assert_eq!(Sidecar::find(folder.path()), Some(at("a.json")));
        fs::write(at("b_f000.png"), "").unwrap();
        assert_eq!(Sidecar::find(folder.path()), None);
    }

    #[test]
    fn a_sidecar_describes_the_tile_that_it_was_written_for() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (tile, shape) = (small(), small().shape());
        npy::write_tile(&tile, &mut File::create(at("a.npy")).unwrap()).unwrap();
        assert!(example().describes(&at("a.npy"), shape));
        let other = Tile::new(shape, vec![0.25, 0.5]).unwrap();
        npy::write_tile(&other, &mut File::create(at("b.npy")).unwrap()).unwrap();
        assert!(!example().describes(&at("b.npy"), shape));
        assert!(!example().describes(&at("absent.npy"), shape));
        assert!(example().describes(folder.path(), shape));
        assert!(!example().describes(folder.path(), TileShape::new(1, 2, 1, 1, 1).unwrap()));
    }

    #[test]
    fn every_deviation_is_an_error() {
        let mut value = serde_json::to_value(example()).unwrap();
        let parse = |value: &Value| Sidecar::parse(value.to_string().as_bytes());
        assert_eq!(parse(&value).unwrap(), example());
        for key in value.as_object().unwrap().keys().filter(|&key| key != "convergence") {
            let mut lacking = value.clone();
            lacking.as_object_mut().unwrap().remove(key);
            let error = parse(&lacking).unwrap_err();
            assert!(error.to_string().contains(key.as_str()), "{key}: {error}");
        }
        for (key, bad, message) in [
            ("format", json!(3), "format 3"),
            ("format", json!(-1), "-1"),
            ("seed", json!(-1), "-1"),
            ("seed", json!("1"), "\"1\""),
            (
                "shape",
                json!({"width": 0, "height": 1, "frames": 1, "spp": 1, "dims": 1}),
                "width is 0",
            ),
            ("sha256", json!("xyz"), "xyz"),
            ("sha256", json!("A".repeat(64)), "AAA"),
            ("sead", json!(1), "sead"),
        ] {
            let mut wrong = value.clone();
            wrong[key] = bad;
            let error = parse(&wrong).unwrap_err();
            assert!(error.to_string().contains(message), "{error}");
        }
        let mut first = value.clone();
        first.as_object_mut().unwrap().remove("convergence");
        first["format"] = json!(1);
        assert!(parse(&first).unwrap().convergence.is_empty());
        value["format"] = json!("1");
        assert!(matches!(parse(&value), Err(SidecarError::Json(_))));
        let deep = "[".repeat(1 << 20);
        for text in ["", "{", "null", "[]", "{\"format\": 1}", deep.as_str()] {
            assert!(matches!(Sidecar::parse(text.as_bytes()), Err(SidecarError::Json(_))));
        }
    }

    #[test]
    fn what_is_no_sidecar_file_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(Sidecar::read(folder.path()), Err(SidecarError::Size { .. })));
        let path = folder.path().join("long.json");
        assert!(matches!(Sidecar::read(&path), Err(SidecarError::Io { .. })));
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(matches!(Sidecar::read(&path), Err(SidecarError::Size { .. })));
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        // Computed with GNU date.
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (951_868_800, "2000-03-01T00:00:00Z"),
            (1_798_761_599, "2026-12-31T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
            (13_574_563_200, "2400-02-29T00:00:00Z"),
        ] {
            assert_eq!(utc(UNIX_EPOCH + Duration::from_secs(seconds)), text);
        }
        assert_eq!(utc(UNIX_EPOCH - Duration::from_secs(1)), "1970-01-01T00:00:00Z");
    }
}
