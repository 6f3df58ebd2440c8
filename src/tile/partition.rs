//! How a tile is cut into cells, and cells are joined to blocks.
//!
//! A *cell* is a rectangle in x and y with all its frames. It is the unit of everything that is
//! shared out: it makes its own draws, and it is owned by one rank ([`Region`]). The cells are the same for
//! every number of ranks and threads, so that draws are, too. A *block* is a rectangle of cells
//! that one thread works on; how many there are is of no influence on any result.
//!
//! Everything here is pure arithmetic on the shape and the reach.

use std::ops::Range;

use thiserror::Error;

use crate::tile::{Block, Cell, Reach, Region, Regions, TileShape};

/// More ranks than a tile has cells.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("{ranks} ranks are too many: a tile of {shape} has {cells} cells, and each rank needs one")]
pub struct TooManyRanks {
    /// Ranks asked for.
    pub ranks: usize,
    /// The tile's shape.
    pub shape: TileShape,
    /// Its cells.
    pub cells: usize,
}

/// The cells of a tile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Partition {
    shape: TileShape,
    reach: Reach,
    columns: Vec<Range<usize>>,
    rows: Vec<Range<usize>>,
}

impl Partition {
    /// Cells of `shape` for draws of a given `reach`.
    ///
    /// Cells are about [`Self::CELL`] pixels wide and high, or four times as wide as the draws
    /// reach, whichever is more, so that halos stay smaller than what they surround.
    pub fn new(shape: TileShape, reach: Reach) -> Self {
        let columns = cut(shape.width(), Self::CELL.max(4 * reach.left.max(reach.right)));
        let rows = cut(shape.height(), Self::CELL.max(4 * reach.up.max(reach.down)));
        Self { shape, reach, columns, rows }
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

    /// Shares the cells out over so many ranks, as one of them sees it.
    ///
    /// Ranks and cells are halved again and again across the longer side, which keeps regions
    /// close to squares, and so their halos small, for any number of ranks.
    ///
    /// # Errors
    /// If there are not as many cells.
    ///
    /// # Panics
    /// If there are no ranks, or not this one.
    pub fn regions(&self, ranks: usize, rank: usize) -> Result<Regions, TooManyRanks> {
        assert!(ranks > 0, "no ranks");
        let cells = self.cells();
        if ranks > cells {
            return Err(TooManyRanks { ranks, shape: self.shape, cells });
        }
        let mut all = Vec::with_capacity(ranks);
        self.halve([0..self.rows.len(), 0..self.columns.len()], ranks, &mut all);
        Ok(Regions::new(all, rank))
    }

    /// Shares `[rows, columns]` of cells out over so many ranks.
    fn halve(&self, cells: [Range<usize>; 2], ranks: usize, all: &mut Vec<Region>) {
        let place = self.rectangle(&cells);
        if ranks == 1 {
            all.push(Region::new(self.shape, place));
            return;
        }
        let [down, across] = [cells[0].len(), cells[1].len()];
        // Of two sides alike, rows stay whole: their memory is one run.
        let axis = usize::from(place.width > place.height && across > 1 || down == 1);
        let (length, width) = if axis == 0 { (down, across) } else { (across, down) };
        // Where to cut, with how many ranks before it: as even as can be, and a cell for each rank.
        let load = |cut: usize, before: usize| {
            let share = |cells: usize, ranks: usize| (cells * width).div_ceil(ranks);
            share(cut, before).max(share(length - cut, ranks - before))
        };
        let fits = |&(cut, before): &(usize, usize)| {
            before >= 1
                && before < ranks
                && cut * width >= before
                && (length - cut) * width >= ranks - before
        };
        let half = ranks / 2;
        let (cut, before) = (1..length)
            .flat_map(|cut| [half, ranks - half, ranks * cut / length].map(|before| (cut, before)))
            .filter(fits)
            .min_by_key(|&(cut, before)| (load(cut, before), before.abs_diff(half)))
            .expect("a cut in proportion leaves a cell for each rank");
        let [mut first, mut second] = [cells.clone(), cells];
        first[axis].end = first[axis].start + cut;
        second[axis].start = first[axis].end;
        self.halve(first, before, all);
        self.halve(second, ranks - before, all);
    }

    /// The rectangle of some `[rows, columns]` of cells.
    fn rectangle(&self, [rows, columns]: &[Range<usize>; 2]) -> Cell {
        let (x, y) = (self.columns[columns.start].start, self.rows[rows.start].start);
        let width = self.columns[columns.end - 1].end - x;
        let height = self.rows[rows.end - 1].end - y;
        Cell { x, y, width, height }
    }

    /// The `[rows, columns]` of cells that a region is made of.
    fn cells_of(&self, region: Region) -> [Range<usize>; 2] {
        let Cell { x, y, width, height } = region.place();
        let within = |pieces: &[Range<usize>], start: usize, size: usize| {
            let at = |place| pieces.partition_point(|piece| piece.end <= place);
            at(start)..at(start + size - 1) + 1
        };
        [within(&self.rows, y, height), within(&self.columns, x, width)]
    }

    /// The cells of a region, in rising order.
    pub fn cells_in(&self, region: Region) -> Vec<usize> {
        let [rows, columns] = self.cells_of(region);
        self.numbers(rows, columns).collect()
    }

    fn numbers(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
    ) -> impl Iterator<Item = usize> + use<> {
        let across = self.columns.len();
        rows.flat_map(move |row| columns.clone().map(move |column| row * across + column))
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

    /// Joins the cells of a region to at least `count` blocks, as far as there are cells.
    ///
    /// Rows of cells stay together as long as possible: the longer a row of a block, the smaller
    /// its halo. Cells at the edges of a region that does not go around the torus are in blocks of
    /// their own.
    pub fn blocks(&self, region: Region, count: usize) -> Vec<Block> {
        let (bands, across) = self.grid(region, count);
        let block = |rows: &Range<usize>, columns: &Range<usize>| {
            let place = self.rectangle(&[rows.clone(), columns.clone()]);
            let cells = self.numbers(rows.clone(), columns.clone()).collect();
            Block::new(self.shape, self.reach, place, cells)
        };
        bands.iter().flat_map(|rows| across.iter().map(|columns| block(rows, columns))).collect()
    }

    /// Number of blocks that [`Self::blocks`] makes.
    pub fn block_count(&self, region: Region, count: usize) -> usize {
        let (bands, across) = self.grid(region, count);
        bands.len() * across.len()
    }

    /// Pixels of all blocks together, halos included; saturating.
    pub fn block_pixels(&self, region: Region, count: usize) -> usize {
        let (bands, across) = self.grid(region, count);
        let Reach { left, right, up, down } = self.reach;
        let Cell { width, height, .. } = region.place();
        let across = width.saturating_add(across.len() * (left + right));
        let down = height.saturating_add(bands.len() * (up + down));
        across.saturating_mul(down).saturating_mul(self.shape.frames())
    }

    /// The rows and columns of cells that blocks of a region are made of.
    fn grid(&self, region: Region, count: usize) -> (Vec<Range<usize>>, Vec<Range<usize>>) {
        let cells = self.cells_of(region);
        let cut = |cells: &Range<usize>, count: usize, apart: bool| -> Vec<Range<usize>> {
            // What others have to do with is kept apart, so that the rest need not wait for it.
            let apart = usize::from(apart && cells.len() > 2);
            let inside = cells.start + apart..cells.end - apart;
            let pieces = pieces(inside.len(), count).into_iter();
            let pieces = pieces.map(|it| inside.start + it.start..inside.start + it.end);
            let first = std::iter::once(cells.start..inside.start);
            let last = std::iter::once(inside.end..cells.end);
            first.chain(pieces).chain(last).filter(|piece| !piece.is_empty()).collect()
        };
        let bands = cut(&cells[0], count, !region.wraps_y());
        let across = cut(&cells[1], count.div_ceil(bands.len()), !region.wraps_x());
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
            reach in 0_usize..9, count in 1_usize..40, ranks in 1_usize..9,
        ) {
            let shape = TileShape::new(width, height, frames, 1, 1).unwrap();
            let reach = Reach { left: reach, up: reach, ..Reach::default() };
            let partition = Partition::new(shape, reach);
            let mut seen = vec![0; width * height];
            let mut before = 0;
            for index in 0..partition.cells() {
                let cell = partition.cell(index);
                prop_assert_eq!(partition.pixels_before(index), before);
                before += cell.pixels(frames);
                for y in cell.y..cell.y + cell.height {
                    seen[y * width + cell.x..][..cell.width].iter_mut().for_each(|n| *n += 1);
                }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));

            let mut blocks = Vec::new();
            for &region in partition.regions(ranks.min(partition.cells()), 0).unwrap().all() {
                let found = partition.blocks(region, count);
                prop_assert_eq!(found.len(), partition.block_count(region, count));
                let [rows, columns] = partition.cells_of(region);
                prop_assert!(found.len() >= count.min(rows.len() * columns.len()).min(rows.len()));
                let words: usize = found.iter().map(Block::words).sum();
                prop_assert_eq!(partition.block_pixels(region, count), words);
                let mut cells: Vec<usize> = found.iter().flat_map(|b| b.cells().to_vec()).collect();
                cells.sort_unstable();
                prop_assert_eq!(cells, partition.cells_in(region));
                blocks.extend(found);
            }
            let mut cells: Vec<usize> = blocks.iter().flat_map(|b| b.cells().to_vec()).collect();
            cells.sort_unstable();
            prop_assert!(cells.into_iter().eq(0..partition.cells()));
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

    #[test]
    fn every_number_of_ranks_up_to_that_of_cells_has_a_region_each() {
        for (width, height) in [(128, 128), (64, 64), (16, 200), (200, 16), (96, 48), (7, 5)] {
            let shape = TileShape::new(width, height, 2, 1, 2).unwrap();
            let partition = Partition::new(shape, Reach::default());
            for ranks in 1..=partition.cells() {
                let regions = partition.regions(ranks, ranks - 1).unwrap();
                assert_eq!(regions.all().len(), ranks);
                let pixels = |region: &Region| region.shape().pixels();
                let most = regions.all().iter().map(pixels).max().unwrap();
                // Some ranks have half a cell more than their share at best.
                let fair = shape.pixels().div_ceil(ranks);
                assert!(most <= 2 * fair + 16 * 16 * 2, "{shape} {ranks}: {most} of {fair}");
            }
            assert!(partition.regions(partition.cells() + 1, 0).is_err());
        }
        // The numbers that clusters like give halves, quarters and so on.
        let shape = TileShape::new(128, 128, 30, 1, 2).unwrap();
        let partition = Partition::new(shape, Reach::default());
        let sizes = |ranks| {
            let regions = partition.regions(ranks, 0).unwrap();
            let size = |region: &Region| (region.place().width, region.place().height);
            regions.all().iter().map(size).collect::<Vec<_>>()
        };
        assert_eq!(sizes(2), [(128, 64); 2]);
        assert_eq!(sizes(4), [(64, 64); 4]);
        assert_eq!(sizes(8), [(64, 32); 8]);
        assert_eq!(sizes(64), [(16, 16); 64]);
    }
}
