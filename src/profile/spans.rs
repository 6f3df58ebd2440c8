//! What each thread did when: the raw material of a trace.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::trace::Trace;
use crate::gradient::probe::{Probe, Stage};

/// Something that a thread did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Span {
    /// The thread's number in the pool.
    pub thread: usize,
    /// The step.
    pub step: u32,
    /// What it was: a stage, or the whole of what a thread took on at once.
    pub work: Activity,
    /// When it began.
    pub start: Duration,
    /// How long it took.
    pub duration: Duration,
}

/// What a thread does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activity {
    /// All draws of a block.
    Gradient,
    /// One line of the tile.
    Update,
    /// A stage of one of them.
    Stage(Stage),
}

impl Activity {
    /// Its name as people read it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gradient => "gradient",
            Self::Update => "update",
            Self::Stage(stage) => stage.name(),
        }
    }
}

/// A probe that keeps the spans of one thread at a time.
#[derive(Debug)]
pub struct SpanProbe {
    zero: Instant,
    /// The step that is done now.
    step: Arc<AtomicU32>,
    /// Steps of which every stage is kept.
    detailed: u32,
    most: usize,
    now: u32,
    thread: usize,
    begun: Duration,
    last: Duration,
    stage: Option<Stage>,
    spans: Vec<Span>,
}

impl SpanProbe {
    /// A probe with times from `zero` on, which keeps stages in the first `detailed` steps, and
    /// at most `most` spans.
    pub fn new(zero: Instant, step: Arc<AtomicU32>, detailed: u32, most: usize) -> Self {
        Self {
            zero,
            step,
            detailed,
            most,
            now: 0,
            thread: 0,
            begun: Duration::ZERO,
            last: Duration::ZERO,
            stage: None,
            spans: Vec::new(),
        }
    }

    /// All spans.
    pub fn into_spans(mut self) -> Vec<Span> {
        self.close();
        self.spans
    }

    /// Ends what the thread has taken on.
    fn close(&mut self) {
        let Some(stage) = self.stage.take() else { return };
        let work = match stage {
            Stage::Reduce | Stage::Adam => Activity::Update,
            _ => Activity::Gradient,
        };
        self.push(work, self.begun);
    }

    /// Keeps what went on from `start` to the last mark.
    fn push(&mut self, work: Activity, start: Duration) {
        if self.spans.len() < self.most {
            let Self { thread, now: step, last, .. } = *self;
            self.spans.push(Span { thread, step, work, start, duration: last - start });
        }
    }
}

impl Probe for SpanProbe {
    fn begin(&mut self) {
        self.close();
        self.thread = rayon::current_thread_index().unwrap_or(0);
        self.now = self.step.load(Ordering::Relaxed);
        self.begun = self.zero.elapsed();
        self.last = self.begun;
    }

    fn lap(&mut self, stage: Stage) {
        let start = self.last;
        self.last = self.zero.elapsed();
        self.stage = Some(stage);
        // Room is kept for the whole that the stages belong to.
        if self.now < self.detailed && self.spans.len() < self.most / 2 {
            self.push(Activity::Stage(stage), start);
        }
    }
}

/// Writes spans as a trace of at most `limit` events, with a track of whole steps and one for
/// each thread.
///
/// # Errors
/// If it cannot be written.
pub fn write(
    out: impl Write,
    threads: usize,
    spans: &[Span],
    steps: &[(Duration, Duration)],
    limit: u64,
) -> io::Result<()> {
    let mut trace = Trace::new(out, "perceptile", limit)?;
    trace.thread(0, "steps")?;
    for thread in 0..threads {
        trace.thread(thread as u32 + 1, &format!("thread {thread}"))?;
    }
    for (number, &(start, duration)) in steps.iter().enumerate() {
        trace.complete(0, &format!("step {number}"), start, duration, &[])?;
    }
    spans.iter().try_for_each(|span| event(&mut trace, 1, span))?;
    trace.finish().map(|_| ())
}

/// Writes the spans of worker processes as a trace of at most `limit` events, with a track for
/// each thread of each worker.
///
/// # Errors
/// If it cannot be written.
pub fn write_workers(
    out: impl Write,
    threads: usize,
    workers: &[Vec<Span>],
    limit: u64,
) -> io::Result<()> {
    let mut trace = Trace::new(out, "perceptile", limit)?;
    for (worker, spans) in workers.iter().enumerate() {
        let first = (worker * threads) as u32;
        for thread in 0..threads {
            trace.thread(first + thread as u32, &format!("worker {worker}, thread {thread}"))?;
        }
        spans.iter().try_for_each(|span| event(&mut trace, first, span))?;
    }
    trace.finish().map(|_| ())
}

/// Writes a span on the track of its thread, of which the first is given.
fn event(trace: &mut Trace<impl Write>, first: u32, span: &Span) -> io::Result<()> {
    let details = match span.work {
        Activity::Stage(_) => Vec::new(),
        Activity::Gradient | Activity::Update => vec![("step", span.step.into())],
    };
    let thread = first + span.thread as u32;
    trace.complete(thread, span.work.name(), span.start, span.duration, &details)
}
