//! Where a density is empty: how a sample that went there comes out again.

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

    /// A point of the unit square, or one next to it that is in a pixel with samples: the nearest of
    /// the pixels around, and where there is none, of the pixel whose middle is nearest.
    #[inline(always)]
    pub(super) fn bring_back(&self, point: [f32; 2]) -> [f32; 2] {
        if self.contains(point) { point } else { self.step_out(point) }
    }

    /// A sample that is where the density is empty goes into the pixel that is nearest, as deep as it
    /// was far away, relative to the pixel: so samples do not gather on a line.
    pub fn enter(&self, point: [f32; 2]) -> [f32; 2] {
        if self.contains(point) {
            return point;
        }
        let border = self.step_out(point);
        let [columns, rows] = &self.ends;
        let [column, row] = [index(border[0], columns.len()), index(border[1], rows.len())];
        let along = |k: usize, [low, high]: [f32; 2]| {
            let (away, size) = (border[k] - point[k], high - low);
            (border[k] + away * (size / (size + away.abs()))).clamp(low, high)
        };
        [along(0, columns[column]), along(1, rows[row])]
    }

    /// Where a sample is after a move: it slides along what is empty, or stays. Brought back to the
    /// border, samples would gather there on one line, which nothing could spread any more.
    #[inline(always)]
    pub(super) fn settle(&self, from: [f32; 2], to: [f32; 2]) -> [f32; 2] {
        if self.contains(to) {
            return to;
        }
        let slides = [[to[0], from[1]], [from[0], to[1]]];
        let is_flat = (to[0] - from[0]).abs() >= (to[1] - from[1]).abs();
        let [first, second] = if is_flat { slides } else { [slides[1], slides[0]] };
        if self.contains(first) {
            first
        } else if self.contains(second) {
            second
        } else {
            from
        }
    }

    /// [`Self::bring_back`] from an empty pixel.
    fn step_out(&self, point: [f32; 2]) -> [f32; 2] {
        let [columns, rows] = &self.ends;
        let (column, row) = (index(point[0], columns.len()), index(point[1], rows.len()));
        let next_to = |pixel: usize| {
            let ([left, right], [top, bottom]) =
                (columns[pixel % self.width], rows[pixel / self.width]);
            [point[0].clamp(left, right), point[1].clamp(top, bottom)]
        };
        let around = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
        let mut best = (f32::INFINITY, point);
        for row in around(row, rows.len()) {
            for column in around(column, columns.len()) {
                let pixel = row * self.width + column;
                if self.nearest[pixel] as usize != pixel {
                    continue;
                }
                let [x, y] = next_to(pixel);
                let (dx, dy) = (x - point[0], y - point[1]);
                let square = dx * dx + dy * dy;
                if square < best.0 {
                    best = (square, [x, y]);
                }
            }
        }
        if best.0.is_finite() {
            return best.1;
        }
        next_to(self.nearest[row * self.width + column] as usize)
    }

    /// How much further than the nearest point that has samples [`Self::bring_back`] may go, from
    /// where a point is after rounding to 8 bits.
    pub(super) fn slack(&self) -> f32 {
        // Rounding leads into a pixel around where pixels are larger than it.
        const SMALL: f32 = 0.005;
        let [columns, rows] = self.ends.each_ref().map(Vec::len);
        (1.0 / columns as f32).hypot(1.0 / rows as f32).min(SMALL)
    }

    /// Bytes that it takes.
    pub(super) fn bytes(&self) -> usize {
        let [columns, rows] = &self.ends;
        size_of_val(&self.nearest[..]) + size_of_val(&columns[..]) + size_of_val(&rows[..])
    }

    /// Whether a point of the unit square is in a pixel that is not empty.
    #[inline(always)]
    pub fn contains(&self, point: [f32; 2]) -> bool {
        let [columns, rows] = &self.ends;
        let pixel = index(point[1], rows.len()) * self.width + index(point[0], columns.len());
        self.nearest[pixel] as usize == pixel
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
    // Along the longer side in two passes, then from the pixel's own line outwards across the shorter
    // one: that has at most a thousand.
    let is_wide = width > height;
    let (long, lines) = if is_wide { (width, height) } else { (height, width) };
    let pixel =
        |line: usize, at: usize| if is_wide { line * width + at } else { at * width + line };
    let mut places = vec![u32::MAX; levels.len()];
    for line in 0..lines {
        let mut pass = |at: usize, last: &mut Option<usize>| {
            if levels[pixel(line, at)] > 0.0 {
                *last = Some(at);
            }
            let (here, before) = (&mut places[pixel(line, at)], last.map(|last| last as u32));
            let away = |other: u32| (at as u32).abs_diff(other);
            if let Some(before) = before
                && (*here == u32::MAX || away(before) < away(*here))
            {
                *here = before;
            }
        };
        let mut last = None;
        (0..long).for_each(|at| pass(at, &mut last));
        let mut last = None;
        (0..long).rev().for_each(|at| pass(at, &mut last));
    }
    let (along, across) = (1.0 / long as f64, 1.0 / lines as f64);
    let mut nearest = vec![0; levels.len()];
    for line in 0..lines {
        for at in 0..long {
            let mut best = (f64::INFINITY, 0);
            for away in 0..lines {
                let far = away as f64 * across;
                if best.0 <= far * far {
                    break;
                }
                let before = line.checked_sub(away);
                let after = (away > 0).then_some(line + away).filter(|&line| line < lines);
                for other in before.into_iter().chain(after) {
                    let found = places[pixel(other, at)];
                    let by = (at as u32).abs_diff(found) as f64 * along;
                    let square = far * far + by * by;
                    if found != u32::MAX && square < best.0 {
                        best = (square, pixel(other, found as usize) as u32);
                    }
                }
            }
            nearest[pixel(line, at)] = best.1;
        }
    }
    nearest
}
