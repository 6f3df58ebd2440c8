//! The gradient of the filtered sliced Wasserstein distance (Algorithm 1, line 9).
//!
//! A draw gathers its subset of samples from the tile's rows, projects it onto its directions,
//! ranks the projections, and moves every sample along each direction towards the quantile of
//! its rank (supplement, Eq. 8). In that equation the factors m/n and 1/m cancel, so samples are
//! moved by the plain difference, whatever the size of the subset; the objective whose negative
//! gradient this is, is half the sum over draws and samples of (projection − target)², that is
//! n·W₂²/2 of each subset. `reference` says the same in f64 and without haste.
//!
//! Draws of a cell go through their stages one behind the other, so that memory is asked for
//! before it is needed. What makes a stage fast stands in its file: [`Run`]s of samples that lie
//! side by side, `memory` that moves them in whole registers, `rank` that sorts one word for each
//! sample, targets in closed form or from tables.
//!
//! Pulls add up as integers in a [`Patch`], in units of a quantum that no sum can overflow, so
//! that the order of draws, threads and ranks cannot matter.

mod memory;
pub mod probe;
mod rank;
pub mod reference;
mod runs;
pub mod simd;
mod target;

pub use runs::{Run, RunTables};
pub use target::Targets;

use crate::draw::{CellDraws, Direction, Draw, Draws};
use crate::tile::{Block, Cell, Layout, Partition, Placement, Region, Rows, SLACK};
use memory::{CHUNK, Memory, Order, Place, Spot};
use probe::{Probe, Stage};
use rank::Keys;
use simd::{Isa, LANES, Simd, Vectorized};

/// The unit of integer gradients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quantum {
    exponent: u32,
}

impl Quantum {
    /// The finest unit for which no gradient can overflow, and no finer than 2⁻²⁰.
    ///
    /// A coordinate is moved by at most √d in a direction, because all projections lie in an
    /// interval no longer than that. A sample is in a draw's subset only if the draw's pixel lies
    /// at one of the offsets of its level set, so at most `offsets · most_per_pixel` draws (and
    /// no more than there are) move it. With half a unit more for each rounding, the sum must
    /// stay below 2³¹; and a single gradient below 2²², for the rounding itself. `None` if the unit
    /// would be coarser than 2⁻¹⁰, a sixteenth of a pixel's share of a small tile.
    pub fn new(draws: &Draws, partition: &Partition) -> Option<Self> {
        let levels = draws.levels();
        let offsets: usize = levels.sets().iter().map(|set| set.offsets.len()).sum();
        let touching =
            draws.most_per_pixel(partition).saturating_mul(offsets).min(draws.options().draws)
                as f64;
        let dims = partition.shape().dims() as f64;
        let most = draws.options().directions as f64 * dims.sqrt();
        let fits = |exponent: u32| {
            let units = most * f64::from(1_u32 << exponent) + 0.5;
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

/// Scratch for one thread, as large as the largest subset.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    draws: CellDraws,
    /// Runs of a subset that is in no table.
    runs: Vec<Run>,
    spots: [Vec<Spot>; LOCATED],
    slots: [DrawSlot; STAGES],
    stage: StageScratch,
    /// What a cell sees, in another layout than the tile's.
    placed: (Vec<f32>, Vec<i32>),
}

/// What a stage needs while it works on one draw.
#[derive(Debug, Clone, Default)]
struct StageScratch {
    /// Samples or gradients of a draw taken apart, one plane for each dimension.
    planes: Vec<f32>,
    /// The target of each rank, and what they are made from.
    targets: Vec<f32>,
    integrals: Vec<f64>,
    keys: Keys,
}

/// What one draw carries from stage to stage.
#[derive(Debug, Clone, Default)]
struct DrawSlot {
    /// Samples of the subset, and the next multiple of [`LANES`].
    n: usize,
    padded: usize,
    /// Gathered samples, point after point; later the gradients on them.
    points: Vec<f32>,
    /// For each direction, the projection of each sample, and the target of its rank.
    projections: Vec<f32>,
    wanted: Vec<f32>,
}

/// The integer gradient of a block, private until it is merged.
#[derive(Debug)]
pub struct Patch<'a> {
    /// One word for each coordinate of [`Block::words`] and [`SLACK`] more; in units of the
    /// quantum, and pointing downhill.
    pub words: &'a mut [i32],
}

/// What draws found, in integers so that the order in which it adds up cannot matter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Objective {
    /// Sum over the draws' directions of W₂², in units of 2⁻²⁴.
    units: i64,
    /// Number of directions.
    pub directions: u64,
}

impl Objective {
    /// Units of W₂². The largest sum, of 2³⁰ draws of 16 directions in 16 dimensions, is 2⁶².
    const SCALE: f64 = (1 << 24) as f64;

    fn add(&mut self, squared_distance: f64) {
        // Adding 1.5·2⁵² rounds to an integer; the bits above it are those of this number.
        const MAGIC: f64 = 6_755_399_441_055_744.0;
        let rounded = squared_distance * Self::SCALE + MAGIC;
        self.units += rounded.to_bits() as i64 - MAGIC.to_bits() as i64;
        self.directions += 1;
    }

    /// What it is, in words that [`Self::from_words`] reads.
    pub fn to_words(self) -> [u64; 2] {
        [self.units as u64, self.directions]
    }

    /// The objective of [`Self::to_words`].
    pub fn from_words([units, directions]: [u64; 2]) -> Self {
        Self { units: units as i64, directions }
    }

    /// Sum over the draws' directions of W₂².
    pub fn squared_distance(&self) -> f64 {
        self.units as f64 / Self::SCALE
    }

    /// Mean W₂² of a direction; 0 if there is none.
    pub fn mean(&self) -> f64 {
        self.squared_distance() / self.directions.max(1) as f64
    }
}

/// Adds up what the draws of several blocks found.
impl std::iter::Sum for Objective {
    fn sum<I: Iterator<Item = Self>>(objectives: I) -> Self {
        objectives.fold(Self::default(), |a, b| Self {
            units: a.units + b.units,
            directions: a.directions + b.directions,
        })
    }
}

/// Computes the gradients of blocks.
#[derive(Debug, Clone)]
pub struct Gradient {
    draws: Draws,
    partition: Partition,
    rows: Rows,
    targets: Targets,
    quantum: Quantum,
    simd: Simd,
    runs: RunTables,
    layout: Layout,
}

impl Gradient {
    /// Prepares the tables for `draws` on the cells of `partition`, with all of the tile's samples
    /// at hand.
    pub fn new(draws: Draws, partition: Partition, quantum: Quantum, simd: Simd) -> Self {
        let targets = Targets::new(draws.directions());
        let rows = Rows::new(Region::whole(partition.shape()), partition.reach());
        let runs = RunTables::new(draws.levels(), partition.shape().frames());
        Self { draws, partition, rows, targets, quantum, simd, runs, layout: Layout::Rows }
    }

    /// The same gradient, computed in a copy of what each cell sees in another layout: to
    /// compare them. [`Layout::Rows`] takes no copy.
    pub fn with_layout(self, layout: Layout) -> Self {
        Self { layout, ..self }
    }

    /// The same gradient, with only the samples of a region and around it at hand, for blocks
    /// within.
    pub fn within(self, region: Region) -> Self {
        Self { rows: Rows::new(region, self.partition.reach()), ..self }
    }

    /// The cells that gradients are computed for.
    pub fn partition(&self) -> &Partition {
        &self.partition
    }

    /// How the samples lie that gradients are computed from.
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// The draws that gradients are made of.
    pub fn draws(&self) -> &Draws {
        &self.draws
    }

    /// The runs of their subsets.
    pub fn runs(&self) -> &RunTables {
        &self.runs
    }

    /// The unit of the gradients.
    pub fn quantum(&self) -> Quantum {
        self.quantum
    }

    /// Makes the draws of a block's cells in `step` and writes their gradient to `patch`.
    ///
    /// `samples` lie in [`Self::rows`], with [`SLACK`] behind them.
    ///
    /// # Panics
    /// If `samples` or `patch` is not as long as that.
    pub fn block<P: Probe>(
        &self,
        step: u32,
        block: &Block,
        samples: &[f32],
        patch: Patch<'_>,
        workspace: &mut Workspace,
        probe: &mut P,
    ) -> Objective {
        assert_eq!(samples.len(), self.rows.words() + SLACK, "samples of a region");
        assert_eq!(patch.words.len(), block.words() + SLACK, "patch of a block");
        patch.words.fill(0);
        probe.lap(Stage::Scatter);
        let cell = |&cell: &usize| {
            let mut draws = std::mem::take(&mut workspace.draws);
            self.draws.cell(&self.partition, step, cell, &mut draws);
            probe.lap(Stage::Draws);
            let patch = Patch { words: &mut *patch.words };
            let (gradient, place) = (self, self.partition.cell(cell));
            let draws_of_cell = &draws;
            let job = CellJob {
                gradient,
                block,
                place,
                samples,
                patch,
                workspace: &mut *workspace,
                draws: draws_of_cell,
                probe: &mut *probe,
            };
            let objective = self.simd.run(job);
            workspace.draws = draws;
            objective
        };
        block.cells().iter().map(cell).sum()
    }
}

/// All draws of a cell, to be done in one go.
struct CellJob<'a, P> {
    gradient: &'a Gradient,
    block: &'a Block,
    place: Cell,
    samples: &'a [f32],
    patch: Patch<'a>,
    workspace: &'a mut Workspace,
    draws: &'a CellDraws,
    probe: &'a mut P,
}

impl<P: Probe> Vectorized for CellJob<'_, P> {
    type Output = Objective;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> Objective {
        run(self, isa)
    }
}

/// Does a job in the layout that it asks for.
#[inline(always)]
fn run<I: Isa, P: Probe>(job: CellJob<'_, P>, isa: I) -> Objective {
    let CellJob { gradient, block, place, samples, patch, workspace, draws, probe } = job;
    let rows = &gradient.rows;
    let frames = rows.shape().frames();
    let reach = rows.reach();
    // Rows and patch both begin with a halo, so what the cell sees of them begins at its place.
    let corner = block.place();
    let start = (place.y - corner.y) * block.line() + (place.x - corner.x) * rows.pixel();
    let (pixel, stride, patch_stride) = (rows.pixel(), rows.stride(), block.stride());
    let region = rows.region().place();
    let samples = &samples[(place.y - region.y) * rows.line() + (place.x - region.x) * pixel..];
    let patch = &mut patch.words[start..];
    if gradient.layout == Layout::Rows {
        let order = Order::Rows { samples: stride, patch: patch_stride, frames };
        let mut memory = Memory { samples, patch, pixel, order };
        return all_draws(gradient, &mut memory, draws, workspace, isa, probe);
    }
    let size = [reach.left + place.width + reach.right, reach.up + place.height + reach.down];
    let placement = Placement::new(gradient.layout, [size[0], size[1], frames], pixel);
    let (mut copy, mut sums) = std::mem::take(&mut workspace.placed);
    copy.resize(placement.words + CHUNK, 0.0);
    sums.clear();
    sums.resize(placement.words + CHUNK, 0);
    // For every pixel that the cell sees: its first word in the rows, the patch, and the copy.
    let pixels = || {
        (0..size[1]).flat_map(|y| (0..frames).map(move |t| (y, t))).flat_map(|(y, t)| {
            let (row, placement) = (y * frames + t, &placement);
            (0..size[0]).map(move |x| {
                (row * stride + x * pixel, row * patch_stride + x * pixel, placement.word(x, y, t))
            })
        })
    };
    for (from, _, to) in pixels() {
        copy[to..to + pixel].copy_from_slice(&samples[from..from + pixel]);
    }
    probe.lap(Stage::Gather);
    let order = Order::Placed(&placement);
    let mut memory = Memory { samples: &copy, patch: &mut sums, pixel, order };
    let objective = all_draws(gradient, &mut memory, draws, workspace, isa, probe);
    for (_, to, from) in pixels() {
        let sums = &sums[from..from + pixel];
        patch[to..to + pixel].iter_mut().zip(sums).for_each(|(to, from)| *to += from);
    }
    probe.lap(Stage::Scatter);
    workspace.placed = (copy, sums);
    objective
}

/// Stages that a draw goes through: gather, rank, move, scatter.
const STAGES: usize = 4;

/// Most numbers of a subset for which draws overlap.
const OVERLAPPED: usize = 1024;

/// Does all draws of a cell.
///
/// Small draws go through their stages staggered: while one is gathered, the one before is
/// ranked, and so on. What a stage writes in pieces the next one reads in whole registers, and a
/// processor can do that at once only if the writing was a while ago.
#[inline(always)]
fn all_draws<I: Isa, P: Probe>(
    gradient: &Gradient,
    memory: &mut Memory<'_>,
    draws: &CellDraws,
    workspace: &mut Workspace,
    isa: I,
    probe: &mut P,
) -> Objective {
    let per_draw = gradient.draws.options().directions;
    let (reach, shape) = (gradient.rows.reach(), gradient.rows.shape());
    let place = |draw: &Draw| Place {
        x: draw.x as usize + reach.left,
        y: draw.y as usize + reach.up,
        t: draw.t as usize,
    };
    let directions = |i: usize| &draws.directions[i * per_draw..(i + 1) * per_draw];
    let Workspace { slots, spots, runs: scratch, stage, .. } = workspace;
    let longest = draws.draws.iter().map(Draw::subset).max().unwrap_or(0);
    let numbers = longest * shape.dims();
    let lag = usize::from(numbers <= OVERLAPPED);
    let count = draws.draws.len();
    let mut objective = Objective::default();
    let mut locate = |memory: &Memory<'_>, i: usize, spots: &mut [Vec<Spot>]| {
        if let Some(draw) = draws.draws.get(i) {
            let runs = gradient.runs.of(draw.set as usize, draw.taps as usize, scratch);
            let used = draw.samples as usize * shape.dims();
            memory.locate(isa, place(draw), runs, used, &mut spots[i % LOCATED]);
        }
    };
    (0..AHEAD).for_each(|i| locate(memory, i, spots));
    for i in 0..count + (STAGES - 1) * lag {
        locate(memory, i + AHEAD, spots);
        // The draw in a stage now, if there is one, and its slot.
        let at = |stage: usize| {
            let draw = i.checked_sub(stage * lag).filter(|&draw| draw < count);
            draw.map(|draw| (draw, if lag == 0 { 0 } else { draw % STAGES }))
        };
        if let Some((i, slot)) = at(0) {
            let slot = &mut slots[slot];
            slot.grow(draws.draws[i].subset(), shape.dims(), per_draw);
            memory.gather(&spots[i % LOCATED], &mut slot.points);
            probe.lap(Stage::Gather);
        }
        if let Some((i, slot)) = at(1) {
            rank(gradient, &mut slots[slot], directions(i), stage, isa, probe);
        }
        if let Some((i, slot)) = at(2) {
            gradients(gradient, &mut slots[slot], directions(i), stage, isa, &mut objective);
            probe.lap(Stage::Transport);
        }
        if let Some((i, slot)) = at(3) {
            memory.scatter(&spots[i % LOCATED], &slots[slot].points);
            probe.lap(Stage::Scatter);
        }
    }
    objective
}

/// Draws between asking for samples and gathering them.
const AHEAD: usize = 1;

/// Draws whose runs are known at a time: those in the stages, and those ahead of them.
const LOCATED: usize = STAGES + AHEAD;

impl DrawSlot {
    /// Makes room for a subset of `n` samples.
    #[inline(always)]
    fn grow(&mut self, n: usize, dims: usize, directions: usize) {
        (self.n, self.padded) = (n, n.next_multiple_of(LANES));
        if self.points.len() < self.padded * dims + CHUNK {
            self.points.resize(self.padded * dims + CHUNK, 0.0);
        }
        if self.wanted.len() < self.padded * directions {
            self.projections.resize(self.padded * directions, 0.0);
            self.wanted.resize(self.padded * directions, 0.0);
        }
    }
}

/// Projects the samples of a subset on each direction and finds the target of each.
#[inline(always)]
fn rank<I: Isa, P: Probe>(
    gradient: &Gradient,
    slot: &mut DrawSlot,
    directions: &[Direction],
    stage: &mut StageScratch,
    isa: I,
    probe: &mut P,
) {
    let dims = gradient.rows.shape().dims();
    let &mut DrawSlot { n, padded, ref points, ref mut projections, ref mut wanted } = slot;
    let StageScratch { planes, targets, integrals, keys } = stage;
    if planes.len() < padded * dims {
        planes.resize(padded * dims, 0.0);
        targets.resize(padded, 0.0);
    }
    // Lanes behind the last sample carry what was there before; nobody asks for it.
    isa.split(points, planes, padded, dims);
    let planes = planes[..padded * dims].chunks_exact(padded);
    let targets = &mut targets[..n];
    let lanes = projections.chunks_exact_mut(padded).zip(wanted.chunks_exact_mut(padded));
    for (direction, (projections, wanted)) in directions.iter().zip(lanes) {
        for (k, (plane, theta)) in planes.clone().zip(direction.theta).enumerate() {
            if k == 0 {
                // Adding 0 turns −0 into +0.
                projections.iter_mut().zip(plane).for_each(|(sum, &x)| *sum = theta * x + 0.0);
            } else {
                projections.iter_mut().zip(plane).for_each(|(sum, &x)| *sum += theta * x);
            }
        }
        probe.lap(Stage::Project);
        let (low, length) = direction.extent(dims);
        let sorted = keys.sort(isa, &projections[..n], low, length);
        probe.lap(Stage::Rank);
        gradient.targets.fill(isa, direction, integrals, targets);
        for (position, &target) in sorted.positions().zip(&*targets) {
            wanted[position] = target;
        }
        // Lanes behind the last sample want to be where they are. (Whole registers: a loop over
        // these few lanes would become a call.)
        let last = padded - LANES;
        let (wanted, projections) = (&mut wanted[last..padded], &projections[last..padded]);
        for lane in 0..LANES {
            wanted[lane] = if last + lane < n { wanted[lane] } else { projections[lane] };
        }
        probe.lap(Stage::Transport);
    }
}

/// Turns the differences of projections to their targets into gradients on the samples.
#[inline(always)]
fn gradients<I: Isa>(
    gradient: &Gradient,
    slot: &mut DrawSlot,
    directions: &[Direction],
    stage: &mut StageScratch,
    isa: I,
    objective: &mut Objective,
) {
    let dims = gradient.rows.shape().dims();
    let scale = gradient.quantum.scale();
    let &mut DrawSlot { n, padded, ref mut points, ref projections, ref mut wanted } = slot;
    let planes = &mut stage.planes[..padded * dims];
    let lanes = projections.chunks_exact(padded).zip(wanted.chunks_exact_mut(padded));
    for (nth, (direction, (projections, wanted))) in directions.iter().zip(lanes).enumerate() {
        let mut squares = [0.0_f32; LANES];
        let chunks = wanted.chunks_exact_mut(LANES).zip(projections.chunks_exact(LANES));
        for (wanted, projections) in chunks {
            for lane in 0..LANES {
                wanted[lane] -= projections[lane];
                squares[lane] += wanted[lane] * wanted[lane];
            }
        }
        objective.add(f64::from(squares.iter().sum::<f32>()) / n as f64);
        for (plane, theta) in planes.chunks_exact_mut(padded).zip(direction.theta) {
            let by = scale * theta;
            if nth == 0 {
                plane.iter_mut().zip(&*wanted).for_each(|(sum, &d)| *sum = by * d);
            } else {
                plane.iter_mut().zip(&*wanted).for_each(|(sum, &d)| *sum += by * d);
            }
        }
    }
    isa.join(planes, points, padded, dims);
}
