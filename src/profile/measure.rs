//! How long steps of a descent take, as a whole and stage by stage.
//!
//! The whole is measured without probes, the stages with them. A probe's clock takes time itself,
//! which is measured as well and taken off the stages; so the time of all threads is that of the
//! stages, of waiting, and of the clock.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use perceptile_cluster::shared::MapError;
use serde::Serialize;

use super::spans::{Span, SpanProbe};
use super::stages::{StageProbe, StageTimes};
use super::subject::Subject;
use crate::gradient::probe::{Probe, Stage, Unprobed};
use crate::gradient::simd::Simd;
use crate::solver::{Descent, Samples};
use crate::tile::Layout;

/// Steps before those that count.
const WARM_UP: u32 = 2;
/// Fewest steps that count.
const FEWEST: u32 = 2;

/// Steps that were timed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Timing {
    /// Steps that count.
    pub steps: u32,
    /// Mean seconds of a step.
    pub seconds: f64,
}

/// Times of the stages, in nanoseconds of all threads together for a mean step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageTiming {
    /// The probed steps. With the clock's own time, they take longer than others.
    pub timing: Timing,
    /// For each thread, its time in each stage, in the order of [`Stage::ALL`]; the last is
    /// waiting: for other threads, or for what only one of them does between the stages.
    pub threads: Vec<[f64; Stage::ALL.len()]>,
    /// For each thread, the time that the clock took.
    pub clock: Vec<f64>,
    /// Nanoseconds of one look at the clock.
    pub look: f64,
}

impl StageTiming {
    /// The time of a stage in all threads.
    pub fn of(&self, stage: Stage) -> f64 {
        self.threads.iter().map(|thread| thread[stage as usize]).sum()
    }

    /// The time of all stages, waiting included.
    pub fn sum(&self) -> f64 {
        self.threads.iter().flatten().sum()
    }
}

/// Does warm-up steps, then as many as fit into `time`.
fn steps<P: Probe>(descent: &mut Descent<P>, time: Duration, mut warm: impl FnMut()) -> Timing {
    for step in 0..WARM_UP {
        descent.step(step);
    }
    warm();
    let begun = Instant::now();
    let mut steps = 0;
    while steps < FEWEST || begun.elapsed() < time {
        descent.step(WARM_UP + steps);
        steps += 1;
    }
    Timing { steps, seconds: begun.elapsed().as_secs_f64() / f64::from(steps) }
}

/// Times steps in a layout for about `time`, without probes. To be called by a thread of the
/// pool that is to do them, as all functions here.
///
/// # Errors
/// If there is no memory for it, as all functions here.
pub fn whole(
    subject: &Subject,
    layout: Layout,
    simd: Simd,
    samples: &Samples,
    time: Duration,
    warm: impl FnMut(),
) -> Result<Timing, MapError> {
    let mut descent = subject.descent(layout, simd, samples, || Unprobed)?;
    Ok(steps(&mut descent, time, warm))
}

/// Times the stages for about `time`.
pub fn stages(
    subject: &Subject,
    simd: Simd,
    samples: &Samples,
    time: Duration,
) -> Result<StageTiming, MapError> {
    let threads = rayon::current_num_threads();
    let counting = Arc::new(AtomicU32::new(0));
    let probe = || ByThread {
        probes: vec![StageProbe::new(); threads],
        warm: vec![StageTimes::default(); threads],
        now: 0,
        counting: counting.clone(),
        counted: false,
    };
    let mut descent = subject.descent(Layout::Rows, simd, samples, probe)?;
    let timing = steps(&mut descent, time, || counting.store(1, Ordering::Relaxed));
    let look = look();
    let per_step = 1.0 / f64::from(timing.steps);
    let mut table = vec![[0.0; Stage::ALL.len()]; threads];
    let mut clock = vec![0.0; threads];
    // A probe that was not lent any more has seen nothing that counts.
    for probe in descent.into_probes().into_iter().filter(|probe| probe.counted) {
        for (thread, (own, warm)) in probe.probes.iter().zip(&probe.warm).enumerate() {
            let times = own.times();
            for (stage, sum) in table[thread].iter_mut().enumerate() {
                let took = (times.nanoseconds[stage] - warm.nanoseconds[stage]) as f64;
                let looks = (times.passed[stage] - warm.passed[stage]) as f64;
                let looking = (looks * look).min(took);
                *sum += (took - looking) * per_step;
                clock[thread] += looking * per_step;
            }
        }
    }
    for (stages, clock) in table.iter_mut().zip(&clock) {
        let busy = stages.iter().sum::<f64>() + clock;
        stages[Stage::Waiting as usize] = (timing.seconds * 1e9 - busy).max(0.0);
    }
    Ok(StageTiming { timing, threads: table, clock, look })
}

/// A probe that knows which thread it is lent to.
#[derive(Debug, Clone)]
struct ByThread {
    probes: Vec<StageProbe>,
    /// What was found in steps that do not count.
    warm: Vec<StageTimes>,
    now: usize,
    counting: Arc<AtomicU32>,
    counted: bool,
}

impl Probe for ByThread {
    fn begin(&mut self) {
        if !self.counted && self.counting.load(Ordering::Relaxed) > 0 {
            self.counted = true;
            self.warm = self.probes.iter().map(StageProbe::times).collect();
        }
        self.now = rayon::current_thread_index().unwrap_or(0);
        self.probes[self.now].begin();
    }

    #[inline(always)]
    fn lap(&mut self, stage: Stage) {
        self.probes[self.now].lap(stage);
    }
}

/// Nanoseconds of one look at the clock: the best of several batches.
fn look() -> f64 {
    const LOOKS: u32 = 10_000;
    let batch = |_| {
        let mut probe = ByThread {
            probes: vec![StageProbe::new()],
            warm: Vec::new(),
            now: 0,
            counting: Arc::default(),
            counted: false,
        };
        let begun = Instant::now();
        for _ in 0..LOOKS {
            std::hint::black_box(&mut probe).lap(Stage::Draws);
        }
        begun.elapsed().as_nanos() as f64 / f64::from(LOOKS)
    };
    (0..20).map(batch).fold(f64::INFINITY, f64::min)
}

/// Steps that a trace shows.
pub const TRACED: u32 = 12;
/// The first steps of a trace, which show the stages of every draw.
pub const DETAILED: u32 = 2;

/// Spans of threads, and beginning and duration of whole steps.
pub type Spans = (Vec<Span>, Vec<(Duration, Duration)>);

/// What all threads did in a few steps: spans of threads, and those of whole steps, from the
/// moment on at which the first one began.
pub fn spans(
    subject: &Subject,
    simd: Simd,
    samples: &Samples,
    most: usize,
) -> Result<Spans, MapError> {
    let step = Arc::new(AtomicU32::new(0));
    let threads = rayon::current_num_threads();
    let begun = Instant::now();
    let probe = || SpanProbe::new(begun, step.clone(), DETAILED, most / threads);
    let mut descent = subject.descent(Layout::Rows, simd, samples, probe)?;
    let mut whole = Vec::new();
    for number in 0..TRACED {
        step.store(number, Ordering::Relaxed);
        let start = begun.elapsed();
        descent.step(number);
        whole.push((start, begun.elapsed() - start));
    }
    let origin = whole[0].0;
    let mut spans: Vec<Span> =
        descent.into_probes().into_iter().flat_map(SpanProbe::into_spans).collect();
    for span in &mut spans {
        span.start = span.start.saturating_sub(origin);
    }
    whole.iter_mut().for_each(|(start, _)| *start -= origin);
    spans.sort_by_key(|span| (span.thread, span.start));
    Ok((spans, whole))
}
