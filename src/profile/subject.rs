//! The descent of a run, taken apart into what the profile looks at.

use serde::Serialize;

use perceptile_cluster::shared::MapError;

use crate::draw::{CellDraws, Draws, LevelSets};
use crate::gradient::probe::Probe;
use crate::gradient::simd::Simd;
use crate::gradient::{Gradient, Quantum, RunTables};
use crate::kernel::Kernel;
use crate::solver::{BLOCKS_PER_THREAD, Descent, Options, OptionsError, Samples, start};
use crate::tile::{Block, Layout, Partition, Region, Rows, TileShape};

/// Bytes of a word: samples, gradients and moments are all of this size.
pub const WORD: u64 = size_of::<f32>() as u64;

/// What a run's descent consists of.
#[derive(Debug, Clone)]
pub struct Subject {
    options: Options,
    partition: Partition,
    draws: Draws,
    quantum: Quantum,
    runs: RunTables,
    rows: Rows,
    blocks: Vec<Block>,
    threads: usize,
}

/// Bytes of what a descent keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Sizes {
    /// The samples in their rows, copies around the torus included.
    pub samples: u64,
    /// Both moments of Adam.
    pub moments: u64,
    /// The patches of all blocks.
    pub patches: u64,
    /// The largest patch.
    pub patch: u64,
    /// What the draws of the largest cell see of the samples; of the gradient it is as much.
    pub window: u64,
}

impl Sizes {
    /// Everything that a step goes through.
    pub fn all(&self) -> u64 {
        self.samples + self.moments + self.patches
    }
}

impl Subject {
    /// The descent of a run on so many threads.
    ///
    /// # Errors
    /// Options outside their ranges, or a kernel that does not fit.
    pub fn new(options: &Options, kernel: &Kernel, threads: usize) -> Result<Self, OptionsError> {
        options.validate()?;
        let kernel = kernel.folded(options.shape.frames())?;
        options.check_kernel(&kernel)?;
        let levels = LevelSets::of(&kernel, options.shape.spp());
        let partition = Partition::new(options.shape, levels.reach());
        let runs = RunTables::new(&levels, options.shape.frames());
        let draws = Draws::new(options.draw, options.seed, levels, options.directions());
        let quantum = Quantum::new(&draws, &partition).ok_or(OptionsError::Batch {
            draws: options.draw.draws,
            directions: options.draw.directions,
        })?;
        let rows = Rows::new(Region::whole(options.shape), partition.reach());
        let blocks = partition
            .blocks(Region::whole(options.shape), threads.saturating_mul(BLOCKS_PER_THREAD));
        Ok(Self {
            options: options.clone(),
            partition,
            draws,
            quantum,
            runs,
            rows,
            blocks,
            threads,
        })
    }

    /// The run's options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The tile's shape.
    pub fn shape(&self) -> TileShape {
        self.options.shape
    }

    /// The cells.
    pub fn partition(&self) -> &Partition {
        &self.partition
    }

    /// The runs of the draws' subsets.
    pub fn runs(&self) -> &RunTables {
        &self.runs
    }

    /// How the samples lie.
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// What threads take in turn.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Threads of the run.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// The draws of a cell in a step.
    pub fn cell_draws(&self, step: u32, cell: usize) -> CellDraws {
        let mut draws = CellDraws::default();
        self.draws.cell(&self.partition, step, cell, &mut draws);
        draws
    }

    /// Columns and rows that the draws of a cell see.
    pub fn window(&self, cell: usize) -> [usize; 2] {
        let (cell, reach) = (self.partition.cell(cell), self.partition.reach());
        [reach.left + cell.width + reach.right, reach.up + cell.height + reach.down]
    }

    /// Bytes of what the descent keeps.
    pub fn sizes(&self) -> Sizes {
        let frames = self.shape().frames();
        let patches = self.blocks.iter().map(|block| block.words() as u64 * WORD);
        let windows = (0..self.partition.cells()).map(|cell| self.window(cell));
        let pixel = self.rows.pixel() as u64 * WORD;
        let window = windows.map(|[width, height]| (width * height * frames) as u64 * pixel).max();
        Sizes {
            samples: self.rows.words() as u64 * WORD,
            moments: 2 * self.shape().coordinates() as u64 * WORD,
            patches: patches.clone().sum(),
            patch: patches.max().unwrap_or(0),
            window: window.unwrap_or(0),
        }
    }

    /// Samples to start from.
    pub fn start(&self) -> Samples {
        start::random(
            self.options.domain,
            &self.partition,
            Region::whole(self.options.shape),
            self.options.seed,
        )
    }

    /// The descent itself, in a layout and with probes; to be called by a thread of the pool that
    /// is to do it.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn descent<P: Probe>(
        &self,
        layout: Layout,
        simd: Simd,
        samples: &Samples,
        probe: impl Fn() -> P,
    ) -> Result<Descent<P>, MapError> {
        let (draws, partition) = (self.draws.clone(), self.partition.clone());
        let gradient = Gradient::new(draws, partition, self.quantum, simd).with_layout(layout);
        let Options { adam, steps, .. } = self.options;
        Descent::probed(gradient, adam, steps, simd, samples, probe)
    }
}
