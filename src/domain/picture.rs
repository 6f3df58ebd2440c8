//! A density on the square that is even within each pixel of a picture: what all of a
//! [`Density`](super::Density) is worked out from, exactly.
//!
//! Row 0 of the picture is at y = 0, column 0 at x = 0. Pixels without a level stay empty.

use std::f64::consts::PI;

use super::mask::Mask;
use super::{Cdf, GRID, Shape, Surface, Symmetry};

/// Levels with what is asked of them often.
#[derive(Debug)]
pub(super) struct Picture {
    width: usize,
    height: usize,
    /// Row by row; the largest is 1.
    levels: Vec<f32>,
    /// Sum of all levels.
    sum: f64,
    /// Row by row, the share of what is left of each column in the row, and of the whole row.
    left: Vec<f64>,
    /// The share of all rows above each row, and of all.
    above: Vec<f64>,
    /// The share of all columns left of each column, and of all.
    columns: Vec<f64>,
    /// Where levels change along both axes: column and row of a corner, and by how much.
    corners: Vec<(u32, u32, f64)>,
    mask: Option<Mask>,
    mean: [f64; 2],
    /// Of x and x, y and y, x and y.
    covariance: [f64; 3],
}

impl Picture {
    /// Of levels row by row, which are finite and not negative, and of which the largest is 1.
    pub fn new(width: usize, height: usize, levels: Vec<f32>) -> Self {
        let sum = levels.iter().map(|&level| f64::from(level)).sum::<f64>();
        let mut left = Vec::with_capacity((width + 1) * height);
        let mut above = vec![0.0];
        let mut columns = vec![0.0; width + 1];
        let mut before = 0.0;
        for row in levels.chunks_exact(width) {
            // Sums of levels are nearly exact, where those of shares are not.
            let mut until = 0.0;
            left.push(0.0);
            for (column, &level) in columns[1..].iter_mut().zip(row) {
                *column += f64::from(level);
                until += f64::from(level);
                left.push(until / sum);
            }
            before += until;
            above.push(before / sum);
        }
        let mut until = 0.0;
        for column in &mut columns {
            until += *column;
            *column = until / sum;
        }
        let mask = levels.contains(&0.0).then(|| Mask::new(width, height, &levels));
        let corners = corners(width, &levels);
        let mut picture = Self {
            width,
            height,
            levels,
            sum,
            left,
            above,
            columns,
            corners,
            mask,
            mean: [0.0; 2],
            covariance: [0.0; 3],
        };
        picture.measure();
        picture
    }

    /// Its mean and covariance.
    fn measure(&mut self) {
        let (w, h) = (1.0 / self.width as f64, 1.0 / self.height as f64);
        let place = |i: usize| {
            ((i % self.width) as f64 * w + 0.5 * w, (i / self.width) as f64 * h + 0.5 * h)
        };
        let shares = || self.levels.iter().map(|&level| f64::from(level) / self.sum).enumerate();
        let mut mean = [0.0; 2];
        for (i, share) in shares() {
            let (x, y) = place(i);
            mean[0] += share * x;
            mean[1] += share * y;
        }
        let mut covariance = [w * w / 12.0, h * h / 12.0, 0.0];
        for (i, share) in shares() {
            let (x, y) = (place(i).0 - mean[0], place(i).1 - mean[1]);
            for (sum, product) in covariance.iter_mut().zip([x * x, y * y, x * y]) {
                *sum += share * product;
            }
        }
        (self.mean, self.covariance) = (mean, covariance);
    }

    /// Pixels across and down.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        let shares = [&self.left, &self.above, &self.columns].map(Vec::len);
        let shares = size_of::<f64>() * shares.iter().sum::<usize>();
        let mask = self.mask.as_ref().map_or(0, Mask::bytes);
        size_of_val(&self.levels[..]) + size_of_val(&self.corners[..]) + shares + mask
    }

    /// Row by row; the largest is 1.
    pub fn levels(&self) -> &[f32] {
        &self.levels
    }

    /// For each axis, the share of what is below a coordinate, at even steps from 0 to 1.
    pub fn marginals(&self) -> [&[f64]; 2] {
        [&self.columns, &self.above]
    }

    /// The mean of its points in the unit square.
    pub fn mean_point(&self) -> [f64; 2] {
        self.mean
    }

    /// The share with `a`·x + `b`·y < `offset`, x and y in the unit square.
    fn half_plane(&self, a: f64, b: f64, offset: f64) -> f64 {
        if a < 0.0 {
            return 1.0 - self.half_plane(-a, -b, -offset);
        }
        let (w, h) = (1.0 / self.width as f64, 1.0 / self.height as f64);
        let column = |x: f64| (x * self.width as f64).clamp(0.0, self.width as f64);
        let mut share = 0.0;
        for row in 0..self.height {
            // Where the line enters the row and leaves it; an infinite place where it is flat.
            let (top, bottom) = (b * row as f64 * h, b * (row + 1) as f64 * h);
            let (least, most) = (top.min(bottom), top.max(bottom));
            let crossing =
                |by: f64| if a > 0.0 { (offset - by) / a } else { (offset - by) * f64::INFINITY };
            let full = column(not_nan(crossing(most))).floor() as usize;
            let touched = column(not_nan(crossing(least))).ceil() as usize;
            let left = &self.left[row * (self.width + 1)..][..self.width + 1];
            share += left[full];
            for i in full..touched {
                let mass = left[i + 1] - left[i];
                if mass > 0.0 {
                    share +=
                        mass * sum_below(a * w, b.abs() * h, offset - a * i as f64 * w - least);
                }
            }
        }
        share.clamp(0.0, 1.0)
    }

    /// The share within a distance of a point, both of the unit square.
    fn disk(&self, [x, y]: [f64; 2], radius: f64) -> f64 {
        let (w, h) = (1.0 / self.width as f64, 1.0 / self.height as f64);
        let mut share = 0.0;
        for row in 0..self.height {
            let (top, bottom) = (row as f64 * h - y, (row + 1) as f64 * h - y);
            // The widest and the narrowest chord of the row.
            let near = if top <= 0.0 && bottom >= 0.0 { 0.0 } else { top.abs().min(bottom.abs()) };
            let far = top.abs().max(bottom.abs());
            if near >= radius {
                continue;
            }
            let chord = |away: f64| (radius * radius - away * away).max(0.0).sqrt();
            let column = |x: f64| (x * self.width as f64).clamp(0.0, self.width as f64);
            let (wide, narrow) = (chord(near), if far < radius { chord(far) } else { -1.0 });
            let touched = [column(x - wide).floor() as usize, column(x + wide).ceil() as usize];
            let full = [column(x - narrow).ceil() as usize, column(x + narrow).floor() as usize];
            let full = if full[0] < full[1] { full } else { [touched[1]; 2] };
            let left = &self.left[row * (self.width + 1)..][..self.width + 1];
            share += left[full[1]] - left[full[0]];
            for i in (touched[0]..full[0]).chain(full[1]..touched[1]) {
                let mass = left[i + 1] - left[i];
                if mass > 0.0 {
                    let sides = [i as f64 * w - x, (i + 1) as f64 * w - x];
                    share += mass * disk_in_box(radius, sides, [top, bottom]) / (w * h);
                }
            }
        }
        share.clamp(0.0, 1.0)
    }
}

/// 0 where an infinite place is multiplied by 0.
fn not_nan(x: f64) -> f64 {
    if x.is_nan() { 0.0 } else { x }
}

/// Where levels change along both axes, and by how much: the mixed second differences.
fn corners(width: usize, levels: &[f32]) -> Vec<(u32, u32, f64)> {
    let height = levels.len() / width;
    let level = |column: usize, row: usize| {
        // One pixel further, so that what is before the first is one as well.
        let inside = (1..=width).contains(&column) && (1..=height).contains(&row);
        if inside { f64::from(levels[(row - 1) * width + column - 1]) } else { 0.0 }
    };
    let mut corners = Vec::new();
    for row in 0..=height {
        for column in 0..=width {
            let change =
                level(column + 1, row + 1) - level(column, row + 1) - level(column + 1, row)
                    + level(column, row);
            if change != 0.0 {
                corners.push((column as u32, row as u32, change));
            }
        }
    }
    corners
}

/// The probability that the sum of two uniform numbers, on [0, `a`] and on [0, `b`], is below `t`.
fn sum_below(a: f64, b: f64, t: f64) -> f64 {
    let (a, b) = if a < b { (b, a) } else { (a, b) };
    if t <= 0.0 {
        0.0
    } else if t >= a + b {
        1.0
    } else if t < b {
        t * t / (2.0 * a * b)
    } else if t <= a {
        (t - 0.5 * b) / a
    } else {
        1.0 - (a + b - t) * (a + b - t) / (2.0 * a * b)
    }
}

/// The area that a disk around 0 has in common with a box.
fn disk_in_box(radius: f64, [left, right]: [f64; 2], [top, bottom]: [f64; 2]) -> f64 {
    let quarter = |x: f64, y: f64| disk_in_quarter(radius, x, y);
    let area =
        quarter(right, bottom) - quarter(left, bottom) - quarter(right, top) + quarter(left, top);
    area.max(0.0)
}

/// The area of a disk around 0 that is left of `x` and above `y`.
fn disk_in_quarter(radius: f64, x: f64, y: f64) -> f64 {
    // ∫ √(r² − t²) from −r to x.
    let half = |x: f64| {
        let x = x.clamp(-radius, radius);
        let root = (radius * radius - x * x).max(0.0).sqrt();
        0.5 * (x * root + radius * radius * libm::asin(x / radius)) + 0.25 * PI * radius * radius
    };
    let x = x.clamp(-radius, radius);
    if y >= radius {
        return 2.0 * half(x);
    }
    if y <= -radius {
        return 0.0;
    }
    // Within a distance of the axis, columns end at y; beyond it they are whole or empty.
    let inner = (radius * radius - y * y).max(0.0).sqrt();
    let (from, to) = (x.min(-inner), x.clamp(-inner, inner));
    let cut = half(to) - half(-inner) + y * (to + inner);
    if y <= 0.0 {
        return cut;
    }
    cut + 2.0 * half(from) + 2.0 * (half(x.max(inner)) - half(inner))
}

/// A point of the unit square, centred, and back.
fn from_centred([x, y, _]: [f64; 3]) -> [f64; 2] {
    [x, y].map(|x| 0.5 + 0.5 * x)
}

impl Shape for Picture {
    fn dims(&self) -> usize {
        2
    }

    fn symmetry(&self) -> Symmetry {
        Symmetry::None
    }

    fn surface(&'static self) -> Surface {
        self.mask.as_ref().map_or(Surface::Cube, Surface::Mask)
    }

    fn has_axes(&self) -> bool {
        true
    }

    fn is_warped_by_places(&self) -> bool {
        true
    }

    /// The inverse transform: the row that a share of all rows is in, then the column.
    fn point(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let find = |shares: &[f64], share: f64| {
            // The last that begins below the share, and has some of it.
            let found =
                shares.partition_point(|&before| before <= share).clamp(1, shares.len() - 1) - 1;
            let found =
                (0..=found).rev().find(|&i| shares[i + 1] > shares[i]).unwrap_or_else(|| {
                    shares.windows(2).position(|ends| ends[1] > ends[0]).unwrap_or_default()
                });
            let inside = (share - shares[found]) / (shares[found + 1] - shares[found]);
            (found, inside.clamp(0.0, 1.0))
        };
        let (row, down) = find(&self.above, v);
        let left = &self.left[row * (self.width + 1)..][..self.width + 1];
        let (column, along) = find(left, u * left[self.width]);
        let place = |i: usize, inside: f64, n: usize| 2.0 * (i as f64 + inside) / n as f64 - 1.0;
        [place(column, along, self.width), place(row, down, self.height), 0.0]
    }

    fn place(&self, point: [f64; 3]) -> [f64; 2] {
        let [x, y] = from_centred(point);
        let cell = |x: f64, n: usize| {
            let at = (x * n as f64).clamp(0.0, n as f64);
            let i = (at as usize).min(n - 1);
            (i, at - i as f64)
        };
        let ((column, along), (row, down)) = (cell(x, self.width), cell(y, self.height));
        let share = |shares: &[f64], i: usize, inside: f64| {
            shares[i] + inside * (shares[i + 1] - shares[i])
        };
        let left = &self.left[row * (self.width + 1)..][..self.width + 1];
        let whole = left[self.width];
        let u = if whole > 0.0 { share(left, column, along) / whole } else { 0.5 };
        [u, share(&self.above, row, down)].map(|share| share.clamp(0.0, 1.0))
    }

    fn below(&self, [a, b, _]: [f64; 3], t: f64) -> f64 {
        self.half_plane(a, b, 0.5 * (t + a + b))
    }

    fn within(&self, centre: [f64; 3], distance: f64) -> f64 {
        if distance <= 0.0 { 0.0 } else { self.disk(from_centred(centre), 0.5 * distance) }
    }

    /// A Gaussian is a product of one along x and one along y, and so is its integral over a pixel.
    fn gaussian(&self, centre: [f64; 3], sigma: f64) -> f64 {
        let [x, y] = from_centred(centre);
        let scale = 1.0 / (0.5 * sigma * std::f64::consts::SQRT_2);
        let means = |centre: f64, n: usize| -> Vec<f64> {
            let at = |i: usize| libm::erf((i as f64 / n as f64 - centre) * scale);
            let height = 0.5 * PI.sqrt() / scale * n as f64;
            (0..n).map(|i| height * (at(i + 1) - at(i))).collect()
        };
        let (across, down) = (means(x, self.width), means(y, self.height));
        let row = |levels: &[f32]| -> f64 {
            levels.iter().zip(&across).map(|(&level, mean)| f64::from(level) * mean).sum()
        };
        let rows = self.levels.chunks_exact(self.width).zip(&down);
        rows.map(|(levels, mean)| row(levels) * mean).sum::<f64>() / self.sum
    }

    /// The distribution on a direction is a sum over corners of quadratic pieces, each of which begins
    /// where its corner is: all of them are added up in one go along the grid.
    fn cdf(&self, [a, b, _]: [f64; 3]) -> Cdf {
        /// Along directions that are closer to an axis, the pieces nearly cancel.
        const LEAST: f64 = 1e-3;
        let length = a.abs() + b.abs();
        let low = -0.5 * length;
        if a == 0.0 || b == 0.0 {
            let shares = if b == 0.0 { &self.columns } else { &self.above };
            let below = |x: f64| {
                let at = (x * (shares.len() - 1) as f64).clamp(0.0, (shares.len() - 1) as f64);
                let node = (at as usize).min(shares.len() - 2);
                shares[node] + (shares[node + 1] - shares[node]) * (at - node as f64)
            };
            return Cdf::new(low, length, |t| {
                let x = t / length + 0.5;
                if a + b > 0.0 { below(x) } else { 1.0 - below(1.0 - x) }
            });
        }
        if a.abs().min(b.abs()) < LEAST * length {
            return Cdf::new(low, length, |t| self.half_plane(a, b, t + 0.5 * (a + b)));
        }
        let (across, down) = (a / self.width as f64, b / self.height as f64);
        let step = length / GRID as f64;
        // At a node, what begins before it: value, slope and curvature.
        let mut begins = vec![[0.0; 3]; GRID + 2];
        for &(column, row, change) in &self.corners {
            let at = f64::from(column) * across + f64::from(row) * down - 0.5 * (a + b);
            let node = ((at - low) / step).ceil().clamp(0.0, (GRID + 1) as f64) as usize;
            let past = low + node as f64 * step - at;
            begins[node][0] += 0.5 * change * past * past;
            begins[node][1] += change * past;
            begins[node][2] += change;
        }
        let scale = 1.0 / (self.sum * across * down);
        let mut sums = [0.0; 3];
        let mut last = 0.0_f64;
        let mut next = begins.into_iter();
        Cdf::new(low, length, |_| {
            let begins = next.next().unwrap_or_default();
            sums[0] += step * (sums[1] + 0.5 * step * sums[2]) + begins[0];
            sums[1] += step * sums[2] + begins[1];
            sums[2] += begins[2];
            last = (sums[0] * scale).clamp(last, 1.0);
            last
        })
    }

    fn mean(&self) -> [f64; 3] {
        [2.0 * self.mean[0] - 1.0, 2.0 * self.mean[1] - 1.0, 0.0]
    }

    fn variances(&self) -> [f64; 3] {
        [4.0 * self.covariance[0], 4.0 * self.covariance[1], 0.0]
    }

    fn variance(&self, [a, b, _]: [f64; 3]) -> f64 {
        let [xx, yy, xy] = self.covariance;
        4.0 * (a * a * xx + b * b * yy + 2.0 * a * b * xy).max(0.0)
    }

    /// Relative to the even square.
    fn spread(&self) -> f64 {
        (6.0 * (self.covariance[0] + self.covariance[1])).sqrt()
    }
}
