//! The waves: what one process does of a selection, with all others that share its memory or have other
//! rows. What a wave does with a frame is in [`rounds`].

mod rounds;

use std::sync::Arc;

use perceptile_cluster::communicator::Communicator;
use perceptile_cluster::{Ends, Worker};

use super::SelectError;
use super::borders::Borders;
use super::footprint::Footprint;
use super::mixture::Mixture;
use super::options::Norm;
use super::plan::{Ready, SelectPlan};
use super::schedule::{Schedule, Wave};
use super::score::Scored;
use super::sources::FilterSet;
use super::window::{Window, WindowPlan};
use crate::gradient::simd::Simd;

/// A process's part in a selection.
pub(super) struct Engine {
    pub plan: WindowPlan,
    pub worker: Arc<Worker>,
    pub window: Window,
    pub schedule: Schedule,
    pub mixture: Mixture,
    pub lambdas: Vec<f32>,
    filters: FilterSet,
    footprint: Footprint,
    norm: Norm,
    simd: Simd,
    borders: Borders,
    round: u64,
    /// The wave that it began with, and the one that is next.
    first: usize,
    wave: usize,
}

impl Engine {
    /// The part of a rank, on memory that its plan has made.
    pub fn new(
        ready: Ready,
        (plan, worker, window): (WindowPlan, Worker, Window),
        communicator: Arc<dyn Communicator>,
        (norm, simd): (Norm, Simd),
    ) -> Self {
        let Ready { mixture, footprint, filters, lambdas, schedule } = ready;
        let borders = Borders::new(&plan, &footprint, &*communicator);
        let worker = Arc::new(worker.with_communicator(communicator));
        let (round, first, wave) = (0, 0, 0);
        Self {
            plan,
            worker,
            window,
            schedule,
            mixture,
            lambdas,
            filters,
            footprint,
            norm,
            simd,
            borders,
            round,
            first,
            wave,
        }
    }

    /// The part of a process that works alone or is one of several ranks.
    ///
    /// # Errors
    /// No memory, on this rank or on another.
    pub fn of_rank(
        plan: &SelectPlan,
        simd: Simd,
        communicator: Arc<dyn Communicator>,
    ) -> Result<Self, SelectError> {
        let ready = plan.ready()?;
        let window_plan = ready.window(plan, communicator.rank());
        let memory = window_plan.private();
        // Nobody goes on alone.
        let mut failed = [i64::from(memory.is_err())];
        communicator.max(&mut failed);
        let (worker, window) = memory?;
        if failed != [0] {
            return Err(SelectError::Elsewhere);
        }
        let memory = (window_plan, worker, window);
        Ok(Self::new(ready, memory, communicator, (plan.options.norm, simd)))
    }

    /// The wave that is next.
    pub fn wave(&self) -> usize {
        self.wave
    }

    /// The window of a rank of the plan that this is part of.
    pub fn window_of(&self, plan: &SelectPlan, rank: usize) -> WindowPlan {
        WindowPlan::new(plan, &self.footprint, self.schedule, rank)
    }

    /// Begins with a wave in the middle.
    pub fn begin_with(&mut self, wave: usize) {
        (self.first, self.wave) = (wave, wave);
    }

    /// Goes on to the next wave, which others do, and says what it is.
    pub fn pass(&mut self) -> Wave {
        let wave = self.schedule.wave(self.wave, self.first);
        self.wave += 1;
        wave
    }

    /// Does the next wave, and says what it was.
    pub fn advance(&mut self) -> Wave {
        let wave = self.pass();
        wave.renews.clone().for_each(|frame| self.prepare(frame));
        for frame in wave.prepares.clone() {
            self.prepare(frame);
            if wave.scored_renders.contains(&frame) {
                self.score(frame, Scored::Others);
            }
        }
        if self.norm == Norm::L2 {
            let prepared = wave.prepares.end;
            wave.curves.clone().for_each(|frame| self.curve(frame, prepared));
        }
        for &(sweep, frame) in &wave.visits {
            self.sweep(frame, sweep);
        }
        wave.scored.clone().for_each(|frame| self.score(frame, Scored::Selection));
        self.end();
        wave
    }

    /// A round by whose end all is done, and after which workers can be held.
    fn end(&mut self) {
        self.round += 1;
        self.worker.round(self.round, Ends::Step, 0..1, (), |_, ()| ());
    }

    /// Prepares all frames, which must fit into the window.
    #[cfg(test)]
    pub fn prepare_all(&mut self) {
        let frames = self.plan.shape.frames();
        (0..frames).for_each(|frame| self.prepare(frame));
        if self.norm == Norm::L2 {
            (0..frames).for_each(|frame| self.curve(frame, frames));
        }
    }
}
