//! A distribution of projections on a grid: what tables of targets are made from.

/// Intervals of the grid.
pub const GRID: usize = 8192;

/// A CDF on a grid over its range, linear in between.
#[derive(Debug)]
pub struct Cdf {
    /// Where its range begins.
    low: f64,
    /// Distance of two nodes.
    step: f64,
    /// At node i, i = 0..=[`GRID`].
    values: Vec<f64>,
}

impl Cdf {
    /// Of a function that rises from 0 to 1 over a range; it is asked from the lower end upwards.
    pub fn new(low: f64, length: f64, mut cdf: impl FnMut(f64) -> f64) -> Self {
        let step = length / GRID as f64;
        let mut values: Vec<f64> = (0..=GRID).map(|i| cdf(low + i as f64 * step)).collect();
        values[GRID] = 1.0;
        Self { low, step, values }
    }

    /// Of Σ mₖ·uₖ for uniform uₖ, with the magnitudes mₖ of the components.
    ///
    /// It is built by adding one at a time, Fₖ(x) = (1/m) ∫ Fₖ₋₁ over [x − m, x], with exact
    /// integrals of the piecewise linear Fₖ₋₁. Components too small to span a cell of the grid shift
    /// the mean only.
    pub fn of_sum(magnitudes: &[f32]) -> Self {
        let mut parts: Vec<f64> = magnitudes.iter().map(|&m| f64::from(m)).collect();
        parts.sort_by(|a, b| b.total_cmp(a));
        let length: f64 = parts.iter().sum();
        let step = length / GRID as f64;
        let mut cdf: Vec<f64> = (0..=GRID).map(|i| (i as f64 * step / parts[0]).min(1.0)).collect();
        let mut integral = vec![0.0; GRID + 1];
        for &part in parts[1..].iter().filter(|&&part| part > 0.0) {
            for i in 0..GRID {
                integral[i + 1] = integral[i] + 0.5 * step * (cdf[i] + cdf[i + 1]);
            }
            // ∫ of the piecewise linear CDF from 0 to x.
            let upto = |x: f64| {
                let place = (x / step).max(0.0);
                let i = (place as usize).min(GRID - 1);
                let f = place - i as f64;
                integral[i] + step * f * (cdf[i] + 0.5 * f * (cdf[i + 1] - cdf[i]))
            };
            let next: Vec<f64> = (0..=GRID)
                .map(|i| {
                    let x = i as f64 * step;
                    ((upto(x) - upto(x - part)) / part).clamp(0.0, 1.0)
                })
                .collect();
            cdf = next;
        }
        cdf[GRID] = 1.0;
        Self { low: 0.0, step, values: cdf }
    }

    /// Its value at a place.
    pub fn at(&self, x: f64) -> f64 {
        let place = ((x - self.low) / self.step).clamp(0.0, GRID as f64);
        let node = (place as usize).min(GRID - 1);
        let (low, high) = (self.values[node], self.values[node + 1]);
        low + (high - low) * (place - node as f64)
    }

    /// The integral of the inverse from 0 to i/n, for every i that there is a place for.
    pub fn integrate_inverse(&self, n: usize, integrals: &mut [f64]) {
        // ∫₀ᵘ F⁻¹ = u·x − ∫ F up to x, at F(x) = u (Young), with x found in the grid.
        let Self { low, step, values: cdf } = self;
        let mut below = 0.0;
        let mut i = 0;
        for (node, place) in integrals.iter_mut().enumerate() {
            let u = node as f64 / n as f64;
            while i + 1 < GRID && cdf[i + 1] < u {
                below += 0.5 * step * (cdf[i] + cdf[i + 1]);
                i += 1;
            }
            let rise = cdf[i + 1] - cdf[i];
            let f = if rise > 0.0 { ((u - cdf[i]) / rise).clamp(0.0, 1.0) } else { 0.0 };
            let x = low + (i as f64 + f) * step;
            *place = u * x - below - step * f * (cdf[i] + 0.5 * f * rise);
        }
    }
}
