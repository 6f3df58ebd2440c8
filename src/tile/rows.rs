//! How the samples of a tile lie in memory while they are optimized.
//!
//! A *row* is one line of pixels of one frame; rows lie in the order `(y, t)`, so that the rows
//! of one place in all frames are neighbours, as they are in a kernel. In front of a row and
//! behind it stand copies of its pixels around the torus, as far as draws reach: what a draw
//! needs of a row is one run of memory, wherever it lies. In y the torus is closed by
//! [`Rows::starts`].

use crate::tile::{Reach, TileShape};

/// Words behind the last row that may be read, so that runs can be read in whole registers.
pub const SLACK: usize = 16;

/// The rows of a tile, in words of four bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rows {
    shape: TileShape,
    reach: Reach,
    starts: Vec<usize>,
}

impl Rows {
    /// Rows of `shape` with copies for draws of a given `reach`.
    pub fn new(shape: TileShape, reach: Reach) -> Self {
        let mut rows = Self { shape, reach, starts: Vec::new() };
        let height = shape.height();
        let first = height * reach.up.div_ceil(height) - reach.up;
        rows.starts = (0..reach.up + height + reach.down)
            .map(|i| (first + i) % height * rows.line())
            .collect();
        rows
    }

    /// The tile's shape.
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

    /// Words of the rows of one y in all frames.
    pub fn line(&self) -> usize {
        self.stride() * self.shape.frames()
    }

    /// Words of all rows, without the [`SLACK`] behind them.
    pub fn words(&self) -> usize {
        self.line() * self.shape.height()
    }

    /// For y from −`reach.up` to `height + reach.down`, the first word of its rows.
    pub fn starts(&self) -> &[usize] {
        &self.starts
    }

    /// First word of a row's own pixels, counted from the row's start.
    pub fn lead(&self) -> usize {
        self.reach.left * self.pixel()
    }

    /// Renews the copies in front of a row's own pixels and behind them.
    pub fn close(&self, row: &mut [f32]) {
        let own = self.shape.width() * self.pixel();
        let lead = self.lead();
        // From the inside outwards, so that longer reaches than the tile is wide find copies.
        for i in (0..lead).rev() {
            row[i] = row[i + own];
        }
        for i in lead + own..row.len() {
            row[i] = row[i - own];
        }
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
            let rows = Rows::new(shape, Reach { left, right, up, down });
            let pixel = rows.pixel();
            let word = |x: usize, y: usize, t: usize, k: usize| {
                (shape.pixel(x, y, t) * pixel + k) as f32
            };
            let mut memory = vec![-1.0; rows.words()];
            for (i, row) in memory.chunks_mut(rows.stride()).enumerate() {
                let (y, t) = (i / frames, i % frames);
                for x in 0..width {
                    (0..pixel).for_each(|k| row[rows.lead() + x * pixel + k] = word(x, y, t, k));
                }
                rows.close(row);
            }
            for y in 0..up + height + down {
                for t in 0..frames {
                    for x in 0..left + width + right {
                        let start = rows.starts()[y] + t * rows.stride() + x * pixel;
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
