//! What the processor itself counts, where it lets us ask.
//!
//! Virtual machines mostly hide these counters, containers forbid them, and only Linux has this
//! way to them; so each is a number or a reason for none, and a run goes on without. The cache
//! model ([`super::cache`]) is there for the machines that report nothing.

#[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
#[path = "counters/linux.rs"]
mod system;
#[cfg(not(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"))))]
#[path = "counters/elsewhere.rs"]
mod system;

use std::fmt;

use serde::Serialize;

/// What is counted, outside the kernel only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Event {
    /// Cycles of the cores.
    Cycles,
    /// Instructions that were completed.
    Instructions,
    /// Reads that the first data cache did not have.
    L1ReadMisses,
    /// Accesses that no cache had.
    LastLevelMisses,
    /// Reads whose page the first address translation did not know.
    TlbReadMisses,
}

impl Event {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Cycles,
        Self::Instructions,
        Self::L1ReadMisses,
        Self::LastLevelMisses,
        Self::TlbReadMisses,
    ];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cycles => "cycles",
            Self::Instructions => "instructions",
            Self::L1ReadMisses => "L1 read misses",
            Self::LastLevelMisses => "last-level misses",
            Self::TlbReadMisses => "TLB read misses",
        }
    }
}

/// How often something happened, if that is known.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// So often.
    Count {
        /// The number, scaled up if the counter served others as well.
        events: u64,
        /// The share of the time in which it was counted, in (0, 1]; below 1 the number is an
        /// estimate.
        share: f64,
    },
    /// Not available here.
    Unavailable {
        /// What the system says to that.
        reason: String,
    },
}

impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count { events, .. } => write!(f, "{events}"),
            Self::Unavailable { reason } => write!(f, "not available here: {reason}"),
        }
    }
}

/// A counter at one moment, in what the kernel keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Sample {
    events: u64,
    /// Nanoseconds for which it should have counted.
    enabled: u64,
    /// Nanoseconds for which it did.
    running: u64,
}

impl Sample {
    /// What happened since an earlier moment.
    fn since(self, earlier: Self) -> Reading {
        let events = self.events.saturating_sub(earlier.events);
        let enabled = self.enabled.saturating_sub(earlier.enabled);
        let running = self.running.saturating_sub(earlier.running);
        if enabled == 0 || running >= enabled {
            return Reading::Count { events, share: 1.0 };
        }
        if running == 0 {
            let reason = "the counter served others all the time".to_owned();
            return Reading::Unavailable { reason };
        }
        let share = running as f64 / enabled as f64;
        Reading::Count { events: (events as f64 / share).round() as u64, share }
    }
}

/// Counters of the calling thread, and of the threads that it starts from then on.
///
/// Open them before the pool whose work they are to count.
#[derive(Debug)]
pub struct Counters {
    counters: Vec<(Event, Result<system::Counter, String>)>,
}

impl Counters {
    /// Begins to count what can be counted here.
    pub fn open() -> Self {
        Self { counters: Event::ALL.map(|event| (event, system::Counter::open(event))).into() }
    }

    /// Whether there is any counter at all.
    pub fn any(&self) -> bool {
        self.counters.iter().any(|(_, counter)| counter.is_ok())
    }

    /// The counters now, to compare with later.
    pub fn snapshot(&mut self) -> CounterSnapshot {
        let read = |(event, counter): &mut (Event, Result<system::Counter, String>)| {
            let sample = counter.as_mut().map_err(|reason| reason.clone());
            (*event, sample.and_then(system::Counter::read))
        };
        CounterSnapshot { samples: self.counters.iter_mut().map(read).collect() }
    }
}

/// All counters at one moment.
#[derive(Debug, Clone)]
pub struct CounterSnapshot {
    samples: Vec<(Event, Result<Sample, String>)>,
}

impl CounterSnapshot {
    /// What happened since an earlier snapshot of the same counters, in the order of
    /// [`Event::ALL`].
    pub fn since(&self, earlier: &Self) -> Vec<(Event, Reading)> {
        let pairs = self.samples.iter().zip(&earlier.samples);
        pairs
            .map(|((event, now), (_, then))| {
                let reading = match (now, then) {
                    (Ok(now), Ok(then)) => now.since(*then),
                    (Err(reason), _) | (_, Err(reason)) => {
                        Reading::Unavailable { reason: reason.clone() }
                    }
                };
                (*event, reading)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::hint::black_box;

    use super::*;

    #[test]
    fn every_counter_is_a_number_or_a_reason() {
        let mut counters = Counters::open();
        let before = counters.snapshot();
        const ROUNDS: u64 = 1_000_000;
        std::thread::spawn(|| (0..ROUNDS).map(black_box).fold(0, u64::wrapping_add));
        let sum = (0..ROUNDS).map(black_box).fold(0, u64::wrapping_add);
        assert_eq!(sum, ROUNDS * (ROUNDS - 1) / 2);
        let readings = counters.snapshot().since(&before);
        assert_eq!(readings.iter().map(|(event, _)| *event).collect::<Vec<_>>(), Event::ALL);
        for (event, reading) in &readings {
            match reading {
                Reading::Unavailable { reason } => assert!(!reason.is_empty()),
                Reading::Count { events, share } => {
                    assert!(0.0 < *share && *share <= 1.0);
                    assert!(counters.any());
                    if matches!(event, Event::Instructions) {
                        assert!(*events >= ROUNDS, "{events} instructions");
                    }
                }
            }
            println!("{}: {reading}", event.name());
        }
    }

    #[test]
    fn shared_counters_are_scaled_up() {
        let then = Sample { events: 10, enabled: 100, running: 100 };
        let reading = |events, enabled, running| Sample { events, enabled, running }.since(then);
        assert_eq!(reading(30, 200, 200), Reading::Count { events: 20, share: 1.0 });
        assert_eq!(reading(30, 500, 200), Reading::Count { events: 80, share: 0.25 });
        assert_eq!(reading(10, 100, 100), Reading::Count { events: 0, share: 1.0 });
        assert!(matches!(reading(10, 200, 100), Reading::Unavailable { .. }));
    }
}
