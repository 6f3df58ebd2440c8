//! What the model says of tiles for growing numbers of ranks, and its tables.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use super::costs::{Check, CostsError, Measured};
use super::{Bottleneck, Model, Network, Prediction, RankMemory, largest};
use crate::draw::LevelSets;
use crate::gradient::simd::Simd;
use crate::profile::machine::Machine;
use crate::solver::{Options, Preset};
use crate::tile::{Partition, TileShape};

/// Version of the form of [`Scaling`] as JSON.
pub const FORMAT: u32 = 1;

/// Pixels across and down that each rank has where the tile grows with them.
const EACH: usize = 128;

/// The kernel of the paper.
const KERNEL: &str = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";

/// A cluster, and how far it is to be predicted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Cluster {
    /// What carries messages.
    pub network: Network,
    /// What a rank has for its data.
    pub memory: RankMemory,
    /// Threads of a rank.
    pub threads: usize,
    /// Most ranks.
    pub ranks: usize,
    /// Cores that all ranks share, if they are on one machine; otherwise each has its own.
    pub cores: Option<usize>,
}

/// How tiles scale.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scaling {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of this program.
    pub version: &'static str,
    /// The machine that costs were measured on.
    pub machine: Machine,
    /// Its instruction set.
    pub simd: &'static str,
    /// The cluster that is predicted.
    pub cluster: Cluster,
    /// The tiles.
    pub tiles: Vec<TileScaling>,
}

/// How a tile scales.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TileScaling {
    /// The tile.
    pub shape: TileShape,
    /// The kernel.
    pub kernel: String,
    /// Draws of a step.
    pub draws: usize,
    /// What its steps cost.
    pub measured: Measured,
    /// More ranks for the same tile.
    pub strong: ScalingTable,
    /// More ranks for a tile and a batch that grow with them.
    pub weak: ScalingTable,
}

/// A tile for growing numbers of ranks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScalingTable {
    /// Whether the tile grows with the ranks.
    pub grows: bool,
    /// One row for each number of ranks: 1, 2, 4 and so on.
    pub rows: Vec<Row>,
    /// Where efficiency falls below a half, and what most of the rest is lost to.
    pub half: Option<(usize, Bottleneck)>,
}

/// A number of ranks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Ranks.
    pub ranks: usize,
    /// The tile.
    pub shape: TileShape,
    /// Its cells.
    pub cells: usize,
    /// Whether it is more than the cores of this machine.
    pub extrapolated: bool,
    /// Its step, if it has as many cells.
    pub step: Option<Step>,
}

/// A step, and how it compares with that of one rank.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Step {
    /// The step.
    #[serde(flatten)]
    pub prediction: Prediction,
    /// Work for each second, in terms of one rank.
    pub speedup: f64,
    /// The same for each rank.
    pub efficiency: f64,
}

/// The tiles that are predicted where none is asked for: that of the paper, and two larger ones
/// with as many draws for each pixel.
pub fn tiles() -> Vec<Options> {
    let paper = Preset::Paper.options();
    let tile = |width, height, frames, spp, dims| {
        let shape = TileShape::new(width, height, frames, spp, dims).expect("sizes in range");
        let mut options = paper.clone();
        options.draw.draws = in_proportion(&paper, shape);
        Options { shape, kernel: KERNEL.parse().expect("a kernel"), ..options }
    };
    vec![tile(128, 128, 30, 1, 2), tile(256, 256, 64, 16, 4), tile(1024, 1024, 128, 64, 10)]
}

/// As many draws for each pixel.
fn in_proportion(options: &Options, shape: TileShape) -> usize {
    let share = shape.pixels() as f64 / options.shape.pixels() as f64;
    ((options.draw.draws as f64 * share).round() as usize).max(1)
}

impl Scaling {
    /// Measures what tiles cost, with about `time` for each of four measurements, and predicts
    /// their steps; the model is checked with so many threads of this machine.
    ///
    /// # Errors
    /// If a run cannot be, or there is no memory or no thread for the measurements.
    pub fn take(
        tiles: &[Options],
        cluster: Cluster,
        simd: Simd,
        threads: usize,
        time: Duration,
    ) -> Result<Self, CostsError> {
        let machine = Machine::detect();
        let tile = |options: &Options| {
            let measured = Measured::take(options, simd, threads, time)?;
            TileScaling::new(options, measured, cluster, machine.cores)
        };
        let tiles = tiles.iter().map(tile).collect::<Result<_, _>>()?;
        let (version, simd) = (env!("CARGO_PKG_VERSION"), simd.name());
        Ok(Self { format: FORMAT, version, machine, simd, cluster, tiles })
    }
}

impl TileScaling {
    fn new(
        options: &Options,
        measured: Measured,
        cluster: Cluster,
        cores: usize,
    ) -> Result<Self, CostsError> {
        let Cluster { network, memory, threads, ranks: most, .. } = cluster;
        let model = Model { costs: measured.costs, network, memory, threads };
        let shape = options.shape;
        let row = |(ranks, shape): (usize, TileShape)| -> Result<_, CostsError> {
            let kernel = options.kernel.resolve(shape)?.folded(shape.frames())?;
            let partition = Partition::new(shape, LevelSets::of(&kernel, shape.spp()).reach());
            let load = measured.load(in_proportion(options, shape));
            let extrapolated = ranks.saturating_mul(threads) > cores;
            // More ranks than cells are where a table ends, and no error.
            let prediction = match cluster.cores {
                Some(cores) => model.predict_run(&partition, &load, ranks, cores).ok(),
                None => model.step(&partition, &load, ranks).ok(),
            };
            Ok((
                Row { ranks, shape, cells: partition.cells(), extrapolated, step: None },
                prediction,
            ))
        };
        let numbers = (0..usize::BITS).map(|k| 1 << k).take_while(|&ranks: &usize| ranks <= most);
        let strong: Result<Vec<_>, _> = numbers.clone().map(|ranks| row((ranks, shape))).collect();
        let grown = numbers.map_while(|ranks| Some((ranks, grown(shape, ranks)?)));
        let weak: Result<Vec<_>, _> = grown.map(row).collect();
        Ok(Self {
            shape,
            kernel: options.kernel.to_string(),
            draws: options.draw.draws,
            measured,
            strong: ScalingTable::new(false, strong?),
            weak: ScalingTable::new(true, weak?),
        })
    }
}

/// The tile that gives each of 2ᵏ ranks [`EACH`] by [`EACH`] pixels, or all of a smaller tile.
fn grown(shape: TileShape, ranks: usize) -> Option<TileShape> {
    let doubled = ranks.trailing_zeros();
    let [across, down] = [doubled.div_ceil(2), doubled / 2];
    let [width, height] = [shape.width(), shape.height()].map(|side| side.min(EACH));
    TileShape::new(width << across, height << down, shape.frames(), shape.spp(), shape.dims()).ok()
}

impl ScalingTable {
    /// Compares predictions with that of one rank.
    fn new(grows: bool, rows: Vec<(Row, Option<Prediction>)>) -> Self {
        let first = rows.first().and_then(|(_, prediction)| *prediction);
        let step = |prediction: Prediction| {
            let (one, ranks) = (first?, prediction.ranks as f64);
            let faster = one.seconds / prediction.seconds;
            let speedup = if grows { ranks * faster } else { faster };
            Some(Step { prediction, speedup, efficiency: speedup / ranks })
        };
        let rows: Vec<Row> = rows
            .into_iter()
            .map(|(row, prediction)| Row { step: prediction.and_then(step), ..row })
            .collect();
        let half = rows.iter().filter_map(|row| row.step).find(|step| step.efficiency < 0.5);
        let half = half.zip(first).map(|(step, one)| {
            let share = if grows { 1.0 } else { 1.0 / step.prediction.ranks as f64 };
            let parts = step.prediction.parts.all().into_iter().zip(one.parts.all());
            let lost: Vec<_> =
                parts.map(|((bound, now), (_, then))| (bound, now - share * then)).collect();
            (step.prediction.ranks, largest(&lost))
        });
        Self { grows, rows, half }
    }

    /// Where it stops, and why.
    fn end(&self) -> String {
        let stop =
            self.rows.iter().find(|row| row.step.is_none()).map_or(String::new(), |row| match row
                .cells
            {
                1 => "Stops at its only cell, which is not divided. ".into(),
                cells => format!("Stops at its {cells} cells, which are not divided. "),
            });
        let half = match self.half {
            Some((ranks, bound)) => {
                format!("Efficiency is below 50 % from {ranks} ranks on: {}.", bound.loss())
            }
            None => "Efficiency stays above 50 %.".into(),
        };
        stop + &half
    }
}

impl Bottleneck {
    /// What is lost to it, as people say it.
    fn loss(self) -> &'static str {
        match self {
            Self::Draws | Self::Update => "most of the loss is at the edges, which are added twice",
            Self::Cells => "most of the loss is threads without a cell to work on",
            Self::Memory => "most of the loss is waiting for memory",
            Self::Packing => "most of the loss is packing halos",
            Self::Messages => "most of the loss is the latency of messages",
            Self::Bandwidth => "most of the loss is bytes on the network",
            Self::Rounds => "most of the loss is the cost of starting threads on a round",
            Self::Sharing => "most of the loss is waiting for cores",
        }
    }
}

impl fmt::Display for Scaling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { machine, cluster, .. } = self;
        let Cluster { network, memory, threads, .. } = cluster;
        writeln!(f, "machine   {}, {} cores, {}", machine.processor, machine.cores, self.simd)?;
        writeln!(
            f,
            "a rank    {threads} threads, {:.0} MB of cache, {:.1} GB/s to memory; messages of \
             {:.2} us and {:.2} GB/s",
            memory.cache / 1e6,
            memory.bandwidth / 1e9,
            network.latency * 1e6,
            network.bandwidth / 1e9
        )?;
        self.tiles.iter().try_for_each(|tile| write!(f, "\n{tile}"))?;
        writeln!(
            f,
            "\n* more than the {} cores of this machine: extrapolated. Costs are those of one \
             thread here; the allreduce\n  is what a cluster without regions would send.",
            machine.cores
        )
    }
}

impl fmt::Display for TileScaling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Measured { shape, load, costs, check } = &self.measured;
        writeln!(f, "tile      {}; {}", self.shape, self.kernel)?;
        writeln!(f, "draws     {} of {:.1} samples on average", self.draws, load.samples)?;
        writeln!(
            f,
            "costs     {:.2} ns for each sample of a draw, {:.2} for each coordinate, {:.2} for \
             each word of a patch;",
            costs.sample * 1e9,
            costs.coordinate * 1e9,
            costs.patch_word * 1e9
        )?;
        writeln!(
            f,
            "          {:.2} to pack and {:.2} to unpack a byte; {:.1} us for each round",
            costs.packed_byte * 1e9,
            costs.unpacked_byte * 1e9,
            costs.round * 1e6
        )?;
        let Check { threads, predicted, measured } = check;
        writeln!(
            f,
            "measured  on {shape}; its step by {threads} threads here takes {:.0} us, predicted {:.0}",
            measured * 1e6,
            predicted * 1e6
        )?;
        let each = |side: usize| side.min(EACH);
        let [width, height] = [each(self.shape.width()), each(self.shape.height())];
        writeln!(f, "\nthe same tile by more ranks\n{}", self.strong)?;
        write!(f, "a tile that grows, {width}x{height} pixels for each rank\n{}", self.weak)
    }
}

impl fmt::Display for ScalingTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:>6}  {:>9} {:>11} {:>9} {:>10} {:>10} {:>13} {:>10}  bound by",
            "ranks",
            if self.grows { "tile" } else { "region" },
            "step us",
            "speed-up",
            "efficiency",
            "halo KB",
            "allreduce KB",
            "memory MB"
        )?;
        for row in &self.rows {
            let mark = if row.extrapolated { '*' } else { ' ' };
            write!(f, "{:>6}{mark} ", row.ranks)?;
            let Some(Step { prediction, speedup, efficiency }) = &row.step else {
                writeln!(f, "{:>9}", "no more cells")?;
                continue;
            };
            let [width, height] = if self.grows {
                [row.shape.width(), row.shape.height()]
            } else {
                prediction.region
            };
            writeln!(
                f,
                "{:>9} {:>11.1} {speedup:>9.2} {:>8.1} % {:>10.1} {:>13.0} {:>10.1}  {}",
                format!("{width}x{height}"),
                prediction.seconds * 1e6,
                100.0 * efficiency,
                prediction.halo_bytes as f64 / 1e3,
                prediction.allreduce_bytes / 1e3,
                prediction.memory_bytes as f64 / 1e6,
                prediction.bound.name()
            )?;
        }
        writeln!(f, "{}", self.end())
    }
}
