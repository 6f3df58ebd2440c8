//! Pictures for people: 8-bit images, gray or RGB.
//!
//! They are PNG files, as slices of tiles are. The picture that lies beside a tile under its name
//! says that it is one, so that it is not taken for slices.

use std::io::{self, Write};
use std::path::Path;

use thiserror::Error;

use super::png::{self, Depth, PixelFormat, Raster};
use super::write::{self, Existing, WriteError};

/// What the picture beside a tile says that it was made by.
pub const PREVIEW: &str = "Perceptile preview";

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
    software: Option<&'static str>,
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
        Ok(Self { width, height, channels, data, software: None })
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

    /// The picture that says in its file what software made it.
    pub fn made_by(self, software: &'static str) -> Self {
        Self { software: Some(software), ..self }
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
        match self.software {
            Some(software) => png::encode_as(&raster, software, out),
            None => png::encode(&raster, out),
        }
    }

    /// Saves the picture as a PNG file.
    ///
    /// # Errors
    /// Those of [`write::write`].
    pub fn save(&self, path: &Path, existing: Existing) -> Result<(), WriteError> {
        write::write(path, existing, |out| self.encode(out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_picture_may_say_what_made_it() {
        let plain = Image::gray(2, 1, |x, _| x as u8).unwrap();
        let software = |image: &Image| {
            let mut bytes = Vec::new();
            image.encode(&mut bytes).unwrap();
            png::software(std::io::Cursor::new(bytes))
        };
        assert_eq!(software(&plain), None);
        assert_eq!(software(&plain.made_by(PREVIEW)).as_deref(), Some(PREVIEW));
    }
}
