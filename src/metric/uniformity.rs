//! How evenly a whole tile covers the cube, beside what the eye sees of it.
//!
//! An arrangement that hides the error of every frame can still leave parts of the cube
//! under-filled, a bias that no averaging removes; and a pixel's samples over all frames can
//! average to something else than the cube's centre, which stays when a still picture accumulates.

use serde::{Deserialize, Serialize};

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

/// The histogram figures over all pairs of dimensions: extremes of all, rms over all.
pub fn histogram(tile: &Tile) -> Histogram {
    let dims = tile.shape().dims();
    let cell = |x: f32| ((x * SIDE as f32) as usize).min(SIDE - 1);
    let pairs: Vec<(usize, usize)> = if dims == 1 {
        vec![(0, 0)]
    } else {
        (0..dims).flat_map(|j| (0..j).map(move |i| (i, j))).collect()
    };
    // One pass over the samples for all pairs; a single dimension uses the grid's diagonal.
    let mut counts = vec![[[0_u32; SIDE]; SIDE]; pairs.len()];
    let mut cells = vec![0; dims];
    for point in tile.samples().chunks_exact(dims) {
        cells.iter_mut().zip(point).for_each(|(c, &x)| *c = cell(x));
        for (count, &(i, j)) in counts.iter_mut().zip(&pairs) {
            count[cells[j]][cells[i]] += 1;
        }
    }
    let used = if dims == 1 { SIDE } else { SIDE * SIDE };
    let expected = tile.shape().samples() as f64 / used as f64;
    let shares: Vec<f64> = counts
        .iter()
        .flat_map(|count| {
            (0..SIDE * SIDE).filter_map(move |k| {
                let (i, j) = (k % SIDE, k / SIDE);
                (dims > 1 || i == j).then(|| f64::from(count[j][i]))
            })
        })
        .map(|count| count / expected)
        .collect();
    let square = shares.iter().map(|share| (share - 1.0) * (share - 1.0)).sum::<f64>();
    Histogram {
        smallest: shares.iter().copied().fold(f64::INFINITY, f64::min),
        largest: shares.iter().copied().fold(0.0, f64::max),
        rms: (square / shares.len() as f64).sqrt(),
    }
}

/// Per dimension: rms over the pixels of (mean over all frames and samples − ½), relative to that
/// of independent samples, √(1 / (12 · frames · spp)).
pub fn residual(tile: &Tile) -> Vec<f64> {
    let shape = tile.shape();
    let (dims, spp) = (shape.dims(), shape.spp());
    let per_frame = shape.width() * shape.height();
    let mut sums = vec![0.0_f64; per_frame * dims];
    for frame in tile.samples().chunks_exact(per_frame * spp * dims) {
        for (pixel, sums) in frame.chunks_exact(spp * dims).zip(sums.chunks_exact_mut(dims)) {
            for point in pixel.chunks_exact(dims) {
                sums.iter_mut().zip(point).for_each(|(sum, &x)| *sum += f64::from(x) - 0.5);
            }
        }
    }
    let samples = (shape.frames() * spp) as f64;
    let expected = samples / 12.0;
    (0..dims)
        .map(|dim| {
            let square: f64 = sums.iter().skip(dim).step_by(dims).map(|sum| sum * sum).sum();
            (square / per_frame as f64 / expected).sqrt()
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
    fn residuals_are_relative_to_independent_samples() {
        let shape = TileShape::new(64, 64, 8, 2, 3).unwrap();
        for residual in residual(&Baseline::White.tile(shape, 3)) {
            // 4096 pixels: a standard error of 1.1 %.
            assert!((residual - 1.0).abs() < 0.05, "{residual}");
        }
        // 16 samples of a pixel that stratify each dimension: the mean of 16 jittered strata has
        // a sixteenth of the standard deviation.
        for residual in residual(&Baseline::Sobol.tile(shape, 3)) {
            assert!((residual * 16.0 - 1.0).abs() < 0.05, "{residual}");
        }
        let shape = TileShape::new(2, 1, 3, 1, 1).unwrap();
        let still = Tile::new(shape, [0.75, 0.25].repeat(3)).unwrap();
        let expected = 0.25 * (12.0_f64 * 3.0).sqrt();
        assert!((residual(&still)[0] - expected).abs() < 1e-12);
    }
}
