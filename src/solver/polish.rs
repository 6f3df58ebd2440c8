//! A polish beyond the paper: full-batch descent on the energy distance of all kernels at once.
//!
//! The perceived squared error of all half-planes together is an energy distance,
//!
//! E = −½ Σᵢⱼ Gᵢⱼ |xᵢ − xⱼ| + Σᵢ V(xᵢ) ΣG,
//!
//! with G the autocorrelation of the kernel over pixel offsets and V(x) the mean distance from x
//! to the square (Székely and Rizzo 2004 for the distance). It has neither sorting nor noise,
//! and needs only neighbours within twice the kernel's reach. Mixtures add up their G. An axis
//! term, the same energy of single coordinates, adds what axis-aligned edges see. In more than
//! two dimensions the energy is summed over all pairs of dimensions.
//!
//! Every sample's gradient is summed by one thread in the order of the offsets, so no order of
//! execution can change it.

use glam::IVec3;
use perceptile_cluster::World;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::gradient::simd::{Simd, Vectorized};
use crate::kernel::KernelTaps;
use crate::solver::adam::AdamOptions;
use crate::solver::blocks::{Blocks, split};
use crate::solver::state::{CellSamples, State};
use crate::solver::step::update;
use crate::tile::{Block, Cell, Partition, Reach};

/// How the polish is done.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PolishOptions {
    /// Full-batch steps; 0 leaves the tile as it is.
    pub steps: u32,
    /// Weight of the energy of single coordinates against that of pairs, at least 0.
    pub axis_weight: f64,
    /// Weight of the squared mean of single coordinates (−½|xᵢ − xⱼ|² in place of the distance),
    /// at least 0.
    pub linear_weight: f64,
    /// How Adam moves the samples.
    pub adam: AdamOptions,
}

/// Samples of a row that are worked on together.
const LANES: usize = 8;

/// One offset of the autocorrelation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pair {
    offset: IVec3,
    weight: f32,
}

/// Σ over classes of weight · autocorrelation, each scaled to 1 at offset 0, with offsets in time
/// taken modulo the tile's frames; sorted by place.
fn autocorrelation(classes: &[(f64, &KernelTaps)], frames: usize) -> Vec<(IVec3, f64)> {
    let mut sums = std::collections::BTreeMap::<(i32, i32, i32), f64>::new();
    for (weight, kernel) in classes {
        let square: f64 = kernel.taps().iter().map(|tap| tap.weight * tap.weight).sum();
        for a in kernel.taps() {
            for b in kernel.taps() {
                let o = b.offset - a.offset;
                let t = o.z.rem_euclid(frames as i32);
                *sums.entry((t, o.y, o.x)).or_default() += weight * a.weight * b.weight / square;
            }
        }
    }
    sums.into_iter().map(|((t, y, x), g)| (IVec3::new(x, y, t), g)).collect()
}

/// Full-batch descent on the energy.
pub struct Polish {
    world: World,
    options: PolishOptions,
    simd: Simd,
    blocks: Blocks,
    state: State,
    pairs: Vec<Pair>,
    /// Weight of a sample with itself, which other samples of its pixel share.
    own: f32,
    /// Σ over all pairs of weights, for the pull of the uniform density.
    total: f32,
    density: Density,
    pulls: Vec<f32>,
    mailbox: Vec<f32>,
}

impl Polish {
    /// Prepares the descent from `samples` for a mixture of kernels with weights.
    pub fn new(
        world: World,
        partition: &Partition,
        classes: &[(f64, &KernelTaps)],
        options: PolishOptions,
        simd: Simd,
        samples: &CellSamples,
    ) -> Self {
        let shape = partition.shape();
        let all = autocorrelation(classes, shape.frames());
        let far = |of: fn(&IVec3) -> i32| {
            all.iter().map(|(o, _)| of(o)).max().unwrap_or(0).max(0) as usize
        };
        let reach = Reach {
            left: far(|o| -o.x),
            right: far(|o| o.x),
            up: far(|o| -o.y),
            down: far(|o| o.y),
        };
        let total: f64 = all.iter().map(|(_, g)| g).sum();
        let own = all.iter().find(|(o, _)| *o == IVec3::ZERO).map_or(0.0, |(_, g)| *g);
        let pairs = all
            .into_iter()
            .filter(|(o, g)| *o != IVec3::ZERO && *g != 0.0)
            .map(|(offset, g)| Pair { offset, weight: g as f32 })
            .collect();
        let blocks = Blocks::new(partition.with_reach(reach), world);
        let mut state = State::new(&blocks, samples);
        let mut mailbox = Vec::new();
        blocks.copy_to_halos(world, &mut state.current_mut().samples, &mut mailbox);
        Self {
            world,
            options,
            simd,
            state,
            pairs,
            own: own as f32,
            total: (total * shape.spp() as f64) as f32,
            density: Density::new(),
            pulls: vec![0.0; blocks.cell_words().iter().sum()],
            blocks,
            mailbox,
        }
    }

    /// Does step number `step`.
    pub fn step(&mut self, step: u32) {
        self.pull();
        let factors = self.options.adam.factors(step, self.options.steps, 1.0);
        let blocks = &self.blocks;
        update(blocks, &mut self.state, &self.pulls, blocks.cell_words(), factors, self.simd);
        let (_, new) = self.state.old_and_new();
        self.blocks.copy_to_halos(self.world, &mut new.samples, &mut self.mailbox);
        self.state.commit();
    }

    /// Goes on from other samples, with the moments as they are.
    pub fn replace(&mut self, samples: &CellSamples) {
        self.state.replace(&self.blocks, samples);
        let samples = &mut self.state.current_mut().samples;
        self.blocks.copy_to_halos(self.world, samples, &mut self.mailbox);
    }

    /// The samples as of the last step.
    pub fn samples(&self) -> CellSamples {
        self.state.samples(&self.blocks)
    }

    fn pull(&mut self) {
        let blocks = &self.blocks;
        let shape = blocks.partition().shape();
        let mut samples = &self.state.current().samples[..];
        let jobs: Vec<(usize, &[f32], &mut [f32])> = split(&mut self.pulls, blocks.cell_words())
            .into_iter()
            .zip(blocks.block_words())
            .enumerate()
            .map(|(i, (pulls, &size))| {
                let (block, rest) = samples.split_at(size);
                samples = rest;
                (blocks.first() + i, block, pulls)
            })
            .collect();
        let (simd, pairs, density) = (self.simd, &self.pairs, &self.density);
        let (own, total) = (self.own, self.total);
        let PolishOptions { axis_weight, linear_weight, .. } = self.options;
        let terms = Terms { axis: axis_weight as f32, linear: linear_weight as f32 };
        jobs.into_par_iter().with_max_len(1).for_each(|(cell, samples, pulls)| {
            let (cell, block) = (blocks.partition().cell(cell), blocks.partition().block(cell));
            let planes = planes(samples, shape.spp() * shape.dims());
            pulls.fill(0.0);
            // The rows of frame t: where each pair's other row starts.
            (0..shape.frames()).for_each(|t| {
                let words: Vec<(i32, f32)> = pairs
                    .iter()
                    .map(|pair| {
                        let frame = (t as i32 + pair.offset.z) % shape.frames() as i32;
                        let rows = (frame - t as i32) * block.height as i32 + pair.offset.y;
                        (rows * block.width as i32 + pair.offset.x, pair.weight)
                    })
                    .collect();
                let frame = Frame {
                    cell,
                    block,
                    t,
                    spp: shape.spp(),
                    dims: shape.dims(),
                    planes: &planes,
                    words: &words,
                    own,
                    terms,
                    total,
                    density,
                };
                simd.run(FrameJob { frame, pulls });
            });
        });
    }
}

/// Takes interleaved samples apart: one plane for each number of a pixel, with room behind it
/// for lanes that run over the last row.
fn planes(samples: &[f32], pixel: usize) -> Vec<Vec<f32>> {
    (0..pixel)
        .map(|k| {
            let mut plane: Vec<f32> = samples.iter().skip(k).step_by(pixel).copied().collect();
            plane.resize(plane.len() + LANES, 0.0);
            plane
        })
        .collect()
}

/// One frame of a cell.
struct Frame<'a> {
    cell: Cell,
    block: Block,
    t: usize,
    spp: usize,
    dims: usize,
    planes: &'a [Vec<f32>],
    words: &'a [(i32, f32)],
    own: f32,
    terms: Terms,
    total: f32,
    density: &'a Density,
}

struct FrameJob<'a> {
    frame: Frame<'a>,
    pulls: &'a mut [f32],
}

impl Vectorized for FrameJob<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { frame, pulls } = self;
        let Cell { width, height, .. } = frame.cell;
        let (spp, dims) = (frame.spp, frame.dims);
        for y in 0..height {
            for x in (0..width).step_by(LANES) {
                let place = frame.block.pixel(x, y, frame.t);
                let size = LANES.min(width - x);
                for s in 0..spp {
                    let pull_at = ((frame.t * height + y) * width + x) * spp + s;
                    for b in 0..dims {
                        // A lone dimension is its own pair.
                        for a in 0..b.max(usize::from(dims == 1)) {
                            let [first, second] = frame.pair(place, s, a, b);
                            for lane in 0..size {
                                let word = (pull_at + lane * spp) * dims;
                                pulls[word + a] += first[lane];
                                if a != b {
                                    pulls[word + b] += second[lane];
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

impl Frame<'_> {
    /// The pull on dimensions `a` and `b` of sample `s` of the pixels from `place` on; where they
    /// are one, on that alone.
    #[inline(always)]
    fn pair(&self, place: usize, s: usize, a: usize, b: usize) -> [[f32; LANES]; 2] {
        let load = |s: usize, place: usize| -> [[f32; LANES]; 2] {
            let row = |k: usize| -> [f32; LANES] {
                let plane = &self.planes[s * self.dims + k];
                plane[place..place + LANES].try_into().expect("a slice of that length")
            };
            [row(a), if a == b { [0.0; LANES] } else { row(b) }]
        };
        let at = load(s, place);
        let mut pull = [[0.0_f32; LANES]; 2];
        for other in 0..self.spp {
            if other != s {
                self.terms.push(&mut pull, at, load(other, place), self.own);
            }
            for &(word, weight) in self.words {
                let from = (place as i32 + word) as usize;
                self.terms.push(&mut pull, at, load(other, from), weight);
            }
        }
        let away = self.terms.axis + 0.5 * self.terms.linear;
        for lane in 0..LANES {
            let [x, y] = [at[0][lane], at[1][lane]];
            let [gx, gy] = if a == b { [2.0 * x - 1.0, 0.0] } else { self.density.gradient(x, y) };
            pull[0][lane] -= self.total * (gx + away * (2.0 * x - 1.0));
            pull[1][lane] -= self.total * (gy + away * (2.0 * y - 1.0));
        }
        pull
    }
}

/// Weights of the energy's terms of single coordinates against the distance.
#[derive(Debug, Clone, Copy)]
struct Terms {
    axis: f32,
    linear: f32,
}

impl Terms {
    /// Adds the push of one neighbour for each lane.
    #[inline(always)]
    fn push(
        self,
        pull: &mut [[f32; LANES]; 2],
        at: [[f32; LANES]; 2],
        other: [[f32; LANES]; 2],
        weight: f32,
    ) {
        let axis = weight * self.axis;
        for lane in 0..LANES {
            let dx = at[0][lane] - other[0][lane];
            let dy = at[1][lane] - other[1][lane];
            let by = weight * (inverse_root(dx * dx + dy * dy) + self.linear);
            pull[0][lane] += by * dx + axis * sign(dx);
            pull[1][lane] += by * dy + axis * sign(dy);
        }
    }
}

/// −1, 0 or 1.
#[inline(always)]
fn sign(x: f32) -> f32 {
    f32::from(i8::from(x > 0.0)) - f32::from(i8::from(x < 0.0))
}

/// 1/√x to five digits for x ≥ 0 (finite at 0): a first guess by halving the exponent in the bit
/// pattern, then two Newton steps. Plain arithmetic, so that it is the same on every machine.
#[inline(always)]
fn inverse_root(x: f32) -> f32 {
    /// 3/2 · 2²³ · (127 − 0.045), which the halved bit pattern is taken from; 0.045 makes the
    /// guess best on average over a significand.
    const GUESS: u32 = 0x5f37_59df;
    let x = x + 1e-30;
    let half = 0.5 * x;
    let mut y = f32::from_bits(GUESS - (x.to_bits() >> 1));
    for _ in 0..2 {
        y *= 1.5 - half * y * y;
    }
    y
}

/// The gradient of the mean distance from a point to the unit square, on a grid.
#[derive(Debug, Clone)]
struct Density {
    /// Along x; along y it is the transpose.
    grid: Vec<f32>,
}

impl Density {
    const CELLS: usize = 256;

    fn new() -> Self {
        let at = |i: usize| i as f64 / Self::CELLS as f64;
        let grid = (0..=Self::CELLS)
            .flat_map(|j| {
                (0..=Self::CELLS).map(move |i| {
                    (distances_to_side(at(i), at(j)) - distances_to_side(1.0 - at(i), at(j))) as f32
                })
            })
            .collect();
        Self { grid }
    }

    #[inline(always)]
    fn gradient(&self, x: f32, y: f32) -> [f32; 2] {
        let cells = Self::CELLS as f32;
        let (px, py) = (x.clamp(0.0, 1.0) * cells, y.clamp(0.0, 1.0) * cells);
        [self.bilinear(px, py), self.bilinear(py, px)]
    }

    #[inline(always)]
    fn bilinear(&self, x: f32, y: f32) -> f32 {
        let (i, j) = ((x as usize).min(Self::CELLS - 1), (y as usize).min(Self::CELLS - 1));
        let (fx, fy) = (x - i as f32, y - j as f32);
        let at = |i: usize, j: usize| self.grid[j * (Self::CELLS + 1) + i];
        let low = at(i, j) + (at(i + 1, j) - at(i, j)) * fx;
        let high = at(i, j + 1) + (at(i + 1, j + 1) - at(i, j + 1)) * fx;
        low + (high - low) * fy
    }
}

/// ∫₀¹ √(x² + (y − v)²) dv: the distances from (x, y) to the points of the side at x = 0. The
/// gradient of the mean distance to the square is the difference of two opposite sides.
fn distances_to_side(x: f64, y: f64) -> f64 {
    let part = |s: f64| {
        let root = (x * x + s * s).sqrt();
        let log = if x > 0.0 { x * x * libm::asinh(s / x) } else { 0.0 };
        0.5 * (s * root + log)
    };
    part(y) + part(1.0 - y)
}
