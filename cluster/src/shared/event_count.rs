//! Waiting for something new to see, across processes: an event count.
//!
//! Whoever changes what others wait for raises the count. Whoever waits reads the count first,
//! looks then, and sleeps only as long as the count is what it was: no change is missed.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use crate::futex;
use crate::shared::section::{Arena, LINE, Words};

/// How often there was something new, and how many sleep until there is.
#[derive(Debug)]
pub(super) struct EventCount(Words);

/// Which of its words is which, each on a line of its own.
const COUNT: usize = 0;
const SLEEPERS: usize = LINE;
const BYTES: usize = 2 * LINE * size_of::<u64>();

impl EventCount {
    /// Bytes that it takes of an arena.
    pub fn room() -> usize {
        Arena::room(BYTES)
    }

    pub fn new(arena: &mut Arena) -> Self {
        Self(arena.take(BYTES).words())
    }

    /// A number that changes when there is something new to see.
    pub fn seen(&self) -> u32 {
        self.count().load(Ordering::SeqCst)
    }

    /// Wakes all who wait, so that they look again.
    pub fn raise(&self) {
        self.count().fetch_add(1, Ordering::SeqCst);
        if self.0[SLEEPERS].load(Ordering::SeqCst) > 0 {
            futex::wake(self.count());
        }
    }

    /// Waits until [`Self::seen`] changes: spins so many times first, then sleeps. May return
    /// without reason.
    pub fn wait(&self, seen: u32, spins: u32) {
        for _ in 0..spins {
            if self.seen() != seen {
                return;
            }
            std::hint::spin_loop();
        }
        // A sleeper that dies is counted for ever, which costs a call to the system and no more.
        self.0[SLEEPERS].fetch_add(1, Ordering::SeqCst);
        futex::wait(self.count(), seen);
        self.0[SLEEPERS].fetch_sub(1, Ordering::SeqCst);
    }

    fn count(&self) -> &AtomicU32 {
        let word: *const AtomicU64 = &self.0[COUNT];
        // SAFETY: the first half of an aligned word, which is used as such a half only.
        unsafe { &*word.cast() }
    }
}
