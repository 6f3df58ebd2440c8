//! The memory of a block's gradient, and how blocks add up to the gradient of a tile.
//!
//! The draws of a block reach over its edge, so its gradient, a *patch*, has a halo around its
//! cells: rows in the order `(y, t)` as in [`crate::tile::Rows`], but without wrap-around in x
//! and y. [`Overlap`] says which rows of which patches add up to a row of the tile.

use crate::tile::{Cell, Reach, TileShape};

/// A rectangle of cells with its halo, in words of four bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    shape: TileShape,
    reach: Reach,
    place: Cell,
    cells: Vec<usize>,
}

impl Block {
    pub(super) fn new(shape: TileShape, reach: Reach, place: Cell, cells: Vec<usize>) -> Self {
        Self { shape, reach, place, cells }
    }

    /// Where it lies in the tile, halo excluded.
    pub fn place(&self) -> Cell {
        self.place
    }

    /// Its cells.
    pub fn cells(&self) -> &[usize] {
        &self.cells
    }

    /// Halo on each side, in pixels.
    pub fn reach(&self) -> Reach {
        self.reach
    }

    /// Words from a row to the next.
    pub fn stride(&self) -> usize {
        (self.reach.left + self.place.width + self.reach.right)
            * (self.shape.spp() * self.shape.dims())
    }

    /// Words of the rows of one y in all frames.
    pub fn line(&self) -> usize {
        self.stride() * self.shape.frames()
    }

    /// Words of the patch.
    pub fn words(&self) -> usize {
        self.line() * (self.reach.up + self.place.height + self.reach.down)
    }
}

/// Part of a row of a patch and the words of the tile's row that it belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// First word in the row of the patch.
    pub from: usize,
    /// First word in the row of the tile.
    pub to: usize,
    /// Number of words.
    pub len: usize,
}

/// How the patches of blocks add up to the gradient of a tile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overlap {
    /// For every y of the tile, the blocks that reach it and the first word there in their patch.
    lines: Vec<Vec<(usize, usize)>>,
    /// For every block, how its rows lie in the rows of the tile.
    segments: Vec<Vec<Segment>>,
}

impl Overlap {
    /// The overlap of blocks that cover a tile of `shape`.
    pub fn new(shape: TileShape, blocks: &[Block]) -> Self {
        let mut lines = vec![Vec::new(); shape.height()];
        for (index, block) in blocks.iter().enumerate() {
            let Reach { up, down, .. } = block.reach;
            for i in 0..up + block.place.height + down {
                let y = around(block.place.y, i, up, shape.height());
                lines[y].push((index, i * block.line()));
            }
        }
        let pixel = shape.spp() * shape.dims();
        let segments = blocks
            .iter()
            .map(|block| {
                let width = block.stride() / pixel;
                let mut segments = Vec::new();
                let mut x = 0;
                while x < width {
                    let to = around(block.place.x, x, block.reach.left, shape.width());
                    let len = (shape.width() - to).min(width - x);
                    segments.push(Segment { from: x * pixel, to: to * pixel, len: len * pixel });
                    x += len;
                }
                segments
            })
            .collect();
        Self { lines, segments }
    }

    /// The blocks that reach a y of the tile, each with the first word of its rows there.
    pub fn line(&self, y: usize) -> &[(usize, usize)] {
        &self.lines[y]
    }

    /// How the rows of a block lie in the rows of the tile.
    pub fn segments(&self, block: usize) -> &[Segment] {
        &self.segments[block]
    }
}

/// Where position `i` of an axis that begins `lead` before `start` lies on a torus of `size`.
fn around(start: usize, i: usize, lead: usize, size: usize) -> usize {
    (start + i + size * lead.div_ceil(size) - lead) % size
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::Partition;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_word_of_every_patch_adds_up_where_it_belongs(
            width in 1_usize..50, height in 1_usize..40, frames in 1_usize..3, spp in 1_usize..3,
            left in 0_usize..20, right in 0_usize..9, up in 0_usize..9, down in 0_usize..20,
            count in 1_usize..9,
        ) {
            let shape = TileShape::new(width, height, frames, spp, 2).unwrap();
            let partition = Partition::new(shape, Reach { left, right, up, down }, 1);
            let blocks = partition.blocks(count);
            let pixel = spp * 2;
            let mut expected = vec![0_i64; shape.coordinates()];
            let mut patches = Vec::new();
            for (b, block) in blocks.iter().enumerate() {
                let patch: Vec<i64> = (0..block.words() as i64).map(|i| i + 7 * b as i64).collect();
                for (i, &word) in patch.iter().enumerate() {
                    let at = |i: usize, lead: usize, start: usize, size: usize| {
                        (start as i64 + i as i64 - lead as i64).rem_euclid(size as i64) as usize
                    };
                    let Cell { x, y, .. } = block.place();
                    let y = at(i / block.line(), up, y, height);
                    let x = at(i % block.stride() / pixel, left, x, width);
                    let t = i / block.stride() % frames;
                    expected[shape.pixel(x, y, t) * pixel + i % pixel] += word;
                }
                patches.push(patch);
            }
            let overlap = Overlap::new(shape, &blocks);
            let mut found = vec![0_i64; shape.coordinates()];
            for y in 0..height {
                for &(block, start) in overlap.line(y) {
                    for t in 0..frames {
                        let row = &patches[block][start + t * blocks[block].stride()..];
                        for s in overlap.segments(block) {
                            let to = shape.pixel(0, y, t) * pixel + s.to;
                            (0..s.len).for_each(|k| found[to + k] += row[s.from + k]);
                        }
                    }
                }
            }
            prop_assert_eq!(found, expected);
        }
    }
}
