//! Systems without counters that we know how to ask for.

use super::{Event, Sample};

/// A counter that there cannot be.
#[derive(Debug)]
pub(super) enum Counter {}

impl Counter {
    /// Says why there is none.
    pub(super) fn open(_: Event) -> Result<Self, String> {
        Err("hardware counters are read on Linux only".to_owned())
    }

    /// Never called.
    pub(super) fn read(&mut self) -> Result<Sample, String> {
        match *self {}
    }
}
