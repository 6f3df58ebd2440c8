//! The level sets of a kernel: the sample subsets that draws select (Eq. 7, Fig. 3b).
//!
//! Taps are sorted by falling weight, so the subset above a threshold is a prefix. A kernel with
//! weights of both signs is split as g = g⁺ − g⁻, and each half has level sets of its own.

use glam::IVec3;

use crate::kernel::KernelTaps;
use crate::tile::Reach;

/// Bins of thresholds.
const GUIDES: usize = 256;

/// The taps of one sign of one kernel, by falling weight.
#[derive(Debug, Clone)]
pub struct LevelSet {
    /// Offsets `(dx, dy, dt)`.
    pub offsets: Vec<IVec3>,
    /// Magnitudes of the weights in units of the largest, falling from 1.
    levels: Vec<f64>,
    /// Number of levels above each multiple of 1/[`GUIDES`], to look thresholds up faster.
    guide: Vec<u32>,
    /// One past the share of draws up to and including this set, in [0, 1].
    cumulative: f64,
}

impl LevelSet {
    /// Number of taps above a threshold in [0, 1), in units of the largest weight.
    pub fn above(&self, threshold: f64) -> usize {
        let bin = ((threshold * GUIDES as f64) as usize).min(GUIDES - 1);
        let (low, high) = (self.guide[bin + 1] as usize, self.guide[bin] as usize);
        low + self.levels[low..high].partition_point(|&level| level > threshold)
    }

    /// Whether a threshold can leave exactly `count` taps, the first ones.
    pub fn ends_level(&self, count: usize) -> bool {
        count > 0 && self.levels.get(count).is_none_or(|&next| next < self.levels[count - 1])
    }
}

/// The level sets of a mixture of kernels, each with its share of the draws.
///
/// A class takes the share that its weight says; within it, thresholds are uniform over the range
/// of both signs together, so a sign is drawn in proportion to its largest weight.
#[derive(Debug, Clone)]
pub struct LevelSets {
    sets: Vec<LevelSet>,
}

impl LevelSets {
    /// The level sets of kernels with weights, which need not add up to 1.
    ///
    /// # Panics
    /// If there is no class, or a weight is not positive.
    pub fn new<'a>(classes: impl IntoIterator<Item = (f64, &'a KernelTaps)>) -> Self {
        let classes: Vec<(f64, &KernelTaps)> = classes.into_iter().collect();
        assert!(!classes.is_empty() && classes.iter().all(|class| class.0 > 0.0));
        let total: f64 = classes.iter().map(|class| class.0).sum();
        let mut sets = Vec::new();
        let mut cumulative = 0.0;
        for (weight, kernel) in classes {
            let halves = kernel.sign_classes();
            let range: f64 = halves.iter().map(|half| half.peak).sum();
            for half in halves {
                cumulative += weight / total * half.peak / range;
                let levels: Vec<f64> = half.taps.iter().map(|tap| tap.weight / half.peak).collect();
                let above = |bin: usize| {
                    let threshold = bin as f64 / GUIDES as f64;
                    levels.partition_point(|&level| level > threshold) as u32
                };
                sets.push(LevelSet {
                    offsets: half.taps.iter().map(|tap| tap.offset).collect(),
                    guide: (0..=GUIDES).map(above).collect(),
                    levels,
                    cumulative,
                });
            }
        }
        Self { sets }
    }

    /// All sets.
    pub fn sets(&self) -> &[LevelSet] {
        &self.sets
    }

    /// The set that a number in [0, 1) selects.
    pub fn select(&self, u: f64) -> usize {
        // Rounding may leave the last bound just below 1.
        self.sets.partition_point(|set| set.cumulative <= u).min(self.sets.len() - 1)
    }

    /// Most taps of any set.
    pub fn longest(&self) -> usize {
        self.sets.iter().map(|set| set.offsets.len()).max().unwrap_or(0)
    }

    /// How far the taps reach in x and y.
    pub fn reach(&self) -> Reach {
        let offsets = || self.sets.iter().flat_map(|set| &set.offsets);
        let far = |of: fn(&IVec3) -> i32| offsets().map(of).max().unwrap_or(0).max(0) as usize;
        Reach { left: far(|o| -o.x), right: far(|o| o.x), up: far(|o| -o.y), down: far(|o| o.y) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::Tap;

    fn kernel(weights: &[f64]) -> KernelTaps {
        let tap =
            |(k, &weight): (usize, &f64)| Tap { offset: IVec3::new(0, 0, -(k as i32)), weight };
        KernelTaps::new(weights.iter().enumerate().map(tap)).unwrap()
    }

    #[test]
    fn subsets_are_prefixes_of_the_right_size() {
        let levels = LevelSets::new([(1.0, &kernel(&[0.2, 0.4, 0.1]))]);
        let set = &levels.sets()[0];
        assert_eq!(set.offsets.iter().map(|o| o.z).collect::<Vec<_>>(), [-1, 0, -2]);
        for (threshold, taps) in [(0.0, 3), (0.24, 3), (0.26, 2), (0.51, 1), (0.99, 1)] {
            assert_eq!(set.above(threshold), taps);
        }
    }

    #[test]
    fn signs_and_classes_have_their_share() {
        // Peaks 0.6 and −0.2: thresholds range over 0.8, three quarters of it above zero.
        let signed = kernel(&[0.6, -0.2, 0.1, -0.1]);
        let levels = LevelSets::new([(3.0, &signed), (1.0, &kernel(&[1.0]))]);
        assert_eq!(levels.sets().len(), 3);
        for (u, set) in [(0.0, 0), (0.562, 0), (0.563, 1), (0.749, 1), (0.751, 2), (0.999_999, 2)] {
            assert_eq!(levels.select(u), set);
        }
        assert_eq!(levels.sets()[1].offsets.iter().map(|o| o.z).collect::<Vec<_>>(), [-1, -3]);
    }
}
