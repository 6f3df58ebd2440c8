//! The accesses of a descent's draws, in several arrangements of the tile and orders of the draws.
//!
//! [`Streams`] lays the arrays of a run out in an address space of its own, from 0 on, and lists
//! every access of a step to a [`Listener`]; [`compare`] listens with the models of
//! [`super::cache`]. One core is modelled, which does all blocks one after the other; with more,
//! each has first and second caches of its own, and what they share is the third.

use serde::Serialize;

use super::cache::{CacheError, CacheLevel, Counts, Footprint, Hierarchy, Reuse, ReuseHistogram};
use super::subject::{Subject, WORD};
use crate::draw::{Draw, Stream, Use};
use crate::gradient::Run;
use crate::tile::{Block, Layout, Overlap, Placement, Region, SLACK};

/// How samples and gradient lie in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Arrangement {
    /// The whole tile frame by frame, `(t, y, x)`, without copies around the torus, and one
    /// gradient of the same form: as the tile's file has it.
    Linear,
    /// As the run has it: [`crate::tile::Rows`], and a patch for each block.
    Rows,
    /// What a cell sees is copied to boxes as large as a cache line ([`Layout::Bricks`]).
    Bricks,
    /// What a cell sees is copied to a Z-order curve ([`Layout::Curve`]).
    Curve,
}

impl Arrangement {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Linear, Self::Rows, Self::Bricks, Self::Curve];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Rows => "rows",
            Self::Bricks => "bricks",
            Self::Curve => "curve",
        }
    }

    /// The layout in which a run computes like that; there is none for [`Self::Linear`].
    pub fn layout(self) -> Option<Layout> {
        match self {
            Self::Linear => None,
            Self::Rows => Some(Layout::Rows),
            Self::Bricks => Some(Layout::Bricks),
            Self::Curve => Some(Layout::Curve),
        }
    }
}

/// In which order a step's draws are done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DrawOrder {
    /// Cell by cell and in the cell by place, as the run does them.
    Sorted,
    /// All over the tile. Where cells have copies, each has one of its own.
    Unsorted,
}

impl DrawOrder {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Sorted, Self::Unsorted];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sorted => "sorted",
            Self::Unsorted => "unsorted",
        }
    }
}

/// What an access is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Purpose {
    /// Reading the samples of a draw.
    Gather,
    /// Adding the gradients of a draw.
    Scatter,
    /// Copying what a cell sees, there and back.
    Copy,
    /// Clearing and adding up patches, moving the samples: what a step does for all coordinates.
    Update,
}

/// One access.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Access {
    /// First byte.
    pub address: u64,
    /// Bytes that are wanted.
    pub bytes: u32,
    /// Bytes that are touched, as whole registers are moved; at least as many.
    pub touched: u32,
    /// Whether it writes.
    pub write: bool,
    /// What it is for.
    pub purpose: Purpose,
}

/// Hears what a step accesses.
pub trait Listener {
    /// One access.
    fn access(&mut self, access: Access);

    /// All accesses of a draw were listed.
    fn drawn(&mut self) {}
}

/// Some of a step's draws, with the cells that they belong to.
#[derive(Debug, Clone)]
pub struct StepDraws {
    /// Cells in the order in which blocks and their cells are done.
    pub cells: Vec<(usize, Vec<Draw>)>,
}

impl StepDraws {
    /// The draws of the first cells of a step, until these cells together see `seen` bytes of
    /// samples, or their draws together move `moved` bytes.
    pub fn new(subject: &Subject, step: u32, seen: u64, moved: u64) -> Self {
        let pixel = subject.rows().pixel() as u64 * WORD;
        let (frames, sample) = (subject.shape().frames() as u64, sample_bytes(subject));
        let (mut seeing, mut moving) = (0_u64, 0_u64);
        let mut cells = Vec::new();
        for &cell in subject.blocks().iter().flat_map(|block| block.cells()) {
            if seeing >= seen || moving >= moved {
                break;
            }
            let [width, height] = subject.window(cell);
            seeing += (width * height) as u64 * frames * pixel;
            let mut draws = subject.cell_draws(step, cell).draws;
            // Samples are read, their gradient is read and written.
            let within = draws.iter().take_while(|draw| {
                let goes_on = moving < moved;
                moving += 3 * draw.subset() as u64 * sample;
                goes_on
            });
            draws.truncate(within.count());
            cells.push((cell, draws));
        }
        Self { cells }
    }

    /// Number of draws.
    pub fn len(&self) -> usize {
        self.cells.iter().map(|(_, draws)| draws.len()).sum()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Bytes of a sample.
fn sample_bytes(subject: &Subject) -> u64 {
    subject.shape().dims() as u64 * WORD
}

/// Arrays begin at multiples of this.
const ALIGNMENT: u64 = 4096;

/// The accesses of a run's steps.
#[derive(Debug)]
pub struct Streams<'a> {
    subject: &'a Subject,
    arrangement: Arrangement,
    order: DrawOrder,
    overlap: Overlap,
    /// First byte of each array.
    samples: u64,
    first: u64,
    second: u64,
    /// The gradient of the whole tile in [`Arrangement::Linear`].
    gradient: u64,
    /// First byte of each block's patch.
    patches: Vec<u64>,
    /// The block of each cell.
    blocks: Vec<usize>,
    /// For each cell, how its copy lies, and the first byte of its samples and of its gradient.
    copies: Vec<(Placement, u64, u64)>,
    end: u64,
}

impl<'a> Streams<'a> {
    /// Lays out the arrays.
    pub fn new(subject: &'a Subject, arrangement: Arrangement, order: DrawOrder) -> Self {
        let mut end = 0;
        let mut array = |words: usize| {
            let start = end;
            end = (start + words as u64 * WORD).next_multiple_of(ALIGNMENT);
            start
        };
        let coordinates = subject.shape().coordinates();
        let linear = arrangement == Arrangement::Linear;
        let samples = array(if linear { coordinates } else { subject.rows().words() } + SLACK);
        let (first, second) = (array(coordinates), array(coordinates));
        let gradient = array(if linear { coordinates } else { 0 });
        let patches = if linear {
            Vec::new()
        } else {
            // Patches lie one behind the other, as the run has them.
            let words = subject.blocks().iter().map(|block| block.words() + SLACK);
            let mut next = array(words.clone().sum());
            words
                .map(|words| {
                    next += words as u64 * WORD;
                    next - words as u64 * WORD
                })
                .collect()
        };
        let mut copies = Vec::new();
        if let Some(layout @ (Layout::Bricks | Layout::Curve)) = arrangement.layout() {
            let frames = subject.shape().frames();
            let pixel = subject.rows().pixel();
            let placements = (0..subject.partition().cells()).map(|cell| {
                let [width, height] = subject.window(cell);
                Placement::new(layout, [width, height, frames], pixel)
            });
            let placements: Vec<Placement> = placements.collect();
            // In order, all cells use the same memory for their copies.
            let most = placements.iter().map(|placement| placement.words).max().unwrap_or(0);
            let shared = (order == DrawOrder::Sorted).then(|| (array(most), array(most)));
            for placement in placements {
                let words = placement.words;
                let (x, g) = shared.unwrap_or_else(|| (array(words), array(words)));
                copies.push((placement, x, g));
            }
        }
        let mut blocks = vec![0; subject.partition().cells()];
        for (index, block) in subject.blocks().iter().enumerate() {
            block.cells().iter().for_each(|&cell| blocks[cell] = index);
        }
        let overlap = Overlap::new(
            Region::whole(subject.shape()),
            subject.blocks().iter().map(Block::window),
        );
        Self {
            subject,
            arrangement,
            order,
            overlap,
            samples,
            first,
            second,
            gradient,
            patches,
            blocks,
            copies,
            end,
        }
    }

    /// Bytes of the address space.
    pub fn bytes(&self) -> u64 {
        self.end
    }

    /// Tells the accesses of draws, with the clearing of patches and the copies that they need.
    pub fn draws(&self, draws: &StepDraws, listener: &mut impl Listener) {
        let mut runs = Vec::new();
        match self.order {
            DrawOrder::Sorted => {
                let mut block = None;
                for (cell, draws) in &draws.cells {
                    if block != Some(self.blocks[*cell]) {
                        block = Some(self.blocks[*cell]);
                        self.clear(self.blocks[*cell], listener);
                    }
                    self.copy_in(*cell, listener);
                    draws.iter().for_each(|draw| self.draw(*cell, draw, &mut runs, listener));
                    self.copy_out(*cell, listener);
                }
            }
            DrawOrder::Unsorted => {
                let mut blocks: Vec<usize> =
                    draws.cells.iter().map(|(cell, _)| self.blocks[*cell]).collect();
                blocks.dedup();
                blocks.into_iter().for_each(|block| self.clear(block, listener));
                draws.cells.iter().for_each(|(cell, _)| self.copy_in(*cell, listener));
                let all = draws.cells.iter();
                let mut all: Vec<(usize, &Draw)> =
                    all.flat_map(|(cell, draws)| draws.iter().map(|draw| (*cell, draw))).collect();
                // The shuffle of Fisher and Yates; any use will do, as nothing is drawn with it.
                let mut random = Stream::new(1, Use::Baseline, 0, 0);
                for i in (1..all.len()).rev() {
                    all.swap(i, random.below(i as u32 + 1) as usize);
                }
                all.into_iter().for_each(|(cell, draw)| self.draw(cell, draw, &mut runs, listener));
                draws.cells.iter().for_each(|(cell, _)| self.copy_out(*cell, listener));
            }
        }
    }

    /// Tells the accesses of the rest of a step, which goes through all coordinates: its last
    /// ones, of which there are about `bytes` bytes in all arrays together. What is left out is
    /// like what is listed.
    pub fn update(&self, bytes: u64, listener: &mut impl Listener) {
        let (shape, rows) = (self.subject.shape(), self.subject.rows());
        let (frames, pixel) = (shape.frames(), rows.pixel());
        let row = (shape.width() * pixel) as u64 * WORD;
        // Samples, two moments, and the gradient.
        let lines = (bytes / (4 * row * frames as u64)).max(1) as usize;
        let from = shape.height().saturating_sub(lines);
        let mut emit = |address, bytes: u64, write| {
            let bytes = bytes as u32;
            listener.access(Access {
                address,
                bytes,
                touched: bytes,
                write,
                purpose: Purpose::Update,
            });
        };
        for (y, t) in (from..shape.height()).flat_map(|y| (0..frames).map(move |t| (y, t))) {
            let own = (y * frames + t) as u64 * row;
            let place = if self.arrangement == Arrangement::Linear {
                let offset = (shape.pixel(0, y, t) * pixel) as u64 * WORD;
                emit(self.gradient + offset, row, false);
                emit(self.gradient + offset, row, true);
                offset
            } else {
                for &(block, start) in self.overlap.line(y) {
                    let start = start + t * self.overlap.stride(block);
                    for segment in self.overlap.segments(block) {
                        let word = (start + segment.from) as u64;
                        let bytes = segment.len as u64 * WORD;
                        emit(self.patches[block] + word * WORD, bytes, false);
                    }
                }
                rows.word(0, y, t) as u64 * WORD
            };
            for address in [self.first + own, self.second + own, self.samples + place] {
                emit(address, row, false);
                emit(address, row, true);
            }
        }
    }

    /// The patch of a block becomes zero.
    fn clear(&self, block: usize, listener: &mut impl Listener) {
        if self.arrangement == Arrangement::Linear {
            return;
        }
        let block_words = &self.subject.blocks()[block];
        let bytes = (block_words.stride() as u64 * WORD) as u32;
        for row in 0..(block_words.words() / block_words.stride()) as u64 {
            let address = self.patches[block] + row * u64::from(bytes);
            let (touched, write, purpose) = (bytes, true, Purpose::Update);
            listener.access(Access { address, bytes, touched, write, purpose });
        }
    }

    /// First words of the pixel where a cell's window begins: in the samples' rows and in the
    /// patch of its block.
    fn corner(&self, cell: usize) -> [usize; 2] {
        let (place, rows) = (self.subject.partition().cell(cell), self.subject.rows());
        let block = &self.subject.blocks()[self.blocks[cell]];
        let corner = block.place();
        [
            place.y * rows.line() + place.x * rows.pixel(),
            (place.y - corner.y) * block.line() + (place.x - corner.x) * rows.pixel(),
        ]
    }

    /// Addresses of what a cell sees, pixel by pixel: in the rows, in the patch, and the words
    /// from the start of the copies.
    fn copied(&self, cell: usize) -> impl Iterator<Item = [u64; 3]> + '_ {
        let (rows, frames) = (self.subject.rows(), self.subject.shape().frames());
        let placement = self.copies.get(cell).map(|(placement, ..)| placement);
        let [width, height] = self.subject.window(cell);
        let [samples, patch] = self.corner(cell);
        let stride = self.subject.blocks()[self.blocks[cell]].stride();
        let base = self.patches.get(self.blocks[cell]).copied().unwrap_or(0);
        placement.into_iter().flat_map(move |placement| {
            let lines = (0..height).flat_map(move |y| (0..frames).map(move |t| (y, t)));
            lines.flat_map(move |(y, t)| {
                let row = y * frames + t;
                let first = samples + row * rows.stride();
                let sum = patch + row * stride;
                (0..width).map(move |x| {
                    let column = x * rows.pixel();
                    [
                        self.samples + (first + column) as u64 * WORD,
                        base + (sum + column) as u64 * WORD,
                        placement.word(x, y, t) as u64 * WORD,
                    ]
                })
            })
        })
    }

    /// Samples come to the copy of a cell, and its gradient becomes zero.
    fn copy_in(&self, cell: usize, listener: &mut impl Listener) {
        let Some(&(ref placement, samples, gradient)) = self.copies.get(cell) else { return };
        let pixel = self.subject.rows().pixel() as u64 * WORD;
        let (purpose, line) = (Purpose::Copy, 64);
        let whole = placement.words as u64 * WORD;
        for address in (gradient..gradient + whole).step_by(line as usize) {
            let bytes = line.min((gradient + whole - address) as u32);
            listener.access(Access { address, bytes, touched: bytes, write: true, purpose });
        }
        let touched = pixel as u32;
        for [from, _, to] in self.copied(cell) {
            let bytes = touched;
            listener.access(Access { address: from, bytes, touched, write: false, purpose });
            listener.access(Access { address: samples + to, bytes, touched, write: true, purpose });
        }
    }

    /// The gradient of a copy is added to the patch.
    fn copy_out(&self, cell: usize, listener: &mut impl Listener) {
        let Some(&(_, _, gradient)) = self.copies.get(cell) else { return };
        let bytes = (self.subject.rows().pixel() as u64 * WORD) as u32;
        let (touched, purpose) = (bytes, Purpose::Copy);
        for [_, patch, from] in self.copied(cell) {
            let mut emit = |address, write| {
                listener.access(Access { address, bytes, touched, write, purpose });
            };
            emit(gradient + from, false);
            emit(patch, false);
            emit(patch, true);
        }
    }

    /// A draw reads its samples, then adds to their gradient.
    fn draw(&self, cell: usize, draw: &Draw, scratch: &mut Vec<Run>, to: &mut impl Listener) {
        let runs = self.subject.runs().of(draw.set as usize, draw.taps as usize, scratch);
        let mut emit = |address, bytes, touched, purpose| {
            to.access(Access { address, bytes, touched, write: false, purpose });
            if purpose == Purpose::Scatter {
                to.access(Access { address, bytes, touched, write: true, purpose });
            }
        };
        for purpose in [Purpose::Gather, Purpose::Scatter] {
            for &run in runs {
                self.run(cell, draw, run, purpose, &mut emit);
            }
        }
        to.drawn();
    }

    /// Calls `emit(address, bytes, touched, purpose)` for the memory of a run.
    fn run(
        &self,
        cell: usize,
        draw: &Draw,
        run: Run,
        purpose: Purpose,
        emit: &mut impl FnMut(u64, u32, u32, Purpose),
    ) {
        /// Bytes that are moved at a time, see `gradient::memory`.
        const REGISTERS: u32 = 64;
        let (shape, rows) = (self.subject.shape(), self.subject.rows());
        let (frames, pixel) = (shape.frames(), rows.pixel());
        let around = |at: i64, size: usize| at.rem_euclid(size as i64) as usize;
        let t = around(i64::from(draw.t) + i64::from(run.dt), frames);
        let reach = rows.reach();
        // In the window of the cell, which begins with the halo.
        let x = (reach.left + draw.x as usize).wrapping_add_signed(run.dx as isize);
        let y = (reach.up + draw.y as usize).wrapping_add_signed(run.dy as isize);
        let len = run.len as usize;
        // Of a pixel, only the samples that the draw sees.
        let seen = draw.samples as usize * shape.dims();
        let bytes = |words: usize| words as u32 * WORD as u32;
        let mut pieces = |first: u64, pixels: usize, registers: u32| {
            let (count, words) = if seen == pixel { (1, pixels * pixel) } else { (pixels, seen) };
            for piece in 0..count {
                let address = first + (piece * pixel) as u64 * WORD;
                let touched = bytes(words).next_multiple_of(registers);
                emit(address, bytes(words), touched, purpose);
            }
        };
        match self.arrangement {
            Arrangement::Linear => {
                let place = self.subject.partition().cell(cell);
                let y = around((place.y + y) as i64 - reach.up as i64, shape.height());
                let mut x = around((place.x + x) as i64 - reach.left as i64, shape.width());
                let base = if purpose == Purpose::Gather { self.samples } else { self.gradient };
                let mut left = len;
                while left > 0 {
                    let here = left.min(shape.width() - x);
                    let word = (shape.pixel(x, y, t) * pixel) as u64;
                    pieces(base + word * WORD, here, WORD as u32);
                    (x, left) = (0, left - here);
                }
            }
            Arrangement::Rows => {
                let [samples, patch] = self.corner(cell);
                let block = self.blocks[cell];
                let (base, corner, stride) = if purpose == Purpose::Gather {
                    (self.samples, samples, rows.stride())
                } else {
                    (self.patches[block], patch, self.subject.blocks()[block].stride())
                };
                let word = corner + (y * frames + t) * stride + x * pixel;
                pieces(base + word as u64 * WORD, len, REGISTERS);
            }
            Arrangement::Bricks | Arrangement::Curve => {
                let &(ref placement, samples, gradient) = &self.copies[cell];
                let base = if purpose == Purpose::Gather { samples } else { gradient };
                for x in x..x + len {
                    let word = placement.word(x, y, t) as u64;
                    pieces(base + word * WORD, 1, WORD as u32);
                }
            }
        }
    }
}

/// Misses of the three levels, in lines.
pub type Misses = [f64; 3];

/// What an arrangement and an order cost.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Behaviour {
    /// How samples and gradient lie.
    pub arrangement: Arrangement,
    /// In which order draws are done.
    pub order: DrawOrder,
    /// Draws that all this is a mean of.
    pub draws: u64,
    /// Distinct lines of a draw's samples; its gradient lies on as many.
    pub lines: f64,
    /// Distinct pages of a draw's samples.
    pub pages: f64,
    /// Lines, over the fewest that the samples could fill.
    pub ratio: f64,
    /// Misses of a draw's reading.
    pub gather: Misses,
    /// Misses of a draw's adding.
    pub scatter: Misses,
    /// Misses of copying, for each draw.
    pub copy: Misses,
    /// How far apart the draws' uses of a line are, in lines of the draws of the counted steps.
    pub reuse: ReuseHistogram,
    /// Nanoseconds of a step for each draw and thread, where a run can be measured like that.
    pub measured: Option<f64>,
}

impl Behaviour {
    /// All misses for each draw, those of copying included.
    pub fn misses(&self) -> Misses {
        std::array::from_fn(|level| self.gather[level] + self.scatter[level] + self.copy[level])
    }
}

/// Hears a step with all models.
struct Models {
    caches: Hierarchy,
    samples: Footprint,
    reuse: Reuse,
    /// Whether this step counts.
    counting: bool,
    purpose: Purpose,
    before: Misses,
    sums: [Misses; 4],
    wanted: u64,
    draws: u64,
    lines: u64,
    pages: u64,
    fewest: u64,
    line: u64,
}

impl Models {
    fn new(levels: &[CacheLevel; 3]) -> Result<Self, CacheError> {
        let line = levels[0].line;
        Ok(Self {
            caches: Hierarchy::new(levels)?,
            samples: Footprint::new(line)?,
            reuse: Reuse::new(line)?,
            counting: false,
            purpose: Purpose::Update,
            before: [0.0; 3],
            sums: Default::default(),
            wanted: 0,
            draws: 0,
            lines: 0,
            pages: 0,
            fewest: 0,
            line: line.into(),
        })
    }

    /// What was missed since the last call was missed for the purpose until now.
    fn settle(&mut self, next: Purpose) {
        let mut now = [0.0; 3];
        for (now, (_, counts)) in now.iter_mut().zip(self.caches.counts()) {
            *now = Counts::misses(&counts) as f64;
        }
        if self.counting {
            for (sum, (now, before)) in
                self.sums[self.purpose as usize].iter_mut().zip(now.into_iter().zip(self.before))
            {
                *sum += now - before;
            }
        }
        (self.before, self.purpose) = (now, next);
    }
}

impl Listener for Models {
    fn access(&mut self, access: Access) {
        if access.purpose != self.purpose {
            self.settle(access.purpose);
        }
        self.caches.access(access.address, access.touched, access.write);
        if self.counting && matches!(access.purpose, Purpose::Gather | Purpose::Scatter) {
            self.reuse.access(access.address, access.touched);
        }
        if self.counting && access.purpose == Purpose::Gather {
            self.samples.access(access.address, access.bytes);
            self.wanted += u64::from(access.bytes);
        }
    }

    fn drawn(&mut self) {
        if self.counting {
            let touched = self.samples.take();
            self.lines += touched.lines;
            self.pages += touched.pages;
            self.fewest += std::mem::take(&mut self.wanted).div_ceil(self.line);
            self.draws += 1;
        }
    }
}

/// Draws after which a comparison is precise enough: a per cent or so.
const ENOUGH: u64 = 12_000;
/// Most steps that are listened to.
const MOST_STEPS: u32 = 16;
/// Most bytes that all draws of a comparison move.
const MOST_MOVED: u64 = 192 << 20;
/// Most bytes of copies in a comparison.
const MOST_COPIED: u64 = 1 << 30;
/// Most bytes of a last cache that is filled over and over again.
const LARGEST: u64 = 128 << 20;

/// Models all arrangements and orders on caches of these levels.
///
/// The first step fills the caches and is not counted. Of a tile that is larger than the last
/// cache many times over, only a part is listened to that is still larger than the cache.
///
/// # Errors
/// If there can be no such caches.
pub fn compare(subject: &Subject, levels: &[CacheLevel; 3]) -> Result<Vec<Behaviour>, CacheError> {
    let seen = 2 * levels[2].bytes.min(LARGEST);
    let mut steps = vec![StepDraws::new(subject, 0, seen, MOST_MOVED / 2)];
    let (mut drawn, mut moved, mut copied) = (0, 0, 0);
    for step in 1..=MOST_STEPS {
        if drawn >= ENOUGH || moved >= MOST_MOVED || copied >= MOST_COPIED {
            break;
        }
        let draws = StepDraws::new(subject, step, seen, MOST_MOVED - moved);
        drawn += draws.len() as u64;
        let samples = draws.cells.iter().flat_map(|(_, draws)| draws).map(|draw| draw.subset());
        moved += 3 * samples.sum::<usize>() as u64 * sample_bytes(subject);
        // Samples there, their gradient cleared and back.
        copied += 6 * subject.sizes().window * draws.cells.len() as u64;
        steps.push(draws);
    }
    let pairs = Arrangement::ALL.into_iter().flat_map(|a| DrawOrder::ALL.map(|order| (a, order)));
    pairs
        .map(|(arrangement, order)| behaviour(subject, levels, arrangement, order, &steps))
        .collect()
}

fn behaviour(
    subject: &Subject,
    levels: &[CacheLevel; 3],
    arrangement: Arrangement,
    order: DrawOrder,
    steps: &[StepDraws],
) -> Result<Behaviour, CacheError> {
    let enough = 4 * levels[2].bytes.min(LARGEST);
    let streams = Streams::new(subject, arrangement, order);
    let mut models = Models::new(levels)?;
    for (step, draws) in steps.iter().enumerate() {
        models.counting = step > 0;
        streams.draws(draws, &mut models);
        models.settle(Purpose::Update);
        models.counting = false;
        streams.update(enough, &mut models);
        models.settle(Purpose::Update);
    }
    let draws = models.draws.max(1) as f64;
    let mean = |purpose: Purpose| models.sums[purpose as usize].map(|sum| sum / draws);
    Ok(Behaviour {
        arrangement,
        order,
        draws: models.draws,
        lines: models.lines as f64 / draws,
        pages: models.pages as f64 / draws,
        ratio: models.lines as f64 / models.fewest.max(1) as f64,
        gather: mean(Purpose::Gather),
        scatter: mean(Purpose::Scatter),
        copy: mean(Purpose::Copy),
        reuse: models.reuse.histogram().clone(),
        measured: None,
    })
}
