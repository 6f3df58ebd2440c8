//! How a tile is cut into cells, and where each cell's pixels lie in memory.
//!
//! A *cell* is a rectangle in x and y with all its frames. It is the unit of everything that is
//! shared out: it makes its own draws, and it is owned by one rank. Its memory is a *block*: the
//! cell and around it a *halo*, as far as the kernel reaches, so that a draw finds its samples
//! side by side and needs no wrap-around in x and y. Halos are copies of other cells (or of the
//! same cell, around the torus); [`Partition::halo`] lists what is a copy of what.
//!
//! Everything here is pure arithmetic on the shape and the reach: the cells are the same for
//! every number of ranks and threads, so that draws are, too.

use std::ops::Range;

use crate::tile::TileShape;

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

/// The block of a cell: its size with the halo. Pixels lie in C order `(frames, height, width)`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Columns, halo included.
    pub width: usize,
    /// Rows, halo included.
    pub height: usize,
    /// Halo columns before the cell's first.
    pub left: usize,
    /// Halo rows before the cell's first.
    pub up: usize,
    /// Frames; there is no halo in time.
    pub frames: usize,
}

impl Block {
    /// Pixels in all frames.
    pub fn pixels(&self) -> usize {
        self.width * self.height * self.frames
    }

    /// Position in the block of the pixel at column `x` and row `y` of the cell, frame `t`.
    pub fn pixel(&self, x: usize, y: usize, t: usize) -> usize {
        (t * self.height + y + self.up) * self.width + x + self.left
    }
}

/// A run of halo pixels and the pixels of a cell that they are copies of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HaloRun {
    /// First pixel in the block of the cell that owns them.
    pub owner_pixel: usize,
    /// First pixel in the block that has the copies.
    pub halo_pixel: usize,
    /// Number of pixels.
    pub len: usize,
}

/// All halo pixels of one cell that one cell (another, or the same) owns.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Halo {
    /// Cell that owns the pixels.
    pub owner: usize,
    /// Cell whose halo they are in.
    pub cell: usize,
    /// The pixels.
    pub runs: Vec<HaloRun>,
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

    /// The same cells and owners with halos for another reach.
    pub fn with_reach(&self, reach: Reach) -> Self {
        Self { reach, ..self.clone() }
    }

    /// Width and height of a cell, in pixels, that the cut aims at: a block of 30 frames with
    /// its integer gradient then fits a second-level cache of 256 KB.
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

    /// The memory of a cell.
    pub fn block(&self, cell: usize) -> Block {
        let Cell { width, height, .. } = self.cell(cell);
        let Reach { left, right, up, down } = self.reach;
        Block {
            width: left + width + right,
            height: up + height + down,
            left,
            up,
            frames: self.shape.frames(),
        }
    }

    /// Pixels of all blocks together, halos included.
    pub fn block_pixels(&self) -> usize {
        let Reach { left, right, up, down } = self.reach;
        let across = self.shape.width().saturating_add(self.columns.len() * (left + right));
        let down = self.shape.height().saturating_add(self.rows.len() * (up + down));
        across.saturating_mul(down).saturating_mul(self.shape.frames())
    }

    /// Pixels of the largest block.
    pub fn largest_block(&self) -> usize {
        let longest = |pieces: &[Range<usize>]| pieces.iter().map(|piece| piece.len()).max();
        let Reach { left, right, up, down } = self.reach;
        let across = longest(&self.columns).unwrap_or(0) + left + right;
        let down = longest(&self.rows).unwrap_or(0) + up + down;
        across.saturating_mul(down).saturating_mul(self.shape.frames())
    }

    /// What the halo of `cell` consists of, by owner.
    pub fn halo(&self, cell: usize) -> Vec<Halo> {
        let Cell { x, y, width, height } = self.cell(cell);
        let block = self.block(cell);
        let across = runs(&self.columns, x, self.reach.left, block.width);
        let down = runs(&self.rows, y, self.reach.up, block.height);
        let mut halos: Vec<Halo> = Vec::new();
        for vertical in &down {
            for horizontal in &across {
                let own = |run: &AxisRun, lead: usize, size: usize| {
                    run.block >= lead && run.block < lead + size
                };
                if own(vertical, self.reach.up, height) && own(horizontal, self.reach.left, width) {
                    continue;
                }
                let owner = vertical.owner * self.columns.len() + horizontal.owner;
                let theirs = self.block(owner);
                let index = match halos.iter().position(|halo| halo.owner == owner) {
                    Some(index) => index,
                    None => {
                        halos.push(Halo { owner, cell, runs: Vec::new() });
                        halos.len() - 1
                    }
                };
                for t in 0..self.shape.frames() {
                    for row in 0..vertical.len {
                        halos[index].runs.push(HaloRun {
                            owner_pixel: theirs.pixel(horizontal.local, vertical.local + row, t),
                            halo_pixel: (t * block.height + vertical.block + row) * block.width
                                + horizontal.block,
                            len: horizontal.len,
                        });
                    }
                }
            }
        }
        halos
    }
}

/// Cuts `size` into pieces of nearly equal length, about `aim` each.
fn cut(size: usize, aim: usize) -> Vec<Range<usize>> {
    let pieces = (size / aim).max(1);
    (0..pieces).map(|i| size * i / pieces..size * (i + 1) / pieces).collect()
}

/// Along one axis: pixels of a block that one cell owns.
struct AxisRun {
    /// First pixel in the block.
    block: usize,
    /// Piece of the axis that owns it.
    owner: usize,
    /// First pixel in that piece.
    local: usize,
    len: usize,
}

/// Takes one axis of a block apart: it starts `lead` pixels before `start` and is `len` long.
fn runs(pieces: &[Range<usize>], start: usize, lead: usize, len: usize) -> Vec<AxisRun> {
    let size = pieces.last().map_or(0, |piece| piece.end);
    let mut found = Vec::new();
    let mut block = 0;
    while block < len {
        let place = (start + block + size * lead.div_ceil(size) - lead) % size;
        let owner = pieces.partition_point(|piece| piece.end <= place);
        // A cell's own pixels are never joined with a copy of them around the torus.
        let edge = [lead, lead + pieces_len_at(pieces, start), len]
            .into_iter()
            .find(|&edge| edge > block)
            .unwrap_or(len);
        let run = (pieces[owner].end - place).min(edge - block);
        found.push(AxisRun { block, owner, local: place - pieces[owner].start, len: run });
        block += run;
    }
    found
}

/// Length of the piece that starts at `start`.
fn pieces_len_at(pieces: &[Range<usize>], start: usize) -> usize {
    pieces.iter().find(|piece| piece.start == start).map_or(0, |piece| piece.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every pixel of every block is either its cell's own or a copy of the right pixel.
        #[test]
        fn halos_are_copies_around_the_torus(
            width in 1_usize..70, height in 1_usize..40, frames in 1_usize..3,
            left in 0_usize..20, right in 0_usize..20, up in 0_usize..9, down in 0_usize..9,
            parts in 1_usize..5,
        ) {
            let shape = TileShape::new(width, height, frames, 1, 1).unwrap();
            let partition = Partition::new(shape, Reach { left, right, up, down }, parts);
            let mut owners = 0;
            for cell in 0..partition.cells() {
                prop_assert!(partition.owned(partition.owner(cell)).contains(&cell));
                owners += partition.cell(cell).pixels(frames);
                let Cell { x, y, width: w, height: h } = partition.cell(cell);
                let block = partition.block(cell);
                let mut filled = vec![None; block.pixels()];
                for t in 0..frames {
                    for j in 0..h {
                        for i in 0..w {
                            filled[block.pixel(i, j, t)] = Some(shape.pixel(x + i, y + j, t));
                        }
                    }
                }
                for halo in partition.halo(cell) {
                    let owner = partition.cell(halo.owner);
                    let theirs = partition.block(halo.owner);
                    for run in halo.runs {
                        for k in 0..run.len {
                            let place = run.owner_pixel + k;
                            let t = place / theirs.width / theirs.height;
                            let j = place / theirs.width % theirs.height - theirs.up;
                            let i = place % theirs.width - theirs.left;
                            prop_assert!(i < owner.width && j < owner.height);
                            let pixel = shape.pixel(owner.x + i, owner.y + j, t);
                            prop_assert_eq!(filled[run.halo_pixel + k].replace(pixel), None);
                        }
                    }
                }
                for t in 0..frames {
                    for j in 0..block.height {
                        for i in 0..block.width {
                            let column = (x + i + width * left.div_ceil(width) - left) % width;
                            let row = (y + j + height * up.div_ceil(height) - up) % height;
                            prop_assert_eq!(
                                filled[(t * block.height + j) * block.width + i],
                                Some(shape.pixel(column, row, t))
                            );
                        }
                    }
                }
            }
            prop_assert_eq!(owners, shape.pixels());
            let blocks = || (0..partition.cells()).map(|cell| partition.block(cell).pixels());
            prop_assert_eq!(partition.block_pixels(), blocks().sum::<usize>());
            prop_assert_eq!(partition.largest_block(), blocks().max().unwrap());
        }
    }
}
