//! What a step reads and writes: samples and moments.
//!
//! A step changes them in place, line by line. Writing into a second copy, so that a step could be
//! done again from its start, made the steps of the paper's tile half as long again: with it the
//! state outgrows the third-level cache.
//!
//! Where a worker can be lost, a row must be changed whole or not at all. Its samples are made in a
//! journal that stays close to the thread, and put in place from there ([`Job::unit`]). Its
//! moments, which nobody reads in between, move on instead: a line has room for one row more than
//! there are frames, and each step writes every row to the place of the row before it, which is
//! done with by then ([`Slots`]). Steps of the paper's tile are 1.04 times as long
//! for it. To copy moments through the journal as well made them 1.05 times as long, and to write
//! down what was there before 1.2 times.

use std::io;

use perceptile_cluster::shared::{Job, Part, Parts, Section};
use perceptile_cluster::{Ends, Worker};

use crate::domain::Surface;
use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::Simd;
use crate::solver::adam::{Component, Factors, Update, UpdateTo};
use crate::solver::halo::SampleHalo;
use crate::solver::slots::Slots;
use crate::solver::{Phase, Storage, faults, rounds};
use crate::tile::{Reach, Region, Regions, Rows, TileShape};

/// Samples and Adam's moments of a tile.
pub(crate) struct State {
    pub rows: Rows,
    pub slots: Slots,
    /// The step that is next.
    pub step: u32,
    /// Each line with its copies above the tile and below it.
    pub samples: Parts<f32>,
    /// Moments in slots, line after line.
    pub first: Parts<f32>,
    pub second: Parts<f32>,
    /// What it sees of others' samples.
    pub halo: SampleHalo,
}

/// Gives every line of `words` its words.
pub(crate) fn by_line(section: Section, words: usize, lines: usize) -> Parts<f32> {
    let line = |y| std::iter::once(y * words..(y + 1) * words).collect();
    section.parts((0..lines).map(line).collect())
}

impl State {
    /// Takes over the samples that lie in `plain`, in line order, before step number `step`. The
    /// moments are set to zero at the start of a phase, and left as they are in one that goes on.
    pub fn enter(
        worker: &Worker,
        phase: Phase,
        (regions, reach): (&Regions, Reach),
        [samples, first, second]: [Section; 3],
        plain: &[f32],
        step: u32,
    ) -> Self {
        let rows = Rows::new(regions.own(), reach);
        let shape = rows.shape();
        let own = rows.own();
        let words = own * shape.frames();
        let lines = (0..shape.height()).map(|y| rows.line_and_copies(y)).collect();
        let slots = Slots::new(shape, worker.board().plan().journal > 0);
        let mut state = Self {
            samples: samples.parts(lines),
            first: by_line(first, slots.line(), shape.height()),
            second: by_line(second, slots.line(), shape.height()),
            halo: SampleHalo::new(&**worker.communicator(), regions, reach),
            rows,
            slots,
            step,
        };
        let (rows, shards) = state.shards();
        let round = rounds::enter(phase);
        worker.round(round, Ends::Half, 0..shape.height(), shards, |job, shards| {
            let y = job.index();
            let mut line = Line::new((rows, slots), shards, 0);
            for t in 0..shape.frames() {
                line.put(t, &plain[y * words + t * own..][..own]);
            }
            worker.fault(faults::EXCHANGE);
            if step == 0 {
                line.first.fill(0.0);
                line.second.fill(0.0);
            }
        });
        state.send(worker);
        state
    }

    /// Sends to others, if there are any, the samples that they see.
    pub fn send(&mut self, worker: &Worker) {
        if worker.communicator().size() > 1 {
            self.halo.send(&self.rows, self.samples.whole());
        }
    }

    /// Takes over the samples of others that this rank sees.
    pub fn receive(&mut self, worker: &Worker) {
        self.halo.receive(worker, &self.rows, self.samples.whole_mut());
    }

    /// Writes the samples to `plain` in line order, and gives the sections back.
    pub fn leave(self, worker: &Worker, phase: Phase, plain: &mut Parts<f32>) -> [Section; 3] {
        let Self { rows, samples, first, second, halo, .. } = self;
        // What is under way ends here, and nobody needs it.
        drop(halo);
        let (shape, own) = (rows.shape(), rows.own());
        let from = samples.whole();
        let round = rounds::leave(phase);
        worker.round(round, Ends::Half, 0..shape.height(), (plain,), |job, (mut line,)| {
            let words = line.piece(0).chunks_exact_mut(own);
            worker.fault(faults::EXCHANGE);
            for (t, row) in words.enumerate() {
                row.copy_from_slice(&from[rows.word(0, job.index(), t)..][..own]);
            }
        });
        [samples.into_section(), first.into_section(), second.into_section()]
    }

    /// How the samples lie, and all that a step changes.
    pub fn shards(&mut self) -> (&Rows, Shards<'_>) {
        let Self { rows, samples, first, second, .. } = self;
        (rows, (samples, first, second))
    }

    /// The samples in line order.
    pub fn line_order(&self) -> Vec<f32> {
        own_rows(&self.rows, self.samples.whole()).concat()
    }

    /// One of its arrays, in line order and in pieces; see [`ArraySource`]: the samples
    /// (0), the first moments (1) or the second (2), as many numbers as the tile has coordinates.
    pub fn array(&self, index: usize) -> Vec<&[f32]> {
        let array = [&self.samples, &self.first, &self.second][index].whole();
        pieces(&self.rows, self.slots, self.step, array, index)
    }

    /// Replaces the samples by others in line order, and keeps the moments. For a rank that is
    /// alone.
    pub fn replace(&mut self, words: &[f32]) {
        let Self { rows, samples, .. } = self;
        let (samples, shape) = (samples.whole_mut(), rows.shape());
        for (i, from) in words.chunks_exact(rows.own()).enumerate() {
            let start = rows.word(0, i / shape.frames(), i % shape.frames());
            samples[start..start + rows.own()].copy_from_slice(from);
            let row = &mut samples[start - rows.lead()..][..rows.stride()];
            rows.close_row(row);
        }
        rows.close_lines(samples);
    }
}

/// The rows of samples without the copies around them, in line order.
fn own_rows<'a>(rows: &Rows, samples: &'a [f32]) -> Vec<&'a [f32]> {
    let frames = rows.shape().frames();
    let row = |i: usize| &samples[rows.word(0, i / frames, i % frames)..][..rows.own()];
    (0..rows.shape().height() * frames).map(row).collect()
}

/// Samples (array 0) or moments as they lie in a phase, in line order and in pieces.
fn pieces<'a>(
    rows: &Rows,
    slots: Slots,
    step: u32,
    array: &'a [f32],
    index: usize,
) -> Vec<&'a [f32]> {
    if index == 0 { own_rows(rows, array) } else { slots.rows(array, step) }
}

/// The state of a phase that other ranks carry out, seen while they wait.
pub struct SharedSnapshot<'a> {
    storage: &'a Storage,
    rows: Rows,
    step: u32,
}

impl<'a> SharedSnapshot<'a> {
    /// The state that lies in `storage` before a step of a phase whose samples reach so far.
    pub fn new(storage: &'a Storage, shape: TileShape, reach: Reach, step: u32) -> Self {
        Self { storage, rows: Rows::new(Region::whole(shape), reach), step }
    }
}

impl ArraySource for SharedSnapshot<'_> {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        let Storage { samples, first, second, .. } = self.storage;
        let array = [samples, first, second][index].slice();
        let slots = Slots::new(self.rows.shape(), true);
        pieces(&self.rows, slots, self.step, array, index)
            .into_iter()
            .try_for_each(|piece| sink.put(piece))
    }
}

/// Samples and both moments, to be given to jobs.
pub(crate) type Shards<'a> = (&'a mut Parts<f32>, &'a mut Parts<f32>, &'a mut Parts<f32>);

/// The rows of one y in all frames.
pub(crate) struct Line<'a> {
    rows: &'a Rows,
    slots: Slots,
    samples: &'a mut [f32],
    /// Its copies above the tile and below it.
    copies: Vec<&'a mut [f32]>,
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl<'a> Line<'a> {
    /// A line of which the first `done` rows are as they should be, except for their copies.
    pub fn new(
        (rows, slots): (&'a Rows, Slots),
        (samples, first, second): (Part<'a, f32>, Part<'a, f32>, Part<'a, f32>),
        done: usize,
    ) -> Self {
        let only = |part: Part<'a, f32>| part.pieces().next().expect("a line of moments");
        let mut samples = samples.pieces();
        let mut line = Self {
            rows,
            slots,
            samples: samples.next().expect("a line of samples"),
            copies: samples.collect(),
            first: only(first),
            second: only(second),
        };
        (0..done).for_each(|t| line.close(t));
        line
    }

    /// Moves the samples of frame `t` by Adam in a step before which moments have turned so
    /// often, as a unit of a job.
    pub fn update<P: Component>(
        &mut self,
        (worker, job): (&Worker, &Job<'_>),
        (t, turns): (usize, usize),
        (factors, surface): (Factors, Surface),
        gradients: &[P],
        simd: Simd,
    ) {
        let place = (surface, self.rows.shape().dims());
        let start = t * self.rows.stride() + self.rows.lead();
        let samples = &mut self.samples[start..start + self.rows.own()];
        let row = self.slots.row(t, turns);
        if !self.slots.move_on() {
            let (first, second) = (&mut self.first[row.clone()], &mut self.second[row]);
            simd.run(Update { factors, place, gradients, samples, first, second });
        } else {
            let two = [row, self.slots.row(t, turns + 1)];
            let apart = "two rows of a line";
            let [m, to_m] = self.first.get_disjoint_mut(two.clone()).expect(apart);
            let [v, to_v] = self.second.get_disjoint_mut(two).expect(apart);
            job.unit(
                samples,
                |x, to_x| {
                    simd.run(UpdateTo {
                        factors,
                        place,
                        gradients,
                        from: [x, m, v],
                        to: [to_x, to_m, to_v],
                    });
                    worker.fault(faults::ADAM);
                },
                || worker.fault(faults::ADAM),
            );
            worker.fault(faults::ADAM);
        }
        self.close(t);
    }

    /// Sets the samples of frame `t`.
    fn put(&mut self, t: usize, row: &[f32]) {
        let start = t * self.rows.stride() + self.rows.lead();
        self.samples[start..start + row.len()].copy_from_slice(row);
        self.close(t);
    }

    /// Renews all copies of the samples of frame `t`.
    fn close(&mut self, t: usize) {
        let stride = self.rows.stride();
        let words = t * stride..(t + 1) * stride;
        let row = &mut self.samples[words.clone()];
        self.rows.close_row(row);
        self.copies.iter_mut().for_each(|copy| copy[words.clone()].copy_from_slice(row));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::Baseline;
    use crate::solver::{Parallelism, Samples, StoragePlan};
    use crate::tile::Partition;

    #[test]
    fn samples_come_and_go_unchanged_and_with_all_their_copies() {
        let shape = TileShape::new(37, 5, 3, 2, 3).unwrap();
        // Lines have several copies.
        let reach = Reach { left: 2, right: 3, up: 12, down: 6 };
        let tile = Baseline::White.tile(shape, 4);
        let partition = Partition::new(shape, reach);
        let whole = Region::whole(shape);
        let plan = StoragePlan::new(&partition, whole, Parallelism::threads());
        let (worker, mut storage) = plan.private().unwrap();
        storage.tile_mut(shape).copy_from_slice(&Samples::from_tile(&tile).words);
        let rows = Rows::new(whole, reach);
        let sections = [storage.samples, storage.first, storage.second];
        let mut plain = by_line(storage.work, rows.own() * 3, 5);
        let mut state = State::enter(
            &worker,
            Phase::Descent,
            (&Regions::whole(shape), reach),
            sections,
            plain.whole(),
            0,
        );
        assert_eq!(state.line_order(), Samples::from_tile(&tile).words);
        let start = (12 + 4) * rows.line() + 2 * rows.stride();
        assert_eq!(state.samples.whole()[start..start + 3], *tile.point(35, 4, 2, 0));
        assert_eq!(state.samples.whole()[start + 12..start + 15], *tile.point(0, 4, 2, 0));
        let closed = state.samples.whole().to_vec();
        state.replace(&Samples::from_tile(&tile).words);
        assert_eq!(closed, state.samples.whole());

        // New samples leave the moments as they are.
        state.first.whole_mut().fill(1.0);
        let other = Samples::from_tile(&Baseline::White.tile(shape, 5));
        state.replace(&other.words);
        assert_eq!(state.line_order(), other.words);
        assert!(state.first.whole().iter().all(|&m| m == 1.0));
        state.leave(&worker, Phase::Descent, &mut plain);
        assert_eq!(plain.whole()[..other.words.len()], other.words);
    }
}
