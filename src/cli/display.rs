//! How progress is shown on the standard error: a bar, lines for people, lines of JSON, or nothing,
//! whatever it is that goes on.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::stream::say;

/// Lines for people come no closer than this, unless a tenth is done.
const SELDOM: Duration = Duration::from_secs(30);
/// Lines come no closer than this.
const OFTEN: Duration = Duration::from_secs(1);

/// How progress is shown on the standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Shown {
    /// A bar on a terminal, lines elsewhere
    Auto,
    /// A bar
    Bar,
    /// A line every 30 seconds, or whenever a tenth of the run is done
    Lines,
    /// A line of JSON each second: phase, done, of, rate (steps per second), eta (seconds), objective
    Json,
    /// Nothing
    None,
}

/// Shows progress.
#[derive(Clone)]
pub enum Display {
    /// Without a terminal, nothing.
    Bar(ProgressBar),
    /// Lines for people.
    Lines {
        /// When the last one came.
        last: Instant,
        /// Share of the whole that it told of.
        share: f64,
    },
    /// Lines for programs.
    Json {
        /// When the last one came.
        last: Option<Instant>,
    },
    /// Nothing.
    Nothing,
}

impl Display {
    /// What is asked for. A bar counts `unit`.
    pub fn new(shown: Shown, unit: &str) -> Self {
        match shown {
            Shown::Auto if io::stderr().is_terminal() => Self::Bar(bar(unit)),
            Shown::Bar => Self::Bar(bar(unit)),
            Shown::Auto | Shown::Lines => Self::Lines { last: Instant::now(), share: 0.0 },
            Shown::Json => Self::Json { last: None },
            Shown::None => Self::Nothing,
        }
    }

    /// Whether people read it.
    pub fn is_for_people(&self) -> bool {
        matches!(self, Self::Bar(_) | Self::Lines { .. })
    }

    /// Something out of the ordinary, in words.
    pub fn report(&self, message: &str) {
        match self {
            Self::Bar(bar) => bar.suspend(|| say(message)),
            Self::Json { .. } => say(serde_json::json!({ "message": message })),
            Self::Lines { .. } | Self::Nothing => say(message),
        }
    }

    /// Whether a line for people is due when this share is done; if so, it is told now.
    pub fn is_line_due(&mut self, now: f64) -> bool {
        let Self::Lines { last, share } = self else { return false };
        let passed = last.elapsed();
        let due = passed >= OFTEN && (passed >= SELDOM || now >= *share + 0.1);
        if due {
            (*last, *share) = (Instant::now(), now);
        }
        due
    }

    /// Prints a line for programs, if one is due.
    pub fn line(&mut self, line: &impl Serialize) {
        let Self::Json { last } = self else { return };
        if last.is_some_and(|last| last.elapsed() < OFTEN) {
            return;
        }
        *last = Some(Instant::now());
        if let Ok(line) = serde_json::to_string(line) {
            say(line);
        }
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

/// A bar on the standard error.
fn bar(unit: &str) -> ProgressBar {
    let template = format!("{{prefix:8}} {{bar:32}} {{pos}}/{{len}} {unit}  {{msg}}");
    ProgressBar::no_length()
        .with_style(ProgressStyle::with_template(&template).expect("a valid template"))
}
