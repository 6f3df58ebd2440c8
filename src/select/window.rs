//! The frames of an animation that are in memory: rings, in which a new frame takes the place of the
//! oldest.
//!
//! Three rings hold pictures, pixel by pixel: the reference and what is chosen, until all that see
//! them are scored, and the renders, until they have been visited. Two hold what sweeps see, with
//! margins around each picture that nobody looks into: the residual and the weights. One holds the
//! curvature of the frames that are being visited.

use std::ops::Range;

use perceptile_cluster::Worker;
use perceptile_cluster::shared::{Arena, Board, BoardPlan, Map, Parts};

use super::footprint::Footprint;
use super::options::Norm;
use super::strips::Strips;
use super::{AnimationShape, SelectError};

/// How large everything is.
#[derive(Debug, Clone)]
pub(super) struct WindowPlan {
    pub shape: AnimationShape,
    pub renders: usize,
    /// Frames of the rings of the reference and of what is chosen.
    pub pictures: usize,
    /// Frames of the rings of renders, residual and weights.
    pub seen: usize,
    /// Frames of the ring of curvatures; 0 where none is needed.
    pub visited: usize,
    /// Numbers of a padded row.
    pub stride: usize,
    /// Padded rows.
    pub rows: usize,
    /// Columns and rows before the first pixel.
    pub corner: [usize; 2],
    pub strips: Strips,
    /// Sums of squares of a strip.
    pub sums: usize,
    pub threads: usize,
}

impl WindowPlan {
    /// For sweeps that are `spread` frames apart, the first from the last.
    pub fn new(
        shape: AnimationShape,
        footprint: &Footprint,
        (renders, norm): (usize, Norm),
        spread: usize,
        (sums, threads): (usize, usize),
    ) -> Self {
        let [left, top, _, bottom] = footprint.margins();
        let ahead = footprint.frames() - 1;
        let frames = |count: usize| count.min(shape.frames());
        let stride = (left + shape.width()).max(shape.width() + footprint.overhang());
        Self {
            shape,
            renders,
            pictures: frames(spread + 1 + 2 * ahead),
            seen: frames(spread + 1 + ahead),
            visited: if norm == Norm::L2 { frames(spread + 1) } else { 0 },
            stride,
            rows: top + shape.height() + bottom,
            corner: [left, top],
            strips: Strips::new(shape.height(), footprint.height),
            sums,
            threads,
        }
    }

    /// Numbers of a padded plane.
    fn plane(&self) -> usize {
        self.stride.saturating_mul(self.rows)
    }

    fn board(&self) -> BoardPlan {
        BoardPlan { workers: 1, threads: self.threads, jobs: self.strips.len(), journal: 0 }
    }

    fn sections(&self) -> [usize; 8] {
        let values = self.shape.values();
        let product =
            |factors: &[usize]| factors.iter().fold(4, |a: usize, &b| a.saturating_mul(b));
        let seen = product(&[self.seen, self.shape.channels(), self.plane()]);
        [
            seen,
            seen,
            product(&[self.visited, values]),
            product(&[self.pictures, values]),
            product(&[self.seen, self.renders, values]),
            product(&[self.pictures, values]),
            self.pictures.saturating_mul(self.shape.pixels()),
            product(&[2, self.strips.len(), self.sums]),
        ]
    }

    /// Bytes of it all; saturating.
    pub fn bytes(&self) -> usize {
        self.sections()
            .into_iter()
            .map(Arena::room)
            .fold(self.board().room(), usize::saturating_add)
    }

    /// Memory of this process alone, and the worker whose threads work on it.
    pub fn private(&self) -> Result<(Worker, Window), SelectError> {
        let mut arena = Arena::new(Map::private(self.bytes())?);
        let board = Board::new(&mut arena, self.board());
        let [residual, weights, curvature, guide, renders, current, choice, sums] =
            self.sections().map(|bytes| arena.take(bytes));
        let window = Window {
            residual: residual.parts(Vec::new()),
            weights: weights.parts(Vec::new()),
            curvature: curvature.parts(Vec::new()),
            guide: guide.parts(Vec::new()),
            renders: renders.parts(Vec::new()),
            current: current.parts(Vec::new()),
            choice: choice.parts(Vec::new()),
            sums: sums.parts(Vec::new()),
        };
        Ok((Worker::new(board, 0, None), window))
    }

    /// Where a channel of a frame is among padded planes.
    pub fn seen_plane(&self, frame: usize, channel: usize) -> usize {
        (frame % self.seen * self.shape.channels() + channel) * self.plane()
    }

    /// Where padded rows of a channel of a frame are.
    pub fn seen_rows(&self, frame: usize, channel: usize, rows: Range<usize>) -> Range<usize> {
        let plane = self.seen_plane(frame, channel);
        plane + rows.start * self.stride..plane + rows.end * self.stride
    }

    /// Where rows of a channel of a frame are among pictures.
    pub fn picture_rows(&self, frame: usize, channel: usize, rows: Range<usize>) -> Range<usize> {
        let slot = frame % self.pictures * self.shape.channels() + channel;
        self.of_picture(slot, rows)
    }

    /// The same for a render.
    pub fn render_rows(
        &self,
        frame: usize,
        render: usize,
        channel: usize,
        rows: Range<usize>,
    ) -> Range<usize> {
        let slot = frame % self.seen * self.renders + render;
        self.of_picture(slot * self.shape.channels() + channel, rows)
    }

    /// The same for the curvature.
    pub fn visited_rows(&self, frame: usize, channel: usize, rows: Range<usize>) -> Range<usize> {
        let slot = frame % self.visited * self.shape.channels() + channel;
        self.of_picture(slot, rows)
    }

    /// Where rows of a frame's choices are.
    pub fn choice_rows(&self, frame: usize, rows: Range<usize>) -> Range<usize> {
        self.of_picture(frame % self.pictures, rows)
    }

    fn of_picture(&self, slot: usize, rows: Range<usize>) -> Range<usize> {
        let (start, width) = (slot * self.shape.pixels(), self.shape.width());
        start + rows.start * width..start + rows.end * width
    }
}

/// The sections.
#[derive(Debug)]
pub(super) struct Window {
    /// Padded planes, frame by frame and channel by channel: w²·r in L2, r in L1.
    pub residual: Parts<f32>,
    /// w² in L2, w in L1.
    pub weights: Parts<f32>,
    /// Pictures, frame by frame and channel by channel: Σ w²·g².
    pub curvature: Parts<f32>,
    pub guide: Parts<f32>,
    /// Frame by frame, render by render.
    pub renders: Parts<f32>,
    pub current: Parts<f32>,
    pub choice: Parts<u8>,
    /// Strip by strip.
    pub sums: Parts<f64>,
}
