//! Directions of projections: where they point, and which table their target comes from.
//!
//! In the square every direction has a target in closed form. In a cube the directions
//! are those of a fixed set, multiplied by random signed permutations of the axes: the projection
//! of a uniform density depends on the magnitudes of the components only, so one table serves all
//! images of a direction. Directions along a pair of axes, or one axis, are closed forms as well.
//! In other domains one table serves all directions that see the domain alike; a density that none
//! sees as another does has those of a fixed set alone.

use crate::domain::{Domain, Symmetry};
use crate::draw::{Stream, Use};
use crate::tile::MAX_DIMS;

/// A direction with what its target distribution needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction {
    /// Unit vector; components past the tile's dimensions are 0.
    pub theta: [f32; MAX_DIMS],
    /// How the domain looks along it.
    pub projection: Projection,
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

/// The shape of the projected density, up to where it stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Projection {
    /// At most two components differ from 0, in the cube: a trapezoid.
    Trapezoid,
    /// All projections of a sphere are as likely (Archimedes).
    Uniform,
    /// The density of a direction of the fixed set.
    Table {
        /// Position in the set.
        index: u32,
    },
}

/// Directions for tiles of a domain and a number of dimensions.
#[derive(Debug, Clone)]
pub struct DirectionSet {
    domain: Domain,
    symmetry: Symmetry,
    dims: usize,
    /// One of all directions that see the domain alike, for each table of targets: in a cube by its
    /// components' magnitudes, and none in the square and on a line.
    representatives: Vec<[f32; MAX_DIMS]>,
}

impl DirectionSet {
    /// Number of directions in the fixed set. With their images under signed permutations
    /// (48 in three dimensions, more above) they cover the sphere densely.
    pub const SIZE: usize = 256;

    /// Number of directions in the fixed set of an axial domain: those with so many last components
    /// at equal distances, and turned around the axis by any angle.
    pub const HEIGHTS: usize = 64;

    /// Number of directions in the fixed set of a density on the square, at equal angles; behind them
    /// are both axes.
    pub const ANGLES: usize = 256;

    /// The set for a domain in `dims` dimensions; it does not depend on any seed.
    pub fn new(domain: Domain, dims: usize) -> Self {
        let symmetry = domain.symmetry();
        let representatives = match symmetry {
            Symmetry::Cube => {
                let mut stream = Stream::new(0, Use::DirectionSet, dims as u32, 0);
                let count = if dims > 2 { Self::SIZE } else { 0 };
                (0..count).map(|_| sphere(dims, &mut stream).map(f32::abs)).collect()
            }
            Symmetry::Round => vec![unit(0, 1.0, 0.0)],
            Symmetry::Axial => (0..Self::HEIGHTS)
                .map(|index| {
                    let height = height(index);
                    unit(dims - 1, height, libm::sqrt(1.0 - height * height))
                })
                .collect(),
            Symmetry::None => (0..Self::ANGLES)
                .map(|index| {
                    let (sin, cos) = half_turn((index as f64 + 0.5) / Self::ANGLES as f64);
                    unit(1, sin, cos)
                })
                .chain([unit(1, 0.0, 1.0), unit(1, 1.0, 0.0)])
                .collect(),
        };
        Self { domain, symmetry, dims, representatives }
    }

    /// The domain.
    pub fn domain(&self) -> Domain {
        self.domain
    }

    /// Number of dimensions.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// A direction for every table of targets.
    pub fn representatives(&self) -> &[[f32; MAX_DIMS]] {
        &self.representatives
    }

    /// Uniform on the sphere; `u` in [0, 1) moves through the set (or around the half circle).
    pub fn any(&self, u: f64, stream: &mut Stream) -> Direction {
        if self.symmetry != Symmetry::Cube {
            return self.turned(u, stream);
        }
        match self.dims {
            1 => self.axis(0),
            2 => self.pair(0, 1, u),
            dims => {
                let index = ((u * Self::SIZE as f64) as usize).min(Self::SIZE - 1);
                let mut theta = self.representatives[index];
                for k in (1..dims).rev() {
                    theta.swap(k, stream.below(k as u32 + 1) as usize);
                }
                let signs = stream.word();
                for (k, component) in theta[..dims].iter_mut().enumerate() {
                    if signs >> k & 1 == 1 {
                        *component = -*component;
                    }
                }
                Direction { theta, projection: Projection::Table { index: index as u32 } }
            }
        }
    }

    /// One that is as `u` says for its table, turned by a random angle where it does not matter.
    fn turned(&self, u: f64, stream: &mut Stream) -> Direction {
        let table = |theta, index: usize| {
            let projection = match self.domain.has_uniform_projections() {
                true => Projection::Uniform,
                false => Projection::Table { index: index as u32 },
            };
            Direction { theta, projection }
        };
        if self.symmetry == Symmetry::None {
            let index = ((u * Self::ANGLES as f64) as usize).min(Self::ANGLES - 1);
            return self.listed(index);
        }
        if self.dims == 2 {
            return table(self.pair(0, 1, u).theta, 0);
        }
        let (height, index) = match self.symmetry {
            // Opposite directions are one, so half of the heights are all.
            Symmetry::Axial => {
                let index = ((u * Self::HEIGHTS as f64) as usize).min(Self::HEIGHTS - 1);
                (height(index), index)
            }
            _ => (u, 0),
        };
        let (sin, cos) = half_turn(stream.unit());
        let flat = libm::sqrt(1.0 - height * height);
        let flat = if stream.word() & 1 == 1 { -flat } else { flat };
        let mut theta = [0.0; MAX_DIMS];
        (theta[0], theta[1], theta[2]) = ((flat * cos) as f32, (flat * sin) as f32, height as f32);
        table(theta, index)
    }

    /// In the plane of two axes, at the angle π·`u`.
    pub fn pair(&self, a: usize, b: usize, u: f64) -> Direction {
        let (sin, cos) = half_turn(u);
        let mut theta = [0.0; MAX_DIMS];
        (theta[a], theta[b]) = (cos as f32, sin as f32);
        Direction { theta, projection: Projection::Trapezoid }
    }

    /// In the plane of a random pair of axes, at the angle π·`u`; in a domain whose axes are as all
    /// other directions, any.
    pub fn random_pair(&self, u: f64, stream: &mut Stream) -> Direction {
        if self.symmetry != Symmetry::Cube {
            return self.turned(u, stream);
        }
        match self.dims {
            1 => self.axis(0),
            dims => {
                let a = stream.below(dims as u32) as usize;
                let b = stream.below(dims as u32 - 1) as usize;
                self.pair(a, if b < a { b } else { b + 1 }, u)
            }
        }
    }

    /// Along a random axis; in a domain whose axes are as all other directions, as `u` says.
    pub fn random_axis(&self, u: f64, stream: &mut Stream) -> Direction {
        match self.symmetry {
            Symmetry::Cube => self.axis(stream.below(self.dims as u32) as usize),
            Symmetry::None => self.listed(Self::ANGLES + stream.below(2) as usize),
            _ => self.turned(u, stream),
        }
    }

    /// The direction across one that is in the plane of a pair of axes.
    pub fn across(&self, first: &Direction) -> Direction {
        if let (Symmetry::None, Projection::Table { index }) = (self.symmetry, first.projection) {
            let index = index as usize;
            let angle = (index + Self::ANGLES / 2) % Self::ANGLES;
            let axis = (2 * Self::ANGLES + 1).saturating_sub(index);
            return self.listed(if index < Self::ANGLES { angle } else { axis });
        }
        let mut second = Direction { theta: [0.0; MAX_DIMS], ..*first };
        let mut pair = (0..self.dims).filter(|&k| first.theta[k] != 0.0);
        let (a, b) = match (pair.next(), pair.next()) {
            (Some(a), Some(b)) => (a, b),
            (Some(a), None) => (a, (a + 1) % self.dims),
            _ => (0, 1),
        };
        (second.theta[a], second.theta[b]) = (-first.theta[b], first.theta[a]);
        second
    }

    /// Number `index` of the fixed set.
    fn listed(&self, index: usize) -> Direction {
        let theta = self.representatives[index];
        Direction { theta, projection: Projection::Table { index: index as u32 } }
    }

    /// Along an axis.
    pub fn axis(&self, k: usize) -> Direction {
        let mut theta = [0.0; MAX_DIMS];
        theta[k] = 1.0;
        Direction { theta, projection: Projection::Trapezoid }
    }
}

/// The last component of direction number `index` of an axial domain.
fn height(index: usize) -> f64 {
    (index as f64 + 0.5) / DirectionSet::HEIGHTS as f64
}

/// A direction with a component `along` axis number `k`, and the rest along the first.
fn unit(k: usize, along: f64, rest: f64) -> [f32; MAX_DIMS] {
    let mut theta = [0.0; MAX_DIMS];
    theta[0] = rest as f32;
    theta[k] = along as f32;
    theta
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
    use crate::domain::tests::densities;

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

    /// Angles and both axes, each with the table of its own direction; across is a right angle.
    #[test]
    fn directions_of_a_density_are_those_of_its_tables() {
        let set = DirectionSet::new(densities()[0], 2);
        let mut stream = Stream::new(1, Use::Directions, 0, 0);
        let mut axes = [0; 2];
        for i in 0..600 {
            let axis = set.random_axis(0.3, &mut stream);
            axes[usize::from(axis.theta[1] == 1.0)] += 1;
            for direction in [set.any(f64::from(i) / 600.0, &mut stream), axis] {
                let across = set.across(&direction);
                let dot: f32 = direction.theta.iter().zip(across.theta).map(|(a, b)| a * b).sum();
                assert!(dot.abs() < 1e-6, "{direction:?} {across:?}");
                for it in [direction, across] {
                    let Projection::Table { index } = it.projection else { panic!("{it:?}") };
                    assert_eq!(set.representatives()[index as usize], it.theta);
                }
            }
        }
        assert!(axes[0] > 200 && axes[1] > 200, "{axes:?}");
    }

    #[test]
    fn directions_are_unit_vectors_without_a_preferred_side() {
        for dims in [1, 2, 3, 8, 16] {
            let set = DirectionSet::new(Domain::Square, dims);
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
