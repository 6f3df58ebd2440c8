//! What a run begins with: samples, and if it goes on from a checkpoint, all else that it had.
//!
//! None of it is held here, but for a tile that was given: it is made or read when it is wanted,
//! and passed on in pieces.

use perceptile_cluster::World;

use crate::format::numbers::Sink;
use crate::run::folder::{Arrays, FolderError};
use crate::run::program::Program;
use crate::solver::{Options, OptionsError, Samples, Start, Storage, rounds, start};
use crate::tile::{Partition, Tile};

/// What a run begins with.
#[derive(Debug)]
pub struct Begin {
    source: Source,
    /// The objective of steps before.
    record: Vec<f64>,
}

/// Where samples come from.
#[derive(Debug)]
enum Source {
    /// They are made from the program's seed.
    Made(fn(&Partition, u64) -> Samples),
    /// They were given.
    Given(Samples),
    /// They lie in a checkpoint, and Adam's moments with them.
    Kept(Arrays),
}

impl Begin {
    /// The start that a program asks for; `start` is the tile to start from, if there is one.
    ///
    /// # Errors
    /// A starting tile of another shape, or one too many or too few.
    pub fn new(program: &Program, start: Option<&Tile>) -> Result<Self, OptionsError> {
        let Options { start: from, shape, .. } = program.options;
        let source = match (from, start) {
            (Start::Random, None) => Source::Made(start::random),
            (Start::Stratified, None) => Source::Made(start::stratified),
            (Start::Tile, Some(tile)) if tile.shape() == shape => {
                Source::Given(Samples::from_tile(tile))
            }
            (Start::Tile, Some(tile)) => {
                return Err(OptionsError::Start { expected: shape, found: tile.shape() });
            }
            _ => return Err(OptionsError::StartMissing),
        };
        Ok(Self { source, record: Vec::new() })
    }

    /// What a checkpoint holds: samples and moments, as many as the program's tile has
    /// coordinates, and the objective of steps before.
    pub(super) fn kept(arrays: Arrays, record: Vec<f64>) -> Self {
        Self { source: Source::Kept(arrays), record }
    }

    /// The objective of steps before.
    pub fn record(&self) -> &[f64] {
        &self.record
    }

    /// Passes on what the ranks of a program begin with, in line order and piece by piece, each
    /// piece with the number of its array: the samples (0), and if a phase is to go on, Adam's
    /// first (1) and second moments (2). What was passed on is worth nothing if there is an error
    /// in the end, but was never more than the tile has coordinates.
    ///
    /// # Errors
    /// A checkpoint that cannot be read again, and what `sink` reports.
    pub fn read<E: From<FolderError>>(
        &mut self,
        program: &Program,
        sink: &mut Sink<'_, E>,
    ) -> Result<(), E> {
        match &mut self.source {
            Source::Made(make) => sink(0, &make(&program.partition(), program.options.seed).words),
            Source::Given(samples) => sink(0, &samples.words),
            Source::Kept(arrays) => {
                let starts = program.from.step == 0;
                arrays.read(&mut |array, piece| {
                    if array > 0 && starts { Ok(()) } else { sink(array, piece) }
                })
            }
        }
    }

    /// Puts it where the program's ranks look for it.
    ///
    /// # Errors
    /// A checkpoint that cannot be read again.
    pub fn put(
        mut self,
        program: &Program,
        world: &World,
        storage: &mut Storage,
    ) -> Result<(), FolderError> {
        let shape = program.options.shape;
        let mut samples = storage.tile_mut(shape);
        let mut moments = [Vec::new(), Vec::new()];
        self.read::<FolderError>(program, &mut |array, piece| {
            if array == 0 {
                let rest = std::mem::take(&mut samples);
                let (words, rest) = rest.split_at_mut(piece.len());
                words.copy_from_slice(piece);
                samples = rest;
            } else {
                let moments = &mut moments[array - 1];
                moments.reserve_exact(shape.coordinates() - moments.len());
                moments.extend(piece);
            }
            Ok(())
        })?;
        if program.from.step > 0 {
            let can_fail = program.team.can_fail;
            storage.put_moments(shape, can_fail, program.from.step, &moments);
        }
        storage.record.restore(&self.record);
        world.board().begin_after(rounds::enter(program.from.phase) - 1);
        Ok(())
    }
}
