//! The waves: frames come in, sweeps go over them, pictures go out.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use perceptile_cluster::{Ends, Worker};

use super::filter::{Border, Filter, FilterScratch};
use super::footprint::Footprint;
use super::mixture::{MAX_CANDIDATES, MAX_SUBSET_RENDERS, Mixture};
use super::options::{Norm, SelectOptions};
use super::score::{Scored, SelectScores, Sums, strip_sums};
use super::sources::{FilterSet, Method, Shares, Weights};
use super::state::SelectState;
use super::strips::COLOURS;
use super::visit::{Magnitudes, Squares, Strip};
use super::window::{Window, WindowPlan};
use super::{AnimationShape, Filters, SelectError, scale};
use crate::gradient::simd::Simd;

/// Frames between one sweep and the next.
pub const LAG: usize = 1;

/// Waves after which the residual is made anew from what is chosen: no rounding error stays, and a
/// selection can go on from there with nothing but its choices.
pub const RENEWAL: usize = 32;

/// What pRelMSE adds to the squared reference.
const FLOOR: f32 = 0.01;

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

    fn next_round(&mut self) -> u64 {
        self.round += 1;
        self.round
    }

    /// Chooses the candidates of a new frame that are closest to the reference.
    fn start(&mut self, frame: usize) {
        let round = self.next_round();
        let Self { plan, worker, window, mixture, .. } = self;
        let channels = plan.shape.channels();
        let strips = || (0..plan.strips.len()).map(|strip| plan.strips.rows(strip));
        let of_channels = |rows: Range<usize>| {
            (0..channels).map(|c| plan.picture_rows(frame, c, rows.clone())).collect()
        };
        window.current.deal(strips().map(of_channels).collect());
        window.choice.deal(strips().map(|rows| vec![plan.choice_rows(frame, rows)]).collect());
        let (guide, renders) = (window.guide.whole(), window.renders.whole());
        let shards = (&mut window.current, &mut window.choice);
        worker.round(
            round,
            Ends::Half,
            0..plan.strips.len(),
            shards,
            |job, (current, mut choice)| {
                let rows = plan.strips.rows(job.index());
                let guide: Vec<&[f32]> = (0..channels)
                    .map(|c| &guide[plan.picture_rows(frame, c, rows.clone())])
                    .collect();
                let renders: Vec<Vec<&[f32]>> = (0..plan.renders)
                    .map(|k| {
                        (0..channels)
                            .map(|c| &renders[plan.render_rows(frame, k, c, rows.clone())])
                            .collect()
                    })
                    .collect();
                let mut current: Vec<&mut [f32]> = current.pieces().collect();
                for (index, choice) in choice.piece(0).iter_mut().enumerate() {
                    let value = |candidate: usize, c: usize| {
                        mixture.value(candidate, |k| renders[k][c][index])
                    };
                    let distance = |candidate: usize| -> f32 {
                        let error = |c: usize| value(candidate, c) - guide[c][index];
                        (0..channels).map(|c| error(c) * error(c)).sum()
                    };
                    let mut best = (distance(0), 0);
                    for candidate in 1..mixture.candidates() {
                        let distance = distance(candidate);
                        if distance < best.0 {
                            best = (distance, candidate);
                        }
                    }
                    *choice = best.1 as u8;
                    for (c, current) in current.iter_mut().enumerate() {
                        current[index] = value(best.1, c);
                    }
                }
            },
        );
    }

    /// Makes the weights and the residual of a frame.
    fn prepare(&mut self, frame: usize) {
        let round = self.next_round();
        let Self { plan, worker, window, filters, norm, .. } = self;
        let (shape, [left, top]) = (plan.shape, plan.corner);
        let strips = plan.strips.len();
        // The margins go along with the first and the last strip.
        let padded = |strip: usize| {
            let rows = plan.strips.rows(strip);
            let from = if strip == 0 { 0 } else { rows.start + top };
            from..if strip + 1 == strips { plan.rows } else { rows.end + top }
        };
        let deal = || -> Vec<Vec<Range<usize>>> {
            (0..strips)
                .map(|strip| {
                    (0..shape.channels()).map(|c| plan.seen_rows(frame, c, padded(strip))).collect()
                })
                .collect()
        };
        window.residual.deal(deal());
        window.weights.deal(deal());
        let shares = Shares {
            plan,
            filters,
            weights: &[],
            norm: *norm,
            guide: window.guide.whole(),
            renders: window.renders.whole(),
            current: window.current.whole(),
        };
        let shards = (&mut window.residual, &mut window.weights);
        worker.round(round, Ends::Half, 0..strips, shards, |job, (residual, weights)| {
            let rows = plan.strips.rows(job.index());
            let within = (rows.clone(), shape.height());
            let first = rows.start + top - padded(job.index()).start;
            let mut scratch = FilterScratch::default();
            let mut seen = vec![0.0; rows.len() * shape.width()];
            let (mut error, mut shift) = (seen.clone(), seen.clone());
            let at = frame as i64;
            for (c, (residual, weights)) in residual.pieces().zip(weights.pieces()).enumerate() {
                filters.eye.rows(
                    &shares.reference(c),
                    at,
                    within.clone(),
                    Border::Same,
                    &mut scratch,
                    &mut seen,
                );
                shares.shift(frame, c, &within, &mut scratch, &mut shift);
                filters.render.as_ref().unwrap_or(&filters.eye).rows(
                    &shares.errors(Method::Selection, c),
                    at,
                    within.clone(),
                    Border::Zero,
                    &mut scratch,
                    &mut error,
                );
                residual.fill(0.0);
                weights.fill(0.0);
                for y in 0..rows.len() {
                    let target = (first + y) * plan.stride + left;
                    for x in 0..shape.width() {
                        let i = y * shape.width() + x;
                        let square = 1.0 / (seen[i] * seen[i] + FLOOR);
                        let error = error[i] + shift[i];
                        (residual[target + x], weights[target + x]) = match norm {
                            Norm::L1 => (error, square.sqrt()),
                            Norm::L2 => (square * error, square),
                        };
                    }
                }
            }
        });
    }

    /// Makes the curvature of a frame.
    fn curve(&mut self, frame: usize) {
        let round = self.next_round();
        let prepared = self.prepared as i64;
        let Self { plan, worker, window, filters, .. } = self;
        let (shape, strips) = (plan.shape, plan.strips.len());
        let ranges = |strip| {
            let rows = plan.strips.rows(strip);
            (0..shape.channels()).map(|c| plan.visited_rows(frame, c, rows.clone())).collect()
        };
        window.curvature.deal((0..strips).map(ranges).collect());
        let weights = window.weights.whole();
        let frames = prepared - (plan.seen.min(prepared as usize)) as i64..prepared;
        worker.round(
            round,
            Ends::Half,
            0..strips,
            (&mut window.curvature,),
            |job, (curvature,)| {
                let within = (plan.strips.rows(job.index()), shape.height());
                let mut scratch = FilterScratch::default();
                for (channel, plane) in curvature.pieces().enumerate() {
                    let weights = Weights { plan, weights, channel, frames: frames.clone() };
                    let at = frame as i64;
                    filters.squares.rows(
                        &weights,
                        at,
                        within.clone(),
                        Border::Zero,
                        &mut scratch,
                        plane,
                    );
                }
            },
        );
    }

    /// Visits all pixels of a frame.
    pub(super) fn sweep(&mut self, frame: usize, sweep: usize) {
        for colour in 0..COLOURS {
            let changed = match self.plan.shape.channels() {
                1 => self.visit::<1>(frame, sweep, colour),
                _ => self.visit::<3>(frame, sweep, colour),
            };
            self.changes[sweep] += changed;
        }
    }

    /// Visits the strips of a colour. Returns how many pixels changed.
    fn visit<const C: usize>(&mut self, frame: usize, sweep: usize, colour: usize) -> u64 {
        let round = self.next_round();
        let Self { plan, worker, window, footprint, mixture, norm, simd, .. } = self;
        let lambda = self.lambdas[sweep];
        let strips: Vec<Range<usize>> = plan.strips.of_colour(colour).collect();
        // The frames that see this one, and which of the footprint they are.
        let low = frame as i64 + i64::from(footprint.low.z);
        let frames = footprint.frames() as i64;
        let present = (-low).clamp(0, frames)..(plan.shape.frames() as i64 - low).clamp(0, frames);
        let present = present.start as usize..present.end as usize;
        let seen = |rows: &Range<usize>| -> Vec<Range<usize>> {
            let rows = rows.start..rows.end + footprint.height - 1;
            present
                .clone()
                .flat_map(|d| (0..C).map(move |c| ((low + d as i64) as usize, c)))
                .map(|(frame, c)| plan.seen_rows(frame, c, rows.clone()))
                .collect()
        };
        let pictures = |rows: &Range<usize>| -> Vec<Range<usize>> {
            (0..C).map(|c| plan.picture_rows(frame, c, rows.clone())).collect()
        };
        window.residual.deal(strips.iter().map(seen).collect());
        window.current.deal(strips.iter().map(pictures).collect());
        let choices = |rows: &Range<usize>| vec![plan.choice_rows(frame, rows.clone())];
        window.choice.deal(strips.iter().map(choices).collect());
        let (weights, curvature) = (window.weights.whole(), window.curvature.whole());
        let (guide, renders) = (window.guide.whole(), window.renders.whole());
        let changed = AtomicU64::new(0);
        let shards = (&mut window.residual, &mut window.current, &mut window.choice);
        worker.round(
            round,
            Ends::Half,
            0..strips.len(),
            shards,
            |job, (residual, current, mut choice)| {
                let rows = &strips[job.index()];
                let mut current = current.pieces();
                let strip = Strip::<C> {
                    footprint,
                    mixture,
                    rows: rows.clone(),
                    width: plan.shape.width(),
                    stride: plan.stride,
                    lambda,
                    frames: present.clone(),
                    residual: residual.pieces().collect(),
                    weights: seen(rows).into_iter().map(|range| &weights[range]).collect(),
                    guide: std::array::from_fn(|c| {
                        &guide[plan.picture_rows(frame, c, rows.clone())]
                    }),
                    renders: (0..plan.renders)
                        .map(|k| {
                            std::array::from_fn(|c| {
                                &renders[plan.render_rows(frame, k, c, rows.clone())]
                            })
                        })
                        .collect(),
                    current: std::array::from_fn(|_| current.next().expect("a channel")),
                    choice: choice.piece(0),
                };
                let changes = match norm {
                    Norm::L1 => simd.run(Magnitudes(strip)),
                    Norm::L2 => {
                        let curvature = std::array::from_fn(|c| {
                            &curvature[plan.visited_rows(frame, c, rows.clone())]
                        });
                        simd.run(Squares { strip, curvature })
                    }
                };
                changed.fetch_add(changes, Ordering::Relaxed);
            },
        );
        changed.into_inner()
    }

    /// Adds the scores of a frame.
    fn score(&mut self, frame: usize, scored: Scored) {
        let round = self.next_round();
        let Self { plan, worker, window, filters, norm, sums, .. } = self;
        let strips = plan.strips.len();
        let sums_of = |strip: usize| strip * plan.sums..(strip + 1) * plan.sums;
        window.sums.deal((0..strips).map(|strip| vec![sums_of(strip)]).collect());
        let shares = Shares {
            plan,
            filters,
            weights: window.weights.whole(),
            norm: *norm,
            guide: window.guide.whole(),
            renders: window.renders.whole(),
            current: window.current.whole(),
        };
        worker.round(round, Ends::Half, 0..strips, (&mut window.sums,), |job, (mut of_strip,)| {
            let rows = plan.strips.rows(job.index());
            strip_sums(&shares, (frame, scored), rows, of_strip.piece(0));
        });
        sums.add(&window.sums.whole()[..strips * plan.sums], scored);
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
