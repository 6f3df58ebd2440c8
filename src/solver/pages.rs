//! Memory for what every step touches, in huge pages where the system has them.
//!
//! A draw reads a dozen rows that lie pages apart. With pages of 4 KB the samples, moments and
//! patches of a tile outgrow the processor's table of pages, and every miss there costs a walk
//! through memory (two nested ones in a virtual machine); with pages of 2 MB they never do.

use std::ops::{Deref, DerefMut};

use bytemuck::Pod;
use memmap2::MmapMut;

/// A slice of zeros to begin with, on pages of its own.
#[derive(Debug)]
pub struct Pages<T> {
    memory: Memory<T>,
    len: usize,
}

#[derive(Debug)]
enum Memory<T> {
    Map(MmapMut),
    /// Where nothing can be mapped.
    Heap(Vec<T>),
}

impl<T: Pod> Pages<T> {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let map = || {
            let map = MmapMut::map_anon(len.checked_mul(size_of::<T>())?.max(1)).ok()?;
            // Only a hint: without huge pages everything works as well, if slower.
            #[cfg(target_os = "linux")]
            let _ = map.advise(memmap2::Advice::HugePage);
            Some(Memory::Map(map))
        };
        let memory = map().unwrap_or_else(|| Memory::Heap(vec![T::zeroed(); len]));
        Self { memory, len }
    }
}

impl<T: Pod> Deref for Pages<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.memory {
            Memory::Map(map) => bytemuck::cast_slice(&map[..self.len * size_of::<T>()]),
            Memory::Heap(words) => words,
        }
    }
}

impl<T: Pod> DerefMut for Pages<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.memory {
            Memory::Map(map) => bytemuck::cast_slice_mut(&mut map[..self.len * size_of::<T>()]),
            Memory::Heap(words) => words,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_slices_of_zeros() {
        for len in [0, 1, 1000, 3 << 20] {
            let mut pages = Pages::<i32>::zeros(len);
            assert_eq!(pages.len(), len);
            assert!(pages.iter().all(|&x| x == 0));
            pages.fill(7);
            assert_eq!(pages.iter().map(|&x| i64::from(x)).sum::<i64>(), 7 * len as i64);
        }
    }
}
