//! Faults made on purpose: a worker that kills or stops itself in the middle of its work.
//!
//! What holds when workers die can only be shown by workers that die, at every site where it
//! matters. Each worker picks a site and a time; when it next passes there, it is gone. Time is what
//! the processors have spent on the worker: on a crowded machine it lives longer by the clock, but
//! does as much before it dies. The crate has a few sites of its own; whoever uses it numbers
//! others.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::shared::Board;

/// Where faults can happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultSite(u8);

impl FaultSite {
    /// A worker has mapped the memory and is about to begin.
    pub const ATTACH: Self = Self(0);
    /// Between a job and the word that it is done, or the last job and the end of the round.
    pub const COMMIT: Self = Self(1);
    /// While all wait until they are released.
    pub const HOLD: Self = Self(2);

    /// The sites of this crate, with their names as people read them.
    pub const OWN: [(Self, &'static str); 3] =
        [(Self::ATTACH, "attach"), (Self::COMMIT, "commit"), (Self::HOLD, "hold")];

    /// Number of sites that a caller can have.
    pub const MOST_OF_CALLER: usize = Board::TALLIES - Self::OWN.len();

    /// A site of the caller's, by its number from 0.
    ///
    /// # Panics
    /// If the number is not below [`Self::MOST_OF_CALLER`].
    pub const fn of_caller(number: u8) -> Self {
        assert!((number as usize) < Self::MOST_OF_CALLER, "more sites than can be counted");
        Self(Self::OWN.len() as u8 + number)
    }
}

/// How often workers fail on purpose, as text `500ms` or `500ms,0.25` (the share of those that
/// stop and must be killed; of the others, which die at once, there are three in four by default).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FaultPlan {
    /// Mean life of a worker, in processor time.
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
    /// Number of sites, of which each is chosen equally often.
    sites: u64,
    /// When the next fault is due, in nanoseconds of the process's processor time, with its site in
    /// the low bits.
    next: AtomicU64,
    random: AtomicU64,
}

/// Low bits that hold a site.
const SITE_BITS: u32 = 5;
const SITE: u64 = (1 << SITE_BITS) - 1;
const _: () = assert!(Board::TALLIES - 1 <= SITE as usize);

impl Faults {
    /// Faults of a worker that begins to live now, at the sites of this crate and at the first
    /// `sites` of the caller's.
    ///
    /// # Panics
    /// If those are more than [`FaultSite::MOST_OF_CALLER`].
    pub fn new(plan: FaultPlan, sites: usize) -> Self {
        // Every worker has another number of its own, so all fail differently.
        Self::seeded(plan, sites, std::process::id().into())
    }

    fn seeded(plan: FaultPlan, sites: usize, seed: u64) -> Self {
        assert!(sites <= FaultSite::MOST_OF_CALLER, "{sites} sites");
        let faults = Self {
            plan,
            sites: (FaultSite::OWN.len() + sites) as u64,
            next: AtomicU64::new(0),
            random: AtomicU64::new(seed),
        };
        faults.next.store(faults.choose(), Ordering::Relaxed);
        faults
    }

    /// The number of all faults at a site that a board has seen, those that stopped a worker
    /// included.
    pub fn tally(board: &Board, site: FaultSite) -> u64 {
        board.tally(site.0.into()).load(Ordering::Relaxed)
    }

    /// A time from now and a site.
    fn choose(&self) -> u64 {
        let site = self.random() % self.sites;
        let mean = self.plan.every.as_nanos() as u64;
        let due = processor_time().as_nanos() as u64 + self.random() % (2 * mean);
        due & !SITE | site
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
    pub(crate) fn at(&self, site: FaultSite, board: &Board) {
        let next = self.next.load(Ordering::Relaxed);
        let now = processor_time().as_nanos() as u64;
        if now < next {
            return;
        }
        if next & SITE != u64::from(site.0) {
            // A site that is not passed any more is given up.
            if now - next > 2 * self.plan.every.as_nanos() as u64 {
                self.next.store(self.choose(), Ordering::Relaxed);
            }
            return;
        }
        // Of several threads one fails for all.
        if self.next.compare_exchange(next, !SITE, Ordering::Relaxed, Ordering::Relaxed).is_err() {
            return;
        }
        board.tally(site.0.into()).fetch_add(1, Ordering::Relaxed);
        let stops = (self.random() >> 11) as f64 / (1_u64 << 53) as f64 + f64::EPSILON;
        fail(stops < self.plan.stops);
    }
}

/// What the processors have spent on this process.
#[cfg(unix)]
fn processor_time() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    // It is never negative.
    clock_gettime(ClockId::ProcessCPUTime).try_into().unwrap_or_default()
}

/// Stands for the processor time where that is not to be had: the time since it was first asked for.
#[cfg(not(unix))]
fn processor_time() -> Duration {
    static START: std::sync::LazyLock<std::time::Instant> =
        std::sync::LazyLock::new(std::time::Instant::now);
    START.elapsed()
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

    #[test]
    fn each_site_is_chosen_equally_often() {
        let plan: FaultPlan = "1ms".parse().unwrap();
        for sites in [0, 5, FaultSite::MOST_OF_CALLER] {
            const CHOICES: usize = 10_000;
            let faults = Faults::seeded(plan, sites, 1);
            let mut counts = vec![0_usize; FaultSite::OWN.len() + sites];
            for _ in 0..CHOICES * counts.len() {
                counts[(faults.choose() & SITE) as usize] += 1;
            }
            // Ten standard deviations, and the seed is fixed.
            let even = |count: &usize| count.abs_diff(CHOICES) < 1000;
            assert!(counts.iter().all(even), "{counts:?}");
        }
    }

    #[test]
    fn sites_of_the_crate_and_of_a_caller_are_apart() {
        let callers =
            (0..FaultSite::MOST_OF_CALLER).map(|number| FaultSite::of_caller(number as u8));
        let mut sites: Vec<u8> = FaultSite::OWN
            .map(|(site, _)| site)
            .into_iter()
            .chain(callers)
            .map(|it| it.0)
            .collect();
        sites.sort_unstable();
        assert_eq!(sites, (0..Board::TALLIES as u8).collect::<Vec<_>>());
        let most = FaultSite::MOST_OF_CALLER;
        assert!(std::panic::catch_unwind(|| FaultSite::of_caller(most as u8)).is_err());
    }
}
