//! Pieces of memory, and the parts that jobs are given of them.

use std::marker::PhantomData;
use std::ops::{Deref, Range};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use bytemuck::Pod;

use crate::shared::Token;
use crate::shared::map::Map;

/// Cuts memory into sections.
#[derive(Debug)]
pub struct Arena {
    map: Arc<Map>,
    taken: usize,
}

/// Bytes that sections are aligned to: two cache lines, which processors fetch together.
const ALIGNMENT: usize = 128;

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

    /// Gives each job the ranges of it that are its own, in units of `T`.
    ///
    /// # Panics
    /// If ranges overlap or end behind the section.
    pub fn parts<T: Pod>(self, parts: Vec<Vec<Range<usize>>>) -> Parts<T> {
        let mut all: Vec<&Range<usize>> =
            parts.iter().flatten().filter(|r| !r.is_empty()).collect();
        all.sort_unstable_by_key(|range| range.start);
        assert!(all.windows(2).all(|pair| pair[0].end <= pair[1].start), "parts overlap");
        let end = all.last().map_or(0, |range| range.end);
        assert!(end <= self.len / size_of::<T>(), "parts end at {end} of {}", self.len);
        Parts { section: self, parts, of: PhantomData }
    }

    /// Numbers that anyone may read and write.
    pub fn words(self) -> Words {
        Words(self)
    }

    /// Puts bytes of a journal in their place in the map.
    pub(super) fn put(map: &Map, offset: usize, bytes: &[u8]) {
        assert!(offset <= map.len() && bytes.len() <= map.len() - offset);
        // SAFETY: the bytes lie in the map, and `bytes` is another section's. Only the board calls
        // this, for a job whose holder is dead and which nobody can claim before it is done.
        unsafe {
            let to = map.base().add(offset);
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len());
        }
    }

    /// The map that the section is a piece of.
    pub(super) fn map(&self) -> &Map {
        &self.map
    }
}

/// A section that is given to jobs in parts.
#[derive(Debug)]
pub struct Parts<T> {
    section: Section,
    parts: Vec<Vec<Range<usize>>>,
    of: PhantomData<T>,
}

impl<T: Pod> Parts<T> {
    /// All of the section, parts or not.
    pub fn whole(&self) -> &[T] {
        self.section.slice()
    }

    /// All of the section, to be changed.
    pub fn whole_mut(&mut self) -> &mut [T] {
        self.section.slice_mut()
    }

    /// The section, to be given out anew.
    pub fn into_section(self) -> Section {
        self.section
    }
}

/// The ranges of one part.
#[derive(Debug)]
pub struct Part<'a, T> {
    base: *mut T,
    ranges: *const [Range<usize>],
    of: PhantomData<&'a mut [T]>,
}

impl<'a, T: Pod> Part<'a, T> {
    fn ranges(&self) -> &'a [Range<usize>] {
        // SAFETY: they belong to `Parts`, which are borrowed for `'a` and keep them as they are.
        unsafe { &*self.ranges }
    }

    /// One range of it.
    ///
    /// # Panics
    /// If there is no such range.
    pub fn piece(&mut self, index: usize) -> &mut [T] {
        let range = &self.ranges()[index];
        // SAFETY: the range lies in the section (checked by `Section::parts`), the part is the
        // caller's alone (`Shards::part`), and the slice borrows it.
        unsafe { std::slice::from_raw_parts_mut(self.base.add(range.start), range.len()) }
    }

    /// All ranges, in order.
    pub fn pieces(self) -> impl Iterator<Item = &'a mut [T]> {
        let base = self.base;
        self.ranges().iter().map(move |range| {
            // SAFETY: as in `piece`; ranges do not overlap, and the part is given up for them.
            unsafe { std::slice::from_raw_parts_mut(base.add(range.start), range.len()) }
        })
    }
}

/// What jobs are given: the parts of one section, or of several.
pub trait Shards: Sync {
    /// What one job is given. It cannot leave the job's thread.
    type Part;

    /// The part of the job that the token is for.
    fn part(&self, token: Token) -> Self::Part;
}

/// Nothing: the job writes words only.
impl Shards for () {
    type Part = ();

    fn part(&self, _: Token) -> Self::Part {}
}

macro_rules! shards {
    ($($name:ident: $t:ident),+) => {
        impl<'s, $($t: Pod + Send + Sync),+> Shards for ($(&'s mut Parts<$t>,)+) {
            type Part = ($(Part<'s, $t>,)+);

            fn part(&self, token: Token) -> Self::Part {
                let ($($name,)+) = self;
                // Parts are of different sections, so they never overlap. A job has one token
                // (see `Board::claim`), which is given up here, and `Parts` are borrowed for this
                // round alone: what is given here, nobody else has.
                ($(Part {
                    base: $name.section.pointer(),
                    ranges: &raw const *$name.parts[token.job()],
                    of: PhantomData,
                },)+)
            }
        }
    };
}
shards!(a: A);
shards!(a: A, b: B);
shards!(a: A, b: B, c: C);
shards!(a: A, b: B, c: C, d: D);

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

impl Words {
    pub(super) fn map(&self) -> &Map {
        self.0.map()
    }
}
