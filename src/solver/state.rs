//! What a step reads and writes: samples and moments, each twice.
//!
//! A step reads the current half and writes the other one; only [`State::commit`] makes the new
//! half current. A step that fails half-way is simply done again.

use crate::solver::blocks::{Blocks, split};
use crate::tile::{Partition, Tile};

/// The samples of a rank's cells in *cell order* (cell after cell, each in C order, no halos).
///
/// This is what phases hand on to each other.
#[derive(Debug, Clone, PartialEq)]
pub struct CellSamples {
    /// The coordinates.
    pub words: Vec<f32>,
}

impl CellSamples {
    /// The samples of all cells of a whole tile.
    ///
    /// # Panics
    /// If the partition is of another shape.
    pub fn from_tile(tile: &Tile, partition: &Partition) -> Self {
        assert_eq!(tile.shape(), partition.shape());
        let mut words = Vec::with_capacity(tile.samples().len());
        visit_rows(partition, |start, len| words.extend(&tile.samples()[start..start + len]));
        Self { words }
    }

    /// The whole tile, if these are all its cells.
    ///
    /// # Panics
    /// If they are not.
    pub fn to_tile(&self, partition: &Partition) -> Tile {
        let mut samples = vec![0.0; partition.shape().coordinates()];
        let mut words = &self.words[..];
        visit_rows(partition, |start, len| {
            let (row, rest) = words.split_at(len);
            samples[start..start + len].copy_from_slice(row);
            words = rest;
        });
        Tile::new(partition.shape(), samples).expect("coordinates are kept in [0, 1) by one rule")
    }
}

/// Calls `row(first word in the tile, words)` for the rows of all cells in cell order.
fn visit_rows(partition: &Partition, mut row: impl FnMut(usize, usize)) {
    let shape = partition.shape();
    let pixel = shape.spp() * shape.dims();
    for cell in (0..partition.cells()).map(|cell| partition.cell(cell)) {
        for t in 0..shape.frames() {
            for y in cell.y..cell.y + cell.height {
                row(shape.pixel(cell.x, y, t) * pixel, cell.width * pixel);
            }
        }
    }
}

/// One half of the state.
#[derive(Debug, Clone)]
pub(crate) struct Half {
    /// Samples of all blocks, halos included.
    pub samples: Vec<f32>,
    /// Adam's first moments, in cell order.
    pub first: Vec<f32>,
    /// Adam's second moments, in cell order.
    pub second: Vec<f32>,
}

impl Half {
    /// Copies samples in cell order into the blocks.
    fn fill(&mut self, blocks: &Blocks, samples: &CellSamples) {
        let mut rest = &samples.words[..];
        for (i, block) in split(&mut self.samples, blocks.block_words()).into_iter().enumerate() {
            let (cell, tail) = rest.split_at(blocks.cell_words()[i]);
            for row in blocks.rows(blocks.first() + i) {
                block[row.block..row.block + row.len]
                    .copy_from_slice(&cell[row.cell..row.cell + row.len]);
            }
            rest = tail;
        }
    }
}

/// Samples and moments of a rank, each twice.
#[derive(Debug, Clone)]
pub(crate) struct State {
    halves: [Half; 2],
    current: usize,
}

impl State {
    /// The state before the first step; halos are yet to be filled.
    pub fn new(blocks: &Blocks, samples: &CellSamples) -> Self {
        let words = samples.words.len();
        let mut half = Half {
            samples: vec![0.0; blocks.block_words().iter().sum()],
            first: vec![0.0; words],
            second: vec![0.0; words],
        };
        half.fill(blocks, samples);
        Self { halves: [half.clone(), half], current: 0 }
    }

    /// Replaces the samples that hold, and keeps the moments; halos are yet to be filled.
    pub fn replace(&mut self, blocks: &Blocks, samples: &CellSamples) {
        self.current_mut().fill(blocks, samples);
    }

    /// The half that holds.
    pub fn current(&self) -> &Half {
        &self.halves[self.current]
    }

    /// The half that holds, for filling its halos.
    pub fn current_mut(&mut self) -> &mut Half {
        &mut self.halves[self.current]
    }

    /// The half that holds, and the one that the step writes.
    pub fn old_and_new(&mut self) -> (&Half, &mut Half) {
        let [a, b] = &mut self.halves;
        if self.current == 0 { (a, b) } else { (b, a) }
    }

    /// Makes the half that was written the one that holds.
    pub fn commit(&mut self) {
        self.current = 1 - self.current;
    }

    /// The samples in cell order.
    pub fn samples(&self, blocks: &Blocks) -> CellSamples {
        let mut words = Vec::with_capacity(self.current().first.len());
        let mut rest = &self.current().samples[..];
        for (i, &size) in blocks.block_words().iter().enumerate() {
            let (block, tail) = rest.split_at(size);
            for row in blocks.rows(blocks.first() + i) {
                words.extend(&block[row.block..row.block + row.len]);
            }
            rest = tail;
        }
        CellSamples { words }
    }
}

#[cfg(test)]
mod tests {
    use perceptile_cluster::World;

    use super::*;
    use crate::metric::Baseline;
    use crate::tile::{Reach, TileShape};

    fn cells() -> (Tile, Partition) {
        let shape = TileShape::new(37, 35, 3, 2, 3).unwrap();
        let reach = Reach { left: 2, right: 3, up: 1, down: 0 };
        (Baseline::White.tile(shape, 4), Partition::new(shape, reach, 1))
    }

    #[test]
    fn cell_order_and_blocks_lose_nothing() {
        let (tile, partition) = cells();
        let samples = CellSamples::from_tile(&tile, &partition);
        assert_eq!(samples.to_tile(&partition), tile);
        // The first row of the first cell, and the first pixel of the second cell.
        let cell = partition.cell(0);
        let row = cell.width * 6;
        assert_eq!(samples.words[..row], tile.samples()[..row]);
        let second = cell.pixels(3) * 6;
        assert_eq!(samples.words[second..second + 3], *tile.point(partition.cell(1).x, 0, 0, 0));

        let blocks = Blocks::new(partition, World::Local);
        assert_eq!(State::new(&blocks, &samples).samples(&blocks), samples);
    }

    #[test]
    fn a_step_holds_only_after_it_is_committed() {
        let (tile, partition) = cells();
        let samples = CellSamples::from_tile(&tile, &partition);
        let blocks = Blocks::new(partition, World::Local);
        let mut state = State::new(&blocks, &samples);
        let (_, new) = state.old_and_new();
        new.samples.fill(0.25);
        new.first.fill(1.0);
        assert_eq!(state.samples(&blocks), samples);
        assert!(state.current().first.iter().all(|&m| m == 0.0));
        state.commit();
        assert!(state.samples(&blocks).words.iter().all(|&x| x == 0.25));
        let (old, new) = state.old_and_new();
        assert_eq!((old.first[0], new.first[0]), (1.0, 0.0));
        state.replace(&blocks, &samples);
        assert_eq!(state.samples(&blocks), samples);
        assert!(state.current().first.iter().all(|&m| m == 1.0));
    }
}
