//! Adam (Kingma and Ba, 2015), the optimizer of Algorithm 1, line 10.
//!
//! Options, moments and the update are kept apart: [`AdamOptions`] says how, [`Update`] does one
//! row of samples, which stay in their domain. The gradient may be an integer one (from draws) or a float one (from the
//! polish); both are turned into f32 first.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use crate::domain::Surface;
use crate::gradient::simd::{Isa, Vectorized};
use crate::tile::clamp_coordinate;

/// How Adam moves the samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AdamOptions {
    /// Step size at the start, in units of the cube.
    pub rate: f64,
    /// Step size at the end; in between it falls along half a cosine.
    pub final_rate: f64,
    /// Decay of the mean of gradients, in [0, [`MAX_BETA`]].
    pub beta1: f64,
    /// Decay of the mean of squared gradients, in [0, [`MAX_BETA`]].
    pub beta2: f64,
    /// Added to the root of the second moment, in units of the gradient; positive.
    pub epsilon: f64,
}

/// Largest decay of a moment. Moments are f32, in which a decay is off by up to 3·10⁻⁸: here that is
/// 3 % of 1 − β, and a little nearer to 1 no moment would ever decay.
pub const MAX_BETA: f64 = 0.999_999;

/// 1 − β, the weight of a new gradient.
///
/// Usual decays count as what they are in f32, so that both weights add up to 1. Near 1 the rounding
/// of β is too large a part of the difference, and it is formed before.
fn weight(beta: f64) -> f32 {
    const USUAL: f64 = 0.99999;
    if beta <= USUAL { 1.0 - beta as f32 } else { (1.0 - beta) as f32 }
}

impl AdamOptions {
    /// Step size in `step` of `steps`.
    pub fn rate(&self, step: u32, steps: u32) -> f64 {
        let done = f64::from(step) / f64::from(steps.max(1));
        self.final_rate + (self.rate - self.final_rate) * 0.5 * (1.0 + libm::cos(PI * done))
    }

    /// The numbers that all coordinates share in one step.
    pub fn factors(&self, step: u32, steps: u32, unit: f32) -> Factors {
        // The corrections 1 − βᵗ by repeated squaring through libm, alike on every machine.
        let corrected = |beta: f64| 1.0 - libm::pow(beta, f64::from(step) + 1.0);
        Factors {
            unit,
            beta1: self.beta1 as f32,
            beta2: self.beta2 as f32,
            weight1: weight(self.beta1),
            weight2: weight(self.beta2),
            rate: (self.rate(step, steps) / corrected(self.beta1)) as f32,
            second: (1.0 / corrected(self.beta2)) as f32,
            epsilon: self.epsilon as f32,
        }
    }
}

/// What one step does to every coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors {
    unit: f32,
    beta1: f32,
    beta2: f32,
    weight1: f32,
    weight2: f32,
    rate: f32,
    second: f32,
    epsilon: f32,
}

/// A component of a gradient that points downhill.
pub trait Component: Copy {
    /// Its value in gradient units.
    fn value(self) -> f32;
}

impl Component for i32 {
    #[inline(always)]
    fn value(self) -> f32 {
        self as f32
    }
}

impl Component for f32 {
    #[inline(always)]
    fn value(self) -> f32 {
        self
    }
}

impl Factors {
    /// A coordinate and its moments after the step.
    #[inline(always)]
    fn step<P: Component>(self, gradient: P, x: f32, m: f32, v: f32) -> [f32; 3] {
        let Self { unit, beta1, beta2, weight1, weight2, rate, second: correction, epsilon } = self;
        let gradient = gradient.value() * unit;
        let m = beta1 * m + weight1 * gradient;
        let v = beta2 * v + weight2 * (gradient * gradient);
        let move_by = rate * m / ((v * correction).sqrt() + epsilon);
        [clamp_coordinate(x + move_by), m, v]
    }

    /// Points that stay on a surface, `L` of them at a time, with their moments, after the step. The
    /// root is that of all coordinates' second moments together, so that directions do not depend on
    /// where the axes are.
    #[inline(always)]
    fn step_points<P: Component, const N: usize, const L: usize>(
        self,
        surface: Surface,
        gradients: [[P; L]; N],
        [mut x, mut m, mut v]: [[[f32; L]; N]; 3],
    ) -> [[[f32; L]; N]; 3] {
        let Self { unit, beta1, beta2, weight1, weight2, rate, second: correction, epsilon } = self;
        let free = (N - usize::from(surface.is_curved())) as f32;
        // Loops, as closures of library functions may not be compiled for the instruction set.
        let mut downhill = [[0.0; L]; N];
        for k in 0..N {
            for lane in 0..L {
                downhill[k][lane] = gradients[k][lane].value() * unit;
            }
        }
        surface.flatten(&x, &mut downhill);
        let mut total = [0.0; L];
        for k in 0..N {
            for lane in 0..L {
                let gradient = downhill[k][lane];
                m[k][lane] = beta1 * m[k][lane] + weight1 * gradient;
                v[k][lane] = beta2 * v[k][lane] + weight2 * (gradient * gradient);
                total[lane] += v[k][lane];
            }
        }
        let mut by = [0.0; L];
        for lane in 0..L {
            by[lane] = rate / ((total[lane] * correction / free).sqrt() + epsilon);
        }
        for k in 0..N {
            for lane in 0..L {
                x[k][lane] += by[lane] * m[k][lane];
            }
        }
        surface.bring_back(&mut x);
        [x, m, v]
    }

    /// [`Self::step_points`] for `L` points of arrays, the first of them number `i`.
    #[inline(always)]
    fn step_at<P: Component, const N: usize, const L: usize>(
        self,
        surface: Surface,
        gradients: &[P],
        arrays: [&[f32]; 3],
        i: usize,
    ) -> [[[f32; L]; N]; 3] {
        let at = i * N..(i + L) * N;
        let mut planes = [[[0.0; L]; N]; 3];
        for (array, planes) in arrays.into_iter().zip(&mut planes) {
            let array = &array[at.clone()];
            for lane in 0..L {
                for k in 0..N {
                    planes[k][lane] = array[lane * N + k];
                }
            }
        }
        let gradients = &gradients[at];
        let mut downhill = [[gradients[0]; L]; N];
        for lane in 0..L {
            for k in 0..N {
                downhill[k][lane] = gradients[lane * N + k];
            }
        }
        self.step_points(surface, downhill, planes)
    }
}

/// Puts `L` points in their place in an array, the first of them as number `i`.
#[inline(always)]
fn put<const N: usize, const L: usize>(points: [[f32; L]; N], array: &mut [f32], i: usize) {
    let array = &mut array[i * N..(i + L) * N];
    for lane in 0..L {
        for k in 0..N {
            array[lane * N + k] = points[k][lane];
        }
    }
}

/// Points that are moved at a time.
const LANES: usize = 32;

/// Where the samples of a row live: the surface that they stay on, and their dimensions.
pub type Place = (Surface, usize);

/// A run of samples that is to be moved.
trait Row: Sized {
    /// Moves all of them, each coordinate by itself.
    fn coordinates(self);
    /// Moves `L` points of `N` coordinates, the first of them number `i`.
    fn points<const N: usize, const L: usize>(&mut self, surface: Surface, i: usize);

    /// Moves all of them, which have so many words, as their place wants it.
    #[inline(always)]
    fn step(self, place: Place, words: usize) {
        // A surface that is known when this is compiled leaves no branch in a loop.
        match place {
            (Surface::Cube | Surface::Mask(_), _) => self.coordinates(),
            (Surface::Ball, 2) => self.all_points::<2>(Surface::Ball, words),
            (Surface::Ball, _) => self.all_points::<3>(Surface::Ball, words),
            (Surface::Sphere, 2) => self.all_points::<2>(Surface::Sphere, words),
            (Surface::Sphere, _) => self.all_points::<3>(Surface::Sphere, words),
            (Surface::Hemisphere, _) => self.all_points::<3>(Surface::Hemisphere, words),
        }
    }

    #[inline(always)]
    fn all_points<const N: usize>(mut self, surface: Surface, words: usize) {
        let whole = words / N / LANES * LANES;
        for i in (0..whole).step_by(LANES) {
            self.points::<N, LANES>(surface, i);
        }
        for i in whole..words / N {
            self.points::<N, 1>(surface, i);
        }
    }
}

/// One step of a run of samples, in place.
pub struct Update<'a, P> {
    /// What the step does.
    pub factors: Factors,
    /// Where samples live.
    pub place: Place,
    /// Downhill gradient.
    pub gradients: &'a [P],
    /// Coordinates.
    pub samples: &'a mut [f32],
    /// First moments.
    pub first: &'a mut [f32],
    /// Second moments.
    pub second: &'a mut [f32],
}

impl<P: Component> Vectorized for Update<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let (place, words) = (self.place, self.gradients.len());
        self.step(place, words);
    }
}

impl<P: Component> Row for Update<'_, P> {
    #[inline(always)]
    fn coordinates(self) {
        let n = self.gradients.len();
        let (x, m, v) = (&mut self.samples[..n], &mut self.first[..n], &mut self.second[..n]);
        for i in 0..n {
            [x[i], m[i], v[i]] = self.factors.step(self.gradients[i], x[i], m[i], v[i]);
        }
    }

    #[inline(always)]
    fn points<const N: usize, const L: usize>(&mut self, surface: Surface, i: usize) {
        let Self { factors, gradients, samples: x, first: m, second: v, .. } = self;
        let next = factors.step_at::<P, N, L>(surface, gradients, [x, m, v], i);
        put(next[0], x, i);
        put(next[1], m, i);
        put(next[2], v, i);
    }
}

/// One step of a run of samples, from one place to another.
pub struct UpdateTo<'a, P> {
    /// What the step does.
    pub factors: Factors,
    /// Where samples live.
    pub place: Place,
    /// Downhill gradient.
    pub gradients: &'a [P],
    /// Coordinates, first and second moments.
    pub from: [&'a [f32]; 3],
    /// The same after the step.
    pub to: [&'a mut [f32]; 3],
}

impl<P: Component> Vectorized for UpdateTo<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let (place, words) = (self.place, self.gradients.len());
        self.step(place, words);
    }
}

impl<P: Component> Row for UpdateTo<'_, P> {
    #[inline(always)]
    fn coordinates(self) {
        let Self { factors, gradients, from, to, .. } = self;
        let n = gradients.len();
        let [x, m, v] = from.map(|slice| &slice[..n]);
        let [to_x, to_m, to_v] = to.map(|slice| &mut slice[..n]);
        for i in 0..n {
            [to_x[i], to_m[i], to_v[i]] = factors.step(gradients[i], x[i], m[i], v[i]);
        }
    }

    #[inline(always)]
    fn points<const N: usize, const L: usize>(&mut self, surface: Surface, i: usize) {
        let Self { factors, gradients, from, to: [x, m, v], .. } = self;
        let next = factors.step_at::<P, N, L>(surface, gradients, *from, i);
        put(next[0], x, i);
        put(next[1], m, i);
        put(next[2], v, i);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Domain;
    use crate::gradient::simd::Plain;
    use crate::metric::Baseline;
    use crate::tile::TileShape;

    const OPTIONS: AdamOptions =
        AdamOptions { rate: 0.01, final_rate: 0.001, beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };

    #[test]
    fn the_step_size_falls_from_its_first_value_to_its_last() {
        assert!((OPTIONS.rate(0, 100) - 0.01).abs() < 1e-12);
        assert!((OPTIONS.rate(50, 100) - 0.0055).abs() < 1e-12);
        assert!((OPTIONS.rate(100, 100) - 0.001).abs() < 1e-12);
    }

    #[test]
    fn moves_equal_the_formulas_of_the_paper_in_f64() {
        for (beta1, beta2) in [(0.9, 0.99), (MAX_BETA, 0.99), (0.5, MAX_BETA)] {
            let options = AdamOptions { beta1, beta2, ..OPTIONS };
            let gradients = [3.0_f32, -0.2, 0.0, 5.0];
            let (mut x, mut m, mut v) = (vec![0.5_f32; 4], vec![0.0; 4], vec![0.0; 4]);
            let (mut slow_x, mut slow_m, mut slow_v) = ([0.5_f64; 4], [0.0; 4], [0.0; 4]);
            for step in 0..5 {
                Update {
                    factors: options.factors(step, 5, 1.0),
                    place: (Surface::Cube, 4),
                    gradients: &gradients,
                    samples: &mut x,
                    first: &mut m,
                    second: &mut v,
                }
                .run(Plain);
                let t = step as i32 + 1;
                for i in 0..4 {
                    let g = f64::from(gradients[i]);
                    slow_m[i] = beta1 * slow_m[i] + (1.0 - beta1) * g;
                    slow_v[i] = beta2 * slow_v[i] + (1.0 - beta2) * g * g;
                    let m_hat = slow_m[i] / (1.0 - beta1.powi(t));
                    let v_hat: f64 = slow_v[i] / (1.0 - beta2.powi(t));
                    slow_x[i] += options.rate(step, 5) * m_hat / (v_hat.sqrt() + 1e-8);
                    let error = (f64::from(x[i]) - slow_x[i]).abs();
                    assert!(error < 1e-5, "{beta1} {beta2}, {i}: {} {}", x[i], slow_x[i]);
                }
            }
        }
    }

    #[test]
    fn weights_of_usual_decays_are_what_they_were() {
        for beta in (0..1000).map(|i| f64::from(i) / 1000.0).chain([0.9995, 0.9999, 0.99999]) {
            assert_eq!(weight(beta).to_bits(), (1.0 - beta as f32).to_bits(), "{beta}");
        }
    }

    /// Points of a domain with gradients, after some steps in f64: along the tangent, by one root for
    /// all coordinates, and back.
    #[test]
    fn points_move_along_their_surface_as_in_f64() {
        for domain in Domain::ALL.into_iter().filter(|domain| !domain.is_square()) {
            let (dims, surface) = (domain.dims().unwrap(), domain.surface());
            // Whole registers and some more.
            let shape = TileShape::new(37, 1, 1, 1, dims).unwrap();
            let tile = Baseline::White.tile_of(domain, shape, 3);
            let gradients = Baseline::White.tile(shape, 4);
            let gradients: Vec<f32> = gradients.samples().iter().map(|x| x - 0.5).collect();
            let mut x = tile.samples().to_vec();
            let (mut m, mut v) = (vec![0.0; x.len()], vec![0.0; x.len()]);
            let mut slow: Vec<[f64; 3]> = x.iter().map(|&x| [f64::from(x), 0.0, 0.0]).collect();
            for step in 0..4 {
                let factors = OPTIONS.factors(step, 4, 1.0);
                let place = (surface, dims);
                let (mut to_x, mut to_m, mut to_v) = (x.clone(), m.clone(), v.clone());
                let to = [&mut to_x[..], &mut to_m[..], &mut to_v[..]];
                let from = [&x[..], &m[..], &v[..]];
                UpdateTo { factors, place, gradients: &gradients, from, to }.run(Plain);
                let (samples, first, second) = (&mut x[..], &mut m[..], &mut v[..]);
                Update { factors, place, gradients: &gradients, samples, first, second }.run(Plain);
                assert_eq!([&to_x, &to_m, &to_v], [&x, &m, &v], "{domain}");

                let t = step as i32 + 1;
                for (point, gradients) in slow.chunks_mut(dims).zip(gradients.chunks(dims)) {
                    let mut gradient: Vec<f64> = gradients.iter().map(|&g| f64::from(g)).collect();
                    let normal: Vec<f64> = point.iter().map(|[x, ..]| 2.0 * x - 1.0).collect();
                    if surface.is_curved() {
                        let away: f64 = normal.iter().zip(&gradient).map(|(n, g)| n * g).sum();
                        gradient.iter_mut().zip(&normal).for_each(|(g, n)| *g -= away * n);
                    }
                    for ([_, m, v], g) in point.iter_mut().zip(&gradient) {
                        *m = OPTIONS.beta1 * *m + (1.0 - OPTIONS.beta1) * g;
                        *v = OPTIONS.beta2 * *v + (1.0 - OPTIONS.beta2) * g * g;
                    }
                    let free = dims - usize::from(surface.is_curved());
                    let v: f64 = point.iter().map(|[_, _, v]| v).sum::<f64>() / free as f64;
                    let root = (v / (1.0 - OPTIONS.beta2.powi(t))).sqrt() + OPTIONS.epsilon;
                    let by = OPTIONS.rate(step, 4) / (1.0 - OPTIONS.beta1.powi(t)) / root;
                    point.iter_mut().for_each(|[x, m, _]| *x += by * *m - 0.5);
                    if surface == Surface::Hemisphere {
                        point[dims - 1][0] = point[dims - 1][0].max(0.0);
                    }
                    let length: f64 = point.iter().map(|[x, ..]| x * x).sum::<f64>().sqrt();
                    let outside = surface.is_curved() || length > 0.5;
                    let back = if outside { 0.5 / length } else { 1.0 };
                    point.iter_mut().for_each(|[x, ..]| *x = *x * back + 0.5);
                }
                for (i, (found, expected)) in x.iter().zip(&slow).enumerate() {
                    let error = (f64::from(*found) - expected[0]).abs();
                    assert!(error < 2e-5, "{domain}, step {step}, {i}: {found} {expected:?}");
                }
            }
        }
    }

    #[test]
    fn coordinates_stay_in_the_cube() {
        let mut x = [0.001, 0.999];
        Update {
            factors: OPTIONS.factors(0, 1, 1.0),
            place: (Surface::Cube, 1),
            gradients: &[-1_i32, 1],
            samples: &mut x,
            first: &mut [0.0; 2],
            second: &mut [0.0; 2],
        }
        .run(Plain);
        assert_eq!(x, [0.0, crate::tile::BELOW_ONE]);
    }
}
