//! A tile as PNG files: a file per frame, or all frames below each other in a strip.
//!
//! A coordinate x becomes the level ⌊256 x⌋ or ⌊65,536 x⌋, so that a renderer that reads
//! (level + 1/2) / levels is off by half a level at most, and no level is favoured.
//!
//! All PNG files of a folder are read as the slices of one tile. So an export refuses a folder with
//! others than its own, or removes them if they are slices of an earlier export: that is why the
//! files name the software that made them.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use super::png::{self, Depth, PixelFormat, Raster};
use super::write::{self, Existing, Staged, WriteError};
use crate::tile::{Tile, TileShape};

/// Most dimensions that one PNG holds.
const PNG_DIMS: usize = 4;
/// Dimensions of a file where one PNG cannot hold all: what a renderer takes at a time.
const PAIR: usize = 2;

/// What exported files say that they were made by.
const SOFTWARE: &str = "Perceptile export";

/// How a tile becomes PNG files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SliceOptions {
    /// Bits of a channel.
    pub depth: Depth,
    /// All frames in one picture, from the first at the top, and not a file for each.
    pub strip: bool,
}

/// The files of a tile of `shape` in `folder`, in the order in which [`write_slices`] writes.
///
/// With one sample per pixel and at most four dimensions: `STEM_f000.png` and so on, or
/// `STEM.png` for a strip. Otherwise a file holds one sample and a pair of dimensions (or all of
/// them, where there are at most four) and says so: `STEM_f000_s00_d02.png` has dimensions 2 and
/// 3 of sample 0.
pub fn slice_paths(
    shape: TileShape,
    options: SliceOptions,
    folder: &Path,
    stem: &str,
) -> Vec<PathBuf> {
    pieces(shape, options).map(|piece| folder.join(piece.name(shape, stem))).collect()
}

/// Writes a tile as PNG files and returns their paths. They appear together, when all are complete.
///
/// Dimensions are channels: one is gray, two are red and green (blue is 0), three are RGB, four
/// RGBA. A large tile's strip must stay below 2³¹ pixels of height.
///
/// Slices and another tile's slices in one folder could not be kept apart. Beside slices no other
/// PNG file may stand, and beside strips no slice and no strip of the same stem. With
/// [`Existing::Replace`], those that earlier exports wrote are removed.
///
/// # Errors
/// Before anything is written, those of [`write::probe`] for all files, and the first PNG file that
/// may not stand beside them and is not to be removed; then what the system reports.
pub fn write_slices(
    tile: &Tile,
    options: SliceOptions,
    folder: &Path,
    stem: &str,
    existing: Existing,
) -> Result<Vec<PathBuf>, WriteError> {
    let shape = tile.shape();
    let paths = slice_paths(shape, options, folder, stem);
    write::probe(&paths, existing)?;
    let others = others(folder, &paths, options.strip.then_some(stem))?;
    for path in &others {
        if existing == Existing::Keep {
            return Err(WriteError::Beside { path: path.clone() });
        }
        if !is_exported(path) {
            return Err(WriteError::Foreign { path: path.clone() });
        }
    }
    let stage = |(piece, path): (SliceFile, &PathBuf)| {
        let raster = piece.raster(tile, options.depth);
        Staged::new(path, existing, |out| png::encode_as(&raster, SOFTWARE, out))
    };
    let staged: Vec<Staged> =
        pieces(shape, options).zip(&paths).map(stage).collect::<Result<_, _>>()?;
    for path in &others {
        fs::remove_file(path).map_err(WriteError::io(path))?;
    }
    staged.into_iter().try_for_each(Staged::finish)?;
    Ok(paths)
}

/// PNG files of `folder` that may not stand beside `paths`, in order. These are strips of the stem
/// `strips`, or slices if there is none.
fn others(
    folder: &Path,
    paths: &[PathBuf],
    strips: Option<&str>,
) -> Result<Vec<PathBuf>, WriteError> {
    let paths: HashSet<&PathBuf> = paths.iter().collect();
    let mut others = Vec::new();
    for entry in fs::read_dir(folder).map_err(WriteError::io(folder))? {
        let path = entry.map_err(WriteError::io(folder))?.path();
        let base = stem_and_frame(&path);
        let is_apart = strips.is_some_and(|stem| base != stem && !is_slice(&base));
        if is_png(&path) && !is_apart && !paths.contains(&path) {
            others.push(path);
        }
    }
    others.sort();
    Ok(others)
}

/// Whether a path is read as a slice if it lies in a folder of slices.
pub(super) fn is_png(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
}

/// The name of a file without the extension, sample and dimension.
fn stem_and_frame(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or(OsStr::new("")).to_string_lossy();
    let part = without_number(&stem, "_d").and_then(|stem| without_number(stem, "_s"));
    part.unwrap_or(&stem).to_owned()
}

/// Whether the name of a file says which frame it is.
pub(super) fn names_frame(path: &Path) -> bool {
    is_slice(&stem_and_frame(path))
}

/// Whether a name without sample and dimension says its frame.
fn is_slice(base: &str) -> bool {
    without_number(base, "_f").is_some()
}

/// What stands before a mark and a number at the end of a name.
fn without_number<'a>(name: &'a str, mark: &str) -> Option<&'a str> {
    let before = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if before.len() < name.len() { before.strip_suffix(mark) } else { None }
}

/// Whether a file was written by an export.
fn is_exported(path: &Path) -> bool {
    // Asked before opening, which would wait for ever on a pipe; a link is somebody else's.
    let is_file = fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file());
    let file = is_file.then(|| File::open(path).ok()).flatten();
    file.and_then(|file| png::software(BufReader::new(file))).is_some_and(|it| it == SOFTWARE)
}

/// What one file holds.
struct SliceFile {
    /// The only frame, or all.
    frame: Option<usize>,
    sample: usize,
    first_dim: usize,
    dims: usize,
    /// Whether the name must say sample and dimension.
    named: bool,
}

/// All files of a tile, in natural order of their names.
fn pieces(shape: TileShape, options: SliceOptions) -> impl Iterator<Item = SliceFile> {
    let group = if shape.dims() > PNG_DIMS { PAIR } else { shape.dims() };
    let named = shape.spp() > 1 || shape.dims() > PNG_DIMS;
    let files = if options.strip { 1 } else { shape.frames() };
    (0..files).flat_map(move |frame| {
        (0..shape.spp()).flat_map(move |sample| {
            (0..shape.dims()).step_by(group).map(move |first_dim| SliceFile {
                frame: (!options.strip).then_some(frame),
                sample,
                first_dim,
                dims: group.min(shape.dims() - first_dim),
                named,
            })
        })
    })
}

impl SliceFile {
    fn name(&self, shape: TileShape, stem: &str) -> String {
        // As many digits as the last number needs keep the files sorted everywhere.
        let digits = (shape.frames() - 1).to_string().len().max(3);
        let frame = self.frame.map_or(String::new(), |frame| format!("_f{frame:0digits$}"));
        let part = if self.named {
            format!("_s{:02}_d{:02}", self.sample, self.first_dim)
        } else {
            String::new()
        };
        format!("{stem}{frame}{part}.png")
    }

    fn raster(&self, tile: &Tile, depth: Depth) -> Raster {
        let shape = tile.shape();
        let layout = match self.dims {
            1 => PixelFormat::Gray,
            2 | 3 => PixelFormat::Rgb,
            _ => PixelFormat::Rgba,
        };
        let frames = self.frame.map_or(0..shape.frames(), |frame| frame..frame + 1);
        let height = frames.len() * shape.height();
        let mut levels = vec![0; height * shape.width() * layout.channels()];
        let mut pixels = levels.chunks_exact_mut(layout.channels());
        for t in frames {
            for y in 0..shape.height() {
                for x in 0..shape.width() {
                    let point = &tile.point(x, y, t, self.sample)[self.first_dim..];
                    let pixel = pixels.next().expect("the raster has every pixel of its frames");
                    for (level, &coordinate) in pixel.iter_mut().zip(&point[..self.dims]) {
                        *level = depth.quantize(coordinate);
                    }
                }
            }
        }
        Raster { width: shape.width(), height, layout, depth, levels }
    }
}
