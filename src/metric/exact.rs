//! Exact integrals over the unit cube `[0, 1]^d`: half-spaces, balls and Gaussians.
//!
//! The scores measure how far a tile's estimate is from the integral, so the integral itself must
//! be better by orders than any tile can be (white noise of 10⁷ samples errs by 10⁻⁴). Inclusion
//! and exclusion over the corners is exact on paper, but cancels in many dimensions or with small
//! components; each formula here says how far it can be off.

use std::f64::consts::{PI, SQRT_2, TAU};
use std::sync::Arc;

use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};

/// Largest error that [`half_space`] may have.
const HALF_SPACE_ERROR: f64 = 1e-10;
/// Most terms of the Fourier series before [`half_space`] gives up.
const MOST_TERMS: usize = 1 << 20;
/// Cells of the squared radius in [`Balls`].
const CELLS: usize = 4096;

/// Volume of `{x : normal·x > offset}` within the unit cube, to 1e-10.
///
/// `None` if the components of `normal` differ by so many orders that the series would need more
/// than a million terms; for uniform random directions this practically never happens.
///
/// The projection on the normal is a sum of independent uniform variables, one of width |nᵢ| per
/// dimension, around the projected centre of the cube. In one and two dimensions its distribution
/// is written down (a box, a trapezoid). Above, its density is periodically continued with the
/// period L = Σ|nᵢ|, its exact support; the coefficients of its Fourier series are the exact
/// characteristic function Π sinc(ω|nᵢ|/2), and the series is integrated term by term:
/// P(projection > u) = ½ − u/L − (2/L) Σₖ sin(ωₖu)/ωₖ Π sinc(ωₖ|nᵢ|/2), ωₖ = 2πk/L, with u
/// measured from the centre. The sum ends when the rest is provably small, by |sinc x| ≤ 1/|x|
/// for the m largest components.
pub(super) fn half_space(normal: &[f64], offset: f64) -> Option<f64> {
    let u = offset - normal.iter().sum::<f64>() / 2.0;
    let mut widths: Vec<f64> = normal.iter().map(|n| n.abs()).filter(|&n| n > 0.0).collect();
    widths.sort_by(|a, b| b.total_cmp(a));
    let period: f64 = widths.iter().sum();
    if u <= -period / 2.0 {
        return Some(1.0);
    }
    if u >= period / 2.0 {
        return Some(0.0);
    }
    match widths[..] {
        [] => Some(if u < 0.0 { 1.0 } else { 0.0 }),
        [_] => Some(0.5 - u / period),
        [a, b] => {
            let tail = period / 2.0 - u.abs();
            // The tail is a triangle up to the smaller width, and then a box.
            let area = if tail < b { tail * tail / (2.0 * a * b) } else { (tail - b / 2.0) / a };
            Some(if u > 0.0 { area } else { 1.0 - area })
        }
        _ => {
            let mut sum = 0.0;
            for k in 1..=MOST_TERMS {
                let omega = TAU * k as f64 / period;
                let product: f64 = widths
                    .iter()
                    .map(|width| libm::sin(omega * width / 2.0) / (omega * width / 2.0))
                    .product();
                sum += libm::sin(omega * u) / omega * product;
                if k % 64 == 0 && rest(&widths, omega) < HALF_SPACE_ERROR {
                    let volume = 0.5 - u / period - 2.0 / period * sum;
                    return Some(volume.clamp(0.0, 1.0));
                }
            }
            None
        }
    }
}

/// Bound of the series of [`half_space`] beyond the frequency `omega`: the smallest of
/// Π(2/aᵢ) / (π m ωᵐ) over the `m` largest widths.
fn rest(widths: &[f64], omega: f64) -> f64 {
    let mut bound = f64::INFINITY;
    let mut product = 1.0;
    for (i, width) in widths.iter().enumerate() {
        product *= 2.0 / (width * omega);
        bound = bound.min(product / (PI * (i + 1) as f64));
    }
    bound
}

/// Integral of exp(−|x − centre|² / 2σ²) over the unit cube, to the rounding of `libm::erf`.
pub(super) fn gaussian(centre: &[f64], sigma: f64) -> f64 {
    let scale = 1.0 / (SQRT_2 * sigma);
    let factor = sigma * libm::sqrt(PI / 2.0);
    centre.iter().map(|c| factor * (libm::erf((1.0 - c) * scale) + libm::erf(c * scale))).product()
}

/// Area of the quarter disk of radius `r` around 0 within `[0, a] × [0, b]`.
fn quarter_disk(a: f64, b: f64, r: f64) -> f64 {
    if a * a + b * b <= r * r {
        return a * b;
    }
    let (a, b) = (a.min(r), b.min(r));
    let primitive = |x: f64| {
        let y = libm::sqrt((r * r - x * x).max(0.0));
        (x * y + r * r * libm::asin((x / r).min(1.0))) / 2.0
    };
    let flat = libm::sqrt((r * r - b * b).max(0.0));
    flat * b + primitive(a) - primitive(flat)
}

/// Area of the disk of radius √`s` around `centre`, a point of the unit square, within it.
fn disk(centre: [f64; 2], s: f64) -> f64 {
    if s <= 0.0 {
        return 0.0;
    }
    let r = libm::sqrt(s);
    let [x, y] = centre;
    [(x, y), (1.0 - x, y), (x, 1.0 - y), (1.0 - x, 1.0 - y)]
        .iter()
        .map(|&(a, b)| quarter_disk(a, b, r))
        .sum()
}

/// ∫₀^y P((X − c)² ≤ v) dv for X uniform in `[0, 1]`.
fn squared_distance_primitive(c: f64, y: f64) -> f64 {
    let side = |b: f64| {
        if y <= b * b {
            2.0 / 3.0 * y * libm::sqrt(y)
        } else {
            2.0 / 3.0 * b * b * b + b * (y - b * b)
        }
    };
    if y <= 0.0 { 0.0 } else { side(c) + side(1.0 - c) }
}

/// Volumes of balls within the unit cube, with the workspace that dimensions above 3 need.
///
/// The squared distance from the centre is a sum of one independent term per dimension. The first
/// two terms together have a closed form (a disk within a square). Every further one is put on a
/// grid of 4096 cells so that the mass and the mean of every part of it are kept; the grid
/// distributions are convolved (no wrap-around: twice the length), and the last step sums the
/// closed form over them. What is left is half the variance of the rounding times the curvature of
/// the distribution: below 1e-7 for radii up to 1.5 in up to 16 dimensions (checked by halving the
/// cells, and against full balls).
pub(super) struct Balls {
    cells: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
}

impl Balls {
    /// A workspace.
    pub(super) fn new() -> Self {
        Self::with_cells(CELLS)
    }

    fn with_cells(cells: usize) -> Self {
        let mut planner = RealFftPlanner::new();
        Self {
            cells,
            forward: planner.plan_fft_forward(2 * cells),
            inverse: planner.plan_fft_inverse(2 * cells),
        }
    }

    /// Volume of the ball of `radius` around `centre`, a point of the unit cube, within the cube.
    pub(super) fn volume(&self, centre: &[f64], radius: f64) -> f64 {
        let s = radius * radius;
        match *centre {
            [] => 1.0,
            [c] => radius.min(c) + radius.min(1.0 - c),
            [x, y] => disk([x, y], s),
            [x, y, ref others @ ..] => {
                let h = s / self.cells as f64;
                let sum: f64 = self
                    .distribution(others, h)
                    .iter()
                    .enumerate()
                    .map(|(j, weight)| weight * disk([x, y], s - j as f64 * h))
                    .sum();
                sum.clamp(0.0, 1.0)
            }
        }
    }

    /// The distribution of Σ (Xᵢ − cᵢ)² on the grid `0, h, …`, as far as the grid goes.
    fn distribution(&self, centre: &[f64], h: f64) -> Vec<f64> {
        let n = self.cells;
        let single = |c: f64| -> Vec<f64> {
            let primitive = |j: usize| squared_distance_primitive(c, j as f64 * h);
            // Each part of the distribution goes to its two neighbours on the grid, in the
            // proportion that keeps its mean: second differences of the primitive.
            let mut weights = vec![0.0; 2 * n];
            weights[0] = primitive(1) / h;
            for (j, weight) in weights[..n].iter_mut().enumerate().skip(1) {
                *weight = (primitive(j + 1) - 2.0 * primitive(j) + primitive(j - 1)) / h;
            }
            weights
        };
        let (&first, others) = centre.split_first().expect("at least one dimension");
        let mut sum = single(first);
        let mut left = self.forward.make_output_vec();
        let mut right = self.forward.make_output_vec();
        for &c in others {
            // The lengths are the plan's own, so that these cannot fail.
            self.forward.process(&mut sum, &mut left).expect("lengths of the plan");
            self.forward.process(&mut single(c), &mut right).expect("lengths of the plan");
            left.iter_mut().zip(&right).for_each(|(a, b): (&mut Complex<f64>, _)| *a *= b);
            // Both ends of the spectrum are real up to rounding; the inverse insists on it.
            left[0].im = 0.0;
            left[n].im = 0.0;
            self.inverse.process(&mut left, &mut sum).expect("lengths of the plan");
            sum.iter_mut().for_each(|w| *w /= 2.0 * n as f64);
            sum[n..].fill(0.0);
        }
        sum.truncate(n);
        sum
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::split_mix::SplitMix;
    use super::*;

    /// Volume of the half-space by inclusion and exclusion over the corners of the cube.
    fn by_corners(normal: &[f64], offset: f64) -> f64 {
        let dims = normal.len();
        let below: f64 = normal.iter().filter(|&&n| n < 0.0).sum();
        let threshold = offset - below;
        let mut sum = 0.0;
        for corner in 0..1_u32 << dims {
            let at: f64 = (0..dims).filter(|i| corner >> i & 1 == 1).map(|i| normal[i].abs()).sum();
            let sign = if corner.count_ones() % 2 == 0 { 1.0 } else { -1.0 };
            sum += sign * (threshold - at).max(0.0).powi(dims as i32);
        }
        let factorial: f64 = (1..=dims).map(|i| i as f64).product();
        1.0 - sum / factorial / normal.iter().map(|n| n.abs()).product::<f64>()
    }

    proptest! {
        #[test]
        fn half_spaces_agree_with_inclusion_and_exclusion(seed: u64, dims in 1_usize..6) {
            let mut stream = SplitMix::new(&[seed]);
            // With small components the formula in this test is the one that is wrong.
            let normal: Vec<f64> = stream
                .direction(dims)
                .into_iter()
                .map(|n| if n.abs() < 0.1 { 0.1_f64.copysign(n) } else { n })
                .collect();
            let point = stream.point(dims);
            let offset: f64 = normal.iter().zip(&point).map(|(n, x)| n * x).sum();
            let found = half_space(&normal, offset).unwrap();
            prop_assert!((found - by_corners(&normal, offset)).abs() < 3e-10);
        }

        #[test]
        fn a_tiny_component_changes_little(seed: u64, tiny in 1e-4_f64..1e-3) {
            let mut stream = SplitMix::new(&[seed]);
            let mut normal = stream.direction(3);
            let offset = stream.range(0.0, 0.5);
            let flat = half_space(&normal, offset);
            normal.push(tiny);
            let tilted = half_space(&normal, offset + tiny / 2.0);
            if let (Some(flat), Some(tilted)) = (flat, tilted) {
                prop_assert!((flat - tilted).abs() < 1e-5);
            }
        }

        #[test]
        fn opposite_half_spaces_fill_the_cube(seed: u64, dims in 1_usize..=16) {
            let mut stream = SplitMix::new(&[seed]);
            let normal = stream.direction(dims);
            let opposite: Vec<f64> = normal.iter().map(|n| -n).collect();
            let offset = stream.range(-0.5, 0.5);
            if let (Some(a), Some(b)) = (half_space(&normal, offset), half_space(&opposite, -offset)) {
                prop_assert!((a + b - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn half_spaces_beside_the_cube_are_empty_or_full() {
        assert_eq!(half_space(&[0.6, 0.8], 1.5), Some(0.0));
        assert_eq!(half_space(&[0.6, 0.8], -0.1), Some(1.0));
        assert_eq!(half_space(&[-1.0], -0.25), Some(0.25));
        // A corner cut off the cube of 3 dimensions: a tetrahedron.
        let found = half_space(&[-1.0, -1.0, -1.0], -0.5).unwrap();
        assert!((found - 0.125 / 6.0).abs() < 1e-10, "{found}");
    }

    #[test]
    fn small_balls_have_the_volume_of_a_ball() {
        for dims in 1..=16 {
            let dimension = dims as f64;
            let unit = libm::pow(PI, dimension / 2.0) / libm::tgamma(dimension / 2.0 + 1.0);
            let full = Balls::new().volume(&vec![0.5; dims], 0.5);
            assert!((full - unit * libm::pow(0.5, dimension)).abs() < 1e-8, "{dims}: {full}");
            // A ball around a corner: one orthant of it is in the cube.
            let corner = Balls::new().volume(&vec![0.0; dims], 0.9);
            let expected = unit * libm::pow(0.45, dimension);
            assert!((corner - expected).abs() < 1e-7, "{dims}: {corner} {expected}");
        }
    }

    #[test]
    fn balls_that_leave_the_cube_do_not_depend_on_the_grid() {
        let mut stream = SplitMix::new(&[3]);
        let (fine, coarse) = (Balls::new(), Balls::with_cells(CELLS / 2));
        for case in 0..48 {
            let dims = 3 + case % 14;
            let centre = stream.point(dims);
            let radius = stream.range(0.2, 0.5) * libm::sqrt(dims as f64 / 2.0);
            let (a, b) = (fine.volume(&centre, radius), coarse.volume(&centre, radius));
            assert!((a - b).abs() < 3e-7, "{dims} dims, radius {radius}: {a} {b}");
        }
    }

    #[test]
    fn balls_agree_with_slices() {
        // In 3 dimensions: the midpoint rule over disks, on centres with all their kinks.
        let mut stream = SplitMix::new(&[5]);
        for _ in 0..16 {
            let centre = stream.point(3);
            let radius = stream.range(0.2, 0.9);
            let n = 200_000;
            let slices: f64 = (0..n)
                .map(|i| {
                    let z = (f64::from(i) + 0.5) / f64::from(n) - centre[2];
                    disk([centre[0], centre[1]], radius * radius - z * z)
                })
                .sum::<f64>()
                / f64::from(n);
            let found = Balls::new().volume(&centre, radius);
            assert!((found - slices).abs() < 2e-8, "{found} {slices}");
        }
    }

    #[test]
    fn disks_agree_with_columns() {
        let mut stream = SplitMix::new(&[6]);
        for _ in 0..16 {
            let (x, y, r) = (stream.uniform(), stream.uniform(), stream.range(0.1, 1.5));
            let n = 200_000;
            let columns: f64 = (0..n)
                .map(|i| {
                    let dx = (f64::from(i) + 0.5) / f64::from(n) - x;
                    let half = libm::sqrt((r * r - dx * dx).max(0.0));
                    half.min(y) + half.min(1.0 - y)
                })
                .sum::<f64>()
                / f64::from(n);
            assert!((disk([x, y], r * r) - columns).abs() < 1e-7);
        }
    }

    #[test]
    fn gaussians_agree_with_the_midpoint_rule() {
        let (n, sigma) = (400, 0.17);
        let centre = [0.3, 0.95];
        let at = |i: usize| (i as f64 + 0.5) / n as f64;
        let mut sum = 0.0;
        for i in 0..n {
            for j in 0..n {
                let (dx, dy) = (at(i) - centre[0], at(j) - centre[1]);
                sum += libm::exp(-(dx * dx + dy * dy) / (2.0 * sigma * sigma));
            }
        }
        assert!((gaussian(&centre, sigma) - sum / (n * n) as f64).abs() < 1e-6);
    }
}
