//! The memory of a rank: the blocks of its cells in one slice, and how their halos are filled.

use perceptile_cluster::{Combine, Endpoint, Message, Plan, Segment, World};

use crate::tile::{Block, Cell, Partition};

/// The blocks of the cells that one rank owns, one after the other in one slice.
#[derive(Debug, Clone)]
pub struct Blocks {
    partition: Partition,
    /// First owned cell.
    first: usize,
    /// Words of each block, and of each cell without its halo.
    block_words: Vec<usize>,
    cell_words: Vec<usize>,
    /// From cells to the halos that are copies of them, and back.
    outwards: Plan,
    inwards: Plan,
}

impl Blocks {
    /// The blocks of this rank of `world`.
    pub fn new(partition: Partition, world: World) -> Self {
        let owned = partition.owned(world.rank());
        let shape = partition.shape();
        let pixel = shape.spp() * shape.dims();
        let block_words =
            owned.clone().map(|cell| partition.block(cell).pixels() * pixel).collect::<Vec<_>>();
        let cell_words =
            owned.clone().map(|cell| partition.cell(cell).pixels(shape.frames()) * pixel).collect();
        let endpoint = |cell: usize| {
            let rank = partition.owner(cell);
            Endpoint { rank, block: cell - partition.owned(rank).start }
        };
        let mut outwards = Vec::new();
        let mut inwards = Vec::new();
        for halo in (0..partition.cells()).flat_map(|cell| partition.halo(cell)) {
            let (owner, cell) = (endpoint(halo.owner), endpoint(halo.cell));
            let segments = |turned: bool| {
                halo.runs
                    .iter()
                    .map(|run| {
                        let (from, to) = if turned {
                            (run.halo_pixel, run.owner_pixel)
                        } else {
                            (run.owner_pixel, run.halo_pixel)
                        };
                        Segment { source: from * pixel, target: to * pixel, len: run.len * pixel }
                    })
                    .collect()
            };
            outwards.push(Message { source: owner, target: cell, segments: segments(false) });
            inwards.push(Message { source: cell, target: owner, segments: segments(true) });
        }
        let plan = |messages| {
            Plan::new(world.rank(), block_words.clone(), messages)
                .expect("halos lie in the blocks of their cells")
        };
        let (outwards, inwards) = (plan(outwards), plan(inwards));
        Self { first: owned.start, outwards, inwards, block_words, cell_words, partition }
    }

    /// The cells and their halos.
    pub fn partition(&self) -> &Partition {
        &self.partition
    }

    /// First cell of this rank.
    pub fn first(&self) -> usize {
        self.first
    }

    /// Words of every block of this rank.
    pub fn block_words(&self) -> &[usize] {
        &self.block_words
    }

    /// Words of every cell of this rank, without halos.
    pub fn cell_words(&self) -> &[usize] {
        &self.cell_words
    }

    /// Refreshes all halos with the samples of the cells that they are copies of.
    pub fn copy_to_halos(&self, world: World, samples: &mut [f32], mailbox: &mut Vec<f32>) {
        world.exchange(&self.outwards, samples, Combine::Copy, mailbox);
    }

    /// Adds what halos hold to the cells that they are copies of.
    pub fn add_from_halos(&self, world: World, gradient: &mut [i32], mailbox: &mut Vec<i32>) {
        world.exchange(&self.inwards, gradient, Combine::Add, mailbox);
    }

    /// The rows of an owned cell: for each, its first word in the block and in the cell, and its
    /// length in words.
    pub fn rows(&self, cell: usize) -> impl Iterator<Item = Row> + use<> {
        let shape = self.partition.shape();
        let pixel = shape.spp() * shape.dims();
        let Cell { width, height, .. } = self.partition.cell(cell);
        let block: Block = self.partition.block(cell);
        (0..shape.frames()).flat_map(move |t| {
            (0..height).map(move |y| Row {
                block: block.pixel(0, y, t) * pixel,
                cell: (t * height + y) * width * pixel,
                len: width * pixel,
            })
        })
    }
}

/// A row of a cell in memory, in words.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// First word in the block.
    pub block: usize,
    /// First word in the cell without its halo.
    pub cell: usize,
    /// Number of words.
    pub len: usize,
}

/// Cuts a slice into consecutive pieces of the given sizes.
///
/// # Panics
/// If they do not fit.
pub fn split<'a, T>(mut slice: &'a mut [T], sizes: &[usize]) -> Vec<&'a mut [T]> {
    let mut cut = |size: &usize| {
        let (head, tail) = std::mem::take(&mut slice).split_at_mut(*size);
        slice = tail;
        head
    };
    sizes.iter().map(&mut cut).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::tile::{Reach, TileShape};

    /// For every word of every block, its word in the tile in C order.
    fn places(partition: &Partition) -> Vec<usize> {
        let shape = partition.shape();
        let pixel = shape.spp() * shape.dims();
        let mut places = Vec::new();
        for cell in 0..partition.cells() {
            let (place, block) = (partition.cell(cell), partition.block(cell));
            for t in 0..block.frames {
                for y in 0..block.height {
                    for x in 0..block.width {
                        let around = |start: usize, at: usize, lead: usize, size: usize| {
                            (start as i64 + at as i64 - lead as i64).rem_euclid(size as i64)
                                as usize
                        };
                        let x = around(place.x, x, block.left, shape.width());
                        let y = around(place.y, y, block.up, shape.height());
                        let word = shape.pixel(x, y, t) * pixel;
                        places.extend(word..word + pixel);
                    }
                }
            }
        }
        places
    }

    /// Whether each word of the blocks is in a cell rather than its halo.
    fn owned(blocks: &Blocks) -> Vec<bool> {
        let mut owned = Vec::new();
        for (cell, &words) in blocks.block_words().iter().enumerate() {
            let start = owned.len();
            owned.resize(start + words, false);
            for row in blocks.rows(cell) {
                owned[start + row.block..start + row.block + row.len].fill(true);
            }
        }
        owned
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn halos_are_filled_and_emptied_around_the_torus(
            width in 1_usize..50, height in 1_usize..40, frames in 1_usize..3,
            spp in 1_usize..3, dims in 1_usize..3,
            left in 0_usize..9, right in 0_usize..9, up in 0_usize..5, down in 0_usize..5,
        ) {
            let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
            let partition = Partition::new(shape, Reach { left, right, up, down }, 1);
            let places = places(&partition);
            let blocks = Blocks::new(partition, World::Local);
            let owned = owned(&blocks);
            let fill = |(&place, &own): (&usize, &bool)| if own { place as f32 } else { -1.0 };
            let mut samples: Vec<f32> = places.iter().zip(&owned).map(fill).collect();
            blocks.copy_to_halos(World::Local, &mut samples, &mut Vec::new());
            let whole: Vec<f32> = places.iter().map(|&place| place as f32).collect();
            prop_assert_eq!(samples, whole);

            let gradient: Vec<i32> = (0..places.len() as i32).collect();
            let mut sums = vec![0; shape.coordinates()];
            places.iter().zip(&gradient).for_each(|(&place, &word)| sums[place] += word);
            let mut added = gradient;
            blocks.add_from_halos(World::Local, &mut added, &mut Vec::new());
            for i in (0..places.len()).filter(|&i| owned[i]) {
                prop_assert_eq!(added[i], sums[places[i]]);
            }
        }
    }
}
