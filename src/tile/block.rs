//! The memory of a block's gradient, and how blocks add up to the gradient of a tile.
//!
//! The draws of a block reach over its edge, so its gradient, a *patch*, has a halo around its
//! cells: rows in the order `(y, t)` as in [`crate::tile::Rows`], but without wrap-around in x
//! and y. [`Overlap`] says which rows of which patches add up to a row of the tile, or of a piece
//! of it that is sent.

use crate::tile::{Cell, Reach, Region, TileShape, Window};

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

    /// With its halo.
    pub fn window(&self) -> Window {
        Window::of(self.place, self.reach)
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

/// How patches add up to the gradient of a rectangle of pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overlap {
    /// For every y of the rectangle, the patches that reach it and the first word there in each.
    lines: Vec<Vec<(usize, usize)>>,
    /// For every patch, words from a row to the next, and how its rows lie in those of the
    /// rectangle.
    patches: Vec<(usize, Vec<Segment>)>,
}

impl Overlap {
    /// The overlap of patches, which lie in windows, with a region. Where the region goes around
    /// the torus, so do they.
    pub fn new(region: Region, patches: impl Iterator<Item = Window>) -> Self {
        let target = Window::of(region.place(), Reach::default());
        Self::on(region.tile(), target, region.wraps(), patches)
    }

    /// The overlap of patches with a window as it is.
    pub fn with_window(
        tile: TileShape,
        window: Window,
        patches: impl Iterator<Item = Window>,
    ) -> Self {
        Self::on(tile, window, [None; 2], patches)
    }

    fn on(
        tile: TileShape,
        target: Window,
        [around_x, around_y]: [Option<usize>; 2],
        windows: impl Iterator<Item = Window>,
    ) -> Self {
        let pixel = tile.spp() * tile.dims();
        let mut lines = vec![Vec::new(); target.height];
        let mut patches: Vec<(usize, Vec<Segment>)> = Vec::new();
        for (index, window) in windows.enumerate() {
            let stride = window.width * pixel;
            for run in runs(window.y - target.y, window.height, target.height, around_y) {
                for i in 0..run.len {
                    let first = (run.from + i) * tile.frames() * stride;
                    lines[run.to + i].push((index, first));
                }
            }
            let segment = |run: Segment| Segment {
                from: run.from * pixel,
                to: run.to * pixel,
                len: run.len * pixel,
            };
            let runs = runs(window.x - target.x, window.width, target.width, around_x);
            patches.push((stride, runs.into_iter().map(segment).collect()));
        }
        // A patch that reaches past the sides only has no words for a line.
        for line in &mut lines {
            line.retain(|(patch, _): &(usize, usize)| !patches[*patch].1.is_empty());
        }
        Self { lines, patches }
    }

    /// The patches that reach a y of the rectangle, each with the first word of its rows there.
    pub fn line(&self, y: usize) -> &[(usize, usize)] {
        &self.lines[y]
    }

    /// How the rows of a patch lie in the rows of the rectangle.
    pub fn segments(&self, patch: usize) -> &[Segment] {
        &self.patches[patch].1
    }

    /// Words from a row of a patch to the next.
    pub fn stride(&self, patch: usize) -> usize {
        self.patches[patch].0
    }
}

/// Where an interval of `len` that begins at `start` lies in `0..size`, around a torus or not.
fn runs(start: i64, len: usize, size: usize, around: Option<usize>) -> Vec<Segment> {
    let mut runs = Vec::new();
    let mut from = 0;
    while from < len {
        let at = start + from as i64;
        let at = around.map_or(at, |around| at.rem_euclid(around as i64));
        if at < 0 {
            from += usize::try_from(-at).map_or(len, |skip| skip.min(len - from));
            continue;
        }
        let to = at as usize;
        if to >= size {
            break;
        }
        let run = (size - to).min(len - from);
        runs.push(Segment { from, to, len: run });
        from += run;
    }
    runs
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
            let partition = Partition::new(shape, Reach { left, right, up, down });
            let blocks = partition.blocks(Region::whole(shape), count);
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
            let overlap = Overlap::new(Region::whole(shape), blocks.iter().map(Block::window));
            let mut found = vec![0_i64; shape.coordinates()];
            for y in 0..height {
                for &(block, start) in overlap.line(y) {
                    for t in 0..frames {
                        let row = &patches[block][start + t * overlap.stride(block)..];
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
