//! How evenly a whole tile covers the cube, beside what the eye sees of it.
//!
//! An arrangement that hides the error of every frame can still leave parts of the cube
//! under-filled, a bias that no averaging removes; and a pixel's samples over all frames can
//! average to something else than the cube's centre, which stays when a still picture accumulates.

use serde::{Deserialize, Serialize};

use crate::domain::Domain;
use crate::tile::Tile;

/// Cells per side of the histograms.
const SIDE: usize = 16;

/// How the samples of a tile fill a 16×16 grid over two dimensions (a row of 16 cells if the tile
/// has only one), each cell relative to its expected share: 1 is perfect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    /// The emptiest cell.
    pub smallest: f64,
    /// The fullest cell.
    pub largest: f64,
    /// Root of the mean squared deviation from 1.
    pub rms: f64,
}

/// How the samples fill the cells over one pair of dimensions.
#[derive(Debug, Clone, PartialEq)]
pub struct PairHistogram {
    /// The first dimension runs across, the second down; both are 0 where there is only one.
    pub dims: (usize, usize),
    /// Cells across and down, equally many; only one row for a single dimension.
    pub rows: usize,
    /// Share of each of the `16 · rows` cells relative to the expected one, row by row.
    pub shares: Vec<f64>,
}

impl PairHistogram {
    /// The figures of this pair.
    pub fn figures(&self) -> Histogram {
        figures(&self.shares)
    }
}

/// Extremes and rms of cells whose expected share is 1.
fn figures<'a>(shares: impl IntoIterator<Item = &'a f64>) -> Histogram {
    let (mut smallest, mut largest, mut square, mut count) = (f64::INFINITY, 0.0_f64, 0.0, 0.0);
    for &share in shares {
        smallest = smallest.min(share);
        largest = largest.max(share);
        square += (share - 1.0) * (share - 1.0);
        count += 1.0;
    }
    Histogram { smallest, largest, rms: (square / count).sqrt() }
}

/// The histogram figures over all pairs of dimensions: extremes of all, rms over all.
pub fn histogram(tile: &Tile) -> Histogram {
    figures(pair_histograms(tile).iter().flat_map(|pair| &pair.shares))
}

/// The histograms of all pairs of dimensions, or that of the only dimension.
pub fn pair_histograms(tile: &Tile) -> Vec<PairHistogram> {
    let dims = tile.shape().dims();
    let cell = |x: f32| ((x * SIDE as f32) as usize).min(SIDE - 1);
    let (pairs, rows): (Vec<(usize, usize)>, usize) = if dims == 1 {
        (vec![(0, 0)], 1)
    } else {
        ((0..dims).flat_map(|j| (0..j).map(move |i| (i, j))).collect(), SIDE)
    };
    // One pass over the samples for all pairs.
    let mut counts = vec![[[0_u32; SIDE]; SIDE]; pairs.len()];
    let mut cells = vec![0; dims];
    for point in tile.samples().chunks_exact(dims) {
        cells.iter_mut().zip(point).for_each(|(c, &x)| *c = cell(x));
        for (count, &(i, j)) in counts.iter_mut().zip(&pairs) {
            count[if rows == 1 { 0 } else { cells[j] }][cells[i]] += 1;
        }
    }
    let expected = tile.shape().samples() as f64 / (SIDE * rows) as f64;
    let share = |&count: &u32| f64::from(count) / expected;
    pairs
        .into_iter()
        .zip(&counts)
        .map(|(dims, count)| PairHistogram {
            dims,
            rows,
            shares: count[..rows].iter().flatten().map(share).collect(),
        })
        .collect()
}

/// For each dimension, how its coordinates fill `bins` equal intervals, relative to the expected
/// share.
///
/// # Panics
/// If there are no bins.
pub fn marginals(tile: &Tile, bins: usize) -> Vec<Vec<f64>> {
    let dims = tile.shape().dims();
    let mut counts = vec![vec![0_u64; bins]; dims];
    for point in tile.samples().chunks_exact(dims) {
        for (count, &x) in counts.iter_mut().zip(point) {
            count[((x * bins as f32) as usize).min(bins - 1)] += 1;
        }
    }
    let expected = tile.shape().samples() as f64 / bins as f64;
    counts
        .iter()
        .map(|count| count.iter().map(|&count| count as f64 / expected).collect())
        .collect()
}

/// Per dimension: rms over the pixels of (mean over all frames and samples − that of the domain, ½ for
/// the square), relative to that of independent samples, √(variance / (frames · spp)), with a variance
/// of 1/12 for the square.
pub fn residual(domain: Domain, tile: &Tile) -> Vec<f64> {
    let shape = tile.shape();
    let (dims, spp) = (shape.dims(), shape.spp());
    let per_frame = shape.width() * shape.height();
    let moments = domain.moments(dims);
    let mut sums = vec![0.0_f64; per_frame * dims];
    for frame in tile.samples().chunks_exact(per_frame * spp * dims) {
        for (pixel, sums) in frame.chunks_exact(spp * dims).zip(sums.chunks_exact_mut(dims)) {
            for point in pixel.chunks_exact(dims) {
                let sums = sums.iter_mut().zip(point).zip(&moments);
                sums.for_each(|((sum, &x), (mean, _))| *sum += f64::from(x) - mean);
            }
        }
    }
    let samples = (shape.frames() * spp) as f64;
    (0..dims)
        .map(|dim| {
            let square: f64 = sums.iter().skip(dim).step_by(dims).map(|sum| sum * sum).sum();
            (square / per_frame as f64 / (samples * moments[dim].1)).sqrt()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::baseline::Baseline;
    use super::*;
    use crate::tile::TileShape;

    #[test]
    fn a_grid_is_even_and_a_hole_shows() {
        // 256 samples, one in each cell; then one moves into its neighbour's.
        let shape = TileShape::new(16, 16, 1, 1, 2).unwrap();
        let mut samples: Vec<f32> = (0..256)
            .flat_map(|i| [(i % 16) as f32 / 16.0, (i / 16) as f32 / 16.0 + 0.06])
            .collect();
        let even = histogram(&Tile::new(shape, samples.clone()).unwrap());
        assert_eq!(even, Histogram { smallest: 1.0, largest: 1.0, rms: 0.0 });
        samples[0] += 1.0 / 16.0;
        let hole = histogram(&Tile::new(shape, samples).unwrap());
        let rms = (2.0_f64 / 256.0).sqrt();
        assert_eq!(hole, Histogram { smallest: 0.0, largest: 2.0, rms });
    }

    #[test]
    fn every_pair_of_dimensions_counts() {
        // Dimensions 0 and 1 are stratified together, 2 repeats 1: only that pair is uneven.
        let shape = TileShape::new(16, 16, 1, 1, 3).unwrap();
        let samples = (0..256)
            .flat_map(|i| [i % 16, i / 16, i / 16].map(|cell| (cell as f32 + 0.5) / 16.0))
            .collect();
        let found = histogram(&Tile::new(shape, samples).unwrap());
        assert_eq!((found.smallest, found.largest), (0.0, 16.0));
        // In that pair 16 cells have 16 times their share, 240 nothing; two pairs are perfect.
        assert!((found.rms - 5.0_f64.sqrt()).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn one_dimension_has_sixteen_cells() {
        let shape = TileShape::new(32, 1, 1, 1, 1).unwrap();
        let samples = (0..32).map(|i| i as f32 / 32.0).collect();
        let found = histogram(&Tile::new(shape, samples).unwrap());
        assert_eq!(found, Histogram { smallest: 1.0, largest: 1.0, rms: 0.0 });
    }

    #[test]
    fn cells_and_bins_are_where_their_samples_are() {
        // All samples but one in one place.
        let shape = TileShape::new(32, 1, 1, 1, 2).unwrap();
        let mut samples = [0.30, 0.99].repeat(32);
        samples[..2].copy_from_slice(&[0.95, 0.01]);
        let tile = Tile::new(shape, samples).unwrap();
        let [pair] = &pair_histograms(&tile)[..] else { panic!() };
        assert_eq!((pair.dims, pair.rows, pair.shares.len()), ((0, 1), 16, 256));
        assert_eq!((pair.shares[15 * 16 + 4], pair.shares[15]), (31.0 * 8.0, 8.0));
        assert_eq!(pair.figures(), histogram(&tile));
        let bins = marginals(&tile, 4);
        assert_eq!(bins[0], [0.0, 31.0 / 8.0, 0.0, 1.0 / 8.0]);
        assert_eq!(bins[1], [1.0 / 8.0, 0.0, 0.0, 31.0 / 8.0]);
    }

    #[test]
    fn residuals_are_relative_to_independent_samples() {
        let shape = TileShape::new(64, 64, 8, 2, 3).unwrap();
        for residual in residual(Domain::Square, &Baseline::White.tile(shape, 3)) {
            // 4096 pixels: a standard error of 1.1 %.
            assert!((residual - 1.0).abs() < 0.05, "{residual}");
        }
        // 16 samples of a pixel that stratify each dimension: the mean of 16 jittered strata has
        // a sixteenth of the standard deviation.
        for residual in residual(Domain::Square, &Baseline::Sobol.tile(shape, 3)) {
            assert!((residual * 16.0 - 1.0).abs() < 0.05, "{residual}");
        }
        let shape = TileShape::new(2, 1, 3, 1, 1).unwrap();
        let still = Tile::new(shape, [0.75, 0.25].repeat(3)).unwrap();
        let expected = 0.25 * (12.0_f64 * 3.0).sqrt();
        assert!((residual(Domain::Square, &still)[0] - expected).abs() < 1e-12);
    }
}
