//! One PNG file: pixels of 8 or 16 bits, in and out.
//!
//! What the pixels mean is decided by [`source`](super::source) and [`slices`](super::slices).
//! A PNG of a few bytes can claim any size, so the claim is held against fixed limits and against
//! the best compression that the format can reach before memory is taken.

use std::fmt;
use std::io::{BufRead, Seek, Write};
use std::str::FromStr;

use ::png as codec;
use codec::{BitDepth, ColorType};
use thiserror::Error;

/// The first bytes of every PNG file.
pub const SIGNATURE: &[u8; 8] = b"\x89PNG\r\n\x1a\n";
/// Most pixels that a PNG is read with: a strip of 4,096 slices of 128×128.
pub const MAX_PIXELS: u64 = 1 << 26;
/// Pixels take at most 8 bytes (four channels of 16 bits).
const MAX_BYTES: usize = 8 * MAX_PIXELS as usize;
/// Most memory for what a PNG says before its pixels.
const MAX_HEADERS: usize = 1 << 20;
/// The format's keyword for the software that made a picture.
const SOFTWARE: &str = "Software";
/// No deflate stream is smaller than its content divided by this (1,032, and some for headers).
const BEST_COMPRESSION: u64 = 1100;

/// Why a PNG cannot be read or written.
#[derive(Debug, Error)]
pub enum PngError {
    /// The file breaks the format, or reading it failed.
    #[error("not a readable PNG: {0}")]
    Decoding(codec::DecodingError),
    /// The picture is larger than any that is read.
    #[error("the PNG has {width}x{height} pixels, but at most {MAX_PIXELS} are read")]
    Pixels {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
    },
    /// The picture cannot be in a file so small.
    #[error("the PNG claims {width}x{height} pixels, which its {bytes} bytes cannot hold")]
    Claim {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Size of the file in bytes.
        bytes: u64,
    },
    /// The machine refuses the memory for the pixels.
    #[error("{bytes} bytes of pixels do not fit in memory")]
    Memory {
        /// Bytes needed.
        bytes: usize,
    },
    /// A moving picture.
    #[error("the PNG is animated, but a slice is a single picture")]
    Animated,
}

/// Bits of one channel of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Depth {
    /// 256 levels.
    Eight,
    /// 65,536 levels.
    Sixteen,
}

impl Depth {
    /// Number of levels.
    pub fn levels(self) -> u32 {
        match self {
            Self::Eight => 1 << 8,
            Self::Sixteen => 1 << 16,
        }
    }

    /// The level whose bin holds the coordinate `x` of `[0, 1)`: ⌊levels · x⌋.
    pub fn quantize(self, x: f32) -> u16 {
        // Exact, as the number of levels is a power of two; `as` saturates what is no coordinate.
        (x * self.levels() as f32) as u16
    }

    /// The middle of a level's bin, (level + 1/2) / levels; exact.
    pub fn coordinate(self, level: u16) -> f32 {
        (f32::from(level) + 0.5) / self.levels() as f32
    }

    /// Bytes of one channel of a pixel.
    pub fn bytes(self) -> usize {
        match self {
            Self::Eight => 1,
            Self::Sixteen => 2,
        }
    }
}

/// The channels that pixels have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One.
    Gray,
    /// Gray and alpha.
    GrayAlpha,
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue, alpha.
    Rgba,
}

impl PixelFormat {
    /// Number of all channels.
    pub fn channels(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::GrayAlpha => 2,
            Self::Rgb => 3,
            Self::Rgba => 4,
        }
    }

    /// Number of channels without alpha.
    pub fn colors(self) -> usize {
        match self {
            Self::Gray | Self::GrayAlpha => 1,
            Self::Rgb | Self::Rgba => 3,
        }
    }

    /// Where in a pixel a channel stands; gray answers to red.
    pub fn position(self, channel: Channel) -> Option<usize> {
        let position = match channel {
            Channel::Red => 0,
            Channel::Green => 1,
            Channel::Blue => 2,
            Channel::Alpha => return (self.channels() > self.colors()).then(|| self.colors()),
        };
        (position < self.colors()).then_some(position)
    }
}

/// One channel by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Red, or gray.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Opacity.
    Alpha,
}

/// A choice of channels in order, written like `rg` or `rgba`.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Channels(Vec<Channel>);

/// Why a text names no channels.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ChannelsError {
    /// The text is empty.
    #[error("no channel is named, but at least one of r, g, b, a is needed")]
    None,
    /// A letter that is no channel.
    #[error("channel {0:?} in {1:?}, but channels are r, g, b and a")]
    Unknown(char, String),
    /// A channel occurs twice.
    #[error("channel {0:?} occurs twice in {1:?}")]
    Twice(char, String),
}

impl Channel {
    const ALL: [Self; 4] = [Self::Red, Self::Green, Self::Blue, Self::Alpha];

    /// The first `count` channels, at most four, from red to alpha.
    pub fn first(count: usize) -> &'static [Self] {
        &Self::ALL[..count.min(Self::ALL.len())]
    }

    /// The letter that names the channel.
    pub fn letter(self) -> char {
        match self {
            Self::Red => 'r',
            Self::Green => 'g',
            Self::Blue => 'b',
            Self::Alpha => 'a',
        }
    }
}

/// `r`, `g`, `b` or `a`.
impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.letter())
    }
}

impl Channels {
    /// The channels in the order in which they were named; at least one, none twice.
    pub fn as_slice(&self) -> &[Channel] {
        &self.0
    }
}

/// The letters, as they are parsed.
impl fmt::Display for Channels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|channel| channel.fmt(f))
    }
}

impl FromStr for Channels {
    type Err = ChannelsError;

    fn from_str(text: &str) -> Result<Self, ChannelsError> {
        let mut channels = Vec::new();
        for letter in text.chars() {
            let known = Channel::ALL.into_iter().find(|channel| channel.letter() == letter);
            let Some(channel) = known else {
                return Err(ChannelsError::Unknown(letter, text.to_owned()));
            };
            if channels.contains(&channel) {
                return Err(ChannelsError::Twice(letter, text.to_owned()));
            }
            channels.push(channel);
        }
        if channels.is_empty() { Err(ChannelsError::None) } else { Ok(Self(channels)) }
    }
}

/// The pixels of a picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster {
    /// Pixels across, at least 1.
    pub width: usize,
    /// Pixels down, at least 1.
    pub height: usize,
    /// Channels of a pixel.
    pub layout: PixelFormat,
    /// Bits of a channel.
    pub depth: Depth,
    /// Levels row by row from the top, pixel by pixel, channel by channel:
    /// `height · width · channels`, each below `depth.levels()`.
    pub levels: Vec<u16>,
}

/// Reads a PNG file of `bytes` bytes.
///
/// Palettes and levels of 1, 2 and 4 bits become 8 bits as the format defines, which undoes what
/// lossless optimizers do to gray pictures. Checksums are verified.
///
/// # Errors
/// Any [`PngError`]: damage, more than [`MAX_PIXELS`] pixels or more than the file can hold, or
/// an animation.
pub fn decode(input: impl BufRead + Seek, bytes: u64) -> Result<Raster, PngError> {
    let mut decoder = codec::Decoder::new_with_limits(input, codec::Limits { bytes: MAX_BYTES });
    decoder.set_transformations(codec::Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder.ignore_checksums(false);
    let header = decoder.read_header_info().map_err(PngError::Decoding)?;
    let (width, height) = header.size();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(PngError::Pixels { width, height });
    }
    let stored = header.raw_bytes() as u64;
    if stored / BEST_COMPRESSION > bytes {
        return Err(PngError::Claim { width, height, bytes });
    }

    let mut reader = decoder.read_info().map_err(PngError::Decoding)?;
    if reader.info().animation_control.is_some() {
        return Err(PngError::Animated);
    }
    let (color, depth) = reader.output_color_type();
    let layout = match color {
        ColorType::Grayscale => PixelFormat::Gray,
        ColorType::GrayscaleAlpha => PixelFormat::GrayAlpha,
        // Palettes have been expanded.
        ColorType::Rgb | ColorType::Indexed => PixelFormat::Rgb,
        ColorType::Rgba => PixelFormat::Rgba,
    };
    let depth = if depth == BitDepth::Sixteen { Depth::Sixteen } else { Depth::Eight };
    let (width, height) = (width as usize, height as usize);
    let values = width * height * layout.channels();
    let mut data = Vec::new();
    let mut levels = Vec::new();
    let size = values * depth.bytes();
    data.try_reserve_exact(size).map_err(|_| PngError::Memory { bytes: size })?;
    levels.try_reserve_exact(values).map_err(|_| PngError::Memory { bytes: size })?;
    data.resize(size, 0);
    reader.next_frame(&mut data).map_err(PngError::Decoding)?;
    reader.finish().map_err(PngError::Decoding)?;
    match depth {
        Depth::Eight => levels.extend(data.iter().map(|&level| u16::from(level))),
        Depth::Sixteen => {
            levels.extend(data.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])));
        }
    }
    Ok(Raster { width, height, layout, depth, levels })
}

/// Writes a PNG file.
///
/// # Errors
/// What `out` reports; sizes that are 0, above 2³¹ − 1, or contradict the number of levels.
pub fn encode(raster: &Raster, out: &mut (impl Write + ?Sized)) -> std::io::Result<()> {
    encode_with(raster, None, out)
}

/// Writes a PNG file that names the software that made it, in Latin-1; see [`software`].
///
/// # Errors
/// Those of [`encode`].
pub fn encode_as(
    raster: &Raster,
    software: &str,
    out: &mut (impl Write + ?Sized),
) -> std::io::Result<()> {
    encode_with(raster, Some(software), out)
}

/// The software that a PNG file says it was made by, before its pixels; `None` if it says none or
/// cannot be read.
pub fn software(input: impl BufRead + Seek) -> Option<String> {
    let limits = codec::Limits { bytes: MAX_HEADERS };
    let reader = codec::Decoder::new_with_limits(input, limits).read_info().ok()?;
    let mut texts = reader.info().uncompressed_latin1_text.iter();
    texts.find(|text| text.keyword == SOFTWARE).map(|text| text.text.clone())
}

fn encode_with(
    raster: &Raster,
    software: Option<&str>,
    out: &mut (impl Write + ?Sized),
) -> std::io::Result<()> {
    let size = |size: usize| u32::try_from(size).map_err(std::io::Error::other);
    let mut encoder = codec::Encoder::new(out, size(raster.width)?, size(raster.height)?);
    if let Some(software) = software {
        encoder.add_text_chunk(SOFTWARE.into(), software.into())?;
    }
    encoder.set_color(match raster.layout {
        PixelFormat::Gray => ColorType::Grayscale,
        PixelFormat::GrayAlpha => ColorType::GrayscaleAlpha,
        PixelFormat::Rgb => ColorType::Rgb,
        PixelFormat::Rgba => ColorType::Rgba,
    });
    let data: Vec<u8> = match raster.depth {
        Depth::Eight => raster.levels.iter().map(|&level| level as u8).collect(),
        Depth::Sixteen => raster.levels.iter().flat_map(|level| level.to_be_bytes()).collect(),
    };
    encoder.set_depth(match raster.depth {
        Depth::Eight => BitDepth::Eight,
        Depth::Sixteen => BitDepth::Sixteen,
    });
    encoder
        .write_header()
        .and_then(|mut writer| {
            writer.write_image_data(&data)?;
            writer.finish()
        })
        .map_err(|error| match error {
            // As it is: the codec's own way makes another kind of it.
            codec::EncodingError::IoError(error) => error,
            error => std::io::Error::other(error),
        })
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;
    use crate::tile::BELOW_ONE;

    fn read(bytes: &[u8]) -> Result<Raster, PngError> {
        decode(Cursor::new(bytes), bytes.len() as u64)
    }

    /// Takes so many bytes.
    struct Full(usize);

    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_is_reported_as_such() {
        let raster = Raster {
            width: 2,
            height: 1,
            layout: PixelFormat::Gray,
            depth: Depth::Eight,
            levels: vec![1, 2],
        };
        let mut bytes = Vec::new();
        encode(&raster, &mut bytes).unwrap();
        for size in 0..bytes.len() {
            let error = encode(&raster, &mut Full(size)).unwrap_err();
            assert_eq!(error.kind(), std::io::ErrorKind::StorageFull, "{size}: {error}");
        }
        encode(&raster, &mut Full(bytes.len())).unwrap();
    }

    #[test]
    fn levels_are_bins_of_the_unit_interval() {
        for depth in [Depth::Eight, Depth::Sixteen] {
            let last = (depth.levels() - 1) as u16;
            assert_eq!(depth.quantize(0.0), 0);
            assert_eq!(depth.quantize(BELOW_ONE), last);
            for level in 0..=last {
                assert_eq!(depth.quantize(depth.coordinate(level)), level);
                let low = f64::from(level) / f64::from(depth.levels());
                assert_eq!(depth.quantize(low as f32), level);
                let high = f64::from(level) + 1.0;
                let below = ((high / f64::from(depth.levels())) as f32).next_down();
                assert_eq!(depth.quantize(below), level);
                let middle = (f64::from(level) + 0.5) / f64::from(depth.levels());
                assert_eq!(f64::from(depth.coordinate(level)), middle);
            }
        }
    }

    #[test]
    fn channels_are_letters() {
        let channels: Channels = "bra".parse().unwrap();
        assert_eq!(channels.as_slice(), [Channel::Blue, Channel::Red, Channel::Alpha]);
        assert_eq!(channels.to_string(), "bra");
        assert_eq!("".parse::<Channels>(), Err(ChannelsError::None));
        assert_eq!("rx".parse::<Channels>(), Err(ChannelsError::Unknown('x', "rx".into())));
        assert_eq!("rgr".parse::<Channels>(), Err(ChannelsError::Twice('r', "rgr".into())));
    }

    /// Pixels of one picture as the library's own encoder writes them, with other settings.
    fn foreign(color: ColorType, depth: BitDepth, data: &[u8], width: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = codec::Encoder::new(&mut bytes, width, 1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(vec![1, 2, 3, 40, 50, 60]);
        }
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    #[test]
    fn palettes_and_few_bits_are_expanded() {
        let palette = read(&foreign(ColorType::Indexed, BitDepth::One, &[0b0100_0000], 2)).unwrap();
        assert_eq!((palette.layout, palette.depth), (PixelFormat::Rgb, Depth::Eight));
        assert_eq!(palette.levels, [1, 2, 3, 40, 50, 60]);
        let gray = read(&foreign(ColorType::Grayscale, BitDepth::Four, &[0x3f], 2)).unwrap();
        assert_eq!(gray.levels, [0x33, 0xff]);
    }

    #[test]
    fn a_claim_beyond_the_file_is_refused_before_memory_is_taken() {
        let mut bytes = foreign(ColorType::Rgba, BitDepth::Sixteen, &[0; 8], 1);
        let mut claim = |width: u32, height: u32| {
            bytes[16..20].copy_from_slice(&width.to_be_bytes());
            bytes[20..24].copy_from_slice(&height.to_be_bytes());
            let crc = crc(&bytes[12..29]);
            bytes[29..33].copy_from_slice(&crc.to_be_bytes());
            read(&bytes)
        };
        assert!(claim(1, 1).is_ok());
        assert!(matches!(claim(1 << 14, 1 << 12), Err(PngError::Claim { .. })));
        assert!(matches!(claim(1 << 14, (1 << 12) + 1), Err(PngError::Pixels { .. })));
        assert!(matches!(claim(i32::MAX as u32, i32::MAX as u32), Err(PngError::Pixels { .. })));
        assert!(claim(0, 1).is_err() && claim(1, 0).is_err() && claim(u32::MAX, 1).is_err());
        assert!(claim(2, 1).is_err());
    }

    /// CRC-32 of a chunk, bit by bit.
    fn crc(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(u32::MAX, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
            })
        })
    }

    fn rasters() -> impl Strategy<Value = Raster> {
        let layouts = prop_oneof![
            Just(PixelFormat::Gray),
            Just(PixelFormat::GrayAlpha),
            Just(PixelFormat::Rgb),
            Just(PixelFormat::Rgba)
        ];
        let depths = prop_oneof![Just(Depth::Eight), Just(Depth::Sixteen)];
        (1_usize..9, 1_usize..9, layouts, depths).prop_flat_map(|(width, height, layout, depth)| {
            let level = 0..=(depth.levels() - 1) as u16;
            proptest::collection::vec(level, width * height * layout.channels())
                .prop_map(move |levels| Raster { width, height, layout, depth, levels })
        })
    }

    proptest! {
        #[test]
        fn pixels_come_back_as_they_were_written(raster in rasters()) {
            let mut bytes = Vec::new();
            encode(&raster, &mut bytes).unwrap();
            prop_assert_eq!(&read(&bytes).unwrap(), &raster);
            for length in 0..bytes.len() {
                prop_assert!(read(&bytes[..length]).is_err(), "{} bytes", length);
            }
        }
    }
}
