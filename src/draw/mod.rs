//! The draws of a step: which pixel, which threshold, which direction (Algorithm 1, lines 6–8).
//!
//! A draw is a pure function of the options, the seed, the step and its cell, so every process
//! makes the draws of its own cells without asking any other.

mod direction;
mod levels;
mod philox;

pub use direction::{Density, Direction, DirectionSet};
pub use levels::{LevelSet, LevelSets};
pub use philox::{Stream, Use, philox};

use serde::{Deserialize, Serialize};

use crate::tile::{Cell, Partition};

/// How draws are made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DrawOptions {
    /// Draws of a step, in all cells together; at least 1.
    pub draws: usize,
    /// Directions for each drawn subset; at least 1.
    pub directions: usize,
    /// Share of the threshold range that is drawn from, in (0, 1]; 1 is the paper's.
    pub threshold_range: f64,
    /// Share of directions along single axes, in [0, 1].
    pub axis_share: f64,
    /// Share of directions in the planes of axis pairs, in [0, 1]; of no effect in two
    /// dimensions, where that is every direction.
    pub pair_share: f64,
}

/// One draw: a subset of samples. Its directions follow in [`CellDraws::directions`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Draw {
    /// Column of the pixel in its cell.
    pub x: u32,
    /// Row of the pixel in its cell.
    pub y: u32,
    /// Frame of the pixel.
    pub t: u32,
    /// Which level set of [`LevelSets`].
    pub set: u32,
    /// How many of its taps are in the subset; at least 1.
    pub taps: u32,
}

/// The draws of one cell; lent to [`Draws::cell`] so that a step allocates nothing.
#[derive(Debug, Clone, Default)]
pub struct CellDraws {
    /// The draws, by place.
    pub draws: Vec<Draw>,
    /// Their directions, a fixed number for each draw.
    pub directions: Vec<Direction>,
}

/// Makes the draws of cells.
#[derive(Debug, Clone)]
pub struct Draws {
    options: DrawOptions,
    seed: u64,
    levels: LevelSets,
    set: DirectionSet,
}

/// 2³² times the first three powers of 1/ρ, with ρ ≈ 1.2207 the real root of x⁴ = x + 1: steps of
/// a sequence that is spread evenly over three axes together (the generalised golden ratio,
/// Roberts 2018), so that the classes, thresholds and directions of a cell are stratified.
const STRIDES: [u32; 3] = [0xD1B5_4A32, 0xABC9_8388, 0x8CB9_2BA7];

impl Draws {
    /// A source of draws from `levels` for tiles of `dims` dimensions.
    pub fn new(options: DrawOptions, seed: u64, levels: LevelSets, dims: usize) -> Self {
        Self { options, seed, levels, set: DirectionSet::new(dims) }
    }

    /// How draws are made.
    pub fn options(&self) -> &DrawOptions {
        &self.options
    }

    /// The level sets that draws select.
    pub fn levels(&self) -> &LevelSets {
        &self.levels
    }

    /// The directions that draws select from.
    pub fn directions(&self) -> &DirectionSet {
        &self.set
    }

    /// Most draws that one pixel can get in one step.
    ///
    /// A cell of P pixels gets at most ⌈D·P/N⌉ + 1 of D draws, spread over its pixels so that
    /// none gets more than the next integer above the mean.
    pub fn most_per_pixel(&self, partition: &Partition) -> usize {
        let frames = partition.shape().frames();
        (0..partition.cells())
            .map(|cell| {
                let pixels = partition.cell(cell).pixels(frames);
                let most = self.options.draws.saturating_mul(pixels) / partition.shape().pixels();
                (most + 2).div_ceil(pixels)
            })
            .max()
            .unwrap_or(0)
    }

    /// Makes the draws of `cell` in `step`.
    ///
    /// The step's draws are dealt to cells in proportion to their pixels. Inside the cell each
    /// draw has a stratum of the pixels (in C order) to itself, so none is drawn twice while
    /// there are more pixels than draws.
    pub fn cell(&self, partition: &Partition, step: u32, cell: usize, out: &mut CellDraws) {
        out.draws.clear();
        out.directions.clear();
        let frames = partition.shape().frames();
        let place = partition.cell(cell);
        let pixels = place.pixels(frames);
        let count = self.share(partition, step, cell);
        let mut stream = Stream::new(self.seed, Use::Draws, step, cell as u32);
        let shift = [stream.word(), stream.word(), stream.word()];
        let turn = stream.below(pixels as u32) as usize;
        let mut directions = Stream::new(self.seed, Use::Directions, step, cell as u32);
        let unit = |word: u32| f64::from(word) / (1_u64 << 32) as f64;
        for i in 0..count {
            // Strata of whole pixels, turned by a random amount so that all are equally likely.
            let first = stratum(i, count, pixels);
            let size = (stratum(i + 1, count, pixels) - first).max(1);
            let pixel = (first + stream.below(size as u32) as usize + turn) % pixels;
            let [class, level, angle]: [f64; 3] = std::array::from_fn(|k| {
                unit(shift[k].wrapping_add((i as u32).wrapping_mul(STRIDES[k])))
            });
            let set = self.levels.select(class);
            let taps = self.levels.sets()[set].above(level * self.options.threshold_range);
            out.draws.push(self.draw(place, pixel, set, taps));
            for k in 0..self.options.directions {
                let turned = angle + k as f64 / self.options.directions as f64;
                let direction = self.direction(turned.fract(), &mut directions);
                out.directions.push(direction);
            }
        }
    }

    /// Number of draws of a cell in a step.
    fn share(&self, partition: &Partition, step: u32, cell: usize) -> usize {
        let frames = partition.shape().frames();
        let all = partition.shape().pixels() as u128;
        let before: usize = (0..cell).map(|c| partition.cell(c).pixels(frames)).sum();
        let after = before + partition.cell(cell).pixels(frames);
        let turn = (Stream::new(self.seed, Use::Share, step, 0).unit() * all as f64) as u128;
        let upto =
            |pixels: usize| ((self.options.draws as u128 * pixels as u128 + turn) / all) as usize;
        upto(after) - upto(before)
    }

    fn draw(&self, cell: Cell, pixel: usize, set: usize, taps: usize) -> Draw {
        Draw {
            x: (pixel % cell.width) as u32,
            y: (pixel / cell.width % cell.height) as u32,
            t: (pixel / cell.width / cell.height) as u32,
            set: set as u32,
            taps: taps.max(1) as u32,
        }
    }

    fn direction(&self, u: f64, stream: &mut Stream) -> Direction {
        let kind = stream.unit();
        let DrawOptions { axis_share, pair_share, .. } = self.options;
        if kind < axis_share {
            self.set.axis(stream.below(self.set.dims() as u32) as usize)
        } else if kind < axis_share + pair_share {
            self.set.random_pair(u, stream)
        } else {
            self.set.any(u, stream)
        }
    }
}

/// First of the `pixels` that belong to stratum `i` of `count`.
fn stratum(i: usize, count: usize, pixels: usize) -> usize {
    (i as u128 * pixels as u128 / count as u128) as usize
}
