//! What filters read: the reference, errors of what is scored, weights; each as rows of a sequence of
//! pictures that goes on beyond its ends as the model says.

use std::ops::Range;

use super::filter::{Border, Filter, FilterScratch, Rows, add};
use super::options::Norm;
use super::window::{Renders, WindowPlan};

/// Whose errors are seen: those of what is chosen, or a render's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    Selection,
    Render(usize),
}

/// The filters, ready.
pub(super) struct FilterSet {
    /// g_s * g_t.
    pub eye: Filter,
    /// g_s * g_t * g_a, with temporal anti-aliasing.
    pub render: Option<Filter>,
    /// The squares of what renders are seen through.
    pub squares: Filter,
}

/// What all jobs of a round read.
pub(super) struct Shares<'a> {
    pub plan: &'a WindowPlan,
    pub filters: &'a FilterSet,
    pub weights: &'a [f32],
    pub norm: Norm,
    pub guide: &'a [f32],
    pub renders: &'a Renders,
    pub current: &'a [f32],
}

/// The reference, which stands still before its first frame and behind its last one.
pub(super) struct Guide<'a> {
    plan: &'a WindowPlan,
    guide: &'a [f32],
    channel: usize,
}

impl Rows for Guide<'_> {
    fn add(&self, frame: i64, row: usize, scale: f32, out: &mut [f32]) {
        let frame = frame.clamp(0, self.plan.shape.frames() as i64 - 1) as usize;
        let row = self.plan.picture_rows(frame, self.channel, row..row + 1);
        add(&self.guide[row], scale, out);
    }
}

/// Errors of a source, which has none outside of the animation.
pub(super) struct Errors<'a> {
    shares: &'a Shares<'a>,
    source: Source,
    channel: usize,
}

impl Rows for Errors<'_> {
    fn add(&self, frame: i64, row: usize, scale: f32, out: &mut [f32]) {
        let Shares { plan, guide, renders, current, .. } = *self.shares;
        if !(0..plan.shape.frames() as i64).contains(&frame) {
            return;
        }
        let (frame, rows) = (frame as usize, row..row + 1);
        let place = plan.picture_rows(frame, self.channel, rows.clone());
        let guide = &guide[place.clone()];
        let mut difference = |picture: &[f32]| {
            for ((out, &value), &guide) in out.iter_mut().zip(picture).zip(guide) {
                *out += scale * (value - guide);
            }
        };
        match self.source {
            Source::Selection => difference(&current[place]),
            Source::Render(k) => {
                let mut render = vec![0.0; place.len()];
                renders.read(plan.render_rows(frame, k, self.channel, rows), &mut render);
                difference(&render);
            }
        }
    }
}

impl<'a> Shares<'a> {
    pub fn errors(&'a self, source: Source, channel: usize) -> Errors<'a> {
        Errors { shares: self, source, channel }
    }

    pub fn reference(&self, channel: usize) -> Guide<'a> {
        Guide { plan: self.plan, guide: self.guide, channel }
    }

    /// w² of what is kept.
    pub fn squared_weight(&self, weight: f32) -> f64 {
        match self.norm {
            Norm::L1 => f64::from(weight) * f64::from(weight),
            Norm::L2 => weight.into(),
        }
    }

    /// What temporal anti-aliasing does to the reference: part of the error of every render.
    pub fn shift(
        &self,
        frame: usize,
        channel: usize,
        within: &(Range<usize>, usize),
        scratch: &mut FilterScratch,
        out: &mut [f32],
    ) {
        let Some(render) = &self.filters.render else {
            out.fill(0.0);
            return;
        };
        let (guide, frame) = (self.reference(channel), frame as i64);
        let mut seen = vec![0.0; out.len()];
        self.filters.eye.rows(&guide, frame, within.clone(), Border::Same, scratch, &mut seen);
        render.rows(&guide, frame, within.clone(), Border::Same, scratch, out);
        for (out, seen) in out.iter_mut().zip(seen) {
            *out -= seen;
        }
    }
}

/// The weights that a change of a pixel meets: 0 beyond the animation.
pub(super) struct Weights<'a> {
    pub plan: &'a WindowPlan,
    pub weights: &'a [f32],
    pub channel: usize,
    /// Frames whose weights are there.
    pub frames: Range<i64>,
}

impl Rows for Weights<'_> {
    fn add(&self, frame: i64, row: usize, scale: f32, out: &mut [f32]) {
        if self.frames.contains(&frame) {
            let [left, top] = self.plan.corner;
            let row = row + top;
            let row = self.plan.seen_rows(frame as usize, self.channel, row..row + 1);
            add(&self.weights[row][left..][..out.len()], scale, out);
        }
    }
}
