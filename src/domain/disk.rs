//! The disk, filled evenly: places on a lens.
//!
//! A projection has Wigner's semicircle as its density. The map from the square is the concentric one
//! of Shirley and Chiu (1997), which keeps neighbours together; behind the map by radius and angle
//! edges of a tile are a fifth worse.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use super::{Shape, Surface, Symmetry};

/// The unit disk.
pub(super) struct Disk;

impl Shape for Disk {
    fn dims(&self) -> usize {
        2
    }

    fn symmetry(&self) -> Symmetry {
        Symmetry::Round
    }

    fn surface(&'static self) -> Surface {
        Surface::Ball
    }

    fn point(&self, place: [f64; 2]) -> [f64; 3] {
        let [x, y] = concentric(place);
        [x, y, 0.0]
    }

    fn place(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        square(x, y)
    }

    fn below(&self, _: [f64; 3], t: f64) -> f64 {
        let t = t.clamp(-1.0, 1.0);
        0.5 + (t * (1.0 - t * t).sqrt() + libm::asin(t)) / PI
    }

    fn within(&self, [x, y, _]: [f64; 3], distance: f64) -> f64 {
        lens((x * x + y * y).sqrt(), distance) / PI
    }

    fn mean(&self) -> [f64; 3] {
        [0.0; 3]
    }

    fn variances(&self) -> [f64; 3] {
        [0.25, 0.25, 0.0]
    }
}

/// The point of the unit disk on the same of many concentric squares, turned into circles.
pub(super) fn concentric(place: [f64; 2]) -> [f64; 2] {
    let [a, b] = place.map(|u| 2.0 * u - 1.0);
    let (radius, angle) = if a.abs() > b.abs() {
        (a, FRAC_PI_4 * b / a)
    } else if b == 0.0 {
        return [0.0; 2];
    } else {
        (b, FRAC_PI_2 - FRAC_PI_4 * a / b)
    };
    let (sin, cos) = libm::sincos(angle);
    [radius * cos, radius * sin]
}

/// The place in the square of a point of the disk: the inverse of [`concentric`].
pub(super) fn square(x: f64, y: f64) -> [f64; 2] {
    let radius = (x * x + y * y).sqrt().min(1.0);
    let angle = libm::atan2(y, x);
    // Which of the four wedges it is in, and where from edge (−1) to edge (1) of that.
    let wedge = ((angle + FRAC_PI_4) / FRAC_PI_2).floor();
    let across = (angle - wedge * FRAC_PI_2) / FRAC_PI_4 * radius;
    let [a, b] = match (wedge as i32).rem_euclid(4) {
        0 => [radius, across],
        1 => [-across, radius],
        2 => [-radius, -across],
        _ => [across, -radius],
    };
    [a, b].map(|x| (0.5 + 0.5 * x).clamp(0.0, 1.0))
}

/// The area that the unit disk has in common with a disk of another radius, `distance` away.
fn lens(distance: f64, radius: f64) -> f64 {
    if radius <= 0.0 || distance >= 1.0 + radius {
        return 0.0;
    }
    if distance + radius.min(1.0) <= radius.max(1.0) {
        return PI * radius.min(1.0) * radius.min(1.0);
    }
    // Where the chord through both intersections stands, seen from either centre.
    let one = (distance * distance + 1.0 - radius * radius) / (2.0 * distance);
    let other = distance - one;
    let segment = |radius: f64, away: f64| {
        let height = (radius * radius - away * away).max(0.0).sqrt();
        radius * radius * libm::acos((away / radius).clamp(-1.0, 1.0)) - away * height
    };
    segment(1.0, one) + segment(radius, other)
}
