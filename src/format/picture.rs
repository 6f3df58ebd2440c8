//! Pictures for people: 8-bit images, and the preview of a tile.
//!
//! The preview shows what the optimizer arranges: noise without low frequencies across a frame,
//! and along time in a slice through the frames.

use std::io::{self, Write};
use std::path::Path;

use thiserror::Error;

use super::png::{self, Depth, PixelFormat, Raster};
use super::write::{self, Existing, WriteError};
use crate::tile::{Tile, TileShape};

/// Pixels that a preview should at least be high.
const PREVIEW_HEIGHT: usize = 256;
/// Pixels that magnification may make a preview wide.
const PREVIEW_WIDTH: usize = 4096;
/// White pixels between the two halves of a preview.
const GAP: usize = 8;

/// Why bytes are not a picture.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum ImageError {
    /// A picture without pixels.
    #[error("a picture of {width}x{height} pixels has none")]
    Empty {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
    /// Pixels are gray or RGB.
    #[error("pixels with {channels} channels, but 1 (gray) or 3 (RGB) are drawn")]
    Channels {
        /// Channels of a pixel.
        channels: usize,
    },
    /// The number of bytes is not that of the size.
    #[error(
        "a picture of {width}x{height} pixels with {channels} channels cannot have {found} bytes"
    )]
    Length {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Channels of a pixel.
        channels: usize,
        /// Bytes given.
        found: usize,
    },
}

/// An 8-bit picture, gray or RGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    channels: usize,
    data: Vec<u8>,
}

impl Image {
    /// A picture of `data`, row by row from the top, pixel by pixel, with 1 channel (gray) or 3
    /// (RGB).
    ///
    /// # Errors
    /// No pixels, other channels, or a length that is not `width · height · channels`.
    pub fn new(
        width: usize,
        height: usize,
        channels: usize,
        data: Vec<u8>,
    ) -> Result<Self, ImageError> {
        if width == 0 || height == 0 {
            return Err(ImageError::Empty { width, height });
        }
        if channels != 1 && channels != 3 {
            return Err(ImageError::Channels { channels });
        }
        let length = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(channels));
        if length != Some(data.len()) {
            return Err(ImageError::Length { width, height, channels, found: data.len() });
        }
        Ok(Self { width, height, channels, data })
    }

    /// A picture whose pixel at `(x, y)` is `pixel(x, y)`, RGB.
    ///
    /// # Errors
    /// No pixels.
    pub fn rgb(
        width: usize,
        height: usize,
        pixel: impl Fn(usize, usize) -> [u8; 3],
    ) -> Result<Self, ImageError> {
        let data = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| pixel(x, y));
        Self::new(width, height, 3, data.collect())
    }

    /// A picture whose pixel at `(x, y)` is `pixel(x, y)`, gray.
    ///
    /// # Errors
    /// No pixels.
    pub fn gray(
        width: usize,
        height: usize,
        pixel: impl Fn(usize, usize) -> u8,
    ) -> Result<Self, ImageError> {
        let data = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Self::new(width, height, 1, data.map(|(x, y)| pixel(x, y)).collect())
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Channels of a pixel: 1 or 3.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// All bytes, row by row from the top, pixel by pixel, channel by channel.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The pixel at `(x, y)`, a byte for each channel.
    ///
    /// # Panics
    /// If it is outside the picture.
    pub fn pixel(&self, x: usize, y: usize) -> &[u8] {
        assert!(x < self.width, "pixel ({x}, {y}) of {}x{}", self.width, self.height);
        &self.data[(y * self.width + x) * self.channels..][..self.channels]
    }

    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// What `out` reports, and sizes above 2³¹ − 1.
    pub fn encode(&self, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
        let raster = Raster {
            width: self.width,
            height: self.height,
            layout: if self.channels == 1 { PixelFormat::Gray } else { PixelFormat::Rgb },
            depth: Depth::Eight,
            levels: self.data.iter().map(|&level| level.into()).collect(),
        };
        png::encode(&raster, out)
    }

    /// Saves the picture as a PNG file.
    ///
    /// # Errors
    /// Those of [`write::write`].
    pub fn save(&self, path: &Path, existing: Existing) -> Result<(), WriteError> {
        write::write(path, existing, |out| self.encode(out))
    }
}

/// The first frame of a tile beside its XT slice, as RGB.
///
/// The slice is the row y = 0 of every frame: x across, time down from frame 0. Only the first
/// sample of a pixel is shown; its dimensions 0, 1 and 2 are red, green and blue, a single
/// dimension is gray. Pixels are magnified by the smallest whole factor that makes the picture at
/// least 256 pixels high, as long as it stays at most 4,096 wide; what nothing covers is white.
pub fn preview(tile: &Tile) -> Image {
    let mut preview = Preview::new(tile.shape());
    preview.take(tile.samples());
    preview.image()
}

/// What a tile's [`preview()`] shows, gathered from coordinates that come in pieces.
#[derive(Debug, Clone)]
pub struct Preview {
    shape: TileShape,
    /// Coordinates that have come.
    taken: usize,
    /// The pixels of frame 0, and of the row y = 0 of every frame behind it.
    colors: Vec<[u8; 3]>,
}

impl Preview {
    /// The preview of a tile of this shape, black before there are coordinates.
    pub fn new(shape: TileShape) -> Self {
        let pixels = shape.width() * (shape.height() + shape.frames() - 1);
        Self { shape, taken: 0, colors: vec![[0; 3]; pixels] }
    }

    /// Takes the next coordinates in C order; those behind the last are left out.
    pub fn take(&mut self, mut piece: &[f32]) {
        let Self { shape, taken, colors } = self;
        let (width, height, dims) = (shape.width(), shape.height(), shape.dims());
        let pixel = shape.spp() * dims;
        let frame = width * height * pixel;
        while !piece.is_empty() && *taken < shape.coordinates() {
            let (t, start) = (*taken / frame, *taken % frame);
            let (words, rest) = piece.split_at(piece.len().min(frame - start));
            // Where the first of the frame's pixels that are shown is, and behind the last word.
            let (first, end) = match t {
                0 => (0, frame),
                _ => ((height + t - 1) * width, width * pixel),
            };
            for (word, &x) in (start..end).zip(words) {
                let color = &mut colors[first + word / pixel];
                let level = Depth::Eight.quantize(x) as u8;
                match word % pixel {
                    0 if dims == 1 => *color = [level; 3],
                    dim if dim < dims.min(3) => color[dim] = level,
                    _ => (),
                }
            }
            *taken += words.len();
            piece = rest;
        }
    }

    /// Draws the picture.
    pub fn image(&self) -> Image {
        let Self { shape, colors, .. } = self;
        let (width, height) = (shape.width(), shape.height());
        let rows = height.max(shape.frames());
        let fitting = PREVIEW_WIDTH.saturating_sub(GAP) / (2 * width);
        let zoom = PREVIEW_HEIGHT.div_ceil(rows).min(fitting).max(1);
        let half = zoom * width;
        let picture = Image::rgb(2 * half + GAP, zoom * rows, |x, y| {
            let y = y / zoom;
            if x < half && y < height {
                colors[y * width + x / zoom]
            } else if x >= half + GAP && y < shape.frames() {
                let row = if y == 0 { 0 } else { height + y - 1 };
                colors[row * width + (x - half - GAP) / zoom]
            } else {
                [255; 3]
            }
        });
        picture.expect("every tile has a pixel")
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn ramp(shape: TileShape) -> Tile {
        let count = shape.coordinates();
        Tile::new(shape, (0..count).map(|i| i as f32 / count as f32).collect()).unwrap()
    }

    #[test]
    fn a_picture_has_the_bytes_of_its_size() {
        assert!(Image::new(2, 1, 3, vec![0; 6]).is_ok());
        assert!(matches!(Image::new(0, 1, 1, vec![]), Err(ImageError::Empty { .. })));
        assert!(matches!(Image::new(1, 1, 2, vec![0; 2]), Err(ImageError::Channels { .. })));
        assert!(matches!(Image::new(2, 2, 1, vec![0; 3]), Err(ImageError::Length { .. })));
        assert!(matches!(Image::new(usize::MAX, 2, 3, vec![]), Err(ImageError::Length { .. })));
        let gray = Image::gray(3, 2, |x, y| (10 * y + x) as u8).unwrap();
        assert_eq!(gray.data(), [0, 1, 2, 10, 11, 12]);
        assert_eq!(gray.pixel(2, 1), [12]);
    }

    #[test]
    fn the_preview_shows_the_frame_and_the_slice() {
        let tile = ramp(TileShape::new(5, 4, 3, 2, 2).unwrap());
        let picture = preview(&tile);
        let zoom = 64;
        assert_eq!((picture.width(), picture.height()), (2 * 5 * zoom + GAP, 4 * zoom));
        let level = |x: f32| (x * 256.0).floor() as u8;
        for (x, y, t) in [(0, 0, 0), (4, 3, 0), (2, 1, 0), (3, 0, 2), (4, 0, 1)] {
            let point = tile.point(x, y, t, 0);
            let expected = [level(point[0]), level(point[1]), 0];
            if t == 0 {
                assert_eq!(picture.pixel(x * zoom, y * zoom), expected);
                assert_eq!(picture.pixel(x * zoom + zoom - 1, y * zoom + zoom - 1), expected);
            }
            if y == 0 {
                let left = 5 * zoom + GAP + x * zoom;
                assert_eq!(picture.pixel(left, t * zoom), expected);
                assert_eq!(picture.pixel(left + zoom - 1, t * zoom + zoom - 1), expected);
            }
        }
        assert_eq!(picture.pixel(5 * zoom, 0), [255; 3]);
        assert_eq!(picture.pixel(5 * zoom + GAP, 3 * zoom), [255; 3]);
    }

    #[test]
    fn one_dimension_is_gray_and_three_are_rgb() {
        let gray = preview(&ramp(TileShape::new(4, 4, 1, 1, 1).unwrap()));
        assert_eq!(gray.pixel(64, 64), [5 * 16; 3]);
        let rgb = preview(&ramp(TileShape::new(4, 4, 1, 1, 4).unwrap()));
        assert_eq!(rgb.pixel(64, 64), [20 * 4, 21 * 4, 22 * 4]);
    }

    proptest! {
        #[test]
        fn pieces_of_any_size_make_the_same_preview(
            (width, height, frames) in (1_usize..6, 1_usize..6, 1_usize..6),
            (spp, dims) in (1_usize..4, 1_usize..5),
            sizes in prop::collection::vec(1_usize..40, 1..6),
        ) {
            let tile = ramp(TileShape::new(width, height, frames, spp, dims).unwrap());
            let mut pieces = Preview::new(tile.shape());
            let mut rest = tile.samples();
            for &size in sizes.iter().cycle() {
                let (piece, others) = rest.split_at(size.min(rest.len()));
                pieces.take(piece);
                rest = others;
                if rest.is_empty() {
                    break;
                }
            }
            // More than there are do no harm.
            pieces.take(&[0.999; 50]);
            let picture = pieces.image();
            prop_assert_eq!(&picture, &preview(&tile));
            let zoom = picture.height() / height.max(frames);
            let color = |x: usize, y: usize, t: usize| -> Vec<u8> {
                let point = tile.point(x, y, t, 0);
                let of = |k: usize| if dims == 1 { 0 } else { k };
                (0..3).map(|k| point.get(of(k)).map_or(0, |x| (x * 256.0) as u8)).collect()
            };
            for x in 0..width {
                for y in 0..height {
                    prop_assert_eq!(picture.pixel(x * zoom, y * zoom), color(x, y, 0));
                }
                for t in 0..frames {
                    let left = (width + x) * zoom + GAP;
                    prop_assert_eq!(picture.pixel(left, t * zoom), color(x, 0, t));
                }
            }
        }
    }

    #[test]
    fn extreme_tiles_have_a_preview_of_sane_size() {
        let wide = preview(&ramp(TileShape::new(1 << 15, 1, 1, 1, 1).unwrap()));
        assert_eq!((wide.width(), wide.height()), ((1 << 16) + GAP, 1));
        let long = preview(&ramp(TileShape::new(1, 1, 1 << 12, 1, 1).unwrap()));
        assert_eq!((long.width(), long.height()), (2 + GAP, 1 << 12));
        assert_eq!(preview(&ramp(TileShape::new(1, 1, 1, 1, 1).unwrap())).height(), 256);
    }
}
