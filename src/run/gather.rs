//! How the numbers of a tile come from the root of a cluster to their regions, and back.
//!
//! Nobody holds more than a few rows of what is another's: the root passes arrays on chunk by
//! chunk, in the order in which files have them. A chunk is some frames of one line, or some lines
//! of one frame, and is sent as one message to or from each region that has a share in it. One
//! process alone is a root whose region is the tile, and sends nothing.
//!
//! Whatever goes wrong at the root, all messages of an array are sent and received, so that no
//! rank waits for ever; the error is returned at the end.

use std::io;
use std::ops::Range;

use perceptile_cluster::communicator::Communicator;

use crate::format::numbers::{ArraySource, NumberSink};
use crate::tile::{Regions, TileShape};

/// Words of a chunk, as far as a row is not longer.
const CHUNK: usize = 1 << 18;

/// Some rows of a tile.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Chunk {
    lines: Range<usize>,
    frames: Range<usize>,
}

/// How arrays are cut into chunks, and chunks into shares of regions.
#[derive(Clone, Copy)]
struct Cut<'a> {
    regions: &'a Regions,
    tile: TileShape,
    pixel: usize,
}

impl<'a> Cut<'a> {
    fn new(regions: &'a Regions) -> Self {
        let tile = regions.own().tile();
        Self { regions, tile, pixel: tile.spp() * tile.dims() }
    }

    /// For each of `outer`, all of `inner`, as many at a time as a chunk has rows.
    fn ranges(&self, outer: usize, inner: usize) -> impl Iterator<Item = [Range<usize>; 2]> {
        let rows = (CHUNK / (self.tile.width() * self.pixel)).max(1);
        (0..outer).flat_map(move |at| {
            let starts = (0..inner).step_by(rows);
            starts.map(move |start| [at..at + 1, start..(start + rows).min(inner)])
        })
    }

    /// The chunks of an array in line order.
    fn in_line_order(&self) -> Vec<Chunk> {
        let ranges = self.ranges(self.tile.height(), self.tile.frames());
        ranges.map(|[lines, frames]| Chunk { lines, frames }).collect()
    }

    /// The chunks of an array in C order.
    fn in_c_order(&self) -> Vec<Chunk> {
        let ranges = self.ranges(self.tile.frames(), self.tile.height());
        ranges.map(|[frames, lines]| Chunk { lines, frames }).collect()
    }

    /// Words of a chunk.
    fn words(&self, chunk: &Chunk) -> usize {
        chunk.lines.len() * chunk.frames.len() * self.tile.width() * self.pixel
    }

    /// The lines of a chunk that a rank has.
    fn share(&self, chunk: &Chunk, rank: usize) -> Range<usize> {
        let place = self.regions.all()[rank].place();
        let start = chunk.lines.start.max(place.y);
        start..chunk.lines.end.min(place.y + place.height).max(start)
    }

    /// Words of a rank's share of a chunk.
    fn shared_words(&self, chunk: &Chunk, rank: usize) -> usize {
        let width = self.regions.all()[rank].place().width;
        self.share(chunk, rank).len() * chunk.frames.len() * width * self.pixel
    }

    /// Ranks that have a share of a chunk.
    fn ranks(&self, chunk: &'a Chunk) -> impl Iterator<Item = usize> {
        (0..self.regions.all().len()).filter(|&rank| !self.share(chunk, rank).is_empty())
    }

    /// Where the rows of a rank's share lie in a chunk, in the order of the share.
    fn places(&self, chunk: &Chunk, rank: usize) -> impl Iterator<Item = Range<usize>> {
        let (place, frames) = (self.regions.all()[rank].place(), chunk.frames.len());
        let (row, pixel) = (self.tile.width() * self.pixel, self.pixel);
        let lines = self.share(chunk, rank);
        let start = chunk.lines.start;
        lines.flat_map(move |y| {
            (0..frames).map(move |t| {
                let from = ((y - start) * frames + t) * row + place.x * pixel;
                from..from + place.width * pixel
            })
        })
    }
}

/// Shares arrays in line order out to all ranks, as their root.
pub struct Scatter<'a> {
    communicator: &'a dyn Communicator,
    cut: Cut<'a>,
    chunks: Vec<Chunk>,
    next: usize,
    buffer: Vec<f32>,
    taken: u64,
}

impl<'a> Scatter<'a> {
    /// Begins with an array.
    pub fn new(communicator: &'a dyn Communicator, regions: &'a Regions) -> Self {
        let cut = Cut::new(regions);
        let chunks = cut.in_line_order();
        Self { communicator, cut, chunks, next: 0, buffer: Vec::new(), taken: 0 }
    }

    /// Takes the next numbers; an array follows the other. What is the root's own comes out again,
    /// in the line order of its region.
    pub fn take(&mut self, mut piece: &[f32], own: &mut dyn FnMut(&[f32])) {
        self.taken += piece.len() as u64;
        while !piece.is_empty() {
            let chunk = &self.chunks[self.next];
            let words = self.cut.words(chunk);
            let (now, rest) = piece.split_at(piece.len().min(words - self.buffer.len()));
            self.buffer.extend_from_slice(now);
            piece = rest;
            if self.buffer.len() < words {
                return;
            }
            for rank in self.cut.ranks(chunk) {
                let rows = self.cut.places(chunk, rank).map(|row| &self.buffer[row]);
                let share = rows.collect::<Vec<&[f32]>>().concat();
                if rank == self.communicator.rank() {
                    own(&share);
                } else {
                    self.communicator.send(rank, bytemuck::cast_slice(&share));
                }
            }
            self.buffer.clear();
            self.next = (self.next + 1) % self.chunks.len();
        }
    }

    /// Sends zeros in place of all that is missing of so many arrays.
    pub fn make_up(&mut self, arrays: usize) {
        let all = self.cut.tile.coordinates() as u64 * arrays as u64;
        let zeros = vec![0.0; CHUNK];
        while self.taken < all {
            let words = (all - self.taken).min(CHUNK as u64) as usize;
            self.take(&zeros[..words], &mut |_| ());
        }
    }
}

/// Receives a rank's part of an array that its root shares out, in the line order of its region.
pub fn receive(communicator: &dyn Communicator, regions: &Regions, own: &mut dyn FnMut(&[f32])) {
    let cut = Cut::new(regions);
    let mut share = Vec::new();
    for chunk in cut.in_line_order() {
        let words = cut.shared_words(&chunk, communicator.rank());
        if words > 0 {
            share.resize(words, 0.0);
            communicator.receive(0, bytemuck::cast_slice_mut(&mut share));
            own(&share);
        }
    }
}

/// Puts chunks together at the root, from the shares of all ranks.
struct Gather<'a> {
    communicator: &'a dyn Communicator,
    cut: Cut<'a>,
    buffer: Vec<f32>,
    sink: &'a mut dyn NumberSink,
    result: io::Result<()>,
}

impl Gather<'_> {
    /// Gives this rank's share of a chunk. The root puts the chunk together and passes it on, unless
    /// something went wrong before.
    fn chunk(&mut self, chunk: &Chunk, own: &[f32]) {
        let Self { communicator, cut, buffer, sink, result } = self;
        if communicator.rank() != 0 {
            if !own.is_empty() {
                communicator.send(0, bytemuck::cast_slice(own));
            }
            return;
        }
        buffer.resize(cut.words(chunk), 0.0);
        for rank in cut.ranks(chunk) {
            let (mut from, mut share) = (own, Vec::new());
            if rank != 0 {
                share.resize(cut.shared_words(chunk, rank), 0.0);
                communicator.receive(rank, bytemuck::cast_slice_mut(&mut share));
                from = &share;
            }
            for place in cut.places(chunk, rank) {
                let (row, rest) = from.split_at(place.len());
                buffer[place].copy_from_slice(row);
                from = rest;
            }
        }
        if result.is_ok() {
            *result = sink.put(buffer);
        }
    }
}

/// Puts an array in line order together. Each rank gives its own part of it, an array of `own` in
/// the line order of its region; the root puts the whole into `sink`.
///
/// # Errors
/// What `sink` reports.
pub fn gather(
    communicator: &dyn Communicator,
    regions: &Regions,
    (own, index): (&dyn ArraySource, usize),
    sink: &mut dyn NumberSink,
) -> io::Result<()> {
    let cut = Cut::new(regions);
    let mut whole = Gather { communicator, cut, buffer: Vec::new(), sink, result: Ok(()) };
    let mut chunks = cut.in_line_order().into_iter().peekable();
    let mut waiting = Vec::new();
    let share = |chunk: &Chunk| cut.shared_words(chunk, communicator.rank());
    let given = own.array(index, &mut |piece: &[f32]| {
        waiting.extend_from_slice(piece);
        while let Some(chunk) = chunks.next_if(|chunk| share(chunk) <= waiting.len()) {
            let words = share(&chunk);
            whole.chunk(&chunk, &waiting[..words]);
            waiting.drain(..words);
        }
        Ok(())
    });
    chunks.for_each(|chunk| whole.chunk(&chunk, &[]));
    given.and(whole.result)
}

/// Puts a tile together in C order. Each rank gives its region in line order; the root puts the
/// tile into `sink`.
///
/// # Errors
/// What `sink` reports.
pub fn gather_tile(
    communicator: &dyn Communicator,
    regions: &Regions,
    own: &[f32],
    sink: &mut dyn NumberSink,
) -> io::Result<()> {
    let cut = Cut::new(regions);
    let mut whole = Gather { communicator, cut, buffer: Vec::new(), sink, result: Ok(()) };
    let place = regions.own().place();
    let row = place.width * cut.pixel;
    for chunk in cut.in_c_order() {
        let rows = cut.share(&chunk, communicator.rank()).map(|y| {
            let start = ((y - place.y) * cut.tile.frames() + chunk.frames.start) * row;
            &own[start..start + row]
        });
        whole.chunk(&chunk, &rows.collect::<Vec<&[f32]>>().concat());
    }
    whole.result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::{Partition, Reach};
    use perceptile_cluster::communicator::InProcess;
    use proptest::prelude::*;

    /// The numbers of a tile in C order, each of them another.
    fn number(shape: TileShape, [x, y, t, k]: [usize; 4]) -> f32 {
        (shape.pixel(x, y, t) * shape.spp() * shape.dims() + k) as f32
    }

    /// A rectangle in line order.
    fn in_line_order(shape: TileShape, place: crate::tile::Cell) -> Vec<f32> {
        let pixel = shape.spp() * shape.dims();
        let mut words = Vec::new();
        for y in place.y..place.y + place.height {
            for t in 0..shape.frames() {
                for x in place.x..place.x + place.width {
                    words.extend((0..pixel).map(|k| number(shape, [x, y, t, k])));
                }
            }
        }
        words
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn arrays_come_to_their_regions_and_back(
            width in 1_usize..70, height in 1_usize..60, frames in 1_usize..5, ranks in 1_usize..6,
            size in 1_usize..3000, fails in proptest::option::of(0_usize..9000),
        ) {
            let shape = TileShape::new(width, height, frames, 1, 2).unwrap();
            let partition = Partition::new(shape, Reach::default());
            let ranks = ranks.min(partition.cells());
            let whole = in_line_order(shape, crate::tile::Region::whole(shape).place());
            let in_c_order: Vec<f32> = (0..shape.coordinates()).map(|i| i as f32).collect();
            std::thread::scope(|scope| {
                for communicator in InProcess::group(ranks) {
                    let (partition, whole, in_c_order) = (&partition, &whole, &in_c_order);
                    scope.spawn(move || {
                        let regions = partition.regions(ranks, communicator.rank()).unwrap();
                        let mine = in_line_order(shape, regions.own().place());
                        // Two arrays, one after the other, of which the second may break off.
                        let mut found = Vec::new();
                        if communicator.rank() == 0 {
                            let mut scatter = Scatter::new(&communicator, &regions);
                            let given = fails.map_or(whole.len(), |at| at.min(whole.len()));
                            for piece in whole.chunks(size).chain(whole[..given].chunks(size)) {
                                scatter.take(piece, &mut |own| found.extend_from_slice(own));
                            }
                            scatter.make_up(2);
                        } else {
                            for _ in 0..2 {
                                receive(&communicator, &regions, &mut |own| found.extend_from_slice(own));
                            }
                        }
                        assert_eq!(found[..mine.len()], mine);
                        if fails.is_none() {
                            assert_eq!(found[mine.len()..], mine);
                        }

                        for wrong in [None, fails] {
                            let mut found = Vec::new();
                            let own = |_: usize, sink: &mut dyn NumberSink| {
                                mine.chunks(size).try_for_each(|piece| sink.put(piece))
                            };
                            let result = gather(&communicator, &regions, (&own, 0), &mut |piece: &[f32]| {
                                found.extend_from_slice(piece);
                                let ok = wrong.is_none_or(|at| found.len() <= at);
                                if ok { Ok(()) } else { Err(io::Error::other("full")) }
                            });
                            if communicator.rank() == 0 {
                                let fits = wrong.is_none_or(|at| whole.len() <= at);
                                assert_eq!(result.is_ok(), fits);
                                if fits {
                                    assert_eq!(&found, whole);
                                }
                            }
                        }
                        let mut tile = Vec::new();
                        gather_tile(&communicator, &regions, &mine, &mut |piece: &[f32]| {
                            tile.extend_from_slice(piece);
                            Ok(())
                        })
                        .unwrap();
                        if communicator.rank() == 0 {
                            assert_eq!(&tile, in_c_order);
                        }
                    });
                }
            });
        }
    }
}
