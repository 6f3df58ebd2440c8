//! A run by the ranks of a cluster, each with a region of the tile and threads of its own.
//!
//! Every rank carries out the same program. What depends on time, on signals or on files is the
//! same on all of them because it is decided at *pulses*, every so many steps: all ranks bring
//! forward what they know, and all get the same answer. The root has the files and the people to
//! deal with; to write the run down it gathers it, a few rows at a time.

use std::cell::Cell;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use perceptile_cluster::World;
use perceptile_cluster::peers::Peers;
use perceptile_cluster::shared::{Counter, Section};
use serde::Serialize;

use crate::format::numbers::Put;
use crate::gradient::simd::Simd;
use crate::run::begin::Begin;
use crate::run::keeper::Keeper;
use crate::run::memory;
use crate::run::observer::Observer;
use crate::run::phases::{Clock, progress, summary};
use crate::run::program::{Abandoned, Position, Program, ProgramError, Watch};
use crate::run::travel;
use crate::solver::{Phase, Record, Recorded, Snapshot, StopReason, Summary};
use crate::tile::{Cell as Place, Regions};

/// What the ranks of a run did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RanksSummary {
    /// Each of them.
    pub ranks: Vec<RankSummary>,
    /// The largest time of work against the mean.
    pub imbalance: f64,
}

/// What one rank did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RankSummary {
    /// Columns and rows of its region.
    pub size: [usize; 2],
    /// Seconds that its threads worked.
    pub busy: f64,
    /// Seconds that it waited for halos of others.
    pub waiting: f64,
    /// Bytes of halos that came from others.
    pub traffic: u64,
    /// The most memory that it had, in bytes; 0 where the system does not tell.
    pub peak: u64,
}

/// A tile in regions.
pub struct Made {
    peers: Arc<dyn Peers>,
    regions: Regions,
    section: Section,
    /// What the run tells.
    pub summary: Summary,
    /// What its ranks did.
    pub ranks: RanksSummary,
}

impl Made {
    /// Puts the tile together in C order, with all ranks; the root passes it on to `put`.
    ///
    /// # Errors
    /// What `put` reports.
    pub fn gather(&self, put: &mut Put<'_>) -> io::Result<()> {
        let own = &self.section.slice()[..self.regions.own().shape().coordinates()];
        travel::gather_tile(&*self.peers, &self.regions, own, put)
    }
}

/// Carries out a program as a rank of a cluster. The observer and the keeper are the root's; other
/// ranks' observers are asked for signals only.
///
/// # Errors
/// If there is too little memory, or what the run begins with cannot be read.
pub fn carry_out(
    program: &Program,
    begin: Begin,
    simd: Simd,
    peers: Arc<dyn Peers>,
    observer: &mut dyn Observer,
    keeper: Option<&mut Keeper>,
) -> Result<Made, ProgramError> {
    let mut clock = Clock::new();
    let regions = program.regions(peers.rank());
    let memory = program.storage(regions.own()).beside(Arc::clone(&peers));
    let mut failed = [i64::from(memory.is_err())];
    peers.max(&mut failed);
    let (world, mut storage) = memory?;
    if failed != [0] {
        return Err(ProgramError::Elsewhere);
    }
    begin.put(program, &world, &mut storage)?;
    let record = storage.record.clone();
    let mut watch = Pulses {
        program,
        regions: &regions,
        observer,
        keeper,
        record: &record,
        clock: &mut clock,
        reason: None,
        next: 0,
        interval: 1,
        last: Instant::now(),
    };
    let section = program.carry_out(&world, storage, simd, &mut watch)?;
    let reason = watch.reason;
    let recorded = all_ranks(&*peers, &record);
    let summary = summary(program, &world, &recorded, reason, clock.seconds());
    let ranks = ranks_summary(&world, &regions);
    Ok(Made { peers, regions, section, summary, ranks })
}

/// What all ranks recorded.
fn all_ranks(peers: &dyn Peers, record: &Record) -> Recorded {
    let mut recorded = record.read();
    peers.sum(&mut recorded.words);
    recorded
}

/// What the counters of all ranks say.
fn ranks_summary(world: &World, regions: &Regions) -> RanksSummary {
    const COUNTERS: [Counter; 3] = [Counter::Busy, Counter::Waiting, Counter::Traffic];
    const FIELDS: usize = COUNTERS.len() + 1;
    let peers = world.peers();
    let count = |counter| world.board().counter(0, counter).load(Ordering::Relaxed);
    let own = COUNTERS.map(count).into_iter().chain([memory::peak().unwrap_or(0)]);
    let mut counts = vec![0; peers.size() * FIELDS];
    let place = &mut counts[peers.rank() * FIELDS..];
    place.iter_mut().zip(own).for_each(|(place, value)| *place = value as i64);
    peers.sum(&mut counts);
    let rank = |(region, counts): (&crate::tile::Region, &[i64])| {
        let Place { width, height, .. } = region.place();
        RankSummary {
            size: [width, height],
            busy: counts[0] as f64 * 1e-9,
            waiting: counts[1] as f64 * 1e-9,
            traffic: counts[2] as u64,
            peak: counts[3] as u64,
        }
    };
    let ranks: Vec<_> = regions.all().iter().zip(counts.chunks_exact(FIELDS)).map(rank).collect();
    let mean = ranks.iter().map(|rank| rank.busy).sum::<f64>() / ranks.len() as f64;
    let most = ranks.iter().map(|rank| rank.busy).fold(0.0, f64::max);
    RanksSummary { ranks, imbalance: if mean > 0.0 { most / mean } else { 1.0 } }
}

/// How much time passes between two pulses: a run that is told to stop does so after that.
const PULSE: Duration = Duration::from_millis(100);

/// Watches the run together with all ranks.
struct Pulses<'a> {
    program: &'a Program,
    regions: &'a Regions,
    observer: &'a mut dyn Observer,
    keeper: Option<&'a mut Keeper>,
    record: &'a Record,
    clock: &'a mut Clock,
    reason: Option<StopReason>,
    /// The next pulse is before this step, counted over all phases, and the one after it so many
    /// steps later.
    next: u32,
    interval: u32,
    last: Instant,
}

impl Watch for Pulses<'_> {
    fn phase(&mut self, phase: Phase) {
        self.clock.begin(phase);
        // Steps of another phase take another time.
        (self.next, self.interval) = (0, 1);
    }

    fn before_step(
        &mut self,
        world: &World,
        at: Position,
        state: &dyn Snapshot,
    ) -> Result<(), Abandoned> {
        let done = self.program.steps_done(at);
        if done < self.next || self.reason.is_some() {
            return Ok(());
        }
        let peers = &**world.peers();
        let asked = match self.observer.stop() {
            None => 0,
            Some(StopReason::Time) => 1,
            Some(_) => 2,
        };
        let is_due = self.keeper.as_ref().is_some_and(|keeper| keeper.is_due(done));
        let mut known = [asked, i64::from(is_due), 0];
        if peers.rank() == 0 {
            known[2] = self.next_interval(done).into();
        }
        peers.max(&mut known);
        let [asked, is_due, interval] = known;
        self.interval = interval as u32;
        self.next = done.saturating_add(self.interval);
        if asked > 0 {
            self.reason = Some(if asked == 1 { StopReason::Time } else { StopReason::Interrupted });
            world.board().stop_here();
        }
        let recorded = all_ranks(peers, self.record);
        if at.step > 0 {
            self.observer.progress(progress(self.program, &recorded, at));
        }
        if asked > 0 || is_due > 0 {
            self.save(peers, at, recorded, state);
        }
        Ok(())
    }
}

impl Pulses<'_> {
    /// Steps until the pulse after this one, as the root's clock and keeper have it.
    fn next_interval(&mut self, done: u32) -> u32 {
        let passed = std::mem::replace(&mut self.last, Instant::now()).elapsed();
        let fits = PULSE.as_secs_f64() / passed.as_secs_f64().max(1e-9) * f64::from(self.interval);
        let steps = (fits as u32).clamp(1, self.interval.saturating_mul(2));
        let due = self.keeper.as_ref().and_then(|keeper| keeper.steps_until_due(done));
        due.map_or(steps, |due| steps.min(due.max(1)))
    }

    /// Writes a checkpoint at the root, of what all ranks have.
    fn save(&mut self, peers: &dyn Peers, at: Position, recorded: Recorded, state: &dyn Snapshot) {
        let gathered = Gathered { peers, regions: self.regions, state, done: Cell::new(0) };
        if let Some(keeper) = &mut self.keeper
            && let Err(error) = keeper.save(self.program, at, recorded, &gathered)
        {
            self.observer.tell(&format!("no checkpoint was written: {error}"));
        }
        gathered.rest();
    }
}

/// The state of all ranks together, as it is gathered at the root. Arrays are asked for in order.
struct Gathered<'a> {
    peers: &'a dyn Peers,
    regions: &'a Regions,
    state: &'a dyn Snapshot,
    /// Arrays that were gathered.
    done: Cell<usize>,
}

impl Gathered<'_> {
    /// Gathers the arrays that nobody asked for, as other ranks send them.
    fn rest(&self) {
        for index in self.done.get()..3 {
            // Nobody wants it, so nothing can go wrong with it.
            let _ = self.array(index, &mut |_| Ok(()));
        }
    }
}

impl Snapshot for Gathered<'_> {
    fn array(&self, index: usize, put: &mut Put<'_>) -> io::Result<()> {
        self.done.set(index + 1);
        let own = &mut |put: &mut Put<'_>| self.state.array(index, put);
        travel::gather(self.peers, self.regions, own, put)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::observer::Unobserved;
    use crate::run::phases;
    use crate::solver::{Options, Preset, Team};
    use crate::tile::TileShape;
    use perceptile_cluster::peers::Threads;
    use rayon::ThreadPoolBuilder;

    /// The tile that so many ranks of so many threads make.
    fn by_ranks(options: &Options, ranks: usize, threads: usize) -> Vec<f32> {
        let team = Team { ranks: 1, threads, regions: ranks, can_fail: false };
        let program = Program::new(options, team).unwrap();
        let run = |peers: Threads| {
            let peers: Arc<dyn Peers> = Arc::new(peers);
            let begin = Begin::new(&program, None).unwrap();
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let made = pool.install(|| {
                let simd = Simd::detect();
                carry_out(&program, begin, simd, peers, &mut Unobserved, None).unwrap()
            });
            let mut tile = Vec::new();
            let put = &mut |piece: &[f32]| {
                tile.extend_from_slice(piece);
                Ok(())
            };
            made.gather(put).unwrap();
            assert_eq!(made.ranks.ranks.len(), ranks);
            (tile, made.summary)
        };
        std::thread::scope(|scope| {
            let run = &run;
            let ranks: Vec<_> = Threads::group(ranks)
                .into_iter()
                .map(|peers| scope.spawn(move || run(peers)))
                .collect();
            let made: Vec<_> = ranks.into_iter().map(|rank| rank.join().unwrap()).collect();
            let summary = &made[0].1;
            assert!(made.iter().all(|(_, other)| {
                other.objective_after == summary.objective_after && other.steps == summary.steps
            }));
            made.into_iter().next().unwrap().0
        })
    }

    #[test]
    fn ranks_make_the_tile_of_one_process() {
        const FAR: &str = "0.7: gaussian(2.1) * fovvideovdp(60) @ 21x17x3 + 0.3: column";
        for (size, spp, dims, kernel) in [
            ([64, 64, 4], 1, 2, "gaussian(2.1) * fovvideovdp(60) @ 7x7x4"),
            ([97, 50, 3], 2, 3, "gaussian(1.5) @ 5x9x2"),
            // Kernels that see all around small tiles, and back to their own region.
            ([40, 36, 3], 1, 2, FAR),
            ([16, 80, 2], 1, 1, "gaussian(1) * ema(0.5) @ 3x3x2"),
        ] {
            let shape = TileShape::new(size[0], size[1], size[2], spp, dims).unwrap();
            let kernel = kernel.parse().unwrap();
            let mut options = Options { shape, kernel, ..Preset::Quick.options() };
            (options.steps, options.draw.draws) = (12, 300);
            (options.polish.steps, options.warp.frames) = (4, 5);
            let program = Program::new(&options, Team::alone()).unwrap();
            let cells = program.partition().cells();
            let (tile, _) =
                phases::optimize(&options, None, Simd::detect(), &mut Unobserved).unwrap();
            for (ranks, threads) in [(1, 2), (2, 1), (3, 1), (4, 2), (7, 1)] {
                let ranks: usize = std::cmp::min(ranks, cells);
                let found = by_ranks(&options, ranks, threads);
                assert!(found == tile.samples(), "{shape}: {ranks} ranks of {threads} threads");
            }
        }
    }
}
