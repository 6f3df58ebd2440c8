//! Where in the phases workers can be made to fail on purpose.

use perceptile_cluster::faults::{FaultPlan, FaultSite, Faults};
use perceptile_cluster::shared::Board;

/// While gradients are made.
pub(crate) const GRADIENT: FaultSite = FaultSite::of_caller(0);
/// While gradients are added up.
pub(crate) const REDUCE: FaultSite = FaultSite::of_caller(1);
/// While samples are moved, half of a row done.
pub(crate) const ADAM: FaultSite = FaultSite::of_caller(2);
/// While samples go from one phase to the next.
pub(crate) const EXCHANGE: FaultSite = FaultSite::of_caller(3);
/// While samples are made uniform.
pub(crate) const WARP: FaultSite = FaultSite::of_caller(4);

/// The sites of the phases, with names as people read them.
const SITES: [(FaultSite, &str); 5] = [
    (GRADIENT, "gradient"),
    (REDUCE, "reduce"),
    (ADAM, "adam"),
    (EXCHANGE, "exchange"),
    (WARP, "warp"),
];

/// The faults of a worker that starts now.
pub fn plan(plan: FaultPlan) -> Faults {
    Faults::new(plan, SITES.len())
}

/// The names of all sites.
pub fn names() -> impl Iterator<Item = &'static str> {
    FaultSite::OWN.into_iter().chain(SITES).map(|(_, name)| name)
}

/// How many faults a board has seen at each site; only those that happened.
pub fn tallies(board: &Board) -> Vec<(&'static str, u64)> {
    let tally = |(site, name)| (name, Faults::tally(board, site));
    let all = FaultSite::OWN.into_iter().chain(SITES).map(tally);
    all.filter(|(_, count)| *count > 0).collect()
}
