//! The waves: frames come in, sweeps go over them, pictures go out. What a wave does with a frame is in
//! [`rounds`].

mod rounds;

use std::ops::Range;

use perceptile_cluster::Worker;

use super::filter::Filter;
use super::footprint::Footprint;
use super::mixture::{MAX_CANDIDATES, MAX_SUBSET_RENDERS, Mixture};
use super::options::{Norm, SelectOptions};
use super::score::{Scored, SelectScores, Sums};
use super::sources::{FilterSet, Method};
use super::state::SelectState;
use super::window::{Window, WindowPlan};
use super::{AnimationShape, Filters, SelectError, scale};
use crate::gradient::simd::Simd;

/// Frames between one sweep and the next. A larger distance makes the window larger and the result no
/// better; without one, frames that come later are not yet there to make up for the error.
pub const LAG: usize = 1;

/// Waves after which the residual is made anew from what is chosen: no rounding error stays, and a
/// selection can go on from there with nothing but its choices.
pub const RENEWAL: usize = 32;

/// A frame of the animation: planes of `height × width` numbers, channel by channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frame {
    /// The reference, or what stands for it.
    pub guide: Vec<f32>,
    /// Every render.
    pub renders: Vec<Vec<f32>>,
}

/// A selection under way.
pub struct Selection {
    plan: WindowPlan,
    worker: Worker,
    window: Window,
    filters: FilterSet,
    footprint: Footprint,
    mixture: Mixture,
    norm: Norm,
    lambdas: Vec<f32>,
    simd: Simd,
    round: u64,
    /// The wave that is next.
    wave: usize,
    /// Frames that came in, and frames whose residual is there.
    loaded: usize,
    prepared: usize,
    sums: Sums,
    /// Choices that are to be taken over with their frames, from a state.
    kept: Option<Kept>,
    /// Frames that are done.
    done: usize,
    /// How often each candidate was chosen, in the frames that are done.
    chosen: Vec<u64>,
    /// Pixels that changed in each sweep.
    changes: Vec<u64>,
}

/// What is made of the arguments.
struct Ready {
    mixture: Mixture,
    footprint: Footprint,
    filters: FilterSet,
    lambdas: Vec<f32>,
}

impl Ready {
    fn new(
        filters: &Filters,
        (renders, subsets): (usize, bool),
        options: &SelectOptions,
    ) -> Result<Self, SelectError> {
        options.validate()?;
        let most = if subsets { MAX_SUBSET_RENDERS } else { MAX_CANDIDATES };
        if !(1..=most).contains(&renders) {
            return Err(SelectError::Renders { renders, most, subsets });
        }
        let seen = filters.render();
        let ready = |kernel| Filter::new(kernel, scale(kernel));
        Ok(Self {
            mixture: if subsets { Mixture::subsets(renders) } else { Mixture::single(renders) },
            footprint: Footprint::new(seen, scale(seen)),
            filters: FilterSet {
                eye: ready(&filters.eye)?,
                render: filters.taa.as_ref().map(ready).transpose()?,
                squares: Filter::of_squares(seen, scale(seen))?,
            },
            lambdas: options.lambdas(),
        })
    }
}

fn plan(
    shape: AnimationShape,
    footprint: &Footprint,
    renders: usize,
    options: &SelectOptions,
    threads: usize,
) -> WindowPlan {
    let spread = (options.sweeps as usize - 1) * LAG;
    let sums = 2 * Method::all(renders).count();
    WindowPlan::new(shape, footprint, (renders, options.norm), spread, (sums, threads))
}

/// Bytes of memory and frames of the window that a selection takes, before it is made; saturating.
///
/// # Errors
/// As [`Selection::new`], but for memory.
pub fn foreseen(
    shape: AnimationShape,
    filters: &Filters,
    candidates: (usize, bool),
    options: &SelectOptions,
    threads: usize,
) -> Result<(usize, usize), SelectError> {
    let Ready { footprint, .. } = Ready::new(filters, candidates, options)?;
    let plan = plan(shape, &footprint, candidates.0, options, threads);
    Ok((plan.bytes(), plan.pictures))
}

/// Choices of a state.
struct Kept {
    /// The first frame that they are of.
    first: usize,
    choices: Vec<u8>,
}

impl Selection {
    /// Prepares a selection among the renders of an animation, or with `subsets` among the means of
    /// all their subsets, by the threads of the current pool.
    ///
    /// # Errors
    /// A number out of range, a kernel that is too large, no memory.
    pub fn new(
        shape: AnimationShape,
        filters: &Filters,
        (renders, subsets): (usize, bool),
        options: &SelectOptions,
        simd: Simd,
    ) -> Result<Self, SelectError> {
        let threads = rayon::current_num_threads();
        let Ready { mixture, footprint, filters, lambdas } =
            Ready::new(filters, (renders, subsets), options)?;
        let plan = plan(shape, &footprint, renders, options, threads);
        let (worker, window) = plan.private()?;
        Ok(Self {
            plan,
            worker,
            window,
            filters,
            footprint,
            norm: options.norm,
            simd,
            round: 0,
            wave: 0,
            loaded: 0,
            prepared: 0,
            sums: Sums::new(renders),
            kept: None,
            done: 0,
            chosen: vec![0; mixture.candidates()],
            changes: vec![0; lambdas.len()],
            mixture,
            lambdas,
        })
    }

    /// The frames that the next wave needs and that are not there yet.
    pub fn needed(&self) -> Range<usize> {
        let ahead = self.footprint.frames() - 1;
        self.loaded..(self.wave + ahead + 1).min(self.plan.shape.frames()).max(self.loaded)
    }

    /// Takes in the next frame.
    ///
    /// # Panics
    /// If it is not of the animation's size.
    pub fn load(&mut self, frame: &Frame) {
        let at = self.loaded;
        let Self { plan, window, .. } = self;
        let (shape, rows) = (plan.shape, 0..plan.shape.height());
        assert_eq!(frame.renders.len(), plan.renders);
        let copy = |target: &mut [f32], picture: &[f32], place: &dyn Fn(usize) -> Range<usize>| {
            assert_eq!(picture.len(), shape.values());
            for (channel, plane) in picture.chunks_exact(shape.pixels()).enumerate() {
                target[place(channel)].copy_from_slice(plane);
            }
        };
        copy(window.guide.whole_mut(), &frame.guide, &|channel| {
            plan.picture_rows(at, channel, rows.clone())
        });
        for (k, render) in frame.renders.iter().enumerate() {
            copy(window.renders.whole_mut(), render, &|channel| {
                plan.render_rows(at, k, channel, rows.clone())
            });
        }
        self.loaded += 1;
        self.start(at);
        if self.kept.is_some() {
            self.take_over(at);
        }
    }

    /// The choices, if the next wave makes the residual anew: [`Self::restore`] goes on from there.
    /// Called before frames are loaded for that wave.
    pub fn state(&self) -> Option<SelectState> {
        if self.wave == 0 || !self.wave.is_multiple_of(RENEWAL) {
            return None;
        }
        let first = self.oldest_seen().saturating_sub(self.footprint.high.z as usize);
        let rows = 0..self.plan.shape.height();
        let choices = (first..self.loaded)
            .flat_map(|frame| {
                &self.window.choice.whole()[self.plan.choice_rows(frame, rows.clone())]
            })
            .copied()
            .collect();
        Some(SelectState {
            wave: self.wave,
            first,
            choices,
            sums: self.sums.clone(),
            chosen: self.chosen.clone(),
            changes: self.changes.clone(),
            done: self.done,
        })
    }

    /// Goes on from a state of the same selection, before the first wave.
    ///
    /// # Errors
    /// [`SelectError::State`] if it is the state of another selection.
    pub fn restore(&mut self, state: SelectState) -> Result<(), SelectError> {
        let SelectState { wave, first, choices, sums, chosen, changes, done } = state;
        let frames = self.plan.shape.frames();
        let end = wave.saturating_add(self.footprint.frames() - 1).min(frames);
        let held = end.checked_sub(first).filter(|&held| held <= self.plan.pictures);
        let fits = wave > 0
            && wave.is_multiple_of(RENEWAL)
            && wave < frames + self.lambdas.len() * LAG
            && held.is_some_and(|held| choices.len() == held * self.plan.shape.pixels())
            && choices.iter().all(|&choice| usize::from(choice) < self.mixture.candidates())
            && sums.fits(self.plan.renders)
            && chosen.len() == self.chosen.len()
            && changes.len() == self.changes.len();
        if !fits || self.wave > 0 || self.loaded > 0 {
            return Err(SelectError::State);
        }
        self.wave = wave;
        let past = self.footprint.high.z as usize;
        (self.loaded, self.prepared) = (first, (wave + past).min(frames));
        (self.sums, self.chosen, self.changes, self.done) = (sums, chosen, changes, done);
        self.kept = Some(Kept { first, choices });
        Ok(())
    }

    /// Takes a frame's choices over from a state, if it has them.
    fn take_over(&mut self, frame: usize) {
        let Self { plan, window, mixture, kept, .. } = self;
        let (shape, rows) = (plan.shape, 0..plan.shape.height());
        let pixels = shape.pixels();
        let Some(choices) = kept
            .as_ref()
            .and_then(|kept| kept.choices.chunks_exact(pixels).nth(frame - kept.first))
        else {
            return;
        };
        window.choice.whole_mut()[plan.choice_rows(frame, rows.clone())].copy_from_slice(choices);
        for channel in 0..shape.channels() {
            let renders = window.renders.whole();
            let render = |k| &renders[plan.render_rows(frame, k, channel, rows.clone())];
            let renders: Vec<&[f32]> = (0..plan.renders).map(render).collect();
            let current = plan.picture_rows(frame, channel, rows.clone());
            let current = &mut window.current.whole_mut()[current];
            for (i, (current, &choice)) in current.iter_mut().zip(choices).enumerate() {
                *current = mixture.value(choice.into(), |k| renders[k][i]);
            }
        }
    }

    /// Goes on by a wave: `done` gets the number, the picture (channel by channel) and the choices of
    /// the frame that is done with it, if one is. Returns whether there is more to do.
    ///
    /// # Panics
    /// If frames are missing that it needs.
    pub fn advance(&mut self, done: impl FnOnce(usize, &[f32], &[u8])) -> bool {
        assert!(self.needed().is_empty(), "frames are missing");
        let (frames, wave) = (self.plan.shape.frames(), self.wave);
        let past = self.footprint.high.z as usize;
        if wave > 0 && wave.is_multiple_of(RENEWAL) {
            (self.oldest_seen()..self.prepared).for_each(|frame| self.prepare(frame));
            if self.kept.take().is_some() && self.norm == Norm::L2 {
                let spread = (self.lambdas.len() - 1) * LAG;
                (wave.saturating_sub(spread)..wave.min(frames)).for_each(|frame| self.curve(frame));
            }
        }
        while self.prepared < (wave + past + 1).min(frames) {
            let frame = self.prepared;
            self.prepare(frame);
            self.prepared += 1;
            if self.scored().contains(&frame) {
                self.score(frame, Scored::Others);
            }
        }
        if self.norm == Norm::L2 && wave < frames {
            self.curve(wave);
        }
        for sweep in 0..self.lambdas.len() {
            if let Some(frame) = wave.checked_sub(sweep * LAG).filter(|&frame| frame < frames) {
                self.sweep(frame, sweep);
            }
        }
        self.wave += 1;
        let spread = (self.lambdas.len() - 1) * LAG;
        let Some(last) = wave.checked_sub(spread) else {
            return true;
        };
        self.count(last);
        let pixels = self.plan.shape.values();
        let place = self.plan.picture_rows(last, 0, 0..0).start;
        let choice = self.plan.choice_rows(last, 0..self.plan.shape.height());
        let picture = &self.window.current.whole()[place..place + pixels];
        done(last, picture, &self.window.choice.whole()[choice]);
        self.done = last + 1;
        // Frames up to so many before it see it.
        let future = (-self.footprint.low.z) as usize;
        let scored = self.scored();
        let seen = match last + 1 == frames {
            true => last.saturating_sub(future)..frames,
            false => last.saturating_sub(future)..(last + 1).saturating_sub(future),
        };
        seen.filter(|frame| scored.contains(frame))
            .for_each(|frame| self.score(frame, Scored::Selection));
        last + 1 < frames
    }

    /// The frames that are scored: those in which the kernel has all its frames, or all frames of an
    /// animation that is too short for that.
    fn scored(&self) -> Range<usize> {
        let frames = self.plan.shape.frames();
        let whole =
            self.footprint.high.z as usize..frames.saturating_sub((-self.footprint.low.z) as usize);
        if whole.is_empty() { 0..frames } else { whole }
    }

    /// The first frame whose error the next wave can change.
    fn oldest_seen(&self) -> usize {
        let spread = (self.lambdas.len() - 1) * LAG;
        self.wave.saturating_sub(spread + (-self.footprint.low.z) as usize)
    }

    /// The scores of the frames that are done.
    pub fn scores(&self) -> SelectScores {
        self.sums.scores(self.plan.shape, self.filters.render.is_some())
    }

    /// How often each candidate was chosen.
    pub fn chosen(&self) -> impl Iterator<Item = (String, u64)> {
        self.chosen.iter().enumerate().map(|(i, &count)| (self.mixture.name(i), count))
    }

    /// λ of each sweep, and how many pixels changed in it.
    pub fn sweeps(&self) -> impl Iterator<Item = (f32, u64)> {
        self.lambdas.iter().copied().zip(self.changes.iter().copied())
    }

    fn count(&mut self, frame: usize) {
        let rows = self.plan.choice_rows(frame, 0..self.plan.shape.height());
        for &choice in &self.window.choice.whole()[rows] {
            self.chosen[usize::from(choice)] += 1;
        }
    }

    /// Prepares all frames, which must fit into the window.
    #[cfg(test)]
    pub(super) fn prepare_all(&mut self) {
        self.prepared = self.plan.shape.frames();
        (0..self.prepared).for_each(|frame| self.prepare(frame));
        if self.norm == Norm::L2 {
            (0..self.prepared).for_each(|frame| self.curve(frame));
        }
    }

    /// What is chosen in frames that all are in the window.
    #[cfg(test)]
    pub(super) fn choices(&self) -> Vec<Vec<u8>> {
        let rows = 0..self.plan.shape.height();
        let of =
            |frame| self.window.choice.whole()[self.plan.choice_rows(frame, rows.clone())].to_vec();
        (0..self.plan.shape.frames()).map(of).collect()
    }
}
