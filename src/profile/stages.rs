//! The time of each stage of a step, taken between stages by a clock that reads the processor's
//! time stamp.

use quanta::Clock;

use crate::gradient::probe::{Probe, Stage};

/// Takes times for one thread.
#[derive(Debug, Clone)]
pub struct StageProbe {
    clock: Clock,
    last: u64,
    totals: StageTimes,
}

/// Time and number of marks of each stage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Nanoseconds, in the order of [`Stage::ALL`].
    pub nanoseconds: [u64; Stage::ALL.len()],
    /// Times that the stage was passed.
    pub passed: [u64; Stage::ALL.len()],
}

impl StageProbe {
    /// A probe that has seen nothing.
    pub fn new() -> Self {
        let clock = Clock::new();
        let last = clock.raw();
        Self { clock, last, totals: StageTimes::default() }
    }

    /// What it has seen.
    pub fn times(&self) -> StageTimes {
        let mut times = self.totals;
        for ticks in &mut times.nanoseconds {
            *ticks = self.clock.delta_as_nanos(0, *ticks);
        }
        times
    }
}

impl Default for StageProbe {
    fn default() -> Self {
        Self::new()
    }
}

impl Probe for StageProbe {
    #[inline(always)]
    fn begin(&mut self) {
        self.last = self.clock.raw();
    }

    #[inline(always)]
    fn lap(&mut self, stage: Stage) {
        let now = self.clock.raw();
        let stage = stage as usize;
        self.totals.nanoseconds[stage] += now.saturating_sub(self.last);
        self.totals.passed[stage] += 1;
        self.last = now;
    }
}
