//! What work costs on this machine, measured on a small tile of a run's kind.
//!
//! One thread does some steps of its descent, and packs and unpacks the halos of two ranks.

use std::sync::Arc;
use std::time::{Duration, Instant};

use perceptile_cluster::communicator::{Communicator, InProcess};
use perceptile_cluster::shared::MapError;
use perceptile_cluster::{Ends, Worker};
use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use serde::Serialize;
use thiserror::Error;

use super::{Costs, Load, Model, Network, RankMemory};
use crate::gradient::probe::Stage;
use crate::gradient::simd::Simd;
use crate::kernel::{Kernel, KernelClass, KernelError};
use crate::profile::measure;
use crate::profile::subject::{Subject, WORD};
use crate::profile::traffic;
use crate::solver::{
    BLOCKS_PER_THREAD, GradientHalo, Options, OptionsError, Parallelism, SampleHalo, StoragePlan,
};
use crate::tile::{Block, Layout, Partition, Region, Rows, SLACK, TileShape, TooManyRanks};

/// Coordinates that a small tile has at most, as far as it can be cut: 64 MB with its moments.
const COORDINATES: usize = 1 << 22;
/// Sides that are not cut any further: they still have four cells.
const SIDE: usize = 32;
/// Frames that are not cut any further.
const FRAMES: usize = 8;
/// Rounds without work for each look at the clock.
const ROUNDS: u64 = 64;

/// Why costs cannot be measured.
#[derive(Debug, Error)]
pub enum CostsError {
    /// The run cannot be.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// There is no memory for it.
    #[error(transparent)]
    Memory(#[from] MapError),
    /// The system gives no threads.
    #[error("threads cannot be had: {0}")]
    InProcess(#[from] ThreadPoolBuildError),
}

impl From<KernelError> for CostsError {
    fn from(error: KernelError) -> Self {
        Self::Options(error.into())
    }
}

impl From<TooManyRanks> for CostsError {
    fn from(error: TooManyRanks) -> Self {
        Self::Options(error.into())
    }
}

/// What was measured for tiles of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measured {
    /// The small tile.
    pub shape: TileShape,
    /// Draws of a step there.
    pub load: Load,
    /// What work costs.
    pub costs: Costs,
    /// Whether that explains whole steps.
    pub check: Check,
}

/// A whole step of the small tile by all threads of this machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Check {
    /// InProcess.
    pub threads: usize,
    /// Seconds that the model says.
    pub predicted: f64,
    /// Seconds that it took.
    pub measured: f64,
}

impl Measured {
    /// Measures what the steps of a run cost, with about `time` for each of four measurements,
    /// and checks it with so many threads.
    ///
    /// # Errors
    /// If the run cannot be, or there is no memory or no thread for it.
    pub fn take(
        options: &Options,
        simd: Simd,
        threads: usize,
        time: Duration,
    ) -> Result<Self, CostsError> {
        let (options, kernel) = small(options)?;
        let shape = options.shape;
        let pool = |threads: usize| ThreadPoolBuilder::new().num_threads(threads).build();
        let one = Subject::new(&options, &kernel, 1)?;
        let samples = one.start();
        let (stages, packing) = pool(1)?.install(|| -> Result<_, CostsError> {
            let stages = measure::stages(&one, simd, &samples, time)?;
            Ok((stages, packing(one.partition(), &samples.words, simd, time)?))
        })?;
        let (_, subsets) = traffic::count(&one, 1);
        let load = Load {
            draws: options.draw.draws as f64,
            samples: subsets.samples,
            directions: options.draw.directions as f64,
        };
        let (reduce, adam) = (stages.of(Stage::Reduce), stages.of(Stage::Adam));
        let drawing = stages.sum() - reduce - adam - stages.of(Stage::Waiting);
        let words: usize = one.blocks().iter().map(Block::words).sum();
        let numbers = load.draws * load.samples * load.directions;
        let all = pool(threads)?;
        let costs = Costs {
            sample: drawing * 1e-9 / numbers.max(1.0),
            coordinate: adam * 1e-9 / shape.coordinates() as f64,
            patch_word: reduce * 1e-9 / words as f64,
            packed_byte: packing[0],
            unpacked_byte: packing[1],
            round: all.install(|| round(one.partition(), time))?,
        };
        let together = Subject::new(&options, &kernel, threads)?;
        let whole = |together| measure::whole(together, Layout::Rows, simd, &samples, time, || ());
        let measured = all.install(|| whole(&together))?.seconds;
        let network = Network { latency: 0.0, bandwidth: f64::INFINITY };
        let model = Model { costs, network, memory: RankMemory::ENDLESS, threads };
        let predicted = model.step(one.partition(), &load, 1)?.seconds;
        Ok(Self { shape, load, costs, check: Check { threads, predicted, measured } })
    }

    /// The draws of a step of a larger tile of this kind.
    pub fn load(&self, draws: usize) -> Load {
        Load { draws: draws as f64, ..self.load }
    }
}

/// The same run on a tile that is small, with as many draws for each pixel, and its kernel there.
fn small(options: &Options) -> Result<(Options, Kernel), CostsError> {
    let mut kernel = options.kernel.resolve(options.shape)?;
    let mut shape = options.shape;
    while shape.coordinates() > COORDINATES {
        let [x, y, t] = [shape.width(), shape.height(), shape.frames()];
        let [x, y, t] = if x.max(y) > SIDE && x.max(y) >= t {
            let half = x.max(y).div_ceil(2).max(SIDE);
            if x >= y { [half, y, t] } else { [x, half, t] }
        } else {
            [x, y, t.div_ceil(2).max(FRAMES.min(t))]
        };
        let Ok(smaller) = TileShape::new(x, y, t, shape.spp(), shape.dims()) else { break };
        // A kernel may need more of a tile than is left.
        let Ok(fitting) = options.kernel.resolve(smaller) else { break };
        let long = |class: &KernelClass| class.taps.size()[2] > t as u64;
        if smaller == shape || t < shape.frames() && fitting.classes().iter().any(long) {
            break;
        }
        (shape, kernel) = (smaller, fitting);
    }
    let share = shape.pixels() as f64 / options.shape.pixels() as f64;
    let mut options = Options { shape, ..options.clone() };
    options.draw.draws = ((options.draw.draws as f64 * share).round() as usize).max(1);
    // Only the descent is looked at.
    options.polish.steps = 0;
    Ok((options, kernel))
}

/// Seconds for each byte that is packed, and unpacked, by one of two ranks; both have as much to
/// do. A tile of one cell has no halos.
fn packing(
    partition: &Partition,
    samples: &[f32],
    simd: Simd,
    time: Duration,
) -> Result<[f64; 2], CostsError> {
    let reach = partition.reach();
    if partition.cells() < 2 {
        return Ok([0.0; 2]);
    }
    let mut ranks = Vec::new();
    for communicator in InProcess::group(2) {
        let communicator: Arc<dyn Communicator> = Arc::new(communicator);
        let regions = partition.regions(2, communicator.rank())?;
        let parallelism = Parallelism { ranks: 2, workers: 0, threads: 1 };
        let plan = StoragePlan::new(partition, regions.own(), parallelism);
        let (worker, _) = plan.beside(Arc::clone(&communicator))?;
        let blocks = parallelism.blocks(partition, regions.own());
        let patches: Vec<Vec<i32>> =
            blocks.iter().map(|block| vec![1; block.words() + SLACK]).collect();
        let rows = Rows::new(regions.own(), reach);
        let own: Vec<f32> = samples.iter().copied().cycle().take(rows.words() + SLACK).collect();
        let there = SampleHalo::new(&*communicator, &regions, reach);
        let back = GradientHalo::new(&*communicator, &regions, reach, &blocks);
        let pixel = partition.shape().spp() * partition.shape().dims();
        let pieces = regions.halo(reach);
        let pixels = pieces.iter().map(|piece| piece.pixels(partition.shape().frames()));
        let bytes = WORD as f64 * (pixels.sum::<usize>() * pixel) as f64;
        ranks.push((worker, rows, own, patches, there, back, bytes));
    }
    let bytes: f64 = ranks.iter().map(|(.., bytes)| bytes).sum();
    let begun = Instant::now();
    let [mut packing, mut unpacking] = [Duration::ZERO; 2];
    let mut times = 0;
    while times < 2 || begun.elapsed() < time {
        let start = Instant::now();
        for (_, rows, own, patches, there, back, _) in &mut ranks {
            let patches: Vec<&[i32]> = patches.iter().map(Vec::as_slice).collect();
            back.send(&patches, simd);
            there.send(rows, own);
        }
        packing += start.elapsed();
        let start = Instant::now();
        for (worker, rows, own, _, there, ..) in &mut ranks {
            there.receive(worker, rows, own);
        }
        unpacking += start.elapsed();
        ranks.iter_mut().for_each(|(worker, .., back, _)| back.receive(worker));
        times += 1;
    }
    let times = f64::from(times);
    Ok([packing.as_secs_f64() / (2.0 * bytes * times), unpacking.as_secs_f64() / (bytes * times)])
}

/// Seconds of a round without work by all threads of the pool: the least that was found.
fn round(partition: &Partition, time: Duration) -> Result<f64, MapError> {
    let threads = rayon::current_num_threads();
    let parallelism = Parallelism { ranks: 1, workers: 0, threads };
    let region = Region::whole(partition.shape());
    let (worker, _) = StoragePlan::new(partition, region, parallelism).private()?;
    let jobs = partition.block_count(region, threads * BLOCKS_PER_THREAD);
    let rounds = |worker: &Worker, numbers: std::ops::Range<u64>| {
        for number in numbers {
            worker.round(number, Ends::Half, 0..jobs, (), |_, ()| ());
        }
    };
    let begun = Instant::now();
    let (mut next, mut least) = (1, f64::INFINITY);
    while least.is_infinite() || begun.elapsed() < time {
        let start = Instant::now();
        rounds(&worker, next..next + ROUNDS);
        least = least.min(start.elapsed().as_secs_f64() / ROUNDS as f64);
        next += ROUNDS;
    }
    Ok(least)
}
