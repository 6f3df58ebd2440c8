//! The frames of an animation that are in memory: rings, in which a new frame takes the place of the
//! oldest.
//!
//! Three rings hold pictures, pixel by pixel: the reference and what is chosen, until all that see
//! them are scored, and the renders, until they have been visited. Two hold what sweeps see, with
//! margins around each picture that nobody looks into: the residual and the weights. One holds the
//! curvature of the frames that are being visited. A rank holds its own rows, and of pictures those
//! around them that its filters read.

use std::ops::Range;

use half::f16;
use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};
use perceptile_cluster::Worker;
use perceptile_cluster::faults::Faults;
use perceptile_cluster::shared::{Arena, Board, BoardPlan, Map, Parts};

use super::footprint::Footprint;
use super::options::Norm;
use super::plan::SelectPlan;
use super::schedule::Schedule;
use super::score::methods;
use super::strips::Strips;
use super::visit::CELL;
use super::{AnimationShape, SelectError};

/// How large everything is.
#[derive(Debug, Clone)]
pub(super) struct WindowPlan {
    pub shape: AnimationShape,
    pub renders: usize,
    half: bool,
    /// Frames of the rings of the reference and of what is chosen.
    pub pictures: usize,
    /// Frames of the rings of renders, residual and weights.
    pub seen: usize,
    /// Frames of the ring of curvatures; 0 where none is needed.
    visited: usize,
    /// Numbers of a padded row.
    pub stride: usize,
    /// Columns and rows before the first pixel.
    pub corner: [usize; 2],
    /// Rows that the kernel reaches beyond its first.
    pub reach: usize,
    pub strips: Strips,
    /// The strips of this rank.
    pub own: Range<usize>,
    /// The rows of its pictures.
    pub held: Range<usize>,
    /// Sums of squares of a strip.
    pub sums: usize,
    sweeps: usize,
    board: BoardPlan,
}

impl WindowPlan {
    /// For a rank, of sweeps that see a footprint.
    pub fn new(plan: &SelectPlan, footprint: &Footprint, schedule: Schedule, rank: usize) -> Self {
        let SelectPlan { shape, candidates, options, parallelism, .. } = plan;
        let [left, top, _, bottom] = footprint.margins();
        let (ahead, spread) = (footprint.frames() - 1, schedule.spread());
        let frames = |count: usize| count.min(shape.frames());
        let strips = Strips::new(shape.height(), footprint.height);
        let share = |rank: usize| strips.len() * rank / parallelism.ranks;
        let own = share(rank)..share(rank + 1).max(share(rank) + 1).min(strips.len());
        let rows = strips.all_rows(&own);
        // The error at a row is made of rows as far from it as the kernel reaches.
        let held = rows.start.saturating_sub(bottom)..(rows.end + top).min(shape.height());
        let stride = (left + shape.width()).max(shape.width() + footprint.overhang());
        let mut made = Self {
            shape: *shape,
            renders: candidates.renders,
            half: candidates.half,
            pictures: frames(spread + 1 + 2 * ahead),
            seen: frames(spread + 1 + ahead),
            visited: if options.norm == Norm::L2 { frames(spread + 1) } else { 0 },
            stride,
            corner: [left, top],
            reach: footprint.height - 1,
            held,
            sums: 2 * methods(candidates.renders),
            sweeps: options.sweeps as usize,
            board: BoardPlan {
                workers: parallelism.workers.max(1),
                threads: parallelism.threads,
                jobs: own.len(),
                journal: 0,
            },
            strips,
            own,
        };
        if parallelism.workers > 0 {
            made.board.journal = made.journal(footprint);
        }
        made
    }

    /// Bytes of the largest cell that a visit changes, as they are saved.
    fn journal(&self, footprint: &Footprint) -> usize {
        let (channels, rows) = (self.shape.channels(), self.strips.most_rows());
        let cell = CELL.min(self.shape.width());
        let seen = footprint.frames() * channels * (rows + self.reach);
        let floats = seen * (cell + footprint.overhang()) + channels * rows * cell;
        let ranges = seen + channels * rows + rows + 1;
        BoardPlan::saved(ranges, 4 * floats + rows * cell + size_of::<u64>())
    }

    /// The rows of this rank.
    pub fn own_rows(&self) -> Range<usize> {
        self.strips.all_rows(&self.own)
    }

    /// Padded rows of this rank.
    fn padded_rows(&self) -> usize {
        self.own_rows().len() + self.reach
    }

    /// Numbers of a padded plane.
    fn plane(&self) -> usize {
        self.stride.saturating_mul(self.padded_rows())
    }

    /// Numbers of a plane of a picture.
    fn held_pixels(&self) -> usize {
        self.held.len() * self.shape.width()
    }

    fn sections(&self) -> [usize; 9] {
        let (pixels, channels) = (self.held_pixels(), self.shape.channels());
        let product =
            |factors: &[usize]| factors.iter().fold(1, |a: usize, &b| a.saturating_mul(b));
        let seen = product(&[4, self.seen, channels, self.plane()]);
        let render = if self.half { 2 } else { 4 };
        [
            seen,
            seen,
            product(&[4, self.visited, channels, pixels]),
            product(&[4, self.pictures, channels, pixels]),
            product(&[render, self.seen, self.renders, channels, pixels]),
            product(&[4, self.pictures, channels, pixels]),
            product(&[self.pictures, pixels]),
            product(&[8, self.pictures, self.own.len(), self.sums]),
            product(&[8, self.sweeps, self.own.len()]),
        ]
    }

    /// Bytes of it all; saturating.
    pub fn bytes(&self) -> usize {
        self.sections().into_iter().map(Arena::room).fold(self.board.room(), usize::saturating_add)
    }

    /// Memory of this process alone, and the worker whose threads work on it.
    pub fn private(&self) -> Result<(Worker, Window), SelectError> {
        Ok(self.open(&mut Arena::new(Map::private(self.bytes())?), 0, None))
    }

    /// The next place of memory that several processes see, and the worker of this index.
    pub fn open(
        &self,
        arena: &mut Arena,
        index: usize,
        faults: Option<Faults>,
    ) -> (Worker, Window) {
        let board = Board::new(arena, self.board);
        let [residual, weights, curvature, guide, renders, current, choice, sums, changes] =
            self.sections().map(|bytes| arena.take(bytes));
        let renders = match self.half {
            true => Renders::Half(renders.parts(Vec::new())),
            false => Renders::Single(renders.parts(Vec::new())),
        };
        let window = Window {
            residual: residual.parts(Vec::new()),
            weights: weights.parts(Vec::new()),
            curvature: curvature.parts(Vec::new()),
            guide: guide.parts(Vec::new()),
            renders,
            current: current.parts(Vec::new()),
            choice: choice.parts(Vec::new()),
            sums: sums.parts(Vec::new()),
            changes: changes.parts(Vec::new()),
        };
        (Worker::new(board, index, faults), window)
    }

    /// Where padded rows of a channel of a frame are.
    pub fn seen_rows(&self, frame: usize, channel: usize, rows: Range<usize>) -> Range<usize> {
        let plane = (frame % self.seen * self.shape.channels() + channel) * self.plane();
        let first = self.own_rows().start;
        plane + (rows.start - first) * self.stride..plane + (rows.end - first) * self.stride
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

    /// Where the sums of a strip of a frame are.
    pub fn strip_sums(&self, frame: usize, strip: usize) -> Range<usize> {
        let at = frame % self.pictures * self.own.len() + (strip - self.own.start);
        at * self.sums..(at + 1) * self.sums
    }

    /// Where a strip counts the pixels that a sweep changed.
    pub fn strip_changes(&self, sweep: usize, strip: usize) -> Range<usize> {
        let at = sweep * self.own.len() + (strip - self.own.start);
        at..at + 1
    }

    fn of_picture(&self, slot: usize, rows: Range<usize>) -> Range<usize> {
        let (start, width) = (slot * self.held_pixels(), self.shape.width());
        let first = self.held.start;
        start + (rows.start - first) * width..start + (rows.end - first) * width
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
    pub renders: Renders,
    pub current: Parts<f32>,
    pub choice: Parts<u8>,
    /// Sums of squares, frame by frame and strip by strip.
    pub sums: Parts<f64>,
    /// Pixels that changed, sweep by sweep and strip by strip.
    pub changes: Parts<u64>,
}

/// Values of renders.
#[derive(Debug)]
pub(super) enum Renders {
    Single(Parts<f32>),
    /// The bits of half floats.
    Half(Parts<u16>),
}

impl Renders {
    /// Some of them.
    pub fn read(&self, place: Range<usize>, out: &mut [f32]) {
        match self {
            Self::Single(values) => out.copy_from_slice(&values.whole()[place]),
            Self::Half(bits) => {
                bits.whole()[place].reinterpret_cast::<f16>().convert_to_f32_slice(out);
            }
        }
    }

    /// Takes new ones in.
    pub fn write(&mut self, place: Range<usize>, values: &[f32]) {
        match self {
            Self::Single(all) => all.whole_mut()[place].copy_from_slice(values),
            Self::Half(bits) => {
                let bits = &mut bits.whole_mut()[place];
                bits.reinterpret_cast_mut::<f16>().convert_from_f32_slice(values);
            }
        }
    }
}
