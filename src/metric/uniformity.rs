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
