//! Scores of a selection: pRelMSE of what is chosen, and of what it is chosen from.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::AnimationShape;
use super::filter::{Border, FilterScratch};
use super::sources::{Shares, Source};
use super::window::WindowPlan;

/// Which methods are scored: renders as soon as the frames around are there, so that they need not stay
/// in memory until the selection is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scored {
    Selection,
    Others,
}

impl Scored {
    /// Their places among so many methods.
    fn methods(self, all: usize) -> Range<usize> {
        match self {
            Self::Selection => 0..1,
            Self::Others => 1..all,
        }
    }
}

/// The selection and the mean of all renders come before the renders.
const OTHERS: usize = 2;

/// How much is scored: the selection, the mean of all renders, and each render.
pub(super) fn methods(renders: usize) -> usize {
    OTHERS + renders
}

/// Sums of squares over frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Sums {
    frames: usize,
    /// Of each method, without TAA and with it.
    sums: Vec<[f64; 2]>,
}

/// pRelMSE of one picture sequence: mean of ε²/(I² + 0.01), with error ε and reference I as they are
/// seen, over all pixels, channels and frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MethodScores {
    /// As the eye sees it.
    pub plain: f64,
    /// As the eye sees it behind temporal anti-aliasing.
    pub taa: Option<f64>,
}

/// All scores.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelectScores {
    /// Of what was chosen.
    pub selection: MethodScores,
    /// Of the mean of all renders.
    pub mean: MethodScores,
    /// Of each render alone.
    pub renders: Vec<MethodScores>,
    /// Over how many frames.
    pub frames: usize,
}

impl Sums {
    pub fn new(renders: usize) -> Self {
        Self { frames: 0, sums: vec![[0.0; 2]; methods(renders)] }
    }

    /// Whether they are those of so many renders.
    pub fn fits(&self, renders: usize) -> bool {
        self.sums.len() == methods(renders)
    }

    /// Adds what is scored of a frame's strips, in their order.
    pub fn add(&mut self, strips: &[f64], scored: Scored) {
        self.frames += usize::from(scored == Scored::Selection);
        let methods = self.sums.len();
        for strip in strips.chunks_exact(2 * methods) {
            for i in scored.methods(methods) {
                let sum = &mut self.sums[i];
                *sum = [sum[0] + strip[2 * i], sum[1] + strip[2 * i + 1]];
            }
        }
    }

    pub fn scores(&self, shape: AnimationShape, has_taa: bool) -> SelectScores {
        let count = (shape.values() * self.frames.max(1)) as f64;
        let mut scores = self.sums.iter().map(|sums| MethodScores {
            plain: sums[0] / count,
            taa: has_taa.then_some(sums[1] / count),
        });
        let mut next = || scores.next().expect("a score for each method");
        let (selection, mean) = (next(), next());
        SelectScores { selection, mean, renders: scores.collect(), frames: self.frames }
    }
}

/// The sums of squares of a strip of a frame: for each method that is scored, without TAA and with it.
pub(super) fn strip_sums(
    shares: &Shares<'_>,
    (frame, scored): (usize, Scored),
    rows: Range<usize>,
    sums: &mut [f64],
) {
    let plan: &WindowPlan = shares.plan;
    let (shape, [left, top]) = (plan.shape, plan.corner);
    let within = (rows.clone(), shape.height());
    let mut scratch = FilterScratch::default();
    let nothing = vec![0.0; rows.len() * shape.width()];
    let (mut seen, mut mean, mut shift) = (nothing.clone(), nothing.clone(), nothing.clone());
    let methods = scored.methods(sums.len() / 2);
    sums[2 * methods.start..2 * methods.end].fill(0.0);
    for channel in 0..shape.channels() {
        let padded = plan.seen_rows(frame, channel, rows.start + top..rows.end + top);
        let weights = &shares.weights[padded];
        let squares = |seen: &[f32], shift: &[f32]| -> f64 {
            let rows = seen.chunks_exact(shape.width()).zip(shift.chunks_exact(shape.width()));
            let of_row = |((row, shift), weights): ((&[f32], &[f32]), &[f32])| {
                let all = row.iter().zip(shift).zip(&weights[left..]);
                let square = |((&r, &shift), &w): ((&f32, &f32), &f32)| {
                    let r = f64::from(r + shift);
                    r * r * shares.squared_weight(w)
                };
                all.map(square).sum::<f64>()
            };
            rows.zip(weights.chunks_exact(plan.stride)).map(of_row).sum()
        };
        shares.shift(frame, channel, &within, &mut scratch, &mut shift);
        let plain = (&shares.filters.eye, &nothing);
        let taa = shares.filters.render.as_ref().map(|render| (render, &shift));
        for (i, (filter, shift)) in [plain].into_iter().chain(taa).enumerate() {
            let mut see = |source: Source, seen: &mut [f32]| {
                let errors = shares.errors(source, channel);
                let at = frame as i64;
                filter.rows(&errors, at, within.clone(), Border::Zero, &mut scratch, seen);
            };
            if scored == Scored::Selection {
                see(Source::Selection, &mut seen);
                sums[i] += squares(&seen, shift);
                continue;
            }
            // What is seen of a mean is the mean of what is seen.
            mean.fill(0.0);
            for k in 0..plan.renders {
                see(Source::Render(k), &mut seen);
                sums[2 * (OTHERS + k) + i] += squares(&seen, shift);
                let share = 1.0 / plan.renders as f32;
                mean.iter_mut().zip(&seen).for_each(|(mean, seen)| *mean += share * seen);
            }
            sums[2 + i] += squares(&mean, shift);
        }
    }
}
