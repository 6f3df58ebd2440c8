//! The draws of a step: which pixel, which threshold, which direction (Algorithm 1, lines 6–8).
//!
//! A draw is a pure function of the options, the seed, the step and its cell, so every process
//! makes the draws of its own cells without asking any other.

mod direction;
mod levels;
mod philox;

pub use direction::{Direction, DirectionSet, Projection};
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
    /// How many samples of each pixel are, the first ones; at least 1.
    pub samples: u32,
}

impl Draw {
    /// Number of samples in its subset.
    #[inline(always)]
    pub fn subset(&self) -> usize {
        self.taps as usize * self.samples as usize
    }
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
    /// A source of draws from `levels` with directions of `set`.
    pub fn new(options: DrawOptions, seed: u64, levels: LevelSets, set: DirectionSet) -> Self {
        Self { options, seed, levels, set }
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
        let mut next = 0;
        for i in 0..count {
            // Strata of whole pixels, turned by a random amount so that all are equally likely.
            let first = next;
            next = stratum(i + 1, count, pixels);
            let size = (next - first).max(1);
            let turned = first + stream.below(size as u32) as usize + turn;
            let pixel = if turned < pixels { turned } else { turned - pixels };
            let [class, level, angle]: [f64; 3] = std::array::from_fn(|k| {
                unit(shift[k].wrapping_add((i as u32).wrapping_mul(STRIDES[k])))
            });
            let (set, samples) = self.levels.select(class);
            let taps = self.levels.sets()[set].above(level * self.options.threshold_range);
            let samples = samples.unwrap_or(partition.shape().spp() as u32);
            out.draws.push(self.draw(place, pixel, (set, taps, samples)));
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
        let before = partition.pixels_before(cell);
        let after = before + partition.cell(cell).pixels(frames);
        let turn = (Stream::new(self.seed, Use::Share, step, 0).unit() * all as f64) as u128;
        let upto =
            |pixels: usize| ((self.options.draws as u128 * pixels as u128 + turn) / all) as usize;
        upto(after) - upto(before)
    }

    fn draw(&self, cell: Cell, pixel: usize, (set, taps, samples): (usize, usize, u32)) -> Draw {
        Draw {
            x: (pixel % cell.width) as u32,
            y: (pixel / cell.width % cell.height) as u32,
            t: (pixel / cell.width / cell.height) as u32,
            set: set as u32,
            taps: taps.max(1) as u32,
            samples,
        }
    }

    fn direction(&self, u: f64, stream: &mut Stream) -> Direction {
        let kind = stream.unit();
        let DrawOptions { axis_share, pair_share, .. } = self.options;
        if kind < axis_share {
            self.set.random_axis(u, stream)
        } else if kind < axis_share + pair_share {
            self.set.random_pair(u, stream)
        } else {
            self.set.any(u, stream)
        }
    }
}

/// First of the `pixels` that belong to stratum `i` of `count`.
fn stratum(i: usize, count: usize, pixels: usize) -> usize {
    match i.checked_mul(pixels) {
        Some(product) => product / count,
        None => (i as u128 * pixels as u128 / count as u128) as usize,
    }
}

#[cfg(test)]
mod tests {
    use glam::IVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::domain::Domain;
    use crate::kernel::{KernelTaps, Tap};
    use crate::tile::TileShape;

    const OPTIONS: DrawOptions = DrawOptions {
        draws: 100,
        directions: 1,
        threshold_range: 1.0,
        axis_share: 0.0,
        pair_share: 0.0,
    };

    /// Taps in a row of frames with the given weights.
    fn levels(weights: &[f64]) -> LevelSets {
        let tap =
            |(k, &weight): (usize, &f64)| Tap { offset: IVec3::new(0, 0, -(k as i32)), weight };
        let kernel = KernelTaps::new(weights.iter().enumerate().map(tap)).unwrap();
        LevelSets::new([(1.0, &kernel)])
    }

    fn source(options: DrawOptions, seed: u64, weights: &[f64], dims: usize) -> Draws {
        Draws::new(options, seed, levels(weights), DirectionSet::new(Domain::Square, dims))
    }

    fn partition(width: usize, height: usize, frames: usize) -> Partition {
        let shape = TileShape::new(width, height, frames, 1, 2).unwrap();
        Partition::new(shape, Default::default())
    }

    proptest! {
        #[test]
        fn a_step_has_all_its_draws_evenly_spread(
            width in 1_usize..70, height in 1_usize..50, frames in 1_usize..4,
            draws in 1_usize..2000, directions in 1_usize..4, seed: u64, step: u32,
        ) {
            let partition = partition(width, height, frames);
            let draws = source(DrawOptions { draws, directions, ..OPTIONS }, seed, &[0.5, -0.2], 2);
            let most = draws.most_per_pixel(&partition);
            let mut all = 0;
            let mut out = CellDraws::default();
            for cell in 0..partition.cells() {
                let place = partition.cell(cell);
                draws.cell(&partition, step, cell, &mut out);
                prop_assert_eq!(out.directions.len(), out.draws.len() * directions);
                let mut counts = vec![0_usize; place.pixels(frames)];
                for draw in &out.draws {
                    let (x, y, t) = (draw.x as usize, draw.y as usize, draw.t as usize);
                    prop_assert!(x < place.width && y < place.height && t < frames);
                    prop_assert!(draw.taps == 1 && draw.set < 2);
                    counts[(t * place.height + y) * place.width + x] += 1;
                }
                let per_pixel = out.draws.len().div_ceil(counts.len());
                prop_assert!(counts.iter().all(|&count| count <= per_pixel));
                prop_assert!(per_pixel <= most);
                let share = draws.options().draws as f64 * counts.len() as f64
                    / partition.shape().pixels() as f64;
                prop_assert!((out.draws.len() as f64 - share).abs() < 1.0);
                all += out.draws.len();
            }
            prop_assert_eq!(all, draws.options().draws);
        }

        #[test]
        fn draws_depend_on_seed_step_and_cell_only(seed: u64, step: u32) {
            let partition = partition(40, 40, 2);
            let draws = source(OPTIONS, seed, &[0.5, 0.2, 0.1], 3);
            let of = |draws: &Draws, step: u32, cell: usize| {
                let mut out = CellDraws::default();
                draws.cell(&partition, step, cell, &mut out);
                (out.draws, out.directions)
            };
            let first = of(&draws, step, 1);
            of(&draws, step, 0);
            prop_assert_eq!(&first, &of(&draws, step, 1));
            prop_assert_ne!(&first.0, &of(&draws, step ^ 1, 1).0);
            prop_assert_ne!(&first.0, &of(&source(OPTIONS, seed ^ 1, &[0.5, 0.2, 0.1], 3), step, 1).0);
        }
    }

    /// Expected and found numbers differ by no more than sampling explains.
    fn assert_close(found: f64, expected: f64, label: &str) {
        let deviation = expected.sqrt().max(1.0);
        assert!((found - expected).abs() < 4.5 * deviation, "{label}: {found}, not {expected}");
    }

    #[test]
    fn subsets_have_the_sizes_of_the_level_sets() {
        // Peaks 0.4 and −0.2 share the thresholds 2 : 1; above 0 the levels are 1, 0.75, 0.25.
        let weights = [0.1, 0.4, 0.3, -0.2, -0.05];
        for (range, shares) in
            [(1.0, [0.25, 0.5, 0.25, 0.75, 0.25]), (0.5, [0.0, 0.5, 0.5, 0.5, 0.5])]
        {
            let options = DrawOptions { threshold_range: range, ..OPTIONS };
            let draws = source(options, 5, &weights, 2);
            let partition = partition(20, 20, 5);
            let mut counts = std::collections::BTreeMap::<(u32, u32), f64>::new();
            let mut out = CellDraws::default();
            let steps = 300;
            for step in 0..steps {
                draws.cell(&partition, step, 0, &mut out);
                for draw in &out.draws {
                    *counts.entry((draw.set, draw.taps)).or_default() += 1.0;
                }
            }
            let all = f64::from(steps) * OPTIONS.draws as f64;
            for (i, key) in [(0, 1), (0, 2), (0, 3), (1, 1), (1, 2)].into_iter().enumerate() {
                let of_set = if key.0 == 0 { 2.0 / 3.0 } else { 1.0 / 3.0 };
                let found = counts.remove(&key).unwrap_or(0.0);
                assert_close(found, all * of_set * shares[i], &format!("{range} {key:?}"));
            }
            assert!(counts.is_empty(), "{counts:?}");
        }
    }

    #[test]
    fn every_pixel_is_drawn_equally_often() {
        // Sizes of which neither cells nor strata are whole parts.
        let partition = partition(35, 33, 2);
        let draws = source(OPTIONS, 9, &[1.0], 2);
        let shape = partition.shape();
        let mut counts = vec![0.0_f64; shape.pixels()];
        let mut out = CellDraws::default();
        let steps = 2000;
        for step in 0..steps {
            for cell in 0..partition.cells() {
                let place = partition.cell(cell);
                draws.cell(&partition, step, cell, &mut out);
                for draw in &out.draws {
                    let (x, y) = (place.x + draw.x as usize, place.y + draw.y as usize);
                    counts[shape.pixel(x, y, draw.t as usize)] += 1.0;
                }
            }
        }
        let expected = f64::from(steps) * OPTIONS.draws as f64 / counts.len() as f64;
        let chi: f64 = counts.iter().map(|count| (count - expected).powi(2) / expected).sum();
        // Draws repel each other, so the sum is at most that of independent ones.
        let freedom = counts.len() as f64;
        assert!(chi < freedom + 5.0 * (2.0 * freedom).sqrt(), "{chi} of {freedom}");
        for (pixel, count) in counts.into_iter().enumerate() {
            assert_close(count, expected, &format!("pixel {pixel}"));
        }
    }

    #[test]
    fn directions_have_their_shares() {
        let options = DrawOptions { axis_share: 0.2, pair_share: 0.5, directions: 3, ..OPTIONS };
        let draws = source(options, 2, &[1.0], 4);
        let partition = partition(16, 16, 1);
        let mut counts = [0.0; 5];
        let mut out = CellDraws::default();
        for step in 0..200 {
            draws.cell(&partition, step, 0, &mut out);
            for direction in &out.directions {
                counts[direction.theta.iter().filter(|&&x| x != 0.0).count()] += 1.0;
            }
        }
        let all: f64 = counts.iter().sum();
        assert_eq!(all, 200.0 * 100.0 * 3.0);
        for (axes, share) in [(1, 0.2), (2, 0.5), (4, 0.3)] {
            assert_close(counts[axes], all * share, &format!("{axes} axes"));
        }
    }
}
