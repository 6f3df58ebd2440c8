//! A run from its start to its tile: descent, polish, uniformity step.

use std::time::Instant;

use perceptile_cluster::World;

use crate::draw::{Draws, LevelSets};
use crate::gradient::simd::Simd;
use crate::gradient::{Gradient, Quantum};
use crate::kernel::Kernel;
use crate::run::observer::{Observer, Progress};
use crate::solver::polish::Polish;
use crate::solver::{
    CellSamples, Descent, Options, OptionsError, Phase, Start, StopReason, Summary, start, warp,
};
use crate::tile::{Partition, Tile};

/// Makes a tile.
///
/// `start` is the tile to start from, if the options say so. The same options give the same tile
/// on every machine, with every number of threads and every instruction set.
///
/// # Errors
/// Options outside their ranges, a kernel that does not fit, or a starting tile that does not.
pub fn optimize(
    options: &Options,
    start: Option<&Tile>,
    simd: Simd,
    observer: &mut dyn Observer,
) -> Result<(Tile, Summary), OptionsError> {
    options.validate()?;
    let mut clock = Clock::default();
    let mut run = clock.time(Phase::Start, || Run::new(options, start, simd))?;
    observer.progress(Progress { phase: Phase::Start, done: 1, of: 1, objective: None });
    clock.time(Phase::Descent, || run.descend(observer))?;
    clock.time(Phase::Polish, || run.polish(observer));
    clock.time(Phase::Warp, || {
        let dims = options.shape.dims();
        warp::warp(&mut run.samples, dims, options.warp, options.seed, run.world, simd);
    });
    let summary = Summary {
        reason: run.reason.unwrap_or(StopReason::Completed),
        steps: run.steps,
        objective_before: run.before.mean(),
        objective_after: run.after.mean(),
        seconds: clock.seconds,
    };
    Ok((run.samples.to_tile(&run.partition), summary))
}

/// What the phases of a run share.
struct Run<'a> {
    options: &'a Options,
    kernel: Kernel,
    world: World,
    simd: Simd,
    partition: Partition,
    samples: CellSamples,
    /// Steps done, of descent and polish together.
    steps: u32,
    reason: Option<StopReason>,
    before: Window,
    after: Window,
}

impl<'a> Run<'a> {
    fn new(options: &'a Options, start: Option<&Tile>, simd: Simd) -> Result<Self, OptionsError> {
        let world = World::Local;
        let kernel = options.kernel.resolve(options.shape)?;
        options.check_kernel(&kernel)?;
        let partition = Partition::new(options.shape, levels(&kernel).reach(), world.size());
        let samples = match (options.start, start) {
            (Start::Random, None) => start::random(&partition, options.seed, world),
            (Start::Stratified, None) => start::stratified(&partition, options.seed, world),
            (Start::Tile, Some(tile)) if tile.shape() == options.shape => {
                CellSamples::from_tile(tile, &partition)
            }
            (Start::Tile, Some(tile)) => {
                return Err(OptionsError::Start { expected: options.shape, found: tile.shape() });
            }
            _ => return Err(OptionsError::StartMissing),
        };
        Ok(Self {
            options,
            kernel,
            world,
            simd,
            partition,
            samples,
            steps: 0,
            reason: None,
            before: Window::default(),
            after: Window::default(),
        })
    }

    /// Whether there is to be another step.
    fn goes_on(&mut self, observer: &dyn Observer) -> bool {
        if self.reason.is_none() {
            let limit = self.options.stop_after.is_some_and(|limit| self.steps >= limit);
            self.reason = if limit { Some(StopReason::StopAfter) } else { observer.stop() };
        }
        self.reason.is_none()
    }

    fn descend(&mut self, observer: &mut dyn Observer) -> Result<(), OptionsError> {
        let options = self.options;
        let draws =
            Draws::new(options.draw, options.seed, levels(&self.kernel), options.shape.dims());
        let quantum = Quantum::new(&draws, &self.partition).ok_or(OptionsError::Batch {
            draws: options.draw.draws,
            directions: options.draw.directions,
        })?;
        if options.steps == 0 {
            return Ok(());
        }
        let gradient = Gradient::new(draws, self.partition.clone(), quantum, self.simd);
        let (adam, steps) = (options.adam, options.steps);
        let mut descent = Descent::new(self.world, gradient, adam, steps, self.simd, &self.samples);
        while self.steps < steps && self.goes_on(observer) {
            let (_, objective) = descent.step(self.steps);
            self.steps += 1;
            let mean = objective.mean();
            if self.before.values.len() < Summary::WINDOW {
                self.before.push(mean);
            }
            self.after.push(mean);
            observer.progress(Progress {
                phase: Phase::Descent,
                done: self.steps,
                of: steps,
                objective: self.after.mean(),
            });
        }
        self.samples = descent.samples();
        Ok(())
    }

    fn polish(&mut self, observer: &mut dyn Observer) {
        let options = self.options.polish;
        if options.steps == 0 || !self.goes_on(observer) {
            return;
        }
        let classes = self.kernel.classes();
        let classes: Vec<_> = classes.iter().map(|class| (class.weight, &class.taps)).collect();
        let mut polish = Polish::new(&self.partition, &classes, options, self.simd, &self.samples);
        for step in 0..options.steps {
            if !self.goes_on(observer) {
                break;
            }
            polish.step(step);
            self.steps += 1;
            observer.progress(Progress {
                phase: Phase::Polish,
                done: step + 1,
                of: options.steps,
                objective: None,
            });
        }
        self.samples = polish.samples();
    }
}

/// The level sets of all classes of a kernel.
pub(crate) fn levels(kernel: &Kernel) -> LevelSets {
    LevelSets::new(kernel.classes().iter().map(|class| (class.weight, &class.taps)))
}

/// The last few values of the objective.
#[derive(Debug, Default)]
struct Window {
    values: std::collections::VecDeque<f64>,
}

impl Window {
    fn push(&mut self, value: f64) {
        if self.values.len() == Summary::WINDOW {
            self.values.pop_front();
        }
        self.values.push_back(value);
    }

    fn mean(&self) -> Option<f64> {
        (!self.values.is_empty())
            .then(|| self.values.iter().sum::<f64>() / self.values.len() as f64)
    }
}

/// Seconds of each phase.
#[derive(Debug, Default)]
struct Clock {
    seconds: Vec<(Phase, f64)>,
}

impl Clock {
    fn time<T>(&mut self, phase: Phase, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.seconds.push((phase, start.elapsed().as_secs_f64()));
        result
    }
}
