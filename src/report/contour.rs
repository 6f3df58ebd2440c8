//! Lines of one level on a grid of values, by marching squares.
//!
//! A line ends where it leaves the grid, so that the border itself is never drawn; generators of
//! filled contours close their rings along it.

use std::collections::HashMap;

/// A point in units of the grid: column and row.
type Point = [f64; 2];

/// The edge from a grid point to its right (false) or lower (true) neighbour.
type Edge = (usize, usize, bool);

/// The lines along which `values`, row by row in so many `columns`, are at `level`. Between grid
/// points values are taken as linear. A closed line ends with its first point.
pub(super) fn contours(values: &[f64], columns: usize, level: f64) -> Vec<Vec<Point>> {
    let rows = values.len() / columns.max(1);
    let at = |x: usize, y: usize| values[y * columns + x] - level;
    let point = |(x, y, down): Edge| -> Point {
        let (a, b) = (at(x, y), if down { at(x, y + 1) } else { at(x + 1, y) });
        let part = a / (a - b);
        if down { [x as f64, y as f64 + part] } else { [x as f64 + part, y as f64] }
    };
    let mut segments: Vec<[Edge; 2]> = Vec::new();
    for y in 0..rows.saturating_sub(1) {
        for x in 0..columns.saturating_sub(1) {
            let corners = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            let edges = [(x, y, false), (x + 1, y, true), (x, y + 1, false), (x, y, true)];
            let inside = corners.map(|value| value >= 0.0);
            // Edge i lies between corners i and i + 1.
            let cut: Vec<usize> = (0..4).filter(|&i| inside[i] != inside[(i + 1) % 4]).collect();
            match cut[..] {
                [a, b] => segments.push([edges[a], edges[b]]),
                [_, _, _, _] => {
                    // A saddle: the middle says which corners belong together.
                    let middle = corners.iter().sum::<f64>() >= 0.0;
                    let first = if middle == inside[0] { 0 } else { 3 };
                    segments.push([edges[first], edges[(first + 1) % 4]]);
                    segments.push([edges[(first + 2) % 4], edges[(first + 3) % 4]]);
                }
                _ => {}
            }
        }
    }
    let mut meeting: HashMap<Edge, Vec<usize>> = HashMap::new();
    for (i, segment) in segments.iter().enumerate() {
        segment.iter().for_each(|&edge| meeting.entry(edge).or_default().push(i));
    }
    let mut used = vec![false; segments.len()];
    let mut lines = Vec::new();
    // Open lines from one of their ends, then the closed ones from anywhere.
    for open in [true, false] {
        for first in 0..segments.len() {
            for start in segments[first] {
                if used[first] || (open && meeting[&start].len() > 1) {
                    continue;
                }
                let mut line = vec![point(start)];
                let (mut segment, mut edge) = (first, start);
                loop {
                    used[segment] = true;
                    let [a, b] = segments[segment];
                    edge = if edge == a { b } else { a };
                    line.push(point(edge));
                    match meeting[&edge].iter().find(|&&next| !used[next]) {
                        Some(&next) => segment = next,
                        None => break,
                    }
                }
                lines.push(line);
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn grid(columns: usize, rows: usize, value: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        let points = (0..rows).flat_map(|y| (0..columns).map(move |x| (x as f64, y as f64)));
        points.map(|(x, y)| value(x, y)).collect()
    }

    #[test]
    fn the_contour_of_a_cone_is_a_circle() {
        let values = grid(61, 61, |x, y| -(x - 30.0).hypot(y - 30.0));
        let lines = contours(&values, 61, -20.0);
        let [circle] = &lines[..] else { panic!("{} lines", lines.len()) };
        assert!(circle.len() > 100);
        assert_eq!(circle.first(), circle.last());
        for [x, y] in circle {
            assert!(((x - 30.0).hypot(y - 30.0) - 20.0).abs() < 0.02, "{x} {y}");
        }
        let length: f64 =
            circle.windows(2).map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1])).sum();
        assert!((length / (std::f64::consts::TAU * 20.0) - 1.0).abs() < 1e-3, "{length}");
    }

    #[test]
    fn lines_end_at_the_border_and_never_run_along_it() {
        let values = grid(10, 6, |x, _| x);
        let lines = contours(&values, 10, 4.25);
        let [line] = &lines[..] else { panic!("{} lines", lines.len()) };
        assert!(line.iter().all(|[x, _]| *x == 4.25));
        let mut ends = [line[0][1], line[line.len() - 1][1]];
        ends.sort_by(f64::total_cmp);
        assert_eq!(ends, [0.0, 5.0]);
        assert!(contours(&values, 10, -1.0).is_empty() && contours(&values, 10, 10.0).is_empty());
        assert!(contours(&[1.0], 1, 0.5).is_empty() && contours(&[], 0, 0.5).is_empty());
    }

    #[test]
    fn a_saddle_keeps_apart_what_its_middle_keeps_apart() {
        // High corners upper left and lower right.
        for (high, joined) in [(3.0, true), (1.5, false)] {
            let lines = contours(&[high, 0.0, 0.0, high], 2, 1.0);
            assert_eq!(lines.len(), 2);
            for line in lines {
                // Lines around the low corners when the high ones are joined, and the reverse.
                let middle = [0, 1].map(|axis| (line[0][axis] + line[1][axis]) / 2.0);
                let low_side = (middle[0] > 0.5) != (middle[1] > 0.5);
                assert_eq!(low_side, joined, "{high}: {line:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn every_crossing_of_an_edge_is_on_one_line(
            values in prop::collection::vec(-1.0..1.0, 42), columns in 2_usize..8,
        ) {
            let rows = values.len() / columns;
            let values = &values[..rows * columns];
            let mut crossings = 0;
            for y in 0..rows {
                for x in 0..columns {
                    let inside = |x: usize, y: usize| values[y * columns + x] >= 0.0;
                    crossings += usize::from(x + 1 < columns && inside(x, y) != inside(x + 1, y));
                    crossings += usize::from(y + 1 < rows && inside(x, y) != inside(x, y + 1));
                }
            }
            let points: usize = contours(values, columns, 0.0)
                .iter()
                .map(|line| line.len() - usize::from(line.first() == line.last()))
                .sum();
            prop_assert_eq!(points, crossings);
        }
    }
}
