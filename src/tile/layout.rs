//! Orders in which the pixels around a cell can lie in memory, to compare with rows.
//!
//! All of them are sums of one number for each axis, so a table for each axis places any pixel.

use std::fmt;

/// An order of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Layout {
    /// Rows of pixels, `(y, t, x)`: the samples of a draw lie in few runs, which are read where
    /// they are.
    Rows,
    /// Boxes as large as a cache line, 2 pixels high and as wide as fits; the boxes in the order
    /// `(y, t, x)`.
    Bricks,
    /// Along a Z-order (Morton) curve through x, y and t.
    Curve,
}

impl Layout {
    /// All layouts.
    pub const ALL: [Self; 3] = [Self::Rows, Self::Bricks, Self::Curve];

    /// Its name: `rows`, `bricks` or `curve`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rows => "rows",
            Self::Bricks => "bricks",
            Self::Curve => "curve",
        }
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Bytes of a cache line on all machines that matter here.
pub const LINE: usize = 64;

/// Where the pixels of a box of `width × height × frames` lie.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    /// First word of pixel `(x, y, t)`: the sum of one entry of each.
    pub x: Vec<usize>,
    /// See `x`.
    pub y: Vec<usize>,
    /// See `x`.
    pub t: Vec<usize>,
    /// Words of the memory, which may have gaps.
    pub words: usize,
}

impl Placement {
    /// Places pixels of `pixel` words each.
    pub fn new(layout: Layout, [width, height, frames]: [usize; 3], pixel: usize) -> Self {
        let axis = |size: usize, place: &dyn Fn(usize) -> usize| -> Vec<usize> {
            (0..size).map(|i| place(i) * pixel).collect()
        };
        let (x, y, t) = match layout {
            Layout::Rows => (
                axis(width, &|x| x),
                axis(height, &|y| y * frames * width),
                axis(frames, &|t| t * width),
            ),
            Layout::Bricks => {
                let brick = (LINE / size_of::<f32>() / pixel / 2).max(1);
                let bricks = width.div_ceil(brick);
                (
                    axis(width, &|x| x / brick * brick * 2 + x % brick),
                    axis(height, &|y| y / 2 * frames * bricks * brick * 2 + y % 2 * brick),
                    axis(frames, &|t| t * bricks * brick * 2),
                )
            }
            Layout::Curve => {
                let curve = Curve::new([width, height, frames]);
                (
                    axis(width, &|x| curve.place(0, x)),
                    axis(height, &|y| curve.place(1, y)),
                    axis(frames, &|t| curve.place(2, t)),
                )
            }
        };
        let last = [&x, &y, &t].into_iter().map(|axis| axis.last().copied().unwrap_or(0));
        let words = last.sum::<usize>() + pixel;
        Self { x, y, t, words }
    }

    /// First word of a pixel.
    pub fn word(&self, x: usize, y: usize, t: usize) -> usize {
        self.x[x] + self.y[y] + self.t[t]
    }
}

/// Interleaved bits of three axes, as many of each as it needs.
struct Curve {
    /// For each axis, which bit of the place each of its bits becomes.
    bits: [Vec<u32>; 3],
}

impl Curve {
    fn new(sizes: [usize; 3]) -> Self {
        let needed = sizes.map(|size| usize::BITS - (size - 1).leading_zeros());
        let mut bits: [Vec<u32>; 3] = Default::default();
        let mut next = 0;
        for level in 0..needed.into_iter().max().unwrap_or(0) {
            for axis in 0..3 {
                if level < needed[axis] {
                    bits[axis].push(next);
                    next += 1;
                }
            }
        }
        Self { bits }
    }

    fn place(&self, axis: usize, i: usize) -> usize {
        self.bits[axis].iter().enumerate().map(|(from, &to)| (i >> from & 1) << to).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_pixel_has_words_of_its_own(
            sizes in [1_usize..30, 1_usize..20, 1_usize..9], pixel in 1_usize..40,
        ) {
            for layout in Layout::ALL {
                let placement = Placement::new(layout, sizes, pixel);
                let mut taken = vec![false; placement.words];
                let [width, height, frames] = sizes;
                for (x, y, t) in (0..width).flat_map(|x| {
                    (0..height).flat_map(move |y| (0..frames).map(move |t| (x, y, t)))
                }) {
                    let first = placement.word(x, y, t);
                    for word in &mut taken[first..first + pixel] {
                        prop_assert!(!std::mem::replace(word, true), "{layout} {x} {y} {t}");
                    }
                }
            }
        }
    }

    #[test]
    fn bricks_and_curves_are_near_in_memory_where_they_are_near_in_the_tile() {
        // Two words a pixel: a line holds 4 x 2 of them.
        let bricks = Placement::new(Layout::Bricks, [22, 22, 30], 2);
        let line = |x, y, t| bricks.word(x, y, t) * size_of::<f32>() / LINE;
        assert_eq!(line(4, 6, 3), line(7, 7, 3));
        assert_ne!(line(4, 6, 3), line(8, 6, 3));
        assert_ne!(line(4, 6, 3), line(4, 8, 3));
        let curve = Placement::new(Layout::Curve, [16, 16, 16], 1);
        assert_eq!(curve.word(0, 0, 0), 0);
        assert_eq!(curve.word(1, 1, 1), 7);
        assert_eq!(curve.word(15, 15, 15), 4095);
    }
}
