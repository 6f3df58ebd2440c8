//! The sample tile: its shape, its memory, and all index arithmetic.
//!
//! A tile holds `frames × height × width × spp × dims` coordinates in `[0, 1)`, in C order
//! (the last axis varies fastest). It wraps toroidally in x, y and t.

mod block;
mod cell;
mod layout;
mod partition;
mod region;
mod rows;
mod shape;

pub use block::{Block, Overlap, Segment};
pub use cell::{Cell, Reach};
pub use layout::{LINE, Layout, Placement};
pub use partition::{Partition, TooManyRanks};
pub use region::{Piece, Region, Regions, Window};
pub use rows::{Rows, SLACK};
pub use shape::{MAX_DIMS, MAX_SPP, ShapeError, TileShape};

use thiserror::Error;

/// The largest `f32` below 1, the upper end of the half-open range of coordinates.
pub const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Brings a coordinate into `[0, 1)`; the only rule in the program that does so.
///
/// Values below 0 (and −0) become +0, values of 1 and above the largest `f32` below 1.
#[inline(always)]
#[allow(clippy::manual_clamp, reason = "`clamp` would let NaN through, this turns it into 0")]
pub fn clamp_coordinate(x: f32) -> f32 {
    // `max` alone may return −0 for −0; adding +0 turns −0 into +0 and keeps all else.
    x.max(0.0).min(BELOW_ONE) + 0.0
}

/// Why samples do not make a tile.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum TileError {
    /// The number of coordinates differs from the shape's.
    #[error("a tile of shape {shape} has {expected} coordinates, but {found} were given")]
    Length {
        /// Shape asked for.
        shape: TileShape,
        /// Number of coordinates that the shape has.
        expected: usize,
        /// Number of coordinates given.
        found: usize,
    },
    /// A coordinate is outside `[0, 1)` or not a number.
    #[error("coordinate {index} is {value}, but every coordinate must be in [0, 1)")]
    Coordinate {
        /// Position in C order.
        index: usize,
        /// The value found there.
        value: f32,
    },
}

/// A sample tile in C order `(frames, height, width, spp, dims)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    shape: TileShape,
    samples: Vec<f32>,
}

impl Tile {
    /// Makes a tile of `samples` in C order.
    ///
    /// # Errors
    /// [`TileError::Length`] if their number differs from the shape's, and
    /// [`TileError::Coordinate`] for the first one outside `[0, 1)`.
    pub fn new(shape: TileShape, samples: Vec<f32>) -> Result<Self, TileError> {
        if samples.len() != shape.coordinates() {
            return Err(TileError::Length {
                shape,
                expected: shape.coordinates(),
                found: samples.len(),
            });
        }
        match samples.iter().position(|x| !(0.0..1.0).contains(x)) {
            Some(index) => Err(TileError::Coordinate { index, value: samples[index] }),
            None => Ok(Self { shape, samples }),
        }
    }

    /// The tile's shape.
    pub fn shape(&self) -> TileShape {
        self.shape
    }

    /// All coordinates in C order.
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// The coordinates in C order, by value.
    pub fn into_samples(self) -> Vec<f32> {
        self.samples
    }

    /// The tile of the first samples of every pixel.
    ///
    /// # Panics
    /// If there are none, or more than the tile has.
    pub fn first(&self, samples: usize) -> Self {
        assert!((1..=self.shape.spp()).contains(&samples), "{samples} samples of {}", self.shape);
        let dims = self.shape.dims();
        let pixels = self.samples.chunks_exact(self.shape.spp() * dims);
        let samples_of = pixels.flat_map(|pixel| &pixel[..samples * dims]).copied().collect();
        Self { shape: self.shape.with_spp(samples), samples: samples_of }
    }

    /// The tile of frame `phase` and every `stride`-th frame after it.
    ///
    /// # Panics
    /// If the phase is not below the stride, or the stride is not a divisor of the tile's frames.
    pub fn every(&self, stride: usize, phase: usize) -> Self {
        let frames = self.shape.frames();
        assert!(phase < stride && frames.is_multiple_of(stride), "{phase} of {stride} of {frames}");
        let frame = self.samples.len() / frames;
        let seen = self.samples.chunks_exact(frame).skip(phase).step_by(stride);
        Self {
            shape: self.shape.with_frames(frames / stride),
            samples: seen.flatten().copied().collect(),
        }
    }

    /// The point (`dims` coordinates) of sample `s` at pixel `(x, y)` of frame `t`.
    ///
    /// # Panics
    /// If a position is outside the tile.
    pub fn point(&self, x: usize, y: usize, t: usize, s: usize) -> &[f32] {
        assert!(s < self.shape.spp(), "sample {s} of {}", self.shape);
        let dims = self.shape.dims();
        let first = (self.shape.pixel(x, y, t) * self.shape.spp() + s) * dims;
        &self.samples[first..first + dims]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_brought_into_the_half_open_range() {
        assert_eq!(clamp_coordinate(1.0), BELOW_ONE);
        assert_eq!(clamp_coordinate(7.5), BELOW_ONE);
        assert_eq!(clamp_coordinate(0.25), 0.25);
        for x in [-0.0_f32, -1e-30, -3.0] {
            assert_eq!(clamp_coordinate(x).to_bits(), 0.0_f32.to_bits());
        }
        const { assert!(BELOW_ONE < 1.0) };
        assert_eq!(BELOW_ONE.to_bits() + 1, 1.0_f32.to_bits());
    }

    #[test]
    fn parts_of_a_tile_hold_its_points() {
        let shape = TileShape::new(3, 2, 6, 4, 2).unwrap();
        let samples = (0..shape.coordinates()).map(|i| i as f32 / 1024.0).collect();
        let tile = Tile::new(shape, samples).unwrap();
        let first = tile.first(3);
        assert_eq!(first.shape(), TileShape::new(3, 2, 6, 3, 2).unwrap());
        let phase = tile.every(3, 2);
        assert_eq!(phase.shape(), TileShape::new(3, 2, 2, 4, 2).unwrap());
        for (x, y, s) in [(0, 0, 0), (2, 1, 2), (1, 1, 1)] {
            (0..6).for_each(|t| assert_eq!(first.point(x, y, t, s), tile.point(x, y, t, s)));
            (0..2)
                .for_each(|t| assert_eq!(phase.point(x, y, t, s), tile.point(x, y, 3 * t + 2, s)));
        }
        assert_eq!(tile.first(4), tile);
        assert_eq!(tile.every(1, 0), tile);
    }

    #[test]
    fn a_tile_refuses_what_is_not_a_sample() {
        let shape = TileShape::new(2, 1, 1, 1, 1).unwrap();
        assert!(Tile::new(shape, vec![0.0, BELOW_ONE]).is_ok());
        assert!(matches!(
            Tile::new(shape, vec![0.0]),
            Err(TileError::Length { expected: 2, found: 1, .. })
        ));
        for bad in [1.0, -0.1, f32::NAN, f32::INFINITY] {
            assert!(matches!(
                Tile::new(shape, vec![0.5, bad]),
                Err(TileError::Coordinate { index: 1, .. })
            ));
        }
    }
}
