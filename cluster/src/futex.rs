//! Waiting for a word to change, across processes, without burning a core.

use std::sync::atomic::AtomicU32;
use std::time::Duration;

/// Longest sleep: who dies between changing a word and waking others must not hold them up.
const LONGEST: Duration = Duration::from_millis(20);

/// Sleeps while a word is `seen`; may wake without reason.
#[cfg(target_os = "linux")]
pub fn wait(word: &AtomicU32, seen: u32) {
    use rustix::thread::futex::{self, Flags, Timespec};
    let timeout = Timespec { tv_sec: 0, tv_nsec: LONGEST.as_nanos() as i64 };
    // Whatever it says, the caller looks at the word again.
    let _ = futex::wait(word, Flags::empty(), seen, Some(&timeout));
}

/// Wakes all who sleep on a word.
#[cfg(target_os = "linux")]
pub fn wake(word: &AtomicU32) {
    use rustix::thread::futex::{self, Flags};
    // It cannot fail for a word that exists; and sleepers wake by themselves in the end.
    let _ = futex::wake(word, Flags::empty(), i32::MAX as u32);
}

/// Sleeps a little while a word is `seen`.
#[cfg(not(target_os = "linux"))]
pub fn wait(word: &AtomicU32, seen: u32) {
    if word.load(std::sync::atomic::Ordering::Acquire) == seen {
        std::thread::sleep(LONGEST / 400);
    }
}

/// Those who sleep on a word wake by themselves.
#[cfg(not(target_os = "linux"))]
pub fn wake(_: &AtomicU32) {}
