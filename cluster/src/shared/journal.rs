//! Journals: what memory is to be, or what it was, written down before it is changed.
//!
//! A worker that dies while it changes a unit of a job leaves it half old and half new. Then the
//! journal of its thread has the whole of what is new and puts it in place, or the whole of what
//! was there, and takes the change back.

use bytemuck::{Pod, cast_slice, cast_slice_mut};

use crate::shared::section::{Arena, Section};

/// A journal for each thread of all workers.
#[derive(Debug)]
pub(super) struct Journals {
    section: Section,
    /// Words of a journal.
    words: usize,
}

/// Words at the beginning of a journal: as many as keep what follows aligned to a cache line.
const HEAD: usize = 8;
/// Number of ranges that are written down.
const RANGES: usize = 0;
/// Whether they are what was there.
const REVERTS: usize = 1;
/// Words before the bytes of a range, which say where in the map it lies and how many bytes it has.
/// Those of the first are the last words of the head.
const RANGE_HEAD: usize = 2;

impl Journals {
    /// Bytes of a unit that so many bytes in so many ranges take, as they are written down one by
    /// one; saturating.
    pub fn saved(ranges: usize, bytes: usize) -> usize {
        const WORD: usize = size_of::<u64>();
        ranges.saturating_mul((RANGE_HEAD + 1) * WORD).saturating_add(bytes)
    }

    /// Bytes that journals for units of so many bytes take of an arena; saturating.
    pub fn room(threads: usize, unit: usize) -> usize {
        Arena::room(Self::bytes(threads, unit))
    }

    /// Those of so many threads, unless units have no bytes.
    pub fn new(arena: &mut Arena, threads: usize, unit: usize) -> Option<Self> {
        let section = arena.take(Self::bytes(threads, unit));
        (unit > 0).then(|| Self { section, words: Self::words(unit) })
    }

    fn words(unit: usize) -> usize {
        if unit == 0 { 0 } else { HEAD + unit.div_ceil(64) * 8 }
    }

    fn bytes(threads: usize, unit: usize) -> usize {
        Self::words(unit).saturating_mul(size_of::<u64>()).saturating_mul(threads)
    }

    /// Writes down what a unit is to be, which `make` makes of what it is, and returns that.
    ///
    /// # Panics
    /// If there is no such thread, or the unit is not in the map of the journals or larger than
    /// they are made for.
    ///
    /// # Safety
    /// Nobody else uses the thread's journal until what is returned is given up.
    #[expect(clippy::mut_from_ref, reason = "the caller promises that nobody else has it")]
    pub unsafe fn write(
        &self,
        thread: usize,
        unit: &[f32],
        make: impl FnOnce(&[f32], &mut [f32]),
    ) -> &mut [f32] {
        let offset = self.offset(unit);
        // SAFETY: as the caller promises.
        let (head, data) = unsafe { self.of(thread) }.split_at_mut(HEAD);
        let made = &mut cast_slice_mut(data)[..unit.len()];
        make(unit, made);
        (head[RANGES], head[REVERTS]) = (1, 0);
        (head[HEAD - 2], head[HEAD - 1]) = (offset, size_of_val(unit) as u64);
        made
    }

    /// Begins to write down what is there before it is changed.
    ///
    /// # Panics
    /// If there is no such thread.
    ///
    /// # Safety
    /// Nobody else uses the thread's journal until what is returned is given up.
    pub unsafe fn save(&self, thread: usize) -> Saver<'_> {
        // SAFETY: as the caller promises.
        let journal = unsafe { self.of(thread) };
        (journal[RANGES], journal[REVERTS]) = (0, 1);
        Saver { journals: self, journal, end: HEAD - RANGE_HEAD }
    }

    /// Where memory lies in the map.
    fn offset<T>(&self, range: &[T]) -> u64 {
        let map = self.section.map();
        let offset = range.as_ptr().addr().wrapping_sub(map.base().addr());
        let fits = offset <= map.len() && size_of_val(range) <= map.len() - offset;
        assert!(fits, "a unit of shared memory");
        offset as u64
    }

    /// Puts what is in a thread's journal in place. Returns whether that is what was there before,
    /// so that the unit is to be changed anew.
    ///
    /// # Panics
    /// If there is no such thread, or the journal has nothing that belongs in the map.
    ///
    /// # Safety
    /// The thread died while it changed the unit that it had written down, and nobody else has its
    /// journal, or the part of the unit.
    pub unsafe fn put_in_place(&self, thread: usize) -> bool {
        // SAFETY: as the caller promises.
        let journal = unsafe { self.of(thread) };
        let map = self.section.map();
        let mut next = HEAD - RANGE_HEAD;
        for _ in 0..journal[RANGES] {
            let (offset, bytes) = (journal[next] as usize, journal[next + 1] as usize);
            next += RANGE_HEAD;
            let made = &cast_slice::<_, u8>(&journal[next..])[..bytes];
            assert!(offset <= map.len() && bytes <= map.len() - offset);
            // SAFETY: the bytes lie in the map. They are those of a unit, which lies in parts of
            // other sections, and nobody else has the parts.
            unsafe {
                let to = map.base().add(offset);
                std::ptr::copy_nonoverlapping(made.as_ptr(), to, bytes);
            }
            next += bytes.div_ceil(size_of::<u64>());
        }
        journal[REVERTS] != 0
    }

    /// The journal of a thread.
    ///
    /// # Panics
    /// If there is no such thread.
    ///
    /// # Safety
    /// Nobody else uses it while it is borrowed.
    #[expect(clippy::mut_from_ref, reason = "the caller promises that nobody else has it")]
    unsafe fn of(&self, thread: usize) -> &mut [u64] {
        let end = (thread + 1) * self.words;
        assert!(end <= self.section.len() / size_of::<u64>(), "a journal of thread {thread}");
        let base: *mut u64 = self.section.pointer();
        // SAFETY: the words lie in the section, which lives as long as this; journals of different
        // threads do not overlap, nothing else in this process has the section, and the caller has
        // this journal for itself.
        unsafe { std::slice::from_raw_parts_mut(base.add(end - self.words), self.words) }
    }
}

/// Writes down what is there, range by range.
#[derive(Debug)]
pub struct Saver<'a> {
    journals: &'a Journals,
    journal: &'a mut [u64],
    end: usize,
}

impl Saver<'_> {
    /// Writes down a range that is to be changed.
    ///
    /// # Panics
    /// If it does not lie in the map of the journals, or there is no room.
    pub fn save<T: Pod>(&mut self, range: &mut [T]) {
        let (offset, bytes) = (self.journals.offset(range), size_of_val(range));
        let data = self.end + RANGE_HEAD;
        (self.journal[self.end], self.journal[self.end + 1]) = (offset, bytes as u64);
        let to = &mut cast_slice_mut::<_, u8>(&mut self.journal[data..])[..bytes];
        to.copy_from_slice(cast_slice(range));
        self.end = data + bytes.div_ceil(size_of::<u64>());
        self.journal[RANGES] += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::Map;

    #[test]
    fn what_was_saved_comes_back_and_nothing_else() {
        let mut arena = Arena::new(Map::private(1 << 16).unwrap());
        let journals = Journals::new(&mut arena, 2, Journals::saved(3, 4 * 5 + 3 + 8)).unwrap();
        let mut numbers = arena.take(40);
        let mut bytes = arena.take(3);
        let mut counts = arena.take(8);
        for (i, number) in numbers.slice_mut::<f32>().iter_mut().enumerate() {
            *number = i as f32;
        }
        // SAFETY: there is one thread here.
        let mut saver = unsafe { journals.save(1) };
        saver.save(&mut numbers.slice_mut::<f32>()[2..7]);
        saver.save(&mut bytes.slice_mut::<u8>()[..]);
        saver.save(&mut counts.slice_mut::<u64>()[..]);
        numbers.slice_mut::<f32>().fill(-1.0);
        bytes.slice_mut::<u8>().fill(7);
        counts.slice_mut::<u64>().fill(u64::MAX);
        // SAFETY: as above, and nothing of what was saved is borrowed.
        assert!(unsafe { journals.put_in_place(1) });
        assert_eq!(numbers.slice::<f32>(), [-1.0, -1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0, -1.0, -1.0]);
        assert_eq!((bytes.slice::<u8>(), counts.slice::<u64>()), (&[0; 3][..], &[0][..]));
    }

    #[test]
    fn each_thread_has_a_journal_of_its_own() {
        let mut arena = Arena::new(Map::private(1 << 16).unwrap());
        let journals = Journals::new(&mut arena, 3, 16).unwrap();
        let units = arena.take(3 * 16);
        for (thread, unit) in units.slice::<f32>().chunks(4).enumerate() {
            // SAFETY: there is one thread here, which keeps nothing of what is returned.
            unsafe { journals.write(thread, unit, |_, made| made.fill(thread as f32 + 1.0)) };
        }
        assert!(units.slice::<f32>().iter().all(|&number| number == 0.0));
        // SAFETY: as above; each journal has been written, and nothing of the units is borrowed.
        (0..3).for_each(|thread| assert!(!unsafe { journals.put_in_place(thread) }));
        let expected: Vec<f32> = (0..12).map(|i| (i / 4 + 1) as f32).collect();
        assert_eq!(units.slice::<f32>(), expected);
    }
}
