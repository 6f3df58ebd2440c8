//! What a run begins with: samples, and if it goes on from a checkpoint, all else that it had.

use perceptile_cluster::World;

use crate::run::program::Program;
use crate::solver::{Options, OptionsError, Samples, Start, Storage, rounds, start};
use crate::tile::Tile;

/// What a run begins with.
#[derive(Debug, Clone, PartialEq)]
pub struct Begin {
    /// Samples in line order.
    pub(super) samples: Vec<f32>,
    /// Adam's moments; none at the start of a phase.
    pub(super) moments: Option<[Vec<f32>; 2]>,
    /// The objective of steps before.
    pub(super) record: Vec<f64>,
}

impl Begin {
    /// The start that a program asks for; `start` is the tile to start from, if there is one.
    ///
    /// # Errors
    /// A starting tile of another shape, or one too many or too few.
    pub fn new(program: &Program, start: Option<&Tile>) -> Result<Self, OptionsError> {
        let Options { start: from, seed, shape, .. } = program.options;
        let Samples { words } = match (from, start) {
            (Start::Random, None) => start::random(&program.partition(), seed),
            (Start::Stratified, None) => start::stratified(&program.partition(), seed),
            (Start::Tile, Some(tile)) if tile.shape() == shape => Samples::from_tile(tile),
            (Start::Tile, Some(tile)) => {
                return Err(OptionsError::Start { expected: shape, found: tile.shape() });
            }
            _ => return Err(OptionsError::StartMissing),
        };
        Ok(Self { samples: words, moments: None, record: Vec::new() })
    }

    /// Puts it where the program's ranks look for it.
    pub fn put(self, program: &Program, world: &World, storage: &mut Storage) {
        storage.tile_mut(program.options.shape).copy_from_slice(&self.samples);
        if let Some(moments) = &self.moments {
            let can_fail = program.team.can_fail;
            storage.put_moments(program.options.shape, can_fail, program.from.step, moments);
        }
        storage.record.restore(&self.record);
        world.board().begin_after(rounds::enter(program.from.phase) - 1);
    }
}
