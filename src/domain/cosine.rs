//! Unit vectors above a surface with a density of z/π, as light falls on a matt one.
//!
//! The density of projections is the integral of the height over the part of a circle that
//! [`hemisphere`](super::hemisphere) has the length of; its own integral has a closed form as well.

use std::f64::consts::PI;

use super::disk::{concentric, square};
use super::hemisphere::{half_angle, mirrored};
use super::{Shape, Surface, Symmetry};

/// The upper half of the unit sphere in proportion to its height.
pub(super) struct Cosine;

impl Shape for Cosine {
    fn dims(&self) -> usize {
        3
    }

    fn symmetry(&self) -> Symmetry {
        Symmetry::Axial
    }

    fn surface(&'static self) -> Surface {
        Surface::Hemisphere
    }

    fn point(&self, place: [f64; 2]) -> [f64; 3] {
        // A point of the disk, lifted (Malley).
        let [x, y] = concentric(place);
        [x, y, (1.0 - x * x - y * y).max(0.0).sqrt()]
    }

    fn place(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        square(x, y)
    }

    fn below(&self, [_, _, axis]: [f64; 3], t: f64) -> f64 {
        mirrored(axis, t, |c, t| {
            let s = (1.0 - c * c).max(0.0).sqrt();
            if t <= -s {
                0.0
            } else if t >= s {
                1.0 - c * (1.0 - t.min(1.0) * t.min(1.0))
            } else {
                let root = (s * s - t * t).sqrt();
                let lifted = c * (1.0 - t * t) * half_angle(c, s, t);
                0.5 + (libm::asin(t / s) + t * root - lifted) / PI
            }
        })
    }

    fn mean(&self) -> [f64; 3] {
        [0.0, 0.0, 2.0 / 3.0]
    }

    fn variances(&self) -> [f64; 3] {
        [0.25, 0.25, 1.0 / 18.0]
    }
}
