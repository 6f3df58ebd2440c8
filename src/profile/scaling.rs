//! How long a step takes on a cluster that is not at hand: a model of [`crate::solver::Descent`]
//! with regions, from costs that are measured on this machine.
//!
//! A rank is a machine of T threads that owns a region of n pixels, of the N of the tile. Its step
//! is, in seconds, the sum of a [`Breakdown`]:
//!
//! | part | seconds |
//! |---|---|
//! | draws | D/(P T) draws · samples · directions · cost of a sample |
//! | update | (coordinates · cost of Adam + patch words · cost of adding one) / T |
//! | cells | what the slowest thread does more than that, because blocks and lines are whole |
//! | memory | what the bytes beyond the cache take longer than the threads |
//! | packing | bytes packed · cost / threads that pack + bytes unpacked · cost |
//! | messages, bandwidth | what is not hidden of messages · latency + bytes / bandwidth |
//! | rounds | rounds of jobs · cost of one without work: 4, or 2 where there are no others |
//! | sharing | what it takes longer if all ranks share fewer cores than they have threads |
//!
//! with D draws of a step and P ranks. Draws are dealt to cells by their pixels, so those of a
//! block are D · pixels / N. Threads take blocks, and lines in the update, in their order, each
//! when it is free; so a region with fewer cells than threads leaves threads idle. As in the
//! descent, the blocks at the edge come between two shares of those inside, one behind the other.
//! Samples are on their way during the first share and gradients during the second: what takes
//! longer than that is not hidden. Messages of an exchange go one after the other, and each of
//! the two exchanges is half of what [`HaloTraffic`] counts.
//!
//! A step goes through samples, moments and patches. What does not fit the caches of a rank goes
//! through its memory: 24 bytes for each coordinate and 8 for each word of a patch in the update,
//! and in each draw 12 for each number of its samples. Work and memory overlap, so the longer one
//! counts.
//!
//! At a pulse, every 0.1 s or every step if that is longer, all ranks reduce a few hundred bytes
//! twice: 2 ⌈log₂ P⌉ · latency.
//!
//! The step is that of the slowest rank. Up to [`ALL_RANKS`] ranks, all are looked at; of more,
//! [`LARGEST`] with the most pixels and [`OTHERS`] of the rest, evenly by number. Where all
//! regions are alike, as for powers of two on tiles that are powers of two, they also have the
//! same neighbours, and this is exact.
//!
//! It assumes that a rank's threads are as fast as one is alone, that the network lets messages on
//! while threads work and all ranks send at once, that cores of the cluster are like those of this
//! machine, and that nobody is late by chance. All of that makes it optimistic.

pub mod costs;
pub mod picture;
pub mod report;

use serde::Serialize;

use super::subject::WORD;
use crate::solver::{
    BLOCKS_PER_THREAD, HaloTraffic, Parallelism, ROWS_AT_A_TIME, StoragePlan, around,
};
use crate::tile::{Block, Partition, Piece, Regions, TooManyRanks};

/// Most ranks that are all looked at.
pub const ALL_RANKS: usize = 64;
/// Ranks with the most pixels that are looked at where there are more.
pub const LARGEST: usize = 24;
/// Other ranks that are looked at.
pub const OTHERS: usize = 24;

/// Bytes that go through memory in the update, for each coordinate and each word of a patch; and
/// in a draw, for each number of a sample.
const COORDINATE_BYTES: f64 = 24.0;
const PATCH_BYTES: f64 = 8.0;
const DRAW_BYTES: f64 = 12.0;

/// Seconds between two pulses, and what all ranks reduce in one.
const PULSE: f64 = 0.1;
const REDUCTIONS: f64 = 2.0;

/// What work costs, in seconds of one thread.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Costs {
    /// A sample of a draw, in one direction, with all that a draw does.
    pub sample: f64,
    /// Moving a coordinate.
    pub coordinate: f64,
    /// Adding a word of a patch.
    pub patch_word: f64,
    /// Packing a byte of a halo.
    pub packed_byte: f64,
    /// Taking a byte of a halo out of its message.
    pub unpacked_byte: f64,
    /// A round without work.
    pub round: f64,
}

/// What carries messages.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Network {
    /// Seconds that a message takes, however short it is.
    pub latency: f64,
    /// Bytes per second that a rank sends while it receives as many.
    pub bandwidth: f64,
}

/// What a rank has for its data.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RankMemory {
    /// Bytes that its caches hold.
    pub cache: f64,
    /// Bytes per second from and to memory, by all threads together.
    pub bandwidth: f64,
}

impl RankMemory {
    /// One that nobody waits for.
    pub const ENDLESS: Self = Self { cache: f64::INFINITY, bandwidth: f64::INFINITY };
}

/// The draws of a step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Load {
    /// Draws in all cells together.
    pub draws: f64,
    /// Samples of a mean draw.
    pub samples: f64,
    /// Directions of a draw.
    pub directions: f64,
}

/// Predicts steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Model {
    /// What work costs.
    pub costs: Costs,
    /// What carries messages.
    pub network: Network,
    /// What a rank has for its data.
    pub memory: RankMemory,
    /// Threads of a rank.
    pub threads: usize,
}

/// What the time of a step consists of, in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Breakdown {
    /// The draws, shared out evenly over all threads of all ranks.
    pub draws: f64,
    /// Adding up patches and moving samples, shared out evenly over the threads of a rank.
    pub update: f64,
    /// Threads that wait for others of their rank, and what the rank has more than its share.
    pub cells: f64,
    /// Threads that wait for memory.
    pub memory: f64,
    /// Packing and unpacking of halos.
    pub packing: f64,
    /// Latency that is not hidden.
    pub messages: f64,
    /// Bytes on the network that are not hidden.
    pub bandwidth: f64,
    /// Rounds of jobs.
    pub rounds: f64,
    /// Ranks that wait for each other's cores.
    pub sharing: f64,
}

impl Breakdown {
    /// All of them with what they are.
    pub fn all(&self) -> [(Bottleneck, f64); 9] {
        [
            (Bottleneck::Draws, self.draws),
            (Bottleneck::Update, self.update),
            (Bottleneck::Cells, self.cells),
            (Bottleneck::Memory, self.memory),
            (Bottleneck::Packing, self.packing),
            (Bottleneck::Messages, self.messages),
            (Bottleneck::Bandwidth, self.bandwidth),
            (Bottleneck::Rounds, self.rounds),
            (Bottleneck::Sharing, self.sharing),
        ]
    }

    /// The whole step.
    pub fn sum(&self) -> f64 {
        self.all().iter().map(|(_, seconds)| seconds).sum()
    }

    /// What keeps cores busy: all but waiting, and packing as if by one thread.
    fn work(&self, threads: f64) -> f64 {
        (self.draws + self.update) * threads + self.packing
    }

    /// What is done between messages.
    fn computing(&self) -> f64 {
        self.draws + self.update + self.cells + self.memory + self.packing
    }
}

/// What most of a step's time is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bottleneck {
    /// [`Breakdown::draws`]
    Draws,
    /// [`Breakdown::update`]
    Update,
    /// [`Breakdown::cells`]
    Cells,
    /// [`Breakdown::memory`]
    Memory,
    /// [`Breakdown::packing`]
    Packing,
    /// [`Breakdown::messages`]
    Messages,
    /// [`Breakdown::bandwidth`]
    Bandwidth,
    /// [`Breakdown::rounds`]
    Rounds,
    /// [`Breakdown::sharing`]
    Sharing,
}

impl Bottleneck {
    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Draws => "draws",
            Self::Update => "update",
            Self::Cells => "too few cells",
            Self::Memory => "memory",
            Self::Packing => "packing",
            Self::Messages => "messages",
            Self::Bandwidth => "bandwidth",
            Self::Rounds => "rounds",
            Self::Sharing => "shared cores",
        }
    }
}

/// The step of so many ranks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Prediction {
    /// Ranks.
    pub ranks: usize,
    /// Columns and rows of the slowest rank's region.
    pub region: [usize; 2],
    /// Seconds of a step.
    pub seconds: f64,
    /// What they consist of.
    pub parts: Breakdown,
    /// The largest part.
    pub bound: Bottleneck,
    /// Bytes of halos that the slowest rank sends in a step.
    pub halo_bytes: u64,
    /// Messages that they are.
    pub messages: u64,
    /// Bytes that each rank would send in a step that reduces the whole gradient around a ring.
    pub allreduce_bytes: f64,
    /// Bytes of memory of the slowest rank.
    pub memory_bytes: u64,
}

impl Model {
    /// A step by so many ranks, each on a machine of its own.
    ///
    /// # Errors
    /// If there are fewer cells.
    ///
    /// # Panics
    /// If there are no ranks.
    pub fn step(
        &self,
        partition: &Partition,
        load: &Load,
        ranks: usize,
    ) -> Result<Prediction, TooManyRanks> {
        let regions = partition.regions(ranks, 0)?;
        let all = looked_at(&regions).into_iter().map(|rank| {
            let regions = partition.regions(ranks, rank)?;
            Ok((self.rank(partition, load, &regions), regions))
        });
        let all: Vec<(Breakdown, Regions)> = all.collect::<Result<_, _>>()?;
        let slower =
            |a: &&(Breakdown, Regions), b: &&(Breakdown, Regions)| a.0.sum().total_cmp(&b.0.sum());
        let (mut parts, regions) = all.iter().max_by(slower).expect("a rank").clone();
        let depth = f64::from(usize::BITS - (ranks - 1).leading_zeros());
        let pulses = (parts.sum() / PULSE).min(1.0);
        parts.messages += pulses * REDUCTIONS * depth * self.network.latency;
        Ok(self.prediction(partition, &regions, parts))
    }

    /// A step by so many ranks that share the cores, the caches and the memory of one machine. The
    /// network is what carries their messages there.
    ///
    /// # Errors
    /// If there are fewer cells.
    ///
    /// # Panics
    /// If there are no ranks or no cores.
    pub fn predict_run(
        &self,
        partition: &Partition,
        load: &Load,
        ranks: usize,
        cores: usize,
    ) -> Result<Prediction, TooManyRanks> {
        assert!(cores > 0, "no cores");
        let share = 1.0 / ranks as f64;
        let memory = RankMemory {
            cache: self.memory.cache * share,
            bandwidth: self.memory.bandwidth * share,
        };
        let mut found = Self { memory, ..*self }.step(partition, load, ranks)?;
        let busy = found.parts.work(self.threads as f64) * ranks as f64 / cores as f64;
        found.parts.sharing = (busy - found.parts.computing()).max(0.0);
        found.seconds = found.parts.sum();
        found.bound = largest(&found.parts.all());
        Ok(found)
    }

    /// What surrounds the parts of a step.
    fn prediction(&self, partition: &Partition, regions: &Regions, parts: Breakdown) -> Prediction {
        let ranks = regions.all().len();
        let parallelism = Parallelism { ranks, workers: 0, threads: self.threads };
        let place = regions.own().place();
        let traffic = HaloTraffic::of(regions, partition.reach());
        let tile = WORD as f64 * partition.shape().coordinates() as f64;
        Prediction {
            ranks,
            region: [place.width, place.height],
            seconds: parts.sum(),
            parts,
            bound: largest(&parts.all()),
            halo_bytes: traffic.bytes,
            messages: traffic.messages,
            allreduce_bytes: 2.0 * (ranks - 1) as f64 / ranks as f64 * tile,
            memory_bytes: StoragePlan::new(partition, regions.own(), parallelism).bytes() as u64,
        }
    }

    /// The parts of one rank's step, pulses and the cores of others aside.
    fn rank(&self, partition: &Partition, load: &Load, regions: &Regions) -> Breakdown {
        let Self { costs, network, memory, threads } = *self;
        let (tile, region, reach) = (partition.shape(), regions.own(), partition.reach());
        let (shape, ranks) = (region.shape(), regions.all().len() as f64);
        let pixel = tile.spp() * tile.dims();
        let threads_f = threads as f64;
        let blocks = partition.blocks(region, threads.saturating_mul(BLOCKS_PER_THREAD));
        let (halo, lent) = (regions.halo(reach), regions.lent(reach));
        let has_others = ranks > 1.0;

        // Draws, in three rounds.
        let draw = load.samples * load.directions * costs.sample;
        let draws_of = |pixels: usize| load.draws * pixels as f64 / tile.pixels() as f64;
        let seconds = |block: &Block| draws_of(block.place().pixels(tile.frames())) * draw;
        let touches =
            |block: &Block| halo.iter().any(|piece| piece.seen.common(block.window()).is_some());
        let (blocks, edge) = around(blocks, touches);
        let round = |blocks: &[Block]| last(blocks.iter().map(seconds), threads);
        let shares = [&blocks[..edge.start], &blocks[edge.clone()], &blocks[edge.end..]];
        let [first, middle, second] = shares.map(round);
        let drawing = first + middle + second;
        let draws = load.draws * draw / (ranks * threads_f);

        // The update, in lines; patches that come from others are added, too.
        let coordinates = shape.coordinates() as f64;
        let own: usize = blocks.iter().map(Block::words).sum();
        let words = |pieces: &[Piece]| -> f64 {
            let pixels = pieces.iter().map(|piece| piece.pixels(tile.frames()));
            pixels.sum::<usize>() as f64 * pixel as f64
        };
        let patches = own as f64 + words(&lent);
        let update = (coordinates * costs.coordinate + patches * costs.patch_word) / threads_f;
        let lines = shape.height();
        let updating = update * ((lines.div_ceil(threads) * threads) as f64 / lines as f64);

        // What does not fit the caches.
        let kept = WORD as f64 * (3.0 * coordinates + patches);
        let missed = (1.0 - memory.cache / kept).max(0.0) / memory.bandwidth;
        let numbers = draws_of(shape.pixels()) * load.samples * tile.dims() as f64;
        let update_bytes = COORDINATE_BYTES * coordinates + PATCH_BYTES * patches;
        let waits = |bytes: f64, working: f64| (bytes * missed - working).max(0.0);

        // Halos: both are packed, and samples unpacked by one thread.
        let pack = |pieces: &[Piece]| {
            let rows: usize = pieces.iter().map(|piece| piece.seen.height * tile.frames()).sum();
            let packing = (rows / ROWS_AT_A_TIME).clamp(1, threads) as f64;
            WORD as f64 * words(pieces) * costs.packed_byte / packing
        };
        let unpacked = WORD as f64 * words(&halo) * costs.unpacked_byte;
        let packing = if has_others { pack(&halo) + pack(&lent) + unpacked } else { 0.0 };

        // Messages, behind the work of blocks inside.
        let traffic = HaloTraffic::of(regions, reach);
        let latency = traffic.messages as f64 / 2.0 * network.latency;
        let transfer = traffic.bytes as f64 / 2.0 / network.bandwidth;
        let shown: f64 =
            [first, second].map(|hides| (latency + transfer - hides).max(0.0)).iter().sum();
        let late = if shown > 0.0 { latency / (latency + transfer) } else { 0.0 };

        Breakdown {
            draws,
            update,
            cells: (drawing - draws).max(0.0) + (updating - update),
            memory: waits(DRAW_BYTES * numbers, drawing) + waits(update_bytes, updating),
            packing,
            messages: shown * late,
            bandwidth: shown * (1.0 - late),
            rounds: if has_others { 4.0 } else { 2.0 } * costs.round,
            sharing: 0.0,
        }
    }
}

/// What has the most seconds.
fn largest(parts: &[(Bottleneck, f64)]) -> Bottleneck {
    parts.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(Bottleneck::Draws, |&(bound, _)| bound)
}

/// When the last of some jobs is done, that threads take in their order.
fn last(jobs: impl Iterator<Item = f64>, threads: usize) -> f64 {
    let mut busy = vec![0.0_f64; threads.max(1)];
    for job in jobs {
        let first = busy.iter_mut().min_by(|a, b| a.total_cmp(b)).expect("a thread");
        *first += job;
    }
    busy.into_iter().fold(0.0, f64::max)
}

/// The ranks that may be the slowest.
fn looked_at(regions: &Regions) -> Vec<usize> {
    let ranks = regions.all().len();
    let mut all: Vec<usize> = (0..ranks).collect();
    if ranks > ALL_RANKS {
        let pixels = |&rank: &usize| std::cmp::Reverse(regions.all()[rank].shape().pixels());
        all.sort_by_key(pixels);
        let mut rest = all.split_off(LARGEST);
        rest.sort_unstable();
        all.extend((0..OTHERS).map(|i| rest[rest.len() * i / OTHERS]));
    }
    all
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::tile::{Cell, Reach, TileShape};

    const COSTS: Costs = Costs {
        sample: 5e-9,
        coordinate: 3e-10,
        patch_word: 1e-10,
        packed_byte: 2e-10,
        unpacked_byte: 1e-10,
        round: 1e-6,
    };
    const NETWORK: Network = Network { latency: 2e-6, bandwidth: 12.5e9 };
    const AT_ONCE: Network = Network { latency: 0.0, bandwidth: f64::INFINITY };
    const LOAD: Load = Load { draws: 4096.0, samples: 80.0, directions: 1.0 };
    const MODEL: Model =
        Model { costs: COSTS, network: NETWORK, memory: RankMemory::ENDLESS, threads: 16 };

    fn partition(width: usize, height: usize, reach: usize) -> Partition {
        let shape = TileShape::new(width, height, 30, 1, 2).unwrap();
        Partition::new(shape, Reach { left: reach, right: reach, up: reach, down: reach })
    }

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-9 * a.abs().max(b.abs()), "{a} and {b}");
    }

    #[test]
    fn one_rank_is_its_work_and_two_rounds() {
        let found = MODEL.step(&partition(128, 128, 3), &LOAD, 1).unwrap();
        // 64 blocks of a cell and 128 lines keep 16 threads busy to the end.
        let patches = 64.0 * 22.0 * 22.0 * 30.0 * 2.0;
        let update = 128.0 * 128.0 * 30.0 * 2.0 * 3e-10 + patches * 1e-10;
        close(found.seconds, (4096.0 * 80.0 * 5e-9 + update) / 16.0 + 2e-6);
        assert_eq!((found.halo_bytes, found.messages, found.allreduce_bytes), (0, 0, 0.0));
        assert_eq!((found.bound, found.region), (Bottleneck::Draws, [128, 128]));
    }

    #[test]
    fn a_cell_for_each_rank_is_one_threads_work_that_hides_nothing() {
        let found = MODEL.step(&partition(128, 128, 3), &LOAD, 64).unwrap();
        let draws = 64.0 * 80.0 * 5e-9;
        close(found.parts.draws + found.parts.cells, draws);
        let (halo, tile) = (22.0 * 22.0 - 256.0, 4.0 * 30.0 * 2.0);
        let received = halo * tile / 4.0;
        let patches = 22.0 * 22.0 * 60.0 + received;
        close(found.parts.update, (256.0 * 60.0 * 3e-10 + patches * 1e-10) / 16.0);
        // Eight neighbours, and in each exchange once around the cell.
        assert_eq!((found.messages, found.halo_bytes), (16, (2.0 * halo * tile) as u64));
        close(found.parts.bandwidth, 2.0 * halo * tile / 12.5e9);
        let pulses = 2.0 * 6.0 * 2e-6 * (found.seconds / PULSE);
        assert!((found.parts.messages - 2.0 * 8.0 * 2e-6 - pulses).abs() < 0.01 * pulses);
        // Eight pieces: four corners, above and below, and the sides.
        let rows: usize = 30 * (4 * 3 + 2 * 3 + 2 * 16);
        let packing = 2.0 * halo * tile * 2e-10 / (rows / 64).min(16) as f64;
        close(found.parts.packing, packing + halo * tile * 1e-10);
        close(found.parts.rounds, 4e-6);
        close(found.allreduce_bytes, 2.0 * 63.0 / 64.0 * 4.0 * 983_040.0);
        assert_eq!(found.parts.memory, 0.0);
    }

    #[test]
    fn memory_holds_up_what_the_caches_do_not_hold() {
        let partition = partition(128, 128, 3);
        let memory = RankMemory { cache: 0.0, bandwidth: 10e9 };
        let slow = Model { memory, ..MODEL }.step(&partition, &LOAD, 1).unwrap();
        let (coordinates, patches) = (983_040.0, 64.0 * 22.0 * 22.0 * 60.0);
        let update = (24.0 * coordinates + 8.0 * patches) / 10e9;
        let drawing = (4096.0 * 80.0 * 24.0_f64 / 10e9 - 4096.0 * 80.0 * 5e-9 / 16.0).max(0.0);
        close(slow.parts.memory, update - slow.parts.update + drawing);
        let kept = 4.0 * (3.0 * coordinates + patches);
        let half = RankMemory { cache: kept / 2.0, bandwidth: 1e9 };
        let half = Model { memory: half, ..MODEL }.step(&partition, &LOAD, 1).unwrap();
        let all = RankMemory { cache: 0.0, bandwidth: 2e9 };
        let all = Model { memory: all, ..MODEL }.step(&partition, &LOAD, 1).unwrap();
        close(half.seconds, all.seconds);
        let fits = RankMemory { cache: kept, bandwidth: 1e9 };
        let fits = Model { memory: fits, ..MODEL }.step(&partition, &LOAD, 1).unwrap();
        assert_eq!(fits.parts.memory, 0.0);
    }

    #[test]
    fn blocks_inside_hide_messages() {
        // 8 x 8 cells of a rank: 28 at the edge and 36 inside, 18 in each share.
        let (partition, load) = (partition(256, 256, 3), Load { draws: 16384.0, ..LOAD });
        let hidden = 2.0 * 64.0 * 80.0 * 5e-9;
        let with = |latency| {
            let network = Network { latency, ..AT_ONCE };
            Model { network, ..MODEL }.step(&partition, &load, 4).unwrap()
        };
        let found = with(0.0);
        close(found.parts.draws + found.parts.cells, 3.0 * hidden);
        // Three neighbours.
        assert_eq!((found.parts.messages, found.messages), (0.0, 6));
        let pulse = |found: &Prediction| 4.0 * found.seconds / PULSE;
        let short = hidden / 3.0 * 0.99;
        assert!((with(short).parts.messages / short - pulse(&with(short))).abs() < 1e-4);
        let long = with(hidden);
        assert!((long.parts.messages / hidden - 4.0 - pulse(&long)).abs() < 0.01);
    }

    #[test]
    fn halos_are_the_pixels_around_regions() {
        for (width, height, ranks) in [(128, 128, 2), (128, 128, 4), (96, 64, 6), (112, 80, 7)] {
            let partition = partition(width, height, 3);
            let regions = partition.regions(ranks, 0).unwrap();
            let owner = |x: i64, y: i64| {
                let [x, y] = [x.rem_euclid(width as i64), y.rem_euclid(height as i64)];
                let has = |Cell { x: left, y: top, width, height }: Cell| {
                    (left..left + width).contains(&(x as usize))
                        && (top..top + height).contains(&(y as usize))
                };
                regions.all().iter().position(|region| has(region.place())).unwrap()
            };
            let mut bytes = vec![0; ranks];
            for (rank, region) in regions.all().iter().enumerate() {
                let Cell { x, y, width: w, height: h } = region.place();
                for y in y as i64 - 3..(y + h) as i64 + 3 {
                    for x in x as i64 - 3..(x + w) as i64 + 3 {
                        let other = owner(x, y);
                        if other != rank {
                            // Samples there, gradients back.
                            bytes[other] += 4 * 30 * 2;
                            bytes[rank] += 4 * 30 * 2;
                        }
                    }
                }
            }
            let found = MODEL.step(&partition, &LOAD, ranks).unwrap();
            let of = |place: Cell| [place.width, place.height] == found.region;
            let like = (0..ranks).filter(|&rank| of(regions.all()[rank].place()));
            let like: Vec<u64> = like.map(|rank| bytes[rank]).collect();
            assert!(like.contains(&found.halo_bytes), "{ranks}: {} of {like:?}", found.halo_bytes);
        }
    }

    #[test]
    fn the_slowest_of_many_is_among_those_looked_at() {
        // Cells of many sizes, and no power of anything.
        let partition = partition(331, 277, 3);
        for ranks in [65, 100, 199, 250] {
            let found = MODEL.step(&partition, &LOAD, ranks).unwrap();
            let all = (0..ranks).map(|rank| {
                let regions = partition.regions(ranks, rank).unwrap();
                MODEL.rank(&partition, &LOAD, &regions).sum()
            });
            let slowest = all.fold(0.0, f64::max);
            assert!(found.seconds >= 0.97 * slowest, "{ranks}: {} of {slowest}", found.seconds);
        }
    }

    #[test]
    fn ranks_that_share_cores_take_turns() {
        let partition = partition(128, 128, 3);
        let model = Model { threads: 1, network: AT_ONCE, ..MODEL };
        let [one, two] = [1, 2].map(|ranks| model.step(&partition, &LOAD, ranks).unwrap());
        let on = |ranks, cores| model.predict_run(&partition, &LOAD, ranks, cores).unwrap();
        assert_eq!((on(1, 1), on(2, 2)), (one, two));
        let work = two.seconds - two.parts.rounds;
        close(on(2, 1).seconds, 2.0 * work + two.parts.rounds);
        close(on(2, 1).parts.sharing, work);
        // Memory is that of all of them.
        let memory = RankMemory { cache: 0.0, bandwidth: 1e9 };
        let model = Model { memory, ..model };
        let shared = model.predict_run(&partition, &LOAD, 2, 2).unwrap();
        let half = RankMemory { bandwidth: 5e8, ..memory };
        let apart = Model { memory: half, ..model }.step(&partition, &LOAD, 2).unwrap();
        assert_eq!(shared, apart);
    }

    #[test]
    fn threads_take_jobs_in_their_order() {
        assert_eq!(last([3.0, 1.0, 1.0, 1.0, 2.0].into_iter(), 2), 5.0);
        assert_eq!(last([1.0; 5].into_iter(), 3), 2.0);
        assert_eq!(last([1.0; 5].into_iter(), 1), 5.0);
        assert_eq!(last([].into_iter(), 4), 0.0);
    }

    proptest! {
        #[test]
        fn no_step_beats_its_work_and_slower_networks_are_slower(
            width in 16_usize..200, height in 16_usize..200, reach in 0_usize..6,
            ranks in 1_usize..80, threads in 1_usize..20,
            draws in 1.0..1e5_f64, latency in 0.0..1e-4_f64, bandwidth in 1e6..1e11_f64,
            cache in 0.0..1e8_f64, memory in 1e9..1e12_f64,
        ) {
            let partition = partition(width, height, reach);
            let ranks = ranks.min(partition.cells());
            let load = Load { draws, ..LOAD };
            let memory = RankMemory { cache, bandwidth: memory };
            let with = |network| {
                Model { network, memory, threads, ..MODEL }.step(&partition, &load, ranks).unwrap()
            };
            let found = with(Network { latency, bandwidth });
            let coordinates = partition.shape().coordinates() as f64;
            let work = draws * 80.0 * COSTS.sample
                + coordinates * (COSTS.coordinate + COSTS.patch_word);
            prop_assert!(found.seconds >= work / (ranks * threads) as f64 * (1.0 - 1e-9));
            prop_assert!(found.parts.all().iter().all(|(_, part)| *part >= 0.0));
            let later = with(Network { latency: latency * 1.5, bandwidth });
            let narrower = with(Network { latency, bandwidth: bandwidth / 1.5 });
            let most = found.seconds * (1.0 - 1e-12);
            prop_assert!(later.seconds >= most && narrower.seconds >= most);
            prop_assert!(MODEL.step(&partition, &load, partition.cells() + 1).is_err());
        }
    }
}
