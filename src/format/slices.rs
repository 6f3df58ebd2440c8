//! A tile as pictures: a PNG or EXR file per frame, all frames below each other in a strip, or as layers
//! of one EXR file.
//!
//! PNG files have the levels of [`texture`](super::texture). EXR files have coordinates as they are.
//!
//! All PNG files of a folder are read as the slices of one tile, and so are all EXR files. So an export
//! refuses a folder with others than its own, or removes them if they are slices of an earlier export:
//! that is why PNG files name the software that made them.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};

#[cfg(feature = "exr")]
use super::exr_slices;
use super::png::{self, Depth, PixelFormat, Raster};
#[cfg(feature = "exr")]
use super::source::Slice;
use super::texture::{MAX_CHANNELS, Texels};
use super::write::{self, Existing, Staged, WriteError};
use crate::tile::{Tile, TileShape};

/// Dimensions of a file where one picture cannot hold all: what a renderer takes at a time.
const PAIR: usize = 2;

/// What exported files say that they were made by.
pub(super) const SOFTWARE: &str = "Perceptile export";

/// The format of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// PNG with channels of so many bits.
    Png(Depth),
    /// EXR with floats.
    #[cfg(feature = "exr")]
    Exr,
}

impl Picture {
    /// The extension of its files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png(_) => "png",
            #[cfg(feature = "exr")]
            Self::Exr => "exr",
        }
    }
}

/// How the frames of a tile are put into files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stack {
    /// A file for each.
    Files,
    /// All in one picture, from the first at the top.
    Strip,
    /// All in one file, in layers, with all samples and dimensions.
    #[cfg(feature = "exr")]
    Layers,
}

/// How a tile becomes pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SliceOptions {
    /// Their format.
    pub picture: Picture,
    /// Where frames go.
    pub stack: Stack,
    /// Whether numbers in names have leading zeros, so that names sort.
    pub padded: bool,
    /// Channels of a pixel, at least as many as a file has dimensions; without them one dimension
    /// is gray, two or three are RGB, four are RGBA.
    pub texels: Option<Texels>,
}

/// PNG files of 8 bits, one for each frame.
impl Default for SliceOptions {
    fn default() -> Self {
        let picture = Picture::Png(Depth::Eight);
        Self { picture, stack: Stack::Files, padded: true, texels: None }
    }
}

/// The files of a tile of `shape` in `folder`, in the order in which [`write_slices`] writes.
///
/// With one sample per pixel and at most four dimensions: `STEM_f000.png` and so on, or
/// `STEM.png` for a strip or layers. Otherwise a file holds one sample and a pair of dimensions (or all of
/// them, where there are at most four) and says so: `STEM_f000_s00_d02.png` has dimensions 2 and
/// 3 of sample 0.
pub fn slice_paths(
    shape: TileShape,
    options: SliceOptions,
    folder: &Path,
    stem: &str,
) -> Vec<PathBuf> {
    files(shape, options).map(|pieces| folder.join(pieces.name(shape, options, stem))).collect()
}

/// Writes a tile as pictures and returns their paths. They appear together, when all are complete.
///
/// Dimensions are channels: one is gray, two are red and green (blue is 0), three are RGB, four
/// RGBA. A large tile's strip must stay below 2³¹ pixels of height.
///
/// Slices and another tile's slices in one folder could not be kept apart. Beside slices no other
/// picture of their format may stand, and beside strips and layers no slice and nothing of the same stem.
/// With [`Existing::Replace`], those that earlier exports wrote are removed.
///
/// # Errors
/// Before anything is written, those of [`write::probe`] for all files, and the first picture that
/// may not stand beside them and is not to be removed; then what the system reports.
///
/// # Panics
/// If the texels asked for have fewer channels than a file has dimensions.
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
    let alone = (options.stack != Stack::Files).then_some(stem);
    let others = others(folder, &paths, options.picture, alone)?;
    for path in &others {
        if existing == Existing::Keep {
            return Err(WriteError::Beside { path: path.clone() });
        }
        if !is_exported(path) {
            return Err(WriteError::Foreign { path: path.clone() });
        }
    }
    let stage = |(file, path): (SliceFile, &PathBuf)| {
        Staged::new(path, existing, |out| file.write(tile, options, out))
    };
    let staged: Vec<Staged> =
        files(shape, options).zip(&paths).map(stage).collect::<Result<_, _>>()?;
    for path in &others {
        fs::remove_file(path).map_err(WriteError::io(path))?;
    }
    staged.into_iter().try_for_each(Staged::finish)?;
    Ok(paths)
}

/// Pictures of `folder` that may not stand beside `paths`, in order. These are strips of the stem
/// `strips`, or slices if there is none.
fn others(
    folder: &Path,
    paths: &[PathBuf],
    picture: Picture,
    strips: Option<&str>,
) -> Result<Vec<PathBuf>, WriteError> {
    let paths: HashSet<&PathBuf> = paths.iter().collect();
    let mut others = Vec::new();
    for entry in fs::read_dir(folder).map_err(WriteError::io(folder))? {
        let path = entry.map_err(WriteError::io(folder))?.path();
        let base = stem_and_frame(&path);
        let is_apart = strips.is_some_and(|stem| base != stem && !is_slice(&base));
        if has_extension(&path, picture.extension()) && !is_apart && !paths.contains(&path) {
            others.push(path);
        }
    }
    others.sort();
    Ok(others)
}

/// Whether a path has this extension, in whatever case.
pub(super) fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|its| its.eq_ignore_ascii_case(extension))
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
    if !fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        return false;
    }
    #[cfg(feature = "exr")]
    if has_extension(path, "exr") {
        return exr_slices::software(path).is_some_and(|it| it == SOFTWARE);
    }
    let file = File::open(path).ok();
    file.and_then(|file| png::software(BufReader::new(file))).is_some_and(|it| it == SOFTWARE)
}

/// What one picture holds.
#[derive(Debug, Clone, Copy)]
struct Piece {
    /// The only frame, or all.
    frame: Option<usize>,
    sample: usize,
    first_dim: usize,
    dims: usize,
    /// Whether the name must say sample and dimension.
    named: bool,
}

/// The pictures of one file: one, or all as layers.
struct SliceFile(Vec<Piece>);

/// All files of a tile, in natural order of their names.
fn files(shape: TileShape, options: SliceOptions) -> impl Iterator<Item = SliceFile> {
    let group = if shape.dims() > MAX_CHANNELS { PAIR } else { shape.dims() };
    let named = shape.spp() > 1 || shape.dims() > MAX_CHANNELS;
    let is_strip = options.stack == Stack::Strip;
    let frames = if is_strip { 1 } else { shape.frames() };
    let pieces = (0..frames).flat_map(move |frame| {
        (0..shape.spp()).flat_map(move |sample| {
            (0..shape.dims()).step_by(group).map(move |first_dim| Piece {
                frame: (!is_strip).then_some(frame),
                sample,
                first_dim,
                dims: group.min(shape.dims() - first_dim),
                named,
            })
        })
    });
    let all: Vec<SliceFile> = match options.stack {
        #[cfg(feature = "exr")]
        Stack::Layers => vec![SliceFile(pieces.collect())],
        _ => pieces.map(|piece| SliceFile(vec![piece])).collect(),
    };
    all.into_iter()
}

impl SliceFile {
    fn name(&self, shape: TileShape, options: SliceOptions, stem: &str) -> String {
        let name = match options.stack {
            #[cfg(feature = "exr")]
            Stack::Layers => String::new(),
            _ => self.0[0].name(shape, options.padded),
        };
        format!("{stem}{name}.{}", options.picture.extension())
    }

    fn write(
        &self,
        tile: &Tile,
        options: SliceOptions,
        out: &mut (impl Write + ?Sized),
    ) -> io::Result<()> {
        match options.picture {
            Picture::Png(depth) => {
                let piece = self.0[0];
                let layout = piece.layout(options.texels);
                let full = (depth.levels() - 1) as u16;
                let level = |x: Option<f32>, padding: bool| match x {
                    Some(x) => depth.quantize(x),
                    None => {
                        if padding {
                            full
                        } else {
                            0
                        }
                    }
                };
                let levels = piece.values(tile, layout, level);
                let [width, height] = piece.size(tile.shape());
                png::encode_as(&Raster { width, height, layout, depth, levels }, SOFTWARE, out)
            }
            #[cfg(feature = "exr")]
            Picture::Exr => {
                let slice = |piece: &Piece| {
                    let layout = piece.layout(options.texels);
                    let value = |x: Option<f32>, padding: bool| match x {
                        Some(x) => x,
                        None => {
                            if padding {
                                crate::tile::BELOW_ONE
                            } else {
                                0.0
                            }
                        }
                    };
                    let coordinates = piece.values(tile, layout, value);
                    let [width, height] = piece.size(tile.shape());
                    let name = match options.stack {
                        // Without the underscore that parts it from the stem of a file.
                        Stack::Layers => piece.name(tile.shape(), true)[1..].to_owned(),
                        Stack::Files | Stack::Strip => String::new(),
                    };
                    (name, Slice { width, height, layout, depth: None, coordinates })
                };
                let slices: Vec<(String, Slice)> = self.0.iter().map(slice).collect();
                exr_slices::write(&slices, out)
            }
        }
    }
}

impl Piece {
    /// What follows the stem in the name of its file.
    fn name(&self, shape: TileShape, padded: bool) -> String {
        // As many digits as the last number needs keep the files sorted everywhere.
        let digits = if padded { (shape.frames() - 1).to_string().len().max(3) } else { 1 };
        let frame = self.frame.map_or(String::new(), |frame| format!("_f{frame:0digits$}"));
        let digits = if padded { 2 } else { 1 };
        let part = if self.named {
            format!("_s{:0digits$}_d{:0digits$}", self.sample, self.first_dim)
        } else {
            String::new()
        };
        frame + &part
    }

    fn layout(&self, texels: Option<Texels>) -> PixelFormat {
        match texels.map_or(self.dims, Texels::channels) {
            1 => PixelFormat::Gray,
            2 | 3 => PixelFormat::Rgb,
            _ => PixelFormat::Rgba,
        }
    }

    /// Pixels across and down.
    fn size(&self, shape: TileShape) -> [usize; 2] {
        let frames = self.frame.map_or(shape.frames(), |_| 1);
        [shape.width(), frames * shape.height()]
    }

    /// The channels of all pixels: `value` of a coordinate, or of a channel that no dimension has and
    /// whether that is alpha.
    fn values<T>(
        &self,
        tile: &Tile,
        layout: PixelFormat,
        value: impl Fn(Option<f32>, bool) -> T,
    ) -> Vec<T> {
        let shape = tile.shape();
        let (channels, dims) = (layout.channels(), self.dims);
        assert!(dims <= channels, "{dims} dimensions in {channels} channels");
        let frames = self.frame.map_or(0..shape.frames(), |frame| frame..frame + 1);
        let mut values =
            Vec::with_capacity(frames.len() * shape.height() * shape.width() * channels);
        for t in frames {
            for y in 0..shape.height() {
                for x in 0..shape.width() {
                    let point = &tile.point(x, y, t, self.sample)[self.first_dim..][..dims];
                    let channel = |k: usize| value(point.get(k).copied(), k + 1 == MAX_CHANNELS);
                    values.extend((0..channels).map(channel));
                }
            }
        }
        values
    }
}
