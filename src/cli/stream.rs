//! The lines that the command writes: results to the standard output, messages to the standard
//! error.
//!
//! `println!` and `eprintln!` panic where a pipe has lost its reader, as after `| head -1`. A run
//! must not end so: whoever went away needs no more lines, but the tile is still wanted.

use std::fmt::Display;
use std::io::{self, Write};

use serde::Serialize;
use thiserror::Error;

/// A result cannot be printed.
#[derive(Debug, Error)]
pub enum OutputError {
    /// The standard output takes no more, and not because its reader has gone.
    #[error("cannot write to the standard output: {0}")]
    Io(io::Error),
    /// It cannot be JSON.
    #[error("cannot print JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// Writes a result to the standard output; that its reader went away is no error.
///
/// # Errors
/// An output that cannot be written for another reason, such as a full disk.
pub fn print(text: &str) -> Result<(), OutputError> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(OutputError::Io(error)),
        _ => Ok(()),
    }
}

/// Writes a result to the standard output, as JSON or as `text` for people.
///
/// # Errors
/// As for [`print`], and what cannot be JSON.
pub fn show(
    json: bool,
    result: &impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), OutputError> {
    let text = if json { serde_json::to_string_pretty(result)? + "\n" } else { text() };
    print(&text)
}

/// Writes a message to the standard error, as one line; nobody can hear that this failed.
pub fn say(message: impl Display) {
    // One write, so that lines of several processes do not mix.
    let _ = io::stderr().write_all(format!("{message}\n").as_bytes());
}
