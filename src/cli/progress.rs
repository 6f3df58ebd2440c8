//! What people see of a run while it goes on, and how they end it.

use std::io;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use perceptile::run::observer::{Observer, Progress};
use perceptile::run::signals::Signals;
use perceptile::solver::{Phase, StopReason};

use super::stream::say;

/// Shows progress on the standard error, and stops the run for signals and the clock.
pub struct Terminal {
    bar: ProgressBar,
    signals: Signals,
    deadline: Option<Instant>,
    phase: Phase,
}

impl Terminal {
    /// Listens for signals from now on. A rank that is not the first shows nothing.
    ///
    /// # Errors
    /// What the system reports.
    pub fn open(is_first: bool) -> io::Result<Self> {
        let bar = if is_first { progress_bar() } else { ProgressBar::hidden() };
        let shown = bar.clone();
        let signals = Signals::install(move |_| {
            if is_first {
                shown.suspend(|| {
                    say(
                        "stopping: the tile so far is made uniform and written; once more ends the \
                         run at once, without it",
                    );
                });
            }
        })?;
        Ok(Self { bar, signals, deadline: None, phase: Phase::Start })
    }

    /// Stops the run when this time has passed from now on.
    pub fn limit(&mut self, time: Option<Duration>) {
        self.deadline = time.and_then(|time| Instant::now().checked_add(time));
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// The exit code for the signal that has arrived, if one has.
    pub fn received(&self) -> Option<i32> {
        self.signals.received()
    }
}

impl Observer for Terminal {
    fn progress(&mut self, progress: Progress) {
        if progress.phase != self.phase {
            self.phase = progress.phase;
            self.bar.reset();
            self.bar.set_length(progress.of.into());
            self.bar.set_prefix(progress.phase.name());
        }
        let mut words = Vec::new();
        if let Some(objective) = progress.objective {
            words.push(format!("objective {objective:.6}"));
        }
        match progress.workers {
            Some((workers, 0)) => words.push(format!("{workers} workers")),
            Some((workers, lost)) => words.push(format!("{workers} workers, {lost} replaced")),
            None => (),
        }
        self.bar.set_message(words.join(", "));
        self.bar.set_position(progress.done.into());
    }

    fn report(&mut self, message: &str) {
        self.bar.suspend(|| say(message));
    }

    fn stop(&self) -> Option<StopReason> {
        if self.received().is_some() {
            Some(StopReason::Interrupted)
        } else if self.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            Some(StopReason::Time)
        } else {
            None
        }
    }
}

/// A bar on the standard error; without a terminal there, nothing.
fn progress_bar() -> ProgressBar {
    let template = "{prefix:8} {bar:32} {pos}/{len} steps, {per_sec}, ETA {eta}  {msg}";
    ProgressBar::no_length()
        .with_style(ProgressStyle::with_template(template).expect("a valid template"))
}
