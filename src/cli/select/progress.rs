//! What people and programs see of a selection while it goes on, and how they end it.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use perceptile::run::signals::Signals;
use serde::Serialize;

use crate::cli::duration::in_words;
use crate::cli::progress::Shown;
use crate::cli::stream::say;

/// Lines for people come no closer than this, unless a tenth is done.
const SELDOM: Duration = Duration::from_secs(30);
/// Lines come no closer than this.
const OFTEN: Duration = Duration::from_secs(1);

/// Shows which frames are done.
pub struct Progress {
    display: Display,
    signals: Signals,
    frames: usize,
    /// When it began, and with how many frames.
    since: (Instant, usize),
}

enum Display {
    Bar(ProgressBar),
    Lines { last: Instant, share: f64 },
    Json { last: Option<Instant> },
    Nothing,
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
        let now = Instant::now();
        let bar = || {
            let style = ProgressStyle::with_template("select   {bar:32} {pos}/{len} frames  {msg}");
            ProgressBar::new(frames as u64).with_style(style.expect("a valid template"))
        };
        let display = match shown {
            Shown::Auto if io::stderr().is_terminal() => Display::Bar(bar()),
            Shown::Bar => Display::Bar(bar()),
            Shown::Auto | Shown::Lines => Display::Lines { last: now, share: 0.0 },
            Shown::Json => Display::Json { last: None },
            Shown::None => Display::Nothing,
        };
        let json = matches!(display, Display::Json { .. });
        let signals = Signals::install(move |_| {
            let words = "stopping after this frame; the same command goes on";
            match json {
                true => say(serde_json::json!({ "message": words })),
                false => say(words),
            }
        })?;
        Ok(Self { display, signals, frames, since: (now, 0) })
    }

    /// The exit code for the signal that has arrived, if one has.
    pub fn received(&self) -> Option<i32> {
        self.signals.received()
    }

    /// Says what is about to begin, behind so many frames, to people.
    pub fn begin(&mut self, words: &str, done: usize) {
        self.since = (Instant::now(), done);
        if matches!(self.display, Display::Bar(_) | Display::Lines { .. }) {
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
            Display::Lines { last, share } => {
                let (now, passed) = (done as f64 / of as f64, last.elapsed());
                if passed < OFTEN || (passed < SELDOM && now < *share + 0.1) {
                    return;
                }
                (*last, *share) = (Instant::now(), now);
                say(format_args!("{done} of {of} frames ({:.0} %){left}", 100.0 * now));
            }
            Display::Json { last } => {
                if last.is_some_and(|last| last.elapsed() < OFTEN) {
                    return;
                }
                *last = Some(Instant::now());
                let line = Line { phase: "select", done, of, rate, eta };
                if let Ok(line) = serde_json::to_string(&line) {
                    say(line);
                }
            }
        }
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}
