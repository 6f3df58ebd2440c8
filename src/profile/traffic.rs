//! What each stage of a step does: samples touched, bytes moved, operations.
//!
//! Counted from the draws of a few steps and the shapes of what a step goes through. Bytes are
//! those that loads and stores move, wherever they come from, and operations those on single
//! numbers, as the algorithm has them:
//!
//! | stage | bytes | operations |
//! |---|---|---|
//! | draws | the draw and its directions, written | not counted: integers and tables |
//! | gather | samples read, points written | 0 |
//! | project | points taken apart; for each direction a sum in memory, read and written for each dimension | 2 p d |
//! | rank | projections read, keys written, keys read and written once | 3 n + n log₂ n |
//! | transport | targets written, placed, compared; gradients for each dimension; points put together | 4 n + 3 p + 2 p d |
//! | scatter | gradients read, sums read and written; patches cleared | 3 for each number |
//! | reduce | patches read, sums cleared, read and written | 1 for each word of a patch |
//! | adam | sums read; samples and moments read and written | 16 for each coordinate |
//!
//! with n samples of d dimensions in a subset, and p the next multiple of 8, all for each
//! direction.

use serde::Serialize;

use super::subject::{Subject, WORD};
use crate::draw::{CellDraws, Direction, Draw};
use crate::gradient::probe::Stage;
use crate::gradient::simd::LANES;

/// What a stage does in a step.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Traffic {
    /// Samples touched.
    pub samples: f64,
    /// Bytes read.
    pub read: f64,
    /// Bytes written.
    pub written: f64,
    /// Operations.
    pub operations: f64,
}

impl Traffic {
    /// Bytes moved.
    pub fn bytes(&self) -> f64 {
        self.read + self.written
    }

    fn add(&mut self, samples: usize, read: usize, written: usize, operations: usize) {
        self.samples += samples as f64;
        self.read += read as f64;
        self.written += written as f64;
        self.operations += operations as f64;
    }
}

/// The subsets of draws.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Subsets {
    /// Draws that were looked at.
    pub draws: u64,
    /// Mean samples of a subset.
    pub samples: f64,
    /// Most samples of a subset.
    pub most: u64,
    /// Mean runs of neighbouring pixels.
    pub runs: f64,
}

/// What a mean step does, in the order of [`Stage::ALL`], and the subsets of its draws.
///
/// `steps` steps are looked at, of which 1 is enough for a per cent or two.
///
/// # Panics
/// If `steps` is 0.
pub fn count(subject: &Subject, steps: u32) -> ([Traffic; Stage::ALL.len()], Subsets) {
    assert!(steps > 0, "no steps to look at");
    let mut stages = [Traffic::default(); Stage::ALL.len()];
    let mut subsets = Subsets::default();
    let mut runs = Vec::new();
    for step in 0..steps {
        for cell in 0..subject.partition().cells() {
            let CellDraws { draws, .. } = subject.cell_draws(step, cell);
            for draw in &draws {
                let n = draw.subset();
                draw_stages(subject, n, &mut stages);
                let of = subject.runs().of(draw.set as usize, draw.taps as usize, &mut runs);
                subsets.draws += 1;
                subsets.samples += n as f64;
                subsets.most = subsets.most.max(n as u64);
                subsets.runs += of.len() as f64;
            }
        }
    }
    let draws = subsets.draws.max(1) as f64;
    subsets.samples /= draws;
    subsets.runs /= draws;
    for stage in &mut stages {
        stage.samples /= f64::from(steps);
        stage.read /= f64::from(steps);
        stage.written /= f64::from(steps);
        stage.operations /= f64::from(steps);
    }
    update_stages(subject, &mut stages);
    (stages, subsets)
}

/// Adds what a draw of `n` samples does.
fn draw_stages(subject: &Subject, n: usize, stages: &mut [Traffic; Stage::ALL.len()]) {
    let word = WORD as usize;
    let (d, k) = (subject.shape().dims(), subject.options().draw.directions);
    let p = n.next_multiple_of(LANES);
    let mut add = |stage: Stage, samples, read, written, operations| {
        stages[stage as usize].add(samples, read, written, operations);
    };
    add(Stage::Draws, 0, 0, size_of::<Draw>() + k * size_of::<Direction>(), 0);
    add(Stage::Gather, n, word * n * d, word * n * d, 0);
    add(
        Stage::Project,
        n,
        word * (p * d + k * 2 * p * d),
        word * (p * d + k * (p + p * d)),
        k * 2 * p * d,
    );
    let log = (usize::BITS - n.saturating_sub(1).leading_zeros()) as usize;
    add(Stage::Rank, n, word * k * 2 * n, word * k * 2 * n, k * (3 * n + n * log));
    // Targets, the place and the target of each rank, both sides of the difference, gradients (read
    // again from the second direction on), and the points.
    let read = k * (2 * n + 2 * p + p * d) + (k - 1) * p * d + p * d;
    let written = k * (2 * n + p + p * d) + p * d;
    let operations = k * (4 * n + 3 * p) + (2 * k - 1) * p * d;
    add(Stage::Transport, n, word * read, word * written, operations);
    add(Stage::Scatter, n, word * 2 * n * d, word * n * d, 3 * n * d);
}

/// Adds what a step does for all coordinates.
fn update_stages(subject: &Subject, stages: &mut [Traffic; Stage::ALL.len()]) {
    let word = WORD as usize;
    let patches: usize = subject.blocks().iter().map(|block| block.words()).sum();
    let all = subject.shape().coordinates();
    let samples = subject.shape().samples();
    stages[Stage::Scatter as usize].add(0, 0, word * patches, 0);
    let sums = word * (all + patches);
    stages[Stage::Reduce as usize].add(samples, word * 2 * patches, sums, patches);
    stages[Stage::Adam as usize].add(samples, word * 4 * all, word * 3 * all, 16 * all);
}
