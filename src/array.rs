//! Arrays of numbers in `.npy` files, whatever they mean: tiles and kernel tables are read from here.
//!
//! The layout (magic, version, header length, a Python dictionary literal padded to 64 bytes,
//! then the raw elements) is that of NumPy's NEP 1. The header is parsed here and not by a
//! library, because a general literal parser recurses as deep as the file says and trusts its
//! sizes; this one accepts exactly the three keys of the format and checks the shape against the
//! length of the file before anything is allocated.

use std::fmt;
use std::io::{self, Read, Write};

use thiserror::Error;

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Longest header accepted, in bytes; that of a plain array has fewer than 200.
const MAX_HEADER: u32 = 1 << 16;
/// The header is padded so that the elements begin at a multiple of this many bytes.
const ALIGNMENT: usize = 64;
/// Elements that are decoded at a time.
const BLOCK: usize = 1 << 13;

/// Why bytes are not a `.npy` file that can be read.
#[derive(Debug, Error)]
pub enum ArrayError {
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
}

/// Writes what stands before the elements of an array of little-endian `f32` in C order.
///
/// # Errors
/// What `out` reports, and a shape of thousands of axes.
pub fn write_header(shape: &[usize], out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    write_header_of(ElementKind::F32, shape, out)
}

/// Writes what stands before the elements of an array of this kind, little-endian, in C order.
///
/// # Errors
/// Those of [`write_header`].
pub fn write_header_of(
    kind: ElementKind,
    shape: &[usize],
    out: &mut (impl Write + ?Sized),
) -> io::Result<()> {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    // A single byte has no order.
    let order = if kind == ElementKind::U8 { '|' } else { '<' };
    let mut header = format!(
        "{{'descr': '{order}{kind}', 'fortran_order': False, 'shape': ({}{}), }}",
        sizes.join(", "),
        // A tuple of one needs it.
        if shape.len() == 1 { "," } else { "" }
    );
    // Ten bytes precede the dictionary, one line feed ends it.
    let padding = (ALIGNMENT - (10 + header.len() + 1) % ALIGNMENT) % ALIGNMENT;
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(io::Error::other)?;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())
}

/// What an element is, without its byte order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementKind {
    /// A float of 16 bits.
    F16,
    /// A float of 32 bits.
    F32,
    /// A float of 64 bits.
    F64,
    /// An unsigned integer of 8 bits.
    U8,
    /// An unsigned integer of 16 bits.
    U16,
}

/// As headers write it, such as `f4`.
impl fmt::Display for ElementKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::F16 => "f2",
            Self::F32 => "f4",
            Self::F64 => "f8",
            Self::U8 => "u1",
            Self::U16 => "u2",
        })
    }
}

/// How an element is stored.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Element {
    kind: ElementKind,
    big_endian: bool,
}

impl Element {
    /// From the header's text: byte order, kind, bytes.
    fn parse(descr: &str) -> Option<Self> {
        let (order, kind) = descr.split_at_checked(1)?;
        let kind = match kind {
            "f2" => ElementKind::F16,
            "f4" => ElementKind::F32,
            "f8" => ElementKind::F64,
            "u1" => ElementKind::U8,
            "u2" => ElementKind::U16,
            _ => return None,
        };
        match order {
            "<" => Some(Self { kind, big_endian: false }),
            ">" => Some(Self { kind, big_endian: true }),
            // "Not applicable", which only single bytes may say.
            "|" if kind == ElementKind::U8 => Some(Self { kind, big_endian: false }),
            _ => None,
        }
    }

    /// Bytes of an element.
    fn size(self) -> usize {
        match self.kind {
            ElementKind::U8 => 1,
            ElementKind::F16 | ElementKind::U16 => 2,
            ElementKind::F32 => 4,
            ElementKind::F64 => 8,
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
            ElementKind::F16 => half(word as u16),
            ElementKind::F32 => f32::from_bits(word as u32).into(),
            ElementKind::F64 => f64::from_bits(word),
            ElementKind::U8 | ElementKind::U16 => word as f64,
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

/// What stands before the elements of an array, checked against the length of the file.
#[derive(Debug)]
pub struct ArrayHeader {
    element: Element,
    fortran_order: bool,
    shape: Vec<usize>,
    /// Product of the shape.
    count: usize,
}

impl ArrayHeader {
    /// Reads up to the first element of a file that is `bytes` long.
    ///
    /// # Errors
    /// Any [`ArrayError`]: no such file, a header that is none, elements of another kind, or a shape
    /// that contradicts the length of the file.
    pub fn read(input: &mut impl Read, bytes: u64) -> Result<Self, ArrayError> {
        let mut magic = [0; 6];
        input.read_exact(&mut magic).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => ArrayError::Magic,
            _ => ArrayError::Io(error),
        })?;
        if &magic != MAGIC {
            return Err(ArrayError::Magic);
        }
        let [major, minor] = take(input)?;
        let (length, prefix) = match (major, minor) {
            (1, 0) => (u16::from_le_bytes(take(input)?).into(), 10),
            (2 | 3, 0) => (u32::from_le_bytes(take(input)?), 12),
            _ => return Err(ArrayError::Version { major, minor }),
        };
        if length > MAX_HEADER {
            return Err(ArrayError::HeaderLength { length });
        }
        let data = bytes.checked_sub(prefix + u64::from(length)).ok_or(ArrayError::Truncated)?;
        let mut text = vec![0; length as usize];
        input.read_exact(&mut text).map_err(truncated)?;
        let (element, fortran_order, shape) = Literal { text: &text, at: 0 }.dictionary()?;

        let count = shape.iter().try_fold(1_usize, |product, &size| product.checked_mul(size));
        let needed = count.and_then(|count| count.checked_mul(element.size()));
        let (Some(count), Some(needed)) = (count, needed) else {
            return Err(ArrayError::Overflow { shape });
        };
        let expected = needed as u64;
        if expected != data {
            return Err(ArrayError::Length { shape, expected, found: data });
        }
        Ok(Self { element, fortran_order, shape, count })
    }

    /// Length of each axis.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Number of elements: the product of the shape.
    pub fn count(&self) -> usize {
        self.count
    }

    /// What the elements are.
    pub fn kind(&self) -> ElementKind {
        self.element.kind
    }

    /// The header of one entry along the first axis, and its bytes, if entries lie one behind the other
    /// in the file.
    pub fn entry(&self) -> Option<(Self, u64)> {
        let (_, shape) = self.shape.split_first()?;
        if self.fortran_order {
            return None;
        }
        let count = shape.iter().product::<usize>();
        let (element, shape) = (self.element, shape.to_vec());
        let bytes = (count * element.size()) as u64;
        Some((Self { element, fortran_order: false, shape, count }, bytes))
    }

    /// Hands every element to `store` with its place in C order, in the order of the file. Integers
    /// come as their value.
    ///
    /// # Errors
    /// What `store` reports, and [`ArrayError::Io`].
    pub fn read_values<E: From<ArrayError>>(
        &self,
        mut input: impl Read,
        mut store: impl FnMut(usize, f64) -> Result<(), E>,
    ) -> Result<(), E> {
        let size = self.element.size();
        let mut places = Places::new(&self.shape, self.fortran_order);
        let mut bytes = vec![0; BLOCK.min(self.count) * size];
        let mut left = self.count;
        while left > 0 {
            let block = &mut bytes[..BLOCK.min(left) * size];
            input.read_exact(block).map_err(ArrayError::Io)?;
            for element in block.chunks_exact(size) {
                store(places.next(), self.element.decode(element))?;
            }
            left -= block.len() / size;
        }
        Ok(())
    }

    /// The position along each axis of a place in C order.
    pub fn index_of(&self, mut place: usize) -> Vec<usize> {
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
fn take<const N: usize>(input: &mut impl Read) -> Result<[u8; N], ArrayError> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes).map_err(truncated)?;
    Ok(bytes)
}

fn truncated(error: io::Error) -> ArrayError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => ArrayError::Truncated,
        _ => ArrayError::Io(error),
    }
}

/// A reader of the one Python literal that the format allows.
struct Literal<'a> {
    text: &'a [u8],
    at: usize,
}

impl Literal<'_> {
    /// `{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }`, keys in any order.
    fn dictionary(mut self) -> Result<(Element, bool, Vec<usize>), ArrayError> {
        let (mut descr, mut fortran_order, mut shape) = (None, None, None);
        self.expect(b'{', "`{`")?;
        while !self.accept(b'}') {
            let key = self.string("a key in quotes")?;
            self.expect(b':', "`:`")?;
            let twice = match key.as_str() {
                "descr" => descr.replace(self.element()?).is_some(),
                "fortran_order" => fortran_order.replace(self.boolean()?).is_some(),
                "shape" => shape.replace(self.tuple()?).is_some(),
                _ => return Err(ArrayError::Key { problem: "has the unknown", key }),
            };
            if twice {
                return Err(ArrayError::Key { problem: "has twice the", key });
            }
            if !self.accept(b',') {
                self.expect(b'}', "`,` or `}`")?;
                break;
            }
        }
        if self.peek().is_some() {
            return Err(self.unexpected("only blanks after the dictionary"));
        }
        let missing = |key: &str| ArrayError::Key { problem: "lacks the", key: key.to_owned() };
        Ok((
            descr.ok_or_else(|| missing("descr"))?,
            fortran_order.ok_or_else(|| missing("fortran_order"))?,
            shape.ok_or_else(|| missing("shape"))?,
        ))
    }

    fn element(&mut self) -> Result<Element, ArrayError> {
        let descr = self.string("an element type in quotes")?;
        Element::parse(&descr).ok_or(ArrayError::Element { descr })
    }

    fn boolean(&mut self) -> Result<bool, ArrayError> {
        self.peek();
        for (word, value) in [(&b"True"[..], true), (b"False", false)] {
            if self.text[self.at..].starts_with(word) {
                self.at += word.len();
                return Ok(value);
            }
        }
        Err(self.unexpected("`True` or `False`"))
    }

    fn tuple(&mut self) -> Result<Vec<usize>, ArrayError> {
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

    fn size(&mut self) -> Result<usize, ArrayError> {
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

    fn string(&mut self, expected: &'static str) -> Result<String, ArrayError> {
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

    fn expect(&mut self, byte: u8, expected: &'static str) -> Result<(), ArrayError> {
        if self.accept(byte) { Ok(()) } else { Err(self.unexpected(expected)) }
    }

    fn unexpected(&self, expected: &'static str) -> ArrayError {
        let found = match self.text.get(self.at) {
            Some(byte) => format!("`{}`", byte.escape_ascii()),
            None => "missing".to_owned(),
        };
        ArrayError::Header { at: self.at, expected, found }
    }
}

/// A file of this header text and these elements.
#[cfg(test)]
pub(crate) fn file(header: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

/// A file of elements of this type and this shape, in C order.
#[cfg(test)]
pub(crate) fn array_file(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    file(&format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n"), data)
}

#[cfg(test)]
mod tests {
    use npyz::WriterBuilder;
    use proptest::prelude::*;

    use super::*;

    /// The shape and the values in C order of a file that says it has so many bytes.
    fn read_of(input: &[u8], bytes: usize) -> Result<(Vec<usize>, Vec<f64>), ArrayError> {
        let mut input = input;
        let header = ArrayHeader::read(&mut input, bytes as u64)?;
        let mut values = vec![f64::NAN; header.count()];
        header.read_values(input, |place, value| {
            values[place] = value;
            Ok::<(), ArrayError>(())
        })?;
        Ok((header.shape().to_vec(), values))
    }

    fn read(bytes: &[u8]) -> Result<(Vec<usize>, Vec<f64>), ArrayError> {
        read_of(bytes, bytes.len())
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
        let expected: Vec<f64> = (0..12).map(|i| f64::from(i) * 5000.0).collect();
        assert_eq!(read(BIG_ENDIAN_FORTRAN).unwrap(), (vec![1, 2, 3, 2], expected));
        let expected = vec![0.0, 0.25, 0.5, 0.75];
        assert_eq!(read(SECOND_VERSION).unwrap(), (vec![1, 2, 2], expected));
    }

    #[test]
    fn every_length_but_the_right_one_is_an_error() {
        for whole in [BIG_ENDIAN_FORTRAN, SECOND_VERSION] {
            for length in 0..whole.len() {
                assert!(read(&whole[..length]).is_err(), "{length}");
            }
            let longer = [whole, b"x"].concat();
            assert!(matches!(read(&longer), Err(ArrayError::Length { .. })));
            // A file that shrinks while it is read.
            let short = &whole[..whole.len() - 1];
            let result = read_of(short, whole.len());
            assert!(matches!(result, Err(ArrayError::Io(_))));
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
    }

    #[test]
    fn lies_and_nonsense_have_their_messages() {
        let message = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        let with = |header: &str| message(&file(header, &[0; 8]));
        let shape = |shape: &str| message(&array_file("|u1", shape, &[0; 8]));
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
        ] {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }

    #[test]
    fn other_types_are_refused() {
        for descr in ["<i4", "<u4", "|b1", "<c8", "=f4", "|u2", "<f16", "<U1", "O", "", "é4"] {
            let error = read(&array_file(descr, "(1, 1, 1)", &[0; 4])).unwrap_err();
            assert!(matches!(error, ArrayError::Element { .. }), "{descr}: {error}");
        }
    }

    /// A file of these numbers, in the order in which they lie in it, by another writer.
    fn written<T>(descr: &str, shape: &[u64], order: npyz::Order, numbers: &[T]) -> Vec<u8>
    where
        T: npyz::Serialize + Copy,
    {
        let mut bytes = Vec::new();
        let options = npyz::WriteOptions::new()
            .dtype(npyz::DType::Plain(descr.parse().unwrap()))
            .order(order);
        let mut writer = options.shape(shape).writer(&mut bytes).begin_nd().unwrap();
        writer.extend(numbers.iter().copied()).unwrap();
        writer.finish().unwrap();
        bytes
    }

    /// Shape and values in C order, by another reader; nothing if it refuses the file.
    fn read_by_other(bytes: &[u8]) -> Option<(Vec<usize>, Vec<f64>)> {
        let file = npyz::NpyFile::new(bytes).ok()?;
        let shape: Vec<usize> = file.shape().iter().map(|&size| size as usize).collect();
        let (order, npyz::DType::Plain(dtype)) = (file.order(), file.dtype()) else { return None };
        let numbers: Vec<f64> = match &dtype.to_string()[1..] {
            "f4" => file.into_vec::<f32>().ok()?.into_iter().map(f64::from).collect(),
            "f8" => file.into_vec().ok()?,
            "u1" => file.into_vec::<u8>().ok()?.into_iter().map(f64::from).collect(),
            "u2" => file.into_vec::<u16>().ok()?.into_iter().map(f64::from).collect(),
            _ => return None,
        };
        if order == npyz::Order::C {
            return Some((shape, numbers));
        }
        let in_c_order = (0..numbers.len()).map(|mut place| {
            let mut index = vec![0; shape.len()];
            for (index, size) in index.iter_mut().zip(&shape).rev() {
                (*index, place) = (place % size, place / size);
            }
            let axes = index.iter().zip(&shape).rev();
            numbers[axes.fold(0, |place, (index, size)| place * size + index)]
        });
        let numbers = in_c_order.collect();
        Some((shape, numbers))
    }

    fn files() -> impl Strategy<Value = Vec<u8>> {
        let shape = prop::collection::vec(1_u64..5, 1..6);
        (shape, 0..7_usize, any::<bool>(), any::<u64>()).prop_map(|(shape, kind, fortran, seed)| {
            let order = if fortran { npyz::Order::Fortran } else { npyz::Order::C };
            let bits = |i: u64| (i + 1).wrapping_mul(seed | 1).rotate_left(29);
            let bits: Vec<u64> = (0..shape.iter().product()).map(bits).collect();
            // Any number but NaN, which is not equal to itself.
            let double =
                |&x: &u64| if f64::from_bits(x).is_nan() { 0.5 } else { f64::from_bits(x) };
            let single = |&x: &u64| {
                let number = f32::from_bits(x as u32);
                if number.is_nan() { 0.5 } else { number }
            };
            let doubles: Vec<f64> = bits.iter().map(double).collect();
            let singles: Vec<f32> = bits.iter().map(single).collect();
            let bytes: Vec<u8> = bits.iter().map(|&x| x as u8).collect();
            let words: Vec<u16> = bits.iter().map(|&x| x as u16).collect();
            match kind {
                0 => written("<f8", &shape, order, &doubles),
                1 => written(">f8", &shape, order, &doubles),
                2 => written("<f4", &shape, order, &singles),
                3 => written(">f4", &shape, order, &singles),
                4 => written("<u2", &shape, order, &words),
                5 => written(">u2", &shape, order, &words),
                _ => written("|u1", &shape, order, &bytes),
            }
        })
    }

    proptest! {
        #[test]
        fn another_reader_finds_the_same(bytes in files()) {
            let ours = read(&bytes).unwrap();
            prop_assert_eq!(Some(ours), read_by_other(&bytes));
        }

        #[test]
        fn damage_gets_an_answer_and_no_other_numbers(
            bytes in files(),
            damage in prop::collection::vec((0..160_usize, any::<u8>()), 1..4),
        ) {
            let mut bytes = bytes;
            for (place, byte) in damage {
                let place = place % bytes.len();
                bytes[place] = byte;
            }
            // What is accepted here is harmless to the other reader.
            if let Ok((shape, values)) = read(&bytes)
                && let Some((other_shape, others)) = read_by_other(&bytes)
            {
                prop_assert_eq!(shape, other_shape);
                let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                prop_assert_eq!(bits(&values), bits(&others));
            }
        }

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
