//! What happens between two steps, whoever does them: the observer hears where the run stands, and
//! the run is stopped and kept.

use std::mem;
use std::time::Instant;

use crate::format::numbers::ArraySource;
use crate::run::checkpointer::Checkpointer;
use crate::run::folder::FolderError;
use crate::run::observer::{Observer, Progress};
use crate::run::plan::{Plan, Position};
use crate::solver::{Phase, Recorded, StopReason};

/// What is to happen before the next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Decision {
    /// Why no step is to follow, if none is.
    pub stop: Option<StopReason>,
    /// Whether a checkpoint is to be written.
    pub checkpoint: bool,
}

/// Watches a run.
pub struct Watch<'a> {
    plan: &'a Plan,
    observer: &'a mut dyn Observer,
    checkpointer: Option<&'a mut Checkpointer>,
    reason: Option<StopReason>,
    /// Seconds of the phases that are over.
    seconds: Vec<(Phase, f64)>,
    /// The phase that is under way.
    phase: Phase,
    since: Instant,
}

impl<'a> Watch<'a> {
    /// Watches a run that began at some time.
    pub fn new(
        since: Instant,
        plan: &'a Plan,
        observer: &'a mut dyn Observer,
        checkpointer: Option<&'a mut Checkpointer>,
    ) -> Self {
        let seconds = Vec::new();
        Self { plan, observer, checkpointer, reason: None, seconds, phase: Phase::Start, since }
    }

    /// Looks at a run before a step: reports where it stands, and says what is to happen.
    /// Once it is to stop, it is. `workers` are how many there are and how many were replaced.
    pub fn look(
        &mut self,
        at: Position,
        recorded: &Recorded,
        workers: Option<(usize, usize)>,
    ) -> Decision {
        let Position { phase, step } = at;
        self.enter(phase);
        if step > 0 {
            let descends = phase == Phase::Descent;
            let objective = if descends { recorded.means(step)[1] } else { None };
            let of = self.plan.steps_of(phase);
            self.observer.progress(Progress { phase, done: step, of, objective, workers });
        }
        let stop = self.reason.or_else(|| self.observer.stop());
        let done = self.plan.steps_done(at);
        let checkpoint = self
            .checkpointer
            .as_ref()
            .is_some_and(|checkpointer| stop.is_some() || checkpointer.is_due(done));
        Decision { stop, checkpoint }
    }

    /// Whether the run was stopped, and nobody wants its tile.
    pub fn gives_up(&self) -> bool {
        self.reason.is_some() && self.observer.gives_up()
    }

    /// Remembers why the run was stopped, the first time.
    pub fn stops(&mut self, reason: StopReason) {
        self.reason.get_or_insert(reason);
    }

    /// Steps until a checkpoint is due after so many; none where that depends on time.
    pub fn steps_until_due(&self, done: u32) -> Option<u32> {
        self.checkpointer.as_ref().and_then(|checkpointer| checkpointer.steps_until_due(done))
    }

    /// Writes a checkpoint, if somebody keeps them.
    ///
    /// # Errors
    /// What the checkpointer reports.
    pub fn save(
        &mut self,
        at: Position,
        recorded: Recorded,
        state: &dyn ArraySource,
    ) -> Result<(), FolderError> {
        let Some(checkpointer) = &mut self.checkpointer else { return Ok(()) };
        checkpointer.save(self.plan, at, recorded, state)
    }

    /// Where a run can be resumed from, if it can.
    pub fn kept(&self) -> Option<&std::path::Path> {
        let saved = self.checkpointer.as_ref().filter(|checkpointer| checkpointer.has_saved());
        saved.map(|checkpointer| checkpointer.path())
    }

    /// Reports something out of the ordinary.
    pub fn report(&mut self, message: &str) {
        self.observer.report(message);
    }

    /// A phase begins, if it is another than before.
    pub fn enter(&mut self, phase: Phase) {
        if phase != self.phase {
            self.leave();
            self.phase = phase;
        }
    }

    /// A phase ends.
    fn leave(&mut self) {
        let passed = mem::replace(&mut self.since, Instant::now()).elapsed();
        self.seconds.push((self.phase, passed.as_secs_f64()));
    }

    /// Why the run was stopped, if it was, and the seconds of every phase that took place.
    pub fn finish(mut self) -> (Option<StopReason>, Vec<(Phase, f64)>) {
        self.leave();
        (self.reason, self.seconds)
    }
}
