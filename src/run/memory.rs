//! How much memory a run needs, and how much there is.

mod limits;
mod size;

use std::path::Path;

use thiserror::Error;

use crate::draw::{Direction, Draw};
use crate::run::plan::Plan;
use crate::tile::Region;

pub use limits::Limit;
pub use size::size;

/// A run that does not fit into the memory that this process can have.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[error(
    "the run needs about {} of memory, but only {} are free {limit}",
    size(*needed), size(*free)
)]
pub struct MemoryError {
    /// Bytes that the run needs.
    pub needed: u64,
    /// Bytes that it can have.
    pub free: u64,
    /// Why no more.
    pub limit: Limit,
}

/// Bytes that a process and its workers take for a run, from the sizes of what they keep.
///
/// What its workers share ([`Plan::storage`]), the samples that it starts from, and in the end
/// the tile. Threads keep the draws of one cell each, with their directions; all draws of a step
/// are never fewer. A worker process has its own tables.
pub fn foreseen(plan: &Plan) -> u64 {
    const FIXED: u64 = 16 << 20;
    let options = &plan.options;
    let regions = plan.regions(0);
    let shared = |&region: &Region| plan.storage(region).bytes() as u64;
    let shared = regions.all().iter().map(shared).max().unwrap_or(0);
    // One process alone holds its start and the tile once more; a cluster nowhere.
    let copies = if plan.parallelism.ranks > 1 { 0 } else { 2 };
    let tile = (options.shape.coordinates() * size_of::<f32>()) as u64;
    let directions = options.draw.directions.saturating_mul(size_of::<Direction>());
    let draws = options.draw.draws.saturating_mul(size_of::<Draw>().saturating_add(directions));
    let workers = plan.parallelism.workers as u64;
    shared
        .saturating_add(copies * tile)
        .saturating_add(draws as u64)
        .saturating_add((FIXED + options.domain.bytes() as u64) * (1 + workers))
}

/// Whether a run fits into the memory that is free.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check(plan: &Plan) -> Result<(), MemoryError> {
    compare(foreseen(plan), limits::tightest())
}

/// Whether a rank's share of a run fits into the memory that is free where it is; and the whole
/// tile, twice, if that is to be put together there.
///
/// # Errors
/// If it does not. Where the system does not say what is free, every run fits.
pub fn check_rank(plan: &Plan, keeps_whole: bool) -> Result<(), MemoryError> {
    let tile = (plan.options.shape.coordinates() * size_of::<f32>()) as u64;
    let needed = foreseen(plan).saturating_add(if keeps_whole { 2 * tile } else { 0 });
    compare(needed, limits::tightest())
}

/// Whether so many bytes are free.
///
/// # Errors
/// If they are not. Where the system does not say what is free, they are.
pub fn check_bytes(needed: u64) -> Result<(), MemoryError> {
    compare(needed, limits::tightest())
}

fn compare(needed: u64, tightest: Option<(u64, Limit)>) -> Result<(), MemoryError> {
    match tightest {
        Some((free, limit)) if needed > free => Err(MemoryError { needed, free, limit }),
        _ => Ok(()),
    }
}

/// Bytes that this process can have without swapping and within its limits, where the system reports
/// it (Linux).
pub fn free() -> Option<u64> {
    limits::tightest().map(|(free, _)| free)
}

/// The most memory that this process has had so far, where the system reports it (Linux).
pub fn peak() -> Option<u64> {
    field(Path::new("/proc/self/status"), "VmHWM:")
}

/// Bytes of a field of a file that has one on each line.
fn field(path: &Path, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Domain;
    use crate::domain::tests::densities;
    use crate::solver::{Parallelism, Preset};

    /// Every process has a picture of its own.
    #[test]
    fn pictures_count_in_every_process() {
        let foreseen = |domain, workers| {
            let options = Preset::Quick.options().with_domain(domain);
            let parallelism = Parallelism { workers, ..Parallelism::threads() };
            foreseen(&Plan::new(&options, parallelism).unwrap())
        };
        for domain in densities() {
            // Levels and the nearest pixels have 4 bytes each, sums 8.
            let pixels = domain.density().unwrap().size().iter().product::<usize>();
            assert!(domain.bytes() >= 12 * pixels, "{domain}");
            for workers in [0, 3] {
                let more = foreseen(domain, workers) - foreseen(Domain::Square, workers);
                assert_eq!(more, (domain.bytes() * (1 + workers)) as u64, "{domain} {workers}");
            }
        }
    }

    #[test]
    fn a_run_that_does_not_fit_is_told_the_limit() {
        let limit = Limit::ControlGroup("/sys/fs/cgroup/job_1".into());
        let tightest = Some((280 << 20, limit));
        let error = compare(791 << 20, tightest.clone()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the run needs about 791.0 MB of memory, but only 280.0 MB are free in the memory limit of \
             control group /sys/fs/cgroup/job_1"
        );
        assert!(compare((280 << 20) + 1, tightest.clone()).is_err());
        assert_eq!(compare(280 << 20, tightest), Ok(()));
        assert_eq!(compare(u64::MAX, None), Ok(()));
    }
}
