//! Chooses the instruction set that the inner loops are compiled for.
//!
//! A loop is written once, in safe code, as a [`Vectorized`] operation, and compiled twice: for
//! the plain target and for AVX2. Both do the same IEEE operations in the same order (no fused
//! multiply-add, no approximate reciprocals), so they give the same bytes; which one runs is
//! found out at run time.

#[cfg(target_arch = "x86_64")]
mod avx2;

/// An operation on slices that gains from wide registers.
///
/// Implementations must mark [`Self::run`] `#[inline(always)]`, as well as what it calls, or they
/// are compiled for the plain target only.
pub trait Vectorized {
    /// What it returns.
    type Output;

    /// Does the work.
    fn run(self) -> Self::Output;
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
            Level::Plain => operation.run(),
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
