//! How a tile is cut into cells, and cells are joined to blocks.
//!
//! A *cell* is a rectangle in x and y with all its frames. It is the unit of everything that is
//! shared out: it makes its own draws, and it is owned by one rank. The cells are the same for
//! every number of ranks and threads, so that draws are, too. A *block* is a rectangle of cells
//! that one thread works on; how many there are is of no influence on any result.
//!
//! Everything here is pure arithmetic on the shape and the reach.

use std::ops::Range;

use crate::tile::{Block, TileShape};

/// How far draws reach from their pixel, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reach {
    /// Towards smaller x.
    pub left: usize,
    /// Towards larger x.
    pub right: usize,
    /// Towards smaller y.
    pub up: usize,
    /// Towards larger y.
    pub down: usize,
}

impl Reach {
    /// How far apart two samples of one draw can be.
    pub fn doubled(&self) -> Self {
        let (across, down) = (self.left + self.right, self.up + self.down);
        Self { left: across, right: across, up: down, down }
    }
}

/// A rectangle of the tile with all its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Cell {
    /// Pixels in all frames: `width · height · frames`.
    pub fn pixels(&self, frames: usize) -> usize {
        self.width * self.height * frames
    }
}

/// The cells of a tile and the parts (ranks) that own them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Partition {
    shape: TileShape,
    reach: Reach,
    columns: Vec<Range<usize>>,
    rows: Vec<Range<usize>>,
    parts: usize,
}

impl Partition {
    /// Cells of `shape` for draws of a given `reach`, owned by `parts` ranks.
    ///
    /// Cells are about [`Self::CELL`] pixels wide and high, or four times as wide as the draws
    /// reach, whichever is more, so that halos stay smaller than what they surround.
    pub fn new(shape: TileShape, reach: Reach, parts: usize) -> Self {
        let columns = cut(shape.width(), Self::CELL.max(4 * reach.left.max(reach.right)));
        let rows = cut(shape.height(), Self::CELL.max(4 * reach.up.max(reach.down)));
        let parts = parts.clamp(1, columns.len() * rows.len());
        Self { shape, reach, columns, rows, parts }
    }

    /// Width and height of a cell, in pixels, that the cut aims at: what the draws of a cell see
    /// of 30 frames then fits a second-level cache of 256 KB, with its integer gradient.
    pub const CELL: usize = 16;

    /// The tile's shape.
    pub fn shape(&self) -> TileShape {
        self.shape
    }

    /// How far its draws reach.
    pub fn reach(&self) -> Reach {
        self.reach
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.columns.len() * self.rows.len()
    }

    /// The cells that a part owns.
    ///
    /// # Panics
    /// If there is no such part.
    pub fn owned(&self, part: usize) -> Range<usize> {
        assert!(part < self.parts, "part {part} of {}", self.parts);
        self.cells() * part / self.parts..self.cells() * (part + 1) / self.parts
    }

    /// The part that owns a cell.
    pub fn owner(&self, cell: usize) -> usize {
        ((cell + 1) * self.parts - 1) / self.cells()
    }

    /// Place and size of a cell.
    pub fn cell(&self, cell: usize) -> Cell {
        let column = &self.columns[cell % self.columns.len()];
        let row = &self.rows[cell / self.columns.len()];
        Cell { x: column.start, y: row.start, width: column.len(), height: row.len() }
    }

    /// Pixels, in all frames, of the cells before a cell.
    pub fn pixels_before(&self, cell: usize) -> usize {
        let Cell { x, y, height, .. } = self.cell(cell);
        (y * self.shape.width() + x * height) * self.shape.frames()
    }

    /// Joins the cells to at least `count` blocks, as far as there are cells.
    ///
    /// Rows of cells stay together as long as possible: the longer a row of a block, the smaller
    /// its halo.
    pub fn blocks(&self, count: usize) -> Vec<Block> {
        let (bands, across) = self.grid(count);
        let block = |rows: &Range<usize>, columns: &Range<usize>| {
            let (x, y) = (self.columns[columns.start].start, self.rows[rows.start].start);
            let width = self.columns[columns.end - 1].end - x;
            let height = self.rows[rows.end - 1].end - y;
            let cells = rows
                .clone()
                .flat_map(|row| columns.clone().map(move |column| (row, column)))
                .map(|(row, column)| row * self.columns.len() + column)
                .collect();
            Block::new(self.shape, self.reach, Cell { x, y, width, height }, cells)
        };
        bands.iter().flat_map(|rows| across.iter().map(|columns| block(rows, columns))).collect()
    }

    /// Number of blocks that [`Self::blocks`] makes.
    pub fn block_count(&self, count: usize) -> usize {
        let (bands, across) = self.grid(count);
        bands.len() * across.len()
    }

    /// Pixels of all blocks together, halos included; saturating.
    pub fn block_pixels(&self, count: usize) -> usize {
        let (bands, across) = self.grid(count);
        let Reach { left, right, up, down } = self.reach;
        let across = self.shape.width().saturating_add(across.len() * (left + right));
        let down = self.shape.height().saturating_add(bands.len() * (up + down));
        across.saturating_mul(down).saturating_mul(self.shape.frames())
    }

    /// The rows and columns of cells that blocks are made of.
    fn grid(&self, count: usize) -> (Vec<Range<usize>>, Vec<Range<usize>>) {
        let bands = pieces(self.rows.len(), count);
        let across = pieces(self.columns.len(), count.div_ceil(bands.len()));
        (bands, across)
    }
}

/// Cuts `size` into pieces of nearly equal length, about `aim` each.
fn cut(size: usize, aim: usize) -> Vec<Range<usize>> {
    pieces(size, (size / aim).max(1))
}

/// Cuts `size` into `count` pieces of nearly equal length, or single ones if there are fewer.
fn pieces(size: usize, count: usize) -> Vec<Range<usize>> {
    let count = count.clamp(1, size);
    (0..count).map(|i| size * i / count..size * (i + 1) / count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cells_and_blocks_cover_the_tile_once(
            width in 1_usize..90, height in 1_usize..70, frames in 1_usize..3,
            reach in 0_usize..9, parts in 1_usize..5, count in 1_usize..40,
        ) {
            let shape = TileShape::new(width, height, frames, 1, 1).unwrap();
            let reach = Reach { left: reach, up: reach, ..Reach::default() };
            let partition = Partition::new(shape, reach, parts);
            let mut seen = vec![0; width * height];
            let mut before = 0;
            for index in 0..partition.cells() {
                prop_assert!(partition.owned(partition.owner(index)).contains(&index));
                let cell = partition.cell(index);
                prop_assert_eq!(partition.pixels_before(index), before);
                before += cell.pixels(frames);
                for y in cell.y..cell.y + cell.height {
                    seen[y * width + cell.x..][..cell.width].iter_mut().for_each(|n| *n += 1);
                }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));

            let blocks = partition.blocks(count);
            prop_assert_eq!(blocks.len(), partition.block_count(count));
            prop_assert!(blocks.len() >= count.min(partition.cells()).min(partition.rows.len()));
            let mut cells: Vec<usize> = blocks.iter().flat_map(|b| b.cells().to_vec()).collect();
            cells.sort_unstable();
            prop_assert!(cells.into_iter().eq(0..partition.cells()));
            let words: usize = blocks.iter().map(Block::words).sum();
            prop_assert_eq!(partition.block_pixels(count), words);
            for block in &blocks {
                let place = block.place();
                let pixels: usize =
                    block.cells().iter().map(|&cell| partition.cell(cell).pixels(frames)).sum();
                prop_assert_eq!(place.pixels(frames), pixels);
                for &cell in block.cells() {
                    let cell = partition.cell(cell);
                    prop_assert!(cell.x >= place.x && cell.x + cell.width <= place.x + place.width);
                    prop_assert!(
                        cell.y >= place.y && cell.y + cell.height <= place.y + place.height
                    );
                }
            }
        }
    }
}
