//! One step of stochastic gradient descent, the only protocol between cells:
//! patches → exchange (add) → Adam into the other half → exchange (copy) → commit.

use crossbeam::queue::SegQueue;
use perceptile_cluster::{Commit, PlanError, World};
use rayon::prelude::*;

use crate::gradient::simd::Simd;
use crate::gradient::{CellObjective, Gradient, Patch, Workspace};
use crate::solver::adam::{AdamOptions, Pull, Update};
use crate::solver::blocks::{Blocks, split};
use crate::solver::state::{CellSamples, State};

/// The descent on the filtered sliced Wasserstein distance.
pub struct Descent {
    world: World,
    gradient: Gradient,
    adam: AdamOptions,
    steps: u32,
    simd: Simd,
    blocks: Blocks,
    state: State,
    patches: Vec<i32>,
    mailbox: (Vec<i32>, Vec<f32>),
    workspaces: SegQueue<Workspace>,
}

impl Descent {
    /// Prepares `steps` steps from `samples`.
    ///
    /// # Errors
    /// If the exchange of halos cannot be planned.
    pub fn new(
        world: World,
        gradient: Gradient,
        adam: AdamOptions,
        steps: u32,
        simd: Simd,
        samples: &CellSamples,
    ) -> Result<Self, PlanError> {
        let blocks = Blocks::new(gradient.partition().clone(), world)?;
        let mut state = State::new(&blocks, samples);
        let mut mailbox = (Vec::new(), Vec::new());
        blocks.copy_to_halos(world, &mut state.current_mut().samples, &mut mailbox.1);
        let patches = vec![0; blocks.block_words().iter().sum()];
        let workspaces = SegQueue::new();
        Ok(Self { world, gradient, adam, steps, simd, blocks, state, patches, mailbox, workspaces })
    }

    /// Does step number `step`. Returns what holds for all ranks, and the objective that the
    /// draws of this rank found, before the step moved the samples.
    pub fn step(&mut self, step: u32, stop: bool) -> (Commit, CellObjective) {
        let objective = self.pull(step);
        self.blocks.add_from_halos(self.world, &mut self.patches, &mut self.mailbox.0);
        let unit = self.gradient.quantum().unit();
        let blocks = &self.blocks;
        let factors = self.adam.factors(step, self.steps, unit);
        update(blocks, &mut self.state, &self.patches, blocks.block_words(), factors, self.simd);
        let (_, new) = self.state.old_and_new();
        self.blocks.copy_to_halos(self.world, &mut new.samples, &mut self.mailbox.1);
        let commit = self.world.commit(stop);
        if commit != Commit::Redo {
            self.state.commit();
        }
        (commit, objective)
    }

    /// Goes on from other samples, with the moments as they are.
    pub fn replace(&mut self, samples: &CellSamples) {
        self.state.replace(&self.blocks, samples);
        let samples = &mut self.state.current_mut().samples;
        self.blocks.copy_to_halos(self.world, samples, &mut self.mailbox.1);
    }

    /// The samples as of the last step that holds.
    pub fn samples(&self) -> CellSamples {
        self.state.samples(&self.blocks)
    }

    /// Fills the patches of all cells.
    fn pull(&mut self, step: u32) -> CellObjective {
        let sizes = self.blocks.block_words();
        let patches = split(&mut self.patches, sizes);
        let mut samples = &self.state.current().samples[..];
        let jobs: Vec<(&[f32], &mut [i32])> = patches
            .into_iter()
            .map(|patch| {
                let (block, rest) = samples.split_at(patch.len());
                samples = rest;
                (block, patch)
            })
            .collect();
        let first = self.blocks.first();
        let objectives: Vec<CellObjective> = jobs
            .into_par_iter()
            .enumerate()
            .with_max_len(1)
            .map(|(i, (block, words))| {
                let mut workspace = self.workspaces.pop().unwrap_or_default();
                let patch = Patch { words };
                let objective = self.gradient.cell(step, first + i, block, patch, &mut workspace);
                self.workspaces.push(workspace);
                objective
            })
            .collect();
        objectives.into_iter().fold(CellObjective::default(), |sum, cell| CellObjective {
            squared_distance: sum.squared_distance + cell.squared_distance,
            directions: sum.directions + cell.directions,
        })
    }
}

/// Moves the samples of all cells by Adam into the new half of the state.
///
/// `pulls` holds, for each cell, either a block (`sizes` are then the blocks') or the cell alone.
pub(crate) fn update<P: Pull + Sync>(
    blocks: &Blocks,
    state: &mut State,
    pulls: &[P],
    sizes: &[usize],
    factors: crate::solver::adam::Factors,
    simd: Simd,
) {
    let in_blocks = sizes == blocks.block_words();
    let (old, new) = state.old_and_new();
    let samples = split(&mut new.samples, blocks.block_words());
    let first = split(&mut new.first, blocks.cell_words());
    let second = split(&mut new.second, blocks.cell_words());
    let (mut block_start, mut cell_start, mut pull_start) = (0, 0, 0);
    let jobs: Vec<_> = samples
        .into_iter()
        .zip(first)
        .zip(second)
        .enumerate()
        .map(|(i, ((samples, first), second))| {
            let starts = (block_start, cell_start, pull_start);
            block_start += samples.len();
            cell_start += first.len();
            pull_start += sizes[i];
            (i, starts, samples, first, second)
        })
        .collect();
    jobs.into_par_iter().with_max_len(1).for_each(|(i, starts, samples, first, second)| {
        let (block, cell, pull) = starts;
        for row in blocks.rows(blocks.first() + i) {
            let pull = pull + if in_blocks { row.block } else { row.cell };
            let (x, m) = (block + row.block, cell + row.cell);
            simd.run(Update {
                factors,
                pulls: &pulls[pull..pull + row.len],
                samples: (
                    &old.samples[x..x + row.len],
                    &mut samples[row.block..row.block + row.len],
                ),
                first: (&old.first[m..m + row.len], &mut first[row.cell..row.cell + row.len]),
                second: (&old.second[m..m + row.len], &mut second[row.cell..row.cell + row.len]),
            });
        }
    });
}
