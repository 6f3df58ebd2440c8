//! How much memory a run needs, and how much there is.

use thiserror::Error;

use crate::draw::{Direction, Draw};
use crate::run::program::Program;
use crate::tile::Region;

/// A run that does not fit into this machine's memory.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("the run needs about {} MB of memory, but only {} MB are free", needed >> 20, free >> 20)]
pub struct MemoryError {
    /// Bytes that the run needs.
    pub needed: u64,
    /// Bytes that the machine has to give.
    pub free: u64,
}

/// Bytes that a process and its workers take for a run, from the sizes of what they keep.
///
/// What its ranks share ([`Program::storage`]), the samples that it begins with, and in the end
/// the tile. Threads keep the draws of one cell each, with their directions; all draws of a step
/// are never fewer. A worker process has its own tables.
pub fn foreseen(program: &Program) -> u64 {
    const FIXED: u64 = 16 << 20;
    let options = &program.options;
    let regions = program.regions(0);
    let shared = |&region: &Region| program.storage(region).bytes() as u64;
    let shared = regions.all().iter().map(shared).max().unwrap_or(0);
    // One process alone holds its start and the tile once more; a cluster nowhere.
    let copies = if program.team.regions > 1 { 0 } else { 2 };
    let tile = (options.shape.coordinates() * size_of::<f32>()) as u64;
    let directions = options.draw.directions.saturating_mul(size_of::<Direction>());
    let draws = options.draw.draws.saturating_mul(size_of::<Draw>().saturating_add(directions));
    let workers = if program.team.can_fail { program.team.ranks as u64 } else { 0 };
    shared
        .saturating_add(copies * tile)
        .saturating_add(draws as u64)
        .saturating_add(FIXED * (1 + workers))
}

/// Whether a run fits into the memory that is free.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check(program: &Program) -> Result<(), MemoryError> {
    compare(foreseen(program))
}

/// Whether a rank's share of a run fits into the memory that is free where it is; and the whole
/// tile, twice, if that is to be put together there.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check_rank(program: &Program, keeps_whole: bool) -> Result<(), MemoryError> {
    let tile = (program.options.shape.coordinates() * size_of::<f32>()) as u64;
    compare(foreseen(program).saturating_add(if keeps_whole { 2 * tile } else { 0 }))
}

fn compare(needed: u64) -> Result<(), MemoryError> {
    match free() {
        Some(free) if needed > free => Err(MemoryError { needed, free }),
        _ => Ok(()),
    }
}

/// Bytes that programs can have without swapping, where the system tells (Linux).
pub fn free() -> Option<u64> {
    field("/proc/meminfo", "MemAvailable:")
}

/// The most memory that this process has had so far, where the system tells (Linux).
pub fn peak() -> Option<u64> {
    field("/proc/self/status", "VmHWM:")
}

/// Bytes of a field of a file that has one on each line.
fn field(path: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
