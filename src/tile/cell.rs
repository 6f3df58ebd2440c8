//! A rectangle of a tile, and how far draws reach over its edge: the measures of cells, blocks and
//! regions.

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
