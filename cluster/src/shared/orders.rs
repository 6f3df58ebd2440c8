//! Holding and stopping: what is asked at any time, and decided once for all workers.
//!
//! All workers have to wait, or stop, after the same round. So whoever asks does no more than that;
//! the holder of one job of a step, which nobody else has, reads what is asked and writes down the
//! round after which it happens, before the job is done and the round can end.

use std::sync::atomic::Ordering;

use crate::shared::section::{Arena, Words};

/// What is asked of the workers, and what is decided.
#[derive(Debug)]
pub(super) struct Orders(Words);

/// Which of its words is which.
const HOLD_ASKED: usize = 0;
/// The last round after which all wait.
const HELD: usize = 1;
/// The last such round after which they may go on.
const RELEASED: usize = 2;
const STOP_ASKED: usize = 3;
/// The round after which all stop; 0 until that is decided.
const STOPPED: usize = 4;
const BYTES: usize = 5 * size_of::<u64>();

impl Orders {
    /// Bytes that they take of an arena.
    pub fn room() -> usize {
        Arena::room(BYTES)
    }

    pub fn new(arena: &mut Arena) -> Self {
        Self(arena.take(BYTES).words())
    }

    /// Asks that all workers stop at the end of a step.
    pub fn ask_stop(&self) {
        self.0[STOP_ASKED].store(1, Ordering::Release);
    }

    /// Asks that all workers wait at the end of a step.
    pub fn ask_hold(&self) {
        self.0[HOLD_ASKED].store(1, Ordering::Release);
    }

    /// Decides, as the only one to do so in this round, what is to happen after it.
    pub fn decide(&self, round: u64) {
        if self.0[STOP_ASKED].load(Ordering::Acquire) != 0 {
            self.stop_after(round);
        }
        if self.0[HOLD_ASKED].load(Ordering::Acquire) != 0 {
            self.0[HELD].store(round, Ordering::Release);
        }
    }

    /// Decides that no step follows this round, unless that was decided before.
    pub fn stop_after(&self, round: u64) {
        if self.stopped().is_none() {
            self.0[STOPPED].store(round, Ordering::Release);
        }
    }

    /// The round after which no step is to follow, once it is decided.
    pub fn stopped(&self) -> Option<u64> {
        Some(self.0[STOPPED].load(Ordering::Acquire)).filter(|&round| round > 0)
    }

    /// The round after which all workers wait, once it is decided and until they are released.
    pub fn held(&self) -> Option<u64> {
        let held = self.0[HELD].load(Ordering::Acquire);
        (held > self.0[RELEASED].load(Ordering::Acquire)).then_some(held)
    }

    /// Lets the workers go on; and asks at once that they wait `again` at the end of the next step.
    /// Nobody decides while they wait, so what was asked meanwhile and this are decided together.
    pub fn release(&self, again: bool) {
        self.0[HOLD_ASKED].store(again.into(), Ordering::Release);
        let held = self.0[HELD].load(Ordering::Acquire);
        self.0[RELEASED].store(held, Ordering::Release);
    }
}
