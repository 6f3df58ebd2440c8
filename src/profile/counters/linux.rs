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
        builder
            .inherit(true)
            .enabled(true)
            .build()
            .map(Self)
            .map_err(|error| format!("perf_event_open: {error}"))
    }

    /// The counter now.
    pub(super) fn read(&mut self) -> Result<Sample, String> {
        let read = self.0.read_count_and_time().map_err(|error| error.to_string())?;
        Ok(Sample { events: read.count, enabled: read.time_enabled, running: read.time_running })
    }
}

#[cfg(test)]
mod tests {
    use perf_event::events::Software;

    use super::super::Reading;
    use super::*;

    /// Nanoseconds for which this thread has had a processor, where the system tells.
    fn had() -> Option<u64> {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split(' ').next()?.parse().ok()
    }

    /// The kernel's own clock of a task is there without any hardware.
    #[test]
    fn threads_started_later_are_counted_too() {
        const WORK: u64 = 20_000_000;
        let mut clock = match Counter::build(&mut Builder::new(Software::TASK_CLOCK)) {
            Ok(clock) => clock,
            Err(reason) => return println!("skipped: {reason}"),
        };
        if had().is_none() {
            return println!("skipped: the system does not tell what a thread had");
        }
        // Of a processor's time, which others may have for a while.
        let work = || while had().is_some_and(|time| time < WORK) {};
        let before = clock.read().unwrap();
        for _ in 0..3 {
            std::thread::spawn(work).join().unwrap();
        }
        let reading = clock.read().unwrap().since(before);
        let Reading::Count { events, .. } = reading else { panic!("{reading}") };
        assert!(events > 5 * WORK / 2, "{events} ns");
    }
}
