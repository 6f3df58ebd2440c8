//! What a run begins with: samples, and if it goes on from a checkpoint, all else that it had.
//!
//! None of it is held here, but for a tile that was given: it is made or read when it is wanted,
//! and passed on in pieces.

use perceptile_cluster::World;

use crate::format::numbers::Sink;
use crate::run::folder::{Arrays, FolderError};
use crate::run::program::{Program, ProgramError};
use crate::run::travel::{self, Scatter};
use crate::solver::{Options, OptionsError, Recorded, Samples, Start, Storage, rounds, start};
use crate::tile::{Partition, Region, Tile};

/// What a run begins with.
#[derive(Debug)]
pub struct Begin {
    source: Source,
    /// The objective of steps before.
    record: Recorded,
}

/// Where samples come from.
#[derive(Debug)]
enum Source {
    /// They are made from the program's seed, each region's by itself.
    Made(fn(&Partition, Region, u64) -> Samples),
    /// They were given.
    Given(Samples),
    /// They lie in a checkpoint, and Adam's moments with them.
    Kept(Arrays),
    /// The root has them.
    AtRoot,
}

impl Begin {
    /// The start that a program asks for; `start` is the tile to start from, if there is one.
    ///
    /// # Errors
    /// A starting tile of another shape, or one too many or too few.
    pub fn new(program: &Program, start: Option<&Tile>) -> Result<Self, OptionsError> {
        let shape = program.options.shape;
        let source = match (Self::makes(&program.options), start) {
            (Some(source), None) => source,
            (None, Some(tile)) if tile.shape() == shape => Source::Given(Samples::from_tile(tile)),
            (None, Some(tile)) => {
                return Err(OptionsError::Start { expected: shape, found: tile.shape() });
            }
            _ => return Err(OptionsError::StartMissing),
        };
        Ok(Self { source, record: Recorded::default() })
    }

    /// What a rank begins with that is not the root: it makes its start, if nobody has to be
    /// asked for it.
    pub fn beside_root(program: &Program, is_kept: bool) -> Self {
        let made = Self::makes(&program.options).filter(|_| !is_kept);
        Self { source: made.unwrap_or(Source::AtRoot), record: Recorded::default() }
    }

    fn makes(options: &Options) -> Option<Source> {
        match options.start {
            Start::Random => Some(Source::Made(start::random)),
            Start::Stratified => Some(Source::Made(start::stratified)),
            Start::Tile => None,
        }
    }

    /// What a checkpoint holds: samples and moments, as many as the program's tile has
    /// coordinates, and the objective of steps before.
    pub(super) fn kept(arrays: Arrays, record: Recorded) -> Self {
        Self { source: Source::Kept(arrays), record }
    }

    /// Whether a run goes on with it that was kept.
    pub fn is_kept(&self) -> bool {
        matches!(self.source, Source::Kept(_))
    }

    /// The objective of steps before.
    pub fn record(&self) -> &Recorded {
        &self.record
    }

    /// Passes on what lies here of what the ranks of a program begin with, in line order and piece
    /// by piece, each piece with the number of its array: the samples (0), and if a phase is to go
    /// on, Adam's first (1) and second moments (2). What was passed on is worth nothing if there is
    /// an error in the end, but was never more than the tile has coordinates.
    ///
    /// # Errors
    /// A checkpoint that cannot be read again, and what `sink` reports.
    pub fn read<E: From<FolderError>>(
        &mut self,
        program: &Program,
        sink: &mut Sink<'_, E>,
    ) -> Result<(), E> {
        match &mut self.source {
            Source::Made(_) | Source::AtRoot => Ok(()),
            Source::Given(samples) => sink(0, &samples.words),
            Source::Kept(arrays) => {
                let starts = program.from.step == 0;
                arrays.read(&mut |array, piece| {
                    if array > 0 && starts { Ok(()) } else { sink(array, piece) }
                })
            }
        }
    }

    /// Puts it where the program's ranks look for it: on all of them, what is their region's.
    ///
    /// # Errors
    /// A checkpoint that cannot be read again, here or at the root.
    pub fn put(
        mut self,
        program: &Program,
        world: &World,
        storage: &mut Storage,
    ) -> Result<(), ProgramError> {
        let peers = &**world.peers();
        let regions = program.regions(peers.rank());
        let shape = regions.own().shape();
        if let Source::Made(make) = self.source {
            let samples = make(&program.partition(), regions.own(), program.options.seed);
            storage.tile_mut(shape).copy_from_slice(&samples.words);
        } else {
            let goes_on = program.from.step > 0;
            let mut own = Own::new(storage.tile_mut(shape));
            let mut result = Ok(());
            if peers.rank() == 0 {
                let mut scatter = Scatter::new(peers, &regions);
                result = self.read::<FolderError>(program, &mut |_, piece| {
                    scatter.take(piece, &mut |words| own.take(words));
                    Ok(())
                });
                scatter.make_up(if goes_on { 3 } else { 1 });
            } else {
                for _ in 0..if goes_on { 3 } else { 1 } {
                    travel::receive(peers, &regions, &mut |words| own.take(words));
                }
            }
            let moments = own.moments;
            let mut failed = [i64::from(result.is_err())];
            peers.max(&mut failed);
            result?;
            if failed != [0] {
                return Err(ProgramError::Elsewhere);
            }
            if goes_on {
                let can_fail = program.team.can_fail;
                storage.put_moments(shape, can_fail, program.from.step, &moments);
            }
        }
        storage.record.restore(&self.record);
        world.board().begin_after(rounds::enter(program.from.phase) - 1);
        Ok(())
    }
}

/// Where samples and moments go that come one after the other.
struct Own<'a> {
    samples: &'a mut [f32],
    count: usize,
    moments: [Vec<f32>; 2],
}

impl<'a> Own<'a> {
    fn new(samples: &'a mut [f32]) -> Self {
        Self { count: samples.len(), samples, moments: [Vec::new(), Vec::new()] }
    }

    fn take(&mut self, mut words: &[f32]) {
        let here = words.len().min(self.samples.len());
        if here > 0 {
            let (to, rest) = std::mem::take(&mut self.samples).split_at_mut(here);
            to.copy_from_slice(&words[..here]);
            (self.samples, words) = (rest, &words[here..]);
        }
        for moments in &mut self.moments {
            let here = words.len().min(self.count - moments.len());
            if here > 0 {
                moments.reserve_exact(self.count - moments.len());
                moments.extend_from_slice(&words[..here]);
                words = &words[here..];
            }
        }
    }
}
