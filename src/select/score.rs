//! Scores of a selection: pRelMSE of what is chosen, and of what it is chosen from.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::AnimationShape;
use super::filter::{Border, Filter, FilterScratch};
use super::sources::{Errors, Method, Shares};
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
        Self { frames: 0, sums: vec![[0.0; 2]; Method::all(renders).count()] }
    }

    /// Whether they are those of so many renders.
    pub fn fits(&self, renders: usize) -> bool {
        self.sums.len() == Method::all(renders).count()
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
    let mut seen = vec![0.0; rows.len() * shape.width()];
    let mut shift = seen.clone();
    let methods = scored.methods(sums.len() / 2);
    sums[2 * methods.start..2 * methods.end].fill(0.0);
    for channel in 0..shape.channels() {
        let padded = plan.seen_rows(frame, channel, rows.start + top..rows.end + top);
        let weights = &shares.weights[padded];
        let mut measure = |filter: &Filter, shift: Option<&[f32]>, errors: &Errors<'_>| {
            filter.rows(
                errors,
                frame as i64,
                within.clone(),
                Border::Zero,
                &mut scratch,
                &mut seen,
            );
            let rows = seen.chunks_exact(shape.width()).zip(weights.chunks_exact(plan.stride));
            rows.enumerate()
                .map(|(y, (row, weights))| {
                    let weights = &weights[left..];
                    let shift = |x| shift.map_or(0.0, |shift| shift[y * shape.width() + x]);
                    let square = |(x, (&r, &w)): (usize, (&f32, &f32))| {
                        let r = f64::from(r + shift(x));
                        r * r * shares.squared_weight(w)
                    };
                    row.iter().zip(weights).enumerate().map(square).sum::<f64>()
                })
                .sum::<f64>()
        };
        if shares.filters.render.is_some() {
            shares.shift(frame, channel, &within, &mut FilterScratch::default(), &mut shift);
        }
        let all = Method::all(plan.renders).zip(sums.as_chunks_mut::<2>().0);
        for (method, sums) in all.skip(methods.start).take(methods.len()) {
            let errors = shares.errors(method, channel);
            sums[0] += measure(&shares.filters.eye, None, &errors);
            if let Some(render) = &shares.filters.render {
                sums[1] += measure(render, Some(&shift), &errors);
            }
        }
    }
}
