//! A run from its start to its tile: one loop for threads, worker processes and ranks.
//!
//! The loop looks at the run between two steps: the observer hears where it stands, may stop it,
//! and a checkpoint is written when one is due. How steps are done, and who has to agree on what
//! is to happen, is what [`backend`](crate::run::backend)s differ in.

use std::cell::Cell;
use std::io;
use std::sync::Arc;
use std::time::Instant;

use perceptile_cluster::communicator::Communicator;
use perceptile_cluster::shared::Section;

use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::Simd;
#[cfg(unix)]
use crate::run::backend::workers::{self, WorkersOptions};
use crate::run::backend::{Backend, ranks, threads};
use crate::run::checkpointer::Checkpointer;
use crate::run::error::RunError;
use crate::run::gather;
use crate::run::observer::Observer;
use crate::run::plan::Plan;
use crate::run::start::InitialState;
use crate::run::summary::ParallelSummary;
use crate::run::watch::Watch;
use crate::solver::{Options, Parallelism, Phase, Summary};
use crate::tile::{Regions, Tile, TileShape};

/// Who does the steps of a run.
#[derive(Debug, Clone)]
pub enum Parallel {
    /// The threads of the current pool, in this process.
    Threads,
    /// Worker processes, which this process starts and looks after.
    #[cfg(unix)]
    Workers(WorkersOptions),
    /// Ranks that share no memory, of which this process is one.
    Ranks(Arc<dyn Communicator>),
}

/// What a run has made: its tile, of which each rank has its region.
#[derive(Debug)]
pub struct Output {
    /// How the run ended.
    pub summary: Summary,
    /// What threads, workers or ranks did.
    pub parallel: ParallelSummary,
    communicator: Arc<dyn Communicator>,
    regions: Regions,
    section: Section,
    gathered: Cell<bool>,
}

impl Output {
    /// The shape of the tile.
    pub fn shape(&self) -> TileShape {
        self.regions.own().tile()
    }

    /// Lets other ranks go on, which send their regions, if nobody has gathered the tile.
    pub fn discard(&self) {
        if !self.gathered.get() {
            // Nobody wants it, so nothing can go wrong with it.
            let _ = self.array(0, &mut |_: &[f32]| Ok(()));
        }
    }

    /// The whole tile at the root, put together with all ranks.
    ///
    /// # Panics
    /// On another rank than the root.
    pub fn tile(&self) -> Tile {
        assert_eq!(self.communicator.rank(), 0, "the root has the tile");
        let mut samples = Vec::with_capacity(self.shape().coordinates());
        let sink = &mut |piece: &[f32]| {
            samples.extend_from_slice(piece);
            Ok(())
        };
        self.array(0, sink).expect("memory takes all");
        Tile::new(self.shape(), samples).expect("samples in [0, 1), as many as the shape has")
    }
}

/// The tile, in C order. It is put together with all ranks; the root puts it into the sink.
impl ArraySource for Output {
    fn array(&self, _: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self.gathered.set(true);
        let own = &self.section.slice()[..self.regions.own().shape().coordinates()];
        gather::gather_tile(&*self.communicator, &self.regions, own, sink)
    }
}

/// Makes a tile by the threads of the current pool.
///
/// `start` is the tile to start from, if the options say so. The same options give the same tile
/// on every machine, with every number of threads and every instruction set.
///
/// # Errors
/// Options outside their ranges, a kernel that does not fit, a starting tile that does not, or
/// too little memory.
pub fn optimize(
    options: &Options,
    start: Option<&Tile>,
    simd: Simd,
    observer: &mut dyn Observer,
) -> Result<(Tile, Summary), RunError> {
    let plan = Plan::new(options, Parallelism::threads())?;
    plan.check_batch()?;
    let start = InitialState::new(&plan, start)?;
    let output = run(&plan, start, simd, Parallel::Threads, observer, None)?;
    Ok((output.tile(), output.summary))
}

/// Follows a plan from its start, and writes checkpoints if there is someone to keep them. On
/// several ranks, observer and checkpointer are the root's; other ranks' observers are asked for
/// signals only.
///
/// # Errors
/// If there is too little memory, if a checkpoint cannot be read again, if workers do not start, or
/// if too many are lost.
pub fn run(
    plan: &Plan,
    start: InitialState,
    simd: Simd,
    parallel: Parallel,
    observer: &mut dyn Observer,
    checkpointer: Option<&mut Checkpointer>,
) -> Result<Output, RunError> {
    let communicator = match &parallel {
        Parallel::Ranks(communicator) => Some(&**communicator),
        _ => None,
    };
    let since = Instant::now();
    let start = start.made(plan, simd, communicator, observer)?;
    let mut watch = Watch::new(since, plan, observer, checkpointer);
    match parallel {
        Parallel::Threads => drive(plan, threads::Threads::start(plan, start, simd)?, watch),
        #[cfg(unix)]
        Parallel::Workers(options) => {
            let workers = workers::Supervisor::start(plan, start, simd, options, &mut watch)?;
            drive(plan, workers, watch)
        }
        Parallel::Ranks(communicator) => {
            drive(plan, ranks::Ranks::start(plan, start, simd, communicator)?, watch)
        }
    }
}

/// Looks at a run between its steps until they are over.
fn drive(plan: &Plan, mut backend: impl Backend, mut watch: Watch<'_>) -> Result<Output, RunError> {
    let (worker, record) = backend.shared();
    let (worker, record) = (Arc::clone(worker), Arc::clone(record));
    let communicator = Arc::clone(worker.communicator());
    let recorded = || {
        let mut recorded = record.read();
        communicator.sum(&mut recorded.words);
        recorded
    };
    while let Some(at) = backend.position() {
        let decision = watch.look(at, &recorded(), backend.workers());
        let decision = backend.agree(at, decision, &watch);
        if let Some(reason) = decision.stop {
            watch.stops(reason);
        }
        if let Some(at) = backend.obey(at, decision) {
            if let Err(error) = watch.save(at, recorded(), &backend) {
                watch.report(&format!(
                    "warning: no checkpoint was written, so the run is NOT saved: {error}"
                ));
            }
            backend.release();
        }
        backend.advance(&mut watch)?;
    }
    if watch.gives_up() {
        return Err(RunError::GivenUp);
    }
    watch.enter(Phase::Warp);
    let (storage, parallel) = backend.finish();
    let Options { warp, domain, shape, .. } = &plan.options;
    let section = storage.into_tile(warp.all_frames(*domain, shape.dims()));
    let (reason, seconds) = watch.finish();
    let (steps, reason) = plan.outcome(&worker, reason);
    let descended = steps.min(plan.options.steps);
    let recorded = recorded();
    let [objective_before, objective_after] = recorded.means(descended);
    let convergence = recorded.curve(descended);
    let summary =
        Summary { reason, steps, objective_before, objective_after, convergence, seconds };
    let (regions, gathered) = (plan.regions(communicator.rank()), Cell::new(false));
    Ok(Output { summary, parallel, communicator, regions, section, gathered })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::observer::Progress;
    use crate::solver::{Preset, Start, StopReason};

    /// Stops after so many steps, and wants nothing of the run then.
    struct Impatient(u32);

    impl Observer for Impatient {
        fn progress(&mut self, _: Progress) {
            self.0 = self.0.saturating_sub(1);
        }

        fn stop(&self) -> Option<StopReason> {
            (self.0 == 0).then_some(StopReason::Interrupted)
        }

        fn gives_up(&self) -> bool {
            true
        }
    }

    #[test]
    fn a_run_that_is_given_up_has_no_tile() {
        let shape = TileShape::new(16, 16, 4, 2, 2).unwrap();
        for start in [Start::Random, Start::Nested] {
            let options = Preset::Quick.options().with_shape(shape).with_steps(20);
            let options = Options { start, ..options };
            let run = |steps| optimize(&options, None, Simd::detect(), &mut Impatient(steps));
            assert!(matches!(run(3), Err(RunError::GivenUp)), "{start:?}");
            // One that is over before is not given up.
            assert!(run(u32::MAX).is_ok());
        }
    }
}
