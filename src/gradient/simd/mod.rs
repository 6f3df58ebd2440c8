//! Chooses the instruction set that the inner loops are compiled for.
//!
//! A loop is written once, in safe code, as a [`Vectorized`] operation, and compiled twice: for
//! the plain target and for AVX2. Both do the same IEEE operations in the same order (no fused
//! multiply-add, no approximate reciprocals), so they give the same bytes; which one runs is
//! found out at run time. What the compiler does not find by itself is asked of the [`Isa`],
//! whose plain twin has the same answer.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod plain;

pub use plain::Plain;

/// Keys that [`Isa::sort`] sorts at a time.
pub const SORT_BLOCK: usize = 64;

/// What instruction sets do differently.
pub trait Isa: Copy {
    /// Sorts keys in rising order.
    ///
    /// # Panics
    /// If their number is no multiple of [`SORT_BLOCK`].
    fn sort(self, keys: &mut [u32]);

    /// Asks for the cache line of an element that will be needed soon; of no effect where there
    /// is none.
    fn prefetch<T>(self, slice: &[T], index: usize);
}

/// An operation on slices that gains from wide registers.
///
/// Implementations must mark [`Self::run`] `#[inline(always)]`, as well as what it calls, or they
/// are compiled for the plain target only.
pub trait Vectorized {
    /// What it returns.
    type Output;

    /// Does the work with an instruction set.
    fn run<I: Isa>(self, isa: I) -> Self::Output;
}

/// An instruction set that this machine has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Simd(Level);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Level {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Simd {
    /// The best one for this machine.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self(Level::Avx2);
        }
        Self::plain()
    }

    /// The one that every machine has.
    pub fn plain() -> Self {
        Self(Level::Plain)
    }

    /// Its name: `plain` or `avx2`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Level::Plain => "plain",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => "avx2",
        }
    }

    /// Runs an operation with it.
    #[inline]
    pub fn run<V: Vectorized>(self, operation: V) -> V::Output {
        match self.0 {
            Level::Plain => operation.run(Plain),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => {
                // SAFETY: `Level::Avx2` is private to this file and made only in `detect`, after
                // the processor was found to have AVX2, the one feature that `avx2::run` needs.
                #[allow(unsafe_code)]
                unsafe {
                    avx2::run(operation)
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Sort<'a>(&'a mut [u32]);

    impl Vectorized for Sort<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self, isa: I) {
            isa.sort(self.0);
        }
    }

    proptest! {
        #[test]
        fn keys_are_sorted_by_every_instruction_set(
            blocks in 0_usize..40, few: bool, seed: u64,
        ) {
            let mut stream = crate::draw::Stream::new(seed, crate::draw::Use::Baseline, 0, 0);
            let keys: Vec<u32> = (0..blocks * SORT_BLOCK)
                .map(|_| if few { stream.below(5) } else { stream.word() })
                .collect();
            let mut expected = keys.clone();
            expected.sort();
            for simd in [Simd::detect(), Simd::plain()] {
                let mut found = keys.clone();
                simd.run(Sort(&mut found));
                prop_assert_eq!(&found, &expected, "{}", simd.name());
            }
        }
    }
}
