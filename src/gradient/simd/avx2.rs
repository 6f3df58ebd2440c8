//! The copy of every inner loop that is compiled for AVX2.

use super::Vectorized;

/// Runs an operation with AVX2, into which its `#[inline(always)]` body is compiled.
#[target_feature(enable = "avx2")]
pub(super) fn run<V: Vectorized>(operation: V) -> V::Output {
    operation.run()
}
