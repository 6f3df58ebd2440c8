//! Draws of a constant number of samples, so that their cost can be read off by size.

use perceptile::kernel::{KernelTaps, Tap};
use perceptile::metric::Baseline;

use super::{Gradients, gradient, paper_options, paper_taps, shape};

/// Taps and samples per pixel of a subset. Large ones come from more samples per pixel, as in
/// real runs: the paper's kernel has 392 taps.
pub const SUBSETS: [(usize, usize); 7] =
    [(4, 1), (16, 1), (60, 1), (64, 4), (250, 4), (250, 16), (250, 64)];
/// Dimensions.
pub const DIMS: [usize; 6] = [1, 2, 3, 4, 8, 16];

/// Draws of a step, one for 16 pixels.
pub const DRAWS: usize = 512;
/// Width, height and frames of the tile: as small as the kernel allows, because 64 samples in 16
/// dimensions make 32 MB of it.
const SIZE: [usize; 3] = [32, 32, 8];

/// Samples of the subsets that are compared with the plain gradient in all dimensions.
const CHECKED: usize = 60;

/// Checked draws of the `taps` largest taps of the paper's kernel, made equal, in one direction.
pub fn gradients((taps, spp): (usize, usize), dims: usize) -> Gradients {
    let shape = shape(SIZE, spp, dims);
    let largest = paper_taps(shape);
    let largest = largest.taps()[..taps].iter().map(|tap| Tap { weight: 1.0, ..*tap });
    let taps = KernelTaps::new(largest).expect("taps");
    let tile = Baseline::White.tile(shape, 2);
    let mut gradients = Gradients::new(gradient(shape, &taps, paper_options(DRAWS)), &tile);
    // Ranks are found alike in all dimensions, but tables of targets above two take their time.
    if dims <= 2 || shape.spp() * taps.taps().len() == CHECKED {
        gradients.check_some(&tile, &taps, 1);
    }
    gradients.check_sum(&tile);
    gradients
}
