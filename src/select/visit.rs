//! The inner loop: pixel by pixel takes the candidate with the least objective.
//!
//! With r the perceived error, e the error of the pixel itself and w the weights, the objective is
//! Σ w²(r² + λe²) (L2) or Σ w(|r| + λ|e|) (L1). Taking a candidate that differs by δ adds δ·g to r
//! over the kernel's footprint. In L2 that changes the objective by
//!
//! ```text
//! δ (2a + δb + λw²(e + e')),   a = Σ w²·r·g,   b = Σ w²·g²
//! ```
//!
//! where e' is the error afterwards, b stays as it is, and a takes one pass over the footprint. So
//! what is kept in L2 is w²r, and every candidate costs a few operations. In L1 it is r itself, and
//! a pass over the footprint has sums for eight candidates at a time.
//!
//! Sums run in eight lanes whose order is fixed: the same bytes with any instruction set.

use std::ops::Range;

use super::footprint::Footprint;
use super::mixture::{MAX_CANDIDATES, Mixture};
use crate::gradient::simd::{Isa, LANES, Vectorized};

/// Columns that are visited at a time, so that what they see stays in the nearest caches.
const CELL: usize = 64;

type Register = [f32; LANES];

/// What a strip of one frame has in common for both norms. Rows are those of the strip.
pub(super) struct Strip<'a, const C: usize> {
    pub footprint: &'a Footprint,
    pub mixture: &'a Mixture,
    pub rows: Range<usize>,
    pub width: usize,
    /// Numbers from a row of the residual to the next.
    pub stride: usize,
    /// λ.
    pub lambda: f32,
    /// Which frames of the footprint there are.
    pub frames: Range<usize>,
    /// Of each of them and each channel, the rows that the strip sees, from the footprint's first
    /// on: w²·r in L2, r in L1.
    pub residual: Vec<&'a mut [f32]>,
    /// The same for w² in L2, w in L1; 0 in the margins.
    pub weights: Vec<&'a [f32]>,
    /// The reference.
    pub guide: [&'a [f32]; C],
    /// Every render.
    pub renders: Vec<[&'a [f32]; C]>,
    /// What is chosen.
    pub current: [&'a mut [f32]; C],
    pub choice: &'a mut [u8],
}

/// Visits a strip by the squares of errors. Returns how many pixels changed.
pub(super) struct Squares<'a, const C: usize> {
    pub strip: Strip<'a, C>,
    /// b.
    pub curvature: [&'a [f32]; C],
}

/// Visits a strip by the magnitudes of errors. Returns how many pixels changed.
pub(super) struct Magnitudes<'a, const C: usize>(pub Strip<'a, C>);

/// A pixel of a strip.
#[derive(Clone, Copy)]
struct Pixel {
    /// Where it is in the rows of the strip.
    index: usize,
    /// Where its footprint begins in the rows of the residual.
    corner: usize,
}

/// A pixel as it is.
struct Present<'e, const C: usize> {
    /// The error of each render.
    errors: &'e [[f32; C]],
    /// The candidate that is chosen.
    now: usize,
    /// Its error.
    own: [f32; C],
    /// λ times the pixel's own weight.
    closeness: [f32; C],
}

impl<const C: usize> Present<'_, C> {
    /// What another candidate differs by.
    #[inline(always)]
    fn change(&self, mixture: &Mixture, candidate: usize) -> [f32; C] {
        std::array::from_fn(|c| mixture.value(candidate, |k| self.errors[k][c]) - self.own[c])
    }
}

impl<const C: usize> Strip<'_, C> {
    /// Where a pixel's own weight is, from the corner of its footprint on.
    #[inline(always)]
    fn centre(&self) -> (usize, usize) {
        let [left, top, ..] = self.footprint.margins();
        let frame = (-self.footprint.low.z) as usize - self.frames.start;
        (frame * C, top * self.stride + left)
    }

    /// The cells, from the left: their columns.
    #[inline(always)]
    fn cells(&self) -> impl Iterator<Item = Range<usize>> + use<C> {
        let width = self.width;
        (0..width).step_by(CELL).map(move |from| from..(from + CELL).min(width))
    }

    /// A pixel of a row of the strip.
    #[inline(always)]
    fn pixel(&self, x: usize, y: usize) -> Pixel {
        Pixel { index: y * self.width + x, corner: y * self.stride + x }
    }

    /// What the visit of a pixel begins with.
    #[inline(always)]
    fn present<'e>(&self, pixel: Pixel, errors: &'e mut [[f32; C]]) -> Present<'e, C> {
        for (error, render) in errors.iter_mut().zip(&self.renders) {
            for c in 0..C {
                error[c] = render[c][pixel.index] - self.guide[c][pixel.index];
            }
        }
        let now = usize::from(self.choice[pixel.index]);
        let own = std::array::from_fn(|c| self.mixture.value(now, |k| errors[k][c]));
        let (frame, centre) = self.centre();
        let weight = |c: usize| self.weights[frame + c][pixel.corner + centre];
        let closeness = std::array::from_fn(|c| self.lambda * weight(c));
        Present { errors, now, own, closeness }
    }

    /// The errors of the candidates in a register.
    #[inline(always)]
    fn errors(&self, register: usize, errors: &[[f32; C]]) -> [Register; C] {
        let mut values = [[0.0; LANES]; C];
        for (weights, render) in self.mixture.register(register).iter().zip(errors) {
            for c in 0..C {
                for lane in 0..LANES {
                    values[c][lane] += weights[lane] * render[c];
                }
            }
        }
        values
    }

    /// Takes a candidate that differs by `change`. `weighted` says whether the residual is w²·r.
    #[inline(always)]
    fn take(&mut self, pixel: Pixel, candidate: usize, change: [f32; C], weighted: bool) {
        match self.footprint.registers {
            1 => self.spread(pixel, change, weighted, 1),
            registers => self.spread(pixel, change, weighted, registers),
        }
        self.choice[pixel.index] = candidate as u8;
        for c in 0..C {
            let render = |k: usize| self.renders[k][c][pixel.index];
            self.current[c][pixel.index] = self.mixture.value(candidate, render);
        }
    }

    /// Adds a change of a pixel to the residual around it.
    #[inline(always)]
    fn spread(&mut self, pixel: Pixel, change: [f32; C], weighted: bool, registers: usize) {
        let height = self.footprint.height;
        for (i, frame) in self.frames.clone().enumerate() {
            let kernel = self.footprint.frame(frame);
            for c in 0..C {
                let plane = &mut self.residual[i * C + c][pixel.corner..];
                let weights = &self.weights[i * C + c][pixel.corner..];
                for row in 0..height {
                    for register in 0..registers {
                        let at = row * self.stride + register * LANES;
                        let kernel = &kernel[row * registers + register];
                        let residual: &mut Register =
                            (&mut plane[at..at + LANES]).try_into().expect("a register");
                        let weights: &Register =
                            (&weights[at..at + LANES]).try_into().expect("a register");
                        for lane in 0..LANES {
                            let change = kernel[lane] * change[c];
                            residual[lane] +=
                                if weighted { change * weights[lane] } else { change };
                        }
                    }
                }
            }
        }
    }
}

/// The sum of all lanes, in a fixed order.
#[inline(always)]
fn total(register: Register) -> f32 {
    let [a, b, c, d, e, f, g, h] = register;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

impl<const C: usize> Squares<'_, C> {
    /// a of every channel. Rows of even and odd number have sums of their own, which do not wait for
    /// each other.
    #[inline(always)]
    fn slope(&self, pixel: Pixel, registers: usize) -> [f32; C] {
        let strip = &self.strip;
        let height = strip.footprint.height;
        let (mut even, mut odd) = ([[0.0_f32; LANES]; C], [[0.0_f32; LANES]; C]);
        for (i, frame) in strip.frames.clone().enumerate() {
            let kernel = strip.footprint.frame(frame);
            let planes: [&[f32]; C] =
                std::array::from_fn(|c| &strip.residual[i * C + c][pixel.corner..]);
            let add = |row: usize, sums: &mut [Register; C]| {
                for register in 0..registers {
                    let at = row * strip.stride + register * LANES;
                    let kernel = &kernel[row * registers + register];
                    for c in 0..C {
                        let residual: &Register =
                            planes[c][at..at + LANES].try_into().expect("a register");
                        for lane in 0..LANES {
                            sums[c][lane] += residual[lane] * kernel[lane];
                        }
                    }
                }
            };
            for row in (0..height & !1).step_by(2) {
                add(row, &mut even);
                add(row + 1, &mut odd);
            }
            if height % 2 == 1 {
                add(height - 1, &mut even);
            }
        }
        std::array::from_fn(|c| total(std::array::from_fn(|lane| even[c][lane] + odd[c][lane])))
    }
}

impl<const C: usize> Squares<'_, C> {
    /// Visits a pixel. Returns whether it changes.
    #[inline(always)]
    fn visit(&mut self, pixel: Pixel, errors: &mut [[f32; C]]) -> bool {
        let strip = &self.strip;
        // A row of one register is most common, and its loop is none.
        let slope = match strip.footprint.registers {
            1 => self.slope(pixel, 1),
            registers => self.slope(pixel, registers),
        };
        let present = strip.present(pixel, errors);
        let curvature = self.curvature.map(|plane| plane[pixel.index]);
        let mut costs = [0.0; MAX_CANDIDATES];
        for register in 0..strip.mixture.registers() {
            let values = strip.errors(register, present.errors);
            let mut sum = [0.0_f32; LANES];
            for c in 0..C {
                let own = present.own[c];
                for lane in 0..LANES {
                    let change = values[c][lane] - own;
                    let steep = (2.0 * slope[c] + change * curvature[c])
                        + present.closeness[c] * (values[c][lane] + own);
                    sum[lane] += change * steep;
                }
            }
            costs[register * LANES..][..LANES].copy_from_slice(&sum);
        }
        let Some(best) = least(&costs[..strip.mixture.candidates()], present.now) else {
            return false;
        };
        let change = present.change(strip.mixture, best);
        self.strip.take(pixel, best, change, true);
        true
    }
}

impl<const C: usize> Vectorized for Squares<'_, C> {
    type Output = u64;

    #[inline(always)]
    fn run<I: Isa>(mut self, _: I) -> u64 {
        let mut errors = vec![[0.0; C]; self.strip.renders.len()];
        let mut changes = 0;
        for columns in self.strip.cells() {
            for y in 0..self.strip.rows.len() {
                for x in columns.clone() {
                    changes += u64::from(self.visit(self.strip.pixel(x, y), &mut errors));
                }
            }
        }
        changes
    }
}

/// The candidate with the least cost, if that is less than the present one's 0.
#[inline(always)]
fn least(costs: &[f32], now: usize) -> Option<usize> {
    let mut best = (0.0, now);
    for (candidate, &cost) in costs.iter().enumerate() {
        if cost < best.0 {
            best = (cost, candidate);
        }
    }
    (best.1 != now).then_some(best.1)
}

impl<const C: usize> Magnitudes<'_, C> {
    /// Σ w|r + δ·g| over the footprint for the candidates of a register, which differ by `change`.
    #[inline(always)]
    fn magnitudes(&self, pixel: Pixel, change: &[Register; C], registers: usize) -> Register {
        let strip = &self.0;
        let height = strip.footprint.height;
        let mut sums = [[0.0_f32; LANES]; LANES];
        for (i, frame) in strip.frames.clone().enumerate() {
            let kernel = strip.footprint.frame(frame);
            for c in 0..C {
                let residual = &strip.residual[i * C + c][pixel.corner..];
                let weights = &strip.weights[i * C + c][pixel.corner..];
                for row in 0..height {
                    for register in 0..registers {
                        let at = row * strip.stride + register * LANES;
                        let kernel = &kernel[row * registers + register];
                        let residual: &Register =
                            residual[at..at + LANES].try_into().expect("a register");
                        let weights: &Register =
                            weights[at..at + LANES].try_into().expect("a register");
                        for (sum, change) in sums.iter_mut().zip(&change[c]) {
                            for lane in 0..LANES {
                                let after = residual[lane] + change * kernel[lane];
                                sum[lane] += weights[lane] * after.abs();
                            }
                        }
                    }
                }
            }
        }
        sums.map(total)
    }
}

impl<const C: usize> Magnitudes<'_, C> {
    /// Visits a pixel. Returns whether it changes.
    #[inline(always)]
    fn visit(&mut self, pixel: Pixel, errors: &mut [[f32; C]]) -> bool {
        let strip = &self.0;
        let present = strip.present(pixel, errors);
        let mut costs = [0.0; MAX_CANDIDATES];
        for register in 0..strip.mixture.registers() {
            let values = strip.errors(register, present.errors);
            let change: [Register; C] =
                std::array::from_fn(|c| values[c].map(|value| value - present.own[c]));
            let mut sum = match strip.footprint.registers {
                1 => self.magnitudes(pixel, &change, 1),
                registers => self.magnitudes(pixel, &change, registers),
            };
            for (values, closeness) in values.iter().zip(present.closeness) {
                for lane in 0..LANES {
                    sum[lane] += closeness * values[lane].abs();
                }
            }
            costs[register * LANES..][..LANES].copy_from_slice(&sum);
        }
        let costs = &mut costs[..strip.mixture.candidates()];
        let before = costs[present.now];
        costs.iter_mut().for_each(|cost| *cost -= before);
        let Some(best) = least(costs, present.now) else {
            return false;
        };
        let change = present.change(strip.mixture, best);
        self.0.take(pixel, best, change, false);
        true
    }
}

impl<const C: usize> Vectorized for Magnitudes<'_, C> {
    type Output = u64;

    #[inline(always)]
    fn run<I: Isa>(mut self, _: I) -> u64 {
        let mut errors = vec![[0.0; C]; self.0.renders.len()];
        let mut changes = 0;
        for columns in self.0.cells() {
            for y in 0..self.0.rows.len() {
                for x in columns.clone() {
                    changes += u64::from(self.visit(self.0.pixel(x, y), &mut errors));
                }
            }
        }
        changes
    }
}
