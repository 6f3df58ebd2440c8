//! Adam (Kingma and Ba, 2015), the optimizer of Algorithm 1, line 10.
//!
//! Options, moments and the update are kept apart: [`AdamOptions`] says how, [`Update`] does one
//! row of coordinates. The gradient may be an integer one (from draws) or a float one (from the
//! polish); both are turned into f32 first.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

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
}

/// One step of a run of coordinates, in place.
pub struct Update<'a, P> {
    /// What the step does.
    pub factors: Factors,
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
        let n = self.gradients.len();
        let (x, m, v) = (&mut self.samples[..n], &mut self.first[..n], &mut self.second[..n]);
        for i in 0..n {
            [x[i], m[i], v[i]] = self.factors.step(self.gradients[i], x[i], m[i], v[i]);
        }
    }
}

/// One step of a run of coordinates, from one place to another.
pub struct UpdateTo<'a, P> {
    /// What the step does.
    pub factors: Factors,
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
        let Self { factors, gradients, from, to } = self;
        let n = gradients.len();
        let [x, m, v] = from.map(|slice| &slice[..n]);
        let [to_x, to_m, to_v] = to.map(|slice| &mut slice[..n]);
        for i in 0..n {
            [to_x[i], to_m[i], to_v[i]] = factors.step(gradients[i], x[i], m[i], v[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient::simd::Plain;

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

    #[test]
    fn coordinates_stay_in_the_cube() {
        let mut x = [0.001, 0.999];
        Update {
            factors: OPTIONS.factors(0, 1, 1.0),
            gradients: &[-1_i32, 1],
            samples: &mut x,
            first: &mut [0.0; 2],
            second: &mut [0.0; 2],
        }
        .run(Plain);
        assert_eq!(x, [0.0, crate::tile::BELOW_ONE]);
    }
}
