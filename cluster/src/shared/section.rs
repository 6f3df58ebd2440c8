//! Pieces of memory that nobody else in this process has.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use bytemuck::Pod;

use crate::shared::map::Map;

/// Cuts memory into sections.
#[derive(Debug)]
pub struct Arena {
    map: Arc<Map>,
    taken: usize,
}

/// Bytes that sections are aligned to: two cache lines, which processors fetch together.
const ALIGNMENT: usize = 128;

/// Words of as many bytes. What different threads write to stands so far apart.
pub(super) const LINE: usize = ALIGNMENT / size_of::<u64>();

impl Arena {
    /// An arena of all of a map.
    pub fn new(map: Map) -> Self {
        Self { map: Arc::new(map), taken: 0 }
    }

    /// Bytes that a section of `bytes` takes of an arena; saturating.
    pub fn room(bytes: usize) -> usize {
        bytes.div_ceil(ALIGNMENT).saturating_mul(ALIGNMENT)
    }

    /// The next `bytes`, which are nobody else's.
    ///
    /// # Panics
    /// If there are not as many left.
    pub fn take(&mut self, bytes: usize) -> Section {
        let start = self.taken;
        let room = Self::room(bytes);
        assert!(room <= self.map.len() - start, "{bytes} bytes of {}", self.map.len() - start);
        self.taken += room;
        Section { map: Arc::clone(&self.map), start, len: bytes }
    }
}

/// Bytes that nobody else in this process has.
///
/// In other processes somebody has them too. Whoever reads or writes a section as a whole does so
/// while no round is under way, or while it holds a claim of a round that does not change them.
#[derive(Debug)]
pub struct Section {
    map: Arc<Map>,
    start: usize,
    len: usize,
}

impl Section {
    /// Number of bytes.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// All of it.
    pub fn slice<T: Pod>(&self) -> &[T] {
        let len = self.len / size_of::<T>();
        // SAFETY: the bytes lie in the map, which lives as long as the section; `T` is aligned
        // (sections are to 128 bytes, and no `Pod` that is used is to more, see `pointer`) and
        // any bits are one. Sections do not overlap and the slice borrows this one, so nobody in
        // this process changes them; between processes the rule of the room holds.
        unsafe { std::slice::from_raw_parts(self.pointer(), len) }
    }

    /// All of it, to be changed.
    pub fn slice_mut<T: Pod>(&mut self) -> &mut [T] {
        let len = self.len / size_of::<T>();
        // SAFETY: as in `slice`, and borrowed for this slice alone.
        unsafe { std::slice::from_raw_parts_mut(self.pointer(), len) }
    }

    pub(super) fn pointer<T: Pod>(&self) -> *mut T {
        const { assert!(align_of::<T>() <= ALIGNMENT && size_of::<T>() > 0) };
        self.map.base().wrapping_add(self.start).cast()
    }

    /// Gives its memory back to the system, in all processes that share it: nobody is to look at
    /// it any more.
    pub fn discard(self) {
        self.map.discard(self.start, self.len);
    }

    /// Numbers that anyone may read and write.
    pub fn words(self) -> Words {
        Words(self)
    }

    /// The map that the section is a piece of.
    pub(super) fn map(&self) -> &Map {
        &self.map
    }
}

/// Numbers that anyone may read and write at any time.
#[derive(Debug)]
pub struct Words(Section);

impl Deref for Words {
    type Target = [AtomicU64];

    fn deref(&self) -> &[AtomicU64] {
        let len = self.0.len / size_of::<AtomicU64>();
        // SAFETY: as in `Section::slice`; atomic words may be shared by everyone, and the section
        // is never a slice of something else (`Section::words` gave it up).
        unsafe { std::slice::from_raw_parts(self.0.pointer::<u64>().cast(), len) }
    }
}
