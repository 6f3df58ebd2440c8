//! The samples of a tile in *line order*, which is what phases hand on to each other.

use crate::tile::{Tile, TileShape};

/// The samples of a tile, line after line: all rows of one y, frame after frame, before those of
/// the next.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// The coordinates.
    pub words: Vec<f32>,
}

impl Samples {
    /// The samples of a tile.
    pub fn from_tile(tile: &Tile) -> Self {
        let mut words = vec![0.0; tile.shape().coordinates()];
        rows(tile.shape(), |in_lines, in_tile| {
            words[in_lines].copy_from_slice(&tile.samples()[in_tile]);
        });
        Self { words }
    }

    /// The tile that has these samples.
    ///
    /// # Panics
    /// If they are not as many as that.
    pub fn to_tile(&self, shape: TileShape) -> Tile {
        assert_eq!(self.words.len(), shape.coordinates());
        let mut samples = vec![0.0; self.words.len()];
        rows(shape, |in_lines, in_tile| samples[in_tile].copy_from_slice(&self.words[in_lines]));
        Tile::new(shape, samples).expect("coordinates are kept in [0, 1) by one rule")
    }
}

/// Calls `row` with the words of every row, in line order and in the tile.
fn rows(shape: TileShape, mut row: impl FnMut(std::ops::Range<usize>, std::ops::Range<usize>)) {
    let own = shape.width() * shape.spp() * shape.dims();
    for y in 0..shape.height() {
        for t in 0..shape.frames() {
            let (line, tile) = (y * shape.frames() + t, t * shape.height() + y);
            row(line * own..(line + 1) * own, tile * own..(tile + 1) * own);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::Baseline;

    #[test]
    fn line_order_loses_nothing() {
        let shape = TileShape::new(7, 5, 3, 2, 3).unwrap();
        let tile = Baseline::White.tile(shape, 4);
        let samples = Samples::from_tile(&tile);
        assert_eq!(samples.to_tile(shape), tile);
        // Pixel (6, 4) of frame 1 is the last of line 4's second row.
        let at = ((4 * 3 + 1) * 7 + 6) * 6;
        assert_eq!(samples.words[at + 3..at + 6], *tile.point(6, 4, 1, 1));
    }
}
