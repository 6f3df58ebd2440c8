//! How strongly a whole domain pulls at one of its points: the gradient of the mean distance from it.
//!
//! A distance is a mean over directions, |v| = c·E|θ·v| with c = π/2 in the plane and 2 in space. So
//! the gradient of the mean distance is c·E (2F(θ·x) − 1)θ, with F the CDF of projections on θ, which
//! every domain has. It is made once, for the points that its symmetry leaves apart.

use std::f64::consts::{FRAC_PI_2, PI};

use super::{Shape, Symmetry};

/// Intervals of a table.
const CELLS: usize = 256;
/// Directions that a mean is taken over, around and (in space) up.
const AROUND: usize = 128;
const UP: usize = 128;

/// The gradient of the mean distance from a domain to its points.
#[derive(Debug, Clone)]
pub struct Attraction {
    symmetry: Symmetry,
    /// At even steps of the distance from the middle (round domains) or of the last coordinate
    /// (axial ones): the part along the radius, as a share of the radius, and along the last axis.
    table: Vec<[f32; 2]>,
    mean: [f32; 3],
}

impl Attraction {
    pub(super) fn new(shape: &'static dyn Shape) -> Self {
        let symmetry = shape.symmetry();
        let node = |i: usize| {
            let at = i as f64 / CELLS as f64;
            match symmetry {
                // By symmetry there is none around the middle, and none along a sphere.
                _ if symmetry == Symmetry::Round && shape.surface().is_curved() => [0.0; 2],
                Symmetry::Round | Symmetry::Cube | Symmetry::None => {
                    let at = at.max(1e-3);
                    [(plane(shape, at) / (0.5 * at)) as f32, 0.0]
                }
                Symmetry::Axial => {
                    let radius = (1.0 - at * at).max(1e-6).sqrt();
                    let [along, up] = space(shape, [radius, at]);
                    [(along / (0.5 * radius)) as f32, up as f32]
                }
            }
        };
        let mean = shape.mean().map(|mean| (0.5 + 0.5 * mean) as f32);
        Self { symmetry, table: (0..=CELLS).map(node).collect(), mean }
    }

    /// Mean of all points, as a tile has them.
    #[inline(always)]
    pub fn mean(&self) -> [f32; 3] {
        self.mean
    }

    /// The gradient of the mean distance at a point, as a tile has it.
    #[inline(always)]
    pub fn gradient<const N: usize>(&self, point: [f32; N]) -> [f32; N] {
        let centred = point.map(|x| x - 0.5);
        let at = match self.symmetry {
            Symmetry::Axial => centred[N - 1],
            _ => centred.iter().map(|x| x * x).sum::<f32>().sqrt(),
        };
        let place = (2.0 * at).clamp(0.0, 1.0) * CELLS as f32;
        let node = (place as usize).min(CELLS - 1);
        let (low, high, f) = (self.table[node], self.table[node + 1], place - node as f32);
        let [along, up] = [0, 1].map(|k| low[k] + (high[k] - low[k]) * f);
        let mut gradient = centred.map(|x| x * along);
        if self.symmetry == Symmetry::Axial {
            gradient[N - 1] = up;
        }
        gradient
    }
}

/// At a distance from the middle of a round domain in the plane, along the radius.
fn plane(shape: &dyn Shape, radius: f64) -> f64 {
    let angles = (0..4 * AROUND).map(|i| PI * (i as f64 + 0.5) / (4 * AROUND) as f64);
    let pull = |angle: f64| {
        let cos = libm::cos(angle);
        (2.0 * shape.below([cos, libm::sin(angle), 0.0], radius * cos) - 1.0) * cos
    };
    FRAC_PI_2 * angles.map(pull).sum::<f64>() / (4 * AROUND) as f64
}

/// At a point of an axial domain in space, given its distance from the axis and its height: along the
/// radius and along the axis.
fn space(shape: &dyn Shape, [radius, height]: [f64; 2]) -> [f64; 2] {
    let mut sum = [0.0; 2];
    // Opposite directions pull alike.
    for up in (0..UP).map(|j| (j as f64 + 0.5) / UP as f64) {
        let flat = (1.0 - up * up).sqrt();
        for i in 0..AROUND {
            let cos = libm::cos(PI * (i as f64 + 0.5) / AROUND as f64);
            let pull = 2.0 * shape.below([0.0, 0.0, up], radius * flat * cos + height * up) - 1.0;
            sum[0] += pull * flat * cos;
            sum[1] += pull * up;
        }
    }
    sum.map(|sum| 2.0 * sum / (UP * AROUND) as f64)
}
