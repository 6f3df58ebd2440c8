//! Checkpoints: the state of a long run as a file from which it goes on, bit for bit.
//!
//! A checkpoint is a value (the *head*) and a few arrays of numbers, which may have gigabytes.
//! What they mean is the solver's business; here they are only kept from harm. All integers and
//! numbers are little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | magic |
//! | 4 | version of this layout, [`FORMAT`] |
//! | 4 | number of arrays, at most [`MAX_ARRAYS`] |
//! | 8 | bytes of the head |
//! | 16 · 8 | numbers in each array; 0 for those that are not there |
//! | 32 | SHA-256 of the head |
//! | 32 | SHA-256 of the 184 bytes so far |
//! | … | the head, encoded by [`perceptile_cluster::codec`] |
//! | … | the arrays, as `f32` |
//! | 32 | SHA-256 of everything before |
//!
//! The lengths have a checksum of their own and must add up to the length of the file, so that
//! nothing is allocated on the word of a damaged one. The head has its own as well, so that it
//! can be read and trusted without the arrays.
//!
//! Arrays come and go in pieces, and are never whole here. Whether they are good is known only
//! when all are read, so a file is read twice by who must not act on a damaged one: the first
//! time gives a [`Seal`], by which the second is known to have read the same ([`read_again`]).

use std::io::{self, ErrorKind, Read, Write};

use perceptile_cluster::codec::{self, CodecError};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::hashed::{DIGEST, Hashed};
use super::numbers::{ArraySink, ArraySource, BLOCK, NumberWriter};

/// The version of the layout that is written and read.
pub const FORMAT: u32 = 1;
/// Most arrays of a checkpoint.
pub const MAX_ARRAYS: usize = 16;
/// Longest head, in bytes as encoded.
pub const MAX_HEAD: usize = 64 << 20;

const MAGIC: &[u8; 8] = b"\x93PTCHECK";
/// What a head may ask for when it is decoded, in bytes. No value asks for more than 16 times its
/// encoded length, so that every head that could be written can be read.
const HEAD_MEMORY: usize = 16 * MAX_HEAD;
/// Bytes of the magic and the version, which all versions have in common.
const PREFIX: usize = 12;
/// Bytes of the fixed part that its checksum covers.
const SEALED: usize = PREFIX + 4 + 8 + 8 * MAX_ARRAYS + DIGEST;
/// Bytes of the fixed part.
const FIXED: usize = SEALED + DIGEST;

/// Why bytes are not a checkpoint that can be used.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// Reading failed.
    #[error("cannot be read: {0}")]
    Io(io::Error),
    /// The first bytes are not a checkpoint's.
    #[error("no checkpoint: it begins with the bytes {found:02x?}")]
    Magic {
        /// The first bytes.
        found: [u8; 8],
    },
    /// Another version of the layout.
    #[error("the checkpoint has format {found}, but this version reads format {expected}")]
    Version {
        /// The version that the file says.
        found: u32,
        /// The only one that is read, [`FORMAT`].
        expected: u32,
    },
    /// The end is missing.
    #[error("cut short: {found} of {expected} bytes")]
    CutShort {
        /// Bytes that are there.
        found: u64,
        /// Bytes that there must be; if even the lengths are missing, only theirs.
        expected: u64,
    },
    /// Something follows the end.
    #[error("too long: {found} bytes instead of {expected}")]
    TooLong {
        /// Bytes that are there.
        found: u64,
        /// Bytes that there must be.
        expected: u64,
    },
    /// The bytes are not those that were written.
    #[error("the checksum of the {part} does not match: the file is damaged")]
    Checksum {
        /// What is damaged: lengths, head or contents.
        part: &'static str,
    },
    /// Lengths, undamaged, that no checkpoint has.
    #[error("the checkpoint claims {found}, but must have {rule}")]
    Lengths {
        /// What it claims.
        found: String,
        /// The rule.
        rule: String,
    },
    /// An undamaged head that is not of the kind asked for.
    #[error("the head of the checkpoint is of another kind: {0}")]
    Head(CodecError),
}

/// What a checkpoint was when it was read, by which it is known again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// Bytes of the file.
    len: u64,
    /// Numbers in each array.
    lengths: Vec<u64>,
    /// SHA-256 of all before it.
    digest: [u8; DIGEST],
}

impl Seal {
    /// How many numbers each array has.
    pub fn lengths(&self) -> &[u64] {
        &self.lengths
    }
}

/// Writes a checkpoint of a head and arrays with so many numbers each.
///
/// `arrays` is asked for one array after the other. When something has failed, it is asked for no
/// more.
///
/// # Errors
/// What `out` or `arrays` reports; a head that cannot be encoded or has more than [`MAX_HEAD`]
/// bytes, and more than [`MAX_ARRAYS`] arrays ([`ErrorKind::InvalidInput`], nothing is written);
/// an array with more numbers than its length says, or fewer ([`ErrorKind::InvalidData`]).
pub fn write<H: Serialize>(
    out: &mut impl Write,
    head: &H,
    lengths: &[u64],
    arrays: &dyn ArraySource,
) -> io::Result<()> {
    let refused = |why: String| io::Error::new(ErrorKind::InvalidInput, why);
    let head = codec::encode(head)
        .map_err(|error| refused(format!("the head cannot be encoded: {error}")))?;
    if head.len() > MAX_HEAD {
        let bytes = head.len();
        return Err(refused(format!("the head has {bytes} bytes, but may have {MAX_HEAD}")));
    }
    if lengths.len() > MAX_ARRAYS {
        let number = lengths.len();
        return Err(refused(format!("there are {number} arrays, but may be {MAX_ARRAYS}")));
    }
    let lengths = Lengths { head: head.len() as u64, arrays: lengths.to_vec() };
    let mut out = Hashed::new(out);
    out.write_all(&lengths.encode(&Sha256::digest(&head).into()))?;
    out.write_all(&head)?;
    for (index, length) in lengths.arrays.iter().enumerate() {
        let mut writer = NumberWriter::new(&mut out, *length);
        arrays.array(index, &mut writer)?;
        writer.finish()?;
    }
    let (out, digest) = out.finish();
    out.write_all(&digest)
}

/// Reads a checkpoint of `len` bytes: its head, and by what it is known again. The numbers of
/// each array are passed on piece by piece as they are read, with the number of the array; they
/// are worth nothing if there is an error in the end.
///
/// Takes little memory, and reads at most `len` bytes.
///
/// # Errors
/// Anything that is not exactly a checkpoint of `len` bytes, as [`write()`] writes it; a head that
/// is no `H`; what `input` reports.
pub fn read_with<H: DeserializeOwned>(
    input: &mut impl Read,
    len: u64,
    sink: &mut ArraySink<'_>,
) -> Result<(H, Seal), CheckpointError> {
    let mut input = HashedReader::new(input, len);
    let (head, lengths) = front(&mut input)?;
    let head = decode(&head)?;
    let digest = contents(&mut input, &lengths, sink)?;
    Ok((head, Seal { len, lengths, digest }))
}

/// Reads the arrays of a checkpoint that was read before, as [`read_with`] does. The arrays have
/// the same lengths as then, or nothing is passed on.
///
/// # Errors
/// Anything that is not exactly the file that was read before; what `input` reports.
pub fn read_again(
    input: &mut impl Read,
    seal: &Seal,
    sink: &mut ArraySink<'_>,
) -> Result<(), CheckpointError> {
    let mut input = HashedReader::new(input, seal.len);
    let (_, lengths) = front(&mut input)?;
    if lengths != seal.lengths {
        return Err(CheckpointError::Checksum { part: "lengths" });
    }
    if contents(&mut input, &lengths, sink)? != seal.digest {
        return Err(CheckpointError::Checksum { part: "contents" });
    }
    Ok(())
}

/// Reads only the head of a checkpoint of `len` bytes, and how many numbers each array has.
///
/// Lengths and head are checked; damage in the arrays is left for [`read_with`] to find.
///
/// # Errors
/// As for [`read_with`], the arrays excepted.
pub fn read_head<H: DeserializeOwned>(
    input: &mut impl Read,
    len: u64,
) -> Result<(H, Vec<u64>), CheckpointError> {
    let (head, lengths) = front(&mut HashedReader::new(input, len))?;
    Ok((decode(&head)?, lengths))
}

/// Everything before the arrays, checked: the head as encoded, and the numbers in each array.
fn front(input: &mut HashedReader<impl Read>) -> Result<(Vec<u8>, Vec<u64>), CheckpointError> {
    let mut fixed = [0; FIXED];
    let (prefix, rest) = fixed.split_at_mut(PREFIX);
    input.need(PREFIX as u64)?;
    input.fill(prefix)?;
    let (magic, version) = split::<8>(prefix);
    if magic != *MAGIC {
        return Err(CheckpointError::Magic { found: magic });
    }
    // Before all else that may differ in another version.
    let found = u32::from_le_bytes(split::<4>(version).0);
    if found != FORMAT {
        return Err(CheckpointError::Version { found, expected: FORMAT });
    }
    input.need(FIXED as u64)?;
    input.fill(rest)?;
    let (sealed, seal) = fixed.split_at(SEALED);
    if seal != Sha256::digest(sealed).as_slice() {
        return Err(CheckpointError::Checksum { part: "lengths" });
    }
    let (lengths, digest) = Lengths::decode(&sealed[PREFIX..])?;
    let expected = lengths.total()?;
    input.need(expected)?;
    if input.len > expected {
        return Err(CheckpointError::TooLong { found: input.len, expected });
    }
    // At most `MAX_HEAD`, and at most what is there.
    let mut head = vec![0; lengths.head as usize];
    input.fill(&mut head)?;
    if digest != Sha256::digest(&head).as_slice() {
        return Err(CheckpointError::Checksum { part: "head" });
    }
    Ok((head, lengths.arrays))
}

fn decode<H: DeserializeOwned>(head: &[u8]) -> Result<H, CheckpointError> {
    codec::decode::<H, HEAD_MEMORY>(head).map_err(CheckpointError::Head)
}

/// The arrays, passed on, and the checksum of all. Returns that.
fn contents(
    input: &mut HashedReader<impl Read>,
    lengths: &[u64],
    sink: &mut ArraySink<'_>,
) -> Result<[u8; DIGEST], CheckpointError> {
    let mut buffer = vec![0.0_f32; BLOCK];
    for (array, length) in lengths.iter().enumerate() {
        let mut left = *length;
        while left > 0 {
            let block = &mut buffer[..left.min(BLOCK as u64) as usize];
            input.fill(bytemuck::cast_slice_mut(block))?;
            block.iter_mut().for_each(|x| *x = f32::from_bits(u32::from_le(x.to_bits())));
            sink(array, block);
            left -= block.len() as u64;
        }
    }
    let expected: [u8; DIGEST] = input.hasher.finalize_reset().into();
    let mut found = [0; DIGEST];
    input.fill(&mut found)?;
    if found != expected {
        return Err(CheckpointError::Checksum { part: "contents" });
    }
    Ok(found)
}

/// How long the parts of a checkpoint are.
struct Lengths {
    /// In bytes, as encoded.
    head: u64,
    /// In numbers.
    arrays: Vec<u64>,
}

impl Lengths {
    /// The fixed part of a file whose head has the SHA-256 `digest`.
    fn encode(&self, digest: &[u8; DIGEST]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(FIXED);
        bytes.extend(MAGIC);
        bytes.extend(FORMAT.to_le_bytes());
        bytes.extend((self.arrays.len() as u32).to_le_bytes());
        bytes.extend(self.head.to_le_bytes());
        for slot in 0..MAX_ARRAYS {
            bytes.extend(self.arrays.get(slot).copied().unwrap_or(0).to_le_bytes());
        }
        bytes.extend(digest);
        bytes.extend(Sha256::digest(&bytes));
        bytes
    }

    /// From the fixed part between version and checksum; with the SHA-256 of the head.
    fn decode(bytes: &[u8]) -> Result<(Self, &[u8]), CheckpointError> {
        let claim = |found, rule| Err(CheckpointError::Lengths { found, rule });
        let (number, bytes) = split::<4>(bytes);
        let number = u32::from_le_bytes(number);
        if number as usize > MAX_ARRAYS {
            return claim(format!("{number} arrays"), format!("at most {MAX_ARRAYS}"));
        }
        let (head, mut bytes) = split::<8>(bytes);
        let head = u64::from_le_bytes(head);
        if head > MAX_HEAD as u64 {
            return claim(format!("a head of {head} bytes"), format!("one of at most {MAX_HEAD}"));
        }
        let mut arrays = Vec::with_capacity(number as usize);
        for slot in 0..MAX_ARRAYS {
            let (length, after) = split::<8>(bytes);
            bytes = after;
            match u64::from_le_bytes(length) {
                length if slot < number as usize => arrays.push(length),
                0 => (),
                length => {
                    let found = format!("{length} numbers in array {slot}");
                    return claim(found, format!("none behind its {number} arrays"));
                }
            }
        }
        Ok((Self { head, arrays }, bytes))
    }

    /// Bytes of the whole file.
    fn total(&self) -> Result<u64, CheckpointError> {
        // Cannot overflow: at most 16 · 4 · 2^64 bytes and a head.
        let numbers: u128 = self.arrays.iter().map(|length| u128::from(*length)).sum();
        let total = (FIXED + DIGEST) as u128 + u128::from(self.head) + 4 * numbers;
        u64::try_from(total).map_err(|_| CheckpointError::Lengths {
            found: format!("{total} bytes"),
            rule: format!("at most {}", u64::MAX),
        })
    }
}

/// The first `N` bytes, and the others; there are enough in the fixed part.
fn split<const N: usize>(bytes: &[u8]) -> ([u8; N], &[u8]) {
    let mut first = [0; N];
    let (front, others) = bytes.split_at(N);
    first.copy_from_slice(front);
    (first, others)
}

/// Takes bytes in, hashes them, and knows where it is.
struct HashedReader<'a, R> {
    input: &'a mut R,
    hasher: Sha256,
    /// Bytes taken so far.
    at: u64,
    /// Bytes that there are to be.
    len: u64,
}

impl<'a, R: Read> HashedReader<'a, R> {
    fn new(input: &'a mut R, len: u64) -> Self {
        Self { input, hasher: Sha256::new(), at: 0, len }
    }

    /// An error unless there are to be `expected` bytes.
    fn need(&self, expected: u64) -> Result<(), CheckpointError> {
        if self.len < expected {
            return Err(CheckpointError::CutShort { found: self.len, expected });
        }
        Ok(())
    }

    /// The next bytes, as many as `bytes` has.
    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), CheckpointError> {
        let mut filled = 0;
        while filled < bytes.len() {
            match self.input.read(&mut bytes[filled..]) {
                // The file became shorter while it was read.
                Ok(0) => {
                    let found = self.at + filled as u64;
                    return Err(CheckpointError::CutShort { found, expected: self.len });
                }
                Ok(read) => filled += read,
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) => return Err(CheckpointError::Io(error)),
            }
        }
        self.at += filled as u64;
        self.hasher.update(bytes);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde::Deserialize;

    use super::*;
    use crate::format::numbers::NumberSink;

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    struct Head {
        step: u64,
        kernel: String,
        taps: Vec<(i32, f32)>,
    }

    fn head() -> Head {
        Head { step: 1000, kernel: "gaussian(2.1)".into(), taps: vec![(-1, 0.25), (0, 0.5)] }
    }

    fn bytes(head: &Head, arrays: &[&[f32]]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let lengths: Vec<u64> = arrays.iter().map(|array| array.len() as u64).collect();
        let put = |array: usize, sink: &mut dyn NumberSink| sink.put(arrays[array]);
        write(&mut bytes, head, &lengths, &put).unwrap();
        bytes
    }

    /// A file with everything in it, arrays longer than a block and empty ones included.
    fn example() -> Vec<u8> {
        let long: Vec<f32> = (0..BLOCK + 7).map(|i| i as f32).collect();
        bytes(&head(), &[&[0.5, -0.0], &[], &long])
    }

    type Contents = (Head, Vec<Vec<f32>>);

    fn load(bytes: &[u8]) -> Result<Contents, CheckpointError> {
        read(&mut &*bytes, bytes.len() as u64)
    }

    /// Reads whole arrays.
    fn read<H: DeserializeOwned>(
        input: &mut impl Read,
        len: u64,
    ) -> Result<(H, Vec<Vec<f32>>), CheckpointError> {
        let mut arrays = Vec::new();
        let (head, seal) = read_with(input, len, &mut gather(&mut arrays))?;
        arrays.resize(seal.lengths().len(), Vec::new());
        assert!(arrays.iter().zip(seal.lengths()).all(|(array, &len)| array.len() as u64 == len));
        Ok((head, arrays))
    }

    /// Puts pieces together to arrays, of which the last ones are left out if they are empty.
    fn gather(arrays: &mut Vec<Vec<f32>>) -> impl FnMut(usize, &[f32]) {
        |array, piece| {
            arrays.resize(arrays.len().max(array + 1), Vec::new());
            arrays[array].extend(piece);
        }
    }

    /// Makes the checksum of the lengths right again.
    fn seal(bytes: &mut [u8]) {
        let digest = Sha256::digest(&bytes[..SEALED]);
        bytes[SEALED..FIXED].copy_from_slice(&digest);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            step in any::<u64>(), kernel in ".{0,20}",
            taps in prop::collection::vec((any::<i32>(), -1.0_f32..1.0), 0..20),
            arrays in prop::collection::vec(prop::collection::vec(any::<u32>(), 0..50), 0..=MAX_ARRAYS),
        ) {
            // All bit patterns, those that are not a number included.
            let arrays: Vec<Vec<f32>> = arrays
                .iter()
                .map(|array| array.iter().map(|bits| f32::from_bits(*bits)).collect())
                .collect();
            let slices: Vec<&[f32]> = arrays.iter().map(Vec::as_slice).collect();
            let head = Head { step, kernel, taps };
            let file = bytes(&head, &slices);
            let (head_again, again) = load(&file).unwrap();
            prop_assert_eq!(&head_again, &head);
            let bits = |arrays: &[Vec<f32>]| -> Vec<Vec<u32>> {
                arrays.iter().map(|array| array.iter().map(|x| x.to_bits()).collect()).collect()
            };
            prop_assert_eq!(bits(&again), bits(&arrays));
            let (head_again, lengths): (Head, _) =
                read_head(&mut &*file, file.len() as u64).unwrap();
            prop_assert_eq!(head_again, head);
            let expected: Vec<u64> = arrays.iter().map(|array| array.len() as u64).collect();
            prop_assert_eq!(lengths, expected);
        }
    }

    proptest! {
        #[test]
        fn arrays_in_pieces_make_the_file_that_the_layout_says(
            arrays in prop::collection::vec(prop::collection::vec(any::<u32>(), 0..50), 0..5),
            size in 1_usize..60, wrong in any::<prop::sample::Index>(),
        ) {
            let le = |array: &Vec<u32>| array.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>();
            let encoded = codec::encode(&head()).unwrap();
            let mut expected = [&MAGIC[..], &1_u32.to_le_bytes()].concat();
            expected.extend((arrays.len() as u32).to_le_bytes());
            expected.extend((encoded.len() as u64).to_le_bytes());
            let mut lengths: Vec<u64> = arrays.iter().map(|array| array.len() as u64).collect();
            expected.extend((0..16).flat_map(|i| lengths.get(i).unwrap_or(&0).to_le_bytes()));
            expected.extend(Sha256::digest(&encoded));
            expected.extend(Sha256::digest(&expected));
            expected.extend(&encoded);
            expected.extend(arrays.iter().flat_map(le));
            expected.extend(Sha256::digest(&expected));

            let give = |lengths: &[u64]| {
                let mut bytes = Vec::new();
                let put = |array: usize, sink: &mut dyn NumberSink| {
                    let array: Vec<f32> =
                        arrays[array].iter().map(|bits| f32::from_bits(*bits)).collect();
                    array.chunks(size).try_for_each(|piece| sink.put(piece))
                };
                let result = write(&mut bytes, &head(), lengths, &put);
                result.map(|()| bytes).map_err(|error| error.kind())
            };
            prop_assert_eq!(give(&lengths), Ok(expected));
            if !arrays.is_empty() {
                let wrong = wrong.index(arrays.len());
                lengths[wrong] += 1;
                prop_assert_eq!(give(&lengths), Err(ErrorKind::InvalidData));
                if lengths[wrong] > 1 {
                    lengths[wrong] -= 2;
                    prop_assert_eq!(give(&lengths), Err(ErrorKind::InvalidData));
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn every_change_is_found(
            at in any::<prop::sample::Index>(), to in any::<prop::sample::Index>(),
            length in any::<prop::sample::Index>(), flip in 1_u8.., near in any::<bool>(),
        ) {
            let good = bytes(&head(), &[&[0.5, -0.0, 7.0], &[], &[1.0; 100]]);
            // Half of the places are in the fixed part, which most of the rules are about.
            let at = at.index(if near { FIXED } else { good.len() });

            let mut flipped = good.clone();
            flipped[at] ^= flip;
            prop_assert!(load(&flipped).is_err());
            seal(&mut flipped);
            prop_assert!(flipped == good || load(&flipped).is_err());

            prop_assert!(load(&good[..at]).is_err());
            let shrunk: Result<Contents, _> = read(&mut &good[..at], good.len() as u64);
            let cut_short = matches!(
                shrunk,
                Err(CheckpointError::CutShort { found, .. }) if found == at as u64
            );
            prop_assert!(cut_short);

            let mut extended = good.clone();
            extended.extend(&good[..=at]);
            prop_assert!(load(&extended).is_err());

            let to = to.index(good.len());
            let length = 1 + length.index(good.len() - at.max(to));
            let mut spliced = good.clone();
            spliced.copy_within(at..at + length, to);
            prop_assert!(spliced == good || load(&spliced).is_err());
            spliced.splice(at..at + length, []);
            prop_assert!(load(&spliced).is_err());
        }

        #[test]
        fn lengths_that_lie_are_found_before_anything_is_allocated(
            slot in 0..=MAX_ARRAYS, lie in prop_oneof![any::<u64>(), 0_u64..200, (0..64).prop_map(|bit| 1_u64 << bit)],
            len in prop_oneof![any::<u64>(), Just(u64::MAX), Just(0)],
        ) {
            let good = bytes(&head(), &[&[0.5, -0.0], &[], &[1.0; 100]]);
            let mut liar = good.clone();
            // Slot 0 has the length of the head.
            let field = PREFIX + 4 + 8 * slot;
            liar[field..field + 8].copy_from_slice(&lie.to_le_bytes());
            seal(&mut liar);
            prop_assert!(liar == good || load(&liar).is_err());
            // A file that is as long as it says, but holds nothing there.
            if let Ok((lengths, _)) = Lengths::decode(&liar[PREFIX..SEALED])
                && let Ok(total) = lengths.total()
            {
                let result: Result<Contents, _> = read(&mut &*liar, total);
                prop_assert!(liar == good || result.is_err());
            }
            let result: Result<Contents, _> = read(&mut &*good, len);
            prop_assert!(len == good.len() as u64 || result.is_err());
        }

        #[test]
        fn noise_is_no_checkpoint(noise in prop::collection::vec(any::<u8>(), 0..400), known in 0..3) {
            let mut noise = noise;
            let start: Vec<u8> = MAGIC.iter().copied().chain(FORMAT.to_le_bytes()).collect();
            if known > 0 && noise.len() >= FIXED {
                noise[..PREFIX].copy_from_slice(&start);
            }
            if known > 1 && noise.len() >= FIXED {
                seal(&mut noise);
            }
            prop_assert!(load(&noise).is_err());
        }
    }

    #[test]
    fn errors_say_what_is_wrong() {
        let good = example();
        assert!(load(&good).is_ok());
        let message = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut file = good.clone();
            change(&mut file);
            load(&file).unwrap_err().to_string()
        };
        let set = |place: usize, value: u64| {
            message(&|file| {
                file[place..place + 8].copy_from_slice(&value.to_le_bytes());
                seal(file);
            })
        };
        let n = good.len();
        assert_eq!(message(&|file| file.clear()), "cut short: 0 of 12 bytes");
        assert_eq!(message(&|file| file.truncate(12)), "cut short: 12 of 216 bytes");
        assert_eq!(
            message(&|file| file.truncate(n - 1)),
            format!("cut short: {} of {n} bytes", n - 1)
        );
        assert_eq!(
            message(&|file| file.push(0)),
            format!("too long: {} bytes instead of {n}", n + 1)
        );
        assert!(message(&|file| file[0] = b'x').starts_with("no checkpoint: it begins with the"));
        assert!(message(&|file| file[20] ^= 1).contains("checksum of the lengths does not match"));
        assert!(message(&|file| file[FIXED] ^= 1).contains("checksum of the head does not match"));
        for place in [n - 33, n - 1] {
            let found = message(&|file| file[place] ^= 1);
            assert!(found.contains("checksum of the contents does not match"), "{found}");
        }
        let many = message(&|file| {
            file[PREFIX] = 17;
            seal(file);
        });
        assert!(many.contains("17 arrays, but must have at most 16"), "{many}");
        let behind = set(PREFIX + 12 + 8 * 3, 5);
        assert!(behind.contains("5 numbers in array 3"), "{behind}");
        let long = set(PREFIX + 4, MAX_HEAD as u64 + 1);
        assert!(long.contains("a head of 67108865 bytes"), "{long}");
        let overflow = set(PREFIX + 12, u64::MAX);
        assert!(overflow.contains("but must have at most 18446744073709551615"), "{overflow}");
    }

    #[test]
    fn only_the_same_file_is_read_again() {
        let good = example();
        let len = good.len() as u64;
        let (_, seal): (Head, _) = read_with(&mut &*good, len, &mut |_, _| ()).unwrap();
        assert_eq!(seal.lengths(), [2, 0, BLOCK as u64 + 7]);
        let again = |file: &[u8]| {
            let mut arrays = Vec::new();
            let result = read_again(&mut &*file, &seal, &mut gather(&mut arrays));
            match result {
                Ok(()) => Ok(arrays),
                Err(error) => Err((error.to_string(), arrays)),
            }
        };
        assert_eq!(again(&good).unwrap(), load(&good).unwrap().1);

        // A good one, as long, and one with other arrays.
        let long = vec![1.0; BLOCK + 7];
        let other = bytes(&head(), &[&[0.5, -0.0], &[], &long]);
        assert_eq!((other.len(), load(&other).is_ok()), (good.len(), true));
        assert!(again(&other).unwrap_err().0.contains("the contents does not match"));
        let other = bytes(&head(), &[&[0.5], &[-0.0], &long]);
        let (message, arrays) = again(&other).unwrap_err();
        assert!(message.contains("the lengths does not match") && arrays.is_empty(), "{message}");
        let mut damaged = good.clone();
        damaged[good.len() - 40] ^= 1;
        assert!(again(&damaged).unwrap_err().0.contains("the contents does not match"));
        assert!(again(&good[..good.len() - 1]).unwrap_err().0.contains("cut short"));
    }

    #[test]
    fn another_version_is_named() {
        let mut file = example();
        file[8..12].copy_from_slice(&(FORMAT + 1).to_le_bytes());
        // It may differ in all that follows.
        for length in [PREFIX, FIXED, file.len()] {
            let error = load(&file[..length]).unwrap_err();
            assert!(matches!(error, CheckpointError::Version { found: 2, expected: FORMAT }));
            let message = "the checkpoint has format 2, but this version reads format 1";
            assert_eq!(error.to_string(), message);
        }
    }

    #[test]
    fn a_head_of_another_kind_is_an_error() {
        let file = example();
        let other: Result<(Vec<String>, _), _> = read(&mut &*file, file.len() as u64);
        assert!(matches!(other, Err(CheckpointError::Head(_))));
        let less: Result<(u64, _), _> = read_head(&mut &*file, file.len() as u64);
        assert!(matches!(less, Err(CheckpointError::Head(_))));
    }

    #[test]
    fn a_long_head_of_small_integers_is_read_again() {
        // Each takes one byte in the file and eight in memory, more than the longest head.
        let long = vec![1_u64; MAX_HEAD / 4];
        let mut file = Vec::new();
        let none = &|_: usize, _: &mut dyn NumberSink| Ok(());
        write(&mut file, &long, &[], none).unwrap();
        let (again, _): (Vec<u64>, _) = read(&mut &*file, file.len() as u64).unwrap();
        assert!(again == long);
    }

    #[test]
    fn what_no_reader_would_take_is_not_written() {
        let mut out = Vec::new();
        let none =
            &|_: usize, _: &mut dyn NumberSink| -> io::Result<()> { panic!("nothing is asked") };
        let many = write(&mut out, &head(), &[0; MAX_ARRAYS + 1], none).unwrap_err();
        assert!(many.to_string().contains("17 arrays"));
        let long = write(&mut out, &"x".repeat(MAX_HEAD), &[0], none).unwrap_err();
        assert!(long.to_string().contains("may have 67108864"));
        assert_eq!(many.kind(), ErrorKind::InvalidInput);
        assert_eq!(long.kind(), ErrorKind::InvalidInput);
        assert!(out.is_empty());
    }

    #[test]
    fn failures_of_the_stream_are_passed_on() {
        struct Broken;
        impl Read for Broken {
            fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
                Err(io::Error::other("the disk is gone"))
            }
        }
        let good = example();
        for at in [0, PREFIX, FIXED, FIXED + 10, good.len() - 1] {
            let mut input = good[..at].chain(Broken);
            let result: Result<Contents, _> = read(&mut input, good.len() as u64);
            assert!(matches!(result, Err(CheckpointError::Io(_))), "{at}");
        }
        for room in [0, PREFIX, FIXED, FIXED + 10, good.len() - 1] {
            let mut out = vec![0; room];
            let zeros = &|_: usize, sink: &mut dyn NumberSink| sink.put(&[0.0; 2 * BLOCK]);
            assert!(write(&mut out.as_mut_slice(), &head(), &[2 * BLOCK as u64], zeros).is_err());
        }
        if cfg!(target_os = "linux") {
            let mut full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
            let zero = &|_: usize, sink: &mut dyn NumberSink| sink.put(&[0.0]);
            let error = write(&mut full, &head(), &[1], zero).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::StorageFull);
        }
    }
}
