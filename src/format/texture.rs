//! Tiles as the texels of a texture: integers of 8 or 16 bits, which containers hold.
//!
//! A coordinate x becomes the level ⌊256 x⌋ or ⌊65,536 x⌋, so that a renderer that reads
//! (level + 1/2) / levels is off by half a level at most, and no level is favoured.
//!
//! A texture has one layer for each frame and sample of a pixel, sample by sample within the frame,
//! and the dimensions of a sample are the channels of its texel. Several tiles can share a texture
//! ([`packed`]): a pair of numbers in red and green, and a third one in blue.

use std::fmt;
use std::io::{self, Read, Write};
use std::str::FromStr;

use thiserror::Error;

use super::png::{Channel, Depth};
use crate::tile::{Tile, TileShape};

/// Most channels of a texel.
pub const MAX_CHANNELS: usize = 4;

/// The channels of a texel, as many as a format has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Texels {
    /// Red.
    R,
    /// Red and green.
    Rg,
    /// Red, green and blue.
    Rgb,
    /// Red, green, blue and alpha.
    Rgba,
}

impl Texels {
    /// All, by their number of channels.
    pub const ALL: [Self; MAX_CHANNELS] = [Self::R, Self::Rg, Self::Rgb, Self::Rgba];

    /// Those with so many channels.
    pub fn of(channels: usize) -> Option<Self> {
        Self::ALL.get(channels.checked_sub(1)?).copied()
    }

    /// The fewest that GPUs have for so many dimensions: none of them has three channels.
    pub fn for_gpu(dims: usize) -> Option<Self> {
        Self::of(if dims == 3 { 4 } else { dims })
    }

    /// Number of channels.
    pub fn channels(self) -> usize {
        self as usize + 1
    }
}

/// The letters of the channels: `r`, `rg`, `rgb`, `rgba`.
impl fmt::Display for Texels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&"rgba"[..self.channels()])
    }
}

impl FromStr for Texels {
    type Err = UnknownTexels;

    fn from_str(text: &str) -> Result<Self, UnknownTexels> {
        let named = Self::ALL.into_iter().find(|texels| texels.to_string() == text);
        named.ok_or(UnknownTexels)
    }
}

/// A text that names no channels of a texel.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("it must be r, rg, rgb or rgba")]
pub struct UnknownTexels;

/// Why a tile is no texture.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum TextureError {
    /// More dimensions than channels.
    #[error("{dims} dimensions do not fit into the {} of `{texels}`: {}", channels(.texels.channels()), fitting(*.dims))]
    Dims {
        /// Dimensions of the tile.
        dims: usize,
        /// The texels asked for.
        texels: Texels,
    },
    /// More dimensions than any texel has channels.
    #[error(
        "the tile has {dims} dimensions, but a texel has at most {MAX_CHANNELS} channels: --channels rg takes \
         two of them, and png8, png16 and npy hold all"
    )]
    Many {
        /// Dimensions of the tile, or of all tiles together.
        dims: usize,
    },
    /// Tiles of different size.
    #[error(
        "tiles of {first} and {other} do not go into one texture: size, frames and samples must agree"
    )]
    Sizes {
        /// Shape of the first tile.
        first: TileShape,
        /// Shape of the other one.
        other: TileShape,
    },
}

fn channels(count: usize) -> String {
    format!("{count} channel{}", if count == 1 { "" } else { "s" })
}

/// The texels that hold so many dimensions, for people.
fn fitting(dims: usize) -> String {
    let names: Vec<String> =
        Texels::ALL.into_iter().skip(dims - 1).map(|texels| format!("`{texels}`")).collect();
    format!("{} would", names.join(" or "))
}

/// The texels of a tile: those asked for, or the fewest that GPUs have.
///
/// # Errors
/// More dimensions than channels.
pub fn texels_for(shape: TileShape, asked: Option<Texels>) -> Result<Texels, TextureError> {
    let dims = shape.dims();
    let least = Texels::for_gpu(dims).ok_or(TextureError::Many { dims })?;
    match asked {
        Some(texels) if texels.channels() < dims => Err(TextureError::Dims { dims, texels }),
        asked => Ok(asked.unwrap_or(least)),
    }
}

/// The level of every channel, texel by texel, row by row, sample by sample, frame by frame. Of the
/// channels that no dimension has, alpha is full and others are 0.
///
/// # Panics
/// If the texels have fewer channels than the tile has dimensions.
pub fn levels(tile: &Tile, texels: Texels, depth: Depth) -> impl Iterator<Item = u16> + '_ {
    let shape = tile.shape();
    assert!(shape.dims() <= texels.channels(), "{texels} for {shape}");
    let full = (depth.levels() - 1) as u16;
    let layers = (0..shape.frames()).flat_map(move |t| (0..shape.spp()).map(move |s| (t, s)));
    let pixels = layers.flat_map(move |(t, s)| {
        let rows = (0..shape.height()).map(move |y| (t, s, y));
        rows.flat_map(move |(t, s, y)| (0..shape.width()).map(move |x| tile.point(x, y, t, s)))
    });
    pixels.flat_map(move |point| {
        let padding = move |channel| if channel == Channel::Alpha as usize { full } else { 0 };
        let level = move |channel: usize| {
            point.get(channel).map_or_else(|| padding(channel), |&x| depth.quantize(x))
        };
        (0..texels.channels()).map(level)
    })
}

/// Writes the [`levels`], little-endian.
///
/// # Errors
/// What `out` reports.
pub(super) fn write_levels(
    tile: &Tile,
    (texels, depth): (Texels, Depth),
    out: &mut (impl Write + ?Sized),
) -> io::Result<()> {
    /// Bytes that are written at a time.
    const BLOCK: usize = 1 << 16;
    let mut block = Vec::with_capacity(BLOCK + 1);
    for level in levels(tile, texels, depth) {
        block.extend(&level.to_le_bytes()[..depth.bytes()]);
        if block.len() >= BLOCK {
            out.write_all(&block)?;
            block.clear();
        }
    }
    out.write_all(&block)
}

/// Reads levels, little-endian, of so many texels across, down and in layers; the caller has held them
/// against the size of the file.
///
/// # Errors
/// What `input` reports, and too little memory.
pub(super) fn read_levels(
    input: &mut impl Read,
    [width, height, layers]: [usize; 3],
    (texels, depth): (Texels, Depth),
) -> io::Result<Vec<u16>> {
    let values = width * height * layers * texels.channels();
    let (mut data, mut levels) = (Vec::new(), Vec::new());
    data.try_reserve_exact(values * depth.bytes()).map_err(io::Error::other)?;
    data.resize(values * depth.bytes(), 0);
    levels.try_reserve_exact(values).map_err(io::Error::other)?;
    input.read_exact(&mut data)?;
    match depth {
        Depth::Eight => levels.extend(data.iter().map(|&level| u16::from(level))),
        Depth::Sixteen => {
            levels.extend(data.as_chunks().0.iter().copied().map(u16::from_le_bytes));
        }
    }
    Ok(levels)
}

/// One tile with the dimensions of all, in their order.
///
/// # Errors
/// Tiles of different size, frames or samples, and more dimensions than a texel has channels.
pub fn packed(tiles: &[Tile]) -> Result<Tile, TextureError> {
    let shape = tiles[0].shape();
    let dims: usize = tiles.iter().map(|tile| tile.shape().dims()).sum();
    let sides = |shape: TileShape| [shape.width(), shape.height(), shape.frames(), shape.spp()];
    if let Some(other) = tiles.iter().find(|tile| sides(tile.shape()) != sides(shape)) {
        return Err(TextureError::Sizes { first: shape, other: other.shape() });
    }
    if tiles.len() > 1 && dims > MAX_CHANNELS {
        return Err(TextureError::Many { dims });
    }
    let [width, height, frames, spp] = sides(shape);
    let all = TileShape::new(width, height, frames, spp, dims)
        .expect("a tile with a few more dimensions is within every limit");
    let mut samples = Vec::with_capacity(all.coordinates());
    for point in 0..all.coordinates() / dims {
        for tile in tiles {
            let dims = tile.shape().dims();
            samples.extend_from_slice(&tile.samples()[point * dims..][..dims]);
        }
    }
    Ok(Tile::new(all, samples).expect("coordinates of tiles are coordinates"))
}

/// A texture that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// Texels across.
    pub width: usize,
    /// Texels down.
    pub height: usize,
    /// Layers.
    pub layers: usize,
    /// Channels of a texel.
    pub texels: Texels,
    /// Bits of a channel.
    pub depth: Depth,
    /// Samples of a pixel and their dimensions, if the file says them.
    pub sample: Option<(usize, usize)>,
    /// The level of every channel, as [`levels`] has them:
    /// `layers · height · width · channels`.
    pub levels: Vec<u16>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(spp: usize, dims: usize, first: f32) -> Tile {
        let shape = TileShape::new(2, 3, 2, spp, dims).unwrap();
        let samples = (0..shape.coordinates()).map(|i| (first + i as f32 * 0.0137).fract());
        Tile::new(shape, samples.collect()).unwrap()
    }

    #[test]
    fn texels_are_in_the_order_of_layers_rows_and_columns() {
        let tile = tile(2, 2, 0.1);
        let all: Vec<u16> = levels(&tile, Texels::Rgba, Depth::Eight).collect();
        let mut texels = all.chunks_exact(4);
        for (t, s) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            for y in 0..3 {
                for x in 0..2 {
                    let point = tile.point(x, y, t, s);
                    let level = |x: f32| (f64::from(x) * 256.0).floor() as u16;
                    let expected = [level(point[0]), level(point[1]), 0, 255];
                    assert_eq!(texels.next().unwrap(), expected, "{t} {s} {y} {x}");
                }
            }
        }
        assert!(texels.next().is_none());
    }

    #[test]
    fn three_dimensions_take_four_channels_unless_told() {
        let of = |dims, asked| texels_for(tile(1, dims, 0.0).shape(), asked);
        assert_eq!(of(1, None), Ok(Texels::R));
        assert_eq!(of(3, None), Ok(Texels::Rgba));
        assert_eq!(of(3, Some(Texels::Rgb)), Ok(Texels::Rgb));
        assert_eq!(of(1, Some(Texels::Rgba)), Ok(Texels::Rgba));
        assert_eq!(of(5, None), Err(TextureError::Many { dims: 5 }));
        let error = of(3, Some(Texels::Rg)).unwrap_err().to_string();
        let expected = "3 dimensions do not fit into the 2 channels of `rg`: `rgb` or `rgba` would";
        assert_eq!(error, expected);
    }

    #[test]
    fn packed_tiles_keep_their_numbers_side_by_side() {
        let (pair, single) = (tile(2, 2, 0.1), tile(2, 1, 0.7));
        let both = packed(&[pair.clone(), single.clone()]).unwrap();
        for (t, s) in [(0, 1), (1, 0)] {
            let point = [pair.point(1, 2, t, s), single.point(1, 2, t, s)].concat();
            assert_eq!(both.point(1, 2, t, s), point);
        }
        assert_eq!(packed(std::slice::from_ref(&pair)).unwrap(), pair);
        let other = Tile::new(TileShape::new(2, 3, 1, 2, 1).unwrap(), vec![0.5; 12]).unwrap();
        assert!(matches!(packed(&[pair.clone(), other]), Err(TextureError::Sizes { .. })));
        let three = [pair.clone(), pair, single];
        assert_eq!(packed(&three), Err(TextureError::Many { dims: 5 }));
    }
}
