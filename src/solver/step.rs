//! One step of stochastic gradient descent: the draws of every block fill its patch; then, line
//! by line, patches add up to the gradient and Adam moves the samples.
//!
//! Both halves run in parallel without sharing a word that is written: a patch belongs to one
//! block, a line to one thread.

use crossbeam::queue::SegQueue;
use perceptile_cluster::{Commit, World};
use rayon::prelude::*;

use crate::gradient::probe::{Probe, Stage, Unprobed};
use crate::gradient::simd::{Isa, Simd, Vectorized};
use crate::gradient::{Gradient, Objective, Patch, Workspace};
use crate::solver::adam::AdamOptions;
use crate::solver::pages::Pages;
use crate::solver::state::{CellSamples, State};
use crate::tile::{Block, Overlap, SLACK};

/// The descent on the filtered sliced Wasserstein distance.
pub struct Descent<P = Unprobed> {
    world: World,
    gradient: Gradient,
    adam: AdamOptions,
    steps: u32,
    simd: Simd,
    state: State,
    blocks: Vec<Block>,
    overlap: Overlap,
    patches: Pages<i32>,
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
    /// Prepares `steps` steps from `samples`.
    pub fn new(
        world: World,
        gradient: Gradient,
        adam: AdamOptions,
        steps: u32,
        simd: Simd,
        samples: &CellSamples,
    ) -> Self {
        Self::probed(world, gradient, adam, steps, simd, samples, || Unprobed)
    }
}

impl<P: Probe> Descent<P> {
    /// The same, with a probe for each thread that may work on it at once.
    #[allow(clippy::too_many_arguments, reason = "what `new` takes, and one more")]
    pub fn probed(
        world: World,
        gradient: Gradient,
        adam: AdamOptions,
        steps: u32,
        simd: Simd,
        samples: &CellSamples,
        probe: impl Fn() -> P,
    ) -> Self {
        let threads = rayon::current_num_threads();
        let partition = gradient.partition();
        let blocks = partition.blocks(threads * BLOCKS_PER_THREAD);
        let overlap = Overlap::new(partition.shape(), &blocks);
        let state = State::new(gradient.rows().clone(), partition, samples);
        let patches = Pages::zeros(blocks.iter().map(|block| block.words() + SLACK).sum());
        let scratch = SegQueue::new();
        for _ in 0..threads {
            let sums = vec![0; state.rows().own()];
            scratch.push(Scratch { workspace: Workspace::default(), sums, probe: probe() });
        }
        Self { world, gradient, adam, steps, simd, state, blocks, overlap, patches, scratch }
    }

    /// Does step number `step`. Returns what holds for all ranks, and the objective that the
    /// draws of this rank found, before the step moved the samples.
    pub fn step(&mut self, step: u32) -> (Commit, Objective) {
        let objective = self.pull(step);
        self.update(step);
        (self.world.commit(false), objective)
    }

    /// Goes on from other samples, with the moments as they are.
    pub fn replace(&mut self, samples: &CellSamples) {
        self.state.replace(self.gradient.partition(), samples);
    }

    /// The samples as of the last step.
    pub fn samples(&self) -> CellSamples {
        self.state.cell_samples(self.gradient.partition())
    }

    /// The probes of all threads.
    pub fn into_probes(self) -> Vec<P> {
        self.scratch.into_iter().map(|scratch| scratch.probe).collect()
    }

    /// Fills the patches of all blocks.
    fn pull(&mut self, step: u32) -> Objective {
        let Self { gradient, state, blocks, patches, scratch, .. } = self;
        let mut rest = &mut patches[..];
        let jobs: Vec<(&Block, &mut [i32])> = blocks
            .iter()
            .map(|block| (block, rest.split_off_mut(..block.words() + SLACK).expect("a patch")))
            .collect();
        let samples = state.samples();
        jobs.into_par_iter()
            .with_max_len(1)
            .map(|(block, words)| {
                with(scratch, |Scratch { workspace, probe, .. }| {
                    gradient.block(step, block, samples, Patch { words }, workspace, probe)
                })
            })
            .sum()
    }

    /// Adds up the patches and moves the samples.
    fn update(&mut self, step: u32) {
        let Self { gradient, adam, simd, state, blocks, overlap, patches, scratch, .. } = self;
        let factors = adam.factors(step, self.steps, gradient.quantum().unit());
        let frames = state.rows().shape().frames();
        let mut start = 0;
        let patches: Vec<&[i32]> = blocks
            .iter()
            .map(|block| {
                start += block.words() + SLACK;
                &patches[start - block.words() - SLACK..start]
            })
            .collect();
        state.lines_mut().enumerate().for_each(|(y, mut line)| {
            with(scratch, |Scratch { sums, probe, .. }| {
                for t in 0..frames {
                    let (patches, simd) = (&patches, *simd);
                    simd.run(Reduce { overlap, blocks, patches, y, t, sums });
                    probe.lap(Stage::Reduce);
                    line.update(t, factors, sums, simd);
                    probe.lap(Stage::Adam);
                }
            });
        });
        state.close();
    }
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
