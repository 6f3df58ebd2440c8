//! A kernel as the optimizer and the scores use it: offsets with weights.

use std::collections::BTreeMap;

use glam::IVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why a list of taps is not a kernel.
#[derive(Debug, Error, Clone, Copy, PartialEq)]
pub enum TapsError {
    /// There is no tap with a weight other than zero.
    #[error("the kernel has no tap with a weight other than 0")]
    Empty,
    /// A weight is not a finite number.
    #[error("the weight of tap ({}, {}, {}) is {weight}, but weights must be finite", offset.x, offset.y, offset.z)]
    Weight {
        /// Where the tap is.
        offset: IVec3,
        /// Its weight.
        weight: f64,
    },
    /// Two taps have one offset.
    #[error("the kernel has two taps at ({}, {}, {})", offset.x, offset.y, offset.z)]
    Twice {
        /// The offset that they share.
        offset: IVec3,
    },
    /// The taps of a kernel are in order and scaled to Σ|g| = 1, and these are not.
    #[error("the taps are not those of a kernel")]
    Unscaled,
}

/// One offset of a kernel with its weight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tap {
    /// `(dx, dy, dt)` in pixels and frames, from the pixel that is filtered to the one that is
    /// weighted; a frame in the past has a negative `dt`.
    pub offset: IVec3,
    /// Weight of the pixel at that offset; either sign, never 0.
    pub weight: f64,
}

/// The taps of one kernel, sorted by falling magnitude of weight (ties by `dt`, `dy`, `dx`),
/// scaled to Σ|g| = 1. The perceived error at pixel p is Σ weight · error(p + offset).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Tap>", into = "Vec<Tap>")]
pub struct KernelTaps {
    taps: Vec<Tap>,
}

/// The taps of a kernel as they are, without scaling them anew: they keep their last digits.
impl TryFrom<Vec<Tap>> for KernelTaps {
    type Error = TapsError;

    fn try_from(taps: Vec<Tap>) -> Result<Self, TapsError> {
        let Self { taps: sorted } = Self::new(taps.iter().copied())?;
        let mass: f64 = taps.iter().map(|tap| tap.weight.abs()).sum();
        let falls = |pair: &[Tap]| pair[0].weight.abs() >= pair[1].weight.abs();
        let kept = sorted.len() == taps.len() && taps.windows(2).all(falls);
        if kept && (mass - 1.0).abs() < 1e-6 { Ok(Self { taps }) } else { Err(TapsError::Unscaled) }
    }
}

impl From<KernelTaps> for Vec<Tap> {
    fn from(kernel: KernelTaps) -> Self {
        kernel.taps
    }
}

impl KernelTaps {
    /// Sorts and scales `taps`; those of weight 0 are left out.
    ///
    /// # Errors
    /// A weight that is not finite, two taps at one offset, or nothing left.
    pub fn new(taps: impl IntoIterator<Item = Tap>) -> Result<Self, TapsError> {
        let mut taps: Vec<Tap> = taps.into_iter().filter(|tap| tap.weight != 0.0).collect();
        if let Some(&Tap { offset, weight }) = taps.iter().find(|tap| !tap.weight.is_finite()) {
            return Err(TapsError::Weight { offset, weight });
        }
        let place = |tap: &Tap| (tap.offset.z, tap.offset.y, tap.offset.x);
        taps.sort_by_key(place);
        if let Some(pair) = taps.windows(2).find(|pair| pair[0].offset == pair[1].offset) {
            return Err(TapsError::Twice { offset: pair[0].offset });
        }
        let mass: f64 = taps.iter().map(|tap| tap.weight.abs()).sum();
        if taps.is_empty() || !(mass > 0.0 && mass.is_finite()) {
            return Err(TapsError::Empty);
        }
        for tap in &mut taps {
            tap.weight /= mass;
        }
        taps.sort_by(|a, b| {
            b.weight.abs().total_cmp(&a.weight.abs()).then(place(a).cmp(&place(b)))
        });
        Ok(Self { taps })
    }

    /// The kernel as a tile sees it that repeats after so many frames: taps a whole number of
    /// periods apart weight one sample, so their weights add up. What is filtered is the same, up to
    /// the scale to Σ|g| = 1, which is smaller before where weights of both signs meet.
    ///
    /// A kernel that is no longer than the period stays as it is. Of others each tap keeps its frame
    /// where the newest period has it (0 and before, if the kernel reaches into the past only), or
    /// the period around frame 0.
    ///
    /// # Errors
    /// Weights that cancel each other.
    ///
    /// # Panics
    /// If there are no frames, or more than `i32` holds.
    pub fn folded(&self, frames: usize) -> Result<Self, TapsError> {
        if self.size()[2] <= frames as u64 {
            return Ok(self.clone());
        }
        let period = i32::try_from(frames).expect("frames of a tile");
        let last = if self.bounds().1.z > 0 { (period - 1) / 2 } else { 0 };
        let mut weights = BTreeMap::new();
        for tap in &self.taps {
            let dt = last - (last - tap.offset.z).rem_euclid(period);
            *weights.entry((dt, tap.offset.y, tap.offset.x)).or_insert(0.0) += tap.weight;
        }
        let tap = |((z, y, x), weight)| Tap { offset: IVec3::new(x, y, z), weight };
        Self::new(weights.into_iter().map(tap))
    }

    /// All taps by falling magnitude of weight.
    pub fn taps(&self) -> &[Tap] {
        &self.taps
    }

    /// The smallest box around all offsets: lowest and highest `(dx, dy, dt)`, both included.
    pub fn bounds(&self) -> (IVec3, IVec3) {
        self.taps.iter().fold((IVec3::MAX, IVec3::MIN), |(low, high), tap| {
            (low.min(tap.offset), high.max(tap.offset))
        })
    }

    /// Pixels across, pixels down and frames of the smallest box around all offsets.
    pub fn size(&self) -> [u64; 3] {
        let (low, high) = self.bounds();
        (high.as_i64vec3() - low.as_i64vec3()).to_array().map(|n| n.unsigned_abs() + 1)
    }

    /// Σg: how much of a constant error passes; 1 where no weight is negative.
    pub fn sum(&self) -> f64 {
        self.taps.iter().map(|tap| tap.weight).sum()
    }

    /// Σ|g|: 1, up to rounding.
    pub fn magnitude(&self) -> f64 {
        self.taps.iter().map(|tap| tap.weight.abs()).sum()
    }

    /// Σg²: the variance of white noise of variance 1 behind the filter.
    pub fn power(&self) -> f64 {
        self.taps.iter().map(|tap| tap.weight * tap.weight).sum()
    }

    /// (Σ|g|)²/Σg²: the number of taps of equal magnitude that pass as much white noise.
    pub fn effective_taps(&self) -> f64 {
        self.magnitude() * self.magnitude() / self.power()
    }

    /// Mean number of taps in the subset of a draw: a threshold uniform over the range of both
    /// signs together leaves Σ|g| / (max g⁺ + max g⁻) of them.
    pub fn mean_subset(&self) -> f64 {
        let range: f64 = self.sign_classes().iter().map(|class| class.peak).sum();
        self.magnitude() / range
    }

    /// The positive part g⁺ and the negative part g⁻, each if it has any taps.
    pub fn sign_classes(&self) -> Vec<SignClass> {
        let part = |negative: bool| {
            let taps: Vec<Tap> = self
                .taps
                .iter()
                .filter(|tap| (tap.weight < 0.0) == negative)
                .map(|tap| Tap { weight: tap.weight.abs(), ..*tap })
                .collect();
            let peak = taps.first()?.weight;
            Some(SignClass { negative, taps, peak })
        };
        [part(false), part(true)].into_iter().flatten().collect()
    }
}

/// The taps of one sign: a draw takes a sign class with probability proportional to its `peak`
/// and a threshold uniform in (0, `peak`); its subset is the prefix of larger weights (Eq. 7).
#[derive(Debug, Clone, PartialEq)]
pub struct SignClass {
    /// Whether these taps are negative in the kernel.
    pub negative: bool,
    /// The taps by falling weight, with their magnitude |g| as weight, so all positive.
    pub taps: Vec<Tap>,
    /// The largest weight, that of the first tap.
    pub peak: f64,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn taps(weights: &[(i32, i32, i32, f64)]) -> KernelTaps {
        let tap = |&(x, y, t, weight)| Tap { offset: IVec3::new(x, y, t), weight };
        KernelTaps::new(weights.iter().map(tap)).unwrap()
    }

    #[test]
    fn sums_and_sizes_are_those_of_the_taps() {
        let kernel = taps(&[(0, 0, -1, 3.0), (2, -1, -4, -4.0), (0, 0, 0, 1.0)]);
        let weights: Vec<f64> = kernel.taps().iter().map(|tap| tap.weight).collect();
        assert_eq!(weights, [-0.5, 0.375, 0.125]);
        assert_eq!(kernel.sum(), 0.0);
        assert_eq!(kernel.magnitude(), 1.0);
        assert_eq!(kernel.power(), 0.25 + 0.140625 + 0.015625);
        assert_eq!(kernel.effective_taps(), 1.0 / kernel.power());
        assert_eq!(kernel.mean_subset(), 1.0 / 0.875);
        assert_eq!(kernel.size(), [3, 2, 5]);
        assert_eq!(kernel.bounds(), (IVec3::new(0, -1, -4), IVec3::new(2, 0, 0)));
        assert_eq!(taps(&[(i32::MIN, 0, 0, 1.0), (i32::MAX, 0, 0, 1.0)]).size(), [1 << 32, 1, 1]);
    }

    #[test]
    fn a_long_kernel_is_folded_at_the_period() {
        let offsets = |kernel: &KernelTaps| {
            kernel.taps().iter().map(|tap| (tap.offset.z, tap.weight)).collect::<Vec<_>>()
        };
        // Frame −5 is frame −1 of four, and frame −4 is frame 0.
        let past = taps(&[(0, 0, 0, 0.25), (0, 0, -1, 0.125), (0, 0, -4, 0.125), (0, 0, -5, 0.5)]);
        assert_eq!(offsets(&past.folded(4).unwrap()), [(-1, 0.625), (0, 0.375)]);
        assert_eq!(past.folded(6).unwrap(), past);
        // Two frames of the future are the past of the period around frame 0.
        let both = taps(&[(0, 0, -1, 0.25), (0, 0, 0, 0.5), (0, 0, 3, 0.25)]);
        assert_eq!(offsets(&both.folded(4).unwrap()), [(-1, 0.5), (0, 0.5)]);
        assert_eq!(offsets(&both.folded(1).unwrap()), [(0, 1.0)]);
        // Frames at the ends of what is allowed.
        let far = taps(&[(0, 0, i32::MIN, 1.0), (0, 0, i32::MAX, 1.0)]);
        assert_eq!(offsets(&far.folded(2).unwrap()), [(-1, 0.5), (0, 0.5)]);
        let zero = taps(&[(0, 0, 0, 0.5), (0, 0, -2, -0.5)]);
        assert_eq!(zero.folded(2), Err(TapsError::Empty));
    }

    #[test]
    fn equal_taps_are_all_effective() {
        let flat: Vec<_> = (0..50).map(|x| (x, 0, 0, 7.0)).collect();
        assert!((taps(&flat).effective_taps() - 50.0).abs() < 1e-12);
        assert!((taps(&flat).mean_subset() - 50.0).abs() < 1e-12);
        assert_eq!(taps(&flat).sign_classes().len(), 1);
    }

    proptest! {
        /// g⁺ − g⁻ is g again, and each is sorted with its peak first.
        #[test]
        fn the_signs_together_are_the_kernel(weights in prop::collection::vec(-1.0..1.0, 1..30)) {
            let listed: Vec<_> =
                weights.iter().enumerate().map(|(x, &w)| (x as i32, 0, 0, w)).collect();
            prop_assume!(weights.iter().any(|&w| w != 0.0));
            let kernel = taps(&listed);
            let mut together = Vec::new();
            for class in kernel.sign_classes() {
                prop_assert_eq!(class.peak, class.taps[0].weight);
                prop_assert!(class.taps.is_sorted_by(|a, b| a.weight >= b.weight));
                prop_assert!(class.taps.iter().all(|tap| tap.weight > 0.0));
                let sign = if class.negative { -1.0 } else { 1.0 };
                together.extend(class.taps.iter().map(|tap| Tap { weight: sign * tap.weight, ..*tap }));
            }
            let mass = kernel.magnitude();
            let again = KernelTaps::new(together).unwrap();
            prop_assert_eq!(again.taps().len(), kernel.taps().len());
            for (a, b) in again.taps().iter().zip(kernel.taps()) {
                prop_assert!(a.offset == b.offset && (a.weight - b.weight / mass).abs() < 1e-15);
            }
        }

        /// On an image that repeats, the folded kernel filters as the whole one does.
        #[test]
        fn a_folded_kernel_filters_as_the_whole_one(
            weights in prop::collection::vec((-1.0..1.0, -40..10_i32), 1..30),
            image in prop::collection::vec(-1.0..1.0, 1..12),
        ) {
            let weights: BTreeMap<i32, f64> = weights.into_iter().map(|(w, t)| (t, w)).collect();
            let kernel = taps(&weights.iter().map(|(&t, &w)| (0, 0, t, w)).collect::<Vec<_>>());
            let period = image.len();
            let folded = kernel.folded(period).unwrap();
            prop_assert!(folded.size()[2] <= period as u64);
            let filtered = |kernel: &KernelTaps, t: i32| -> f64 {
                let at = |tap: &Tap| image[(t + tap.offset.z).rem_euclid(period as i32) as usize];
                kernel.taps().iter().map(|tap| tap.weight * at(tap)).sum()
            };
            // Where weights cancel, what is left is scaled up.
            let sums = |kernel: &KernelTaps| -> f64 {
                let mut sums = vec![0.0; period];
                for tap in kernel.taps() {
                    sums[tap.offset.z.rem_euclid(period as i32) as usize] += tap.weight;
                }
                sums.iter().map(|sum: &f64| sum.abs()).sum()
            };
            for t in 0..period as i32 {
                let whole = filtered(&kernel, t) / sums(&kernel);
                prop_assert!((filtered(&folded, t) - whole).abs() < 1e-9);
            }
        }

        /// The mean size of the subset is the integral over thresholds, taken here step by step.
        #[test]
        fn the_mean_subset_is_the_mean_over_thresholds(
            weights in prop::collection::vec(-1.0..1.0, 1..20),
        ) {
            let listed: Vec<_> =
                weights.iter().enumerate().map(|(x, &w)| (x as i32, 0, 0, w)).collect();
            let kernel = taps(&listed);
            let classes = kernel.sign_classes();
            let range: f64 = classes.iter().map(|class| class.peak).sum();
            let steps = 4000;
            let mut sum = 0.0;
            for class in &classes {
                for step in 0..steps {
                    let z = class.peak * (f64::from(step) + 0.5) / f64::from(steps);
                    let subset = class.taps.iter().filter(|tap| tap.weight > z).count();
                    sum += subset as f64 * class.peak / range / f64::from(steps);
                }
            }
            prop_assert!((sum - kernel.mean_subset()).abs() < 1e-2, "{sum}");
        }
    }
}
