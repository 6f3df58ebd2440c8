//! KTX2 textures (Khronos, version 2.0): a tile as a two-dimensional array or as a volume, as engines
//! load them, and textures of that kind back.
//!
//! Written are formats without compression and without mipmaps, which is all that sample tiles
//! allow: any other texel would be another sample. Layers follow each other as `texture` has them.
//! The file says in its metadata how many samples and dimensions they hold, which the format itself
//! has no place for.

use std::io::{self, Read, Write};

use thiserror::Error;

use super::png::Depth;
use super::texture::{self, Texels, Texture};
use crate::tile::Tile;

/// The first bytes of every KTX2 file.
pub const SIGNATURE: &[u8; 12] = b"\xabKTX 20\xbb\r\n\x1a\n";
/// Bytes of the header with its index of parts.
const HEADER: u64 = 80;
/// Bytes of an entry of the index of levels.
const LEVEL: u64 = 24;
/// Longest metadata that is read, in bytes.
const MAX_METADATA: u32 = 1 << 16;
/// The key of what only we say: samples of a pixel and dimensions of a sample.
const SAMPLE: &str = "PerceptileSample";

/// Why a file is no KTX2 texture that can be read.
#[derive(Debug, Error)]
pub enum Ktx2Error {
    /// Reading failed.
    #[error("cannot read: {0}")]
    Io(#[from] io::Error),
    /// The file ends early, or parts lie beyond its end.
    #[error("the file has {bytes} bytes, but its {part} lies outside of them")]
    Outside {
        /// Which part.
        part: &'static str,
        /// Bytes of the file.
        bytes: u64,
    },
    /// A format of texels that is not read.
    #[error("texels are of the Vulkan format {format}, but only {} are read", known())]
    Format {
        /// Its number.
        format: u32,
    },
    /// Texels that are compressed.
    #[error(
        "the texels are compressed (scheme {scheme}): write the texture without supercompression"
    )]
    Compressed {
        /// The scheme's number.
        scheme: u32,
    },
    /// Sides that no stack of pictures has.
    #[error("{what} is {found}, but it must be {rule}")]
    Size {
        /// Which number.
        what: &'static str,
        /// Its value.
        found: u32,
        /// What it must be.
        rule: &'static str,
    },
    /// Texels that are not as many as the sizes say.
    #[error(
        "{width}x{height} texels in {layers} layers need {expected} bytes, but the file has {found} for them"
    )]
    Length {
        /// Texels across.
        width: u32,
        /// Texels down.
        height: u32,
        /// Layers.
        layers: u64,
        /// Bytes that they take.
        expected: u64,
        /// Bytes that the file says.
        found: u64,
    },
}

/// How layers are laid out for the GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// A two-dimensional array.
    Array,
    /// A volume, for those who load no arrays.
    Volume,
}

/// The number of Vulkan's format `VK_FORMAT_…_UNORM`.
fn vulkan(texels: Texels, depth: Depth) -> u32 {
    let [eight, sixteen] = match texels {
        Texels::R => [9, 70],
        Texels::Rg => [16, 77],
        Texels::Rgb => [23, 84],
        Texels::Rgba => [37, 91],
    };
    if depth == Depth::Eight { eight } else { sixteen }
}

/// All formats that are written and read.
fn formats() -> impl Iterator<Item = (Texels, Depth)> {
    let depths = [Depth::Eight, Depth::Sixteen];
    depths.into_iter().flat_map(|depth| Texels::ALL.map(|texels| (texels, depth)))
}

/// The names of all formats, for people.
fn known() -> String {
    let name = |(texels, depth): (Texels, Depth)| {
        let channels = texels.to_string().to_uppercase();
        format!("{channels}{} ({})", 8 * depth.bytes(), vulkan(texels, depth))
    };
    formats().map(name).collect::<Vec<_>>().join(", ")
}

/// Writes a tile, one layer for each frame and sample.
///
/// The bytes depend on the arguments and the version of this program alone.
///
/// # Errors
/// What `out` reports.
///
/// # Panics
/// If the texels have fewer channels than the tile has dimensions.
pub fn write(
    tile: &Tile,
    (texels, depth): (Texels, Depth),
    layout: Layout,
    out: &mut (impl Write + ?Sized),
) -> io::Result<()> {
    let shape = tile.shape();
    let layers = shape.frames() * shape.spp();
    let number = |size: usize| u32::try_from(size).map_err(io::Error::other);
    let descriptor = descriptor(texels, depth);
    let orientation: &[u8] = if layout == Layout::Array { b"rd\0" } else { b"rdi\0" };
    let sample = format!("{} {}\0", shape.spp(), shape.dims());
    let writer = format!("Perceptile {}\0", env!("CARGO_PKG_VERSION"));
    // In the order of their bytes, as the format wants it.
    let mut metadata = Vec::new();
    for (key, value) in [
        ("KTXorientation", orientation),
        ("KTXwriter", writer.as_bytes()),
        (SAMPLE, sample.as_bytes()),
    ] {
        let length = key.len() + 1 + value.len();
        metadata.extend(number(length)?.to_le_bytes());
        metadata.extend([key.as_bytes(), b"\0", value].concat());
        metadata.resize(metadata.len().next_multiple_of(4), 0);
    }
    let texel = texels.channels() * depth.bytes();
    let bytes = (layers * shape.height() * shape.width() * texel) as u64;
    let descriptor_at = HEADER + LEVEL;
    let metadata_at = descriptor_at + descriptor.len() as u64;
    // Texels begin at a multiple of their size and of four.
    let alignment = if texel.is_multiple_of(4) { texel } else { 4 * texel };
    let end = metadata_at + metadata.len() as u64;
    let texels_at = end.next_multiple_of(alignment as u64);

    let (depth_size, layer_count) = match layout {
        Layout::Array => (0, number(layers)?),
        Layout::Volume => (number(layers)?, 0),
    };
    let mut head = SIGNATURE.to_vec();
    for word in [
        vulkan(texels, depth),
        number(depth.bytes())?,
        number(shape.width())?,
        number(shape.height())?,
        depth_size,
        layer_count,
        // One face, one level, no supercompression.
        1,
        1,
        0,
        descriptor_at as u32,
        number(descriptor.len())?,
        metadata_at as u32,
        number(metadata.len())?,
    ] {
        head.extend(word.to_le_bytes());
    }
    // Nothing that is shared by compressed levels; then the only level.
    for long in [0, 0, texels_at, bytes, bytes] {
        head.extend(long.to_le_bytes());
    }
    head.extend(descriptor);
    head.extend(metadata);
    head.resize(texels_at as usize, 0);
    out.write_all(&head)?;
    texture::write_levels(tile, (texels, depth), out)
}

/// What the texels are, in the words of the Khronos Data Format Specification 1.3: one basic block,
/// linear, every channel a normalized integer.
fn descriptor(texels: Texels, depth: Depth) -> Vec<u8> {
    let channels = texels.channels();
    let size = 24 + 16 * channels as u16;
    let mut bytes = Vec::new();
    bytes.extend((u32::from(size) + 4).to_le_bytes());
    // Vendor Khronos, a basic block, of version 1.3.
    bytes.extend([0, 0, 0, 0, 2, 0]);
    bytes.extend(size.to_le_bytes());
    // Red, green, blue, alpha; primaries of BT.709, a linear transfer, no premultiplied alpha.
    bytes.extend([1, 1, 1, 0]);
    // Blocks of one texel, in one plane.
    bytes.extend([0; 4]);
    bytes.extend([(channels * depth.bytes()) as u8, 0, 0, 0, 0, 0, 0, 0]);
    for channel in 0..channels {
        let bits = 8 * depth.bytes();
        bytes.extend(((channel * bits) as u16).to_le_bytes());
        let alpha = 15;
        bytes.extend([bits as u8 - 1, if channel == 3 { alpha } else { channel as u8 }]);
        bytes.extend([0; 4]);
        bytes.extend(0_u32.to_le_bytes());
        bytes.extend((depth.levels() - 1).to_le_bytes());
    }
    bytes
}

/// Reads a texture: a single picture, an array or a volume, or an array of volumes, whose slices are
/// layers. Only its largest mipmap counts.
///
/// `input` is the whole file of `bytes` bytes.
///
/// # Errors
/// Any [`Ktx2Error`]. No more memory is taken than the size of the file justifies.
pub fn read(mut input: impl Read, bytes: u64) -> Result<Texture, Ktx2Error> {
    let outside = |part| Ktx2Error::Outside { part, bytes };
    let mut head = [0; (HEADER + LEVEL) as usize];
    if bytes < head.len() as u64 {
        return Err(outside("header"));
    }
    input.read_exact(&mut head)?;
    let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| head[at + i]));
    let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 4)) << 32;
    let format = word(12);
    let (texels, depth) = formats()
        .find(|&(texels, depth)| vulkan(texels, depth) == format)
        .ok_or(Ktx2Error::Format { format })?;
    let [width, height, slices, layers, faces] = [20, 24, 28, 32, 36].map(word);
    let scheme = word(44);
    if scheme != 0 {
        return Err(Ktx2Error::Compressed { scheme });
    }
    for (what, found, rule, holds) in [
        ("the width", width, "at least 1", width > 0),
        ("the height", height, "at least 1", height > 0),
        ("the number of faces", faces, "1", faces == 1),
    ] {
        if !holds {
            return Err(Ktx2Error::Size { what, found, rule });
        }
    }
    let (metadata_at, metadata_length) = (word(56), word(60));
    let (texels_at, length) = (long(80), long(88));
    let all_layers = u64::from(layers.max(1)) * u64::from(slices.max(1));
    let texel = (texels.channels() * depth.bytes()) as u64;
    let expected = [u64::from(width), u64::from(height), texel]
        .into_iter()
        .try_fold(all_layers, u64::checked_mul)
        .unwrap_or(u64::MAX);
    if expected != length {
        let layers = all_layers;
        return Err(Ktx2Error::Length { width, height, layers, expected, found: length });
    }
    let inside = |at: u64, length: u64| at.checked_add(length).is_some_and(|end| end <= bytes);
    if texels_at < HEADER + LEVEL || !inside(texels_at, length) {
        return Err(outside("level 0"));
    }
    // What stands between: with mipmaps, the smaller ones, which lie before the largest.
    let before = texels_at - head.len() as u64;
    let mut sample = None;
    let metadata_end = u64::from(metadata_at) + u64::from(metadata_length);
    let mut passed = head.len() as u64;
    if (passed..=texels_at).contains(&u64::from(metadata_at))
        && metadata_end <= texels_at
        && metadata_length <= MAX_METADATA
    {
        skip(&mut input, u64::from(metadata_at) - passed)?;
        let mut metadata = vec![0; metadata_length as usize];
        input.read_exact(&mut metadata)?;
        sample = sample_of(&metadata);
        passed = metadata_end;
    }
    skip(&mut input, before + head.len() as u64 - passed)?;
    let layers = all_layers as usize;
    let size = [width as usize, height as usize, layers];
    let levels = texture::read_levels(&mut input, size, (texels, depth))?;
    let [width, height, layers] = size;
    let sample = sample.filter(|&(spp, dims)| {
        spp > 0 && layers.is_multiple_of(spp) && (1..=texels.channels()).contains(&dims)
    });
    Ok(Texture { width, height, layers, texels, depth, sample, levels })
}

fn skip(input: &mut impl Read, bytes: u64) -> io::Result<()> {
    io::copy(&mut input.take(bytes), &mut io::sink()).map(drop)
}

/// Samples of a pixel and dimensions, if the metadata say them. What else it says, and how, does not
/// matter.
fn sample_of(mut metadata: &[u8]) -> Option<(usize, usize)> {
    while let Some((length, rest)) = metadata.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let entry = rest.get(..length)?;
        metadata = rest.get(length.next_multiple_of(4)..).unwrap_or(&[]);
        let value = entry.strip_prefix(SAMPLE.as_bytes()).and_then(|it| it.strip_prefix(b"\0"));
        if let Some(value) = value {
            let text = std::str::from_utf8(value.strip_suffix(b"\0")?).ok()?;
            let (spp, dims) = text.split_once(' ')?;
            return Some((spp.parse().ok()?, dims.parse().ok()?));
        }
    }
    None
}
