//! How much memory a run needs, and how much there is.

use thiserror::Error;

use crate::draw::{Direction, Draw};
use crate::kernel::Kernel;
use crate::run::program::levels;
use crate::solver::{BLOCKS_PER_THREAD, Options};
use crate::tile::{Partition, Reach};

/// A run that does not fit into this machine's memory.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("the run needs about {} MB of memory, but only {} MB are free", needed >> 20, free >> 20)]
pub struct MemoryError {
    /// Bytes that the run needs.
    pub needed: u64,
    /// Bytes that the machine has to give.
    pub free: u64,
}

/// Bytes that a run of these options takes on a number of threads, from the sizes of what it
/// keeps.
///
/// Words of four bytes: the samples in rows, with copies around them, and Adam's two moments;
/// for the descent the patches of all blocks, for the polish the gradient. The samples are there
/// in cell order as well, and in the end as a tile. Threads keep the draws of one cell each,
/// with their directions; all draws of a step are never fewer.
pub fn foreseen(options: &Options, kernel: &Kernel, threads: usize) -> u64 {
    const FIXED: u64 = 16 << 20;
    let shape = options.shape;
    let reach = levels(kernel).reach();
    let pixel = (shape.spp() * shape.dims()) as u64;
    let tile = shape.coordinates() as u64;
    // One block is the tile with all copies around it.
    let pixels = |reach: Reach, blocks: usize| {
        let partition = Partition::new(shape, reach, 1);
        (partition.block_pixels(blocks) as u64).saturating_mul(pixel)
    };
    let patches = pixels(reach, threads.saturating_mul(BLOCKS_PER_THREAD));
    let descent = pixels(reach, 1).saturating_add(patches);
    let polish =
        if options.polish.steps > 0 { pixels(reach.doubled(), 1).saturating_add(tile) } else { 0 };
    let words = descent.max(polish);
    let directions = options.draw.directions.saturating_mul(size_of::<Direction>());
    let draws = options.draw.draws.saturating_mul(size_of::<Draw>().saturating_add(directions));
    words
        .saturating_add(tile.saturating_mul(4))
        .saturating_mul(size_of::<f32>() as u64)
        .saturating_add(draws as u64)
        .saturating_add(FIXED)
}

/// Whether a run of these options on a number of threads fits into the memory that is free.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check(options: &Options, kernel: &Kernel, threads: usize) -> Result<(), MemoryError> {
    let needed = foreseen(options, kernel, threads);
    match free() {
        Some(free) if needed > free => Err(MemoryError { needed, free }),
        _ => Ok(()),
    }
}

/// Bytes that programs can have without swapping, where the system tells (Linux).
pub fn free() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
