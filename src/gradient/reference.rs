//! The gradient as the paper's equations say it, in f64 and without haste: the oracle that the
//! fast one is compared with.
//!
//! Nothing here is shared with the fast path but the draws themselves: pixels wrap by remainder,
//! ranks come from a stable sort, targets from the exact CDF of the cube's projected density, which
//! is inverted by bisection and integrated in closed form, and in other domains from many of their
//! points, projected and sorted ([`ManyPoints`]).

use glam::IVec3;

use super::target::NODES;
use crate::domain::{Domain, GRID};
use crate::draw::{Direction, LevelSets};
use crate::tile::Tile;

/// A draw in coordinates of the tile.
#[derive(Debug, Clone)]
pub struct ReferenceDraw {
    /// Pixel `(x, y, t)`.
    pub pixel: IVec3,
    /// Which level set.
    pub set: usize,
    /// How many of its taps.
    pub taps: usize,
    /// How many samples of each pixel, the first ones.
    pub samples: usize,
    /// Directions of the projections.
    pub directions: Vec<Direction>,
}

/// Half the sum over draws, directions and samples of (projection − target)².
pub fn objective(
    (tile, domain): (&Tile, Domain),
    levels: &LevelSets,
    draws: &[ReferenceDraw],
) -> f64 {
    let mut sum = 0.0;
    visit((tile, domain), levels, draws, |_, _, difference| sum += 0.5 * difference * difference);
    sum
}

/// The negative gradient of [`objective`]: for every coordinate in C order, the sum over its draws.
pub fn gradient(
    (tile, domain): (&Tile, Domain),
    levels: &LevelSets,
    draws: &[ReferenceDraw],
) -> Vec<f64> {
    let dims = tile.shape().dims();
    let mut gradient = vec![0.0; tile.shape().coordinates()];
    visit((tile, domain), levels, draws, |sample, direction, difference| {
        for k in 0..dims {
            gradient[sample * dims + k] += difference * f64::from(direction.theta[k]);
        }
    });
    gradient
}

/// Calls `visit(sample, direction, target − projection)` for every sample of every draw.
fn visit(
    (tile, domain): (&Tile, Domain),
    levels: &LevelSets,
    draws: &[ReferenceDraw],
    mut visit: impl FnMut(usize, &Direction, f64),
) {
    let shape = tile.shape();
    let points = (!domain.is_square()).then(|| ManyPoints::of(domain));
    let size = IVec3::new(shape.width() as i32, shape.height() as i32, shape.frames() as i32);
    for draw in draws {
        // Where projections are equal, the order of the offsets decides (y first, then t and x).
        let mut offsets = levels.sets()[draw.set].offsets[..draw.taps].to_vec();
        offsets.sort_by_key(|offset| (offset.y, offset.z % size.z, offset.x));
        let subset: Vec<usize> = offsets
            .into_iter()
            .flat_map(|offset| {
                let place = (draw.pixel + offset).rem_euclid(size).as_usizevec3();
                let pixel = shape.pixel(place.x, place.y, place.z);
                (0..draw.samples).map(move |s| pixel * shape.spp() + s)
            })
            .collect();
        for direction in &draw.directions {
            let theta = &direction.theta[..shape.dims()];
            let targets = match &points {
                None => ProjectedDensity::new(theta).targets(subset.len()),
                Some(points) => points.targets(theta, subset.len()),
            };
            let projections: Vec<f64> = subset
                .iter()
                .map(|sample| {
                    let first = sample * shape.dims();
                    let point = &tile.samples()[first..first + shape.dims()];
                    point
                        .iter()
                        .zip(direction.theta)
                        .map(|(&x, theta)| f64::from(x) * f64::from(theta))
                        .sum()
                })
                .collect();
            let mut order: Vec<usize> = (0..subset.len()).collect();
            order.sort_by(|&a, &b| projections[a].total_cmp(&projections[b]));
            for (&place, target) in order.iter().zip(targets) {
                visit(subset[place], direction, target - projections[place]);
            }
        }
    }
}

/// Points of a domain, spread as evenly as a lattice of the golden ratio is in the square.
pub struct ManyPoints(Vec<f32>);

impl ManyPoints {
    /// How many they are.
    const COUNT: usize = 1 << 15;

    /// Of a domain that has its own dimensions.
    ///
    /// # Panics
    /// If it has any number of them.
    pub fn of(domain: Domain) -> Self {
        let dims = domain.dims().expect("a domain with dimensions");
        let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
        let mut points = vec![0.0; Self::COUNT * dims];
        for (i, point) in points.chunks_exact_mut(dims).enumerate() {
            let place = [(i as f64 + 0.5) / Self::COUNT as f64, (i as f64 * ratio).fract()];
            domain.point(&place, point);
        }
        Self(points)
    }

    /// Means of all projections between two ranks of `n`; off by 10⁻³ at most.
    pub fn targets(&self, theta: &[f32], n: usize) -> Vec<f64> {
        let project = |point: &[f32]| -> f64 {
            point.iter().zip(theta).map(|(&x, &theta)| f64::from(x) * f64::from(theta)).sum()
        };
        let mut all: Vec<f64> = self.0.chunks_exact(theta.len()).map(project).collect();
        all.sort_by(f64::total_cmp);
        let mean = |rank: usize| {
            let of_rank = &all[rank * all.len() / n..(rank + 1) * all.len() / n];
            of_rank.iter().sum::<f64>() / of_rank.len() as f64
        };
        (0..n).map(mean).collect()
    }
}

/// Unit roundoff of f32, 2⁻²⁴, and enough more for products of several of them.
pub const ROUNDOFF: f64 = 6e-8;

/// The distribution of θ·u for u uniform on the cube.
///
/// Up to its lower end it is that of Σ sideₖ·uₖ with positive sides. The volume of the cube below a
/// plane, Σ sideₖ·uₖ < x, is a sum over the corners of the box that has these sides, by inclusion
/// and exclusion: ± (x − corner)₊ᵈ / (d! Π sides), where a corner stands at the sum of the sides
/// that lead to it.
#[derive(Debug, Clone)]
pub struct ProjectedDensity {
    /// Magnitudes of the components of θ that are not 0, largest first.
    sides: Vec<f64>,
    /// Where the distribution begins.
    low: f64,
    /// Its length.
    length: f64,
    /// Number of sides of the box.
    dims: i32,
    /// Corners of the box: where they stand, lowest first, and ± 1 / (d! Π sides).
    corners: Vec<(f64, f64)>,
}

impl ProjectedDensity {
    /// Along a direction, of any length.
    pub fn new(theta: &[f32]) -> Self {
        // Terms are rounded to 16 digits. Where they add up to more than this, few digits of the CDF
        // would be left; the mean of the smallest side then stands for it. It is below 10⁻⁷ in two
        // dimensions and 10⁻⁴ in eight, and its square is what the CDF changes by.
        const LARGEST: f64 = 1e7;
        let mut sides: Vec<f64> =
            theta.iter().map(|x| f64::from(x.abs())).filter(|&side| side > 0.0).collect();
        sides.sort_by(|a, b| b.total_cmp(a));
        let mut found = Self {
            low: theta.iter().map(|&x| f64::from(x).min(0.0)).sum(),
            length: 0.0,
            dims: 0,
            corners: Vec::new(),
            sides: sides.clone(),
        };
        loop {
            found.dims = sides.len() as i32;
            found.length = sides.iter().sum();
            found.corners = corners(&sides);
            if found.terms(0.5 * found.length).map(f64::abs).sum::<f64>() < LARGEST {
                return found;
            }
            found.low += 0.5 * sides.pop().unwrap_or_default();
        }
    }

    /// The terms of the CDF at a distance from the lower end.
    fn terms(&self, x: f64) -> impl Iterator<Item = f64> {
        let below = self.corners.iter().take_while(move |(corner, _)| *corner < x);
        below.map(move |(corner, factor)| factor * (x - corner).powi(self.dims))
    }

    /// Where the CDF is `u` in its lower half, as a distance from the lower end; by bisection.
    fn lower_quantile(&self, u: f64) -> f64 {
        let (mut low, mut high) = (0.0, 0.5 * self.length);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if self.terms(middle).sum::<f64>() < u {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// The inverse CDF F⁻¹ at `u`, as a distance from the lower end, and its integral from 0 to `u`.
    fn inverse(&self, u: f64) -> (f64, f64) {
        if u > 0.5 {
            // The distribution is symmetric, and the terms are small in its lower half.
            let (mirror, rest) = self.inverse(1.0 - u);
            return (self.length - mirror, self.length * (u - 0.5) + rest);
        }
        let x = self.lower_quantile(u);
        (x, u * x - self.integral(0.0, x))
    }

    /// Integral of the CDF between two distances from the lower end.
    fn integral(&self, from: f64, to: f64) -> f64 {
        let below = self.corners.iter().take_while(|(corner, _)| *corner < to);
        below
            .map(|(corner, factor)| {
                // (bᵈ⁺¹ − aᵈ⁺¹) / (d + 1), written so that nothing cancels where both are near.
                let (a, b) = ((from - corner).max(0.0), to - corner);
                let (mut powers, mut power) = (0.0, 1.0);
                for _ in 0..=self.dims {
                    powers = powers * b + power;
                    power *= a;
                }
                factor * (b - a) * powers / f64::from(self.dims + 1)
            })
            .sum()
    }

    /// Targets of the ranks of a subset of `n` samples: means of the inverse CDF over
    /// [rank/n, (rank + 1)/n].
    pub fn targets(&self, n: usize) -> Vec<f64> {
        // The middle one of an odd number is the middle of the distribution.
        let mut targets = vec![self.low + 0.5 * self.length; n];
        let mut from = 0.0;
        for rank in 0..n / 2 {
            let to = self.lower_quantile((rank + 1) as f64 / n as f64);
            // ∫ F⁻¹ over [u, v] is v·x(v) − u·x(u) − ∫ F over [x(u), x(v)].
            let above = self.integral(from, to) - rank as f64 / n as f64 * (to - from);
            let mean = to - n as f64 * above;
            targets[rank] = self.low + mean;
            targets[n - 1 - rank] = self.low + self.length - mean;
            from = to;
        }
        targets
    }

    /// By how much fast targets may differ from [`Self::targets`], rank by rank: the most that their
    /// arithmetic can lose.
    ///
    /// In closed form, with S the length of the distribution:
    /// - 15 roundings of half of S below the middle, where a rank has both parts of F⁻¹;
    /// - 4 of S more for its mirror image above.
    ///
    /// From a table of c sides:
    /// - ½ + 2c roundings of S.
    /// - What the CDF loses. With one side, with two, up to c it is interpolated on a grid of step h.
    ///   No density has a larger slope than 1/ab, a and b the largest two sides, so each time costs
    ///   at most h²/8ab (the kink of one side's CDF costs that of two as much): δ in all. Then the
    ///   mean of F⁻¹ over [v, w] is off by at most δ (F⁻¹(w + δ) − F⁻¹(v − δ)) / (w − v). It is off
    ///   by no more than c steps either, because each interpolation lies between what is shifted by
    ///   a step to one side and to the other.
    /// - Up to as many samples as nodes, the chord. The integral of F⁻¹ is interpolated between
    ///   nodes, and because it is convex, it is too large at both ends of a rank's interval.
    pub fn slack(&self, n: usize) -> Vec<f64> {
        let (sides, count, nodes) = (self.sides.len() as f64, n as f64, NODES as f64);
        let length: f64 = self.sides.iter().sum();
        let [a, b, _, ..] = self.sides[..] else {
            return vec![12.0 * ROUNDOFF * length; n];
        };
        let step = length / GRID as f64;
        let delta = sides * step * step / (8.0 * a * b);
        // F⁻¹ before and after the end of an interval, and by how much the chord is too large there.
        let end = |edge: usize| {
            let u = edge as f64 / count;
            let (low, high) = ((u - delta).max(0.0), u + delta);
            if n > NODES {
                return (self.inverse(low).0, self.inverse(high).0, 0.0);
            }
            let (low, high) = ((low * nodes).floor() / nodes, (high * nodes).ceil() / nodes);
            let ((from, below), (to, above)) = (self.inverse(low), self.inverse(high));
            let chord = below + (above - below) * (u - low) / (high - low);
            (from, to, chord - self.inverse(u).1)
        };
        let mut slack = vec![0.0; n];
        let mut from = end(0);
        for rank in 0..n.div_ceil(2) {
            let to = end(rank + 1);
            let of_cdf = (count * delta * (to.1 - from.0)).min(sides * step);
            let of_chord = count * from.2.max(to.2);
            slack[rank] = (0.5 + 2.0 * sides) * ROUNDOFF * length + of_cdf + of_chord;
            slack[n - 1 - rank] = slack[rank];
            from = to;
        }
        slack
    }
}

/// The corners of a box as [`ProjectedDensity`] has them.
fn corners(sides: &[f64]) -> Vec<(f64, f64)> {
    let factorial: f64 = (1..=sides.len()).map(|k| k as f64).product();
    let factor = 1.0 / (factorial * sides.iter().product::<f64>());
    let mut corners = vec![(0.0, factor)];
    for side in sides {
        for i in 0..corners.len() {
            let (corner, factor) = corners[i];
            corners.push((corner + side, -factor));
        }
    }
    corners.sort_by(|a, b| a.0.total_cmp(&b.0));
    corners
}
