//! The `.npy` format: tiles out, our own and foreign tiles in.
//!
//! The layout (magic, version, header length, a Python dictionary literal padded to 64 bytes,
//! then the raw elements) is that of NumPy's NEP 1. The header is parsed here and not by a
//! library, because a general literal parser recurses as deep as the file says and trusts its
//! sizes; this one accepts exactly the three keys of the format and checks the shape against the
//! length of the file before anything is allocated.

use std::io::{self, Read, Write};

use thiserror::Error;

use super::numbers::{self, Put};
use crate::tile::{ShapeError, Tile, TileShape, clamp_coordinate};

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Longest header accepted, in bytes; that of a plain array has fewer than 200.
const MAX_HEADER: u32 = 1 << 16;
/// The header is padded so that the elements begin at a multiple of this many bytes.
const ALIGNMENT: usize = 64;
/// Elements that are decoded at a time.
const BLOCK: usize = 1 << 13;

/// Why bytes are not a `.npy` file that can be read.
#[derive(Debug, Error)]
pub enum NpyError {
    /// Reading from the disk failed.
    #[error("cannot read: {0}")]
    Io(io::Error),
    /// The first bytes are not the format's.
    #[error("not a .npy file: it does not begin with \\x93NUMPY")]
    Magic,
    /// A format version nobody has defined yet.
    #[error("format version {major}.{minor}, but only versions 1.0, 2.0 and 3.0 are known")]
    Version {
        /// First number of the version.
        major: u8,
        /// Second number of the version.
        minor: u8,
    },
    /// The file ends before its header does.
    #[error("the file ends inside its header")]
    Truncated,
    /// The header claims to be longer than any header of a plain array.
    #[error("the header is said to have {length} bytes, but at most {MAX_HEADER} are accepted")]
    HeaderLength {
        /// Length that the file claims.
        length: u32,
    },
    /// The header is not the dictionary that the format prescribes.
    #[error("byte {at} of the header is {found}, but {expected} must stand there")]
    Header {
        /// Position in the header, from 0.
        at: usize,
        /// What the format asks for.
        expected: &'static str,
        /// What stands there.
        found: String,
    },
    /// The header breaks a rule about its keys.
    #[error("the header {problem} key {key:?}")]
    Key {
        /// What is wrong with the key.
        problem: &'static str,
        /// The key.
        key: String,
    },
    /// Elements of a type that is no coordinate.
    #[error("elements of type {descr:?}, but only f2, f4, f8, u1 and u2 are read")]
    Element {
        /// Type as the header says it.
        descr: String,
    },
    /// The product of the sizes is not a number of bytes.
    #[error("shape {shape:?} has more bytes than memory can address")]
    Overflow {
        /// Sizes in the header.
        shape: Vec<usize>,
    },
    /// Shape and file size contradict each other.
    #[error("shape {shape:?} needs {expected} bytes of data, but the file has {found}")]
    Length {
        /// Sizes in the header.
        shape: Vec<usize>,
        /// Bytes that the shape needs.
        expected: u64,
        /// Bytes that follow the header.
        found: u64,
    },
    /// The machine refuses the memory for the values.
    #[error("{values} values do not fit in memory")]
    Memory {
        /// Numbers to be kept.
        values: usize,
    },
    /// A number of axes that says nothing about tiles.
    #[error(
        "shape {shape:?} has {} axes, but a tile has (frames, height, width), \
         (frames, height, width, dims) or (frames, height, width, spp, dims)",
        shape.len()
    )]
    Axes {
        /// Sizes in the header.
        shape: Vec<usize>,
    },
    /// The samples per pixel asked for contradict the shape.
    #[error("shape {shape:?} cannot hold {spp} samples per pixel")]
    Spp {
        /// Sizes in the header.
        shape: Vec<usize>,
        /// Samples per pixel asked for.
        spp: usize,
    },
    /// The sizes are not those of a tile.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A value that is no coordinate.
    #[error("the value at {index:?} is {value}, but every coordinate must be in [0, 1)")]
    Coordinate {
        /// Position along each axis of the file.
        index: Vec<usize>,
        /// The value there.
        value: f64,
    },
}

/// Writes a tile as little-endian `f32` of shape `(frames, height, width, spp, dims)`, C order.
///
/// The bytes depend on the tile alone.
///
/// # Errors
/// What `out` reports.
pub fn write_tile(tile: &Tile, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    write_rows(tile.shape(), out, &mut |put| put(tile.samples()))
}

/// Writes a tile, with the same bytes as [`write_tile`], whose coordinates come in pieces: `rows`
/// hands them over, in C order, to what it is called with.
///
/// # Errors
/// What `out` or `rows` reports, and [`io::ErrorKind::InvalidData`] if there are more coordinates
/// than the shape has, or fewer, or a number that is none.
pub fn write_rows(
    shape: TileShape,
    out: &mut (impl Write + ?Sized),
    rows: &mut dyn FnMut(&mut Put<'_>) -> io::Result<()>,
) -> io::Result<()> {
    let mut header = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}, {}, {}, {}), }}",
        shape.frames(),
        shape.height(),
        shape.width(),
        shape.spp(),
        shape.dims()
    );
    // Ten bytes precede the dictionary, one line feed ends it.
    let padding = (ALIGNMENT - (10 + header.len() + 1) % ALIGNMENT) % ALIGNMENT;
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(io::Error::other)?;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())?;
    let mut stray = None;
    numbers::write(out, shape.coordinates() as u64, &mut |put| {
        rows(&mut |piece| {
            stray = stray.or_else(|| piece.iter().copied().find(|x| !(0.0..1.0).contains(x)));
            put(piece)
        })
    })?;
    match stray {
        Some(x) => {
            let message = format!("a coordinate is {x}, but every one must be in [0, 1)");
            Err(io::Error::new(io::ErrorKind::InvalidData, message))
        }
        None => Ok(()),
    }
}

/// Reads a tile: one of ours exactly, or a foreign one.
///
/// `input` is the whole file of `bytes` bytes. Axes are `(frames, height, width)`,
/// `(frames, height, width, dims)` or `(frames, height, width, spp, dims)`, in C or Fortran
/// order; with four axes, `spp` splits the last one into samples of `size / spp` dimensions.
/// Elements of either byte order are floats of 16, 32 or 64 bits, which must be in `[0, 1]` (1
/// itself, and what rounds to it, becomes the largest `f32` below 1; −0 becomes 0), or unsigned
/// integers of 8 or 16 bits, where b stands for the middle of its bin, (b + 1/2)/256 or
/// (b + 1/2)/65536.
///
/// # Errors
/// Any [`NpyError`]: the file is damaged or contradicts itself, its shape is no tile's or
/// contradicts `spp`, or a value is no coordinate.
pub fn read_tile(mut input: impl Read, bytes: u64, spp: Option<usize>) -> Result<Tile, NpyError> {
    let header = Header::read(&mut input, bytes)?;
    let shape = header.tile_shape(spp)?;
    let mut samples = Vec::new();
    samples
        .try_reserve_exact(header.count)
        .map_err(|_| NpyError::Memory { values: header.count })?;
    samples.resize(header.count, 0.0_f32);
    header.read_values(input, |place, value| {
        samples[place] = header
            .element
            .coordinate(value)
            .ok_or_else(|| NpyError::Coordinate { index: header.index_of(place), value })?;
        Ok(())
    })?;
    Ok(Tile::new(shape, samples).expect("every coordinate was brought into [0, 1)"))
}

/// What an element is, without its byte order.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    F16,
    F32,
    F64,
    U8,
    U16,
}

/// How an element is stored.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Element {
    kind: Kind,
    big_endian: bool,
}

impl Element {
    /// From the header's text: byte order, kind, bytes.
    fn parse(descr: &str) -> Option<Self> {
        let (order, kind) = descr.split_at_checked(1)?;
        let kind = match kind {
            "f2" => Kind::F16,
            "f4" => Kind::F32,
            "f8" => Kind::F64,
            "u1" => Kind::U8,
            "u2" => Kind::U16,
            _ => return None,
        };
        match order {
            "<" => Some(Self { kind, big_endian: false }),
            ">" => Some(Self { kind, big_endian: true }),
            // "Not applicable", which only single bytes may say.
            "|" if kind == Kind::U8 => Some(Self { kind, big_endian: false }),
            _ => None,
        }
    }

    /// Bytes of an element.
    fn size(self) -> usize {
        match self.kind {
            Kind::U8 => 1,
            Kind::F16 | Kind::U16 => 2,
            Kind::F32 => 4,
            Kind::F64 => 8,
        }
    }

    /// The number that `bytes`, as many as [`Self::size`], stand for; exact.
    fn decode(self, bytes: &[u8]) -> f64 {
        // All types fit one 64-bit word.
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        if self.big_endian {
            word[..bytes.len()].reverse();
        }
        let word = u64::from_le_bytes(word);
        match self.kind {
            Kind::F16 => half(word as u16),
            Kind::F32 => f32::from_bits(word as u32).into(),
            Kind::F64 => f64::from_bits(word),
            Kind::U8 | Kind::U16 => word as f64,
        }
    }

    /// The coordinate that a decoded value stands for.
    fn coordinate(self, value: f64) -> Option<f32> {
        match self.kind {
            Kind::U8 => Some(((value + 0.5) / 256.0) as f32),
            Kind::U16 => Some(((value + 0.5) / 65536.0) as f32),
            Kind::F16 | Kind::F32 | Kind::F64 => {
                (0.0..=1.0).contains(&value).then(|| clamp_coordinate(value as f32))
            }
        }
    }
}

/// The value of an IEEE 754 half-precision number.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 0 { 1.0 } else { -1.0 };
    let exponent = (bits >> 10) & 31;
    let fraction = f64::from(bits & 0x3ff) / 1024.0;
    let magnitude = match exponent {
        0 => fraction / 16384.0,
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        // 2^exponent, exactly.
        _ => (1.0 + fraction) * f64::from(1_u32 << exponent) / 32768.0,
    };
    sign * magnitude
}

/// What stands before the elements, checked against the length of the file.
#[derive(Debug)]
struct Header {
    element: Element,
    fortran_order: bool,
    shape: Vec<usize>,
    /// Product of the shape.
    count: usize,
}

impl Header {
    /// Reads up to the first element of a file that is `bytes` long.
    fn read(input: &mut impl Read, bytes: u64) -> Result<Self, NpyError> {
        let mut magic = [0; 6];
        input.read_exact(&mut magic).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => NpyError::Magic,
            _ => NpyError::Io(error),
        })?;
        if &magic != MAGIC {
            return Err(NpyError::Magic);
        }
        let [major, minor] = take(input)?;
        let (length, prefix) = match (major, minor) {
            (1, 0) => (u16::from_le_bytes(take(input)?).into(), 10),
            (2 | 3, 0) => (u32::from_le_bytes(take(input)?), 12),
            _ => return Err(NpyError::Version { major, minor }),
        };
        if length > MAX_HEADER {
            return Err(NpyError::HeaderLength { length });
        }
        let data = bytes.checked_sub(prefix + u64::from(length)).ok_or(NpyError::Truncated)?;
        let mut text = vec![0; length as usize];
        input.read_exact(&mut text).map_err(truncated)?;
        let (element, fortran_order, shape) = Literal { text: &text, at: 0 }.dictionary()?;

        let count = shape.iter().try_fold(1_usize, |product, &size| product.checked_mul(size));
        let needed = count.and_then(|count| count.checked_mul(element.size()));
        let (Some(count), Some(needed)) = (count, needed) else {
            return Err(NpyError::Overflow { shape });
        };
        let expected = needed as u64;
        if expected != data {
            return Err(NpyError::Length { shape, expected, found: data });
        }
        Ok(Self { element, fortran_order, shape, count })
    }

    /// The tile that an array of this shape is.
    fn tile_shape(&self, spp: Option<usize>) -> Result<TileShape, NpyError> {
        let shape = &self.shape;
        let wrong_spp = |spp| NpyError::Spp { shape: shape.clone(), spp };
        let (frames, height, width, held, dims) = match shape[..] {
            [frames, height, width] => (frames, height, width, 1, 1),
            [frames, height, width, values] => {
                let spp = spp.unwrap_or(1);
                if spp == 0 || !values.is_multiple_of(spp) {
                    return Err(wrong_spp(spp));
                }
                (frames, height, width, spp, values / spp)
            }
            [frames, height, width, spp, dims] => (frames, height, width, spp, dims),
            _ => return Err(NpyError::Axes { shape: shape.clone() }),
        };
        match spp {
            Some(spp) if spp != held => Err(wrong_spp(spp)),
            _ => Ok(TileShape::new(width, height, frames, held, dims)?),
        }
    }

    /// Hands every element to `store` with its place in C order, in the order of the file.
    fn read_values(
        &self,
        mut input: impl Read,
        mut store: impl FnMut(usize, f64) -> Result<(), NpyError>,
    ) -> Result<(), NpyError> {
        let size = self.element.size();
        let mut places = Places::new(&self.shape, self.fortran_order);
        let mut bytes = vec![0; BLOCK.min(self.count) * size];
        let mut left = self.count;
        while left > 0 {
            let block = &mut bytes[..BLOCK.min(left) * size];
            input.read_exact(block).map_err(NpyError::Io)?;
            for element in block.chunks_exact(size) {
                store(places.next(), self.element.decode(element))?;
            }
            left -= block.len() / size;
        }
        Ok(())
    }

    /// The position along each axis of a place in C order.
    fn index_of(&self, mut place: usize) -> Vec<usize> {
        let mut index = vec![0; self.shape.len()];
        for (index, &size) in index.iter_mut().zip(&self.shape).rev() {
            *index = place % size;
            place /= size;
        }
        index
    }
}

/// The places in C order of the elements of a file, one after the other.
struct Places {
    /// Size and stride in C order, axis by axis, the one that varies fastest in the file first.
    axes: Vec<(usize, usize)>,
    index: Vec<usize>,
    place: usize,
}

impl Places {
    fn new(shape: &[usize], fortran_order: bool) -> Self {
        let mut stride = 1_usize;
        let mut axes: Vec<_> = shape
            .iter()
            .rev()
            .map(|&size| {
                let axis = (size, stride);
                // An empty array has no places; its strides may overflow.
                stride = stride.wrapping_mul(size);
                axis
            })
            .collect();
        if fortran_order {
            axes.reverse();
        }
        Self { index: vec![0; axes.len()], axes, place: 0 }
    }

    fn next(&mut self) -> usize {
        let place = self.place;
        for (index, &(size, stride)) in self.index.iter_mut().zip(&self.axes) {
            *index += 1;
            self.place += stride;
            if *index < size {
                break;
            }
            self.place -= *index * stride;
            *index = 0;
        }
        place
    }
}

/// The next `N` bytes of the header's frame.
fn take<const N: usize>(input: &mut impl Read) -> Result<[u8; N], NpyError> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes).map_err(truncated)?;
    Ok(bytes)
}

fn truncated(error: io::Error) -> NpyError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => NpyError::Truncated,
        _ => NpyError::Io(error),
    }
}

/// A reader of the one Python literal that the format allows.
struct Literal<'a> {
    text: &'a [u8],
    at: usize,
}

impl Literal<'_> {
    /// `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }`, keys in any order.
    fn dictionary(mut self) -> Result<(Element, bool, Vec<usize>), NpyError> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        self.expect(b'{', "`{`")?;
        while !self.accept(b'}') {
            let key = self.string("a key in quotes")?;
            self.expect(b':', "`:`")?;
            let twice = match key.as_str() {
                "descr" => descr.replace(self.element()?).is_some(),
                "fortran_order" => fortran_order.replace(self.boolean()?).is_some(),
                "shape" => shape.replace(self.tuple()?).is_some(),
                _ => return Err(NpyError::Key { problem: "has the unknown", key }),
            };
            if twice {
                return Err(NpyError::Key { problem: "has twice the", key });
            }
            if !self.accept(b',') {
                self.expect(b'}', "`,` or `}`")?;
                break;
            }
        }
        if self.peek().is_some() {
            return Err(self.unexpected("only blanks after the dictionary"));
        }
        let missing = |key: &str| NpyError::Key { problem: "lacks the", key: key.to_owned() };
        Ok((
            descr.ok_or_else(|| missing("descr"))?,
            fortran_order.ok_or_else(|| missing("fortran_order"))?,
            shape.ok_or_else(|| missing("shape"))?,
        ))
    }

    fn element(&mut self) -> Result<Element, NpyError> {
        let descr = self.string("an element type in quotes")?;
        Element::parse(&descr).ok_or(NpyError::Element { descr })
    }

    fn boolean(&mut self) -> Result<bool, NpyError> {
        self.peek();
        for (word, value) in [(&b"True"[..], true), (b"False", false)] {
            if self.text[self.at..].starts_with(word) {
                self.at += word.len();
                return Ok(value);
            }
        }
        Err(self.unexpected("`True` or `False`"))
    }

    fn tuple(&mut self) -> Result<Vec<usize>, NpyError> {
        let mut sizes = Vec::new();
        self.expect(b'(', "`(`")?;
        while !self.accept(b')') {
            sizes.push(self.size()?);
            // Python 2 wrote sizes as long integers.
            self.accept(b'L');
            if !self.accept(b',') {
                self.expect(b')', "`,` or `)`")?;
                break;
            }
        }
        Ok(sizes)
    }

    fn size(&mut self) -> Result<usize, NpyError> {
        self.peek();
        let digits = self.text[self.at..].iter().take_while(|c| c.is_ascii_digit()).count();
        let value = self.text[self.at..self.at + digits].iter().try_fold(0_usize, |value, c| {
            value.checked_mul(10)?.checked_add(usize::from(c - b'0'))
        });
        match value {
            Some(value) if digits > 0 => {
                self.at += digits;
                Ok(value)
            }
            _ => Err(self.unexpected("a size from 0 to the largest address")),
        }
    }

    fn string(&mut self, expected: &'static str) -> Result<String, NpyError> {
        let Some(quote @ (b'\'' | b'"')) = self.peek() else {
            return Err(self.unexpected(expected));
        };
        let rest = &self.text[self.at + 1..];
        let Some(length) = rest.iter().position(|&c| c == quote) else {
            return Err(self.unexpected("a string that ends"));
        };
        self.at += length + 2;
        Ok(String::from_utf8_lossy(&rest[..length]).into_owned())
    }

    /// The next byte that is not blank, which `at` then points to.
    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn accept(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, byte: u8, expected: &'static str) -> Result<(), NpyError> {
        if self.accept(byte) { Ok(()) } else { Err(self.unexpected(expected)) }
    }

    fn unexpected(&self, expected: &'static str) -> NpyError {
        let found = match self.text.get(self.at) {
            Some(byte) => format!("`{}`", byte.escape_ascii()),
            None => "missing".to_owned(),
        };
        NpyError::Header { at: self.at, expected, found }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::tile::BELOW_ONE;

    /// A file of this header text and these elements.
    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn array(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        file(&header, data)
    }

    fn read(bytes: &[u8]) -> Result<Tile, NpyError> {
        read_tile(bytes, bytes.len() as u64, None)
    }

    fn floats(values: &[f64]) -> Vec<u8> {
        let data: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        array("<f8", &format!("(1, 1, {})", values.len()), &data)
    }

    /// Written by NumPy 2.4: `np.arange(12).reshape(1, 2, 3, 2) * 5000` in Fortran order.
    const BIG_ENDIAN_FORTRAN: &[u8] =
        b"\x93NUMPY\x01\x00v\x00{'descr': '>u2', 'fortran_order': True, 'shape': (1, 2, 3, 2), }\
          \x20                                                    \n\
          \x00\x00u0'\x10\x9c@N \xc3P\x13\x88\x88\xb8:\x98\xaf\xc8a\xa8\xd6\xd8";

    /// Written by NumPy 2.4 as version 2.0: `np.arange(4).reshape(1, 2, 2) / 4`.
    const SECOND_VERSION: &[u8] = b"\x93NUMPY\x02\x00t\x00\x00\x00\
          {'descr': '<f8', 'fortran_order': False, 'shape': (1, 2, 2), }\
          \x20                                                    \n\
          \x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\xd0?\
          \x00\x00\x00\x00\x00\x00\xe0?\x00\x00\x00\x00\x00\x00\xe8?";

    #[test]
    fn files_of_numpy_are_read() {
        let tile = read(BIG_ENDIAN_FORTRAN).unwrap();
        assert_eq!(tile.shape(), TileShape::new(3, 2, 1, 1, 2).unwrap());
        let expected: Vec<f32> =
            (0..12).map(|i| ((f64::from(i) * 5000.0 + 0.5) / 65536.0) as f32).collect();
        assert_eq!(tile.samples(), expected);
        let tile = read(SECOND_VERSION).unwrap();
        assert_eq!(tile.shape(), TileShape::new(2, 2, 1, 1, 1).unwrap());
        assert_eq!(tile.samples(), [0.0, 0.25, 0.5, 0.75]);
    }

    #[test]
    fn every_length_but_the_right_one_is_an_error() {
        for whole in [BIG_ENDIAN_FORTRAN, SECOND_VERSION] {
            for length in 0..whole.len() {
                assert!(read(&whole[..length]).is_err(), "{length}");
            }
            let longer = [whole, b"x"].concat();
            assert!(matches!(read(&longer), Err(NpyError::Length { .. })));
            // A file that shrinks while it is read.
            let short = &whole[..whole.len() - 1];
            let result = read_tile(short, whole.len() as u64, None);
            assert!(matches!(result, Err(NpyError::Io(_))));
        }
    }

    #[test]
    fn halves_are_those_of_the_standard() {
        for (bits, value) in [
            (0x0000, 0.0),
            (0x0001, 1.0 / 16_777_216.0),
            (0x03ff, 1023.0 / 16_777_216.0),
            (0x0400, 1.0 / 16384.0),
            (0x3555, 1365.0 / 4096.0),
            (0x3800, 0.5),
            (0x3bff, 2047.0 / 2048.0),
            (0x3c00, 1.0),
            (0x7bff, 65504.0),
            (0x7c00, f64::INFINITY),
            (0xfc00, f64::NEG_INFINITY),
            (0xc000, -2.0),
        ] {
            assert_eq!(half(bits), value, "{bits:#x}");
        }
        assert!(half(0x7c01).is_nan());
        let tile = read(&array(">f2", "(1, 1, 2)", &[0x38, 0x00, 0x3c, 0x00])).unwrap();
        assert_eq!(tile.samples(), [0.5, BELOW_ONE]);
    }

    #[test]
    fn coordinates_are_checked_and_brought_into_range() {
        let tile = read(&floats(&[0.0, -0.0, 0.1, 1.0 - 1e-12, 1.0])).unwrap();
        let bits: Vec<u32> = tile.samples().iter().map(|x| x.to_bits()).collect();
        assert_eq!(bits, [0.0, 0.0, 0.1, BELOW_ONE, BELOW_ONE].map(f32::to_bits));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.0 + 1e-15, -1e-300, 255.0] {
            match read(&floats(&[0.5, 0.5, bad])).unwrap_err() {
                NpyError::Coordinate { index, value } => {
                    assert_eq!(index, [0, 0, 2]);
                    assert_eq!(value.to_bits(), bad.to_bits());
                }
                other => panic!("{other}"),
            }
        }
        let fortran = "{'descr': '<f4', 'fortran_order': True, 'shape': (1, 2, 3), }";
        let data: Vec<u8> =
            [0.0, 0.0, 0.0, 7.0, 0.0, 0.0_f32].iter().flat_map(|x| x.to_le_bytes()).collect();
        let error = read(&file(fortran, &data)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the value at [0, 1, 1] is 7, but every coordinate must be in [0, 1)"
        );
    }

    #[test]
    fn samples_per_pixel_split_the_last_axis_of_four() {
        let bytes = array("|u1", "(1, 1, 1, 6)", &[0, 1, 2, 3, 4, 5]);
        let spp = |bytes: &[u8], spp| read_tile(bytes, bytes.len() as u64, Some(spp));
        let tile = spp(&bytes, 2).unwrap();
        assert_eq!(tile.shape(), TileShape::new(1, 1, 1, 2, 3).unwrap());
        assert_eq!(tile.point(0, 0, 0, 1), [3.5 / 256.0, 4.5 / 256.0, 5.5 / 256.0]);
        assert!(matches!(spp(&bytes, 4), Err(NpyError::Spp { spp: 4, .. })));
        assert!(matches!(spp(&bytes, 0), Err(NpyError::Spp { spp: 0, .. })));
        let three = array("|u1", "(1, 1, 2)", &[0, 1]);
        assert!(spp(&three, 1).is_ok() && spp(&three, 2).is_err());
        let five = array("|u1", "(1, 1, 1, 2, 1)", &[0, 1]);
        assert!(spp(&five, 2).is_ok() && spp(&five, 1).is_err());
    }

    #[test]
    fn lies_and_nonsense_have_their_messages() {
        let message = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        let with = |header: &str| message(&file(header, &[0; 8]));
        let shape = |shape: &str| message(&array("|u1", shape, &[0; 8]));
        for (message, part) in [
            (message(b""), "NUMPY"),
            (message(b"PK\x03\x04 a zip file"), "NUMPY"),
            (message(b"\x93NUMPY\x04\x00"), "version 4.0"),
            (message(b"\x93NUMPY\x02\x00\xff\xff\xff\xff"), "4294967295"),
            (message(b"\x93NUMPY\x02\x00\x00\x01\x00\x00"), "ends inside"),
            (with(""), "`{` must"),
            (with("{"), "a key in quotes"),
            (with(&"(".repeat(60_000)), "`{` must"),
            (with(&"{'shape': ".repeat(6_000)), "byte 10"),
            (with("{'descr': [('x', '<f4')]}"), "an element type"),
            (with("{'descr': '<f4"), "a string that ends"),
            (with("{'descr' '<f4'}"), "`:` must"),
            (with("{'fortran_order': 1}"), "`True` or `False`"),
            (with("{'shape': (1, 2)}"), "lacks the key \"descr\""),
            (with("{'shape': (1,), 'shape': (1,)}"), "twice the key \"shape\""),
            (with("{'name': 'x'}"), "unknown key \"name\""),
            (with("{'shape': (2, 4) 'descr'"), "`,` or `}`"),
            (with("{}x"), "only blanks"),
            (shape("(-1, 8)"), "`-`"),
            (shape("(1.5, 8)"), "`.`"),
            (shape("(1 8)"), "`,` or `)`"),
            (shape("(99999999999999999999, 8)"), "a size"),
            (shape("(2, 2, 3)"), "needs 12 bytes of data, but the file has 8"),
            (shape("(4294967296, 4294967296, 4294967296)"), "memory can address"),
            (shape("(0, 18446744073709551615, 3)"), "needs 0 bytes"),
            (shape("(8,)"), "1 axes"),
            (shape("(1, 1, 1, 1, 2, 4)"), "6 axes"),
        ] {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }

    #[test]
    fn only_types_of_coordinates_are_read() {
        for descr in ["<i4", "<u4", "|b1", "<c8", "=f4", "|u2", "<f16", "<U1", "O", "", "é4"] {
            let error = read(&array(descr, "(1, 1, 1)", &[0; 4])).unwrap_err();
            assert!(matches!(error, NpyError::Element { .. }), "{descr}: {error}");
        }
    }

    #[test]
    fn sizes_that_are_no_tile_are_refused() {
        let empty = array("<f4", "(0, 4, 4)", &[]);
        assert!(matches!(read(&empty), Err(NpyError::Shape(ShapeError::Zero { .. }))));
        let many = array("|u1", "(1, 1, 1, 17)", &[0; 17]);
        assert!(matches!(read(&many), Err(NpyError::Shape(ShapeError::Limit { .. }))));
    }

    #[test]
    fn coordinates_in_pieces_make_the_file_of_the_whole() {
        let shape = TileShape::new(5, 4, 3, 2, 3).unwrap();
        let count = shape.coordinates();
        let samples: Vec<f32> = (0..count).map(|i| i as f32 / count as f32).collect();
        let give = |samples: &[f32], size: usize| {
            let mut bytes = Vec::new();
            let result = write_rows(shape, &mut bytes, &mut |put| {
                samples.chunks(size).try_for_each(&mut *put)
            });
            result.map(|()| bytes).map_err(|error| (error.kind(), error.to_string()))
        };
        let data: Vec<u8> = samples.iter().flat_map(|x| x.to_le_bytes()).collect();
        let mut whole = Vec::new();
        write_tile(&Tile::new(shape, samples.clone()).unwrap(), &mut whole).unwrap();
        assert_eq!(whole[whole.len() - data.len()..], data);
        for size in [1, 7, 30, count - 1, count] {
            assert_eq!(give(&samples, size).unwrap(), whole);
            let (few, more) = (&samples[1..], [&samples[..], &[0.5]].concat());
            for (wrong, part) in [(few, "359 numbers instead of 360"), (&more, "more than 360")] {
                let (kind, message) = give(wrong, size).unwrap_err();
                assert_eq!(kind, io::ErrorKind::InvalidData);
                assert!(message.contains(part), "{message}");
            }
        }
        for bad in [1.0, -0.5, f32::NAN] {
            let mut wrong = samples.clone();
            wrong[100] = bad;
            let (kind, message) = give(&wrong, 7).unwrap_err();
            assert_eq!(kind, io::ErrorKind::InvalidData);
            assert!(message.contains(&bad.to_string()), "{message}");
        }
    }

    proptest! {
        #[test]
        fn places_are_visited_as_the_strides_say(
            shape in proptest::collection::vec(1_usize..5, 0..6),
        ) {
            let count: usize = shape.iter().product();
            let mut c = Places::new(&shape, false);
            prop_assert!((0..count).all(|place| c.next() == place));
            let mut fortran = Places::new(&shape, true);
            for position in 0..count {
                // The index with the first axis fastest, then its place with the last fastest.
                let mut left = position;
                let place = shape.iter().fold(0, |place, &size| {
                    let index = left % size;
                    left /= size;
                    place * size + index
                });
                prop_assert_eq!(fortran.next(), place);
            }
        }
    }
}
