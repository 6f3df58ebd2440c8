//! Random numbers that are the same on every machine: a stream is a function of its key alone.
//!
//! SplitMix64 (Steele, Lea, Flood 2014), with `libm` for what is not a basic operation. The
//! integrand sets and the comparison tiles are published by a number, so they must never change.

use std::f64::consts::TAU;

/// The weyl increment of SplitMix64, 2^64 divided by the golden ratio.
const GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finalizer of SplitMix64: a bijection of 64 bits in which every bit depends on all.
pub(super) fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A hash of `key`; words at different places count differently.
pub(super) fn hash(key: &[u64]) -> u64 {
    key.iter().fold(GAMMA, |state, &word| mix(state.wrapping_add(GAMMA) ^ mix(word ^ GAMMA)))
}

/// An endless sequence of random numbers.
#[derive(Debug, Clone)]
pub(super) struct SplitMix {
    state: u64,
}

impl SplitMix {
    /// The sequence that belongs to `key`.
    pub(super) fn new(key: &[u64]) -> Self {
        Self { state: hash(key) }
    }

    /// 64 random bits.
    pub(super) fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GAMMA);
        mix(self.state)
    }

    /// Uniform in `[0, 1)`, a multiple of 2⁻⁵³.
    pub(super) fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Uniform in `[low, high)`.
    pub(super) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform among `0..n`, with a bias of at most n/2⁵³.
    pub(super) fn below(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n - 1)
    }

    /// A point uniform in the unit cube.
    pub(super) fn point(&mut self, dims: usize) -> Vec<f64> {
        (0..dims).map(|_| self.uniform()).collect()
    }

    /// A direction uniform on the unit sphere: a normal vector (Box–Muller), scaled.
    pub(super) fn direction(&mut self, dims: usize) -> Vec<f64> {
        loop {
            let normal: Vec<f64> = (0..dims)
                .map(|_| {
                    let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
                    radius * libm::cos(TAU * self.uniform())
                })
                .collect();
            let length = libm::sqrt(normal.iter().map(|x| x * x).sum());
            if length > 1e-9 {
                return normal.into_iter().map(|x| x / length).collect();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_is_splitmix64() {
        // The first three outputs for seed 1234567, as published with the algorithm.
        let mut stream = SplitMix { state: 1_234_567 };
        let found = [stream.bits(), stream.bits(), stream.bits()];
        assert_eq!(
            found,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
    }

    #[test]
    fn keys_with_the_same_words_elsewhere_differ() {
        assert_ne!(hash(&[1, 2]), hash(&[2, 1]));
        assert_ne!(hash(&[1]), hash(&[1, 0]));
        assert_ne!(hash(&[0]), hash(&[]));
    }

    #[test]
    fn directions_are_isotropic_and_of_unit_length() {
        let mut stream = SplitMix::new(&[7]);
        for dims in [1, 2, 5] {
            let n = 4000;
            let mut second = vec![0.0; dims];
            for _ in 0..n {
                let direction = stream.direction(dims);
                let length: f64 = direction.iter().map(|x| x * x).sum();
                assert!((length - 1.0).abs() < 1e-12);
                second.iter_mut().zip(&direction).for_each(|(sum, x)| *sum += x * x);
            }
            for sum in second {
                assert!((sum / f64::from(n) - 1.0 / dims as f64).abs() < 0.03);
            }
        }
    }
}
