//! Counters of Linux (`perf_event_open`).

use perf_event::Builder;
use perf_event::events::{Cache, CacheId, CacheOp, CacheResult, Hardware};

use super::{Event, Sample};

/// One counter that counts.
#[derive(Debug)]
pub(super) struct Counter(perf_event::Counter);

impl Counter {
    /// Begins to count an event of this thread and of those that it starts.
    pub(super) fn open(event: Event) -> Result<Self, String> {
        let misses = |which| Cache { which, operation: CacheOp::READ, result: CacheResult::MISS };
        Self::build(&mut match event {
            Event::Cycles => Builder::new(Hardware::CPU_CYCLES),
            Event::Instructions => Builder::new(Hardware::INSTRUCTIONS),
            Event::L1ReadMisses => Builder::new(misses(CacheId::L1D)),
            Event::LastLevelMisses => Builder::new(Hardware::CACHE_MISSES),
            Event::TlbReadMisses => Builder::new(misses(CacheId::DTLB)),
        })
    }

    /// Enabled from the start, since a counter that is enabled later leaves out the threads that
    /// it was not there for.
    fn build(builder: &mut Builder<'_>) -> Result<Self, String> {
        builder.inherit(true).enabled(true).build().map(Self).map_err(|error| error.to_string())
    }

    /// The counter now.
    pub(super) fn read(&mut self) -> Result<Sample, String> {
        let read = self.0.read_count_and_time().map_err(|error| error.to_string())?;
        Ok(Sample { events: read.count, enabled: read.time_enabled, running: read.time_running })
    }
}

#[cfg(test)]
mod tests {
    use std::hint::black_box;
    use std::time::{Duration, Instant};

    use perf_event::events::Software;

    use super::super::Reading;
    use super::*;

    /// The kernel's own clock of a task is there without any hardware.
    #[test]
    fn threads_started_later_are_counted_too() {
        const WORK: Duration = Duration::from_millis(20);
        let mut clock = match Counter::build(&mut Builder::new(Software::TASK_CLOCK)) {
            Ok(clock) => clock,
            Err(reason) => return println!("skipped: {reason}"),
        };
        let work = || {
            let begun = Instant::now();
            while begun.elapsed() < WORK {
                black_box(begun);
            }
        };
        let before = clock.read().unwrap();
        for _ in 0..3 {
            std::thread::spawn(work).join().unwrap();
        }
        let reading = clock.read().unwrap().since(before);
        let Reading::Count { events, .. } = reading else { panic!("{reading}") };
        // Less than three times the work if others had the cores in the meantime.
        assert!(u128::from(events) > WORK.as_nanos() / 2, "{events} ns");
    }
}
