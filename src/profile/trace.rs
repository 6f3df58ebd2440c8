//! Who did what when, in a file that Perfetto and Chrome show as tracks.
//!
//! The format is the JSON object of the "Trace Event Format" (Google, 2016), which
//! <https://ui.perfetto.dev> opens: complete events (`X`) with a start and a duration in
//! microseconds, counters (`C`), and metadata (`M`) that names tracks. Viewers nest the events of
//! a track by their times, in whatever order they were written.
//!
//! Events are written as they come, so that a trace takes no memory. Its length is bounded: past
//! the limit events are dropped, and the file says how many.

use std::io::{self, BufWriter, Write};
use std::time::Duration;

use serde::Serialize;
use serde_json::{Map, Value};

/// The process of all events; a trace shows one.
const PROCESS: u32 = 1;

/// One event as the format has it. Fields that it does not use are left out.
#[derive(Debug, Serialize)]
struct TraceEvent<'a> {
    ph: &'static str,
    pid: u32,
    tid: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    ts: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dur: Option<f64>,
    name: &'a str,
    #[serde(skip_serializing_if = "Map::is_empty")]
    args: Map<String, Value>,
}

/// A trace that is being written.
///
/// ```
/// use std::time::Duration;
/// use perceptile::profile::trace::Trace;
///
/// let mut trace = Trace::new(Vec::new(), "perceptile", 1000)?;
/// trace.thread(0, "worker 0")?;
/// trace.complete(0, "step", Duration::from_micros(10), Duration::from_nanos(2500), &[])?;
/// trace.counter("objective", Duration::from_micros(12), &[("mean", 0.25)])?;
/// assert!(trace.finish()?.starts_with(b"{\"traceEvents\":["));
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug)]
pub struct Trace<W: Write> {
    out: BufWriter<W>,
    /// Events that may still be written.
    left: u64,
    limit: u64,
    dropped: u64,
}

impl<W: Write> Trace<W> {
    /// Begins a trace of a process of this name, of at most `limit` events; names of tracks do
    /// not count.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(out: W, process: &str, limit: u64) -> io::Result<Self> {
        let mut trace = Self { out: BufWriter::new(out), left: limit, limit, dropped: 0 };
        trace.out.write_all(b"{\"traceEvents\":[\n")?;
        // No event of the list begins with a comma, so the first one is written here.
        trace.write(&metadata(0, "process_name", "name", process.into()))?;
        Ok(trace)
    }

    /// Names a thread's track; tracks are shown in the order of their numbers.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn thread(&mut self, thread: u32, name: &str) -> io::Result<()> {
        self.next(&metadata(thread, "thread_name", "name", name.into()))?;
        self.next(&metadata(thread, "thread_sort_index", "sort_index", thread.into()))
    }

    /// Something that a thread did, `start` after the trace's zero and for `duration`, with
    /// what a viewer shall show beside it.
    ///
    /// Times keep their nanoseconds for traces of up to a month.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn complete(
        &mut self,
        thread: u32,
        name: &str,
        start: Duration,
        duration: Duration,
        details: &[(&str, Value)],
    ) -> io::Result<()> {
        if !self.admit() {
            return Ok(());
        }
        let args = details.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        self.next(&TraceEvent {
            ph: "X",
            pid: PROCESS,
            tid: thread,
            ts: Some(microseconds(start)),
            dur: Some(microseconds(duration)),
            name,
            args,
        })
    }

    /// The values that a counter's series have from a time on. Those that are not finite are left
    /// out, as the format has no way to write them.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn counter(&mut self, name: &str, at: Duration, series: &[(&str, f64)]) -> io::Result<()> {
        let finite = series.iter().filter(|(_, value)| value.is_finite());
        let args: Map<_, _> =
            finite.map(|&(key, value)| (key.to_owned(), Value::from(value))).collect();
        if args.is_empty() || !self.admit() {
            return Ok(());
        }
        let ts = Some(microseconds(at));
        self.next(&TraceEvent { ph: "C", pid: PROCESS, tid: 0, ts, dur: None, name, args })
    }

    /// Events that did not fit.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Completes the file and gives the writer back, flushed.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        let notes = serde_json::json!({
            "displayTimeUnit": "ns",
            "otherData": { "limit": self.limit, "dropped": self.dropped },
        });
        // The object is open already: its own brace is replaced by the end of the list.
        let notes = notes.to_string();
        self.out.write_all(b"\n],")?;
        self.out.write_all(&notes.as_bytes()[1..])?;
        self.out.write_all(b"\n")?;
        let mut out = self.out.into_inner().map_err(io::IntoInnerError::into_error)?;
        out.flush()?;
        Ok(out)
    }

    /// Whether one more event fits; counts those that do not.
    fn admit(&mut self) -> bool {
        let fits = self.left > 0;
        self.left -= u64::from(fits);
        self.dropped += u64::from(!fits);
        fits
    }

    fn next(&mut self, event: &TraceEvent<'_>) -> io::Result<()> {
        self.out.write_all(b",\n")?;
        self.write(event)
    }

    fn write(&mut self, event: &TraceEvent<'_>) -> io::Result<()> {
        serde_json::to_writer(&mut self.out, event).map_err(io::Error::from)
    }
}

fn metadata<'a>(thread: u32, name: &'a str, key: &str, value: Value) -> TraceEvent<'a> {
    let args = Map::from_iter([(key.to_owned(), value)]);
    TraceEvent { ph: "M", pid: PROCESS, tid: thread, ts: None, dur: None, name, args }
}

/// The format's unit of time.
fn microseconds(time: Duration) -> f64 {
    time.as_nanos() as f64 / 1000.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIMIT: u64 = 100;

    fn begin() -> Trace<Vec<u8>> {
        Trace::new(Vec::new(), "test", LIMIT).unwrap()
    }

    fn parse(trace: Trace<Vec<u8>>) -> Value {
        serde_json::from_slice(&trace.finish().unwrap()).unwrap()
    }

    fn events(file: &Value, kind: &str) -> Vec<Value> {
        let all = file["traceEvents"].as_array().unwrap();
        all.iter().filter(|event| event["ph"] == kind).cloned().collect()
    }

    fn nanoseconds(value: &Value) -> u64 {
        (value.as_f64().unwrap() * 1000.0).round() as u64
    }

    #[test]
    fn an_empty_trace_is_complete() {
        let file = parse(begin());
        let expected = serde_json::json!({
            "traceEvents": [
                {"ph": "M", "pid": 1, "tid": 0, "name": "process_name", "args": {"name": "test"}},
            ],
            "displayTimeUnit": "ns",
            "otherData": {"limit": LIMIT, "dropped": 0},
        });
        assert_eq!(file, expected);
    }

    #[test]
    fn threads_get_tracks_with_names_that_survive() {
        let mut trace = begin();
        let names = ["plain", "\"quoted\" \\ \n\u{0}", "größer 速い"];
        for (thread, name) in names.iter().enumerate() {
            trace.thread(thread as u32, name).unwrap();
        }
        let file = parse(trace);
        let named: Vec<Value> =
            events(&file, "M").into_iter().filter(|event| event["name"] == "thread_name").collect();
        for (thread, name) in names.iter().enumerate() {
            assert_eq!(named[thread]["tid"], thread);
            assert_eq!(named[thread]["args"]["name"], *name);
        }
    }

    #[test]
    fn events_past_the_limit_are_counted_only() {
        let mut trace = begin();
        for i in 0..70 {
            let at = Duration::from_micros(i);
            trace.complete(0, "work", at, at, &[("i", i.into())]).unwrap();
            trace.counter("count", at, &[("a", i as f64), ("b", f64::NAN)]).unwrap();
        }
        trace.thread(0, "late").unwrap();
        assert_eq!(trace.dropped(), 40);
        let file = parse(trace);
        assert_eq!(file["otherData"]["dropped"], 40);
        assert_eq!(events(&file, "X").len() + events(&file, "C").len(), 100);
        assert_eq!(events(&file, "X")[3]["args"]["i"], 3);
        assert_eq!(events(&file, "C")[3]["args"], serde_json::json!({"a": 3.0}));
        assert!(events(&file, "M").iter().any(|event| event["args"]["name"] == "late"));
    }

    #[test]
    fn counters_without_a_finite_value_are_no_events() {
        let mut trace = begin();
        trace.counter("none", Duration::ZERO, &[]).unwrap();
        trace.counter("none", Duration::ZERO, &[("a", f64::INFINITY)]).unwrap();
        assert_eq!(events(&parse(trace), "C").len(), 0);
    }

    #[test]
    fn a_full_disk_is_an_error() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let trace = Trace::new(Full, "test", LIMIT).unwrap();
        assert_eq!(trace.finish().err().unwrap().kind(), io::ErrorKind::StorageFull);
    }

    proptest! {
        /// A run of phases with steps in them, each a few nanoseconds to hours long.
        #[test]
        fn nested_work_stays_nested(
            phases in prop::collection::vec(
                prop::collection::vec((0..1_u64 << 40, 0..1_u64 << 40), 1..5), 1..5),
        ) {
            let mut trace = begin();
            let mut now = 0;
            let mut expected = Vec::new();
            for (thread, steps) in (0..).zip(&phases) {
                let start = now;
                for &(pause, work) in steps {
                    now += pause;
                    let (at, long) = (Duration::from_nanos(now), Duration::from_nanos(work));
                    trace.complete(thread, "step", at, long, &[]).unwrap();
                    expected.push((thread, "step", now, work));
                    now += work;
                }
                let (at, long) = (Duration::from_nanos(start), Duration::from_nanos(now - start));
                trace.complete(thread, "phase", at, long, &[]).unwrap();
                expected.push((thread, "phase", start, now - start));
            }
            let file = parse(trace);
            let found: Vec<_> = events(&file, "X");
            prop_assert_eq!(found.len(), expected.len());
            for (event, (thread, name, start, long)) in found.iter().zip(&expected) {
                prop_assert_eq!(&event["tid"], &Value::from(*thread));
                prop_assert_eq!(&event["name"], &Value::from(*name));
                prop_assert_eq!(nanoseconds(&event["ts"]), *start);
                prop_assert_eq!(nanoseconds(&event["dur"]), *long);
            }
            // As a viewer does it: in a track, each step lies within the phase.
            let ends = |event: &Value| {
                let start = nanoseconds(&event["ts"]);
                (start, start + nanoseconds(&event["dur"]))
            };
            for phase in found.iter().filter(|event| event["name"] == "phase") {
                let mut before = ends(phase).0;
                for step in found.iter().filter(|event| event["name"] == "step") {
                    if step["tid"] == phase["tid"] {
                        let (start, end) = ends(step);
                        prop_assert!(before <= start && end <= ends(phase).1);
                        before = end;
                    }
                }
            }
        }
    }
}
