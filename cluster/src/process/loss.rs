//! Which worker is no more, and why, in words for users.

use std::fmt;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::time::Duration;

use signal_hook::low_level::signal_name;
use thiserror::Error;

use super::message::MessageError;

/// A worker that is no more.
#[derive(Debug, Error)]
#[error("worker {worker} (process {pid}) {cause}")]
pub struct Loss {
    /// Its index.
    pub worker: usize,
    /// Its process, which has been reaped.
    pub pid: u32,
    /// Why.
    pub cause: Cause,
}

/// Why a worker is no more.
#[derive(Debug)]
pub enum Cause {
    /// It ended by itself, with this exit code.
    Exited(i32),
    /// This signal ended it.
    Signal(i32),
    /// The system does not say how it ended.
    Vanished(io::Error),
    /// It was not ready in this time.
    Unready(Duration),
    /// Its heartbeat stood still for this time.
    Silent(Duration),
    /// It said that it cannot go on, and why.
    Failed(String),
    /// It said what no worker of this program says.
    Message(MessageError),
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exited(code) => write!(f, "ended too early, with exit code {code}"),
            Self::Signal(number) => match signal_name(*number) {
                Some(name) => write!(f, "was ended by {name}"),
                None => write!(f, "was ended by signal {number}"),
            },
            Self::Vanished(error) => write!(f, "has vanished: {error}"),
            Self::Unready(time) => write!(f, "was not ready within {time:?}"),
            Self::Silent(time) => write!(f, "gave no sign of life for {time:?}"),
            Self::Failed(text) => write!(f, "failed: {text}"),
            Self::Message(error) => write!(f, "cannot be used: {error}"),
        }
    }
}

impl From<MessageError> for Cause {
    fn from(error: MessageError) -> Self {
        Self::Message(error)
    }
}

impl From<ExitStatus> for Cause {
    fn from(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(code), _) => Self::Exited(code),
            (None, Some(signal)) => Self::Signal(signal),
            (None, None) => Self::Vanished(io::Error::other(status.to_string())),
        }
    }
}
