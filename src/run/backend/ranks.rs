//! A run by ranks that share no memory, each with a region of the tile and threads of its own.
//!
//! Every rank does the same steps. What depends on time, on signals or on files is the same on all
//! of them because it is decided at *pulses*, every so many steps: all ranks bring forward what
//! they know, and all get the same answer. The root writes the files and speaks to people; for a
//! checkpoint it gathers the state of all ranks, a few rows at a time.

use std::cell::Cell;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use perceptile_cluster::Worker;
use perceptile_cluster::communicator::Communicator;
use perceptile_cluster::shared::Counter;

use super::Backend;
use super::threads::Threads;
use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::Simd;
use crate::run::error::RunError;
use crate::run::plan::{Plan, Position};
use crate::run::start::InitialState;
use crate::run::summary::{ParallelSummary, RankSummary, RanksSummary, imbalance};
use crate::run::watch::{Decision, Watch};
use crate::run::{gather, memory};
use crate::solver::{Record, StopReason, Storage};
use crate::tile::{Region, Regions};

/// How much time passes between two pulses: a run that is to stop does so after that.
const PULSE: Duration = Duration::from_millis(100);
/// Why ranks stop, by its number in what they send each other. The largest counts; what is none of
/// these is the last.
const REASONS: [Option<StopReason>; 3] =
    [None, Some(StopReason::Time), Some(StopReason::Interrupted)];

/// The ranks of a run, seen from one of them.
pub struct Ranks<'a> {
    plan: &'a Plan,
    communicator: Arc<dyn Communicator>,
    regions: Regions,
    /// What this rank does with its region.
    own: Threads<'a>,
    /// The next pulse is before this step, counted over all phases, and the one after it so many
    /// steps later.
    next: u32,
    interval: u32,
    last: Instant,
    /// Arrays of the state that were gathered for a checkpoint; they are asked for in order.
    gathered: Cell<usize>,
}

impl<'a> Ranks<'a> {
    /// Gets a run ready for its first step, with all ranks.
    ///
    /// # Errors
    /// If there is too little memory, or what the run starts from cannot be read.
    pub fn start(
        plan: &'a Plan,
        start: InitialState,
        simd: Simd,
        communicator: Arc<dyn Communicator>,
    ) -> Result<Self, RunError> {
        let regions = plan.regions(communicator.rank());
        let memory = plan.storage(regions.own()).beside(Arc::clone(&communicator));
        let mut failed = [i64::from(memory.is_err())];
        communicator.max(&mut failed);
        let memory = memory?;
        if failed != [0] {
            return Err(RunError::Elsewhere);
        }
        let own = Threads::on(memory, plan, start, simd)?;
        let (last, gathered) = (Instant::now(), Cell::new(0));
        Ok(Self { plan, communicator, regions, own, next: 0, interval: 1, last, gathered })
    }

    /// Steps until the pulse after this one, as the root's clock and checkpointer have it.
    fn next_interval(&mut self, due: Option<u32>) -> u32 {
        let passed = std::mem::replace(&mut self.last, Instant::now()).elapsed();
        let fits = PULSE.as_secs_f64() / passed.as_secs_f64().max(1e-9) * f64::from(self.interval);
        let steps = (fits as u32).clamp(1, self.interval.saturating_mul(2));
        due.map_or(steps, |due| steps.min(due.max(1)))
    }
}

impl ArraySource for Ranks<'_> {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self.gathered.set(index + 1);
        gather::gather(&*self.communicator, &self.regions, (&self.own, index), sink)
    }
}

impl Backend for Ranks<'_> {
    fn shared(&self) -> (&Arc<Worker>, &Arc<Record>) {
        self.own.shared()
    }

    fn position(&self) -> Option<Position> {
        self.own.position()
    }

    fn agree(&mut self, at: Position, own: Decision, watch: &Watch<'_>) -> Decision {
        let done = self.plan.steps_done(at);
        let asked = REASONS.iter().position(|reason| *reason == own.stop);
        let asked = asked.unwrap_or(REASONS.len() - 1) as i64;
        let mut known = [asked, i64::from(own.checkpoint), 0];
        if self.communicator.rank() == 0 {
            known[2] = self.next_interval(watch.steps_until_due(done)).into();
        }
        self.communicator.max(&mut known);
        let [asked, checkpoint, interval] = known;
        self.interval = interval as u32;
        self.next = done.saturating_add(self.interval);
        Decision { stop: REASONS[asked as usize], checkpoint: checkpoint > 0 }
    }

    fn obey(&mut self, at: Position, decision: Decision) -> Option<Position> {
        self.own.obey(at, decision)
    }

    fn release(&mut self) {
        // Other ranks send what nobody asked for, because there is no checkpointer or it failed.
        for index in self.gathered.get()..3 {
            // Nobody wants it, so nothing can go wrong with it.
            let _ = self.array(index, &mut |_: &[f32]| Ok(()));
        }
        self.gathered.set(0);
    }

    fn advance(&mut self, watch: &mut Watch<'_>) -> Result<(), RunError> {
        loop {
            let before = self.position().map(|at| at.phase);
            self.own.advance(watch)?;
            let Some(at) = self.position() else { return Ok(()) };
            if before != Some(at.phase) {
                // Steps of another phase take another time.
                (self.next, self.interval) = (0, 1);
            }
            if self.plan.steps_done(at) >= self.next {
                return Ok(());
            }
        }
    }

    fn finish(self) -> (Storage, ParallelSummary) {
        let worker = Arc::clone(self.shared().0);
        let (storage, _) = self.own.finish();
        (storage, ParallelSummary::Ranks(summary(&worker, &self.regions)))
    }
}

/// What the counters of all ranks say.
fn summary(worker: &Worker, regions: &Regions) -> RanksSummary {
    const COUNTERS: [Counter; 3] = [Counter::Busy, Counter::Waiting, Counter::Traffic];
    const FIELDS: usize = COUNTERS.len() + 1;
    let communicator = worker.communicator();
    let count = |counter| worker.board().counter(0, counter).load(Ordering::Relaxed);
    let own = COUNTERS.map(count).into_iter().chain([memory::peak().unwrap_or(0)]);
    let mut counts = vec![0; communicator.size() * FIELDS];
    let place = &mut counts[communicator.rank() * FIELDS..];
    place.iter_mut().zip(own).for_each(|(place, value)| *place = value as i64);
    communicator.sum(&mut counts);
    let rank = |(region, counts): (&Region, &[i64])| {
        let cell = region.place();
        RankSummary {
            size: [cell.width, cell.height],
            busy: counts[0] as f64 * 1e-9,
            waiting: counts[1] as f64 * 1e-9,
            traffic: counts[2] as u64,
            peak: counts[3] as u64,
        }
    };
    let ranks: Vec<_> = regions.all().iter().zip(counts.chunks_exact(FIELDS)).map(rank).collect();
    RanksSummary { imbalance: imbalance(ranks.iter().map(|rank| rank.busy)), ranks }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::driver::{self, Parallel};
    use crate::run::observer::Unobserved;
    use crate::solver::{Options, Parallelism, Preset, Start};
    use crate::tile::TileShape;
    use perceptile_cluster::communicator::InProcess;
    use rayon::ThreadPoolBuilder;

    /// The tile that so many ranks of so many threads make.
    fn by_ranks(options: &Options, ranks: usize, threads: usize) -> Vec<f32> {
        let parallelism = Parallelism { ranks, workers: 0, threads };
        let plan = Plan::new(options, parallelism).unwrap();
        let run = |communicator: InProcess| {
            let start = InitialState::new(&plan, None).unwrap();
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let output = pool.install(|| {
                let (simd, parallel) = (Simd::detect(), Parallel::Ranks(Arc::new(communicator)));
                driver::run(&plan, start, simd, parallel, &mut Unobserved, None).unwrap()
            });
            let mut tile = Vec::new();
            let sink = &mut |piece: &[f32]| {
                tile.extend_from_slice(piece);
                Ok(())
            };
            output.array(0, sink).unwrap();
            let ParallelSummary::Ranks(summary) = output.parallel else { panic!("ranks") };
            assert_eq!(summary.ranks.len(), ranks);
            (tile, output.summary)
        };
        std::thread::scope(|scope| {
            let run = &run;
            let ranks: Vec<_> = InProcess::group(ranks)
                .into_iter()
                .map(|communicator| scope.spawn(move || run(communicator)))
                .collect();
            let outputs: Vec<_> = ranks.into_iter().map(|rank| rank.join().unwrap()).collect();
            let summary = &outputs[0].1;
            assert!(outputs.iter().all(|(_, other)| {
                other.objective_after == summary.objective_after && other.steps == summary.steps
            }));
            outputs.into_iter().next().unwrap().0
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
            (
                [33, 34, 4],
                3,
                2,
                "0.8: gaussian(1) * box(2) * every(2) @ 5x5x2 of 1.. + 0.2: column",
            ),
        ] {
            let shape = TileShape::new(size[0], size[1], size[2], spp, dims).unwrap();
            let kernel = kernel.parse().unwrap();
            let mut options = Options { shape, kernel, ..Preset::Quick.options() };
            (options.steps, options.draw.draws) = (12, 300);
            (options.polish.steps, options.warp.frames) = (4, 5);
            if options.kernel.classes()[0].prefix.is_some() {
                options.start = Start::Nested;
            }
            let plan = Plan::new(&options, Parallelism::threads()).unwrap();
            let cells = plan.partition().cells();
            let (tile, _) =
                driver::optimize(&options, None, Simd::detect(), &mut Unobserved).unwrap();
            for (ranks, threads) in [(1, 2), (2, 1), (3, 1), (4, 2), (7, 1)] {
                let ranks: usize = std::cmp::min(ranks, cells);
                let found = by_ranks(&options, ranks, threads);
                assert!(found == tile.samples(), "{shape}: {ranks} ranks of {threads} threads");
            }
        }
    }
}
