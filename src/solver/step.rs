//! One step of stochastic gradient descent: the draws of every block fill its patch; then, line
//! by line, patches add up to the gradient and Adam moves the samples.
//!
//! Both halves are rounds of jobs that share no word that is written: a patch belongs to one
//! block, a line to one job.
//!
//! On a cluster each rank does so with its region. Blocks at its edge need samples of others and
//! have gradients for others, so they are done between two shares of the blocks inside: while the
//! one is done, samples are under way, and while the other is, gradients.

use std::io;
use std::ops::Range;
use std::sync::Arc;

use crossbeam::queue::SegQueue;
use perceptile_cluster::shared::Parts;
use perceptile_cluster::{Ends, Worker};

use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::probe::{Probe, Stage, Unprobed};
use crate::gradient::simd::Simd;
use crate::gradient::{Gradient, Objective, Patch, Workspace};
use crate::solver::adam::AdamOptions;
use crate::solver::halo::{GradientHalo, Reduce};
use crate::solver::rounds::{self, Part};
use crate::solver::state::{Line, State, by_line};
use crate::solver::storage::{Objectives, Record, Storage, StoragePlan};
use crate::solver::{Parallelism, Phase, Samples, faults};
use crate::tile::{Block, Overlap, Regions, SLACK};
use perceptile_cluster::shared::{MapError, Section, Words};

/// The descent on the filtered sliced Wasserstein distance.
pub struct Descent<P = Unprobed> {
    worker: Arc<Worker>,
    gradient: Gradient,
    adam: AdamOptions,
    steps: u32,
    simd: Simd,
    state: State,
    /// Those that others have to do with are at [`Self::edge`].
    blocks: Vec<Block>,
    edge: Range<usize>,
    /// Of the patches of all blocks, and of those that come from others.
    overlap: Overlap,
    halo: GradientHalo,
    patches: Parts<i32>,
    objectives: Arc<Objectives>,
    owners: Arc<Words>,
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
        let regions = Regions::whole(partition.shape());
        let plan = StoragePlan::new(partition, regions.own(), Parallelism::threads());
        let (worker, mut storage) = plan.private()?;
        storage.tile_mut(partition.shape()).copy_from_slice(&samples.words);
        Ok(Self::enter(worker, storage, (gradient, &regions), adam, steps, (simd, 0), probe))
    }

    /// Prepares `steps` steps from the samples of a region that lie in the storage, by all ranks
    /// of a worker and of its communicator; from step `first_step` on. After step 0, it goes on with the
    /// moments that are there.
    pub fn enter(
        worker: Arc<Worker>,
        storage: Storage,
        (gradient, regions): (Gradient, &Regions),
        adam: AdamOptions,
        steps: u32,
        (simd, first_step): (Simd, u32),
        probe: impl Fn() -> P,
    ) -> Self {
        let gradient = gradient.within(regions.own());
        let partition = gradient.partition();
        let parallelism = Parallelism::of(&worker);
        let Storage { samples, first, second, work, counts, objectives, owners, record } = storage;
        let sections = [samples, first, second];
        let seen = (regions, partition.reach());
        let state = State::enter(&worker, Phase::Descent, seen, sections, work.slice(), first_step);
        let blocks = parallelism.blocks(partition, regions.own());
        let (blocks, edge) = around(blocks, |block| state.halo.touches(block.window()));
        let halo = GradientHalo::new(&**worker.communicator(), regions, partition.reach(), &blocks);
        let windows = blocks.iter().map(Block::window).chain(halo.windows());
        let overlap = Overlap::new(regions.own(), windows);
        let mut start = 0;
        let patch = |block: &Block| {
            let words = start..start + block.words() + SLACK;
            start = words.end;
            vec![words]
        };
        let patches = work.parts(blocks.iter().map(patch).collect());
        let scratch = SegQueue::new();
        for _ in 0..parallelism.threads {
            let sums = vec![0; state.rows.own()];
            scratch.push(Scratch { workspace: Workspace::default(), sums, probe: probe() });
        }
        Self {
            worker,
            gradient,
            adam,
            steps,
            simd,
            state,
            blocks,
            edge,
            overlap,
            halo,
            patches,
            objectives,
            owners,
            record,
            counts,
            scratch,
        }
    }

    /// Hands the samples on to the next phase.
    pub fn leave(self) -> Storage {
        let Self { worker, state, patches, objectives, owners, record, counts, .. } = self;
        let shape = state.rows.shape();
        let words = state.rows.own() * shape.frames();
        let mut plain = by_line(patches.into_section(), words, shape.height());
        let [samples, first, second] = state.leave(&worker, Phase::Descent, &mut plain);
        let work = plain.into_section();
        Storage { samples, first, second, work, counts, objectives, owners, record }
    }

    /// Does step number `step`. Returns the objective that the draws of this region found, before
    /// the step moved the samples.
    pub fn step(&mut self, step: u32) -> Objective {
        self.gradients(step);
        self.update(step);
        self.objectives.sum(self.blocks.len())
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
    fn gradients(&mut self, step: u32) {
        let edge = self.edge.clone();
        let has_others = self.worker.communicator().size() > 1;
        if has_others {
            self.gradients_of_blocks(step, Part::Early, 0..edge.start);
            self.state.receive(&self.worker);
            self.gradients_of_blocks(step, Part::Edge, edge.clone());
            let patches = cut(self.patches.whole(), &self.blocks);
            self.halo.send(&patches, self.simd);
        }
        self.gradients_of_blocks(step, Part::Gradient, edge.end..self.blocks.len());
        if has_others {
            self.halo.receive(&self.worker);
        }
    }

    /// Fills the patches of some blocks.
    fn gradients_of_blocks(&mut self, step: u32, part: Part, which: Range<usize>) {
        let Self { worker, gradient, state, blocks, patches, objectives, owners, scratch, .. } =
            self;
        let (round, halo) = (rounds::step(Phase::Descent, step, part), &self.halo);
        // The section may be longer, for another phase.
        let samples = &state.samples.whole()[..state.rows.words() + SLACK];
        worker.round(round, Ends::Half, which, (patches,), |job, (mut patch,)| {
            let block = &blocks[job.index()];
            worker.fault(faults::GRADIENT);
            match part {
                Part::Early => state.halo.progress(),
                _ => halo.progress(),
            }
            let objective = with(scratch, |Scratch { workspace, probe, .. }| {
                let patch = Patch { words: patch.piece(0) };
                gradient.block(step, block, samples, patch, workspace, probe)
            });
            objectives.set(job.index(), objective, worker.index());
            if worker.workers() > 1 {
                worker.read_from_others(foreign_lines(block, worker.index(), owners));
            }
            worker.fault(faults::GRADIENT);
        });
    }

    /// Adds up the patches and moves the samples.
    fn update(&mut self, step: u32) {
        let Self { worker, gradient, adam, simd, state, blocks, overlap, halo, .. } = self;
        let Self { patches, objectives, owners, record, scratch, .. } = self;
        let round = rounds::step(Phase::Descent, step, Part::Update);
        let factors = adam.factors(step, self.steps, gradient.quantum().unit());
        let surface = gradient.draws().directions().domain().surface_on_the_way();
        let slots = state.slots;
        let turns = slots.turns(step);
        state.step = step + 1;
        let (rows, shards) = state.shards();
        let shape = rows.shape();
        let own = cut(patches.whole(), blocks);
        halo.with_received(|received| {
            let patches: Vec<&[i32]> = own.into_iter().chain(received).collect();
            let patches = patches.as_slice();
            worker.round(round, Ends::Step, 0..shape.height(), shards, |job, shards| {
                let y = job.index();
                if y == 0 {
                    record.set(step, objectives.sum(blocks.len()));
                }
                let mut line = Line::new((rows, slots), shards, job.units_done());
                with(scratch, |Scratch { sums, probe, .. }| {
                    for t in job.units_done()..shape.frames() {
                        let simd = *simd;
                        simd.run(Reduce { overlap, patches, y, t, sums });
                        worker.fault(faults::REDUCE);
                        probe.lap(Stage::Reduce);
                        line.update((worker, job), (t, turns), (factors, surface), sums, simd);
                        probe.lap(Stage::Adam);
                    }
                });
                if worker.workers() > 1 {
                    let foreign =
                        |&&(block, _): &&(usize, usize)| objectives.owner(block) != worker.index();
                    let bytes = |&(block, _): &(usize, usize)| 4 * blocks[block].line() as u64;
                    worker
                        .read_from_others(overlap.line(y).iter().filter(foreign).map(bytes).sum());
                    owners[y].store(worker.index() as u64, std::sync::atomic::Ordering::Relaxed);
                }
            });
        });
        state.send(worker);
    }
}

/// Puts blocks at the edge, those that `touches` names, between two shares of those inside. Returns
/// where they are, too.
pub(crate) fn around(
    blocks: Vec<Block>,
    touches: impl Fn(&Block) -> bool,
) -> (Vec<Block>, Range<usize>) {
    let (edge, mut inside): (Vec<_>, Vec<_>) = blocks.into_iter().partition(touches);
    // Nobody waits for a share that is not needed.
    let early = if edge.is_empty() { 0 } else { inside.len() / 2 };
    let late = inside.split_off(early);
    let range = early..early + edge.len();
    (inside.into_iter().chain(edge).chain(late).collect(), range)
}

/// Cuts the memory of all patches into those of each block.
fn cut<'a>(words: &'a [i32], blocks: &[Block]) -> Vec<&'a [i32]> {
    let mut rest = words;
    let mut cut = |block: &Block| {
        let (patch, after) = rest.split_at(block.words() + SLACK);
        rest = after;
        patch
    };
    blocks.iter().map(&mut cut).collect()
}

impl<P> ArraySource for Descent<P> {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self.state.array(index).into_iter().try_for_each(|piece| sink.put(piece))
    }
}

/// Bytes of samples that a block sees of lines that other ranks moved last.
fn foreign_lines(block: &Block, rank: usize, owners: &Words) -> u64 {
    let (place, reach) = (block.place(), block.reach());
    let lines = (0..reach.up + place.height + reach.down).filter(|i| {
        let y = (place.y + i + reach.up * (owners.len() - 1)) % owners.len();
        owners[y].load(std::sync::atomic::Ordering::Relaxed) != rank as u64
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
