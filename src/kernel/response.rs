//! The frequency response |ĝ| of a kernel: how much of each frequency of error is seen.

use glam::IVec3;

use crate::kernel::taps::{KernelTaps, Tap};

/// |ĝ| on a plane of frequencies, as the discrete Fourier transform of the taps padded with zeros.
///
/// Column i has the frequency (i − ⌊columns/2⌋)/columns and row j likewise, so frequency 0 is in
/// the middle. The pads may be smaller than the kernel: the values are exact all the same.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// Number of frequencies across.
    pub columns: usize,
    /// Number of frequencies down.
    pub rows: usize,
    /// Magnitudes, row by row.
    pub magnitude: Vec<f64>,
}

impl Response {
    /// |ĝ(f_x, f_y)| at temporal frequency 0, in cycles per pixel: error that stays.
    pub fn spatial(taps: &KernelTaps, columns: usize, rows: usize) -> Self {
        Self::of(taps, columns, rows, |offset| (offset.x, offset.y))
    }

    /// |ĝ(f_x, f_t)| at vertical frequency 0: cycles per pixel across, cycles per frame down.
    pub fn space_time(taps: &KernelTaps, columns: usize, rows: usize) -> Self {
        Self::of(taps, columns, rows, |offset| (offset.x, offset.z))
    }

    /// The transform of the taps, summed along the axis that `plane` leaves out.
    fn of(
        taps: &KernelTaps,
        columns: usize,
        rows: usize,
        plane: impl Fn(IVec3) -> (i32, i32),
    ) -> Self {
        let (low, high) = taps.bounds();
        let ((left, top), (right, bottom)) = (plane(low), plane(high));
        let height = bottom.abs_diff(top) as usize + 1;
        let width = right.abs_diff(left) as usize + 1;
        let mut sums = vec![0.0; width * height];
        for &Tap { offset, weight } in taps.taps() {
            let (x, y) = plane(offset);
            sums[y.abs_diff(top) as usize * width + x.abs_diff(left) as usize] += weight;
        }
        // Along x, then along y. The first offset is taken as 0, which turns phases only.
        let (across, down) = (Phases::new(columns), Phases::new(rows));
        let mut half = vec![(0.0, 0.0); columns * height];
        for y in 0..height {
            for i in 0..columns {
                let row = &sums[y * width..][..width];
                half[y * columns + i] = row.iter().enumerate().fold((0.0, 0.0), |sum, (x, &w)| {
                    let (cos, sin) = across.at(i, x);
                    (sum.0 + w * cos, sum.1 - w * sin)
                });
            }
        }
        let mut magnitude = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let (re, im) = (0..height).fold((0.0, 0.0), |sum, y| {
                    let (re, im) = half[y * columns + i];
                    let (cos, sin) = down.at(j, y);
                    (sum.0 + re * cos + im * sin, sum.1 + im * cos - re * sin)
                });
                magnitude.push(libm::sqrt(re * re + im * im));
            }
        }
        Self { columns, rows, magnitude }
    }
}

/// cos and sin of 2πk/n.
struct Phases(Vec<(f64, f64)>);

impl Phases {
    fn new(n: usize) -> Self {
        let phase = |k: usize| {
            let angle = std::f64::consts::TAU * k as f64 / n as f64;
            (libm::cos(angle), libm::sin(angle))
        };
        Self((0..n).map(phase).collect())
    }

    /// At frequency number `i`, of which the middle one is 0, and offset `x`.
    fn at(&self, i: usize, x: usize) -> (f64, f64) {
        let n = self.0.len();
        self.0[(i + n - n / 2) % n * (x % n) % n]
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;

    use super::*;
    use crate::kernel::KernelSpec;

    fn taps(spec: &str) -> KernelTaps {
        let kernel = spec.parse::<KernelSpec>().unwrap().resolve_without_tile().unwrap();
        kernel.classes()[0].taps.clone()
    }

    fn frequency(i: usize, n: usize) -> f64 {
        (i as f64 - (n / 2) as f64) / n as f64
    }

    #[test]
    fn a_gaussian_s_response_is_a_gaussian() {
        let sigma = 2.1;
        let response = Response::spatial(&taps("gaussian(2.1) @ 100%"), 32, 17);
        for j in 0..17 {
            for i in 0..32 {
                let (fx, fy) = (frequency(i, 32), frequency(j, 17));
                let expected = (-0.5 * (TAU * sigma).powi(2) * (fx * fx + fy * fy)).exp();
                let found = response.magnitude[j * 32 + i];
                assert!((found - expected).abs() < 1e-8, "{fx} {fy}: {found} != {expected}");
            }
        }
    }

    #[test]
    fn an_average_s_response_is_the_known_one() {
        let alpha = 0.2_f64;
        let response = Response::space_time(&taps("ema(0.2) @ 100%"), 1, 64);
        for j in 0..64 {
            let angle = TAU * frequency(j, 64);
            let beta = 1.0 - alpha;
            let expected = alpha / (1.0 + beta * beta - 2.0 * beta * angle.cos()).sqrt();
            assert!((response.magnitude[j] - expected).abs() < 1e-9);
        }
    }

    proptest! {
        /// The definition: |Σ g exp(−2πi (f·d))|, tap by tap.
        #[test]
        fn the_response_is_the_sum_over_taps(
            weights in prop::collection::vec(-1.0..1.0, 24),
            columns in 1..9_usize,
            rows in 1..9_usize,
        ) {
            let taps = KernelTaps::new(weights.iter().enumerate().map(|(k, &weight)| {
                let k = k as i32;
                Tap { offset: IVec3::new(k % 4 - 2, k / 4 % 3 + 1, k / 12 - 7), weight }
            })).unwrap();
            let both = [
                (Response::spatial(&taps, columns, rows), 1),
                (Response::space_time(&taps, columns, rows), 2),
            ];
            for (response, axis) in both {
                for j in 0..rows {
                    for i in 0..columns {
                        let (mut re, mut im) = (0.0, 0.0);
                        for tap in taps.taps() {
                            let angle = TAU * (frequency(i, columns) * f64::from(tap.offset[0])
                                + frequency(j, rows) * f64::from(tap.offset[axis]));
                            re += tap.weight * angle.cos();
                            im += tap.weight * angle.sin();
                        }
                        let expected = re.hypot(im);
                        prop_assert!((response.magnitude[j * columns + i] - expected).abs() < 1e-12);
                    }
                }
            }
        }
    }
}
