//! How the samples of a tile lie in memory while they are optimized.
//!
//! A *row* is one line of pixels of one frame, and a *line* the rows of one y in all frames; rows
//! lie in the order `(y, t)`, so that a kernel's frames of one place are neighbours. In front of
//! a row and behind it stand copies of its pixels around the torus, as far as draws reach, and
//! above and below the tile copies of its lines: what a draw needs of a row is one run of
//! memory, wherever it lies.
//!
//! A rank of a cluster has the rows of its region instead of the tile's. Where the region goes
//! around the torus its copies are its own; all others come from where the samples are.

use crate::tile::{Reach, Region, TileShape, Window};

/// Words behind the last row that may be read, so that runs can be read in whole registers.
pub const SLACK: usize = 16;

/// The rows of a region of a tile, in words of four bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rows {
    region: Region,
    shape: TileShape,
    reach: Reach,
}

impl Rows {
    /// Rows of a region with copies for draws of a given `reach`.
    pub fn new(region: Region, reach: Reach) -> Self {
        Self { region, shape: region.shape(), reach }
    }

    /// The region.
    pub fn region(&self) -> Region {
        self.region
    }

    /// The region's shape.
    pub fn shape(&self) -> TileShape {
        self.shape
    }

    /// How far draws reach.
    pub fn reach(&self) -> Reach {
        self.reach
    }

    /// Words of a pixel.
    pub fn pixel(&self) -> usize {
        self.shape.spp() * self.shape.dims()
    }

    /// Words from a row to the next.
    pub fn stride(&self) -> usize {
        (self.reach.left + self.shape.width() + self.reach.right) * self.pixel()
    }

    /// Words of a line.
    pub fn line(&self) -> usize {
        self.stride() * self.shape.frames()
    }

    /// Words of all rows, copies included, without the [`SLACK`] behind them.
    pub fn words(&self) -> usize {
        self.line() * (self.reach.up + self.shape.height() + self.reach.down)
    }

    /// Words of a row's own pixels, without the copies around them.
    pub fn own(&self) -> usize {
        self.shape.width() * self.pixel()
    }

    /// First word of a row's own pixels, counted from the row's start.
    pub fn lead(&self) -> usize {
        self.reach.left * self.pixel()
    }

    /// The words of the region's own lines.
    pub fn lines(&self) -> std::ops::Range<usize> {
        let start = self.reach.up * self.line();
        start..start + self.shape.height() * self.line()
    }

    /// First word of pixel `(x, y)` of frame `t`, counted from the region's first.
    pub fn word(&self, x: usize, y: usize, t: usize) -> usize {
        let row = (self.reach.up + y) * self.shape.frames() + t;
        row * self.stride() + self.lead() + x * self.pixel()
    }

    /// First word of a row of a window in the region or around it: its `j`-th in frame `t`.
    pub fn word_of(&self, window: Window, j: usize, t: usize) -> usize {
        let place = self.region.place();
        let y = window.y - (place.y as i64 - self.reach.up as i64) + j as i64;
        let x = window.x - (place.x as i64 - self.reach.left as i64);
        y as usize * self.line() + t * self.stride() + x as usize * self.pixel()
    }

    /// The words of line `y`, and those of its copies above the region and below it.
    pub fn line_and_copies(&self, y: usize) -> Vec<std::ops::Range<usize>> {
        let (height, up) = (self.shape.height(), self.reach.up);
        let words = |line: usize| line * self.line()..(line + 1) * self.line();
        if !self.region.wraps_y() {
            return vec![words(up + y)];
        }
        let lines = up + height + self.reach.down;
        // The first line that is one of them.
        let first = (up + y) % height;
        let copies = (first..lines).step_by(height).filter(|&line| line != up + y);
        std::iter::once(up + y).chain(copies).map(words).collect()
    }

    /// Renews the copies in front of a row's own pixels and behind them, where they are its own.
    pub fn close_row(&self, row: &mut [f32]) {
        if self.region.wraps_x() {
            close(row, self.lead(), self.own());
        }
    }

    /// Renews the copies of lines above the region and below it, where they are its own.
    pub fn close_lines(&self, samples: &mut [f32]) {
        if self.region.wraps_y() {
            let lines = self.lines();
            close(&mut samples[..self.words()], lines.start, lines.len());
        }
    }
}

/// Renews the copies in front of the `own` words from `lead` on, and behind them.
fn close(words: &mut [f32], lead: usize, own: usize) {
    // From the inside outwards, so that longer reaches than the tile is wide find copies.
    let mut start = lead;
    while start > 0 {
        let len = start.min(own);
        words.copy_within(start + own - len..start + own, start - len);
        start -= len;
    }
    let mut end = lead + own;
    while end < words.len() {
        let len = (words.len() - end).min(own);
        words.copy_within(end - own..end - own + len, end);
        end += len;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn whatever_is_in_reach_is_found_around_the_torus(
            width in 1_usize..12, height in 1_usize..9, frames in 1_usize..4, spp in 1_usize..3,
            left in 0_usize..20, right in 0_usize..20, up in 0_usize..14, down in 0_usize..14,
        ) {
            let shape = TileShape::new(width, height, frames, spp, 2).unwrap();
            let rows = Rows::new(Region::whole(shape), Reach { left, right, up, down });
            let pixel = rows.pixel();
            let word = |x: usize, y: usize, t: usize, k: usize| {
                (shape.pixel(x, y, t) * pixel + k) as f32
            };
            let mut memory = vec![-1.0; rows.words()];
            for (i, row) in memory[rows.lines()].chunks_mut(rows.stride()).enumerate() {
                let (y, t) = (i / frames, i % frames);
                for x in 0..width {
                    (0..pixel).for_each(|k| row[rows.lead() + x * pixel + k] = word(x, y, t, k));
                }
                rows.close_row(row);
            }
            let mut copied = memory.clone();
            rows.close_lines(&mut memory);
            for y in 0..height {
                let mut words = rows.line_and_copies(y).into_iter();
                let line = words.next().unwrap();
                words.for_each(|copy| copied.copy_within(line.clone(), copy.start));
            }
            prop_assert_eq!(&copied, &memory);
            prop_assert_eq!(memory[rows.word(0, height - 1, 0)], word(0, height - 1, 0, 0));
            for y in 0..up + height + down {
                for t in 0..frames {
                    for x in 0..left + width + right {
                        let start = y * rows.line() + t * rows.stride() + x * pixel;
                        let at = |i: usize, lead: usize, size: usize| {
                            (i as i64 - lead as i64).rem_euclid(size as i64) as usize
                        };
                        let (x, y) = (at(x, left, width), at(y, up, height));
                        for k in 0..pixel {
                            prop_assert_eq!(memory[start + k], word(x, y, t, k));
                        }
                    }
                }
            }
        }
    }
}
