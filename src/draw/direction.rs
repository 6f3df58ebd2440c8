//! Directions of projections: where they point, and which table their target comes from.
//!
//! In one and two dimensions every direction has a target in closed form. Above, the directions
//! are those of a fixed set, multiplied by random signed permutations of the axes: the projection
//! of a uniform density depends on the magnitudes of the components only, so one table serves all
//! images of a direction. Directions along a pair of axes, or one axis, are closed forms as well.

use crate::draw::{Stream, Use};
use crate::tile::MAX_DIMS;

/// A direction with what its target distribution needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction {
    /// Unit vector; components past the tile's dimensions are 0.
    pub theta: [f32; MAX_DIMS],
    /// How the uniform density on the cube looks along it.
    pub density: Density,
}

impl Direction {
    /// Lowest projection of a point of the cube in `dims` dimensions, and how far above it the
    /// highest one is.
    #[inline(always)]
    pub fn extent(&self, dims: usize) -> (f32, f32) {
        let (mut low, mut length) = (0.0, 0.0);
        for x in &self.theta[..dims] {
            low += x.min(0.0);
            length += x.abs();
        }
        (low, length)
    }
}

/// The shape of the projected uniform density, up to its lower end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Density {
    /// At most two components differ from 0: a trapezoid.
    Trapezoid,
    /// The density of a direction of the fixed set.
    Table {
        /// Position in the set.
        index: u32,
    },
}

/// Directions for tiles of a number of dimensions.
#[derive(Debug, Clone)]
pub struct DirectionSet {
    dims: usize,
    /// Components' magnitudes; empty for one and two dimensions.
    magnitudes: Vec<[f32; MAX_DIMS]>,
}

impl DirectionSet {
    /// Number of directions in the fixed set. With their images under signed permutations
    /// (48 in three dimensions, more above) they cover the sphere densely.
    pub const SIZE: usize = 256;

    /// The set for `dims` dimensions; it does not depend on any seed.
    pub fn new(dims: usize) -> Self {
        let mut stream = Stream::new(0, Use::DirectionSet, dims as u32, 0);
        let count = if dims > 2 { Self::SIZE } else { 0 };
        let magnitudes = (0..count).map(|_| sphere(dims, &mut stream).map(f32::abs)).collect();
        Self { dims, magnitudes }
    }

    /// Number of dimensions.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// The magnitudes of the components of every direction of the set.
    pub fn magnitudes(&self) -> &[[f32; MAX_DIMS]] {
        &self.magnitudes
    }

    /// Uniform on the sphere; `u` in [0, 1) moves through the set (or around the half circle).
    pub fn any(&self, u: f64, stream: &mut Stream) -> Direction {
        match self.dims {
            1 => self.axis(0),
            2 => self.pair(0, 1, u),
            dims => {
                let index = ((u * Self::SIZE as f64) as usize).min(Self::SIZE - 1);
                let mut theta = self.magnitudes[index];
                for k in (1..dims).rev() {
                    theta.swap(k, stream.below(k as u32 + 1) as usize);
                }
                let signs = stream.word();
                for (k, component) in theta[..dims].iter_mut().enumerate() {
                    if signs >> k & 1 == 1 {
                        *component = -*component;
                    }
                }
                Direction { theta, density: Density::Table { index: index as u32 } }
            }
        }
    }

    /// In the plane of two axes, at the angle π·`u`.
    pub fn pair(&self, a: usize, b: usize, u: f64) -> Direction {
        let (sin, cos) = half_turn(u);
        let mut theta = [0.0; MAX_DIMS];
        (theta[a], theta[b]) = (cos as f32, sin as f32);
        Direction { theta, density: Density::Trapezoid }
    }

    /// In the plane of a random pair of axes, at the angle π·`u`.
    pub fn random_pair(&self, u: f64, stream: &mut Stream) -> Direction {
        match self.dims {
            1 => self.axis(0),
            dims => {
                let a = stream.below(dims as u32) as usize;
                let b = stream.below(dims as u32 - 1) as usize;
                self.pair(a, if b < a { b } else { b + 1 }, u)
            }
        }
    }

    /// Along an axis.
    pub fn axis(&self, k: usize) -> Direction {
        let mut theta = [0.0; MAX_DIMS];
        theta[k] = 1.0;
        Direction { theta, density: Density::Trapezoid }
    }
}

/// Sine and cosine of π·`u` for `u` in [0, 1), to 1e−10, which is enough
/// for f32. Plain arithmetic, so that it is the same on every machine.
#[inline(always)]
fn half_turn(u: f64) -> (f64, f64) {
    // With x = π(u − 1/2) in [−π/2, π/2), sin πu = cos x and cos πu = −sin x, by their series.
    const SIN: [f64; 8] = series(1);
    const COS: [f64; 8] = series(0);
    let x = std::f64::consts::PI * (u - 0.5);
    let square = x * x;
    let sum = |terms: &[f64; 8]| terms.iter().rev().fold(0.0, |sum, term| sum * square + term);
    (sum(&COS), -x * sum(&SIN))
}

/// (−1)ᵏ / (2k + odd)!, k = 0..8.
const fn series(odd: u32) -> [f64; 8] {
    let mut terms = [1.0; 8];
    let mut k = 1;
    while k < 8 {
        let n = 2 * k as u32 + odd;
        terms[k] = -terms[k - 1] / (n * (n - 1)) as f64;
        k += 1;
    }
    terms
}

/// A point on the unit sphere in `dims` dimensions, by normalised Gaussians (Box–Muller).
fn sphere(dims: usize, stream: &mut Stream) -> [f32; MAX_DIMS] {
    loop {
        let mut gaussians = [0.0_f64; MAX_DIMS];
        for pair in gaussians[..dims].chunks_mut(2) {
            // 1 − u is in (0, 1], so the logarithm is finite.
            let radius = libm::sqrt(-2.0 * libm::log(1.0 - stream.unit()));
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * stream.unit());
            for (value, part) in pair.iter_mut().zip([cos, sin]) {
                *value = radius * part;
            }
        }
        let length = gaussians.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length > 1e-6 {
            return gaussians.map(|x| (x / length) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_turns_are_those_of_the_exact_functions() {
        for i in 0..10_000 {
            let u = f64::from(i) / 10_000.0;
            let (sin, cos) = half_turn(u);
            let (exact_sin, exact_cos) = (std::f64::consts::PI * u).sin_cos();
            assert!((sin - exact_sin).abs() < 1e-10 && (cos - exact_cos).abs() < 1e-10, "{u}");
        }
        assert_eq!(half_turn(0.5).0, 1.0);
    }

    #[test]
    fn directions_are_unit_vectors_without_a_preferred_side() {
        for dims in [1, 2, 3, 8, 16] {
            let set = DirectionSet::new(dims);
            let mut stream = Stream::new(1, Use::Directions, 0, 0);
            let mut second_moment = [0.0_f64; MAX_DIMS];
            let count = 20_000;
            for i in 0..count {
                let u = i as f64 / count as f64;
                for direction in [set.any(u, &mut stream), set.random_pair(u, &mut stream)] {
                    let square: f32 = direction.theta.iter().map(|x| x * x).sum();
                    assert!((square - 1.0).abs() < 1e-5);
                }
                for (sum, x) in second_moment.iter_mut().zip(set.any(u, &mut stream).theta) {
                    *sum += f64::from(x * x) / f64::from(count);
                }
            }
            // An isotropic unit vector has E θₖ² = 1/d.
            for (k, moment) in second_moment.into_iter().enumerate() {
                let expected = if k < dims { 1.0 / dims as f64 } else { 0.0 };
                assert!((moment - expected).abs() < 0.02, "{dims} dims, axis {k}: {moment}");
            }
        }
    }
}
