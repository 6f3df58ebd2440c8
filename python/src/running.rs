//! Work on a thread of its own. The interpreter is free meanwhile; the thread that called looks for
//! signals and hands on progress, so that Python code runs only where Python's users expect it.

use std::any::Any;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use perceptile::Progress;
use perceptile::run::observer::Observer;
use perceptile::solver::{Parallelism, StopReason};
use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;

use crate::failure::Failure;

/// How often signals and progress are looked at.
const LOOK: Duration = Duration::from_millis(50);
/// How long work that was stopped may take to end; then it ends by itself, and nobody waits.
const PATIENCE: Duration = Duration::from_millis(500);

/// What those who work and the one who waits tell each other.
#[derive(Debug, Default)]
pub struct Watch {
    latest: Mutex<Option<(&'static str, u64, u64)>>,
    stops: AtomicBool,
    gives_up: AtomicBool,
}

impl Watch {
    /// Says where the work stands: what it does, and how many steps of how many are done.
    pub fn report(&self, phase: &'static str, step: u64, steps: u64) {
        *self.latest.lock().unwrap_or_else(PoisonError::into_inner) = Some((phase, step, steps));
    }

    /// Whether the work is to end.
    pub fn stops(&self) -> bool {
        self.stops.load(Ordering::Relaxed)
    }

    fn take(&self) -> Option<(&'static str, u64, u64)> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn stop(&self, gives_up: bool) {
        self.gives_up.fetch_or(gives_up, Ordering::Relaxed);
        self.stops.store(true, Ordering::Relaxed);
    }
}

/// As a run sees it.
pub struct Watcher(pub Arc<Watch>);

impl Observer for Watcher {
    fn progress(&mut self, progress: Progress) {
        self.0.report(progress.phase.name(), progress.done.into(), progress.of.into());
    }

    fn stop(&self) -> Option<StopReason> {
        self.0.stops().then_some(StopReason::Interrupted)
    }

    fn gives_up(&self) -> bool {
        self.0.gives_up.load(Ordering::Relaxed)
    }
}

/// Works by so many threads, as many as there are cores without a number. `progress` is called with
/// where the work stands, at most twenty times a second and once at the end; if it returns False, the
/// work ends early.
///
/// # Errors
/// What the work says; an exception of `progress` or of a signal, after which nobody wants what comes
/// of the work.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Arc<Watch>) -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    let threads = threads.unwrap_or(0);
    let most = Parallelism::MAX_THREADS;
    if threads > most {
        return Err(Failure::value(format!("{threads} threads are too many: at most {most}")));
    }
    let watch = Arc::new(Watch::default());
    let (sender, mut receiver) = mpsc::channel();
    let watched = Arc::clone(&watch);
    let worker = move || {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build();
        let refused = |error| Failure::run(format!("{threads} threads cannot be had: {error}"));
        let result = pool.map_err(refused).and_then(|pool| pool.install(|| work(&watched)));
        // Nobody listens after an exception.
        let _ = sender.send(result);
    };
    let refused = |error| Failure::run(format!("a thread cannot be had: {error}"));
    let worker = thread::Builder::new().spawn(worker).map_err(refused)?;
    let mut listen = |time| {
        let receiver = &mut receiver;
        py.detach(move || receiver.recv_timeout(time))
    };
    let report = || -> PyResult<()> {
        let Some((progress, latest)) = progress.zip(watch.take()) else { return Ok(()) };
        if progress.call1(latest)?.is(&**pyo3::types::PyBool::new(py, false)) {
            watch.stop(false);
        }
        Ok(())
    };
    loop {
        match listen(LOOK) {
            Ok(result) => {
                report()?;
                return result;
            }
            Err(RecvTimeoutError::Timeout) => {
                if let Err(error) = py.check_signals().and_then(|()| report()) {
                    watch.stop(true);
                    let _ = listen(PATIENCE);
                    return Err(error.into());
                }
            }
            Err(RecvTimeoutError::Disconnected) => {
                let panic = py.detach(|| worker.join()).err();
                return Err(Failure::run(panic.map_or_else(String::new, |panic| words(&*panic))));
            }
        }
    }
}

/// What a thread that panicked said.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("it panicked");
    format!("the work failed, which is a mistake in Perceptile: {text}")
}
