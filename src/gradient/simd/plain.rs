//! The instruction set that every machine has: the plain twin of the others.

use super::{Isa, SORT_BLOCK, check_places};

/// No instructions but those that the program was compiled for.
#[derive(Debug, Clone, Copy)]
pub struct Plain;

impl Isa for Plain {
    #[inline(always)]
    fn sort(self, keys: &mut [u32]) {
        assert!(keys.len().is_multiple_of(SORT_BLOCK));
        keys.sort_unstable();
    }

    #[inline(always)]
    fn split(self, points: &[f32], planes: &mut [f32], n: usize, dims: usize) {
        for k in 0..dims {
            let plane = &mut planes[k * n..(k + 1) * n];
            for (i, x) in plane.iter_mut().enumerate() {
                *x = points[i * dims + k];
            }
        }
    }

    #[inline(always)]
    fn join(self, planes: &[f32], points: &mut [f32], n: usize, dims: usize) {
        for k in 0..dims {
            for (i, &x) in planes[k * n..(k + 1) * n].iter().enumerate() {
                points[i * dims + k] = x;
            }
        }
    }

    #[inline(always)]
    fn interpolate(self, table: &[f64], step: f64, out: &mut [f64]) {
        check_places(table.len(), step, out.len());
        for (i, value) in out.iter_mut().enumerate() {
            let place = i as f64 * step;
            let node = (place as usize).min(table.len() - 2);
            *value = table[node] + (table[node + 1] - table[node]) * (place - node as f64);
        }
    }

    #[inline(always)]
    fn prefetch<T>(self, _: &[T], _: usize) {}
}
