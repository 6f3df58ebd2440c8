//! The rounds of a wave: what the threads of all workers do with the strips of a frame.
//!
//! When the frames around it are there, a frame's weights and its residual are made, and its curvature
//! before the first visit. Sweeps visit its pixels, and in the end it is scored.

use std::ops::Range;

use perceptile_cluster::Ends;

use super::Engine;
use crate::select::faults;
use crate::select::filter::{Border, FilterScratch};
use crate::select::options::Norm;
use crate::select::score::{Scored, strip_sums};
use crate::select::sources::{Shares, Source, Weights};
use crate::select::strips::{COLOURS, Strips};
use crate::select::visit::{Magnitudes, Squares, Strip};

/// What pRelMSE adds to the squared reference.
const FLOOR: f32 = 0.01;

impl Engine {
    /// The number of the next round, unless others have done all of it.
    fn next_round(&mut self) -> Option<u64> {
        self.round += 1;
        (self.worker.board().completed() < self.round).then_some(self.round)
    }

    /// Makes the weights and the residual of a frame.
    pub(super) fn prepare(&mut self, frame: usize) {
        let Some(round) = self.next_round() else { return };
        let Self { plan, worker, window, filters, norm, borders, .. } = self;
        let (shape, [left, top]) = (plan.shape, plan.corner);
        let (own, strips) = (plan.own.clone(), plan.strips.len());
        // The margins go along with the first and the last strip.
        let padded = |strip: usize| {
            let rows = plan.strips.rows(strip);
            let from = if strip == 0 { 0 } else { rows.start + top };
            from..if strip + 1 == strips { rows.end + plan.reach } else { rows.end + top }
        };
        let deal = || -> Vec<Vec<Range<usize>>> {
            own.clone()
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
            renders: &window.renders,
            current: window.current.whole(),
        };
        let shards = (&mut window.residual, &mut window.weights);
        worker.round(round, Ends::Half, 0..own.len(), shards, |job, (residual, weights)| {
            let strip = own.start + job.index();
            let rows = plan.strips.rows(strip);
            let within = (rows.clone(), shape.height());
            let first = rows.start + top - padded(strip).start;
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
                    &shares.errors(Source::Selection, c),
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
            worker.fault(faults::PREPARE);
        });
        borders.after_prepare(plan, window, frame);
    }

    /// Makes the curvature of a frame, when so many have their weights.
    pub(super) fn curve(&mut self, frame: usize, prepared: usize) {
        let Some(round) = self.next_round() else { return };
        let Self { plan, worker, window, filters, .. } = self;
        let (shape, own) = (plan.shape, plan.own.clone());
        let ranges = |strip| {
            let rows = plan.strips.rows(strip);
            (0..shape.channels()).map(|c| plan.visited_rows(frame, c, rows.clone())).collect()
        };
        window.curvature.deal(own.clone().map(ranges).collect());
        let weights = window.weights.whole();
        let frames = prepared.saturating_sub(plan.seen) as i64..prepared as i64;
        worker.round(
            round,
            Ends::Half,
            0..own.len(),
            (&mut window.curvature,),
            |job, (curvature,)| {
                let within = (plan.strips.rows(own.start + job.index()), shape.height());
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
            match self.plan.shape.channels() {
                1 => self.visit::<1>(frame, sweep, colour),
                _ => self.visit::<3>(frame, sweep, colour),
            }
        }
    }

    /// Visits the strips of a colour.
    fn visit<const C: usize>(&mut self, frame: usize, sweep: usize, colour: usize) {
        let Some(round) = self.next_round() else { return };
        let Self { plan, worker, window, footprint, mixture, norm, simd, borders, .. } = self;
        let lambda = self.lambdas[sweep];
        let strips: Vec<usize> = Strips::of_colour(&plan.own, colour).collect();
        // The frames that see this one, and which of the footprint they are.
        let low = frame as i64 + i64::from(footprint.low.z);
        let frames = footprint.frames() as i64;
        let present = (-low).clamp(0, frames)..(plan.shape.frames() as i64 - low).clamp(0, frames);
        let present = present.start as usize..present.end as usize;
        let rows = |&strip: &usize| plan.strips.rows(strip);
        let seen = |rows: Range<usize>| -> Vec<Range<usize>> {
            let rows = rows.start..rows.end + plan.reach;
            present
                .clone()
                .flat_map(|d| (0..C).map(move |c| ((low + d as i64) as usize, c)))
                .map(|(frame, c)| plan.seen_rows(frame, c, rows.clone()))
                .collect()
        };
        let pictures = |rows: Range<usize>| -> Vec<Range<usize>> {
            (0..C).map(|c| plan.picture_rows(frame, c, rows.clone())).collect()
        };
        window.residual.deal(strips.iter().map(|strip| seen(rows(strip))).collect());
        window.current.deal(strips.iter().map(|strip| pictures(rows(strip))).collect());
        // What a strip has of bytes and of counts goes with its choices.
        let choices = |strip| vec![plan.choice_rows(frame, rows(strip))];
        window.choice.deal(strips.iter().map(choices).collect());
        let changes = |&strip: &usize| vec![plan.strip_changes(sweep, strip)];
        window.changes.deal(strips.iter().map(changes).collect());
        let (weights, curvature) = (window.weights.whole(), window.curvature.whole());
        let (guide, renders) = (window.guide.whole(), &window.renders);
        let shards =
            (&mut window.residual, &mut window.current, &mut window.choice, &mut window.changes);
        let midway = || worker.fault(faults::VISIT);
        worker.round(
            round,
            Ends::Half,
            0..strips.len(),
            shards,
            |job, (residual, current, mut choice, mut changes)| {
                let rows = rows(&strips[job.index()]);
                let mut current = current.pieces();
                let strip = Strip::<C> {
                    job,
                    midway: &midway,
                    footprint,
                    mixture,
                    rows: rows.clone(),
                    width: plan.shape.width(),
                    stride: plan.stride,
                    lambda,
                    frames: present.clone(),
                    residual: residual.pieces().collect(),
                    weights: seen(rows.clone()).into_iter().map(|range| &weights[range]).collect(),
                    guide: std::array::from_fn(|c| {
                        &guide[plan.picture_rows(frame, c, rows.clone())]
                    }),
                    renders,
                    places: (0..plan.renders)
                        .map(|k| {
                            std::array::from_fn(|c| {
                                plan.render_rows(frame, k, c, rows.clone()).start
                            })
                        })
                        .collect(),
                    current: std::array::from_fn(|_| current.next().expect("a channel")),
                    choice: choice.piece(0),
                    changes: changes.piece(0),
                };
                match norm {
                    Norm::L1 => simd.run(Magnitudes(strip)),
                    Norm::L2 => {
                        let curvature = std::array::from_fn(|c| {
                            &curvature[plan.visited_rows(frame, c, rows.clone())]
                        });
                        simd.run(Squares { strip, curvature });
                    }
                }
            },
        );
        let present = present.map(|d| (low + d as i64) as usize);
        borders.after_visit(plan, window, (colour, frame), present);
    }

    /// Sums up the squares of a frame's errors.
    pub(super) fn score(&mut self, frame: usize, scored: Scored) {
        let Some(round) = self.next_round() else { return };
        let Self { plan, worker, window, filters, norm, .. } = self;
        let own = plan.own.clone();
        let sums = |strip: usize| vec![plan.strip_sums(frame, strip)];
        window.sums.deal(own.clone().map(sums).collect());
        let shares = Shares {
            plan,
            filters,
            weights: window.weights.whole(),
            norm: *norm,
            guide: window.guide.whole(),
            renders: &window.renders,
            current: window.current.whole(),
        };
        worker.round(round, Ends::Half, 0..own.len(), (&mut window.sums,), |job, (mut sums,)| {
            let rows = plan.strips.rows(own.start + job.index());
            strip_sums(&shares, (frame, scored), rows, sums.piece(0));
        });
    }
}
