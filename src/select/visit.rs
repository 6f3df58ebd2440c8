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
//!
//! Pixels are visited cell by cell. A cell is a unit of its job: of a worker that dies, the cell that
//! it was in is as it was, and those before it are done.

use std::ops::Range;

use perceptile_cluster::shared::{Job, Saver};

use super::footprint::Footprint;
use super::mixture::{MAX_CANDIDATES, Mixture, UNSET};
use super::window::Renders;
use crate::gradient::simd::{Isa, LANES, Vectorized};

/// Columns that are visited at a time, so that what they see stays in the nearest caches.
pub(super) const CELL: usize = 64;

type Register = [f32; LANES];

/// What a strip of one frame has in common for both norms. Rows are those of the strip.
pub(super) struct Strip<'a, const C: usize> {
    pub job: &'a Job<'a>,
    /// Called while a cell is half done.
    pub midway: &'a dyn Fn(),
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
    /// All renders, and where among them the strip of each begins.
    pub renders: &'a Renders,
    pub places: Vec<[usize; C]>,
    /// What is chosen.
    pub current: [&'a mut [f32]; C],
    pub choice: &'a mut [u8],
    /// Counts the pixels that changed.
    pub changes: &'a mut [u64],
}

/// Visits a strip by the squares of errors.
pub(super) struct Squares<'a, const C: usize> {
    pub strip: Strip<'a, C>,
    /// b.
    pub curvature: [&'a [f32]; C],
}

/// Visits a strip by the magnitudes of errors.
pub(super) struct Magnitudes<'a, const C: usize>(pub Strip<'a, C>);

/// A pixel of a strip.
#[derive(Clone, Copy)]
struct Pixel {
    /// Where it is in the rows of the strip.
    index: usize,
    /// Where its footprint begins in the rows of the residual.
    corner: usize,
    /// Its column in the cell.
    column: usize,
}

/// A row of a cell.
struct Row<const C: usize> {
    /// The values of every render.
    renders: Vec<[[f32; CELL]; C]>,
    /// For the errors of every render at a pixel.
    errors: Vec<[f32; C]>,
}

/// What visits pixels.
trait Visit<'a, const C: usize> {
    fn strip(&mut self) -> &mut Strip<'a, C>;

    /// Visits a pixel. Returns whether it changes.
    fn visit(&mut self, pixel: Pixel, row: &mut Row<C>) -> bool;
}

/// Visits all cells that are not done yet.
#[inline(always)]
fn visit_all<'a, const C: usize>(mut visitor: impl Visit<'a, C>) {
    let strip = visitor.strip();
    let (job, midway) = (strip.job, strip.midway);
    let (width, height, stride) = (strip.width, strip.rows.len(), strip.stride);
    let renders = strip.places.len();
    let mut row = Row { renders: vec![[[0.0; CELL]; C]; renders], errors: vec![[0.0; C]; renders] };
    for from in (0..width).step_by(CELL).skip(job.units_done()) {
        let columns = from..(from + CELL).min(width);
        let unit = job.reversible(|saver| visitor.strip().save(columns.clone(), saver));
        let mut changes = 0;
        for y in 0..height {
            visitor.strip().read(&mut row.renders, y * width + columns.start, columns.len());
            for (column, x) in columns.clone().enumerate() {
                let pixel = Pixel { index: y * width + x, corner: y * stride + x, column };
                changes += u64::from(visitor.visit(pixel, &mut row));
            }
        }
        midway();
        visitor.strip().changes[0] += changes;
        unit.done();
    }
}

/// A pixel as it is.
struct Present<'e, const C: usize> {
    /// The error of each render.
    errors: &'e [[f32; C]],
    /// The candidate that is chosen, if one is.
    now: Option<usize>,
    /// Its error; 0 of the reference.
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

    /// Names all that the visit of a cell can change.
    fn save(&mut self, columns: Range<usize>, saver: &mut Saver<'_>) {
        let width = self.width;
        let seen = columns.start..columns.end + self.footprint.overhang();
        for plane in &mut self.residual {
            plane.chunks_exact_mut(self.stride).for_each(|row| saver.save(&mut row[seen.clone()]));
        }
        for plane in &mut self.current {
            plane.chunks_exact_mut(width).for_each(|row| saver.save(&mut row[columns.clone()]));
        }
        self.choice.chunks_exact_mut(width).for_each(|row| saver.save(&mut row[columns.clone()]));
        saver.save(self.changes);
    }

    /// Reads a row of a cell of all renders.
    #[inline(always)]
    fn read(&self, row: &mut [[[f32; CELL]; C]], index: usize, columns: usize) {
        for (row, places) in row.iter_mut().zip(&self.places) {
            for (row, place) in row.iter_mut().zip(places) {
                let from = place + index;
                self.renders.read(from..from + columns, &mut row[..columns]);
            }
        }
    }

    /// What the visit of a pixel begins with.
    #[inline(always)]
    fn present<'e>(&self, pixel: Pixel, row: &'e mut Row<C>) -> Present<'e, C> {
        let Row { renders, errors } = row;
        for (error, render) in errors.iter_mut().zip(renders) {
            for c in 0..C {
                error[c] = render[c][pixel.column] - self.guide[c][pixel.index];
            }
        }
        let errors = &*errors;
        let choice = self.choice[pixel.index];
        let now = (choice != UNSET).then_some(usize::from(choice));
        let own = match now {
            Some(now) => std::array::from_fn(|c| self.mixture.value(now, |k| errors[k][c])),
            None => [0.0; C],
        };
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
    fn take(
        &mut self,
        (pixel, row): (Pixel, &Row<C>),
        candidate: usize,
        change: [f32; C],
        weighted: bool,
    ) {
        match self.footprint.registers {
            1 => self.spread(pixel, change, weighted, 1),
            registers => self.spread(pixel, change, weighted, registers),
        }
        self.choice[pixel.index] = candidate as u8;
        for c in 0..C {
            let render = |k: usize| row.renders[k][c][pixel.column];
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

/// Adds a row of w²·r·g to the sums of every channel. A function, as a closure that is not inlined would
/// be compiled without the vector instructions of its caller.
#[inline(always)]
fn add_row<const C: usize>(
    planes: [&[f32]; C],
    kernel: &[Register],
    (row, stride): (usize, usize),
    registers: usize,
    sums: &mut [Register; C],
) {
    for register in 0..registers {
        let at = row * stride + register * LANES;
        let kernel = &kernel[row * registers + register];
        for c in 0..C {
            let residual: &Register = planes[c][at..at + LANES].try_into().expect("a register");
            for lane in 0..LANES {
                sums[c][lane] += residual[lane] * kernel[lane];
            }
        }
    }
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
            for row in (0..height & !1).step_by(2) {
                add_row(planes, kernel, (row, strip.stride), registers, &mut even);
                add_row(planes, kernel, (row + 1, strip.stride), registers, &mut odd);
            }
            if height % 2 == 1 {
                add_row(planes, kernel, (height - 1, strip.stride), registers, &mut even);
            }
        }
        std::array::from_fn(|c| total(std::array::from_fn(|lane| even[c][lane] + odd[c][lane])))
    }
}

impl<'a, const C: usize> Visit<'a, C> for Squares<'a, C> {
    #[inline(always)]
    fn strip(&mut self) -> &mut Strip<'a, C> {
        &mut self.strip
    }

    #[inline(always)]
    fn visit(&mut self, pixel: Pixel, row: &mut Row<C>) -> bool {
        let strip = &self.strip;
        // A row of one register is most common, and its loop is none.
        let slope = match strip.footprint.registers {
            1 => self.slope(pixel, 1),
            registers => self.slope(pixel, registers),
        };
        let present = strip.present(pixel, row);
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
        self.strip.take((pixel, row), best, change, true);
        true
    }
}

impl<const C: usize> Vectorized for Squares<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        visit_all(self);
    }
}

/// The candidate with the least cost, if that is less than the present one's 0 or there is none.
#[inline(always)]
fn least(costs: &[f32], now: Option<usize>) -> Option<usize> {
    let mut best = now.map_or((costs[0], 0), |now| (0.0, now));
    for (candidate, &cost) in costs.iter().enumerate() {
        if cost < best.0 {
            best = (cost, candidate);
        }
    }
    (Some(best.1) != now).then_some(best.1)
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

impl<'a, const C: usize> Visit<'a, C> for Magnitudes<'a, C> {
    #[inline(always)]
    fn strip(&mut self) -> &mut Strip<'a, C> {
        &mut self.0
    }

    #[inline(always)]
    fn visit(&mut self, pixel: Pixel, row: &mut Row<C>) -> bool {
        let strip = &self.0;
        let present = strip.present(pixel, row);
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
        if let Some(now) = present.now {
            let before = costs[now];
            costs.iter_mut().for_each(|cost| *cost -= before);
        }
        let Some(best) = least(costs, present.now) else {
            return false;
        };
        let change = present.change(strip.mixture, best);
        self.0.take((pixel, row), best, change, false);
        true
    }
}

impl<const C: usize> Vectorized for Magnitudes<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        visit_all(self);
    }
}
