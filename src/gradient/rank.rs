//! Ranks of projected samples: the sorting step of one-dimensional optimal transport.
//!
//! Sorting moves one word for each sample: the place of its projection among equal steps along
//! the direction in the high bits, its position in the subset in the low ones, so that all keys
//! differ and equal places are in order of position. The steps are so fine (2⁻²³ of the
//! direction's length up to 512 samples, a sixteenth of the mean distance of two samples at the
//! most, where they are even) that what falls into one of them is as good as equal.

use super::simd::{Isa, SORT_BLOCK};

/// Bits of a key.
const BITS: u32 = u32::BITS;
/// Most bits of a place: as many as an f32 between 2²³ and 2²⁴ has behind its point.
const PLACE_BITS: u32 = 23;
/// Most bits of a position; larger subsets have keys of 64 bits.
const POSITION_BITS: u32 = 14;

/// Scratch for the keys of a subset.
#[derive(Debug, Clone, Default)]
pub struct Keys {
    short: Vec<u32>,
    long: Vec<u64>,
}

impl Keys {
    /// Sorts the positions of `projections` by rising projection.
    ///
    /// All projections lie in `[low, low + length]` up to rounding, and none is NaN or −0.
    #[inline(always)]
    pub fn sort<I: Isa>(
        &mut self,
        isa: I,
        projections: &[f32],
        low: f32,
        length: f32,
    ) -> Sorted<'_> {
        let n = projections.len();
        let needed = BITS - (n as u32).saturating_sub(1).leading_zeros();
        let position_bits = needed.max(BITS - PLACE_BITS);
        if position_bits > POSITION_BITS {
            return self.sort_long(projections);
        }
        // In [2²³, 2²⁴) the last bit of a float is its unit, so adding 2²³ rounds to an integer
        // and leaves it in the low bits; the shift drops the exponent. A few steps stay free at
        // the end for what rounding adds to a projection.
        const MAGIC: f32 = (1 << PLACE_BITS) as f32;
        let steps = (1_u32 << (BITS - position_bits)) - 32;
        let scale = steps as f32 / length;
        let padded = n.next_multiple_of(SORT_BLOCK);
        if self.short.len() < padded + SORT_BLOCK {
            self.short.resize(padded + SORT_BLOCK, 0);
        }
        for (position, (key, &projection)) in self.short.iter_mut().zip(projections).enumerate() {
            let place = ((projection - low) * scale).max(0.0) + MAGIC;
            *key = place.to_bits() << position_bits | position as u32;
        }
        // Fewer are needed, but a fixed number takes no call.
        self.short[n..n + SORT_BLOCK].copy_from_slice(&[u32::MAX; SORT_BLOCK]);
        let keys = &mut self.short[..padded];
        isa.sort(keys);
        Sorted { keys: &self.short[..n], mask: (1 << position_bits) - 1 }
    }

    /// The same for subsets of any size, with the bits of the projections themselves.
    fn sort_long(&mut self, projections: &[f32]) -> Sorted<'_> {
        self.long.clear();
        self.long.extend(projections.iter().enumerate().map(|(position, &projection)| {
            // Flipping the sign bit of positive floats, and all bits of negative ones, makes
            // their bit patterns ordered as they are.
            let bits = projection.to_bits();
            let flip = if bits >> 31 == 0 { 1 << 31 } else { u32::MAX };
            u64::from(bits ^ flip) << 32 | position as u64
        }));
        self.long.sort_unstable();
        self.short.clear();
        self.short.extend(self.long.iter().map(|&key| key as u32));
        Sorted { keys: &self.short, mask: u32::MAX }
    }
}

/// Positions in the order of their projections.
pub struct Sorted<'a> {
    keys: &'a [u32],
    mask: u32,
}

impl Sorted<'_> {
    /// The positions, lowest projection first.
    #[inline(always)]
    pub fn positions(&self) -> impl Iterator<Item = usize> {
        self.keys.iter().map(|key| (key & self.mask) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{Stream, Use};
    use crate::gradient::simd::Plain;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn order_is_that_of_a_stable_sort_down_to_the_steps(
            n in prop_oneof![1_usize..600, 4000_usize..40_000],
            few: bool, low in -2.0..0.0_f32, length in 0.1..4.0_f32, seed: u64,
        ) {
            let mut stream = Stream::new(seed, Use::Baseline, 0, 0);
            let mut unit = || if few { f64::from(stream.below(4)) / 4.0 } else { stream.unit() };
            let values: Vec<f32> = (0..n).map(|_| low + length * unit() as f32 + 0.0).collect();
            let mut keys = Keys::default();
            let found: Vec<usize> = keys.sort(Plain, &values, low, length).positions().collect();
            let mut seen = vec![false; n];
            found.iter().for_each(|&i| seen[i] = true);
            prop_assert!(seen.into_iter().all(|seen| seen));
            let step = if n <= 512 {
                length / (1 << 22) as f32
            } else if n <= 1 << POSITION_BITS {
                length / 8.0 / n as f32
            } else {
                0.0
            };
            for pair in found.windows(2) {
                let (a, b) = (values[pair[0]], values[pair[1]]);
                prop_assert!(a <= b + step, "{a} {b}");
                prop_assert!(a != b || pair[0] < pair[1]);
            }
        }
    }
}
