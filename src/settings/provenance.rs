//! Where a tile comes from, for its sidecar.

use std::time::SystemTime;

use super::Settings;
use crate::format::sidecar::{self, Sidecar};
use crate::metric::Scores;
use crate::run::driver::Output;
use crate::run::summary::ParallelSummary;
use crate::solver::{Options, StopReason};

/// Where the tile of a run comes from that these settings asked for, and which took so many seconds.
pub fn provenance(
    settings: &Settings,
    options: &Options,
    output: &Output,
    scores: Option<&Scores>,
    seconds: f64,
    sha256: String,
) -> Sidecar {
    let summary = &output.summary;
    // The command that makes the same tile again.
    let mut settings = settings.clone();
    if summary.reason != StopReason::Completed {
        settings.stop_after = Some(summary.steps);
    }
    let words = ["perceptile".into(), "optimize".into()].into_iter();
    let mut recorded = serde_json::json!({ "options": options, "summary": summary });
    match &output.parallel {
        ParallelSummary::Threads => (),
        ParallelSummary::Workers(workers) => recorded["workers"] = serde_json::json!(workers),
        ParallelSummary::Ranks(ranks) => recorded["ranks"] = serde_json::json!(ranks),
    }
    Sidecar {
        format: sidecar::FORMAT,
        program: env!("CARGO_PKG_NAME").into(),
        version: env!("CARGO_PKG_VERSION").into(),
        command: shell_line(words.chain(settings.command_line())),
        kernel: options.kernel.to_string(),
        seed: options.seed,
        shape: options.shape,
        options: recorded,
        created: sidecar::utc(SystemTime::now()),
        seconds,
        sha256,
        scores: serde_json::json!(scores),
        convergence: summary.convergence.clone(),
    }
}

/// Words as one line for a shell.
pub fn shell_line(words: impl Iterator<Item = String>) -> String {
    let quote = |word: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
        let bare = !word.is_empty() && word.chars().all(plain);
        if bare { word } else { format!("'{}'", word.replace('\'', r"'\''")) }
    };
    words.map(quote).collect::<Vec<String>>().join(" ")
}
