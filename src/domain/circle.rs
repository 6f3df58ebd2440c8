//! Unit vectors in the plane, for angles that have no beginning: a rotation, a direction of a streak.
//!
//! A projection is the cosine of a uniform angle: the arcsine distribution.

use std::f64::consts::{PI, TAU};

use super::{Shape, Surface, Symmetry};

/// The unit circle.
pub(super) struct Circle;

impl Shape for Circle {
    fn dims(&self) -> usize {
        2
    }

    fn parameters(&self) -> usize {
        1
    }

    fn symmetry(&self) -> Symmetry {
        Symmetry::Round
    }

    fn surface(&'static self) -> Surface {
        Surface::Sphere
    }

    fn point(&self, [u, _]: [f64; 2]) -> [f64; 3] {
        let (sin, cos) = libm::sincos(TAU * u);
        [cos, sin, 0.0]
    }

    fn place(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        [turn(x, y), 0.0]
    }

    fn below(&self, _: [f64; 3], t: f64) -> f64 {
        1.0 - libm::acos(t.clamp(-1.0, 1.0)) / PI
    }

    fn mean(&self) -> [f64; 3] {
        [0.0; 3]
    }

    fn variances(&self) -> [f64; 3] {
        [0.5, 0.5, 0.0]
    }
}

/// The angle of a point in turns, in [0, 1).
pub(super) fn turn(x: f64, y: f64) -> f64 {
    let turn = libm::atan2(y, x) / TAU;
    if turn < 0.0 { (turn + 1.0).min(1.0 - f64::EPSILON) } else { turn }
}
