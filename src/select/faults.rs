//! Where in a wave workers can be made to fail on purpose.

use perceptile_cluster::faults::{FaultPlan, FaultSite, Faults};

/// While frames get what a visit needs.
pub(super) const PREPARE: FaultSite = FaultSite::of_caller(0);
/// While a cell is half visited.
pub(super) const VISIT: FaultSite = FaultSite::of_caller(1);

/// Number of sites.
const SITES: usize = 2;

/// The faults of a worker that starts now.
#[cfg(unix)]
pub(super) fn plan(plan: FaultPlan) -> Faults {
    Faults::new(plan, SITES)
}
