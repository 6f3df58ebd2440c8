//! What this machine could do at best, and how near a phase of a run comes to it.
//!
//! The roofline model (Williams, Waterman, Patterson 2009): work of so many operations on so many
//! bytes takes at least the time of the operations at the machine's compute rate, and at least
//! the time of the bytes at its bandwidth. [`Rates::measure`] finds both rates by doing nothing
//! else for a moment, [`Ceiling::place`] compares.
//!
//! Rates are the best of many short windows of time, as STREAM reports the best of several runs
//! (McCalpin 1995): a ceiling is what can be reached, not what is usual on a busy machine. Each is
//! measured several times, in turn with the others, so that a busy moment spoils none of them.
//! Where a cache still seems slower than what lies beyond it, it counts as not measured.

use std::array;
use std::hint::black_box;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::machine::Machine;
use crate::gradient::simd::{Isa, Simd, Vectorized};
use crate::run::memory;

/// How long each rate is measured at a time.
const DURATION: Duration = Duration::from_millis(100);
/// Times that all rates are measured at least.
const FEWEST_ROUNDS: u32 = 3;
/// Times that they are measured at most, while a cache seems slower than what lies beyond it.
const MOST_ROUNDS: u32 = 12;
/// Time over which a rate is the mean, in seconds: much longer than a piece of work, and not longer
/// than a thread keeps its core on a busy machine.
const WINDOW: f64 = 3e-3;
/// Windows begin after such shares of their length.
const WINDOWS_IN_ONE: f64 = 4.0;
/// Shortest piece of work between two looks at the clock, which take some ten nanoseconds.
const PIECE: Duration = Duration::from_micros(20);
/// Share of the free memory that is used at most.
const MEMORY_SHARE: u64 = 8;
/// Most bytes that are used where the system does not say what is free.
const MOST_UNTOLD: u64 = 256 << 20;

/// Why there is no roofline.
#[derive(Debug, Error)]
pub enum RooflineError {
    /// The threads cannot be started.
    #[error("cannot start {threads} threads: {error}")]
    Threads {
        /// How many were asked for.
        threads: usize,
        /// What the system says.
        error: rayon::ThreadPoolBuildError,
    },
    /// What was copied or computed is wrong: the machine cannot be trusted.
    #[error("this machine {0} wrongly")]
    Wrong(&'static str),
    /// A phase that did nothing, took no time, or has numbers that are none.
    #[error("{0:?} is no work: numbers must be finite, and the time and some work positive")]
    Work(Work),
}

/// Where data is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Store {
    /// In the first cache of each core.
    L1,
    /// In the second cache of each core.
    L2,
    /// In memory.
    Memory,
}

/// A rate of copying.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bandwidth {
    /// Bytes in all arrays of all threads. Out of memory they should be several times the last
    /// cache; less than that, because memory is short, and the rate is partly that of the cache.
    pub bytes: u64,
    /// Bytes read plus bytes written, per second, of all threads.
    pub rate: f64,
    /// Whether the rate was measured here. If not, copying here took longer than beyond, as no
    /// cache is slower than what it is a cache of. The rate is then that from beyond: this one is
    /// at least as high.
    pub measured: bool,
}

impl Bandwidth {
    /// What people read before the rate: nothing if it was measured.
    pub(super) fn hedge(&self) -> &'static str {
        if self.measured { "" } else { "at least " }
    }
}

/// What a number of threads can do together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// The number of threads.
    pub threads: usize,
    /// Copying what stays in L1.
    pub l1: Bandwidth,
    /// Copying what stays in L2.
    pub l2: Bandwidth,
    /// Copying what comes from memory. The system's copy routine writes around the caches there,
    /// so that no line is read before it is overwritten: the rate is that of the bus.
    pub memory: Bandwidth,
    /// Operations on f32 per second: a multiplication and an addition, not fused, count as two.
    pub compute: f64,
}

impl Rates {
    /// Measures this machine for one to five seconds, with `threads` threads (0: one for each core)
    /// and an instruction set.
    ///
    /// # Errors
    /// If the threads cannot be started, or the machine makes mistakes.
    pub fn measure(machine: &Machine, simd: Simd, threads: usize) -> Result<Self, RooflineError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|error| RooflineError::Threads { threads, error })?;
        let threads = pool.current_num_threads();
        let [l1, l2, l3] = machine.levels().map(|level| level.bytes);
        // Threads may sit on clusters of cores with an L3 each, so the arrays grow with them.
        let far = l3.saturating_mul(threads.saturating_mul(2).max(8) as u64);
        let most = memory::free().map_or(MOST_UNTOLD, |free| free / MEMORY_SHARE);
        let near = |cache: u64| (cache / 2).saturating_mul(threads as u64).min(most);
        let copies = [near(l1), near(l2), far.min(most)].map(|bytes| Copying::new(&pool, bytes));
        let mut rates = [0.0; 3];
        let mut operations = 0.0;
        for round in 0..MOST_ROUNDS {
            if round >= FEWEST_ROUNDS && is_falling(rates) {
                break;
            }
            for (rate, copying) in rates.iter_mut().zip(&copies) {
                *rate = f64::max(*rate, copying.rate(&pool)?);
            }
            operations = f64::max(operations, compute(&pool, simd)?);
        }
        let [l1, l2, memory] = bandwidths(copies.map(|copying| copying.bytes), rates);
        Ok(Self { threads, l1, l2, memory, compute: operations })
    }

    /// The rate of copying there.
    pub fn bandwidth(&self, store: Store) -> Bandwidth {
        match store {
            Store::L1 => self.l1,
            Store::L2 => self.l2,
            Store::Memory => self.memory,
        }
    }

    /// The ceiling for work on data that is there.
    pub fn ceiling(&self, store: Store) -> Ceiling {
        Ceiling { compute: self.compute, bandwidth: self.bandwidth(store).rate }
    }
}

/// Whether no cache seems slower than what lies beyond it; rates are in the order of the stores.
fn is_falling(rates: [f64; 3]) -> bool {
    rates.is_sorted_by(|near, far| near >= far)
}

/// What is believed of measured rates, in the order of the stores.
fn bandwidths(bytes: [u64; 3], rates: [f64; 3]) -> [Bandwidth; 3] {
    let mut beyond = 0.0;
    let mut bandwidths = array::from_fn(|store| Bandwidth {
        bytes: bytes[store],
        rate: rates[store],
        measured: true,
    });
    for bandwidth in bandwidths.iter_mut().rev() {
        bandwidth.measured = bandwidth.rate >= beyond;
        bandwidth.rate = bandwidth.rate.max(beyond);
        beyond = bandwidth.rate;
    }
    bandwidths
}

/// The best that work can do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ceiling {
    /// Operations per second, positive.
    pub compute: f64,
    /// Bytes per second, positive.
    pub bandwidth: f64,
}

/// What a phase did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// Arithmetic operations.
    pub operations: f64,
    /// Bytes read and written in the store that the ceiling is for.
    pub bytes: f64,
    /// How long it took.
    pub seconds: f64,
}

/// What a phase cannot be faster than.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Bound {
    /// The rate of operations.
    Compute,
    /// The rate of bytes.
    Memory,
}

/// A phase under its ceiling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RooflinePoint {
    /// Operations for each byte; none if there are no bytes.
    pub intensity: Option<f64>,
    /// Operations per second that this intensity allows.
    pub attainable: f64,
    /// Operations per second that there were.
    pub attained: f64,
    /// What the ceiling consists of there.
    pub bound: Bound,
    /// The least time that the work needs, over the time it took. Above 1 the data was nearer
    /// than assumed.
    pub share: f64,
}

impl Ceiling {
    /// Compares a phase with the ceiling.
    ///
    /// # Errors
    /// If the phase did nothing or took no time, or a number is negative or not finite.
    pub fn place(&self, work: Work) -> Result<RooflinePoint, RooflineError> {
        let Work { operations, bytes, seconds } = work;
        let numbers = [operations, bytes, seconds].iter().all(|x| x.is_finite() && *x >= 0.0);
        if !numbers || seconds == 0.0 || operations + bytes == 0.0 {
            return Err(RooflineError::Work(work));
        }
        let (computing, moving) = (operations / self.compute, bytes / self.bandwidth);
        let intensity = (bytes > 0.0).then(|| operations / bytes);
        let slope = intensity.map_or(f64::INFINITY, |intensity| intensity * self.bandwidth);
        Ok(RooflinePoint {
            intensity,
            attainable: self.compute.min(slope),
            attained: operations / seconds,
            bound: if computing >= moving { Bound::Compute } else { Bound::Memory },
            share: computing.max(moving) / seconds,
        })
    }
}

/// What a thread had done at a moment.
#[derive(Debug, Clone, Copy)]
struct Mark {
    /// Seconds since the measurement began.
    at: f64,
    /// Repeats so far.
    done: f64,
}

/// The best rate at which all threads of a pool do `work(thread, repeats)`, in units per second,
/// where each thread does `units` in one repeat. Goes on for `time`.
///
/// Threads do not wait for each other in between: on a busy machine that takes longer than the work.
fn best(pool: &ThreadPool, time: Duration, units: f64, work: impl Fn(usize, u64) + Sync) -> f64 {
    let begun = Instant::now();
    let threads = pool.broadcast(|context| {
        let mut last = begun.elapsed();
        let mut marks = vec![Mark { at: last.as_secs_f64(), done: 0.0 }];
        let (mut done, mut repeats) = (0, 1_u64);
        loop {
            work(context.index(), repeats);
            done += repeats;
            let now = begun.elapsed();
            marks.push(Mark { at: now.as_secs_f64(), done: done as f64 });
            if now >= time {
                return marks;
            }
            if now - last < PIECE {
                repeats = repeats.saturating_mul(2);
            }
            last = now;
        }
    });
    units * fastest(&threads)
}

/// The most repeats per second of all threads together in any window; marks are in the order of
/// time.
fn fastest(threads: &[Vec<Mark>]) -> f64 {
    let end = threads.iter().filter_map(|marks| marks.last()).fold(0.0, |end, it| it.at.max(end));
    let windows = (end / WINDOW * WINDOWS_IN_ONE).ceil() as usize;
    let done = |at: f64| threads.iter().map(|marks| done(marks, at)).sum::<f64>();
    let rate = |window: usize| {
        let begin = window as f64 * WINDOW / WINDOWS_IN_ONE;
        (done(begin + WINDOW) - done(begin)) / WINDOW
    };
    (0..windows).map(rate).fold(0.0, f64::max)
}

/// What a thread had done at a moment, evenly in between its marks.
fn done(marks: &[Mark], at: f64) -> f64 {
    let next = marks.partition_point(|mark| mark.at <= at);
    match (marks[..next].last(), marks.get(next)) {
        (Some(a), Some(b)) => a.done + (b.done - a.done) * (at - a.at) / (b.at - a.at),
        (Some(last), None) => last.done,
        (None, _) => 0.0,
    }
}

/// As much as processors move at once, so that no move straddles two lines of a cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
struct CacheLine([u64; 8]);

/// The two arrays of a thread.
struct Lane {
    source: Vec<CacheLine>,
    target: Vec<CacheLine>,
    batches: u64,
}

impl Lane {
    fn new(lines: usize) -> Self {
        let source = (0..lines as u64).map(|i| CacheLine([i; 8])).collect();
        Self { source, target: vec![CacheLine([u64::MAX; 8]); lines], batches: 0 }
    }

    /// Copies all of it so many times; returns whether something new arrived.
    fn copy(&mut self, repeats: u64) -> bool {
        self.batches += 1;
        let place = self.batches as usize % self.source.len();
        self.source[place].0[0] = u64::MAX - self.batches;
        for _ in 0..repeats {
            black_box(&mut self.target).copy_from_slice(black_box(&self.source));
        }
        self.target[place].0[0] == u64::MAX - self.batches
    }

    /// Whether everything arrived.
    fn whole(&self) -> bool {
        self.source == self.target
    }
}

/// Arrays that all threads of a pool copy.
struct Copying {
    /// One of them for each thread.
    lanes: Vec<Mutex<Lane>>,
    /// Lines in each of a thread's arrays.
    lines: u64,
    /// Bytes of all arrays.
    bytes: u64,
}

impl Copying {
    /// Arrays of `bytes` bytes in all, at least a line in each.
    fn new(pool: &ThreadPool, bytes: u64) -> Self {
        let pair = (2 * size_of::<CacheLine>()) as u64;
        let lines = (bytes / pair / pool.current_num_threads() as u64).max(1);
        // Each thread makes its own, so that they are in the memory nearest to it.
        let lanes = pool.broadcast(|_| Mutex::new(Lane::new(lines as usize)));
        Self { bytes: lines * pair * lanes.len() as u64, lanes, lines }
    }

    /// How fast all threads copy them, in bytes read plus bytes written per second.
    fn rate(&self, pool: &ThreadPool) -> Result<f64, RooflineError> {
        let right = AtomicBool::new(true);
        let lane =
            |thread: usize| self.lanes[thread].lock().unwrap_or_else(|lane| lane.into_inner());
        let bytes = (2 * size_of::<CacheLine>()) as f64 * self.lines as f64;
        let rate = best(pool, DURATION, bytes, |thread, repeats| {
            if !lane(thread).copy(repeats) {
                right.store(false, Ordering::Relaxed);
            }
        });
        let whole = pool.broadcast(|context| lane(context.index()).whole());
        if !right.into_inner() || whole.contains(&false) {
            return Err(RooflineError::Wrong("copies"));
        }
        Ok(rate)
    }
}

/// Chains of a multiplication and an addition each, with `LANES` f32 in all.
struct Chain<const LANES: usize> {
    repeats: u64,
    factor: f32,
    term: f32,
}

impl<const LANES: usize> Vectorized for Chain<LANES> {
    type Output = f32;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> f32 {
        let Self { repeats, factor, term } = self;
        let mut lanes: [f32; LANES] = array::from_fn(|lane| lane as f32);
        for _ in 0..repeats {
            for x in &mut lanes {
                *x = *x * factor + term;
            }
        }
        lanes.iter().sum()
    }
}

/// How fast all threads of a pool compute.
///
/// How many chains hide the latency of an operation and still fit into the registers depends on
/// the processor, and whether a loop of so many becomes wide instructions on the compiler: 48
/// lanes ran at a sixth of the rate of 56 (baseline x86-64, Rust 1.95). So several are tried.
fn compute(pool: &ThreadPool, simd: Simd) -> Result<f64, RooflineError> {
    let rates = [
        compute_lanes::<32>(pool, simd)?,
        compute_lanes::<56>(pool, simd)?,
        compute_lanes::<96>(pool, simd)?,
        compute_lanes::<112>(pool, simd)?,
    ];
    Ok(rates.into_iter().fold(0.0, f64::max))
}

fn compute_lanes<const LANES: usize>(pool: &ThreadPool, simd: Simd) -> Result<f64, RooflineError> {
    /// Numbers of lanes that are tried.
    const TRIED: u32 = 4;
    /// Steps that a repeat stands for; even, so that each number comes back: x → 3 − x → x.
    const STEPS: u64 = 64;
    let right = AtomicBool::new(true);
    let rate = best(pool, DURATION / TRIED, (STEPS as usize * LANES * 2) as f64, |_, repeats| {
        let repeats = STEPS.saturating_mul(repeats);
        let chain = Chain::<LANES> { repeats, factor: black_box(-1.0), term: black_box(3.0) };
        if black_box(simd.run(chain)) != (LANES * (LANES - 1) / 2) as f32 {
            right.store(false, Ordering::Relaxed);
        }
    });
    if right.into_inner() { Ok(rate) } else { Err(RooflineError::Wrong("computes")) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CEILING: Ceiling = Ceiling { compute: 100e9, bandwidth: 20e9 };

    fn place(operations: f64, bytes: f64, seconds: f64) -> RooflinePoint {
        CEILING.place(Work { operations, bytes, seconds }).unwrap()
    }

    #[test]
    fn the_roof_has_two_sides() {
        // The ridge is at five operations a byte.
        let slope = place(2e9, 1e9, 0.1);
        assert_eq!(slope.intensity, Some(2.0));
        assert_eq!((slope.attainable, slope.attained), (40e9, 20e9));
        assert_eq!((slope.bound, slope.share), (Bound::Memory, 0.5));
        let flat = place(10e9, 1e9, 0.4);
        assert_eq!((flat.attainable, flat.attained), (100e9, 25e9));
        assert_eq!((flat.bound, flat.share), (Bound::Compute, 0.25));
        assert_eq!(place(5e9, 1e9, 0.1).bound, Bound::Compute);
    }

    #[test]
    fn pure_copying_and_pure_computing_have_a_place() {
        let copying = place(0.0, 2e9, 0.2);
        assert_eq!((copying.bound, copying.share, copying.attainable), (Bound::Memory, 0.5, 0.0));
        let computing = place(1e9, 0.0, 0.01);
        assert_eq!((computing.intensity, computing.attainable), (None, 100e9));
        assert_eq!((computing.bound, computing.share), (Bound::Compute, 1.0));
    }

    #[test]
    fn no_work_has_no_place() {
        let bad = [f64::NAN, f64::INFINITY, -1.0];
        let cases = bad.iter().flat_map(|&x| [(x, 1.0, 1.0), (1.0, x, 1.0), (1.0, 1.0, x)]);
        for (operations, bytes, seconds) in cases.chain([(0.0, 0.0, 1.0), (1.0, 1.0, 0.0)]) {
            let work = Work { operations, bytes, seconds };
            assert!(matches!(CEILING.place(work), Err(RooflineError::Work(_))), "{work:?}");
        }
    }

    proptest! {
        #[test]
        fn the_share_is_that_of_the_attainable_rate(
            operations in 1.0..1e15_f64, bytes in 1.0..1e15_f64, seconds in 1e-6..1e6_f64,
        ) {
            let found = place(operations, bytes, seconds);
            let share = found.attained / found.attainable;
            prop_assert!((found.share - share).abs() <= 1e-12 * share);
            let roof = CEILING.compute.min(operations / bytes * CEILING.bandwidth);
            prop_assert_eq!(found.attainable, roof);
        }
    }

    /// Marks of a thread that does repeats at these rates, each for so many milliseconds.
    fn marks(phases: &[(f64, u32)]) -> Vec<Mark> {
        let mut mark = Mark { at: 0.0, done: 0.0 };
        let mut marks = vec![mark];
        for &(rate, milliseconds) in phases {
            for _ in 0..milliseconds {
                mark = Mark { at: mark.at + 1e-3, done: mark.done + rate * 1e-3 };
                marks.push(mark);
            }
        }
        marks
    }

    #[test]
    fn the_fastest_window_is_found() {
        let steady = || marks(&[(1000.0, 100)]);
        let near = |threads: &[Vec<Mark>], expected: f64| {
            let rate = fastest(threads);
            assert!((rate - expected).abs() < 1e-9 * expected, "{rate}, not {expected}");
        };
        near(&[steady()], 1000.0);
        near(&[steady(), steady()], 2000.0);
        // Somebody else has the core nearly all the time.
        near(&[steady(), marks(&[(0.0, 60), (1000.0, 4), (0.0, 36)])], 2000.0);
        // The threads never work at the same time.
        near(&[marks(&[(1000.0, 50), (0.0, 50)]), marks(&[(0.0, 50), (1000.0, 50)])], 1000.0);
        // One piece that takes all the time, begun later.
        let long = |at: f64| vec![Mark { at, done: 0.0 }, Mark { at: at + 0.4, done: 40.0 }];
        near(&[long(0.0), long(0.3)], 200.0);
        near(&[long(0.0), long(0.5)], 100.0);
    }

    #[test]
    fn a_cache_is_never_slower_than_what_lies_beyond() {
        let believed = |rates: [f64; 3]| {
            let found = bandwidths([1, 2, 3], rates);
            assert_eq!(found.map(|bandwidth| bandwidth.bytes), [1, 2, 3]);
            assert_eq!(is_falling(rates), found.iter().all(|bandwidth| bandwidth.measured));
            found.map(|bandwidth| (bandwidth.rate, bandwidth.measured))
        };
        assert_eq!(believed([9.0, 5.0, 3.0]), [(9.0, true), (5.0, true), (3.0, true)]);
        assert_eq!(believed([9.0, 2.0, 3.0]), [(9.0, true), (3.0, false), (3.0, true)]);
        assert_eq!(believed([2.0, 2.5, 3.0]), [(3.0, false), (3.0, false), (3.0, true)]);
        assert_eq!(believed([2.0, 5.0, 3.0]), [(5.0, false), (5.0, true), (3.0, true)]);
        assert_eq!(believed([4.0, 4.0, 4.0]), [(4.0, true), (4.0, true), (4.0, true)]);
        assert_eq!(believed([4.0, 0.0, 4.0]), [(4.0, true), (4.0, false), (4.0, true)]);
    }

    #[test]
    fn this_machine_has_rates() {
        let machine = Machine::detect();
        // What is free changes while others work.
        let memory = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
        let total = memory.split_whitespace().nth(1).and_then(|total| total.parse().ok());
        let total: u64 = total.map_or(u64::MAX, |kilobytes: u64| 1024 * kilobytes);
        for simd in [Simd::plain(), Simd::detect()] {
            for threads in [1, 2] {
                let rates = Rates::measure(&machine, simd, threads).unwrap();
                assert_eq!(rates.threads, threads);
                let all = [rates.l1.rate, rates.l2.rate, rates.memory.rate, rates.compute];
                assert!(all.iter().all(|&rate| 0.0 < rate && rate < 1e14), "{rates:#?}");
                assert!(is_falling([rates.l1.rate, rates.l2.rate, rates.memory.rate]));
                assert!(rates.memory.measured);
                assert!(rates.memory.bytes <= total / 4);
                assert_eq!(rates.ceiling(Store::L2).bandwidth, rates.l2.rate);
            }
        }
    }

    #[test]
    fn both_instruction_sets_compute_the_same() {
        for simd in [Simd::plain(), Simd::detect()] {
            for repeats in [0, 1, 2, 7] {
                let sum = simd.run(Chain::<5> { repeats, factor: 0.5, term: 1.0 });
                let mut expected = [0.0, 1.0, 2.0, 3.0, 4.0_f32];
                for _ in 0..repeats {
                    expected = expected.map(|x| x * 0.5 + 1.0);
                }
                assert_eq!(sum, expected.iter().sum::<f32>());
            }
        }
    }
}
