//! Zeroed memory: of this process alone, or of all processes that map one file.
//!
//! A file begins with a header that says what it is and how long; whoever maps it checks that
//! first. Pages of a process's own memory are huge where the system has them: a draw reads a
//! dozen rows that lie pages apart.

use std::fs::File;
use std::io;
use std::ops::Range;

use memmap2::{MmapMut, MmapRaw};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Zeroed memory.
#[derive(Debug)]
pub struct Map {
    raw: MmapRaw,
    /// Where the memory behind the header begins.
    start: usize,
    len: usize,
    /// Whether it is a file's.
    shared: bool,
}

/// Why memory cannot be had.
#[derive(Debug, Error)]
pub enum MapError {
    /// The system refuses it.
    #[error("{bytes} bytes of shared memory cannot be had: {error}")]
    System {
        /// How many were asked for.
        bytes: usize,
        /// What the system says.
        error: io::Error,
    },
    /// The file is not what it should be.
    #[error("the shared memory is not that of this run: {0}")]
    Header(&'static str),
}

/// What a file of shared memory begins with: a page of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Bytes behind the header.
    pub len: u64,
    /// A number that all processes of a run know, and no other's.
    pub run: u64,
}

impl Header {
    /// Bytes from the beginning of a file to what is behind the header.
    pub const BYTES: usize = 4096;
    const MAGIC: [u8; 8] = *b"PRCPTSHM";
    const VERSION: u64 = 1;

    fn to_bytes(self) -> [u8; 40] {
        let mut bytes = [0; 40];
        bytes[..8].copy_from_slice(&Self::MAGIC);
        bytes[8..16].copy_from_slice(&Self::VERSION.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.len.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.run.to_le_bytes());
        let sum = checksum(&bytes[..32]);
        bytes[32..].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8; 40]) -> Result<Self, MapError> {
        let word = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("8 bytes"));
        if bytes[..8] != Self::MAGIC {
            return Err(MapError::Header("it does not begin as shared memory does"));
        }
        if word(32) != checksum(&bytes[..32]) {
            return Err(MapError::Header("the checksum of its header does not match"));
        }
        if word(8) != Self::VERSION {
            return Err(MapError::Header("its header is of another version"));
        }
        Ok(Self { len: word(16), run: word(24) })
    }
}

/// FNV-1a of 64 bits.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, &byte| {
        (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

impl Map {
    /// Memory of this process alone.
    ///
    /// # Errors
    /// If the system does not give it.
    pub fn private(len: usize) -> Result<Self, MapError> {
        let map = MmapMut::map_anon(len.max(1))
            .map_err(|error| MapError::System { bytes: len, error })?;
        // Only a hint: without huge pages everything works as well, if slower.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::HugePage);
        Ok(Self { raw: map.into(), start: 0, len, shared: false })
    }

    /// Makes an empty file one of shared memory and maps it.
    ///
    /// All of it is allocated now: a full disk is an error here, not a crash later.
    ///
    /// # Errors
    /// If the system does not give as much.
    pub fn create(file: &File, header: Header) -> Result<Self, MapError> {
        let bytes = usize::try_from(header.len)
            .ok()
            .and_then(|len| len.checked_add(Header::BYTES))
            .unwrap_or(usize::MAX);
        let system = |error| MapError::System { bytes, error };
        reserve(file, bytes).map_err(system)?;
        write_head(file, &header.to_bytes()).map_err(system)?;
        Self::open(file, header)
    }

    /// Maps a file of shared memory that somebody else made.
    ///
    /// # Errors
    /// A file that is something else, shorter than it says, or of another run.
    pub fn open(file: &File, expected: Header) -> Result<Self, MapError> {
        let system = |error| MapError::System { bytes: expected.len as usize, error };
        let bytes = read_head(file).map_err(|_| MapError::Header("it has no header"))?;
        let header = Header::from_bytes(&bytes)?;
        if header != expected {
            return Err(MapError::Header("its header tells of another run"));
        }
        let len = usize::try_from(header.len)
            .map_err(|_| MapError::Header("it is larger than memory can be"))?;
        let size = file.metadata().map_err(system)?.len();
        if size.checked_sub(Header::BYTES as u64) != Some(header.len) {
            return Err(MapError::Header("its size is not what its header says"));
        }
        let raw = MmapRaw::map_raw(file).map_err(system)?;
        Ok(Self { raw, start: Header::BYTES, len, shared: true })
    }

    /// Bytes behind the header.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Gives whole pages of some bytes back to the system, as far as it takes them; they are zeros
    /// if somebody looks at them again.
    pub(super) fn discard(&self, start: usize, len: usize) {
        #[cfg(target_os = "linux")]
        {
            use memmap2::UncheckedAdvice;
            let page = rustix::param::page_size();
            let first = (self.start + start).next_multiple_of(page);
            let end = (self.start + start + len) / page * page;
            let advice =
                if self.shared { UncheckedAdvice::Remove } else { UncheckedAdvice::DontNeed };
            if first < end {
                // SAFETY: the pages lie in a section (`Section::discard` gives it up, so that no
                // reference into it is left in this process), and zeros are a value of all that
                // sections hold. Refused, it does nothing.
                let _ = unsafe { self.raw.unchecked_advise_range(advice, first, end - first) };
            }
        }
        #[cfg(not(target_os = "linux"))]
        let _ = (start, len);
    }

    /// The first byte behind the header; it is aligned to a page.
    pub(super) fn base(&self) -> *mut u8 {
        self.raw.as_mut_ptr().wrapping_add(self.start)
    }
}

/// Reads the first bytes of a file. Its position, which processes share, stays where it is.
fn read_head(file: &File) -> io::Result<[u8; 40]> {
    let mut bytes = [0; 40];
    #[cfg(unix)]
    std::os::unix::fs::FileExt::read_exact_at(file, &mut bytes, 0)?;
    #[cfg(not(unix))]
    {
        use std::io::{Read, Seek};
        (&*file).rewind()?;
        (&*file).read_exact(&mut bytes)?;
    }
    Ok(bytes)
}

/// Writes the first bytes of a file.
fn write_head(file: &File, bytes: &[u8; 40]) -> io::Result<()> {
    #[cfg(unix)]
    std::os::unix::fs::FileExt::write_all_at(file, bytes, 0)?;
    #[cfg(not(unix))]
    {
        use std::io::{Seek, Write};
        (&*file).rewind()?;
        (&*file).write_all(bytes)?;
    }
    Ok(())
}

/// Allocates some ranges of the bytes behind the header of a file that is to be made, by the
/// calling thread: memory lies near whoever has it allocated. Where the system cannot do that
/// ahead of use, nothing happens.
///
/// # Errors
/// If the system does not give as much.
pub fn allocate(file: &File, header: Header, ranges: &[Range<usize>]) -> Result<(), MapError> {
    let bytes = header.len as usize;
    #[cfg(target_os = "linux")]
    for range in ranges.iter().filter(|range| !range.is_empty()) {
        use rustix::fs::{FallocateFlags, fallocate};
        let start = (Header::BYTES + range.start) as u64;
        match fallocate(file, FallocateFlags::empty(), start, range.len() as u64) {
            Ok(()) | Err(rustix::io::Errno::OPNOTSUPP) => (),
            Err(error) => return Err(MapError::System { bytes, error: error.into() }),
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, ranges, bytes);
    Ok(())
}

/// Gives a file its size, with all of it allocated where the system can.
fn reserve(file: &File, bytes: usize) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{FallocateFlags, fallocate};
        match fallocate(file, FallocateFlags::empty(), 0, bytes as u64) {
            // A file system that cannot allocate ahead.
            Err(rustix::io::Errno::OPNOTSUPP) => (),
            done => return Ok(done?),
        }
    }
    file.set_len(bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: Header = Header { len: 10_000, run: 77 };

    #[test]
    fn what_one_map_of_a_file_holds_another_sees() {
        let file = tempfile::tempfile().unwrap();
        let one = Map::create(&file, HEADER).unwrap();
        let other = Map::open(&file, HEADER).unwrap();
        assert_eq!((one.len(), other.len()), (10_000, 10_000));
        assert_ne!(one.base(), other.base());
        let mut one = crate::shared::Arena::new(one);
        let mut section = one.take(100);
        section.slice_mut::<u32>()[7] = 5;
        let other = crate::shared::Arena::new(other).take(100);
        assert_eq!(other.slice::<u32>()[6..9], [0, 5, 0]);
    }

    #[test]
    fn a_header_that_lies_is_refused() {
        let spoil = |spoil: &dyn Fn(&File)| {
            let file = tempfile::tempfile().unwrap();
            Map::create(&file, HEADER).unwrap();
            spoil(&file);
            Map::open(&file, HEADER).unwrap_err().to_string()
        };
        let put = |at: u64, bytes: &[u8], mut file: &File| {
            use std::io::{Seek, SeekFrom, Write};
            file.seek(SeekFrom::Start(at)).unwrap();
            file.write_all(bytes).unwrap();
        };
        for at in 0..40 {
            let message = spoil(&|file| put(at, &[0xaa], file));
            assert!(message.contains("begin") || message.contains("checksum"), "{at}: {message}");
        }
        let rewrite = |len, run| spoil(&|file| put(0, &Header { len, run }.to_bytes(), file));
        assert!(rewrite(10_000, 78).contains("another run"));
        assert!(rewrite(u64::MAX, 77).contains("another run"));
        assert!(spoil(&|file| file.set_len(9000).unwrap()).contains("size"));
        assert!(spoil(&|file| file.set_len(20).unwrap()).contains("no header"));
        assert!(spoil(&|file| file.set_len(1 << 20).unwrap()).contains("size"));
    }

    #[test]
    fn discarded_pages_are_zeros_and_their_neighbours_stay() {
        let file = tempfile::tempfile().unwrap();
        let header = Header { len: 100_000, run: 1 };
        for map in [Map::private(100_000).unwrap(), Map::create(&file, header).unwrap()] {
            let mut arena = crate::shared::Arena::new(map);
            let mut sections = [(); 3].map(|()| arena.take(30_000));
            sections.iter_mut().for_each(|section| section.slice_mut::<u8>().fill(7));
            let [before, middle, after] = sections;
            middle.discard();
            assert!(before.slice::<u8>().iter().chain(after.slice()).all(|&byte| byte == 7));
        }
    }

    #[test]
    fn more_than_there_is_is_an_error() {
        let file = tempfile::tempfile().unwrap();
        let error = Map::create(&file, Header { len: 1 << 60, run: 1 }).unwrap_err();
        assert!(error.to_string().contains("cannot be had"), "{error}");
        assert!(Map::create(&file, Header { len: u64::MAX, run: 1 }).is_err());
    }
}
