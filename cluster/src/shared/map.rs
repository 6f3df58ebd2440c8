//! Zeroed memory: of this process alone, or of all processes that map one file.
//!
//! A file begins with a header that says what it is and how long; whoever maps it checks that
//! first. Pages of a process's own memory are huge where the system has them: a draw reads a
//! dozen rows that lie pages apart.

use std::fs::File;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

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
    /// The system has no memory for this process.
    #[error("{bytes} bytes of memory cannot be had: {error}")]
    NoMemory {
        /// How many were asked for.
        bytes: usize,
        /// What the system says.
        error: io::Error,
    },
    /// Where the file of shared memory lies there is no space left, or a limit for files.
    #[error("{bytes} bytes of shared memory cannot be had in {}: {error}", folder.display())]
    NoSpace {
        /// How many were asked for.
        bytes: usize,
        /// Where the file lies.
        folder: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The system refuses the file of shared memory for another reason.
    #[error("{bytes} bytes of shared memory cannot be had in {}: {error}", folder.display())]
    File {
        /// How many were asked for.
        bytes: usize,
        /// Where the file lies.
        folder: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The file is not what it should be.
    #[error("the shared memory is not that of this run: {0}")]
    Header(&'static str),
}

impl MapError {
    /// What it means that a file of `bytes` in a folder is refused.
    fn of_file(bytes: usize, folder: &Path, error: io::Error) -> Self {
        use io::ErrorKind::{FileTooLarge, OutOfMemory, QuotaExceeded, StorageFull};
        let folder = folder.to_owned();
        match error.kind() {
            StorageFull | QuotaExceeded | FileTooLarge => Self::NoSpace { bytes, folder, error },
            // The folder may be in memory, of which there is too little for what it may hold.
            OutOfMemory => Self::NoMemory { bytes, error },
            _ => Self::File { bytes, folder, error },
        }
    }
}

/// What a file of shared memory begins with: a page of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapHeader {
    /// Bytes behind the header.
    pub len: u64,
    /// A number that all processes of a run know, and no other's.
    pub run: u64,
}

impl MapHeader {
    /// Bytes from the beginning of a file to what is behind the header.
    pub const BYTES: usize = 4096;
    const MAGIC: [u8; 8] = *b"PRCPTSHM";
    const VERSION: u64 = 1;

    /// The header of so many bytes of a new run.
    pub fn new(len: u64) -> Self {
        Self { len, run: RandomState::new().hash_one(len) }
    }

    /// Bytes of the file; saturating.
    fn file_len(self) -> usize {
        usize::try_from(self.len).unwrap_or(usize::MAX).saturating_add(Self::BYTES)
    }

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
            .map_err(|error| MapError::NoMemory { bytes: len, error })?;
        // Only a hint: without huge pages everything works as well, if slower.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::HugePage);
        Ok(Self { raw: map.into(), start: 0, len, shared: false })
    }

    /// Makes an empty file in a folder one of shared memory and maps it. The file needs no name:
    /// the folder is for the error.
    ///
    /// All of it is allocated now: a full disk is an error here, not a crash later.
    ///
    /// # Errors
    /// If the system does not give as much.
    pub fn create(file: &File, folder: &Path, header: MapHeader) -> Result<Self, MapError> {
        let refused = |error| MapError::of_file(header.file_len(), folder, error);
        reserve(file, header.file_len()).map_err(refused)?;
        write_head(file, &header.to_bytes()).map_err(refused)?;
        Self::open(file, header)
    }

    /// Maps a file of shared memory that somebody else made.
    ///
    /// # Errors
    /// A file that is something else, shorter than it says, or of another run, and a system that
    /// does not map it.
    pub fn open(file: &File, expected: MapHeader) -> Result<Self, MapError> {
        let refused = |error| MapError::NoMemory { bytes: expected.file_len(), error };
        let bytes = read_head(file).map_err(|_| MapError::Header("it has no header"))?;
        let header = MapHeader::from_bytes(&bytes)?;
        if header != expected {
            return Err(MapError::Header("its header is that of another run"));
        }
        let len = usize::try_from(header.len)
            .map_err(|_| MapError::Header("it is larger than memory can be"))?;
        let size = file.metadata().map_err(|_| MapError::Header("its size cannot be read"))?;
        if size.len().checked_sub(MapHeader::BYTES as u64) != Some(header.len) {
            return Err(MapError::Header("its size is not what its header says"));
        }
        let raw = MmapRaw::map_raw(file).map_err(refused)?;
        Ok(Self { raw, start: MapHeader::BYTES, len, shared: true })
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

/// Allocates some ranges of the bytes behind the header of a file in a folder, before
/// [`Map::create`], by the calling thread: memory lies near whoever has it allocated. Where the
/// system cannot do that ahead of use, nothing happens.
///
/// # Errors
/// If the system does not give as much.
pub fn allocate(
    file: &File,
    folder: &Path,
    header: MapHeader,
    ranges: &[Range<usize>],
) -> Result<(), MapError> {
    #[cfg(target_os = "linux")]
    for range in ranges.iter().filter(|range| !range.is_empty()) {
        use rustix::fs::{FallocateFlags, fallocate};
        let start = (MapHeader::BYTES + range.start) as u64;
        match fallocate(file, FallocateFlags::empty(), start, range.len() as u64) {
            Ok(()) | Err(rustix::io::Errno::OPNOTSUPP) => (),
            Err(error) => return Err(MapError::of_file(header.file_len(), folder, error.into())),
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, folder, header, ranges);
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

    const HEADER: MapHeader = MapHeader { len: 10_000, run: 77 };

    /// A file without a name, and where it lies.
    fn file() -> (File, PathBuf) {
        let folder = std::env::temp_dir();
        (tempfile::tempfile_in(&folder).unwrap(), folder)
    }

    #[test]
    fn what_one_map_of_a_file_holds_another_sees() {
        let (file, folder) = file();
        let one = Map::create(&file, &folder, HEADER).unwrap();
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
            let (file, folder) = file();
            Map::create(&file, &folder, HEADER).unwrap();
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
        let rewrite = |len, run| spoil(&|file| put(0, &MapHeader { len, run }.to_bytes(), file));
        assert!(rewrite(10_000, 78).contains("another run"));
        assert!(rewrite(u64::MAX, 77).contains("another run"));
        assert!(spoil(&|file| file.set_len(9000).unwrap()).contains("size"));
        assert!(spoil(&|file| file.set_len(20).unwrap()).contains("no header"));
        assert!(spoil(&|file| file.set_len(1 << 20).unwrap()).contains("size"));
    }

    #[test]
    fn discarded_pages_are_zeros_and_their_neighbours_stay() {
        let (file, folder) = file();
        let header = MapHeader { len: 100_000, run: 1 };
        for map in [Map::private(100_000).unwrap(), Map::create(&file, &folder, header).unwrap()] {
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
        let (file, folder) = file();
        let header = MapHeader { len: 1 << 60, run: 1 };
        let error = Map::create(&file, &folder, header).unwrap_err();
        let start = format!(
            "1152921504606851072 bytes of shared memory cannot be had in {}: ",
            folder.display()
        );
        assert!(error.to_string().starts_with(&start), "{error}");
        let header = MapHeader { len: u64::MAX, run: 1 };
        assert!(Map::create(&file, &folder, header).is_err());
        let error = Map::private(1 << 60).unwrap_err();
        assert!(matches!(error, MapError::NoMemory { .. }), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn a_full_disk_is_not_too_little_memory() {
        use rustix::io::Errno;
        let refused = |errno: Errno| MapError::of_file(4096, Path::new("/dev/shm"), errno.into());
        for errno in [Errno::NOSPC, Errno::DQUOT, Errno::FBIG] {
            let error = refused(errno);
            assert!(matches!(error, MapError::NoSpace { .. }), "{error:?}");
        }
        assert_eq!(
            refused(Errno::NOSPC).to_string(),
            "4096 bytes of shared memory cannot be had in /dev/shm: \
             No space left on device (os error 28)"
        );
        assert!(matches!(refused(Errno::NOMEM), MapError::NoMemory { .. }));
        assert!(matches!(refused(Errno::IO), MapError::File { .. }));
    }

    /// More than a file system in memory has is found when the file is made.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_folder_is_named() {
        const TMPFS: rustix::fs::FsWord = 0x0102_1994;
        let folder = Path::new("/dev/shm");
        // Elsewhere it may be a folder of a disk, or have no limit.
        let Some(system) = rustix::fs::statfs(folder)
            .ok()
            .filter(|system| system.f_type == TMPFS && system.f_blocks > 0)
        else {
            return;
        };
        let bytes = system.f_blocks * system.f_bsize as u64 + (1 << 20);
        let file = tempfile::tempfile_in(folder).unwrap();
        let header = MapHeader { len: bytes, run: 1 };
        for error in [
            Map::create(&file, folder, header).unwrap_err(),
            allocate(&file, folder, header, std::slice::from_ref(&(0..bytes as usize)))
                .unwrap_err(),
        ] {
            let full = matches!(&error, MapError::NoSpace { folder: at, .. } if at == folder);
            assert!(full, "{error:?}");
        }
    }
}
