//! What people and programs see of a selection while it goes on, and how they end it.

use std::io;
use std::time::Instant;

use perceptile::run::signals::Signals;
use serde::Serialize;

use crate::cli::display::{Display, Shown};
use crate::cli::duration::in_words;
use crate::cli::stream::say;

/// Shows which frames are done.
pub struct Progress {
    display: Display,
    signals: Signals,
    frames: usize,
    /// When it began, and with how many frames.
    since: (Instant, usize),
}

/// A line for programs.
#[derive(Debug, Serialize)]
struct Line {
    phase: &'static str,
    done: usize,
    of: usize,
    /// Frames per second.
    rate: f64,
    /// Seconds until all are done.
    eta: Option<f64>,
}

impl Progress {
    /// Listens for signals from now on.
    ///
    /// # Errors
    /// What the system reports.
    pub fn open(shown: Shown, frames: usize) -> io::Result<Self> {
        let display = Display::new(shown, "frames");
        if let Display::Bar(bar) = &display {
            bar.set_length(frames as u64);
            bar.set_prefix("select");
        }
        let stopping = display.clone();
        let signals = Signals::install(move |_| {
            stopping.report("stopping after this frame; the same command goes on");
        })?;
        Ok(Self { display, signals, frames, since: (Instant::now(), 0) })
    }

    /// The exit code for the signal that has arrived, if one has.
    pub fn received(&self) -> Option<i32> {
        self.signals.received()
    }

    /// Says what is about to begin, behind so many frames, to people.
    pub fn begin(&mut self, words: &str, done: usize) {
        self.since = (Instant::now(), done);
        if self.display.is_for_people() {
            say(words);
            if done > 0 {
                say(format_args!("going on behind frame {done}"));
            }
        }
    }

    /// So many frames are done.
    pub fn done(&mut self, done: usize) {
        let (since, first) = self.since;
        let rate = done.saturating_sub(first) as f64 / since.elapsed().as_secs_f64().max(1e-9);
        let eta =
            Some(self.frames.saturating_sub(done) as f64 / rate).filter(|eta| eta.is_finite());
        let of = self.frames;
        let left = eta.map(|eta| format!(", {} left", in_words(eta))).unwrap_or_default();
        match &mut self.display {
            Display::Nothing => (),
            Display::Bar(bar) => {
                bar.set_message(format!("{rate:.1}/s{left}"));
                bar.set_position(done as u64);
            }
            Display::Lines { .. } => {
                let share = done as f64 / of as f64;
                if self.display.is_line_due(share) {
                    say(format_args!("{done} of {of} frames ({:.0} %){left}", 100.0 * share));
                }
            }
            Display::Json { .. } => {
                self.display.line(&Line { phase: "select", done, of, rate, eta });
            }
        }
    }

    /// Something out of the ordinary, in words.
    pub fn report(&self, message: &str) {
        self.display.report(message);
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        self.display.clear();
    }
}
