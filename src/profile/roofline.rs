//! What this machine could do at best, and how near a phase of a run comes to it.
//!
//! The roofline model (Williams, Waterman, Patterson 2009): work of so many operations on so many
//! bytes takes at least the time of the operations at the machine's compute rate, and at least
//! the time of the bytes at its bandwidth. [`Rates::measure`] finds both rates by doing nothing
//! else for a moment, [`Ceiling::place`] compares.
//!
//! Rates are the best of many short batches, as STREAM reports them (McCalpin 1995): a ceiling
//! is what can be reached, not what is usual on a busy machine.

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

/// How long each rate is measured.
const DURATION: Duration = Duration::from_millis(300);
/// Shortest batch that counts: waking the threads, some ten microseconds, is lost in it.
const BATCH: Duration = Duration::from_millis(3);
/// Share of the free memory that is used at most.
const MEMORY_SHARE: u64 = 8;
/// Most bytes that are used where the system does not tell what is free.
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
    /// Measures this machine for somewhat more than a second, with `threads` threads (0: one for
    /// each core) and an instruction set.
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
        Ok(Self {
            threads,
            l1: copy(&pool, near(l1))?,
            l2: copy(&pool, near(l2))?,
            memory: copy(&pool, far.min(most))?,
            compute: compute(&pool, simd)?,
        })
    }

    /// The ceiling for work on data that is there.
    pub fn ceiling(&self, store: Store) -> Ceiling {
        let bandwidth = match store {
            Store::L1 => self.l1.rate,
            Store::L2 => self.l2.rate,
            Store::Memory => self.memory.rate,
        };
        Ceiling { compute: self.compute, bandwidth }
    }
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
pub struct Placement {
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
    pub fn place(&self, work: Work) -> Result<Placement, RooflineError> {
        let Work { operations, bytes, seconds } = work;
        let numbers = [operations, bytes, seconds].iter().all(|x| x.is_finite() && *x >= 0.0);
        if !numbers || seconds == 0.0 || operations + bytes == 0.0 {
            return Err(RooflineError::Work(work));
        }
        let (computing, moving) = (operations / self.compute, bytes / self.bandwidth);
        let intensity = (bytes > 0.0).then(|| operations / bytes);
        let slope = intensity.map_or(f64::INFINITY, |intensity| intensity * self.bandwidth);
        Ok(Placement {
            intensity,
            attainable: self.compute.min(slope),
            attained: operations / seconds,
            bound: if computing >= moving { Bound::Compute } else { Bound::Memory },
            share: computing.max(moving) / seconds,
        })
    }
}

/// The best rate at which all threads of a pool do `work(thread, repeats)`, in units per second,
/// where each thread does `units` in one repeat. Goes on for `time`.
fn best(pool: &ThreadPool, time: Duration, units: f64, work: impl Fn(usize, u64) + Sync) -> f64 {
    let units = units * pool.current_num_threads() as f64;
    let begun = Instant::now();
    let mut repeats = 1_u64;
    let mut best = 0.0;
    while best == 0.0 || begun.elapsed() < time {
        let batch = Instant::now();
        pool.broadcast(|context| work(context.index(), repeats));
        let took = batch.elapsed();
        if took < BATCH {
            repeats = repeats.saturating_mul(2);
        } else {
            best = f64::max(best, units * repeats as f64 / took.as_secs_f64());
        }
    }
    best
}

/// As much as processors move at once, so that no move straddles two lines of a cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
struct Line([u64; 8]);

/// The two arrays of a thread.
struct Lane {
    source: Vec<Line>,
    target: Vec<Line>,
    batches: u64,
}

impl Lane {
    fn new(lines: usize) -> Self {
        let source = (0..lines as u64).map(|i| Line([i; 8])).collect();
        Self { source, target: vec![Line([u64::MAX; 8]); lines], batches: 0 }
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

/// How fast all threads of a pool copy arrays of `bytes` bytes in all.
fn copy(pool: &ThreadPool, bytes: u64) -> Result<Bandwidth, RooflineError> {
    let pair = (2 * size_of::<Line>()) as u64;
    let lines = (bytes / pair / pool.current_num_threads() as u64).max(1);
    // Each thread makes its own, so that they are in the memory nearest to it.
    let lanes = pool.broadcast(|_| Mutex::new(Lane::new(lines as usize)));
    let right = AtomicBool::new(true);
    let lane = |thread: usize| lanes[thread].lock().unwrap_or_else(|lane| lane.into_inner());
    let rate = best(pool, DURATION, (lines * pair) as f64, |thread, repeats| {
        if !lane(thread).copy(repeats) {
            right.store(false, Ordering::Relaxed);
        }
    });
    let whole = pool.broadcast(|context| lane(context.index()).whole());
    if !right.into_inner() || whole.contains(&false) {
        return Err(RooflineError::Wrong("copies"));
    }
    Ok(Bandwidth { bytes: lines * pair * lanes.len() as u64, rate })
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
    const TRIED: u32 = 4;
    let time = DURATION / TRIED;
    let rates = [
        compute_lanes::<32>(pool, simd, time)?,
        compute_lanes::<56>(pool, simd, time)?,
        compute_lanes::<96>(pool, simd, time)?,
        compute_lanes::<112>(pool, simd, time)?,
    ];
    Ok(rates.into_iter().fold(0.0, f64::max))
}

fn compute_lanes<const LANES: usize>(
    pool: &ThreadPool,
    simd: Simd,
    time: Duration,
) -> Result<f64, RooflineError> {
    /// Steps that a repeat stands for; even, so that each number comes back: x → 3 − x → x.
    const STEPS: u64 = 64;
    let right = AtomicBool::new(true);
    let rate = best(pool, time, (STEPS as usize * LANES * 2) as f64, |_, repeats| {
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

    fn place(operations: f64, bytes: f64, seconds: f64) -> Placement {
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

    /// Wide margins: what holds on any machine that is not busy at every moment.
    #[test]
    fn this_machine_has_rates() {
        let machine = Machine::detect();
        for simd in [Simd::plain(), Simd::detect()] {
            for threads in [1, 2] {
                let measure = || Rates::measure(&machine, simd, threads).unwrap();
                let all = |rates: &Rates| {
                    [rates.l1.rate, rates.l2.rate, rates.memory.rate, rates.compute]
                };
                // A thread that gets no core for a while measures next to nothing.
                let idle = |rates: &Rates| all(rates).iter().all(|&rate| rate > 1e7);
                let rates = (0..20).map(|_| measure()).find(idle).expect("a moment's rest");
                println!("{}: {rates:#?}", simd.name());
                assert_eq!(rates.threads, threads);
                assert!(all(&rates).iter().all(|&rate| rate < 1e14), "{rates:#?}");
                let free = memory::free().unwrap_or(u64::MAX);
                assert!(rates.memory.bytes <= free / 4);
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
