//! What all ranks of a run see: the samples, Adam's moments and what steps hand from half to half.
//!
//! All of it lies in one map, which is this process's own or a file that worker processes share.
//! Phases use the same memory one after the other. In between, the samples lie in line order in
//! the section that holds patches or gradients otherwise.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use perceptile_cluster::Worker;
use perceptile_cluster::communicator::Communicator;
use perceptile_cluster::faults::Faults;
use perceptile_cluster::shared::{Arena, Board, BoardPlan, Map, MapError, Section, Words};

use serde::{Deserialize, Serialize};

use crate::gradient::Objective;
use crate::solver::parallelism::BLOCKS_PER_THREAD;
use crate::solver::slots::Slots;
use crate::solver::{Parallelism, Summary, histograms};
use crate::tile::{Partition, Reach, Region, SLACK, TileShape};

/// How much memory a run's phases take, in words of four bytes unless it says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoragePlan {
    parallelism: Parallelism,
    shape: TileShape,
    samples: usize,
    work: usize,
    blocks: usize,
    layers: usize,
}

/// The sections that phases hand on.
#[derive(Debug)]
pub struct Storage {
    /// The samples in rows, or a tile in line order.
    pub(crate) samples: Section,
    /// Moments in slots, line after line.
    pub(crate) first: Section,
    pub(crate) second: Section,
    /// Patches, gradients, or a tile in line order.
    pub(crate) work: Section,
    /// Histograms of the warp.
    pub(crate) counts: [Section; 2],
    /// What the draws of each block found, and which rank did them.
    pub(crate) objectives: Arc<Objectives>,
    /// Which rank did each line.
    pub(crate) owners: Arc<Words>,
    /// The objective of the first and the last steps.
    pub record: Arc<Record>,
}

impl StoragePlan {
    /// Memory for the descent on a region, by a parallelism.
    pub fn new(partition: &Partition, region: Region, parallelism: Parallelism) -> Self {
        let shape = region.shape();
        let count = parallelism.all_threads().saturating_mul(BLOCKS_PER_THREAD);
        // The count itself may be less than asked for, or more.
        let blocks = partition.block_count(region, count);
        let pixel = shape.spp() * shape.dims();
        let patches = partition
            .block_pixels(region, count)
            .saturating_mul(pixel)
            .saturating_add(blocks.saturating_mul(SLACK));
        Self {
            parallelism,
            shape,
            samples: rows(shape, partition.reach()).max(shape.coordinates()),
            work: patches.max(shape.coordinates()),
            blocks,
            layers: 1,
        }
    }

    /// The same for a tile whose samples the warp makes uniform in so many layers.
    pub fn with_layers(self, layers: usize) -> Self {
        Self { layers, ..self }
    }

    fn count_words(&self) -> usize {
        histograms::count_words(self.shape, self.parallelism.all_threads(), self.layers)
    }

    /// The same, and memory for a polish whose samples see each other so far away.
    pub fn with_polish(self, reach: Reach) -> Self {
        Self { samples: self.samples.max(rows(self.shape, reach)), ..self }
    }

    fn board(&self) -> BoardPlan {
        let workers = self.parallelism.processes();
        let row = self.shape.width() * self.shape.spp() * self.shape.dims();
        let jobs = self
            .blocks
            .max(self.shape.height())
            .max(histograms::jobs(self.shape, self.parallelism.all_threads()));
        // A unit is a row of samples.
        let journal = if self.parallelism.has_workers() { row * 4 } else { 0 };
        BoardPlan { workers, threads: self.parallelism.threads, jobs, journal }
    }

    /// Words of the first or of the second moments; saturating.
    fn moments(&self) -> usize {
        let slots = Slots::new(self.shape, self.parallelism.has_workers());
        slots.line().saturating_mul(self.shape.height())
    }

    /// Bytes of it all; saturating.
    pub fn bytes(&self) -> usize {
        let counts = bytes(8, self.count_words());
        [
            bytes(4, self.samples),
            bytes(4, self.moments()),
            bytes(4, self.moments()),
            bytes(4, self.work),
            counts,
            counts,
            bytes(8, Objectives::WORDS.saturating_mul(self.blocks)),
            bytes(8, self.shape.height()),
            bytes(8, Record::WORDS),
        ]
        .into_iter()
        .fold(self.board().room(), usize::saturating_add)
    }

    /// The bytes that a rank touches most, by place.
    pub fn shares(&self, worker: usize) -> Vec<Range<usize>> {
        let workers = self.parallelism.processes();
        let mut start = self.board().room();
        let moments = 4 * self.moments();
        [4 * self.samples, moments, moments, 4 * self.work]
            .into_iter()
            .map(|bytes| {
                let own = start + bytes * worker / workers..start + bytes * (worker + 1) / workers;
                start += Arena::room(bytes);
                own
            })
            .collect()
    }

    /// The memory, and the worker that works on it as one of its ranks sees it.
    ///
    /// # Panics
    /// If the map is smaller than [`Self::bytes`], or the rank is none of the parallelism.
    pub fn open(&self, map: Map, rank: usize, faults: Option<Faults>) -> (Arc<Worker>, Storage) {
        let (worker, storage) = self.parts(map, rank, faults);
        (Arc::new(worker), storage)
    }

    fn parts(&self, map: Map, rank: usize, faults: Option<Faults>) -> (Worker, Storage) {
        let mut arena = Arena::new(map);
        let board = Board::new(&mut arena, self.board());
        let storage = Storage {
            samples: arena.take(4 * self.samples),
            first: arena.take(4 * self.moments()),
            second: arena.take(4 * self.moments()),
            work: arena.take(4 * self.work),
            counts: [(); 2].map(|()| arena.take(8 * self.count_words())),
            objectives: Arc::new(Objectives(
                arena.take(8 * Objectives::WORDS * self.blocks).words(),
            )),
            owners: Arc::new(arena.take(8 * self.shape.height()).words()),
            record: Arc::new(Record(arena.take(8 * Record::WORDS).words())),
        };
        (Worker::new(board, rank, faults), storage)
    }

    /// Memory of this process alone.
    ///
    /// # Errors
    /// If the system does not give it.
    pub fn private(&self) -> Result<(Arc<Worker>, Storage), MapError> {
        Ok(self.open(Map::private(self.bytes())?, 0, None))
    }

    /// Memory of this process alone, which has communicator.
    ///
    /// # Errors
    /// If the system does not give it.
    pub fn beside(
        &self,
        communicator: Arc<dyn Communicator>,
    ) -> Result<(Arc<Worker>, Storage), MapError> {
        let (worker, storage) = self.parts(Map::private(self.bytes())?, 0, None);
        Ok((Arc::new(worker.with_communicator(communicator)), storage))
    }
}

/// Words of the rows of a region, [`SLACK`] included; saturating, as it may be larger than memory.
fn rows(shape: TileShape, Reach { left, right, up, down }: Reach) -> usize {
    let across = left.saturating_add(shape.width()).saturating_add(right);
    let lines = up.saturating_add(shape.height()).saturating_add(down);
    [lines, shape.frames(), shape.spp(), shape.dims()]
        .into_iter()
        .fold(across, usize::saturating_mul)
        .saturating_add(SLACK)
}

/// Bytes of so many words of a size.
fn bytes(size: usize, words: usize) -> usize {
    Arena::room(words.saturating_mul(size))
}

impl Storage {
    /// A region of this shape in line order, as phases find it and leave it.
    pub fn tile_mut(&mut self, shape: TileShape) -> &mut [f32] {
        &mut self.work.slice_mut()[..shape.coordinates()]
    }

    /// The section in which the region lies, in line order, after so many frames of the warp. The
    /// memory of the others is given back.
    pub fn into_tile(self, frames: u32) -> Section {
        let Self { samples, first, second, work, .. } = self;
        let (tile, other) =
            if frames.is_multiple_of(2) { (work, samples) } else { (samples, work) };
        [first, second, other].into_iter().for_each(Section::discard);
        tile
    }

    /// Sets Adam's moments, in line order, as they are before step number `step` of a phase.
    ///
    /// # Panics
    /// If they are not as many as the tile has coordinates.
    pub fn put_moments(
        &mut self,
        shape: TileShape,
        has_workers: bool,
        step: u32,
        [first, second]: &[Vec<f32>; 2],
    ) {
        let slots = Slots::new(shape, has_workers);
        slots.put(self.first.slice_mut(), step, first);
        slots.put(self.second.slice_mut(), step, second);
    }
}

/// What the draws of each block found.
#[derive(Debug)]
pub(crate) struct Objectives(Words);

impl Objectives {
    /// Words of a block.
    const WORDS: usize = 3;

    /// Writes down what a rank found.
    pub fn set(&self, block: usize, objective: Objective, rank: usize) {
        let [units, directions] = objective.to_words();
        let words = &self.0[block * Self::WORDS..][..Self::WORDS];
        for (word, value) in words.iter().zip([units, directions, rank as u64]) {
            word.store(value, Ordering::Relaxed);
        }
    }

    /// The rank that did a block.
    pub fn owner(&self, block: usize) -> usize {
        self.0[block * Self::WORDS + 2].load(Ordering::Relaxed) as usize
    }

    /// The sum over blocks.
    pub fn sum(&self, blocks: usize) -> Objective {
        let word = |at: usize| self.0[at].load(Ordering::Relaxed);
        (0..blocks)
            .map(|block| block * Self::WORDS)
            .map(|at| Objective::from_words([word(at), word(at + 1)]))
            .sum()
    }
}

/// What the first steps of a descent found, and the last ones, and some in between.
#[derive(Debug)]
pub struct Record(Words);

impl Record {
    /// Words of a step.
    const STEP: usize = 2;
    const WORDS: usize = (CURVE + CURVE_STEPS) * Self::STEP;

    /// Writes down what a step found.
    pub(crate) fn set(&self, step: u32, objective: Objective) {
        let step = step as usize;
        let set = |at: usize| {
            for (word, value) in self.0[at * Self::STEP..].iter().zip(objective.to_words()) {
                word.store(value, Ordering::Relaxed);
            }
        };
        if step < Summary::WINDOW {
            set(step);
        }
        set(Summary::WINDOW + step % Summary::WINDOW);
        if let Some(at) = curve_place(step) {
            set(CURVE + at);
        }
    }

    /// What it holds now.
    pub fn read(&self) -> Recorded {
        Recorded { words: self.0.iter().map(|word| word.load(Ordering::Relaxed) as i64).collect() }
    }

    /// Takes over what was kept; what is missing stays as it is.
    pub fn restore(&self, kept: &Recorded) {
        for (word, &value) in self.0.iter().zip(&kept.words) {
            word.store(value as u64, Ordering::Relaxed);
        }
    }
}

/// Steps of a record before those of the curve.
const CURVE: usize = 2 * Summary::WINDOW;
/// Places of the curve: four for each doubling of the number of steps.
const CURVE_STEPS: usize = 4 * 32;

/// The place of a step on the curve of convergence: the first steps, and then those whose number,
/// counted from one, is 4, 5, 6 or 7 times a power of two.
fn curve_place(step: usize) -> Option<usize> {
    let number = step + 1;
    let octave = number.ilog2() as usize;
    let quarters = (number << 2) >> octave;
    ((quarters << octave) >> 2 == number).then_some(4 * octave + quarters - 4)
}

/// What a [`Record`] held. Those of ranks with a region each add up word by word.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Recorded {
    /// The words.
    pub words: Vec<i64>,
}

impl Recorded {
    /// The mean objectives over the first and the last steps when so many are done; none after
    /// none.
    pub fn means(&self, done: u32) -> [Option<f64>; 2] {
        let (done, window) = (done as usize, Summary::WINDOW);
        let count = done.min(window);
        let word = |at: usize| self.words.get(at).map_or(0, |&word| word as u64);
        let value = |at: usize| Objective::from_words([word(2 * at), word(2 * at + 1)]).mean();
        let first: f64 = (0..count).map(value).sum();
        let last: f64 = (done - count..done).map(|step| value(window + step % window)).sum();
        [first, last].map(|sum| (count > 0).then(|| sum / count as f64))
    }

    /// The objective of single steps, four for each doubling of their number, when so many are
    /// done: the steps, counted from one, and what their draws found.
    pub fn curve(&self, done: u32) -> Vec<(u32, f64)> {
        let word = |at: usize| self.words.get(at).map_or(0, |&word| word as u64);
        (0..done)
            .filter_map(|step| curve_place(step as usize).map(|place| (step, CURVE + place)))
            .map(|(step, at)| (step + 1, Objective::from_words([word(2 * at), word(2 * at + 1)])))
            // A checkpoint of an earlier version has none.
            .filter(|(_, objective)| objective.to_words()[1] > 0)
            .map(|(step, objective)| (step, objective.mean()))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_those_of_the_first_and_the_last_steps() {
        let shape = TileShape::new(16, 16, 1, 1, 2).unwrap();
        let partition = Partition::new(shape, Reach::default());
        let plan = StoragePlan::new(&partition, Region::whole(shape), Parallelism::threads());
        let (_, storage) = plan.private().unwrap();
        let record = &storage.record;
        assert_eq!(record.read().means(0), [None, None]);
        // W2^2 of 2^-24 a unit, over one direction.
        let found = |step: u32| Objective::from_words([u64::from(step) << 24, 1]);
        (0..100).for_each(|step| record.set(step, found(step)));
        assert_eq!(record.read().means(100), [Some(15.5), Some(83.5)]);
        (0..3).for_each(|step| record.set(step, found(step)));
        assert_eq!(record.read().means(3), [Some(1.0), Some(1.0)]);
        let steps =
            [1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96];
        let curve = record.read().curve(100);
        assert_eq!(curve.iter().map(|&(step, _)| step).collect::<Vec<_>>(), steps);
        // The first three steps were done again, with the same outcome.
        assert!(curve.iter().all(|&(step, value)| value == f64::from(step - 1)));
        let (_, other) = plan.private().unwrap();
        other.record.restore(&record.read());
        assert_eq!(other.record.read().means(3), record.read().means(3));
    }
}
