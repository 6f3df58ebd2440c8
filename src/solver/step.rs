//! One step of stochastic gradient descent: the draws of every block fill its patch; then, line
//! by line, patches add up to the gradient and Adam moves the samples.
//!
//! Both halves are rounds of jobs that share no word that is written: a patch belongs to one
//! block, a line to one job.

use std::io;
use std::sync::Arc;

use crossbeam::queue::SegQueue;
use perceptile_cluster::faults::Place;
use perceptile_cluster::shared::Parts;
use perceptile_cluster::{Ends, World};

use crate::gradient::probe::{Probe, Stage, Unprobed};
use crate::gradient::simd::{Isa, Simd, Vectorized};
use crate::gradient::{Gradient, Objective, Patch, Workspace};
use crate::solver::adam::AdamOptions;
use crate::solver::rounds::{self, Half};
use crate::solver::state::{Line, Snapshot, State, by_line};
use crate::solver::storage::{Found, Record, Storage, StoragePlan, Team};
use crate::solver::{Phase, Samples};
use crate::tile::{Block, Overlap, SLACK};
use perceptile_cluster::shared::{MapError, Section, Words};

/// The descent on the filtered sliced Wasserstein distance.
pub struct Descent<P = Unprobed> {
    world: Arc<World>,
    gradient: Gradient,
    adam: AdamOptions,
    steps: u32,
    simd: Simd,
    state: State,
    blocks: Vec<Block>,
    overlap: Overlap,
    patches: Parts<i32>,
    found: Arc<Found>,
    makers: Arc<Words>,
    record: Arc<Record>,
    counts: [Section; 2],
    scratch: SegQueue<Scratch<P>>,
}

/// What a thread works with.
struct Scratch<P> {
    workspace: Workspace,
    sums: Vec<i32>,
    probe: P,
}

/// Blocks for each thread, so that one who is done can take over from one who is late.
pub const BLOCKS_PER_THREAD: usize = 4;

impl Descent {
    /// Prepares `steps` steps from `samples`, by the threads of the current pool.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn alone(
        gradient: Gradient,
        adam: AdamOptions,
        steps: u32,
        simd: Simd,
        samples: &Samples,
    ) -> Result<Self, MapError> {
        Self::probed(gradient, adam, steps, simd, samples, || Unprobed)
    }
}

impl<P: Probe> Descent<P> {
    /// The same, with a probe for each thread that may work on it at once.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn probed(
        gradient: Gradient,
        adam: AdamOptions,
        steps: u32,
        simd: Simd,
        samples: &Samples,
        probe: impl Fn() -> P,
    ) -> Result<Self, MapError> {
        let partition = gradient.partition();
        let (world, mut storage) = StoragePlan::new(partition, Team::alone()).private()?;
        storage.tile_mut(partition.shape()).copy_from_slice(&samples.words);
        Ok(Self::enter(world, storage, gradient, adam, steps, (simd, 0), probe))
    }

    /// Prepares `steps` steps from the samples that lie in the storage, by all ranks of a world;
    /// from
    /// step `first_step` on. After step 0, it goes on with the moments that are there.
    pub fn enter(
        world: Arc<World>,
        storage: Storage,
        gradient: Gradient,
        adam: AdamOptions,
        steps: u32,
        (simd, first_step): (Simd, u32),
        probe: impl Fn() -> P,
    ) -> Self {
        let partition = gradient.partition();
        let plan = world.board().plan();
        let team = Team { ranks: plan.ranks, threads: plan.threads, can_fail: plan.journal > 0 };
        let blocks = team.blocks(partition);
        let overlap = Overlap::new(partition.shape(), &blocks);
        let Storage { samples, first, second, work, counts, found, makers, record } = storage;
        let rows = gradient.rows().clone();
        let sections = [samples, first, second];
        let state = State::enter(&world, Phase::Descent, rows, sections, work.slice(), first_step);
        let mut start = 0;
        let patch = |block: &Block| {
            let words = start..start + block.words() + SLACK;
            start = words.end;
            vec![words]
        };
        let patches = work.parts(blocks.iter().map(patch).collect());
        let scratch = SegQueue::new();
        for _ in 0..team.threads {
            let sums = vec![0; state.rows.own()];
            scratch.push(Scratch { workspace: Workspace::default(), sums, probe: probe() });
        }
        Self {
            world,
            gradient,
            adam,
            steps,
            simd,
            state,
            blocks,
            overlap,
            patches,
            found,
            makers,
            record,
            counts,
            scratch,
        }
    }

    /// Hands the samples on to the next phase.
    pub fn leave(self) -> Storage {
        let Self { world, state, patches, found, makers, record, counts, .. } = self;
        let shape = state.rows.shape();
        let words = state.rows.own() * shape.frames();
        let mut plain = by_line(patches.into_section(), words, shape.height());
        let [samples, first, second] = state.leave(&world, Phase::Descent, &mut plain);
        let work = plain.into_section();
        Storage { samples, first, second, work, counts, found, makers, record }
    }

    /// Does step number `step`. Returns the objective that the draws found, before the step moved
    /// the samples.
    pub fn step(&mut self, step: u32) -> Objective {
        self.pull(step);
        self.update(step);
        self.found.sum(self.blocks.len())
    }

    /// Goes on from other samples, with the moments as they are; for a descent of one rank.
    pub fn replace(&mut self, samples: &Samples) {
        self.state.replace(&samples.words);
    }

    /// The samples as of the last step.
    pub fn samples(&self) -> Samples {
        Samples { words: self.state.line_order() }
    }

    /// The probes of all threads.
    pub fn into_probes(self) -> Vec<P> {
        self.scratch.into_iter().map(|scratch| scratch.probe).collect()
    }

    /// Fills the patches of all blocks.
    fn pull(&mut self, step: u32) {
        let Self { world, gradient, state, blocks, patches, found, makers, scratch, .. } = self;
        let round = rounds::step(Phase::Descent, step, Half::Pull);
        // The section may be longer, for another phase.
        let samples = &state.samples.whole()[..state.rows.words() + SLACK];
        world.round(round, Ends::Half, blocks.len(), (patches,), |job, (mut patch,)| {
            let block = &blocks[job.index()];
            world.fault(Place::Pull);
            let objective = with(scratch, |Scratch { workspace, probe, .. }| {
                let patch = Patch { words: patch.piece(0) };
                gradient.block(step, block, samples, patch, workspace, probe)
            });
            found.set(job.index(), objective, world.rank());
            if world.size() > 1 {
                world.read_from_others(foreign_lines(block, world.rank(), makers));
            }
            world.fault(Place::Pull);
        });
    }

    /// Adds up the patches and moves the samples.
    fn update(&mut self, step: u32) {
        let Self { world, gradient, adam, simd, state, blocks, overlap, .. } = self;
        let Self { patches, found, makers, record, scratch, .. } = self;
        let round = rounds::step(Phase::Descent, step, Half::Update);
        let factors = adam.factors(step, self.steps, gradient.quantum().unit());
        let patches = patches.whole();
        let slots = state.slots;
        let turns = slots.turns(step);
        state.step = step + 1;
        let (rows, shards) = state.shards();
        let shape = rows.shape();
        let mut start = 0;
        let patches: Vec<&[i32]> = blocks
            .iter()
            .map(|block| {
                start += block.words() + SLACK;
                &patches[start - block.words() - SLACK..start]
            })
            .collect();
        world.round(round, Ends::Step, shape.height(), shards, |job, shards| {
            let y = job.index();
            if y == 0 {
                record.set(step, found.sum(blocks.len()).mean());
            }
            let mut line = Line::new((rows, slots), shards, job.units_done());
            with(scratch, |Scratch { sums, probe, .. }| {
                for t in job.units_done()..shape.frames() {
                    let (patches, simd) = (&patches, *simd);
                    simd.run(Reduce { overlap, blocks, patches, y, t, sums });
                    world.fault(Place::Reduce);
                    probe.lap(Stage::Reduce);
                    line.update((world, job), (t, turns), factors, sums, simd);
                    probe.lap(Stage::Adam);
                }
            });
            if world.size() > 1 {
                let foreign = |&&(block, _): &&(usize, usize)| found.maker(block) != world.rank();
                let bytes = |&(block, _): &(usize, usize)| 4 * blocks[block].line() as u64;
                world.read_from_others(overlap.line(y).iter().filter(foreign).map(bytes).sum());
                makers[y].store(world.rank() as u64, std::sync::atomic::Ordering::Relaxed);
            }
        });
    }
}

impl<P> Snapshot for Descent<P> {
    fn array(&self, index: usize, put: &mut dyn FnMut(&[f32]) -> io::Result<()>) -> io::Result<()> {
        self.state.array(index).into_iter().try_for_each(put)
    }
}

/// Bytes of samples that a block sees of lines that other ranks moved last.
fn foreign_lines(block: &Block, rank: usize, makers: &Words) -> u64 {
    let (place, reach) = (block.place(), block.reach());
    let lines = (0..reach.up + place.height + reach.down).filter(|i| {
        let y = (place.y + i + reach.up * (makers.len() - 1)) % makers.len();
        makers[y].load(std::sync::atomic::Ordering::Relaxed) != rank as u64
    });
    (lines.count() * block.line() * 4) as u64
}

/// Works with a thread's scratch; there is one for each thread.
fn with<P: Probe, T>(scratch: &SegQueue<Scratch<P>>, work: impl FnOnce(&mut Scratch<P>) -> T) -> T {
    let mut mine = scratch.pop().expect("scratch for every thread");
    mine.probe.begin();
    let result = work(&mut mine);
    scratch.push(mine);
    result
}

/// Adds up one row of the gradient.
struct Reduce<'a> {
    overlap: &'a Overlap,
    blocks: &'a [Block],
    patches: &'a [&'a [i32]],
    y: usize,
    t: usize,
    sums: &'a mut [i32],
}

impl Vectorized for Reduce<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self { overlap, blocks, patches, y, t, sums } = self;
        sums.fill(0);
        for &(block, start) in overlap.line(y) {
            let row = &patches[block][start + t * blocks[block].stride()..];
            for segment in overlap.segments(block) {
                let part = &row[segment.from..segment.from + segment.len];
                let sums = &mut sums[segment.to..segment.to + segment.len];
                sums.iter_mut().zip(part).for_each(|(sum, &part)| *sum += part);
            }
        }
    }
}
