//! A selection as its owner sees it: frames go in, pictures and scores come out.
//!
//! The owner is the process that reads and writes: the only one, the one that looks after workers, or
//! the first of several ranks. Other ranks follow it with the same calls.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{cast_slice, cast_slice_mut};
use perceptile_cluster::communicator::{Communicator, Single};

use super::engine::Engine;
use super::mixture::UNSET;
use super::plan::SelectPlan;
use super::schedule::{Schedule, Wave};
use super::score::{Scored, SelectScores, Sums};
use super::state::SelectState;
use super::{AnimationShape, SelectError};
use crate::gradient::simd::Simd;

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
    pub(super) engine: Engine,
    shape: AnimationShape,
    has_taa: bool,
    /// What each rank has.
    ranks: Vec<Rows>,
    /// Frames that came in.
    loaded: usize,
    /// Choices that are to be taken over with their frames, from a state.
    kept: Option<Kept>,
    /// Frames that are done.
    done: usize,
    sums: Sums,
    /// How often each candidate was chosen, in the frames that are done.
    chosen: Vec<u64>,
    /// Pixels that changed in each sweep, before it went on.
    changes: Vec<u64>,
}

/// Rows of a rank.
struct Rows {
    own: Range<usize>,
    held: Range<usize>,
    strips: usize,
}

/// Choices of a state.
struct Kept {
    /// The first frame that they are of, and the one behind the last.
    first: usize,
    end: usize,
    choices: Vec<u8>,
}

impl Selection {
    /// Prepares a selection by the threads of the current pool.
    ///
    /// # Errors
    /// A kernel that is too large, no memory.
    pub fn new(plan: &SelectPlan, simd: Simd) -> Result<Self, SelectError> {
        Self::of_ranks(plan, simd, Arc::new(Single))
    }

    /// The same as one of several ranks, with all of them.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_ranks(
        plan: &SelectPlan,
        simd: Simd,
        communicator: Arc<dyn Communicator>,
    ) -> Result<Self, SelectError> {
        Ok(Self::with_engine(plan, Engine::of_rank(plan, simd, communicator)?))
    }

    /// The owner of a selection that an engine is part of.
    pub(super) fn with_engine(plan: &SelectPlan, engine: Engine) -> Self {
        let ranks = (0..plan.parallelism.ranks).map(|rank| {
            let of_rank = engine.window_of(plan, rank);
            let (own, strips) = (of_rank.own_rows(), of_rank.own.len());
            Rows { own, held: of_rank.held, strips }
        });
        Self {
            shape: plan.shape,
            has_taa: plan.filters.taa.is_some(),
            ranks: ranks.collect(),
            loaded: 0,
            kept: None,
            done: 0,
            sums: Sums::new(plan.candidates.renders),
            chosen: vec![0; engine.mixture.candidates()],
            changes: vec![0; engine.lambdas.len()],
            engine,
        }
    }

    fn communicator(&self) -> Arc<dyn Communicator> {
        Arc::clone(self.engine.worker.communicator())
    }

    fn rank(&self) -> usize {
        self.communicator().rank()
    }

    /// The frames that the next wave needs and that are not there yet.
    pub fn needed(&self) -> Range<usize> {
        self.loaded..self.engine.schedule.started(self.engine.wave() + 1).max(self.loaded)
    }

    /// Takes in the next frame; at the root of several ranks, hands on what they need of it. They take
    /// it in with [`Self::receive`].
    ///
    /// # Panics
    /// If it is not of the animation's size.
    pub fn load(&mut self, frame: &Frame) {
        let (shape, communicator) = (self.shape, self.communicator());
        assert_eq!(frame.renders.len(), self.engine.plan.renders);
        let planes = || {
            let pictures = [&frame.guide].into_iter().chain(&frame.renders);
            pictures.flat_map(|picture| {
                assert_eq!(picture.len(), shape.values());
                picture.chunks_exact(shape.pixels())
            })
        };
        let rows = |rows: &Range<usize>| rows.start * shape.width()..rows.end * shape.width();
        let kept = self.kept(self.loaded);
        for (rank, of_rank) in self.ranks.iter().enumerate().skip(1) {
            let held = rows(&of_rank.held);
            planes().for_each(|plane| communicator.send(rank, cast_slice(&plane[held.clone()])));
            if let Some(choices) = kept {
                communicator.send(rank, &words(&choices[held]));
            }
        }
        let held = rows(&self.ranks[0].held);
        let kept = kept.map(|choices| choices[held.clone()].to_vec());
        self.put(planes().map(|plane| &plane[held.clone()]), kept);
    }

    /// Takes in the next frame from the root.
    pub fn receive(&mut self) {
        let (plan, communicator) = (&self.engine.plan, self.communicator());
        let values = plan.held.len() * self.shape.width();
        let planes = (1 + plan.renders) * self.shape.channels();
        let mut received = vec![0.0_f32; planes * values];
        for plane in received.chunks_exact_mut(values) {
            communicator.receive(0, cast_slice_mut(plane));
        }
        let kept = self.is_kept(self.loaded).then(|| {
            let mut words = vec![0; values.div_ceil(4)];
            communicator.receive(0, &mut words);
            cast_slice(&words)[..values].to_vec()
        });
        self.put(received.chunks_exact(values), kept);
    }

    /// Takes in the rows of the next frame that this rank holds, plane by plane: the reference, then
    /// every render. Choices that are kept are taken over.
    fn put<'p>(&mut self, mut planes: impl Iterator<Item = &'p [f32]>, kept: Option<Vec<u8>>) {
        let Engine { plan, window, mixture, .. } = &mut self.engine;
        let (at, held, channels) = (self.loaded, plan.held.clone(), self.shape.channels());
        for channel in 0..channels {
            let plane = planes.next().expect("a plane of the reference");
            let place = plan.picture_rows(at, channel, held.clone());
            window.guide.whole_mut()[place].copy_from_slice(plane);
        }
        for (i, plane) in planes.enumerate() {
            let place = plan.render_rows(at, i / channels, i % channels, held.clone());
            window.renders.write(place, plane);
        }
        self.loaded += 1;
        let choices = kept.unwrap_or_else(|| vec![UNSET; held.len() * self.shape.width()]);
        window.choice.whole_mut()[plan.choice_rows(at, held.clone())].copy_from_slice(&choices);
        let is_set = choices.iter().any(|&choice| choice != UNSET);
        let mut renders = vec![vec![0.0; choices.len()]; if is_set { plan.renders } else { 0 }];
        for channel in 0..channels {
            for (k, render) in renders.iter_mut().enumerate() {
                window.renders.read(plan.render_rows(at, k, channel, held.clone()), render);
            }
            let place = plan.picture_rows(at, channel, held.clone());
            let guide = &window.guide.whole()[place.clone()];
            let current = &mut window.current.whole_mut()[place];
            current.copy_from_slice(guide);
            for (i, (current, &choice)) in current.iter_mut().zip(&choices).enumerate() {
                if choice != UNSET {
                    *current = mixture.value(choice.into(), |k| renders[k][i]);
                }
            }
        }
    }

    /// The choices of a frame that are kept.
    fn kept(&self, frame: usize) -> Option<&[u8]> {
        let kept = self.kept.as_ref().filter(|_| self.is_kept(frame))?;
        kept.choices.chunks_exact(self.shape.pixels()).nth(frame - kept.first)
    }

    fn is_kept(&self, frame: usize) -> bool {
        self.kept.as_ref().is_some_and(|kept| (kept.first..kept.end).contains(&frame))
    }

    /// The choices, if the next wave makes the residual anew: [`Self::restore`] goes on from there.
    /// Called before frames are loaded for that wave; by all ranks, of which the root gets them.
    pub fn state(&self) -> Option<SelectState> {
        let wave = self.engine.wave();
        if !Schedule::is_renewal(wave) {
            return None;
        }
        let first = self.engine.schedule.oldest_read(wave);
        let mut choices = vec![0; (self.loaded - first) * self.shape.pixels()];
        let frames = choices.chunks_exact_mut(self.shape.pixels());
        frames.enumerate().for_each(|(i, choices)| self.gather_choices(first + i, choices));
        let changes = self.all_changes();
        (self.rank() == 0).then(|| SelectState {
            wave,
            first,
            choices,
            sums: self.sums.clone(),
            chosen: self.chosen.clone(),
            changes,
            done: self.done,
        })
    }

    /// Goes on from a state of the same selection, before the first wave.
    ///
    /// # Errors
    /// [`SelectError::State`] if it is the state of another selection.
    pub fn restore(&mut self, state: SelectState) -> Result<(), SelectError> {
        let SelectState { wave, first, choices, sums, chosen, changes, done } = state;
        let schedule = self.engine.schedule;
        let end = schedule.started(wave);
        let fits = Schedule::is_renewal(wave)
            && wave < schedule.waves()
            && first == schedule.oldest_read(wave)
            && end
                .checked_sub(first)
                .is_some_and(|held| held.checked_mul(self.shape.pixels()) == Some(choices.len()))
            && choices
                .iter()
                .all(|&choice| usize::from(choice) < self.chosen.len() || choice == UNSET)
            && sums.fits(self.engine.plan.renders)
            && chosen.len() == self.chosen.len()
            && changes.len() == self.changes.len();
        if !fits || self.engine.wave() > 0 || self.loaded > 0 {
            return Err(SelectError::State);
        }
        self.go_on_from(wave);
        (self.sums, self.chosen, self.changes, self.done) = (sums, chosen, changes, done);
        self.kept = Some(Kept { first, end, choices });
        Ok(())
    }

    /// Goes on where the root does, which has a state of this wave.
    pub fn go_on_from(&mut self, wave: usize) {
        if wave > 0 {
            let schedule = self.engine.schedule;
            let (first, end) = (schedule.oldest_read(wave), schedule.started(wave));
            self.kept = Some(Kept { first, end, choices: Vec::new() });
            self.loaded = first;
            self.engine.begin_with(wave);
        }
    }

    /// The wave that is next.
    pub fn wave(&self) -> usize {
        self.engine.wave()
    }

    /// Goes on by a wave: `done` gets the number, the picture (channel by channel) and the choices of
    /// the frame that is done with it, if one is; of several ranks, the root's. Returns whether there
    /// is more to do.
    ///
    /// # Panics
    /// If frames are missing that it needs.
    pub fn advance(&mut self, done: impl FnOnce(usize, &[f32], &[u8])) -> bool {
        assert!(self.needed().is_empty(), "frames are missing");
        let wave = self.engine.advance();
        self.collect(&wave, done)
    }

    /// Takes out what a wave has made. Returns whether there is more to do.
    pub(super) fn collect(&mut self, wave: &Wave, done: impl FnOnce(usize, &[f32], &[u8])) -> bool {
        self.kept.take_if(|kept| kept.end <= self.loaded);
        for frame in wave.scored_renders.clone() {
            self.add_sums(frame, Scored::Others);
        }
        for frame in wave.scored.clone() {
            self.add_sums(frame, Scored::Selection);
        }
        if let Some(frame) = wave.done {
            let mut choices = vec![0; self.shape.pixels()];
            self.gather_choices(frame, &mut choices);
            let mut picture = vec![0.0; self.shape.values()];
            self.gather_picture(frame, &mut picture);
            self.done = frame + 1;
            if self.rank() == 0 {
                choices.iter().for_each(|&choice| self.chosen[usize::from(choice)] += 1);
                done(frame, &picture, &choices);
            }
        }
        !wave.is_last
    }

    /// Adds what a frame's strips have found.
    fn add_sums(&mut self, frame: usize, scored: Scored) {
        let (plan, communicator) = (&self.engine.plan, self.communicator());
        let sums = self.engine.window.sums.whole();
        let first = plan.strip_sums(frame, plan.own.start).start;
        let own = &sums[first..first + plan.own.len() * plan.sums];
        if communicator.rank() > 0 {
            communicator.send(0, cast_slice(own));
            return;
        }
        let mut all = own.to_vec();
        for (rank, of_rank) in self.ranks.iter().enumerate().skip(1) {
            let mut received = vec![0.0_f64; of_rank.strips * plan.sums];
            communicator.receive(rank, cast_slice_mut(&mut received));
            all.extend(received);
        }
        self.sums.add(&all, scored);
    }

    /// Puts all ranks' choices of a frame together, at the root.
    fn gather_choices(&self, frame: usize, out: &mut [u8]) {
        let plan = &self.engine.plan;
        let own = &self.engine.window.choice.whole()[plan.choice_rows(frame, plan.own_rows())];
        let communicator = self.communicator();
        self.gather(
            own,
            out,
            |own| communicator.send(0, &words(own)),
            |rank, part| {
                let mut words = vec![0; part.len().div_ceil(4)];
                communicator.receive(rank, &mut words);
                part.copy_from_slice(&cast_slice(&words)[..part.len()]);
            },
        );
    }

    /// Puts all ranks' rows of a frame together, at the root.
    fn gather_picture(&self, frame: usize, out: &mut [f32]) {
        let plan = &self.engine.plan;
        let current = self.engine.window.current.whole();
        let communicator = self.communicator();
        for (channel, plane) in out.chunks_exact_mut(self.shape.pixels()).enumerate() {
            let own = &current[plan.picture_rows(frame, channel, plan.own_rows())];
            self.gather(
                own,
                plane,
                |own| communicator.send(0, cast_slice(own)),
                |rank, part| {
                    communicator.receive(rank, cast_slice_mut(part));
                },
            );
        }
    }

    /// Puts all ranks' rows of a plane together, at the root; other ranks send theirs.
    fn gather<T: Copy>(
        &self,
        own: &[T],
        out: &mut [T],
        send: impl FnOnce(&[T]),
        receive: impl Fn(usize, &mut [T]),
    ) {
        if self.rank() > 0 {
            return send(own);
        }
        let mut rest = out;
        for (rank, of_rank) in self.ranks.iter().enumerate() {
            let (part, behind) = rest.split_at_mut(of_rank.own.len() * self.shape.width());
            match rank {
                0 => part.copy_from_slice(own),
                _ => receive(rank, part),
            }
            rest = behind;
        }
    }

    /// Pixels that changed in each sweep, of all ranks.
    fn all_changes(&self) -> Vec<u64> {
        let strips = self.engine.plan.own.len();
        let of_sweeps = self.engine.window.changes.whole().chunks_exact(strips);
        let mut sums: Vec<i64> =
            of_sweeps.map(|counts| counts.iter().sum::<u64>() as i64).collect();
        self.communicator().sum(&mut sums);
        sums.iter().zip(&self.changes).map(|(&sum, before)| sum as u64 + before).collect()
    }

    /// The scores of the frames that are done; of several ranks, the root has them.
    pub fn scores(&self) -> SelectScores {
        self.sums.scores(self.shape, self.has_taa)
    }

    /// How often each candidate was chosen; of several ranks, the root knows.
    pub fn chosen(&self) -> impl Iterator<Item = (String, u64)> {
        let mixture = &self.engine.mixture;
        self.chosen.iter().enumerate().map(|(i, &count)| (mixture.name(i), count))
    }

    /// λ of each sweep, and how many pixels changed in it; called by all ranks.
    pub fn sweeps(&self) -> impl Iterator<Item = (f32, u64)> {
        self.engine.lambdas.iter().copied().zip(self.all_changes())
    }

    /// What is chosen in frames that all are in the window.
    #[cfg(test)]
    pub(super) fn choices(&self) -> Vec<Vec<u8>> {
        let of = |frame| {
            let mut choices = vec![0; self.shape.pixels()];
            self.gather_choices(frame, &mut choices);
            choices
        };
        (0..self.shape.frames()).map(of).collect()
    }
}

/// Bytes as words, the last filled up.
fn words(bytes: &[u8]) -> Vec<u32> {
    bytes
        .chunks(4)
        .map(|bytes| {
            let mut word = [0; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            u32::from_ne_bytes(word)
        })
        .collect()
}
