//! What people and programs see of a run while it goes on, and how they end it.

use std::io;
use std::time::{Duration, Instant};

use perceptile::run::forecast::Forecast;
use perceptile::run::observer::{Observer, Progress};
use perceptile::run::signals::Signals;
use perceptile::solver::{Phase, StopReason};
use serde::Serialize;

use super::display::{Display, Shown};
use super::duration::in_words;
use super::stream::say;

/// Shows progress on the standard error, and stops the run for signals and the clock.
pub struct Terminal {
    display: Display,
    signals: Signals,
    deadline: Option<Instant>,
    forecast: Option<Forecast>,
    phase: Phase,
    /// When the phase was first heard of, and its steps that were done then.
    since: (Instant, u32),
}

/// A line for programs.
#[derive(Debug, Serialize)]
struct Line {
    phase: Phase,
    done: u32,
    of: u32,
    /// Steps per second.
    rate: f64,
    /// Seconds until the run is over, as far as is known.
    eta: Option<f64>,
    objective: Option<f64>,
}

impl Terminal {
    /// Listens for signals from now on. A rank that is not the first shows nothing.
    ///
    /// # Errors
    /// What the system reports.
    pub fn open(shown: Shown, is_first: bool) -> io::Result<Self> {
        let now = Instant::now();
        let shown = if is_first { shown } else { Shown::None };
        let display = Display::new(shown, "steps");
        let shown = display.clone();
        let signals = Signals::install(move |_| {
            if is_first {
                shown.report(
                    "stopping: the tile so far is made uniform and written; once more ends the run \
                     at once, without it",
                );
            }
        })?;
        let (deadline, forecast, phase) = (None, None, Phase::Start);
        Ok(Self { display, signals, deadline, forecast, phase, since: (now, 0) })
    }

    /// Stops the run when this time has passed from now on.
    pub fn limit(&mut self, time: Option<Duration>) {
        self.deadline = time.and_then(|time| Instant::now().checked_add(time));
    }

    /// Whether anybody sees how the run goes on.
    pub fn is_watched(&self) -> bool {
        !matches!(self.display, Display::Nothing)
    }

    /// Says what is about to begin, to people.
    pub fn begin(&mut self, words: &str, forecast: Option<Forecast>) {
        if self.display.is_for_people() {
            say(words);
        }
        self.forecast = forecast;
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        self.display.clear();
    }

    /// The exit code for the signal that has arrived, if one has.
    pub fn received(&self) -> Option<i32> {
        self.signals.received()
    }

    /// Steps per second of this phase, and how many seconds the run will go on, if that was foreseen.
    fn rate(&self, progress: &Progress) -> (f64, Option<f64>) {
        let (since, first) = self.since;
        let steps = f64::from(progress.done.saturating_sub(first));
        let rate = steps / since.elapsed().as_secs_f64().max(1e-9);
        let left = f64::from(progress.of.saturating_sub(progress.done)) / rate;
        let after = self.forecast.as_ref().map(|forecast| forecast.after(progress.phase));
        (rate, after.map(|after| left + after).filter(|eta| eta.is_finite()))
    }
}

impl Observer for Terminal {
    fn progress(&mut self, progress: Progress) {
        let begins = progress.phase != self.phase;
        if begins {
            (self.phase, self.since) = (progress.phase, (Instant::now(), progress.done));
        }
        let (rate, eta) = self.rate(&progress);
        let Progress { phase, done, of, objective, workers } = progress;
        match &mut self.display {
            Display::Nothing => (),
            Display::Bar(bar) => {
                if begins {
                    bar.reset();
                    bar.set_length(of.into());
                    bar.set_prefix(phase.name());
                }
                let mut words = Vec::new();
                words.extend((!begins).then(|| format!("{rate:.0}/s")));
                words.extend(eta.map(|eta| format!("{} left", in_words(eta))));
                words.extend(objective.map(|objective| format!("loss {objective:.6}")));
                words.extend(workers.map(|(workers, lost)| match lost {
                    0 => format!("{workers} workers"),
                    lost => format!("{workers} workers, {lost} replaced"),
                }));
                bar.set_message(words.join(", "));
                bar.set_position(done.into());
            }
            Display::Lines { share, .. } => {
                let done_of = f64::from(done) / f64::from(of.max(1));
                let now = match &self.forecast {
                    Some(forecast) => 1.0 - eta.unwrap_or(0.0) / forecast.total().max(1e-9),
                    None => done_of,
                };
                if begins && self.forecast.is_none() {
                    *share = 0.0;
                }
                if begins || !self.display.is_line_due(now) {
                    return;
                }
                let left = eta.map(|eta| format!(", {} left", in_words(eta))).unwrap_or_default();
                let percent = 100.0 * done_of;
                say(format_args!("{}: {done} of {of} steps ({percent:.0} %){left}", phase.name()));
            }
            Display::Json { .. } if begins => (),
            Display::Json { .. } => {
                self.display.line(&Line { phase, done, of, rate, eta, objective });
            }
        }
    }

    fn report(&mut self, message: &str) {
        self.display.report(message);
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
