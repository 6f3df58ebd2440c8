//! Where a density is empty: how a sample that went there comes out again.

use std::ops::Range;

/// The pixels of a picture that have samples.
#[derive(Debug)]
pub struct Mask {
    width: usize,
    /// For each axis, the first and the last coordinate in each column or row.
    ends: [Vec<[f32; 2]>; 2],
    /// For each pixel, the nearest one that is not empty: itself, if it is not.
    nearest: Vec<u32>,
}

/// Pictures have one mask, which is compared by being the same.
impl PartialEq for Mask {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}

impl Eq for Mask {}

impl Mask {
    /// Of levels row by row, not all of which are 0.
    pub(super) fn new(width: usize, height: usize, levels: &[f32]) -> Self {
        Self { width, ends: [ends(width), ends(height)], nearest: nearest(width, height, levels) }
    }

    /// A point of the unit square, or the one of the nearest pixel that is not empty that is next to it.
    #[inline(always)]
    pub(super) fn bring_back(&self, point: [f32; 2]) -> [f32; 2] {
        let [columns, rows] = &self.ends;
        let pixel = index(point[1], rows.len()) * self.width + index(point[0], columns.len());
        let nearest = self.nearest[pixel] as usize;
        if nearest == pixel {
            return point;
        }
        let ([left, right], [top, bottom]) =
            (columns[nearest % self.width], rows[nearest / self.width]);
        [point[0].clamp(left, right), point[1].clamp(top, bottom)]
    }

    /// Whether a point of the unit square is in a pixel that is not empty.
    pub fn contains(&self, point: [f32; 2]) -> bool {
        self.bring_back(point) == point
    }
}

/// The column or row, one of `n`, that a coordinate is in. The product has 24 + 20 bits at most, so it
/// is exact.
#[inline(always)]
fn index(x: f32, n: usize) -> usize {
    ((f64::from(x) * n as f64) as usize).min(n - 1)
}

/// The first and the last coordinate in each of `n` columns.
fn ends(n: usize) -> Vec<[f32; 2]> {
    let first = |i: usize| {
        let x = (i as f64 / n as f64) as f32;
        if index(x, n) < i { x.next_up() } else { x }
    };
    (0..n)
        .map(|i| [first(i), if i + 1 < n { first(i + 1).next_down() } else { 1.0_f32.next_down() }])
        .collect()
}

/// For each pixel, the one nearest to it, between their middles, that has a level.
fn nearest(width: usize, height: usize, levels: &[f32]) -> Vec<u32> {
    // In each column the nearest row, then among columns, from the pixel's own outwards.
    let mut rows = vec![u32::MAX; levels.len()];
    for column in 0..width {
        let place = |row: usize| row * width + column;
        let mut pass = |row: usize, last: &mut Option<usize>| {
            if levels[place(row)] > 0.0 {
                *last = Some(row);
            }
            let (here, before) = (&mut rows[place(row)], last.map(|last| last as u32));
            let away = |other: u32| (row as u32).abs_diff(other);
            if let Some(before) = before
                && (*here == u32::MAX || away(before) < away(*here))
            {
                *here = before;
            }
        };
        let mut last = None;
        (0..height).for_each(|row| pass(row, &mut last));
        let mut last = None;
        (0..height).rev().for_each(|row| pass(row, &mut last));
    }
    let (across, down) = (1.0 / width as f64, 1.0 / height as f64);
    let find = |pixel: usize| {
        let (row, column) = (pixel / width, pixel % width);
        let mut best = (f64::INFINITY, pixel as u32);
        let mut look = |columns: Range<usize>| {
            for other in columns {
                let found = rows[row * width + other];
                let dx = other.abs_diff(column) as f64 * across;
                let dy = (row as u32).abs_diff(found) as f64 * down;
                let square = dx * dx + dy * dy;
                if found != u32::MAX && square < best.0 {
                    best = (square, found * width as u32 + other as u32);
                }
            }
            best.0
        };
        for away in 0..width {
            let dx = away as f64 * across;
            let before = column.checked_sub(away).map_or(0..0, |left| left..left + 1);
            let after = if away > 0 && column + away < width {
                column + away..column + away + 1
            } else {
                0..0
            };
            if look(before).min(look(after)) <= dx * dx {
                break;
            }
        }
        best.1
    };
    (0..levels.len()).map(find).collect()
}
