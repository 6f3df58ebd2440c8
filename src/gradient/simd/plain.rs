//! The instruction set that every machine has: the plain twin of the others.

use super::{Isa, SORT_BLOCK};

/// No instructions but those that the program was compiled for.
#[derive(Debug, Clone, Copy)]
pub struct Plain;

impl Isa for Plain {
    #[inline(always)]
    fn sort(self, keys: &mut [u32]) {
        assert!(keys.len().is_multiple_of(SORT_BLOCK));
        keys.sort_unstable();
    }

    #[inline(always)]
    fn prefetch<T>(self, _: &[T], _: usize) {}
}
