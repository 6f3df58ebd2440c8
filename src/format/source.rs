//! A tile from a path, whatever it holds: a `.npy` file, a KTX2 texture, a raw volume, a strip of PNG
//! slices, EXR layers, or a folder of slices.
//!
//! The content decides what a file is, not its name; raw volumes alone have no mark of their own, and
//! are known by the description beside them.

#[cfg(feature = "exr")]
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use thiserror::Error;

#[cfg(feature = "exr")]
use super::exr::ExrError;
#[cfg(feature = "exr")]
use super::exr_slices;
use super::ktx2::{self, Ktx2Error};
use super::npy::{self, NpyError};
use super::picture::PREVIEW;
use super::png::{self, Channel, Channels, Depth, PixelFormat, PngError, Raster};
use super::raw::{self, RawError};
use super::series::{Series, SeriesError, SeriesLayout};
use super::slices::{has_extension, names_frame};
use super::texture::Texture;
use crate::tile::{BELOW_ONE, ShapeError, Tile, TileShape};

/// Most coordinates of a tile made of pictures, which compress too well for the size of the files to
/// bound them: 4 GiB.
const MAX_COORDINATES: usize = 1 << 30;

/// Why a path gives no tile.
#[derive(Debug, Error)]
pub enum SourceError {
    /// Opening or reading failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// What was to be read.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// A pipe or a device, whose size nobody knows.
    #[error("cannot read {}: it is neither a file nor a folder", path.display())]
    Special {
        /// The path.
        path: PathBuf,
    },
    /// A file of another kind.
    #[error(
        "cannot read {}: it is no .npy file, PNG, KTX2 texture, EXR file or raw volume with its .json{}",
        path.display(), instead(tile.as_deref())
    )]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The tile that it stands beside, if it has the name of its provenance.
        tile: Option<PathBuf>,
    },
    /// A `.npy` file that is no tile.
    #[error("cannot read {}: {error}", path.display())]
    Npy {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: NpyError,
    },
    /// A PNG that cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Png {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: PngError,
    },
    /// A KTX2 file that cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Ktx2 {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: Ktx2Error,
    },
    /// A raw volume that cannot be read.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// An EXR file that cannot be read.
    #[cfg(feature = "exr")]
    #[error("cannot read {}: {error}", path.display())]
    Exr {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: ExrError,
    },
    /// An EXR file with several layers among slices.
    #[error("cannot read {}: it has {layers} layers, but a slice has one", path.display())]
    Layers {
        /// The file.
        path: PathBuf,
        /// Layers there.
        layers: usize,
    },
    /// Layers of one name.
    #[error("cannot read {}: several layers have the same name", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
    },
    /// A number in a picture that is no coordinate.
    #[error("cannot read {}: it has a value of {value}, but every coordinate must be in [0, 1)", path.display())]
    Coordinate {
        /// The file.
        path: PathBuf,
        /// The value.
        value: f32,
    },
    /// A folder whose pictures are not the slices of one tile.
    #[error("cannot read {}: {error}", path.display())]
    Series {
        /// The folder.
        path: PathBuf,
        /// What is wrong.
        error: SeriesError,
    },
    /// A folder without pictures.
    #[error("cannot read {}: the folder has neither PNG nor EXR files", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// A slice that differs from the first.
    #[error("cannot read {}: it has {found}, but the first slice has {expected}", path.display())]
    Unequal {
        /// The slice.
        path: PathBuf,
        /// Its size, channels and bits.
        found: String,
        /// The first slice's.
        expected: String,
    },
    /// A channel that was asked for is not there.
    #[error("cannot read channel {channel} of {}: it has {held}", path.display())]
    Channel {
        /// The file.
        path: PathBuf,
        /// The channel asked for.
        channel: Channel,
        /// What the file has.
        held: String,
    },
    /// Files that should hold one sample's dimensions one after the other do not.
    #[error("cannot read {}: the file should begin with dimension {expected}", path.display())]
    Dimensions {
        /// The file.
        path: PathBuf,
        /// The dimension that follows those of the file before.
        expected: usize,
    },
    /// The picture that is written beside a tile.
    #[error("{} is the picture of a tile, not a tile{}", path.display(), instead(tile.as_deref()))]
    Preview {
        /// The picture.
        path: PathBuf,
        /// Its tile, if that is beside it.
        tile: Option<PathBuf>,
    },
    /// A strip that cannot be cut into slices as asked.
    #[error(
        "cannot read {}: a strip of {width}x{height} pixels is no whole number of slices of {slice}",
        path.display()
    )]
    Strip {
        /// The file.
        path: PathBuf,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// What the slices should be.
        slice: String,
    },
    /// The number of frames differs from the one asked for.
    #[error("{} has {found} frames, but {asked} were asked for", path.display())]
    Frames {
        /// The file or folder.
        path: PathBuf,
        /// Frames there.
        found: usize,
        /// Frames asked for.
        asked: usize,
    },
    /// The slices are no whole number of frames.
    #[error("{} has {slices} slices, which cannot hold {spp} samples per pixel", path.display())]
    Spp {
        /// The file or folder.
        path: PathBuf,
        /// Slices, or samples per pixel, there.
        slices: usize,
        /// Samples per pixel asked for.
        spp: usize,
    },
    /// The sizes are not those of a tile.
    #[error("cannot read {}: {error}", path.display())]
    Shape {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong.
        error: ShapeError,
    },
    /// More coordinates than are read from pictures, or than the machine has memory for.
    #[error(
        "cannot read {}: a tile of {shape} is too large to be read from pictures",
        path.display()
    )]
    Large {
        /// The file or folder.
        path: PathBuf,
        /// The tile that it would be.
        shape: TileShape,
    },
}

/// What to give in place of a picture, if it is known.
fn instead(tile: Option<&Path>) -> String {
    tile.map_or_else(String::new, |tile| format!(": give {}", tile.display()))
}

/// Where a tile is read from, and what its file does not say itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TileSource {
    /// A `.npy` file (see [`npy::read_tile`]), a KTX2 texture (see [`ktx2::read`]), a raw volume with
    /// its description (see [`raw::read`]), a PNG with all slices below each other, an EXR file with
    /// a layer for each slice, or a folder of PNG or EXR slices (see [`Series`]; files of other kinds
    /// in it do not matter).
    pub path: PathBuf,
    /// Channels that are the dimensions of a sample, in this order. In a `.npy` file, dimensions
    /// 0 to 3 go by the names r, g, b and a.
    ///
    /// By default every dimension of a file that says how many it has, and of others every channel;
    /// but alpha does not count where it is full in all pixels, and green and blue do not where they
    /// are the last then and 0, as in pictures of one or two dimensions that were saved as RGBA.
    pub channels: Option<Channels>,
    /// Samples per pixel: the last axis of a `.npy` file of four axes is cut into as many parts;
    /// as many consecutive PNG slices make one frame. By default what the file says, else 1.
    pub spp: Option<usize>,
    /// Frames. A strip is cut into as many; without it, its slices are taken to be square. Where
    /// the file says it, the two must agree.
    pub frames: Option<usize>,
}

impl TileSource {
    /// A source that is read as its files say.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), channels: None, spp: None, frames: None }
    }

    /// Reads the tile.
    ///
    /// # Errors
    /// Any [`SourceError`]: nothing there that can be read, damage, or a contradiction between
    /// the files and what was asked for.
    pub fn read(&self) -> Result<Tile, SourceError> {
        let metadata = fs::metadata(&self.path).map_err(self.io())?;
        if metadata.is_dir() {
            return self.read_folder();
        }
        let (mut file, bytes) = open(&self.path)?;
        let mut start = Vec::new();
        Read::by_ref(&mut file).take(12).read_to_end(&mut start).map_err(self.io())?;
        file.rewind().map_err(self.io())?;
        if start.starts_with(png::SIGNATURE) {
            self.read_strip(file, bytes)
        } else if start.starts_with(b"\x93NUMPY") {
            self.read_npy(file, bytes)
        } else if start == ktx2::SIGNATURE {
            let texture = ktx2::read(file, bytes)
                .map_err(|error| SourceError::Ktx2 { path: self.path.clone(), error })?;
            self.read_texture(&texture)
        } else if is_exr(&start) {
            self.read_layers()
        } else if raw::description_of(&self.path).is_file() {
            self.read_texture(&raw::read(&self.path)?)
        } else {
            let is_sidecar = self.path.extension().is_some_and(|it| it == "json");
            let tile = is_sidecar.then(|| self.tile_beside()).flatten();
            Err(SourceError::Unknown { path: self.path.clone(), tile })
        }
    }

    /// The tile to which a picture or a provenance at the path would belong.
    fn tile_beside(&self) -> Option<PathBuf> {
        Some(self.path.with_extension("npy")).filter(|tile| tile.is_file())
    }

    fn read_npy(&self, file: BufReader<File>, bytes: u64) -> Result<Tile, SourceError> {
        let tile = npy::read_tile(file, bytes, self.spp)
            .map_err(|error| SourceError::Npy { path: self.path.clone(), error })?;
        self.check_frames(tile.shape().frames())?;
        match &self.channels {
            None => Ok(tile),
            Some(channels) => self.select(&tile, channels),
        }
    }

    /// The tile that has only the dimensions that `channels` name.
    fn select(&self, tile: &Tile, channels: &Channels) -> Result<Tile, SourceError> {
        let shape = tile.shape();
        let dims = channels
            .as_slice()
            .iter()
            .map(|&channel| {
                let dim = channel as usize;
                (dim < shape.dims()).then_some(dim).ok_or_else(|| SourceError::Channel {
                    path: self.path.clone(),
                    channel,
                    held: format!("{} dimensions", shape.dims()),
                })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let points = tile.samples().chunks_exact(shape.dims());
        let samples = points.flat_map(|point| dims.iter().map(|&dim| point[dim])).collect();
        Ok(Tile::new(with_dims(shape, dims.len()), samples)
            .expect("coordinates of a tile make a tile"))
    }

    /// The tile in the layers of a texture.
    fn read_texture(&self, texture: &Texture) -> Result<Tile, SourceError> {
        let path = || self.path.clone();
        let layers = texture.layers;
        let spp = match (texture.sample, self.spp) {
            (Some((held, _)), Some(spp)) if spp != held => {
                return Err(SourceError::Spp { path: path(), slices: layers, spp });
            }
            (held, spp) => spp.or(held.map(|(spp, _)| spp)).unwrap_or(1),
        };
        if spp == 0 || !layers.is_multiple_of(spp) {
            return Err(SourceError::Spp { path: path(), slices: layers, spp });
        }
        self.check_frames(layers / spp)?;
        let channels = texture.texels.channels();
        // What the file leaves open may be mere padding.
        let (dims, padding) = match (&self.channels, texture.sample) {
            (Some(asked), _) => (asked.as_slice(), Vec::new()),
            (None, Some((_, dims))) => (Channel::first(dims), Vec::new()),
            (None, None) => {
                let [none, full] = padding(Some(texture.depth));
                (Channel::first(channels), vec![none, none, none, full])
            }
        };
        if let Some(&channel) = dims.iter().find(|&&channel| channel as usize >= channels) {
            let held = format!("channels {}", texture.texels);
            return Err(SourceError::Channel { path: path(), channel, held });
        }
        let (width, height) = (texture.width, texture.height);
        let shape = TileShape::new(width, height, layers / spp, spp, dims.len())
            .map_err(|error| SourceError::Shape { path: path(), error })?;
        let mut samples = Vec::new();
        let memory = samples.try_reserve_exact(shape.coordinates());
        memory.map_err(|_| SourceError::Large { path: path(), shape })?;
        let pixels = width * height;
        for frame in texture.levels.chunks_exact(pixels * spp * channels) {
            for pixel in 0..pixels {
                for sample in 0..spp {
                    let texel = &frame[(sample * pixels + pixel) * channels..][..channels];
                    let coordinate = |&channel| texture.depth.coordinate(texel[channel as usize]);
                    samples.extend(dims.iter().map(coordinate));
                }
            }
        }
        Ok(trimmed(shape, samples, &padding))
    }

    /// The tile in the layers of an EXR file.
    #[cfg(feature = "exr")]
    fn read_layers(&self) -> Result<Tile, SourceError> {
        let slices = slices_of_exr(&self.path)?;
        let count = slices.len();
        if let [(name, slice)] = &slices[..]
            && name.is_empty()
        {
            return self.cut(slice);
        }
        // As if they were files, whose names begin with that of the tile.
        let named = slices.into_iter().map(|(name, slice)| (format!("_{name}"), slice));
        let mut by_name: HashMap<String, Slice> = named.collect();
        if by_name.len() < count {
            return Err(SourceError::Twice { path: self.path.clone() });
        }
        let names = by_name.keys().cloned().collect();
        self.assemble(names, |name| {
            let slice = by_name.remove(name).expect("one of the names");
            Ok((self.path.clone(), slice))
        })
    }

    #[cfg(not(feature = "exr"))]
    fn read_layers(&self) -> Result<Tile, SourceError> {
        Err(SourceError::Unknown { path: self.path.clone(), tile: None })
    }

    fn read_strip(&self, mut file: BufReader<File>, bytes: u64) -> Result<Tile, SourceError> {
        if png::software(&mut file).is_some_and(|software| software == PREVIEW) {
            let tile = self.tile_beside();
            return Err(SourceError::Preview { path: self.path.clone(), tile });
        }
        file.rewind().map_err(self.io())?;
        self.cut(&decode(&self.path, file, bytes)?)
    }

    /// The tile of a strip of slices.
    fn cut(&self, strip: &Slice) -> Result<Tile, SourceError> {
        let spp = self.spp.unwrap_or(1);
        let (height, slice) = match self.frames {
            Some(frames) => {
                let slices = frames.saturating_mul(spp);
                (strip.height.checked_div(slices).unwrap_or(0), format!("{slices} in all"))
            }
            None => (strip.width, format!("{0}x{0} pixels", strip.width)),
        };
        let whole = height > 0
            && strip.height.is_multiple_of(height)
            && self.frames.is_none_or(|frames| frames * spp * height == strip.height);
        if !whole {
            return Err(SourceError::Strip {
                path: self.path.clone(),
                width: strip.width,
                height: strip.height,
                slice,
            });
        }
        let slices = strip.height / height;
        let heads = [(self.path.clone(), strip)];
        let mut tile = Assembly::new(self, &heads, height, slices, None)?;
        for slice in 0..slices {
            tile.add(strip, slice * height, slice, 0);
        }
        Ok(tile.finish())
    }

    fn read_folder(&self) -> Result<Tile, SourceError> {
        let (mut pictures, mut others) = (Vec::new(), Vec::new());
        for entry in fs::read_dir(&self.path).map_err(self.io())? {
            let name = entry.map_err(self.io())?.file_name();
            for (extension, names) in [("png", &mut pictures), ("exr", &mut others)] {
                if has_extension(Path::new(&name), extension) {
                    names.push(name.to_string_lossy().into_owned());
                }
            }
        }
        let names = if pictures.is_empty() { others } else { pictures };
        // A lone picture of several squares, whose name says no frame, is a strip.
        if let [name] = names.as_slice() {
            let path = self.path.join(name);
            let is_stack = match read_slice(&path) {
                Ok(Slice { width, height, .. }) => height > width && height.is_multiple_of(width),
                Err(SourceError::Layers { .. }) => true,
                Err(error) => return Err(error),
            };
            if is_stack && !names_frame(&path) {
                return Self { path, ..self.clone() }.read();
            }
        }
        self.assemble(names, |name| {
            let path = self.path.join(name);
            Ok((path.clone(), read_slice(&path)?))
        })
    }

    /// The tile of the slices that have these names.
    fn assemble(
        &self,
        names: Vec<String>,
        mut read: impl FnMut(&str) -> Result<(PathBuf, Slice), SourceError>,
    ) -> Result<Tile, SourceError> {
        let series = Series::new(names)
            .map_err(|error| SourceError::Series { path: self.path.clone(), error })?;
        // The files of the first sample say what all others must be.
        let groups = series.layout.as_ref().map_or(1, |layout| layout.first_dims.len());
        let (first, others) = series.names.split_at(groups.min(series.names.len()));
        let heads = first.iter().map(|name| read(name)).collect::<Result<Vec<_>, _>>()?;
        let heads: Vec<_> = heads.iter().map(|(path, slice)| (path.clone(), slice)).collect();
        let Some((_, head)) = heads.first() else {
            return Err(SourceError::Empty { path: self.path.clone() });
        };
        let slices = series.names.len() / groups;
        let mut tile = Assembly::new(self, &heads, head.height, slices, series.layout.as_ref())?;
        for (group, (_, slice)) in heads.iter().enumerate() {
            tile.add(slice, 0, 0, group);
        }
        for (number, name) in (groups..).zip(others) {
            let (path, slice) = read(name)?;
            let group = number % groups;
            same_form(&path, &slice, heads[group].1)?;
            tile.add(&slice, 0, number / groups, group);
        }
        Ok(tile.finish())
    }

    fn check_frames(&self, found: usize) -> Result<(), SourceError> {
        match self.frames {
            Some(asked) if asked != found => {
                Err(SourceError::Frames { path: self.path.clone(), found, asked })
            }
            _ => Ok(()),
        }
    }

    fn io(&self) -> impl FnOnce(io::Error) -> SourceError {
        let path = self.path.clone();
        |error| SourceError::Io { path, error }
    }
}

/// One picture of a tile, with the coordinates that its levels stand for.
pub(super) struct Slice {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Channels of a pixel.
    pub layout: PixelFormat,
    /// Bits of a channel, or floats.
    pub depth: Option<Depth>,
    /// Coordinates row by row from the top, pixel by pixel, channel by channel.
    pub coordinates: Vec<f32>,
}

impl From<Raster> for Slice {
    fn from(raster: Raster) -> Self {
        let Raster { width, height, layout, depth, levels } = raster;
        let coordinates = levels.into_iter().map(|level| depth.coordinate(level)).collect();
        Self { width, height, layout, depth: Some(depth), coordinates }
    }
}

/// The coordinates of no colour and of full opacity, which channels without a dimension have: of levels, or
/// of floats.
fn padding(depth: Option<Depth>) -> [f32; 2] {
    match depth {
        Some(depth) => [0, (depth.levels() - 1) as u16].map(|level| depth.coordinate(level)),
        None => [0.0, BELOW_ONE],
    }
}

/// A tile that grows slice by slice.
struct Assembly {
    shape: TileShape,
    samples: Vec<f32>,
    /// For each file of a sample: where in a pixel its dimensions stand, in order.
    positions: Vec<Vec<usize>>,
    /// For each dimension, the coordinate of a channel that has none, if some may be mere padding.
    padding: Option<Vec<f32>>,
}

impl Assembly {
    /// A tile of `slices` slices of `height` rows, whose first sample is in `heads`.
    fn new(
        source: &TileSource,
        heads: &[(PathBuf, &Slice)],
        height: usize,
        slices: usize,
        layout: Option<&SeriesLayout>,
    ) -> Result<Self, SourceError> {
        let path = || source.path.clone();
        let (_, first) = heads[0];
        let spp = match (layout, source.spp) {
            (Some(layout), Some(spp)) if spp != layout.spp => {
                return Err(SourceError::Spp { path: path(), slices: layout.spp, spp });
            }
            (Some(layout), _) => layout.spp,
            (None, spp) => spp.unwrap_or(1),
        };
        if spp == 0 || !slices.is_multiple_of(spp) {
            return Err(SourceError::Spp { path: path(), slices, spp });
        }
        source.check_frames(slices / spp)?;

        let mut dims = 0;
        let mut positions = Vec::new();
        for (group, (path, slice)) in heads.iter().enumerate() {
            if (slice.width, slice.height) != (first.width, first.height) {
                same_form(path, slice, first)?;
            }
            let first_dims = layout.map_or(&[][..], |layout| &layout.first_dims);
            let colors = Channel::first(slice.layout.colors());
            let position: Vec<usize> = match (&source.channels, first_dims.get(group + 1)) {
                (Some(channels), _) => channels
                    .as_slice()
                    .iter()
                    .map(|&channel| position(path, slice, channel))
                    .collect::<Result<_, _>>()?,
                (None, Some(&next)) => Channel::first(next.saturating_sub(dims))
                    .iter()
                    .map(|&channel| position(path, slice, channel))
                    .collect::<Result<_, _>>()?,
                // The last of several files has one dimension or a pair.
                (None, None) if group > 0 => (0..colors.len().min(2)).collect(),
                (None, None) => (0..slice.layout.channels()).collect(),
            };
            if first_dims.get(group).is_some_and(|&named| named != dims) {
                return Err(SourceError::Dimensions { path: path.clone(), expected: dims });
            }
            dims += position.len();
            positions.push(position);
        }
        let shape = TileShape::new(first.width, height, slices / spp, spp, dims)
            .map_err(|error| SourceError::Shape { path: path(), error })?;
        let mut samples = Vec::new();
        if shape.coordinates() > MAX_COORDINATES
            || samples.try_reserve_exact(shape.coordinates()).is_err()
        {
            return Err(SourceError::Large { path: path(), shape });
        }
        samples.resize(shape.coordinates(), 0.0);
        let padded = source.channels.is_none() && heads.len() == 1;
        let [none, full] = padding(first.depth);
        let colors = first.layout.colors();
        let padding = padded.then(|| (0..dims).map(|k| if k < colors { none } else { full }));
        Ok(Self { shape, samples, positions, padding: padding.map(Iterator::collect) })
    }

    /// Takes the rows of `slice` from `top` as one file of a slice.
    fn add(&mut self, from: &Slice, top: usize, slice: usize, group: usize) {
        let (spp, dims) = (self.shape.spp(), self.shape.dims());
        let (frame, sample) = (slice / spp, slice % spp);
        let first_dim: usize = self.positions[..group].iter().map(Vec::len).sum();
        let channels = from.layout.channels();
        let pixels = self.shape.width() * self.shape.height();
        let rows = &from.coordinates[top * from.width * channels..][..pixels * channels];
        let points = &mut self.samples[frame * pixels * spp * dims..][..pixels * spp * dims];
        for (pixel, points) in rows.chunks_exact(channels).zip(points.chunks_exact_mut(spp * dims))
        {
            let point = &mut points[sample * dims + first_dim..];
            for (coordinate, &position) in point.iter_mut().zip(&self.positions[group]) {
                *coordinate = pixel[position];
            }
        }
    }

    /// The tile, without channels that are mere padding.
    fn finish(self) -> Tile {
        let Self { shape, samples, padding, .. } = self;
        trimmed(shape, samples, &padding.unwrap_or_default())
    }
}

/// The tile of these samples, without the last dimensions as far as all their coordinates are those of
/// `padding`, which has one for each dimension that may be mere padding, or none.
fn trimmed(mut shape: TileShape, mut samples: Vec<f32>, padding: &[f32]) -> Tile {
    let dims = shape.dims();
    let of = |dim: usize| samples.iter().skip(dim).step_by(dims);
    let is_kept = |&dim: &usize| padding.get(dim).is_none_or(|it| of(dim).any(|x| x != it));
    let kept = (1..dims).rev().find(is_kept).map_or(1, |dim| dim + 1);
    if kept < dims {
        samples = samples.chunks_exact(dims).flat_map(|p| &p[..kept]).copied().collect();
        shape = with_dims(shape, kept);
    }
    Tile::new(shape, samples).expect("slices and levels have coordinates in [0, 1)")
}

/// Where in a pixel a channel that was asked for stands.
fn position(path: &Path, slice: &Slice, channel: Channel) -> Result<usize, SourceError> {
    slice.layout.position(channel).ok_or_else(|| SourceError::Channel {
        path: path.to_owned(),
        channel,
        held: describe(slice),
    })
}

/// The same shape with other dimensions, at most as many as channels.
fn with_dims(shape: TileShape, dims: usize) -> TileShape {
    TileShape::new(shape.width(), shape.height(), shape.frames(), shape.spp(), dims)
        .expect("a few dimensions of a sample are within every limit")
}

/// Opens a regular file and says how long it is.
fn open(path: &Path) -> Result<(BufReader<File>, u64), SourceError> {
    let io = |error| SourceError::Io { path: path.to_owned(), error };
    // Asked before opening, which would wait for ever on a pipe.
    if !fs::metadata(path).map_err(io)?.is_file() {
        return Err(SourceError::Special { path: path.to_owned() });
    }
    let file = File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    Ok((BufReader::new(file), bytes))
}

/// Reads one slice of a folder.
fn read_slice(path: &Path) -> Result<Slice, SourceError> {
    #[cfg(feature = "exr")]
    if has_extension(path, "exr") {
        open(path)?;
        let mut slices = slices_of_exr(path)?;
        return match slices.len() {
            1 => Ok(slices.remove(0).1),
            layers => Err(SourceError::Layers { path: path.to_owned(), layers }),
        };
    }
    let (file, bytes) = open(path)?;
    decode(path, file, bytes)
}

/// The layers of an EXR file, with their names.
#[cfg(feature = "exr")]
fn slices_of_exr(path: &Path) -> Result<Vec<(String, Slice)>, SourceError> {
    let slices = exr_slices::read(path)
        .map_err(|error| SourceError::Exr { path: path.to_owned(), error })?;
    for (_, slice) in &slices {
        if let Some(&value) = slice.coordinates.iter().find(|x| !(0.0..1.0).contains(*x)) {
            return Err(SourceError::Coordinate { path: path.to_owned(), value });
        }
    }
    Ok(slices)
}

/// Whether a file begins as EXR files do.
fn is_exr(start: &[u8]) -> bool {
    start.starts_with(&[0x76, 0x2f, 0x31, 0x01])
}

fn decode(path: &Path, file: BufReader<File>, bytes: u64) -> Result<Slice, SourceError> {
    let raster = png::decode(file, bytes);
    raster.map(Slice::from).map_err(|error| SourceError::Png { path: path.to_owned(), error })
}

/// Size, channels and bits of a picture, for people.
fn describe(slice: &Slice) -> String {
    let layout = match slice.layout {
        PixelFormat::Gray => "gray",
        PixelFormat::GrayAlpha => "gray and alpha",
        PixelFormat::Rgb => "RGB",
        PixelFormat::Rgba => "RGBA",
    };
    let depth = match slice.depth {
        Some(depth) => format!("{} bits", depth.bytes() * 8),
        None => "floats".to_owned(),
    };
    format!("{}x{} pixels, {layout}, {depth}", slice.width, slice.height)
}

/// Checks that a slice is like the one it is compared with.
fn same_form(path: &Path, slice: &Slice, first: &Slice) -> Result<(), SourceError> {
    let (found, expected) = (describe(slice), describe(first));
    if found == expected {
        Ok(())
    } else {
        Err(SourceError::Unequal { path: path.to_owned(), found, expected })
    }
}
