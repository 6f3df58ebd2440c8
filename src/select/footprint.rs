//! The kernel as a visit sees it: what a pixel's candidate does to the perceived error around it.
//!
//! The error at pixel y is Σ g(o) · e(y + o), so the pixel x weighs g(x − y) in the error at y: the
//! kernel turned around. Rows are padded to whole registers with weights of 0.

use glam::IVec3;

use crate::gradient::simd::LANES;
use crate::kernel::KernelTaps;

/// Dense weights of all pixels y that see a pixel x, from the lowest y − x on.
#[derive(Debug, Clone)]
pub(super) struct Footprint {
    /// The lowest y − x, at most 0 along each axis.
    pub low: IVec3,
    /// The highest, at least 0.
    pub high: IVec3,
    /// Rows of a frame.
    pub height: usize,
    /// Registers of a row.
    pub registers: usize,
    /// `[frame][row][register]`.
    weights: Vec<[f32; LANES]>,
}

impl Footprint {
    /// Turns a kernel around whose weights are multiplied by `scale`.
    pub fn new(kernel: &KernelTaps, scale: f64) -> Self {
        let (least, most) = kernel.bounds();
        let (low, high) = ((-most).min(IVec3::ZERO), (-least).max(IVec3::ZERO));
        let size = (high - low + IVec3::ONE).as_usizevec3();
        let registers = size.x.div_ceil(LANES);
        let mut weights = vec![[0.0; LANES]; size.z * size.y * registers];
        for tap in kernel.taps() {
            let place = (-tap.offset - low).as_usizevec3();
            let row = &mut weights[(place.z * size.y + place.y) * registers..][..registers];
            row[place.x / LANES][place.x % LANES] = (tap.weight * scale) as f32;
        }
        Self { low, high, height: size.y, registers, weights }
    }

    /// Frames.
    pub fn frames(&self) -> usize {
        (self.high.z - self.low.z) as usize + 1
    }

    /// Pixels of a row beyond the first, padding included.
    pub fn overhang(&self) -> usize {
        self.registers * LANES - 1
    }

    /// Columns and rows of the margins around a picture: before its first pixel, and behind its
    /// last one but for the padding.
    pub fn margins(&self) -> [usize; 4] {
        [-self.low.x, -self.low.y, self.high.x, self.high.y].map(|side| side as usize)
    }

    /// The weights of a frame, row by row.
    #[inline(always)]
    pub fn frame(&self, frame: usize) -> &[[f32; LANES]] {
        let rows = self.height * self.registers;
        &self.weights[frame * rows..][..rows]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::Tap;

    #[test]
    fn a_pixel_weighs_where_the_kernel_reaches_it() {
        let tap = |x, y, t, weight| Tap { offset: IVec3::new(x, y, t), weight };
        let taps = [tap(0, 0, 0, 5.0), tap(-9, 1, -2, -3.0), tap(2, -1, 0, 2.0)];
        let kernel = KernelTaps::new(taps).unwrap();
        let footprint = Footprint::new(&kernel, 10.0);
        assert_eq!((footprint.low, footprint.high), (IVec3::new(-2, -1, 0), IVec3::new(9, 1, 2)));
        assert_eq!((footprint.frames(), footprint.height, footprint.registers), (3, 3, 2));
        assert_eq!((footprint.overhang(), footprint.margins()), (15, [2, 1, 9, 1]));
        let weight =
            |x: usize, y: usize, t: usize| footprint.frame(t)[y * 2 + x / LANES][x % LANES];
        assert_eq!([weight(2, 1, 0), weight(11, 0, 2), weight(0, 2, 0)], [5.0, -3.0, 2.0]);
        let all: f32 = (0..3).flat_map(|t| footprint.frame(t)).flatten().sum();
        assert_eq!(all, 4.0);
    }
}
