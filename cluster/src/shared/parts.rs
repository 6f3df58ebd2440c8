//! What jobs are given of a section: parts, each to the job that it belongs to.

use std::marker::PhantomData;
use std::ops::Range;

use bytemuck::Pod;

use crate::shared::job::Token;
use crate::shared::section::Section;

impl Section {
    /// Gives each job the ranges of it that are its own, in units of `T`.
    ///
    /// # Panics
    /// If ranges overlap or end behind the section.
    pub fn parts<T: Pod>(self, parts: Vec<Vec<Range<usize>>>) -> Parts<T> {
        let mut dealt = Parts { section: self, parts: Vec::new(), of: PhantomData };
        dealt.deal(parts);
        dealt
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

    /// Gives jobs other ranges from now on.
    ///
    /// # Panics
    /// If ranges overlap or end behind the section.
    pub fn deal(&mut self, parts: Vec<Vec<Range<usize>>>) {
        let mut all: Vec<&Range<usize>> =
            parts.iter().flatten().filter(|r| !r.is_empty()).collect();
        all.sort_unstable_by_key(|range| range.start);
        assert!(all.windows(2).all(|pair| pair[0].end <= pair[1].start), "parts overlap");
        let (end, len) = (all.last().map_or(0, |range| range.end), self.section.len());
        assert!(end <= len / size_of::<T>(), "parts end at {end} of {len}");
        self.parts = parts;
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
