//! Unit vectors above a surface, evenly: the sky.
//!
//! With θ at an angle to the axis whose sine is s and cosine c, the points with θ·x = t lie on a
//! circle, of which the part with cos ψ > −ct / (s√(1 − t²)) is above the surface. By Archimedes all
//! circles have the same weight in dt dψ, so the density of projections is the length of that part,
//! whose integral has a closed form.

use std::f64::consts::PI;

use super::disk::{concentric, square};
use super::{Shape, Surface, Symmetry};

/// The upper half of the unit sphere, evenly.
pub(super) struct Hemisphere;

impl Shape for Hemisphere {
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
        // Lambert's equal-area projection, backwards from a concentric disk.
        let [x, y] = concentric(place);
        let square = (x * x + y * y).min(1.0);
        let stretch = (2.0 - square).sqrt();
        [x * stretch, y * stretch, 1.0 - square]
    }

    fn place(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        let stretch = (1.0 + z.max(0.0)).sqrt();
        square(x / stretch, y / stretch)
    }

    fn below(&self, [_, _, axis]: [f64; 3], t: f64) -> f64 {
        mirrored(axis, t, |c, t| {
            let s = (1.0 - c * c).max(0.0).sqrt();
            if t <= -s {
                0.0
            } else if t >= s {
                t.min(1.0)
            } else {
                let root = (s * s - t * t).sqrt();
                (t * half_angle(c, s, t) + libm::atan2(root, c)) / PI
            }
        })
    }

    fn mean(&self) -> [f64; 3] {
        [0.0, 0.0, 0.5]
    }

    fn variances(&self) -> [f64; 3] {
        [1.0 / 3.0, 1.0 / 3.0, 1.0 / 12.0]
    }
}

/// Half the angle of the part of the circle θ·x = `t` that is above the surface, for |t| < s.
pub(super) fn half_angle(c: f64, s: f64, t: f64) -> f64 {
    libm::acos((-c * t / (s * (1.0 - t * t).sqrt())).clamp(-1.0, 1.0))
}

/// A distribution that is known for directions with an axial component of 0 and more.
pub(super) fn mirrored(axis: f64, t: f64, upper: impl Fn(f64, f64) -> f64) -> f64 {
    let axis = axis.clamp(-1.0, 1.0);
    let share = if axis >= 0.0 { upper(axis, t) } else { 1.0 - upper(-axis, -t) };
    share.clamp(0.0, 1.0)
}
