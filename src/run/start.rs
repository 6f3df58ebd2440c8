//! What a run starts from: samples, and after a checkpoint Adam's moments and the objective so far.
//!
//! None of it is held here, but for a tile that was given: it is made or read when it is wanted,
//! and passed on in pieces.

use perceptile_cluster::Worker;
use perceptile_cluster::communicator::Communicator;

use crate::domain::Domain;
use crate::format::numbers::ArraySink;
use crate::gradient::simd::Simd;
use crate::run::error::RunError;
use crate::run::folder::{Arrays, FolderError};
use crate::run::gather::{self, Scatter};
use crate::run::nested;
use crate::run::observer::Observer;
use crate::run::plan::Plan;
use crate::solver::{Options, OptionsError, Recorded, Samples, Start, Storage, rounds, start};
use crate::tile::{Partition, Region, Tile};

/// What a run starts from.
#[derive(Debug)]
pub struct InitialState {
    source: Source,
    /// The objective of steps before.
    pub(super) record: Recorded,
}

/// Where samples come from.
#[derive(Debug)]
enum Source {
    /// They are made from the plan's seed, each region's by itself.
    Seed(fn(Domain, &Partition, Region, u64) -> Samples),
    /// A tile was given.
    Given(Samples),
    /// A tile of one sample per pixel is made first, by the root ([`crate::run::nested`]).
    Nested,
    /// They lie in a checkpoint, and Adam's moments with them.
    Checkpoint(Arrays),
    /// The root has them.
    AtRoot,
}

impl InitialState {
    /// The start that a plan asks for; `start` is the tile to start from, if there is one.
    ///
    /// # Errors
    /// A starting tile of another shape, or one too many or too few.
    pub fn new(plan: &Plan, start: Option<&Tile>) -> Result<Self, OptionsError> {
        let shape = plan.options.shape;
        let source = match (Self::from_seed(&plan.options), start) {
            (Some(source), None) => source,
            (None, None) if plan.options.start == Start::Nested => Source::Nested,
            (None, Some(_)) if plan.options.start == Start::Nested => {
                return Err(OptionsError::StartMissing);
            }
            (None, Some(tile)) if tile.shape() == shape => {
                Source::Given(Samples::from_tile(&plan.options.domain.adopt(tile)?))
            }
            (None, Some(tile)) => {
                return Err(OptionsError::Start { expected: shape, found: tile.shape() });
            }
            _ => return Err(OptionsError::StartMissing),
        };
        Ok(Self { source, record: Recorded::default() })
    }

    /// What a rank starts from that is not the root: it makes its samples from the seed, or gets
    /// them from the root.
    pub fn beside_root(plan: &Plan, from_checkpoint: bool) -> Self {
        let source = match plan.options.start {
            _ if from_checkpoint => Source::AtRoot,
            Start::Nested => Source::Nested,
            _ => Self::from_seed(&plan.options).unwrap_or(Source::AtRoot),
        };
        Self { source, record: Recorded::default() }
    }

    /// Makes the first sample of every pixel at the root, if the start is nested, and all others of it.
    ///
    /// # Errors
    /// As for a run; on the other ranks, if it failed at the root.
    pub(super) fn made(
        self,
        plan: &Plan,
        simd: Simd,
        communicator: Option<&dyn Communicator>,
        observer: &mut dyn Observer,
    ) -> Result<Self, RunError> {
        let Self { source: Source::Nested, record } = self else { return Ok(self) };
        let is_root = communicator.is_none_or(|communicator| communicator.rank() == 0);
        let made = if is_root {
            nested::samples(plan, simd, observer).map(Source::Given)
        } else {
            Ok(Source::AtRoot)
        };
        let mut failed = [i64::from(made.is_err())];
        communicator.inspect(|communicator| communicator.max(&mut failed));
        let source = made?;
        if failed == [0] { Ok(Self { source, record }) } else { Err(RunError::Elsewhere) }
    }

    fn from_seed(options: &Options) -> Option<Source> {
        match options.start {
            Start::Random => Some(Source::Seed(start::random)),
            Start::Stratified => Some(Source::Seed(start::stratified)),
            Start::Tile | Start::Nested => None,
        }
    }

    /// What a checkpoint holds: samples and moments, as many as the plan's tile has coordinates, and
    /// the objective of steps before.
    pub(super) fn checkpoint(arrays: Arrays, record: Recorded) -> Self {
        Self { source: Source::Checkpoint(arrays), record }
    }

    /// Whether it is that of a checkpoint.
    pub fn is_checkpoint(&self) -> bool {
        matches!(self.source, Source::Checkpoint(_))
    }

    /// Passes on what lies here of what the ranks of a plan start from, in line order and piece
    /// by piece, each piece with the number of its array: the samples (0), and if a phase is to go
    /// on, Adam's first (1) and second moments (2). What was passed on is worth nothing if there is
    /// an error in the end, but was never more than the tile has coordinates.
    ///
    /// # Errors
    /// A checkpoint that cannot be read again.
    pub fn read(&mut self, plan: &Plan, sink: &mut ArraySink<'_>) -> Result<(), FolderError> {
        match &mut self.source {
            Source::Seed(_) | Source::Nested | Source::AtRoot => (),
            Source::Given(samples) => sink(0, &samples.words),
            Source::Checkpoint(arrays) => arrays.read(&mut |array, piece| {
                if array == 0 || plan.from.step > 0 {
                    sink(array, piece);
                }
            })?,
        }
        Ok(())
    }

    /// Puts it where the phases look for it: on every rank, what is its region's.
    ///
    /// # Errors
    /// A checkpoint that cannot be read again, here or at the root.
    pub fn put(
        mut self,
        plan: &Plan,
        worker: &Worker,
        storage: &mut Storage,
    ) -> Result<(), RunError> {
        let communicator = &**worker.communicator();
        let regions = plan.regions(communicator.rank());
        let shape = regions.own().shape();
        if let Source::Seed(make) = self.source {
            let Options { domain, seed, .. } = plan.options;
            let samples = make(domain, &plan.partition(), regions.own(), seed);
            storage.tile_mut(shape).copy_from_slice(&samples.words);
        } else {
            let goes_on = plan.from.step > 0;
            let arrays = if goes_on { 3 } else { 1 };
            let tile = storage.tile_mut(shape);
            let (mut taken, mut moments) = (0, [Vec::new(), Vec::new()]);
            // One array comes after the other, and each piece is of one.
            let mut own = |words: &[f32]| {
                let (array, at) = (taken / tile.len(), taken % tile.len());
                taken += words.len();
                if array == 0 {
                    tile[at..taken].copy_from_slice(words);
                } else {
                    let moments: &mut Vec<f32> = &mut moments[array - 1];
                    moments.reserve_exact(tile.len() - at);
                    moments.extend_from_slice(words);
                }
            };
            let mut result = Ok(());
            if communicator.rank() == 0 {
                let mut scatter = Scatter::new(communicator, &regions);
                result = self.read(plan, &mut |_, piece| scatter.take(piece, &mut own));
                scatter.make_up(arrays);
            } else {
                (0..arrays).for_each(|_| gather::receive(communicator, &regions, &mut own));
            }
            let mut failed = [i64::from(result.is_err())];
            communicator.max(&mut failed);
            result?;
            if failed != [0] {
                return Err(RunError::Elsewhere);
            }
            if goes_on {
                let has_workers = plan.parallelism.has_workers();
                storage.put_moments(shape, has_workers, plan.from.step, &moments);
            }
        }
        storage.record.restore(&self.record);
        worker.board().start_after(rounds::enter(plan.from.phase) - 1);
        Ok(())
    }
}
