//! One row of the profile: a stage of a mean step, with its time, its traffic, and how near it comes
//! to what the machine can do.

use serde::Serialize;

use super::roofline::{Bound, RooflinePoint, Store};
use super::subject::Sizes;
use super::traffic::Traffic;
use crate::gradient::probe::Stage;

/// A stage of a mean step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageRow {
    /// Its name.
    pub stage: &'static str,
    /// Nanoseconds of a step, of all threads together.
    pub nanoseconds: f64,
    /// The same for each draw.
    pub per_draw: f64,
    /// Share of the time of all stages, waiting included.
    pub share: f64,
    /// What it does in a step.
    #[serde(flatten)]
    pub traffic: Traffic,
    /// Where most of its data should be.
    pub store: Store,
    /// Where it stands under the roofline of that store; nowhere if it does not work.
    pub placement: Option<RooflinePoint>,
}

impl StageRow {
    /// What its roof is made of, as people read it.
    pub(super) fn bound(&self) -> String {
        let Some(placement) = self.placement else { return "-".into() };
        let store = match self.store {
            Store::L1 => "L1",
            Store::L2 => "L2",
            Store::Memory => "memory",
        };
        match placement.bound {
            Bound::Compute => "compute".into(),
            // From L3, whose rate is not measured, or in streams that suit the memory better.
            Bound::Memory if placement.share > 1.0 => format!("{store}, faster than copying there"),
            Bound::Memory => store.into(),
        }
    }
}

/// The nearest store that holds what a stage works on: a draw's scratch, what a cell sees of
/// samples and gradient, or everything.
pub(super) fn store(stage: Stage, sizes: &Sizes, [l1, l2, _]: [u64; 3], threads: usize) -> Store {
    let (l1, l2, bytes) = match stage {
        Stage::Gather | Stage::Scatter => (l1, l2, 2 * sizes.window),
        Stage::Reduce | Stage::Adam => (l1 * threads as u64, l2 * threads as u64, sizes.all()),
        _ => (l1, l2, 0),
    };
    if bytes <= l1 {
        Store::L1
    } else if bytes <= l2 {
        Store::L2
    } else {
        Store::Memory
    }
}
