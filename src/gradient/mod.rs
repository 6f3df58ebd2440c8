//! The gradient of the filtered sliced Wasserstein distance (Algorithm 1, line 9).
//!
//! A draw gathers its subset of samples from the cell's block, projects it onto its directions,
//! ranks the projections, and pulls every sample along each direction towards the quantile of
//! its rank (supplement, Eq. 8). In that equation the factors m/n and 1/m cancel, so samples are
//! pulled by the plain difference, whatever the size of the subset; the objective whose negative
//! gradient this is, is half the sum over draws and samples of (projection − target)², that is
//! n·W₂²/2 of each subset. `reference` says the same in f64 and without haste.
//!
//! Pulls add up as integers in a [`Patch`], in units of a quantum that no sum can overflow, so
//! that the order of draws, threads and ranks cannot matter.

mod rank;
pub mod reference;
pub mod simd;
mod target;

pub use target::Targets;

use glam::IVec3;

use crate::draw::{CellDraws, Direction, Draw, Draws, LevelSets};
use crate::tile::{Block, Partition, TileShape};
use rank::rank;
use simd::{Simd, Vectorized};

/// The unit of integer gradients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quantum {
    exponent: u32,
}

impl Quantum {
    /// The finest unit for which no gradient can overflow, and no finer than 2⁻²⁰.
    ///
    /// A coordinate is pulled by at most √d in a direction, because all projections lie in an
    /// interval no longer than that. A sample is in a draw's subset only if the draw's pixel lies
    /// at one of the offsets of its level set, so at most `offsets · most_per_pixel` draws (and
    /// no more than there are) pull at it. With half a unit more for each rounding, the sum must
    /// stay below 2³¹; and a single pull below 2²², for the rounding itself. `None` if the unit
    /// would be coarser than 2⁻¹⁰, a sixteenth of a pixel's share of a small tile.
    pub fn new(draws: &Draws, partition: &Partition) -> Option<Self> {
        let levels = draws.levels();
        let offsets: usize = levels.sets().iter().map(|set| set.offsets.len()).sum();
        let touching =
            draws.most_per_pixel(partition).saturating_mul(offsets).min(draws.options().draws)
                as f64;
        let dims = partition.shape().dims() as f64;
        let pull = draws.options().directions as f64 * dims.sqrt();
        let fits = |exponent: u32| {
            let units = pull * f64::from(1_u32 << exponent) + 0.5;
            units * touching < f64::from(i32::MAX) && units < f64::from(1 << 22)
        };
        (10..=20).rev().find(|&exponent| fits(exponent)).map(|exponent| Self { exponent })
    }

    /// Units per unit of the cube.
    pub fn scale(self) -> f32 {
        (1_u32 << self.exponent) as f32
    }

    /// Size of a unit.
    pub fn unit(self) -> f32 {
        1.0 / self.scale()
    }
}

/// The taps of all level sets as distances in the memory of a block.
#[derive(Debug, Clone)]
struct TapWords {
    /// Per set and tap: the distance in words inside the block, and in frames.
    sets: Vec<Vec<(i32, i32)>>,
    /// Words from a frame to the next.
    frame: i32,
    frames: i32,
    /// Words of a pixel.
    pixel: usize,
}

impl TapWords {
    fn new(levels: &LevelSets, block: Block, shape: TileShape) -> Self {
        let pixel = shape.spp() * shape.dims();
        let row = block.width as i32 * pixel as i32;
        let frame = row * block.height as i32;
        let word = |o: &IVec3| {
            // However far a tap lies, it is less than a period away around the torus.
            let frames = o.z % block.frames as i32;
            (frames * frame + o.y * row + o.x * pixel as i32, frames)
        };
        let sets = levels.sets().iter().map(|set| set.offsets.iter().map(word).collect()).collect();
        Self { sets, frame, frames: block.frames as i32, pixel }
    }
}

/// Scratch for one thread, as large as the largest subset.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    draws: CellDraws,
    /// First word of each gathered sample in the block.
    words: Vec<u32>,
    /// Coordinates, and the pulls on them, one run of samples for each dimension.
    points: Vec<f32>,
    pulls: Vec<f32>,
    projections: Vec<f32>,
    ranks: Vec<u32>,
    targets: Vec<f32>,
    keys: Vec<u64>,
}

/// The integer gradient of a cell and its halo, private until it is merged.
#[derive(Debug)]
pub struct Patch<'a> {
    /// One word for each coordinate of the block, in its order; in units of the quantum, and
    /// pointing downhill.
    pub words: &'a mut [i32],
}

/// What the draws of a cell found.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CellObjective {
    /// Sum over the draws' directions of W₂².
    pub squared_distance: f64,
    /// Number of directions.
    pub directions: usize,
}

/// Computes the gradients of cells.
#[derive(Debug, Clone)]
pub struct Gradient {
    draws: Draws,
    partition: Partition,
    targets: Targets,
    quantum: Quantum,
    simd: Simd,
    /// Tap distances for each kind of block, and which kind each cell has.
    kinds: Vec<(Block, TapWords)>,
    kind_of: Vec<usize>,
}

impl Gradient {
    /// Prepares the tables for `draws` on the cells of `partition`.
    pub fn new(draws: Draws, partition: Partition, quantum: Quantum, simd: Simd) -> Self {
        let mut kinds: Vec<(Block, TapWords)> = Vec::new();
        let kind_of = (0..partition.cells())
            .map(|cell| {
                let block = partition.block(cell);
                kinds.iter().position(|kind| kind.0 == block).unwrap_or_else(|| {
                    kinds.push((block, TapWords::new(draws.levels(), block, partition.shape())));
                    kinds.len() - 1
                })
            })
            .collect();
        let targets = Targets::new(draws.directions());
        Self { draws, partition, targets, quantum, simd, kinds, kind_of }
    }

    /// The cells that gradients are computed for.
    pub fn partition(&self) -> &Partition {
        &self.partition
    }

    /// The draws that gradients are made of.
    pub fn draws(&self) -> &Draws {
        &self.draws
    }

    /// The unit of the gradients.
    pub fn quantum(&self) -> Quantum {
        self.quantum
    }

    /// Makes the draws of `cell` in `step` and writes their gradient to `patch`.
    ///
    /// `samples` is the cell's block.
    ///
    /// # Panics
    /// If `samples` or `patch` is not as long as the block.
    pub fn cell(
        &self,
        step: u32,
        cell: usize,
        samples: &[f32],
        patch: Patch<'_>,
        workspace: &mut Workspace,
    ) -> CellObjective {
        let (block, taps) = &self.kinds[self.kind_of[cell]];
        assert_eq!(samples.len(), block.pixels() * taps.pixel, "samples of a block");
        assert_eq!(patch.words.len(), samples.len(), "patch of a block");
        patch.words.fill(0);
        let mut cell_draws = std::mem::take(&mut workspace.draws);
        self.draws.cell(&self.partition, step, cell, &mut cell_draws);
        let job =
            Job { gradient: self, block, taps, samples, patch, workspace, draws: &cell_draws };
        let objective = match self.partition.shape().dims() {
            1 => self.simd.run(Fixed::<1>(job)),
            2 => self.simd.run(Fixed::<2>(job)),
            3 => self.simd.run(Fixed::<3>(job)),
            4 => self.simd.run(Fixed::<4>(job)),
            _ => self.simd.run(Any(job)),
        };
        workspace.draws = cell_draws;
        objective
    }
}

/// All draws of a cell, to be done in one go.
struct Job<'a> {
    gradient: &'a Gradient,
    block: &'a Block,
    taps: &'a TapWords,
    samples: &'a [f32],
    patch: Patch<'a>,
    workspace: &'a mut Workspace,
    draws: &'a CellDraws,
}

/// A job in a number of dimensions that the compiler knows.
struct Fixed<'a, const DIMS: usize>(Job<'a>);

impl<const DIMS: usize> Vectorized for Fixed<'_, DIMS> {
    type Output = CellObjective;

    #[inline(always)]
    fn run(self) -> CellObjective {
        run(self.0, DIMS)
    }
}

/// A job in any number of dimensions.
struct Any<'a>(Job<'a>);

impl Vectorized for Any<'_> {
    type Output = CellObjective;

    #[inline(always)]
    fn run(self) -> CellObjective {
        let dims = self.0.gradient.partition.shape().dims();
        run(self.0, dims)
    }
}

#[inline(always)]
fn run(mut job: Job<'_>, dims: usize) -> CellObjective {
    let per_draw = job.gradient.draws.options().directions;
    let mut objective = CellObjective::default();
    let draws = job.draws;
    for (draw, directions) in draws.draws.iter().zip(draws.directions.chunks(per_draw)) {
        objective.squared_distance += one_draw(&mut job, draw, directions, dims);
        objective.directions += directions.len();
    }
    objective
}

/// Gathers, then projects, ranks and pulls along each direction, then scatters. Returns the sum
/// of W₂² over the directions.
#[inline(always)]
fn one_draw(job: &mut Job<'_>, draw: &Draw, directions: &[Direction], dims: usize) -> f64 {
    let Job { gradient, block, taps, samples, patch, workspace, .. } = job;
    let spp = taps.pixel / dims;
    let set = &taps.sets[draw.set as usize][..draw.taps as usize];
    let n = set.len() * spp;
    let Workspace { words, points, pulls, projections, ranks, targets, keys, .. } =
        &mut **workspace;
    if words.len() < n {
        words.resize(n, 0);
        ranks.resize(n, 0);
        for scratch in [&mut *projections, &mut *targets] {
            scratch.resize(n, 0.0);
        }
        for scratch in [&mut *points, &mut *pulls] {
            scratch.resize(n * dims, 0.0);
        }
    }
    let (words, ranks) = (&mut words[..n], &mut ranks[..n]);
    let (projections, targets) = (&mut projections[..n], &mut targets[..n]);
    let (points, pulls) = (&mut points[..n * dims], &mut pulls[..n * dims]);

    let t = draw.t as i32;
    let pixel = block.pixel(draw.x as usize, draw.y as usize, draw.t as usize);
    let first = (pixel * taps.pixel) as i32;
    let period = taps.frame * taps.frames;
    for (place, &(word, frames)) in words.chunks_exact_mut(spp).zip(set) {
        let frame = t + frames;
        let wrap = if frame < 0 {
            period
        } else if frame >= taps.frames {
            -period
        } else {
            0
        };
        let word = (first + word + wrap) as u32;
        for (s, place) in place.iter_mut().enumerate() {
            *place = word + (s * dims) as u32;
        }
    }
    for (i, &word) in words.iter().enumerate() {
        let point = &samples[word as usize..word as usize + dims];
        for (k, &x) in point.iter().enumerate() {
            points[k * n + i] = x;
        }
    }

    let scale = gradient.quantum.scale();
    let mut squares = 0.0;
    for (nth, direction) in directions.iter().enumerate() {
        projections.fill(0.0);
        for k in 0..dims {
            let theta = direction.theta[k];
            for (projection, &x) in projections.iter_mut().zip(&points[k * n..(k + 1) * n]) {
                *projection += theta * x;
            }
        }
        gradient.targets.fill(direction, targets);
        rank(projections, ranks, keys);
        let mut square = 0.0_f32;
        for (projection, &rank) in projections.iter_mut().zip(&*ranks) {
            *projection = targets[rank as usize] - *projection;
            square += *projection * *projection;
        }
        squares += f64::from(square) / n as f64;
        for k in 0..dims {
            let theta = scale * direction.theta[k];
            let pulls = &mut pulls[k * n..(k + 1) * n];
            for (pull, &difference) in pulls.iter_mut().zip(&*projections) {
                let before = if nth == 0 { 0.0 } else { *pull };
                *pull = before + theta * difference;
            }
        }
    }
    for (i, &word) in words.iter().enumerate() {
        let place = &mut patch.words[word as usize..word as usize + dims];
        for (k, sum) in place.iter_mut().enumerate() {
            *sum += to_integer(pulls[k * n + i]);
        }
    }
    squares
}

/// The nearest integer (ties to even) of a number of magnitude below 2²².
#[inline(always)]
fn to_integer(x: f32) -> i32 {
    // Adding 1.5·2²³ leaves the integer in the low bits of the significand.
    const MAGIC: f32 = 12_582_912.0;
    (x + MAGIC).to_bits() as i32 - MAGIC.to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rounding_is_to_nearest_even(x in -4_194_303.0_f32..4_194_303.0, halves in -4000_i32..4000) {
            prop_assert_eq!(to_integer(x), x.round_ties_even() as i32);
            let half = halves as f32 * 0.5;
            prop_assert_eq!(to_integer(half), half.round_ties_even() as i32);
        }
    }
}
