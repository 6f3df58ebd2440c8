//! Unit vectors in space: directions to a light that is everywhere, or of scattering.
//!
//! A projection is uniform (Archimedes), and the perceived error of all caps together is an energy of
//! chords (Stolarsky 1973), which is what the polish descends.

use std::f64::consts::TAU;

use super::circle::turn;
use super::{Shape, Surface, Symmetry};

/// The unit sphere.
pub(super) struct Sphere;

impl Shape for Sphere {
    fn dims(&self) -> usize {
        3
    }

    fn symmetry(&self) -> Symmetry {
        Symmetry::Round
    }

    fn surface(&'static self) -> Surface {
        Surface::Sphere
    }

    fn point(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let z = 1.0 - 2.0 * v;
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = libm::sincos(TAU * u);
        [radius * cos, radius * sin, z]
    }

    fn place(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        [turn(x, y), (0.5 - 0.5 * z).clamp(0.0, 1.0)]
    }

    fn has_uniform_projections(&self) -> bool {
        true
    }

    fn below(&self, _: [f64; 3], t: f64) -> f64 {
        0.5 + 0.5 * t.clamp(-1.0, 1.0)
    }

    fn mean(&self) -> [f64; 3] {
        [0.0; 3]
    }

    fn variances(&self) -> [f64; 3] {
        [1.0 / 3.0; 3]
    }
}
