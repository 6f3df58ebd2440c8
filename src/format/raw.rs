//! Texels and nothing else: a volume of integers that `fread` loads, and a description beside it.
//!
//! The file has no header, so that a program reads it into a buffer and is done. What it would say is
//! in `NAME.raw.json`: sizes, channels, bits, order, and the digest by which the two belong together.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::hashed::Hashed;
use super::png::Depth;
use super::texture::{self, Texels, Texture};
use crate::tile::Tile;

/// What descriptions say that they are.
const FORMAT: &str = "perceptile raw 1";
/// The order of texels, from what changes fastest.
const ORDER: &str = "channel, x, y, sample, frame";
/// Longest description that is read, in bytes.
const MAX_DESCRIPTION: u64 = 1 << 16;

/// What is said about a raw file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// What this is: `perceptile raw 1`.
    pub format: String,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Frames.
    pub frames: u32,
    /// Samples of a pixel, a layer each.
    pub spp: u32,
    /// Dimensions of a sample, the first channels of a texel.
    pub dims: u32,
    /// Channels of a texel.
    pub channels: u32,
    /// Bits of a channel: 8 or 16, little-endian.
    pub bits: u32,
    /// What changes fastest, first.
    pub order: String,
    /// The coordinate that a level stands for.
    pub value: String,
    /// SHA-256 of the raw file.
    pub sha256: String,
}

/// Why a raw file cannot be read.
#[derive(Debug, Error)]
pub enum RawError {
    /// Reading failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The description is none.
    #[error("{} does not describe a raw file: {error}", path.display())]
    Json {
        /// The description.
        path: PathBuf,
        /// What is wrong.
        error: serde_json::Error,
    },
    /// The description is too long to be one.
    #[error("{} does not describe a raw file: it has more than {MAX_DESCRIPTION} bytes", path.display())]
    Long {
        /// The description.
        path: PathBuf,
    },
    /// A field that is none of a raw file.
    #[error("{} does not describe a raw file: {field} is {found}, but it must be {rule}", path.display())]
    Field {
        /// The description.
        path: PathBuf,
        /// Its field.
        field: &'static str,
        /// What stands there.
        found: String,
        /// What it must be.
        rule: &'static str,
    },
    /// The file is not as long as its description says.
    #[error("{} has {found} bytes, but its description says {expected}", path.display())]
    Length {
        /// The raw file.
        path: PathBuf,
        /// Its bytes.
        found: u64,
        /// Bytes of the sizes.
        expected: u64,
    },
    /// The description is that of another file.
    #[error("{} is not the file that {} describes: its digest is another one", path.display(), description.display())]
    Digest {
        /// The raw file.
        path: PathBuf,
        /// The description beside it.
        description: PathBuf,
    },
}

/// Where the description of a raw file is: `tile.raw` → `tile.raw.json`.
pub fn description_of(raw: &Path) -> PathBuf {
    let mut path = raw.as_os_str().to_owned();
    path.push(".json");
    path.into()
}

/// Writes the texels of a tile to `out`, and says what they are.
///
/// # Errors
/// What `out` reports.
///
/// # Panics
/// If the texels have fewer channels than the tile has dimensions.
pub fn write(
    tile: &Tile,
    (texels, depth): (Texels, Depth),
    out: &mut (impl Write + ?Sized),
) -> io::Result<Description> {
    let mut hashed = Hashed::new(out);
    texture::write_levels(tile, (texels, depth), &mut hashed)?;
    let shape = tile.shape();
    let number = |size: usize| u32::try_from(size).map_err(io::Error::other);
    Ok(Description {
        format: FORMAT.to_owned(),
        width: number(shape.width())?,
        height: number(shape.height())?,
        frames: number(shape.frames())?,
        spp: number(shape.spp())?,
        dims: number(shape.dims())?,
        channels: number(texels.channels())?,
        bits: 8 * number(depth.bytes())?,
        order: ORDER.to_owned(),
        value: format!("(level + 0.5) / {}", depth.levels()),
        sha256: hashed.hexadecimal(),
    })
}

/// Reads a raw file by the description beside it.
///
/// # Errors
/// Any [`RawError`]. No more memory is taken than the size of the file justifies.
pub fn read(path: &Path) -> Result<Texture, RawError> {
    let description = description_of(path);
    let it = read_description(&description)?;
    let field = |field, found: String, rule| RawError::Field {
        path: description.clone(),
        field,
        found,
        rule,
    };
    let texels = Texels::of(it.channels as usize)
        .ok_or_else(|| field("channels", it.channels.to_string(), "1 to 4"))?;
    let depth = match it.bits {
        8 => Depth::Eight,
        16 => Depth::Sixteen,
        bits => return Err(field("bits", bits.to_string(), "8 or 16")),
    };
    for (name, found, most) in [
        ("width", it.width, u32::MAX),
        ("height", it.height, u32::MAX),
        ("frames", it.frames, u32::MAX),
        ("spp", it.spp, u32::MAX),
        ("dims", it.dims, it.channels),
    ] {
        if found == 0 || found > most {
            return Err(field(name, found.to_string(), "at least 1, and dims at most channels"));
        }
    }
    if it.format != FORMAT {
        return Err(field("format", format!("{:?}", it.format), "`perceptile raw 1`"));
    }
    if it.order != ORDER {
        return Err(field("order", format!("{:?}", it.order), "`channel, x, y, sample, frame`"));
    }
    let io = |error| RawError::Io { path: path.to_owned(), error };
    let file = File::open(path).map_err(io)?;
    let found = file.metadata().map_err(io)?.len();
    let sizes = [it.width, it.height, it.frames, it.spp, it.channels, it.bits / 8];
    let product = |all: u64, size: u32| all.checked_mul(size.into());
    let expected = sizes.into_iter().try_fold(1, product).unwrap_or(u64::MAX);
    if expected != found {
        return Err(RawError::Length { path: path.to_owned(), found, expected });
    }
    let layers = it.frames as usize * it.spp as usize;
    let size = [it.width as usize, it.height as usize, layers];
    let mut input = Digesting { input: BufReader::new(file), hashed: Hashed::new(io::sink()) };
    let levels = texture::read_levels(&mut input, size, (texels, depth)).map_err(io)?;
    if input.hashed.hexadecimal() != it.sha256 {
        return Err(RawError::Digest { path: path.to_owned(), description });
    }
    let [width, height, layers] = size;
    let sample = Some((it.spp as usize, it.dims as usize));
    Ok(Texture { width, height, layers, texels, depth, sample, levels })
}

fn read_description(path: &Path) -> Result<Description, RawError> {
    let io = |error| RawError::Io { path: path.to_owned(), error };
    let mut text = Vec::new();
    let file = File::open(path).map_err(io)?;
    file.take(MAX_DESCRIPTION + 1).read_to_end(&mut text).map_err(io)?;
    if text.len() as u64 > MAX_DESCRIPTION {
        return Err(RawError::Long { path: path.to_owned() });
    }
    serde_json::from_slice(&text).map_err(|error| RawError::Json { path: path.to_owned(), error })
}

/// Bytes that are hashed on their way in.
struct Digesting<R> {
    input: R,
    hashed: Hashed<io::Sink>,
}

impl<R: Read> Read for Digesting<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(buffer)?;
        self.hashed.write_all(&buffer[..read])?;
        Ok(read)
    }
}
