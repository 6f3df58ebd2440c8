//! Gathering and scattering: how the samples of a subset come out of a tile and pulls go back.
//!
//! [`InRows`] reads runs of samples where they lie in the tile's rows and adds to the patch of
//! the block; whole registers are moved, and what they hold beyond a run is masked. [`Placed`]
//! works on a copy of what one cell sees in another [`crate::tile::Layout`], pixel by pixel.

use super::runs::Run;
use super::simd::Isa;
use super::to_integer;
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

/// Memory that a subset's samples come from and its pulls go to.
pub trait Memory {
    /// Asks for what a draw will need.
    fn prefetch<I: Isa>(&self, isa: I, place: Place, runs: &[Run]);

    /// Copies the samples of `runs` to `points`, one after the other, each with its dimensions
    /// side by side. `points` has room for a [`CHUNK`] more.
    fn gather(&self, place: Place, runs: &[Run], points: &mut [f32]);

    /// Adds `pulls`, in the order of `points`, to the integer gradient; a [`CHUNK`] more of them
    /// can be read.
    fn scatter(&mut self, place: Place, runs: &[Run], pulls: &[f32]);
}

/// The rows of the tile and the patch of a block, both from the corner of a cell's halo on.
pub struct InRows<'a> {
    /// The tile's rows, and [`crate::tile::SLACK`] behind them.
    pub samples: &'a [f32],
    /// Words from a row of the tile to the next.
    pub stride: usize,
    /// The patch, and slack behind it.
    pub patch: &'a mut [i32],
    /// Words from a row of the patch to the next.
    pub patch_stride: usize,
    /// Frames of the tile.
    pub frames: usize,
    /// Words of a pixel.
    pub pixel: usize,
}

impl InRows<'_> {
    /// First word of a run in the tile and in the patch, and its number of words.
    #[inline(always)]
    fn words(&self, place: Place, run: Run) -> (usize, usize, usize) {
        let Place { x, y, t } = place.at(run, self.frames);
        let (row, column) = (y * self.frames + t, x * self.pixel);
        let words = run.len as usize * self.pixel;
        (row * self.stride + column, row * self.patch_stride + column, words)
    }

    /// Calls `visit(samples, patch, [x, y, t])` for every pixel that the cell sees, a box of
    /// `width × height` and all frames.
    #[inline(always)]
    pub fn visit(
        &mut self,
        [width, height]: [usize; 2],
        mut visit: impl FnMut(&[f32], &mut [i32], [usize; 3]),
    ) {
        for (y, t) in (0..height).flat_map(|y| (0..self.frames).map(move |t| (y, t))) {
            let row = y * self.frames + t;
            for x in 0..width {
                let tile = row * self.stride + x * self.pixel;
                let patch = row * self.patch_stride + x * self.pixel;
                visit(
                    &self.samples[tile..tile + self.pixel],
                    &mut self.patch[patch..patch + self.pixel],
                    [x, y, t],
                );
            }
        }
    }
}

impl Memory for InRows<'_> {
    #[inline(always)]
    fn prefetch<I: Isa>(&self, isa: I, place: Place, runs: &[Run]) {
        for &run in runs {
            let (samples, patch, words) = self.words(place, run);
            let mut k = 0;
            while k < words {
                isa.prefetch(self.samples, samples + k);
                isa.prefetch(self.patch, patch + k);
                k += CHUNK;
            }
            isa.prefetch(self.samples, samples + words - 1);
            isa.prefetch(self.patch, patch + words - 1);
        }
    }

    #[inline(always)]
    fn gather(&self, place: Place, runs: &[Run], points: &mut [f32]) {
        let mut to = 0;
        for &run in runs {
            let (from, _, words) = self.words(place, run);
            let mut k = 0;
            while k < words {
                points[to + k..to + k + CHUNK]
                    .copy_from_slice(&self.samples[from + k..from + k + CHUNK]);
                k += CHUNK;
            }
            to += words;
        }
    }

    #[inline(always)]
    fn scatter(&mut self, place: Place, runs: &[Run], pulls: &[f32]) {
        let mut from = 0;
        for &run in runs {
            let (_, to, words) = self.words(place, run);
            let mut k = 0;
            while k < words {
                let mask = CHUNK - (words - k).min(CHUNK);
                let mask: &[i32; CHUNK] = MASKS[mask..mask + CHUNK].try_into().expect("a chunk");
                let sums = &mut self.patch[to + k..to + k + CHUNK];
                let pulls = &pulls[from + k..from + k + CHUNK];
                for i in 0..CHUNK {
                    sums[i] += to_integer(pulls[i]) & mask[i];
                }
                k += CHUNK;
            }
            from += words;
        }
    }
}

/// What one cell sees, in another layout.
pub struct Placed<'a> {
    /// Where the pixels are.
    pub placement: &'a Placement,
    /// Their samples.
    pub samples: &'a [f32],
    /// The gradient in the same places.
    pub patch: &'a mut [i32],
    /// Words of a pixel.
    pub pixel: usize,
}

impl Placed<'_> {
    /// Calls `visit` with the first word of every pixel of the runs.
    #[inline(always)]
    fn visit(&self, place: Place, runs: &[Run], mut visit: impl FnMut(usize)) {
        let Placement { x, y, t, .. } = self.placement;
        for &run in runs {
            let first = place.at(run, t.len());
            let row = y[first.y] + t[first.t];
            for &column in &x[first.x..first.x + run.len as usize] {
                visit(row + column);
            }
        }
    }
}

impl Memory for Placed<'_> {
    #[inline(always)]
    fn prefetch<I: Isa>(&self, isa: I, place: Place, runs: &[Run]) {
        self.visit(place, runs, |word| {
            isa.prefetch(self.samples, word);
            isa.prefetch(self.patch, word);
        });
    }

    #[inline(always)]
    fn gather(&self, place: Place, runs: &[Run], points: &mut [f32]) {
        let mut to = 0;
        self.visit(place, runs, |word| {
            let pixel = &self.samples[word..word + self.pixel];
            points[to..to + self.pixel].iter_mut().zip(pixel).for_each(|(to, &from)| *to = from);
            to += self.pixel;
        });
    }

    #[inline(always)]
    fn scatter(&mut self, place: Place, runs: &[Run], pulls: &[f32]) {
        let mut from = 0;
        let patch = std::mem::take(&mut self.patch);
        self.visit(place, runs, |word| {
            let pulls = &pulls[from..from + self.pixel];
            let sums = patch[word..word + self.pixel].iter_mut();
            sums.zip(pulls).for_each(|(sum, &pull)| *sum += to_integer(pull));
            from += self.pixel;
        });
        self.patch = patch;
    }
}
