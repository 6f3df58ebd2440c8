//! Ctrl-C and SIGTERM: the first one asks the run to stop, the second one ends the process. A file
//! that may not become so large is an error, and no signal that ends the process.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Which signal has arrived.
#[derive(Debug, Clone, Default)]
pub struct Signals {
    number: Arc<AtomicUsize>,
}

impl Signals {
    /// Listens for both signals from now on, and lets writes fail that pass a limit of file sizes.
    ///
    /// # Errors
    /// What the system reports.
    pub fn install() -> io::Result<Self> {
        let signals = Self::default();
        let seen = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // Handlers run in the order in which they are registered, so the first signal finds
            // the flag down and the second finds it up.
            flag::register_conditional_shutdown(signal, exit_code(signal), Arc::clone(&seen))?;
            flag::register(signal, Arc::clone(&seen))?;
            flag::register_usize(signal, Arc::clone(&signals.number), signal as usize)?;
        }
        // Unless somebody listens, the signal ends the process instead.
        #[cfg(unix)]
        flag::register(signal_hook::consts::SIGXFSZ, Arc::default())?;
        Ok(signals)
    }

    /// The exit code for the signal that has arrived, if one has.
    pub fn received(&self) -> Option<i32> {
        match self.number.load(Ordering::Relaxed) {
            0 => None,
            number => Some(exit_code(number as i32)),
        }
    }
}

/// 128 + the signal's number, as shells have it: 130 for Ctrl-C, 143 for SIGTERM.
fn exit_code(signal: i32) -> i32 {
    128 + signal
}
