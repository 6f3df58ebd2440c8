//! How a sample that was moved comes back to its domain, in single precision and the same on every
//! machine: sums, one root and one division, all of them rounded as IEEE 754 says.

use super::mask::Mask;
use crate::tile::clamp_coordinate;

/// How samples that were moved come back, in a cube of side 1; round ones have a radius of ½ around its middle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// Each coordinate by itself, into [0, 1).
    Cube,
    /// The same, then along the empty pixels of a picture.
    Mask(&'static Mask),
    /// From outside of a disk or ball straight to its border.
    Ball,
    /// Straight to the circle or sphere.
    Sphere,
    /// The same, from below the surface up to it first.
    Hemisphere,
}

impl Surface {
    /// Whether samples can move in a tangent only.
    #[inline(always)]
    pub fn is_curved(self) -> bool {
        matches!(self, Self::Sphere | Self::Hemisphere)
    }

    /// Whether a ball of radius ½ holds all of it.
    #[inline(always)]
    pub fn is_round(self) -> bool {
        !matches!(self, Self::Cube | Self::Mask(_))
    }

    /// Brings `L` points back, which have a plane of coordinates for each dimension.
    ///
    /// Plane after plane and without branches, so that it becomes instructions for many points.
    #[inline(always)]
    pub fn bring_back<const N: usize, const L: usize>(self, points: &mut [[f32; L]; N]) {
        /// Points that are nearer to the middle have no direction that could be trusted.
        const LEAST: f32 = 1e-12;
        if self.is_round() {
            let mut squares = [0.0; L];
            for (k, plane) in points.iter_mut().enumerate() {
                let is_last = k == N - 1;
                for (x, square) in plane.iter_mut().zip(&mut squares) {
                    *x -= 0.5;
                    if self == Self::Hemisphere && is_last {
                        *x = x.max(0.0);
                    }
                    *square += *x * *x;
                }
            }
            for (k, plane) in points.iter_mut().enumerate() {
                let lost = if k == N - 1 { 0.5 } else { 0.0 };
                for (x, &square) in plane.iter_mut().zip(&squares) {
                    let by = 0.5 / square.max(LEAST).sqrt();
                    *x = if self == Self::Ball {
                        *x * by.min(1.0)
                    } else if square < LEAST {
                        lost
                    } else {
                        *x * by
                    };
                    *x += 0.5;
                }
            }
        }
        for plane in &mut *points {
            plane.iter_mut().for_each(|x| *x = clamp_coordinate(*x));
        }
        if let (Self::Mask(mask), [xs, ys, ..]) = (self, &mut points[..]) {
            for (x, y) in xs.iter_mut().zip(ys) {
                [*x, *y] = mask.bring_back([*x, *y]);
            }
        }
    }

    /// Brings one point back that was moved from where it was before, of `dims` coordinates.
    #[inline(always)]
    pub fn settle(self, before: &[f32], point: &mut [f32], dims: usize) {
        match (self, before, &mut *point) {
            (Self::Mask(mask), &[from_x, from_y], [x, y]) => {
                let to = [clamp_coordinate(*x), clamp_coordinate(*y)];
                [*x, *y] = mask.settle([from_x, from_y], to);
            }
            _ => self.bring_all_back(point, dims),
        }
    }

    /// Brings back all points of a slice, which have `dims` coordinates each.
    pub fn bring_all_back(self, samples: &mut [f32], dims: usize) {
        match (self, dims) {
            (Self::Cube, _) => samples.iter_mut().for_each(|x| *x = clamp_coordinate(*x)),
            (_, 2) => {
                let points = samples.as_chunks_mut::<2>().0;
                points.iter_mut().for_each(|point| self.bring_one_back(point));
            }
            _ => {
                let points = samples.as_chunks_mut::<3>().0;
                points.iter_mut().for_each(|point| self.bring_one_back(point));
            }
        }
    }

    #[inline(always)]
    fn bring_one_back<const N: usize>(self, point: &mut [f32; N]) {
        let mut planes = point.map(|x| [x]);
        self.bring_back(&mut planes);
        *point = planes.map(|[x]| x);
    }

    /// Takes from gradients on `L` points what does not lead along the surface; both have a plane for
    /// each dimension.
    #[inline(always)]
    pub fn flatten<const N: usize, const L: usize>(
        self,
        points: &[[f32; L]; N],
        gradients: &mut [[f32; L]; N],
    ) {
        if !self.is_curved() {
            return;
        }
        // Centred, a point is half its normal.
        let mut away = [0.0; L];
        for (plane, gradients) in points.iter().zip(&*gradients) {
            for lane in 0..L {
                away[lane] += 4.0 * ((plane[lane] - 0.5) * gradients[lane]);
            }
        }
        for (plane, gradients) in points.iter().zip(gradients) {
            for lane in 0..L {
                gradients[lane] -= away[lane] * (plane[lane] - 0.5);
            }
        }
    }
}
