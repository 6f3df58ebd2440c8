//! Dense weights on a box of offsets, and their convolution: how factors become one kernel.
//!
//! Every sum runs in the order of the loops below, so the result is the same on every machine.

use glam::IVec3;

use crate::kernel::taps::Tap;

/// Weights of the offsets from `low` on, in C order (dt, dy, dx).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Grid {
    low: IVec3,
    /// Frames, rows and pixels.
    size: [usize; 3],
    weights: Vec<f64>,
}

/// Along which axis a row of weights lies.
#[derive(Debug, Clone, Copy)]
pub(crate) enum GridAxis {
    X,
    Y,
    Time,
}

impl Grid {
    /// Weights in C order (dt, dy, dx) from offset `low` on.
    ///
    /// # Panics
    /// If their number is not the product of `size`.
    pub(crate) fn new(low: IVec3, size: [usize; 3], weights: Vec<f64>) -> Self {
        assert_eq!(weights.len(), size.iter().product::<usize>(), "weights of a {size:?} grid");
        Self { low, size, weights }.scaled()
    }

    /// A row of weights along one axis, the first of them at offset `low`.
    pub(crate) fn row(axis: GridAxis, low: i32, weights: Vec<f64>) -> Self {
        let n = weights.len();
        let (low, size) = match axis {
            GridAxis::X => (IVec3::new(low, 0, 0), [1, 1, n]),
            GridAxis::Y => (IVec3::new(0, low, 0), [1, n, 1]),
            GridAxis::Time => (IVec3::new(0, 0, low), [n, 1, 1]),
        };
        Self::new(low, size, weights)
    }

    /// The identity of convolution.
    pub(crate) fn one() -> Self {
        Self::row(GridAxis::X, 0, vec![1.0])
    }

    /// Number of weights.
    pub(crate) fn len(&self) -> usize {
        self.weights.len()
    }

    /// Σ|g|.
    pub(crate) fn mass(&self) -> f64 {
        self.weights.iter().map(|w| w.abs()).sum()
    }

    /// Scaled to Σ|g| = 1, so that long products neither overflow nor vanish.
    fn scaled(mut self) -> Self {
        let mass = self.mass();
        if mass > 0.0 {
            self.weights.iter_mut().for_each(|w| *w /= mass);
        }
        self
    }

    /// Frames, rows and pixels of the convolution with `other`.
    pub(crate) fn convolved_size(&self, other: &Self) -> [usize; 3] {
        std::array::from_fn(|axis| self.size[axis] + other.size[axis] - 1)
    }

    /// The convolution of both, scaled to Σ|g| = 1.
    pub(crate) fn convolve(&self, other: &Self) -> Self {
        let size = self.convolved_size(other);
        let mut weights = vec![0.0; size.iter().product()];
        let [frames, height, width] = other.size;
        for (at, &a) in self.offsets().zip(&self.weights) {
            if a == 0.0 {
                continue;
            }
            let [t, y, x] = at;
            for dt in 0..frames {
                for dy in 0..height {
                    let row = &other.weights[(dt * height + dy) * width..][..width];
                    let first = ((t + dt) * size[1] + y + dy) * size[2] + x;
                    for (sum, &b) in weights[first..first + width].iter_mut().zip(row) {
                        *sum += a * b;
                    }
                }
            }
        }
        Self { low: self.low + other.low, size, weights }.scaled()
    }

    /// The part inside the box from `low` to `high`, both included; not scaled.
    pub(crate) fn clip(&self, low: IVec3, high: IVec3) -> Self {
        let last = |axis: usize| self.size[axis] as i32 - 1;
        let top = self.low + IVec3::new(last(2), last(1), last(0));
        let (from, to) = (self.low.max(low), top.min(high));
        let extent =
            |from: i32, to: i32| (to.saturating_sub(from).saturating_add(1)).max(0) as usize;
        let size = [extent(from.z, to.z), extent(from.y, to.y), extent(from.x, to.x)];
        let inside = |at: IVec3| at.cmpge(from).all() && at.cmple(to).all();
        let weights = self.taps().filter(|tap| inside(tap.offset)).map(|tap| tap.weight).collect();
        Self { low: from, size, weights }
    }

    /// Every offset with its weight, in C order.
    pub(crate) fn taps(&self) -> impl Iterator<Item = Tap> + '_ {
        self.offsets().zip(&self.weights).map(|([t, y, x], &weight)| Tap {
            offset: self.low + IVec3::new(x as i32, y as i32, t as i32),
            weight,
        })
    }

    /// Indices (t, y, x) in C order.
    fn offsets(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [frames, height, width] = self.size;
        (0..frames)
            .flat_map(move |t| (0..height).flat_map(move |y| (0..width).map(move |x| [t, y, x])))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn grid() -> impl Strategy<Value = Grid> {
        (1..4_usize, 1..4_usize, 1..4_usize, -5..5_i32, -5..5_i32, -5..5_i32).prop_flat_map(
            |(t, y, x, lx, ly, lt)| {
                prop::collection::vec(0.1..1.0, t * y * x)
                    .prop_map(move |w| Grid::new(IVec3::new(lx, ly, lt), [t, y, x], w))
            },
        )
    }

    fn at(grid: &Grid, offset: IVec3) -> f64 {
        grid.taps().filter(|tap| tap.offset == offset).map(|tap| tap.weight).sum()
    }

    proptest! {
        /// The definition, tap by tap: (a * b)(d) = Σ a(e) b(d − e).
        #[test]
        fn convolution_is_the_sum_over_pairs(a in grid(), b in grid()) {
            let both = a.convolve(&b);
            for tap in both.taps() {
                let sum: f64 = a.taps().map(|p| p.weight * at(&b, tap.offset - p.offset)).sum();
                prop_assert!((tap.weight - sum).abs() < 1e-14);
            }
        }

        /// Every tap is inside or outside the box, and none changes its place.
        #[test]
        fn a_clip_keeps_what_is_inside(a in grid(), b in grid()) {
            let (low, high) = (b.low, b.low + IVec3::new(1, 2, 0));
            let part = a.clip(low, high);
            prop_assert_eq!(part.len(), part.size.iter().product::<usize>());
            for tap in a.taps() {
                let inside = tap.offset.cmpge(low).all() && tap.offset.cmple(high).all();
                prop_assert_eq!(at(&part, tap.offset), if inside { tap.weight } else { 0.0 });
            }
        }
    }
}
