//! Gathering and scattering: how the samples of a subset come out of a tile and gradients go back.
//!
//! The runs of a subset are located once, in the tile's rows and the patch of the block, or in a
//! copy of what one cell sees in another [`crate::tile::Layout`], pixel by pixel. Whole registers
//! are moved, and what they hold beyond a run is masked.

use super::runs::Run;
use super::simd::Isa;
use crate::tile::Placement;

/// Words that are moved at a time.
pub const CHUNK: usize = 16;

/// All bits for the first words of a chunk, none for the rest: `MASKS[CHUNK - n..]` keeps n.
const MASKS: [i32; 2 * CHUNK] = {
    let mut masks = [0; 2 * CHUNK];
    let mut i = 0;
    while i < CHUNK {
        masks[i] = -1;
        i += 1;
    }
    masks
};

/// A draw's pixel in what its cell sees, which begins with the halo.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Frame.
    pub t: usize,
}

impl Place {
    /// The first pixel of a run, around the torus in time.
    #[inline(always)]
    fn at(self, run: Run, frames: usize) -> Self {
        let frame = self.t as i32 + run.dt;
        let wrap = if frame < 0 {
            frames as i32
        } else if frame >= frames as i32 {
            -(frames as i32)
        } else {
            0
        };
        Self {
            x: self.x.wrapping_add_signed(run.dx as isize),
            y: self.y.wrapping_add_signed(run.dy as isize),
            t: (frame + wrap) as usize,
        }
    }
}

/// Where a run of words is in the samples and in the patch.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    samples: usize,
    patch: usize,
    words: usize,
}

/// Samples and their gradient, both from the corner of a cell's halo on, with a [`CHUNK`] of
/// slack behind them.
pub struct Memory<'a> {
    /// The samples.
    pub samples: &'a [f32],
    /// Their integer gradient.
    pub patch: &'a mut [i32],
    /// Words of a pixel.
    pub pixel: usize,
    /// How both lie.
    pub order: Order<'a>,
}

/// How samples and their gradient lie.
#[derive(Debug, Clone, Copy)]
pub enum Order<'a> {
    /// In rows, with so many words from one to the next.
    Rows {
        /// Of the samples.
        samples: usize,
        /// Of the patch.
        patch: usize,
        /// Frames of the tile.
        frames: usize,
    },
    /// Both as a placement says.
    Placed(&'a Placement),
}

impl Memory<'_> {
    /// Finds the runs of a draw of which each pixel's first `used` words are seen, and asks for
    /// what will be needed of them.
    #[inline(always)]
    pub fn locate<I: Isa>(
        &self,
        isa: I,
        place: Place,
        runs: &[Run],
        used: usize,
        spots: &mut Vec<Spot>,
    ) {
        spots.clear();
        match self.order {
            Order::Rows { samples, patch, frames } => {
                for &run in runs {
                    let Place { x, y, t } = place.at(run, frames);
                    let (row, column) = (y * frames + t, x * self.pixel);
                    let words = run.len as usize * self.pixel;
                    let (samples, patch) = (row * samples + column, row * patch + column);
                    // A whole run is one piece of memory; of a part of each pixel, every pixel is.
                    let piece = if used == self.pixel { words } else { used };
                    for from in (0..words).step_by(self.pixel.max(piece)) {
                        let (samples, patch) = (samples + from, patch + from);
                        spots.push(Spot { samples, patch, words: piece });
                        self.prefetch(isa, samples, patch, piece);
                    }
                }
            }
            Order::Placed(Placement { x, y, t, .. }) => {
                for &run in runs {
                    let first = place.at(run, t.len());
                    let row = y[first.y] + t[first.t];
                    for &column in &x[first.x..first.x + run.len as usize] {
                        let word = row + column;
                        spots.push(Spot { samples: word, patch: word, words: used });
                        self.prefetch(isa, word, word, used);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, isa: I, samples: usize, patch: usize, words: usize) {
        let mut k = 0;
        while k < words {
            isa.prefetch(self.samples, samples + k);
            isa.prefetch(self.patch, patch + k);
            k += CHUNK;
        }
        isa.prefetch(self.samples, samples + words - 1);
        isa.prefetch(self.patch, patch + words - 1);
    }

    /// Copies the samples of a draw to `points`, one after the other, each with its dimensions
    /// side by side. `points` has room for a [`CHUNK`] more.
    #[inline(always)]
    pub fn gather(&self, spots: &[Spot], points: &mut [f32]) {
        let mut to = 0;
        for &Spot { samples, words, .. } in spots {
            let mut k = 0;
            while k < words {
                points[to + k..to + k + CHUNK]
                    .copy_from_slice(&self.samples[samples + k..samples + k + CHUNK]);
                k += CHUNK;
            }
            to += words;
        }
    }

    /// Adds `gradients`, in the order of `points`, to the integer gradient; a [`CHUNK`] more of them
    /// can be read.
    #[inline(always)]
    pub fn scatter(&mut self, spots: &[Spot], gradients: &[f32]) {
        let mut from = 0;
        for &Spot { patch, words, .. } in spots {
            let mut k = 0;
            while k < words {
                let mask = CHUNK - (words - k).min(CHUNK);
                let mask: &[i32; CHUNK] = MASKS[mask..mask + CHUNK].try_into().expect("a chunk");
                let sums = &mut self.patch[patch + k..patch + k + CHUNK];
                let gradients = &gradients[from + k..from + k + CHUNK];
                for i in 0..CHUNK {
                    sums[i] += to_integer(gradients[i]) & mask[i];
                }
                k += CHUNK;
            }
            from += words;
        }
    }
}

/// The nearest integer (ties to even) of a number of magnitude below 2²².
#[inline(always)]
fn to_integer(x: f32) -> i32 {
    // Adding 1.5·2²³ leaves the integer in the low bits of the significand.
    const MAGIC: f32 = 12_582_912.0;
    (x + MAGIC).to_bits() as i32 - MAGIC.to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rounding_is_to_nearest_even(x in -4_194_303.0_f32..4_194_303.0, halves in -4000_i32..4000) {
            prop_assert_eq!(to_integer(x), x.round_ties_even() as i32);
            let half = halves as f32 * 0.5;
            prop_assert_eq!(to_integer(half), half.round_ties_even() as i32);
        }
    }
}
