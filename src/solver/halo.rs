//! What the ranks of a cluster send each other in each step: samples to where draws see them, and
//! gradients to where the samples are. Nothing else does.
//!
//! Both are the same pieces of the tile, in opposite directions; all pieces between two ranks are
//! one message. What is under way while draws go on, and when it must be there, is the step's
//! business.

use std::sync::Mutex;

use perceptile_cluster::Worker;
use perceptile_cluster::communicator::{Communicator, Message, Transfer};
use rayon::prelude::*;

use crate::gradient::simd::{Isa, Simd, Vectorized};
use crate::tile::{Block, Overlap, Piece, Reach, Regions, Rows, Window};

/// The samples around a rank's region, which others own.
pub(crate) struct SampleHalo {
    transfer: Mutex<Box<dyn Transfer>>,
    seen: Vec<Piece>,
    lent: Vec<Piece>,
    words: Words,
    /// Bytes that come from other ranks.
    bytes: u64,
}

/// The gradients of draws on one side of an edge for samples on the other.
pub(crate) struct GradientHalo {
    transfer: Mutex<Box<dyn Transfer>>,
    seen: Vec<Piece>,
    lent: Vec<Piece>,
    /// How this rank's patches add up on each piece that it sees.
    overlaps: Vec<Overlap>,
    words: Words,
    /// Bytes that come from other ranks.
    bytes: u64,
}

/// Sizes of rows, in words.
#[derive(Debug, Clone, Copy)]
struct Words {
    pixel: usize,
    frames: usize,
}

/// Bytes that a rank sends in a step of the descent, and messages that they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct HaloTraffic {
    /// Bytes of samples and of gradients.
    pub bytes: u64,
    /// Messages to other ranks.
    pub messages: u64,
}

impl HaloTraffic {
    /// What one rank sends in a step whose draws reach so far. Pieces that a rank has of its own
    /// halo, around the torus, do not gather.
    pub fn of(regions: &Regions, reach: Reach) -> Self {
        let words = Words::of(regions);
        let mut all = words.messages(&regions.halo(reach), |piece| piece.owner);
        all.extend(words.messages(&regions.lent(reach), |piece| piece.seer));
        let away = all.iter().filter(|message| message.rank != regions.rank());
        Self { bytes: Words::bytes(&all, regions.rank()), messages: away.count() as u64 }
    }
}

impl Words {
    fn of(regions: &Regions) -> Self {
        let tile = regions.own().tile();
        Self { pixel: tile.spp() * tile.dims(), frames: tile.frames() }
    }

    /// Words of a row of a piece.
    fn row(self, piece: &Piece) -> usize {
        piece.seen.width * self.pixel
    }

    /// Words of a piece.
    fn piece(self, piece: &Piece) -> usize {
        piece.pixels(self.frames) * self.pixel
    }

    /// The messages that pieces gather in, which are sorted by the rank at the other end.
    fn messages(self, pieces: &[Piece], other: fn(&Piece) -> usize) -> Vec<Message> {
        pieces
            .chunk_by(|a, b| other(a) == other(b))
            .map(|chunk| Message {
                rank: other(&chunk[0]),
                words: chunk.iter().map(|piece| self.piece(piece)).sum(),
            })
            .collect()
    }

    /// Bytes of messages to or from other ranks than this one.
    fn bytes(messages: &[Message], rank: usize) -> u64 {
        let others = messages.iter().filter(|message| message.rank != rank);
        others.map(|message| 4 * message.words as u64).sum()
    }

    /// Cuts messages into the words of each piece.
    fn cut<'a>(self, messages: Vec<&'a [u32]>, pieces: &[Piece]) -> Vec<&'a [u32]> {
        let mut messages = messages.into_iter();
        let mut rest: &[u32] = &[];
        let mut cut = |piece: &Piece| {
            if rest.is_empty() {
                rest = messages.next().expect("a message for each rank");
            }
            let (words, after) = rest.split_at(self.piece(piece));
            rest = after;
            words
        };
        pieces.iter().map(&mut cut).collect()
    }

    /// The rows of all pieces in messages, each with the number of its piece, its line there and
    /// its frame.
    fn rows_mut<'a>(
        self,
        messages: Vec<&'a mut [u32]>,
        pieces: &[Piece],
    ) -> Vec<([usize; 3], &'a mut [u32])> {
        let mut messages = messages.into_iter();
        let mut rest: &mut [u32] = &mut [];
        let mut rows = Vec::new();
        for (index, piece) in pieces.iter().enumerate() {
            if rest.is_empty() {
                rest = messages.next().expect("a message for each rank");
            }
            for i in 0..piece.seen.height * self.frames {
                let (row, after) = std::mem::take(&mut rest).split_at_mut(self.row(piece));
                rest = after;
                rows.push(([index, i / self.frames, i % self.frames], row));
            }
        }
        rows
    }
}

/// Rows that a thread packs at a time: fewer are not worth a thread.
pub(crate) const ROWS_AT_A_TIME: usize = 64;

/// The other side does not panic while it holds the lock.
const HELD: &str = "nobody panics with a transfer";

impl SampleHalo {
    /// The halo of rows of a rank's region.
    pub fn new(communicator: &dyn Communicator, regions: &Regions, reach: Reach) -> Self {
        let (seen, lent) = (regions.halo(reach), regions.lent(reach));
        let words = Words::of(regions);
        let outgoing = words.messages(&lent, |piece| piece.seer);
        let incoming = words.messages(&seen, |piece| piece.owner);
        let bytes = Words::bytes(&incoming, communicator.rank());
        let transfer = Mutex::new(communicator.transfer(&outgoing, &incoming));
        Self { transfer, seen, lent, words, bytes }
    }

    /// Sends the samples that others see.
    pub fn send(&mut self, rows: &Rows, samples: &[f32]) {
        let Self { transfer, lent, words, .. } = self;
        let transfer = transfer.get_mut().expect(HELD);
        let pack = |([index, j, t], to): ([usize; 3], &mut [u32])| {
            let from = rows.word_of(lent[index].owned, j, t);
            to.copy_from_slice(bytemuck::cast_slice(&samples[from..from + to.len()]));
        };
        let outgoing = words.rows_mut(transfer.outgoing(), lent);
        outgoing.into_par_iter().with_min_len(ROWS_AT_A_TIME).for_each(pack);
        transfer.start();
    }

    /// Waits for the samples that others have sent, and puts them where draws see them.
    pub fn receive(&mut self, worker: &Worker, rows: &Rows, samples: &mut [f32]) {
        let Self { transfer, seen, words, bytes, .. } = self;
        let transfer = transfer.get_mut().expect(HELD);
        worker.waiting(|| transfer.finish());
        worker.read_from_others(*bytes);
        for (piece, from) in seen.iter().zip(words.cut(transfer.incoming(), seen)) {
            for (i, row) in from.chunks_exact(words.row(piece)).enumerate() {
                let to = rows.word_of(piece.seen, i / words.frames, i % words.frames);
                samples[to..to + row.len()].copy_from_slice(bytemuck::cast_slice(row));
            }
        }
    }

    /// Lets what is under way get on.
    pub fn progress(&self) {
        progress(&self.transfer);
    }

    /// Whether a window sees samples of others.
    pub fn touches(&self, window: Window) -> bool {
        self.seen.iter().any(|piece| piece.seen.common(window).is_some())
    }
}

impl GradientHalo {
    /// The halo of the patches of a rank's blocks.
    pub fn new(
        communicator: &dyn Communicator,
        regions: &Regions,
        reach: Reach,
        blocks: &[Block],
    ) -> Self {
        let (seen, lent) = (regions.halo(reach), regions.lent(reach));
        let words = Words::of(regions);
        let outgoing = words.messages(&seen, |piece| piece.owner);
        let incoming = words.messages(&lent, |piece| piece.seer);
        let tile = regions.own().tile();
        let overlap = |piece: &Piece| {
            Overlap::with_window(tile, piece.seen, blocks.iter().map(Block::window))
        };
        let overlaps = seen.iter().map(overlap).collect();
        let transfer = Mutex::new(communicator.transfer(&outgoing, &incoming));
        let bytes = Words::bytes(&incoming, communicator.rank());
        Self { transfer, seen, lent, overlaps, words, bytes }
    }

    /// Where the patches lie that come from others.
    pub fn windows(&self) -> impl Iterator<Item = Window> {
        self.lent.iter().map(|piece| piece.owned)
    }

    /// Sends to others what the patches of this rank's blocks say of their samples.
    pub fn send(&mut self, patches: &[&[i32]], simd: Simd) {
        let Self { transfer, seen, overlaps, words, .. } = self;
        let transfer = transfer.get_mut().expect(HELD);
        let pack = |([index, y, t], to): ([usize; 3], &mut [u32])| {
            let (overlap, sums) = (&overlaps[index], bytemuck::cast_slice_mut(to));
            simd.run(Reduce { overlap, patches, y, t, sums });
        };
        let outgoing = words.rows_mut(transfer.outgoing(), seen);
        outgoing.into_par_iter().with_min_len(ROWS_AT_A_TIME).for_each(pack);
        transfer.start();
    }

    /// Waits for what others have sent.
    pub fn receive(&mut self, worker: &Worker) {
        let transfer = self.transfer.get_mut().expect(HELD);
        worker.waiting(|| transfer.finish());
        worker.read_from_others(self.bytes);
    }

    /// Calls `then` with the patches that were received, in the order of [`Self::windows`].
    pub fn with_received<T>(&self, then: impl FnOnce(Vec<&[i32]>) -> T) -> T {
        let transfer = self.transfer.lock().expect(HELD);
        let patches = self.words.cut(transfer.incoming(), &self.lent);
        then(patches.into_iter().map(bytemuck::cast_slice).collect())
    }

    /// Lets what is under way get on.
    pub fn progress(&self) {
        progress(&self.transfer);
    }
}

/// Lets a transfer get on, unless somebody else just does so.
fn progress(transfer: &Mutex<Box<dyn Transfer>>) {
    if let Ok(mut transfer) = transfer.try_lock() {
        transfer.progress();
    }
}

/// Adds up one row of a gradient.
pub(crate) struct Reduce<'a> {
    pub overlap: &'a Overlap,
    pub patches: &'a [&'a [i32]],
    pub y: usize,
    pub t: usize,
    pub sums: &'a mut [i32],
}

impl Vectorized for Reduce<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self { overlap, patches, y, t, sums } = self;
        sums.fill(0);
        for &(patch, start) in overlap.line(y) {
            let row = &patches[patch][start + t * overlap.stride(patch)..];
            for segment in overlap.segments(patch) {
                let part = &row[segment.from..segment.from + segment.len];
                let sums = &mut sums[segment.to..segment.to + segment.len];
                sums.iter_mut().zip(part).for_each(|(sum, &part)| *sum += part);
            }
        }
    }
}
