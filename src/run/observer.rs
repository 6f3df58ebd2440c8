//! How a run is observed, and how it is asked to stop.

use crate::solver::{Phase, StopReason};

/// Where a run stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Part of the run.
    pub phase: Phase,
    /// Steps of that part that are done.
    pub done: u32,
    /// Steps of that part in all.
    pub of: u32,
    /// Mean W₂² of the draws of the last steps, as far as there are any.
    pub objective: Option<f64>,
    /// Worker processes, and those that were replaced so far; none for threads of this process.
    pub workers: Option<(usize, usize)>,
}

/// Someone who observes a run and may end it. Called between steps, never by two threads at once.
/// What is not said otherwise goes unheard, and stops nothing.
pub trait Observer {
    /// Hears where the run stands.
    fn progress(&mut self, _progress: Progress) {}

    /// Hears in words of something out of the ordinary that the run has coped with.
    fn report(&mut self, _message: &str) {}

    /// Whether the run should end now: it then does the uniformity step and returns its tile.
    fn stop(&self) -> Option<StopReason> {
        None
    }

    /// Whether nobody wants the tile of a run that ends early: then it ends at once, without one. Only
    /// a run by the threads of this process is asked; workers and ranks make theirs together.
    fn gives_up(&self) -> bool {
        false
    }
}

/// Observes nothing and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}
