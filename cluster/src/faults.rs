//! Faults made on purpose: a worker that kills or stops itself in the middle of its work.
//!
//! What holds when workers die can only be shown by workers that die, in every place where it
//! matters. Each worker picks a place and a time; when it next passes there, it is gone.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::shared::Board;

/// Where faults can happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// A worker has mapped the memory and is about to begin.
    Attach,
    /// While gradients are made.
    Pull,
    /// While gradients are added up.
    Reduce,
    /// While samples are moved, half of a unit done.
    Adam,
    /// Between a job and the word that it is done, or the last job and the end of the round.
    Commit,
    /// While all wait for a checkpoint to be written.
    Hold,
    /// While samples go from one phase to the next.
    Exchange,
    /// While samples are made uniform.
    Warp,
}

impl Place {
    /// All places.
    pub const ALL: [Self; 8] = [
        Self::Attach,
        Self::Pull,
        Self::Reduce,
        Self::Adam,
        Self::Commit,
        Self::Hold,
        Self::Exchange,
        Self::Warp,
    ];

    /// Its name as people read it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Attach => "attach",
            Self::Pull => "pull",
            Self::Reduce => "reduce",
            Self::Adam => "adam",
            Self::Commit => "commit",
            Self::Hold => "hold",
            Self::Exchange => "exchange",
            Self::Warp => "warp",
        }
    }
}

/// How often workers fail on purpose, as text `500ms` or `500ms,0.25` (the share of those that
/// stop and must be killed; of the others, which die at once, there are three in four by default).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FaultPlan {
    /// Mean life of a worker.
    pub every: Duration,
    /// Share of faults that stop the worker instead of killing it, in [0, 1].
    pub stops: f64,
}

impl FromStr for FaultPlan {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (every, stops) = text.split_once(',').unwrap_or((text, "0.25"));
        let every = every
            .strip_suffix("ms")
            .and_then(|number| number.parse().ok())
            .filter(|number| (1..=3_600_000).contains(number))
            .ok_or_else(|| format!("`{every}` is not a time from 1ms to 3600000ms"))?;
        let stops = stops
            .parse()
            .ok()
            .filter(|share| (0.0..=1.0).contains(share))
            .ok_or_else(|| format!("`{stops}` is not a share in [0, 1]"))?;
        Ok(Self { every: Duration::from_millis(every), stops })
    }
}

impl fmt::Display for FaultPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}ms,{}", self.every.as_millis(), self.stops)
    }
}

/// The faults of one worker.
#[derive(Debug)]
pub struct Faults {
    plan: FaultPlan,
    born: Instant,
    /// When the next fault is due, in nanoseconds from birth, with its place in the low bits.
    next: AtomicU64,
    random: AtomicU64,
}

/// Low bits that hold a place.
const PLACE_BITS: u32 = 4;

impl Faults {
    /// Faults of a worker that begins to live now.
    pub fn new(plan: FaultPlan) -> Self {
        // Every worker has another number of its own, so all fail differently.
        let seed = u64::from(std::process::id());
        let born = Instant::now();
        let faults = Self { plan, born, next: AtomicU64::new(0), random: AtomicU64::new(seed) };
        faults.next.store(faults.choose(), Ordering::Relaxed);
        faults
    }

    /// The number of all faults at a place that a board has seen, those that stopped a worker
    /// included.
    pub fn tally(board: &Board, place: Place) -> u64 {
        board.tally(place as usize).load(Ordering::Relaxed)
    }

    /// A time from now and a place.
    fn choose(&self) -> u64 {
        let place = self.random() % Place::ALL.len() as u64;
        let mean = self.plan.every.as_nanos() as u64;
        let due = self.born.elapsed().as_nanos() as u64 + self.random() % (2 * mean);
        due >> PLACE_BITS << PLACE_BITS | place
    }

    /// The next random number (SplitMix64; Steele et al. 2014).
    fn random(&self) -> u64 {
        const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
        let mut z = self.random.fetch_add(STEP, Ordering::Relaxed).wrapping_add(STEP);
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Fails here, if that is due.
    pub(crate) fn at(&self, place: Place, board: &Board) {
        let next = self.next.load(Ordering::Relaxed);
        let now = self.born.elapsed().as_nanos() as u64;
        if now < next {
            return;
        }
        if next & ((1 << PLACE_BITS) - 1) != place as u64 {
            // A place that is not passed any more is given up.
            if now - next > 2 * self.plan.every.as_nanos() as u64 {
                self.next.store(self.choose(), Ordering::Relaxed);
            }
            return;
        }
        // Of several threads one fails for all.
        let later = u64::MAX >> PLACE_BITS << PLACE_BITS;
        if self.next.compare_exchange(next, later, Ordering::Relaxed, Ordering::Relaxed).is_err() {
            return;
        }
        board.tally(place as usize).fetch_add(1, Ordering::Relaxed);
        let stops = (self.random() >> 11) as f64 / (1_u64 << 53) as f64 + f64::EPSILON;
        fail(stops < self.plan.stops);
    }
}

/// Kills this process or stops it.
#[cfg(unix)]
fn fail(stop: bool) {
    use rustix::process::{Signal, getpid, kill_process};
    let signal = if stop { Signal::STOP } else { Signal::KILL };
    // To signal oneself is always allowed.
    let _ = kill_process(getpid(), signal);
}

/// Ends this process.
#[cfg(not(unix))]
fn fail(_: bool) {
    std::process::abort();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_read_as_they_are_written() {
        let plan: FaultPlan = "200ms".parse().unwrap();
        assert_eq!((plan.every, plan.stops), (Duration::from_millis(200), 0.25));
        assert_eq!(plan.to_string().parse(), Ok(plan));
        for wrong in ["", "0ms", "5", "5s", "5ms,2", "5ms,", "-1ms", "5ms,nan", "99999999ms"] {
            assert!(wrong.parse::<FaultPlan>().is_err(), "{wrong}");
        }
    }
}
