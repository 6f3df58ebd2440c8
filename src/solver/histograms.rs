//! How the work of the warp is dealt out, and what its histograms take: the storage makes room for
//! them before there is a warp.

use crate::tile::TileShape;

/// Bins of a histogram of projections. More would make the density smoother still, but follow the
/// chance of single samples and so disturb their strata (axis edges were 6 % worse with 1,024 bins
/// than with 128, where the density was less even; in the mean of ratios, as `metric` scored before).
pub(crate) const BINS: usize = 256;

/// Coordinates that a thread handles at a time, so that they stay close to it while it moves them
/// and counts them; of no influence on the result.
pub(crate) const CHUNK: usize = 1 << 14;

/// Words of a job's histograms: of each layer of samples, two axes at most.
pub(crate) fn job_words(layers: usize) -> usize {
    2 * BINS * layers
}

/// Jobs that the samples of a tile are dealt out as, to so many threads.
pub(crate) fn jobs(shape: TileShape, threads: usize) -> usize {
    let points = shape.coordinates() / shape.dims();
    shape.coordinates().div_ceil(CHUNK).min(threads * 4).clamp(1, points)
}

/// Words of the histograms of all jobs.
pub(crate) fn count_words(shape: TileShape, threads: usize, layers: usize) -> usize {
    jobs(shape, threads) * job_words(layers)
}
