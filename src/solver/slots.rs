//! Where Adam's moments lie: rows that move on by one place in each step, where workers can be lost.
//!
//! A row of moments must be changed whole or not at all there. So a line has room for one row more
//! than there are frames, and each step writes every row to the place of the row before it, which
//! is done with by then.

use std::ops::Range;

use crate::tile::TileShape;

/// Where the rows of a line's moments lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Slots {
    frames: usize,
    /// Rows that there is room for: one more than frames, if a worker can be lost.
    count: usize,
    /// Words of a row.
    own: usize,
}

impl Slots {
    /// The slots of the lines of a tile.
    pub fn new(shape: TileShape, has_workers: bool) -> Self {
        let own = shape.width() * shape.spp() * shape.dims();
        Self { frames: shape.frames(), count: shape.frames() + usize::from(has_workers), own }
    }

    /// Words of a line.
    pub fn line(self) -> usize {
        self.count * self.own
    }

    /// Whether rows move on in each step.
    pub fn move_on(self) -> bool {
        self.count > self.frames
    }

    /// Slots that rows have moved on before step number `step`.
    pub fn turns(self, step: u32) -> usize {
        if self.move_on() { step as usize % self.count } else { 0 }
    }

    /// Words of the row of frame `t` in a line after so many `turns`, up to one more than slots.
    pub fn row(self, t: usize, turns: usize) -> Range<usize> {
        // No remainder: it would take longer than the arithmetic of some samples.
        let slot = if t >= turns { t - turns } else { t + self.count - turns };
        slot * self.own..(slot + 1) * self.own
    }

    /// The rows of all lines before a step, in line order.
    pub fn rows(self, moments: &[f32], step: u32) -> Vec<&[f32]> {
        let turns = self.turns(step);
        let lines = moments.chunks_exact(self.line());
        lines.flat_map(|line| (0..self.frames).map(move |t| &line[self.row(t, turns)])).collect()
    }

    /// Puts moments in line order where they belong before a step.
    pub fn put(self, moments: &mut [f32], step: u32, rows: &[f32]) {
        let turns = self.turns(step);
        let lines = moments.chunks_exact_mut(self.line());
        for (line, rows) in lines.zip(rows.chunks_exact(self.frames * self.own)) {
            for (t, row) in rows.chunks_exact(self.own).enumerate() {
                line[self.row(t, turns)].copy_from_slice(row);
            }
        }
    }
}
