//! The memory of a rank: the blocks of its cells in one slice, and how their halos are filled.

use perceptile_cluster::{Combine, Endpoint, Message, Plan, PlanError, Segment, World};

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
    ///
    /// # Errors
    /// None that a partition can cause; the plan is checked nevertheless.
    pub fn new(partition: Partition, world: World) -> Result<Self, PlanError> {
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
        Ok(Self {
            first: owned.start,
            outwards: Plan::new(world.rank(), block_words.clone(), outwards)?,
            inwards: Plan::new(world.rank(), block_words.clone(), inwards)?,
            block_words,
            cell_words,
            partition,
        })
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
