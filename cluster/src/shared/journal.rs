//! Journals: what a unit of a job is to be, written down before the unit is changed.
//!
//! A worker that dies while it changes a unit leaves it half old and half new. Then the journal of
//! its thread has the whole of what is new, and where it belongs.

use bytemuck::{cast_slice, cast_slice_mut};

use crate::shared::section::{Arena, Section};

/// A journal for each thread of all workers.
#[derive(Debug)]
pub(super) struct Journals {
    section: Section,
    /// Words of a journal.
    words: usize,
}

/// Words at the beginning of a journal, which say where in the map its unit belongs and how many
/// bytes of it there are: as many as keep what follows aligned to a cache line.
const HEAD: usize = 8;

impl Journals {
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
        let map = self.section.map();
        let offset = unit.as_ptr().addr().wrapping_sub(map.base().addr());
        assert!(offset <= map.len(), "a unit of shared memory");
        // SAFETY: as the caller promises.
        let (head, data) = unsafe { self.of(thread) }.split_at_mut(HEAD);
        let made = &mut cast_slice_mut(data)[..unit.len()];
        make(unit, made);
        (head[0], head[1]) = (offset as u64, size_of_val(unit) as u64);
        made
    }

    /// Puts what is in a thread's journal in place.
    ///
    /// # Panics
    /// If there is no such thread, or the journal has nothing that belongs in the map.
    ///
    /// # Safety
    /// The thread died while it changed the unit that it had written down, and nobody else has its
    /// journal, or the part of the unit.
    pub unsafe fn put_in_place(&self, thread: usize) {
        // SAFETY: as the caller promises.
        let (head, data) = unsafe { self.of(thread) }.split_at(HEAD);
        let (offset, made) = (head[0] as usize, &cast_slice::<_, u8>(data)[..head[1] as usize]);
        let map = self.section.map();
        assert!(offset <= map.len() && made.len() <= map.len() - offset);
        // SAFETY: the bytes lie in the map. They are those of a unit, which lies in a part of
        // another section, and nobody else has the part.
        unsafe {
            let to = map.base().add(offset);
            std::ptr::copy_nonoverlapping(made.as_ptr(), to, made.len());
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::Map;

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
        (0..3).for_each(|thread| unsafe { journals.put_in_place(thread) });
        let expected: Vec<f32> = (0..12).map(|i| (i / 4 + 1) as f32).collect();
        assert_eq!(units.slice::<f32>(), expected);
    }
}
