//! What a step reads and writes: samples and moments.
//!
//! A step changes them in place, line by line. Writing into a second copy, so that a step could be
//! done again from its start, made the steps of the paper's tile half as long again: with it the
//! state outgrows the third-level cache. One process has nobody who could fail half-way; where
//! somebody can, a line that is written down before it is changed is enough.

use rayon::prelude::*;

use crate::gradient::simd::Simd;
use crate::solver::adam::{Factors, Pull, Update};
use crate::solver::pages::Pages;
use crate::tile::{Cell, Partition, Rows, SLACK, Tile};

/// The samples of a rank's cells in *cell order* (cell after cell, each in C order).
///
/// This is what phases hand on to each other.
#[derive(Debug, Clone, PartialEq)]
pub struct CellSamples {
    /// The coordinates.
    pub words: Vec<f32>,
}

impl CellSamples {
    /// The samples of all cells of a whole tile.
    ///
    /// # Panics
    /// If the partition is of another shape.
    pub fn from_tile(tile: &Tile, partition: &Partition) -> Self {
        assert_eq!(tile.shape(), partition.shape());
        let shape = tile.shape();
        let pixel = shape.spp() * shape.dims();
        let mut words = Vec::with_capacity(tile.samples().len());
        visit_rows(partition, |x, y, t, width| {
            let start = shape.pixel(x, y, t) * pixel;
            words.extend(&tile.samples()[start..start + width * pixel]);
        });
        Self { words }
    }

    /// The whole tile, if these are all its cells.
    ///
    /// # Panics
    /// If they are not.
    pub fn to_tile(&self, partition: &Partition) -> Tile {
        let shape = partition.shape();
        let pixel = shape.spp() * shape.dims();
        let mut samples = vec![0.0; shape.coordinates()];
        let mut words = &self.words[..];
        visit_rows(partition, |x, y, t, width| {
            let start = shape.pixel(x, y, t) * pixel;
            let (row, rest) = words.split_at(width * pixel);
            samples[start..start + row.len()].copy_from_slice(row);
            words = rest;
        });
        Tile::new(shape, samples).expect("coordinates are kept in [0, 1) by one rule")
    }
}

/// Calls `row(x, y, t, width)` for the rows of all cells in cell order, with their first pixel.
fn visit_rows(partition: &Partition, mut row: impl FnMut(usize, usize, usize, usize)) {
    for cell in 0..partition.cells() {
        let Cell { x, y: top, width, height } = partition.cell(cell);
        for t in 0..partition.shape().frames() {
            (top..top + height).for_each(|y| row(x, y, t, width));
        }
    }
}

/// Samples and Adam's moments of a tile.
#[derive(Debug)]
pub(crate) struct State {
    rows: Rows,
    samples: Pages<f32>,
    /// Moments in the order of the rows, without the copies around them.
    first: Pages<f32>,
    second: Pages<f32>,
}

impl State {
    /// The state before the first step.
    pub fn new(rows: Rows, partition: &Partition, samples: &CellSamples) -> Self {
        let coordinates = rows.shape().coordinates();
        let mut state = Self {
            samples: Pages::zeros(rows.words() + SLACK),
            first: Pages::zeros(coordinates),
            second: Pages::zeros(coordinates),
            rows,
        };
        state.replace(partition, samples);
        state
    }

    /// Replaces the samples, and keeps the moments.
    pub fn replace(&mut self, partition: &Partition, samples: &CellSamples) {
        let mut words = &samples.words[..];
        let Self { rows, samples, .. } = self;
        let pixel = rows.pixel();
        visit_rows(partition, |x, y, t, width| {
            let (row, rest) = words.split_at(width * pixel);
            let start = rows.word(x, y, t);
            samples[start..start + row.len()].copy_from_slice(row);
            words = rest;
        });
        samples[rows.lines()].chunks_mut(rows.stride()).for_each(|row| rows.close_row(row));
        rows.close_lines(samples);
    }

    /// How the samples lie.
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// The samples in their rows, with [`SLACK`] behind them.
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// The samples in cell order.
    pub fn cell_samples(&self, partition: &Partition) -> CellSamples {
        let rows = &self.rows;
        let mut words = Vec::with_capacity(rows.shape().coordinates());
        visit_rows(partition, |x, y, t, width| {
            let start = rows.word(x, y, t);
            words.extend(&self.samples[start..start + width * rows.pixel()]);
        });
        CellSamples { words }
    }

    /// Renews the copies of lines, after [`Self::lines_mut`].
    pub fn close(&mut self) {
        self.rows.close_lines(&mut self.samples);
    }

    /// The lines of the tile, in order of y, to be changed.
    pub fn lines_mut(&mut self) -> impl IndexedParallelIterator<Item = Line<'_>> {
        let rows = &self.rows;
        let words = rows.own() * rows.shape().frames();
        self.samples[rows.lines()]
            .par_chunks_mut(rows.line())
            .zip(self.first.par_chunks_mut(words))
            .zip(self.second.par_chunks_mut(words))
            .map(move |((samples, first), second)| Line { rows, samples, first, second })
    }
}

/// The rows of one y in all frames.
pub(crate) struct Line<'a> {
    rows: &'a Rows,
    samples: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl Line<'_> {
    /// Moves the samples of frame `t` by Adam.
    pub fn update<P: Pull>(&mut self, t: usize, factors: Factors, pulls: &[P], simd: Simd) {
        let own = self.rows.own();
        let moments = t * own..(t + 1) * own;
        let row = &mut self.samples[t * self.rows.stride()..(t + 1) * self.rows.stride()];
        let lead = self.rows.lead();
        simd.run(Update {
            factors,
            pulls,
            samples: &mut row[lead..lead + own],
            first: &mut self.first[moments.clone()],
            second: &mut self.second[moments],
        });
        self.rows.close_row(row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::Baseline;
    use crate::tile::{Reach, TileShape};

    #[test]
    fn cell_order_and_rows_lose_nothing() {
        let shape = TileShape::new(37, 35, 3, 2, 3).unwrap();
        let reach = Reach { left: 2, right: 3, up: 1, down: 0 };
        let (tile, partition) = (Baseline::White.tile(shape, 4), Partition::new(shape, reach, 1));
        let samples = CellSamples::from_tile(&tile, &partition);
        assert_eq!(samples.to_tile(&partition), tile);
        // The first row of the first cell, and the first pixel of the second cell.
        let cell = partition.cell(0);
        let row = cell.width * 6;
        assert_eq!(samples.words[..row], tile.samples()[..row]);
        let second = cell.pixels(3) * 6;
        assert_eq!(samples.words[second..second + 3], *tile.point(partition.cell(1).x, 0, 0, 0));

        let rows = Rows::new(shape, reach);
        let mut state = State::new(rows.clone(), &partition, &samples);
        assert_eq!(state.cell_samples(&partition), samples);
        let start = 6 * rows.line() + 2 * rows.stride();
        assert_eq!(state.samples()[start..start + 3], *tile.point(35, 5, 2, 0));
        assert_eq!(state.samples()[start + 12..start + 15], *tile.point(0, 5, 2, 0));

        // New samples leave the moments as they are.
        state.first.fill(1.0);
        let other = CellSamples::from_tile(&Baseline::White.tile(shape, 5), &partition);
        state.replace(&partition, &other);
        assert_eq!(state.cell_samples(&partition), other);
        assert!(state.first.iter().all(|&m| m == 1.0));
    }
}
