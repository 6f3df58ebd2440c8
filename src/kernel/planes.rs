//! A kernel as whole pictures are filtered with it: a few planes of weights, and the frames that use
//! them.
//!
//! Most kernels are a product of space and time: every frame has the same plane but for a factor,
//! and the plane is a column times a row. Filtering then takes a row, a column and a number for
//! each frame, and not a sum over all taps.

use glam::IVec3;
use serde::Serialize;

use super::KernelTaps;

/// Part of the largest weight by which planes may differ that count as proportional.
const TOLERANCE: f64 = 1e-6;
/// Most weights of all planes together.
const MAX_WEIGHTS: usize = 1 << 17;

/// A kernel as planes and slices: the tap (dx, dy, dt) weighs `scale` × the plane's weight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KernelPlanes {
    /// Σg².
    pub power: f64,
    /// Each but for a factor.
    pub planes: Vec<Plane>,
    /// One for each frame with taps, from the past to the newest.
    pub slices: Vec<KernelFrame>,
}

/// Weights of one frame's offsets from (x, y) on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plane {
    /// Offset of the first column, in pixels.
    pub x: i32,
    /// Offset of the first row.
    pub y: i32,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// With `column`, the factors of the weights, if they have them.
    pub row: Option<Vec<f64>>,
    /// See `row`.
    pub column: Option<Vec<f64>>,
    /// Row by row.
    pub weights: Vec<f64>,
}

/// One frame of the kernel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KernelFrame {
    /// Offset of the frame; the past is negative.
    pub dt: i32,
    /// Index of its plane.
    pub plane: usize,
    /// What the plane's weights are multiplied by.
    pub scale: f64,
}

impl KernelPlanes {
    /// Takes a kernel apart; `None` if its planes have more than 131,072 weights.
    pub fn of(kernel: &KernelTaps) -> Option<Self> {
        let mut taps: Vec<_> = kernel.taps().to_vec();
        taps.sort_by_key(|tap| tap.offset.z);
        let mut planes: Vec<Plane> = Vec::new();
        let mut slices = Vec::new();
        let mut left = MAX_WEIGHTS;
        for frame in taps.chunk_by(|a, b| a.offset.z == b.offset.z) {
            let (low, high) = frame.iter().fold((IVec3::MAX, IVec3::MIN), |(low, high), tap| {
                (low.min(tap.offset), high.max(tap.offset))
            });
            let width = high.x.abs_diff(low.x) as usize + 1;
            let height = high.y.abs_diff(low.y) as usize + 1;
            if width.checked_mul(height).is_none_or(|size| size > MAX_WEIGHTS) {
                return None;
            }
            let mut weights = vec![0.0; width * height];
            for tap in frame {
                let (x, y) = (tap.offset.x.abs_diff(low.x), tap.offset.y.abs_diff(low.y));
                weights[y as usize * width + x as usize] = tap.weight;
            }
            let plane =
                Plane { x: low.x, y: low.y, width, height, row: None, column: None, weights };
            let dt = low.z;
            let known = planes.iter().enumerate().find_map(|(i, known)| {
                plane.relative_to(known).map(|scale| KernelFrame { dt, plane: i, scale })
            });
            slices.push(match known {
                Some(slice) => slice,
                None => {
                    left = left.checked_sub(width * height)?;
                    planes.push(plane);
                    KernelFrame { dt, plane: planes.len() - 1, scale: 1.0 }
                }
            });
        }
        for plane in &mut planes {
            (plane.column, plane.row) = plane.factors().unzip();
        }
        Some(Self { power: kernel.power(), planes, slices })
    }
}

impl Plane {
    /// The factor by which the weights differ from another plane's, if they are proportional.
    fn relative_to(&self, other: &Self) -> Option<f64> {
        let place = |plane: &Self| (plane.x, plane.y, plane.width, plane.height);
        let peak = other.peak();
        let scale = self.weights.get(peak)? / other.weights[peak];
        let tolerance = TOLERANCE * self.weights.get(self.peak())?.abs();
        let close = |(a, b): (&f64, &f64)| (a - scale * b).abs() <= tolerance;
        let same = place(self) == place(other);
        (same && self.weights.iter().zip(&other.weights).all(close)).then_some(scale)
    }

    /// A column and a row whose product is the plane.
    fn factors(&self) -> Option<(Vec<f64>, Vec<f64>)> {
        let peak = self.peak();
        let (x, y) = (peak % self.width, peak / self.width);
        let largest = self.weights[peak];
        let column: Vec<f64> = self.weights.iter().skip(x).step_by(self.width).copied().collect();
        let row: Vec<f64> = self.weights[y * self.width..][..self.width]
            .iter()
            .map(|weight| weight / largest)
            .collect();
        let rows = self.weights.chunks_exact(self.width).zip(&column);
        let close = |(weights, c): (&[f64], &f64)| {
            weights.iter().zip(&row).all(|(w, r)| (w - c * r).abs() <= TOLERANCE * largest.abs())
        };
        rows.into_iter().all(close).then_some((column, row))
    }

    /// Where the weight of the largest magnitude is.
    fn peak(&self) -> usize {
        let larger = |best: usize, i: usize| {
            if self.weights[i].abs() > self.weights[best].abs() { i } else { best }
        };
        (0..self.weights.len()).fold(0, larger)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use proptest::prelude::*;

    use super::*;
    use crate::kernel::{KernelSpec, Tap};

    fn taps(text: &str) -> KernelTaps {
        let spec: KernelSpec = text.parse().unwrap();
        spec.resolve_without_tile().unwrap().classes()[0].taps.clone()
    }

    /// Every tap is what the planes say, and they say nothing else.
    fn check(kernel: &KernelTaps, planes: &KernelPlanes) {
        let mut left: HashMap<IVec3, f64> =
            kernel.taps().iter().map(|tap| (tap.offset, tap.weight)).collect();
        let peak = kernel.taps()[0].weight.abs();
        let close = |a: f64, b: f64| (a - b).abs() <= 2e-6 * peak;
        for slice in &planes.slices {
            let plane = &planes.planes[slice.plane];
            for (i, &weight) in plane.weights.iter().enumerate() {
                let (x, y) = (i % plane.width, i / plane.width);
                let offset = IVec3::new(plane.x + x as i32, plane.y + y as i32, slice.dt);
                let expected = left.remove(&offset).unwrap_or(0.0);
                assert!(close(slice.scale * weight, expected), "{offset}");
                if let (Some(column), Some(row)) = (&plane.column, &plane.row) {
                    assert!(close(slice.scale * column[y] * row[x], expected), "{offset}");
                }
            }
        }
        assert!(left.is_empty());
        assert_eq!(planes.power, kernel.power());
    }

    #[test]
    fn a_product_of_space_and_time_is_one_separable_plane() {
        let kernel = taps("gaussian(2.1) * fovvideovdp(60) @ 7x7x8");
        let planes = KernelPlanes::of(&kernel).unwrap();
        check(&kernel, &planes);
        assert_eq!((planes.planes.len(), planes.slices.len()), (1, 8));
        let plane = &planes.planes[0];
        assert_eq!((plane.x, plane.y, plane.width, plane.height), (-3, -3, 7, 7));
        assert!(plane.row.is_some() && plane.column.is_some());
        assert_eq!(planes.slices.iter().map(|s| s.dt).collect::<Vec<_>>(), Vec::from_iter(-7..=0));
        assert!(planes.slices[0].scale * plane.weights[24] < 0.0);
    }

    #[test]
    fn a_round_kernel_is_not_separable() {
        let kernel = taps("gaussian(2.1) * ema(0.5) @ 80%");
        let planes = KernelPlanes::of(&kernel).unwrap();
        check(&kernel, &planes);
        assert!(planes.planes.len() > 1);
        assert!(planes.planes.iter().any(|plane| plane.row.is_none() && plane.column.is_none()));
    }

    #[test]
    fn planes_beyond_measure_are_refused_before_they_are_made() {
        let tap = |x, y, t| Tap { offset: IVec3::new(x, y, t), weight: 1.0 };
        let far = [tap(i32::MIN, 0, 0), tap(i32::MAX, 7, 0)];
        assert_eq!(KernelPlanes::of(&KernelTaps::new(far).unwrap()), None);
        // Each of these planes is small enough, and none like another.
        let many = (0..4).flat_map(|t| [tap(0, 0, t), tap(199, 199 + t, t)]);
        assert_eq!(KernelPlanes::of(&KernelTaps::new(many).unwrap()), None);
    }

    proptest! {
        #[test]
        fn planes_and_slices_are_the_kernel(
            rows in prop::collection::vec(-1.0..1.0, 1..4),
            columns in prop::collection::vec(-1.0..1.0, 1..4),
            times in prop::collection::vec(-1.0..1.0, 1..4),
            odd in prop::option::of((0..3_i32, 0..3_i32, 0..3_i32, 0.1..1.0)),
        ) {
            let mut weights: HashMap<IVec3, f64> = HashMap::new();
            for (t, c) in times.iter().enumerate() {
                for (y, b) in columns.iter().enumerate() {
                    for (x, a) in rows.iter().enumerate() {
                        let offset = IVec3::new(x as i32 - 1, y as i32, -(t as i32));
                        weights.insert(offset, a * b * c);
                    }
                }
            }
            if let Some((x, y, t, weight)) = odd {
                *weights.entry(IVec3::new(x - 1, y, -t)).or_default() += weight;
            }
            let kernel = weights.iter().map(|(&offset, &weight)| Tap { offset, weight });
            let Ok(kernel) = KernelTaps::new(kernel) else { return Ok(()) };
            let planes = KernelPlanes::of(&kernel).unwrap();
            check(&kernel, &planes);
            prop_assert!(odd.is_some() || planes.planes.len() == 1);
        }
    }
}
