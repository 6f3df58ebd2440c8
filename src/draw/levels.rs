//! The level sets of a kernel: the sample subsets that draws select (Eq. 7, Fig. 3b).
//!
//! Taps are sorted by falling weight, so the subset above a threshold is a prefix. A kernel with
//! weights of both signs is split as g = g⁺ − g⁻, and each half has level sets of its own.

use glam::IVec3;

use crate::kernel::{Kernel, KernelTaps, Prefix};
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
    /// The share of draws of the sets before this one, and one past that with it, in [0, 1].
    cumulative: [f64; 2],
    /// The samples of a pixel that draws see, the first so many, each with one past the share of the
    /// set's draws up to and including it. Where there is none, draws see all samples.
    prefixes: Vec<(u32, f64)>,
}

impl LevelSet {
    /// Number of taps above a threshold in [0, 1), in units of the largest weight.
    pub fn above(&self, threshold: f64) -> usize {
        let bin = ((threshold * GUIDES as f64) as usize).min(GUIDES - 1);
        let (low, high) = (self.guide[bin + 1] as usize, self.guide[bin] as usize);
        low + self.levels[low..high].partition_point(|&level| level > threshold)
    }

    /// The samples of a pixel that a number in [0, 1) selects, if they are not all.
    fn prefix(&self, u: f64) -> Option<u32> {
        let last = self.prefixes.len().checked_sub(1)?;
        // Rounding may leave the last bound just below 1.
        let place = self.prefixes.partition_point(|&(_, cumulative)| cumulative <= u).min(last);
        Some(self.prefixes[place].0)
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
    /// The level sets of a kernel for tiles of `spp` samples per pixel.
    pub fn of(kernel: &Kernel, spp: usize) -> Self {
        let classes = kernel.classes().iter();
        Self::with_prefixes(classes.map(|class| (class.weight, &class.taps, class.prefix)), spp)
    }

    /// The level sets of kernels with weights, which need not add up to 1; they see all samples.
    ///
    /// # Panics
    /// If there is no class, or a weight is not positive.
    pub fn new<'a>(classes: impl IntoIterator<Item = (f64, &'a KernelTaps)>) -> Self {
        Self::with_prefixes(classes.into_iter().map(|(weight, taps)| (weight, taps, None)), 1)
    }

    fn with_prefixes<'a>(
        classes: impl IntoIterator<Item = (f64, &'a KernelTaps, Option<Prefix>)>,
        spp: usize,
    ) -> Self {
        let classes: Vec<(f64, &KernelTaps, Option<Prefix>)> = classes.into_iter().collect();
        assert!(!classes.is_empty() && classes.iter().all(|class| class.0 > 0.0));
        let total: f64 = classes.iter().map(|class| class.0).sum();
        let mut sets = Vec::new();
        let mut cumulative = 0.0;
        for (weight, kernel, prefix) in classes {
            let halves = kernel.sign_classes();
            let range: f64 = halves.iter().map(|half| half.peak).sum();
            let mut below = 0.0;
            let sum = |(samples, share)| {
                below += share;
                (samples as u32, below)
            };
            let shares = prefix.map(|prefix| prefix.shares(spp)).unwrap_or_default();
            let prefixes: Vec<(u32, f64)> = shares.into_iter().map(sum).collect();
            for half in halves {
                let before = cumulative;
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
                    cumulative: [before, cumulative],
                    prefixes: prefixes.clone(),
                });
            }
        }
        Self { sets }
    }

    /// All sets.
    pub fn sets(&self) -> &[LevelSet] {
        &self.sets
    }

    /// The set that a number in [0, 1) selects, and the samples of a pixel, if they are not all:
    /// what the number is within the share of the set says how many.
    pub fn select(&self, u: f64) -> (usize, Option<u32>) {
        // Rounding may leave the last bound just below 1.
        let place = self.sets.partition_point(|set| set.cumulative[1] <= u);
        let place = place.min(self.sets.len() - 1);
        let set = &self.sets[place];
        let [from, to] = set.cumulative;
        (place, set.prefix((u - from) / (to - from)))
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
    use crate::kernel::{KernelSpec, Tap};

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
    fn prefixes_have_their_share_of_each_class() {
        let spec: KernelSpec = "0.75: box(2) of 1.. + 0.25: none of 2".parse().unwrap();
        let levels = LevelSets::of(&spec.resolve_without_tile().unwrap(), 3);
        let shares = [1.0, 0.5_f64.sqrt(), (1.0_f64 / 3.0).sqrt()];
        let total: f64 = shares.iter().sum();
        let ends = [1.0, 1.0 + shares[1], total].map(|end| 0.75 * end / total);
        for (from, to, samples) in [(0.0, ends[0], 1), (ends[0], ends[1], 2), (ends[1], ends[2], 3)]
        {
            for u in [from + 1e-9, 0.5 * (from + to), to - 1e-9] {
                assert_eq!(levels.select(u), (0, Some(samples)), "{u}");
            }
        }
        assert_eq!(levels.select(0.75 + 1e-9), (1, Some(2)));
        assert_eq!(levels.select(1.0 - 1e-16), (1, Some(2)));
    }

    #[test]
    fn signs_and_classes_have_their_share() {
        // Peaks 0.6 and −0.2: thresholds range over 0.8, three quarters of it above zero.
        let signed = kernel(&[0.6, -0.2, 0.1, -0.1]);
        let levels = LevelSets::new([(3.0, &signed), (1.0, &kernel(&[1.0]))]);
        assert_eq!(levels.sets().len(), 3);
        for (u, set) in [(0.0, 0), (0.562, 0), (0.563, 1), (0.749, 1), (0.751, 2), (0.999_999, 2)] {
            assert_eq!(levels.select(u), (set, None));
        }
        assert_eq!(levels.sets()[1].offsets.iter().map(|o| o.z).collect::<Vec<_>>(), [-1, -3]);
    }
}
