//! How strongly a whole domain pulls at a sample in the polish: the gradient of the mean distance from
//! the domain, and on the square those of single coordinates.

use std::f64::consts::FRAC_PI_2;

use super::picture::Picture;
use super::{Attraction, Cdf, Shape};

/// What pulls at samples of a domain.
#[derive(Debug, Clone)]
pub enum Pull {
    /// The even square, or all pairs of a cube's dimensions.
    Even(Even),
    /// A density on the square.
    Uneven(Uneven),
    /// Any other domain, by chords.
    Chords(Attraction),
}

/// What pulls at points of the square.
pub trait Plane {
    /// Whether a difference of coordinates is the share between them.
    const IS_EVEN: bool;

    /// Along each axis, how dense coordinates are, relative to the mean over all of them.
    fn densities(&self, point: [f32; 2]) -> [f32; 2];

    /// The gradient of the mean distance from the density to a point.
    fn gradient(&self, point: [f32; 2]) -> [f32; 2];

    /// Along each axis the gradients of the mean share between coordinates, relative to their mean
    /// density, times `axis`, and of the mean of half their squared distance, times `linear`.
    fn sides(&self, point: [f32; 2], axis: f32, linear: f32) -> [f32; 2];
}

/// Intervals of a grid over the square along each axis.
const CELLS: usize = 256;

/// The even square.
#[derive(Debug, Clone)]
pub struct Even {
    /// Along x; along y it is the transpose.
    grid: Vec<f32>,
}

impl Even {
    pub(super) fn new() -> Self {
        let at = |i: usize| i as f64 / CELLS as f64;
        let grid = (0..=CELLS)
            .flat_map(|j| {
                (0..=CELLS).map(move |i| {
                    (distances_to_side(at(i), at(j)) - distances_to_side(1.0 - at(i), at(j))) as f32
                })
            })
            .collect();
        Self { grid }
    }
}

impl Plane for Even {
    const IS_EVEN: bool = true;

    #[inline(always)]
    fn densities(&self, _: [f32; 2]) -> [f32; 2] {
        [1.0; 2]
    }

    #[inline(always)]
    fn gradient(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let cells = CELLS as f32;
        let (px, py) = (x.clamp(0.0, 1.0) * cells, y.clamp(0.0, 1.0) * cells);
        [bilinear(&self.grid, px, py), bilinear(&self.grid, py, px)]
    }

    #[inline(always)]
    fn sides(&self, point: [f32; 2], axis: f32, linear: f32) -> [f32; 2] {
        let away = axis + 0.5 * linear;
        point.map(|x| away * (2.0 * x - 1.0))
    }
}

/// ∫₀¹ √(x² + (y − v)²) dv: the distances from (x, y) to the points of the side at x = 0. The
/// gradient of the mean distance to the square is the difference of two opposite sides.
fn distances_to_side(x: f64, y: f64) -> f64 {
    let part = |s: f64| {
        let root = (x * x + s * s).sqrt();
        let log = if x > 0.0 { x * x * libm::asinh(s / x) } else { 0.0 };
        0.5 * (s * root + log)
    };
    part(y) + part(1.0 - y)
}

/// A density on the square.
#[derive(Debug, Clone)]
pub struct Uneven {
    /// Along x and along y.
    grids: [Vec<f32>; 2],
    /// For each axis the share below, at even steps.
    marginals: [Vec<f32>; 2],
    /// For each axis the density between these, relative to the mean over samples.
    densities: [Vec<f32>; 2],
    mean: [f32; 2],
}

impl Uneven {
    /// A distance in the plane is a mean over directions, |v| = π/2 E|θ·v|, so its gradient is
    /// π/2 E (2F(θ·x) − 1)θ with the CDF of projections.
    pub(super) fn new(picture: &Picture) -> Self {
        /// Directions of the mean.
        const DIRECTIONS: usize = 256;
        let mut sums = [0, 1].map(|_| vec![0.0; (CELLS + 1) * (CELLS + 1)]);
        let at = |i: usize| i as f64 / CELLS as f64 - 0.5;
        for i in 0..DIRECTIONS {
            let angle = std::f64::consts::PI * (i as f64 + 0.5) / DIRECTIONS as f64;
            let (sin, cos) = libm::sincos(angle);
            let cdf: Cdf = picture.cdf([cos, sin, 0.0]);
            let [along_x, along_y] = &mut sums;
            let nodes = along_x.iter_mut().zip(along_y);
            for (node, (along_x, along_y)) in nodes.enumerate() {
                let (x, y) = (at(node % (CELLS + 1)), at(node / (CELLS + 1)));
                let pull = 2.0 * cdf.at(cos * x + sin * y) - 1.0;
                *along_x += pull * cos;
                *along_y += pull * sin;
            }
        }
        let scale = FRAC_PI_2 / DIRECTIONS as f64;
        let single =
            |values: &[f64], scale: f64| values.iter().map(|x| (x * scale) as f32).collect();
        let densities = picture.marginals().map(|shares| {
            let rises: Vec<f64> = shares.windows(2).map(|ends| ends[1] - ends[0]).collect();
            let mean: f64 = rises.iter().map(|rise| rise * rise).sum();
            single(&rises, 1.0 / mean)
        });
        Self {
            densities,
            grids: sums.map(|sums| single(&sums, scale)),
            marginals: picture.marginals().map(|shares| single(shares, 1.0)),
            mean: picture.mean_point().map(|x| x as f32),
        }
    }
}

impl Plane for Uneven {
    const IS_EVEN: bool = false;

    #[inline(always)]
    fn densities(&self, point: [f32; 2]) -> [f32; 2] {
        std::array::from_fn(|k| self.densities[k][node(&self.marginals[k], point[k]).0])
    }

    #[inline(always)]
    fn gradient(&self, point: [f32; 2]) -> [f32; 2] {
        let [px, py] = point.map(|x| x.clamp(0.0, 1.0) * CELLS as f32);
        [bilinear(&self.grids[0], px, py), bilinear(&self.grids[1], px, py)]
    }

    #[inline(always)]
    fn sides(&self, point: [f32; 2], axis: f32, linear: f32) -> [f32; 2] {
        std::array::from_fn(|k| {
            let shares = &self.marginals[k];
            let (node, past) = node(shares, point[k]);
            let below = shares[node] + (shares[node + 1] - shares[node]) * past;
            axis * self.densities[k][node] * (2.0 * below - 1.0)
                + linear * (point[k] - self.mean[k])
        })
    }
}

/// The node of a marginal that is before a coordinate, and how far past it that is.
#[inline(always)]
fn node(shares: &[f32], x: f32) -> (usize, f32) {
    // Exact, so that the last coordinate of a pixel is not taken for one of the next.
    let place = f64::from(x.clamp(0.0, 1.0)) * (shares.len() - 1) as f64;
    let node = (place as usize).min(shares.len() - 2);
    (node, (place - node as f64) as f32)
}

/// Of a grid over the square, in its cells' units.
#[inline(always)]
fn bilinear(grid: &[f32], x: f32, y: f32) -> f32 {
    let (i, j) = ((x as usize).min(CELLS - 1), (y as usize).min(CELLS - 1));
    let (fx, fy) = (x - i as f32, y - j as f32);
    let at = |i: usize, j: usize| grid[j * (CELLS + 1) + i];
    let low = at(i, j) + (at(i + 1, j) - at(i, j)) * fx;
    let high = at(i, j + 1) + (at(i + 1, j + 1) - at(i, j + 1)) * fx;
    low + (high - low) * fy
}
