//! How much memory a run needs, and how much there is.

use thiserror::Error;

use crate::solver::Options;

/// A run that does not fit into this machine's memory.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("the run needs about {} MB of memory, but only {} MB are free", needed >> 20, free >> 20)]
pub struct MemoryError {
    /// Bytes that the run needs.
    pub needed: u64,
    /// Bytes that the machine has to give.
    pub free: u64,
}

/// Bytes that a run of these options takes, roughly.
///
/// Per coordinate: the samples and both moments of Adam twice over, the gradient and the two
/// mailboxes of the halo exchange, each of four bytes and with halos that may double their size
/// (nearly 20 words); and once more the samples in cell order and as a tile.
pub fn foreseen(options: &Options) -> u64 {
    const WORDS: u64 = 22;
    const FIXED: u64 = 16 << 20;
    FIXED.saturating_add((options.shape.coordinates() as u64).saturating_mul(WORDS * 4))
}

/// Whether a run of these options fits into the memory that is free.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check(options: &Options) -> Result<(), MemoryError> {
    let needed = foreseen(options);
    match free() {
        Some(free) if needed > free => Err(MemoryError { needed, free }),
        _ => Ok(()),
    }
}

/// Bytes that programs can have without swapping (Linux).
fn free() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
