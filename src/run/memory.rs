//! How much memory a run needs, and how much there is.

use thiserror::Error;

use crate::draw::{Direction, Draw};
use crate::kernel::Kernel;
use crate::run::phases::levels;
use crate::solver::Options;
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

/// Bytes that a run of these options takes, from the sizes of what it keeps.
///
/// Words of four bytes: the descent has the samples of all blocks twice, their gradient, and two
/// mailboxes for halos; the polish has the samples of its larger blocks three times and a mailbox.
/// Both have Adam's two moments twice, and the samples in cell order and as a tile. Threads keep
/// the draws of one cell each, with their directions; all draws of a step are never fewer.
pub fn foreseen(options: &Options, kernel: &Kernel) -> u64 {
    const FIXED: u64 = 16 << 20;
    let Options { shape, polish, .. } = options;
    let reach = levels(kernel).reach();
    let partition = Partition::new(*shape, reach, 1);
    let tile = shape.pixels() as u64;
    let descent = partition.block_pixels() as u64;
    let wide = if polish.steps > 0 { reach.doubled() } else { Reach::default() };
    let polish = partition.with_reach(wide).block_pixels() as u64;
    let words = u64::max(
        descent.saturating_mul(5).saturating_sub(tile.saturating_mul(2)),
        polish.saturating_mul(4),
    );
    let directions = options.draw.directions.saturating_mul(size_of::<Direction>());
    let draws = options.draw.draws.saturating_mul(size_of::<Draw>().saturating_add(directions));
    words
        .saturating_add(tile.saturating_mul(7))
        .saturating_mul((shape.spp() * shape.dims() * size_of::<f32>()) as u64)
        .saturating_add(draws as u64)
        .saturating_add(FIXED)
}

/// Whether a run of these options fits into the memory that is free.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check(options: &Options, kernel: &Kernel) -> Result<(), MemoryError> {
    let needed = foreseen(options, kernel);
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
