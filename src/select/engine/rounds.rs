//! The rounds of a wave: what threads do with the strips of a frame.
//!
//! A frame that comes in starts with its closest candidates. When the frames around it are there, its
//! weights and its residual are made, and its curvature before the first visit. Sweeps visit its pixels,
//! and in the end it is scored.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use perceptile_cluster::Ends;

use super::Selection;
use crate::select::filter::{Border, FilterScratch};
use crate::select::options::Norm;
use crate::select::score::{Scored, strip_sums};
use crate::select::sources::{Method, Shares, Weights};
use crate::select::strips::COLOURS;
use crate::select::visit::{Magnitudes, Squares, Strip};

/// What pRelMSE adds to the squared reference.
const FLOOR: f32 = 0.01;

impl Selection {
    fn next_round(&mut self) -> u64 {
        self.round += 1;
        self.round
    }

    /// Chooses the candidates of a new frame that are closest to the reference.
    pub(super) fn start(&mut self, frame: usize) {
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
    pub(super) fn prepare(&mut self, frame: usize) {
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
    pub(super) fn curve(&mut self, frame: usize) {
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
    pub(in crate::select) fn sweep(&mut self, frame: usize, sweep: usize) {
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
    pub(super) fn score(&mut self, frame: usize, scored: Scored) {
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
}
