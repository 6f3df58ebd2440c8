//! Making a tile in a few lines: the front door of the library.
//!
//! An [`Optimizer`] holds a preset and what is changed of it. Whatever else a run needs has a
//! default here that suits a program which wants a tile: the threads of the current pool, the best
//! instructions of the machine, no files, and nobody who watches. The command takes the same way
//! through [`run`](crate::run), with checkpoints, workers and ranks besides, so that the same
//! options give the same bytes.

use std::fmt;

use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use thiserror::Error;

use crate::domain::Domain;
use crate::gradient::simd::Simd;
use crate::kernel::{KernelSpec, Viewing};
use crate::metric::{ScoreError, ScoreOptions, Scores};
use crate::run::driver::{self, Parallel};
use crate::run::error::RunError;
use crate::run::memory::{self, MemoryError};
use crate::run::observer::{Observer, Progress};
use crate::run::plan::Plan;
use crate::run::start::InitialState;
use crate::solver::{Options, OptionsError, Parallelism, Preset, Start, StopReason, Summary};
use crate::tile::{ShapeError, Tile, TileShape};

/// Why there is no tile.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OptimizeError {
    /// No tile has this size.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// Options that cannot be run, or not with this kernel, [`Viewing`] or start.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The run does not fit into the memory that is free.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The system does not give the threads.
    #[error("{threads} threads cannot be had: {error}")]
    Threads {
        /// How many were asked for.
        threads: usize,
        /// What the system says.
        error: ThreadPoolBuildError,
    },
    /// The run failed.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Makes a tile: a preset, some changes, [`run`](Self::run).
///
/// The same options give the same tile on every machine and with any number of threads, the same
/// bytes as those of the command `perceptile optimize` with flags that say the same. Methods may be
/// called in any order; of two calls of one, or of [`kernel`](Self::kernel) and
/// [`viewing`](Self::viewing), the last one counts. Numbers are checked when the run starts.
///
/// ```
/// use perceptile::{Optimizer, Preset, Viewing};
///
/// let run = Optimizer::new(Preset::Quick)
///     .size(16, 16, 8)
///     .viewing(Viewing { fps: 120.0, taa: Some(0.1), ..Viewing::default() })
///     .steps(20)
///     .observe(|progress| progress.done < 10)
///     .run()?;
/// assert_eq!(run.summary().steps, 10);
/// # Ok::<(), perceptile::OptimizeError>(())
/// ```
#[must_use = "nothing is made until it runs"]
pub struct Optimizer<'a> {
    /// All but the shape, and what depends on it.
    options: Options,
    size: [usize; 3],
    spp: usize,
    dims: usize,
    viewing: Option<Viewing>,
    /// Steps of the descent, if neither preset nor viewing decides.
    steps: Option<u32>,
    /// Steps of the polish, if the shape does not decide.
    polish: Option<u32>,
    start: Option<Tile>,
    threads: Option<usize>,
    observe: Box<dyn FnMut(Progress) -> bool + Send + 'a>,
}

impl Default for Optimizer<'_> {
    /// What the command makes without flags: [`Preset::Best`].
    fn default() -> Self {
        Self::new(Preset::Best)
    }
}

/// With options of one's own, such as those of a preset with changes that have no method here.
/// [`Start::Tile`] needs a tile from [`start_from`](Optimizer::start_from).
impl From<Options> for Optimizer<'_> {
    fn from(options: Options) -> Self {
        let shape = options.shape;
        Self {
            size: [shape.width(), shape.height(), shape.frames()],
            spp: shape.spp(),
            dims: shape.dims(),
            viewing: None,
            steps: None,
            polish: Some(options.polish.steps),
            options,
            start: None,
            threads: None,
            observe: Box::new(|_| true),
        }
    }
}

impl<'a> Optimizer<'a> {
    /// Starts with a preset.
    pub fn new(preset: Preset) -> Self {
        Self { polish: None, ..Self::from(preset.options()) }
    }

    /// Pixels across, pixels down, and frames, each 1 to 2²⁰.
    pub fn size(self, width: usize, height: usize, frames: usize) -> Self {
        Self { size: [width, height, frames], ..self }
    }

    /// Samples per pixel, 1 to 64.
    pub fn spp(self, spp: usize) -> Self {
        Self { spp, ..self }
    }

    /// Dimensions of a sample, 1 to 16.
    pub fn dims(self, dims: usize) -> Self {
        Self { dims, ..self }
    }

    /// Where samples live, and as many dimensions as its points have: of a circle, sphere and so on of
    /// radius ½ around ½. Without this call it is the square.
    ///
    /// ```
    /// use perceptile::domain::Domain;
    /// use perceptile::{Optimizer, Preset};
    ///
    /// let run = Optimizer::new(Preset::Quick).domain(Domain::Sphere).size(8, 8, 8).steps(20).run()?;
    /// let direction: Vec<f32> = run.tile().point(1, 2, 3, 0).iter().map(|x| 2.0 * x - 1.0).collect();
    /// let length = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
    /// assert!((length - 1.0).abs() < 1e-6);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// A density on the square comes from a picture, by `"density(star.png)".parse::<Domain>()`, or from
    /// levels:
    ///
    /// ```
    /// use perceptile::domain::{Density, Domain};
    /// use perceptile::{Optimizer, Preset};
    ///
    /// // Three quarters of all samples to the right, and none at the bottom.
    /// let levels = [1.0, 3.0, 0.0, 0.0];
    /// let density = Density::new("corner", [2, 2], &levels)?;
    /// let optimizer = Optimizer::new(Preset::Quick).domain(Domain::Density(density));
    /// let run = optimizer.size(8, 8, 8).steps(20).run()?;
    /// assert!(run.tile().samples().chunks(2).all(|point| point[1] < 0.5));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn domain(mut self, domain: Domain) -> Self {
        self.options.domain = domain;
        Self { dims: domain.dims().unwrap_or(self.dims), ..self }
    }

    /// The filter through which error is seen, for example from text:
    /// `"gaussian(2.1) * fovvideovdp(60) @ 7x7x8".parse()?`.
    pub fn kernel(mut self, kernel: KernelSpec) -> Self {
        self.options.kernel = kernel;
        Self { viewing: None, ..self }
    }

    /// The filter that follows from how the animation is watched, with steps that take as long as the
    /// preset's: [`Options::watched`].
    pub fn viewing(self, viewing: Viewing) -> Self {
        Self { viewing: Some(viewing), ..self }
    }

    /// Steps of stochastic gradient descent; more are better and take longer.
    pub fn steps(self, steps: u32) -> Self {
        Self { steps: Some(steps), ..self }
    }

    /// Steps of the polish that follows. Without this call they are the preset's for one sample
    /// per pixel in two dimensions, and else 0 ([`Options::with_shape`]); fewer, if there are fewer
    /// steps before it ([`Options::with_steps`]).
    pub fn polish(self, steps: u32) -> Self {
        Self { polish: Some(steps), ..self }
    }

    /// What all random numbers depend on: another seed gives another tile that is as good.
    pub fn seed(mut self, seed: u64) -> Self {
        self.options.seed = seed;
        self
    }

    /// Starts from a tile, of the same shape, instead of random samples.
    pub fn start_from(mut self, tile: Tile) -> Self {
        self.options.start = Start::Tile;
        Self { start: Some(tile), ..self }
    }

    /// Takes threads of its own, at least 1. Without this call the run takes those of the current
    /// `rayon` pool, which are as many as the machine has cores unless the program says otherwise.
    pub fn threads(self, threads: usize) -> Self {
        Self { threads: Some(threads.max(1)), ..self }
    }

    /// Calls `observe` after every step, on the thread that runs, with where the run stands. It
    /// returns whether to go on. If not, the run ends with the tile so far, which it makes uniform
    /// before, and with [`StopReason::Interrupted`].
    pub fn observe(self, observe: impl FnMut(Progress) -> bool + Send + 'a) -> Self {
        Self { observe: Box::new(observe), ..self }
    }

    /// What the run will do.
    ///
    /// # Errors
    /// A size that no tile has, and a number of the [`Viewing`] outside its range.
    pub fn options(&self) -> Result<Options, OptimizeError> {
        let [width, height, frames] = self.size;
        let shape = TileShape::new(width, height, frames, self.spp, self.dims)?;
        let mut options = self.options.clone().with_shape(shape);
        if let Some(steps) = self.steps {
            options = options.with_steps(steps);
        }
        if let Some(viewing) = self.viewing {
            options = options.watched(viewing)?;
        }
        options.steps = self.steps.unwrap_or(options.steps);
        options.polish.steps = self.polish.unwrap_or(options.polish.steps);
        Ok(options)
    }

    /// Makes the tile.
    ///
    /// # Errors
    /// Any [`OptimizeError`]. All but [`OptimizeError::Run`] come before the first step.
    pub fn run(self) -> Result<Run, OptimizeError> {
        let options = self.options()?;
        let Self { start, threads, observe, .. } = self;
        let mut observer = Observing { observe, goes_on: true };
        let work = || make(options, start.as_ref(), &mut observer);
        match threads {
            Some(threads) => {
                let pool = ThreadPoolBuilder::new().num_threads(threads).build();
                let pool = pool.map_err(|error| OptimizeError::Threads { threads, error })?;
                pool.install(work)
            }
            None => work(),
        }
    }
}

impl fmt::Debug for Optimizer<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Optimizer").field("options", &self.options()).finish_non_exhaustive()
    }
}

/// Makes a tile by the threads of the current pool.
fn make(
    options: Options,
    start: Option<&Tile>,
    observer: &mut Observing<'_>,
) -> Result<Run, OptimizeError> {
    let plan = Plan::new(&options, Parallelism::threads())?;
    memory::check(&plan)?;
    plan.check_batch()?;
    let start = InitialState::new(&plan, start)?;
    let output = driver::run(&plan, start, Simd::detect(), Parallel::Threads, observer, None)?;
    Ok(Run { tile: output.tile(), summary: output.summary, options })
}

/// Somebody who watches by a closure.
struct Observing<'a> {
    observe: Box<dyn FnMut(Progress) -> bool + Send + 'a>,
    goes_on: bool,
}

impl Observer for Observing<'_> {
    fn progress(&mut self, progress: Progress) {
        self.goes_on = self.goes_on && (self.observe)(progress);
    }

    /// Only checkpoints and worker processes have something to report, and there are none.
    fn report(&mut self, _: &str) {}

    fn stop(&self) -> Option<StopReason> {
        (!self.goes_on).then_some(StopReason::Interrupted)
    }
}

/// A run that is over: its tile, and how it came about.
#[derive(Debug, Clone)]
pub struct Run {
    tile: Tile,
    summary: Summary,
    options: Options,
}

impl Run {
    /// The tile.
    pub fn tile(&self) -> &Tile {
        &self.tile
    }

    /// The tile, by value.
    pub fn into_tile(self) -> Tile {
        self.tile
    }

    /// Why the run ended, how far it came, and how long it took.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// What was run.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The tile's scores, as [`Tile::scores`] has them, through what the run's kernel is made for
    /// ([`KernelSpec::perceived`]).
    ///
    /// # Errors
    /// A kernel from a file that can no longer be read.
    pub fn scores(&self) -> Result<Scores, ScoreError> {
        let shape = self.tile.shape();
        let kernel = self.options.kernel.perceived(shape).resolve(shape)?;
        let options = ScoreOptions { domain: self.options.domain, ..ScoreOptions::default() };
        Scores::of(&self.tile, &kernel.classes()[0].taps, options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> Optimizer<'static> {
        Optimizer::new(Preset::Quick).size(16, 16, 8).steps(6).polish(2).seed(3)
    }

    #[test]
    fn changes_may_come_in_any_order() {
        let kernel: KernelSpec = "gaussian(1) @ 3x3x1".parse().unwrap();
        let options = small().kernel(kernel.clone()).dims(3).options().unwrap();
        let again = Optimizer::new(Preset::Quick).dims(3).seed(3).polish(2).steps(6);
        let again = again.viewing(Viewing::default()).kernel(kernel).size(16, 16, 8);
        assert_eq!(again.options().unwrap(), options);
        assert_eq!((options.steps, options.polish.steps, options.seed), (6, 2, 3));
        assert_eq!(options.shape, TileShape::new(16, 16, 8, 1, 3).unwrap());
        assert_eq!(Optimizer::default().options().unwrap(), Preset::Best.options());
    }

    #[test]
    fn the_shape_decides_about_the_polish_unless_somebody_does() {
        let quick = || Optimizer::new(Preset::Quick);
        let polish = |optimizer: Optimizer| optimizer.options().unwrap().polish.steps;
        assert_eq!(polish(quick()), 30);
        assert_eq!([polish(quick().spp(2)), polish(quick().dims(3))], [15, 0]);
        assert_eq!([polish(quick().spp(2).polish(4)), polish(quick().polish(4).dims(1))], [4, 4]);
        let own = Preset::Quick.options();
        assert_eq!(polish(Optimizer::from(own).spp(2)), 30);
    }

    #[test]
    fn a_viewing_makes_the_kernel_of_the_tile() {
        let viewing = Viewing { fps: 120.0, taa: Some(0.1), ..Viewing::default() };
        let options = small().viewing(viewing).size(16, 16, 30).options().unwrap();
        assert_eq!(options.kernel, viewing.kernel(options.shape).unwrap());
        let wrong = small().viewing(Viewing { fps: 1.0, ..viewing }).run().unwrap_err();
        assert!(matches!(wrong, OptimizeError::Options(OptionsError::Viewing(_))), "{wrong}");
    }

    #[test]
    fn an_observer_sees_every_step_and_may_end_the_run() {
        let mut seen = Vec::new();
        let run = small().observe(|progress| {
            seen.push(progress.done);
            seen.len() < 4
        });
        let run = run.run().unwrap();
        assert_eq!(seen, [1, 2, 3, 4]);
        assert_eq!((run.summary().reason, run.summary().steps), (StopReason::Interrupted, 4));
        let mut options = run.options().clone();
        options.stop_after = Some(4);
        assert_eq!(Optimizer::from(options).run().unwrap().tile(), run.tile());
    }

    #[test]
    fn threads_leave_no_trace_and_a_tile_is_a_start() {
        let run = small().run().unwrap();
        assert_eq!(run.summary().reason, StopReason::Completed);
        assert_eq!(small().threads(3).run().unwrap().tile(), run.tile());
        let scores = run.scores().unwrap();
        assert_eq!(scores, run.tile().scores(&run.options().kernel).unwrap());
        let further = small().start_from(run.tile().clone()).run().unwrap();
        assert_ne!(further.tile(), run.tile());
        let other = small().size(16, 16, 4).start_from(run.into_tile()).run().unwrap_err();
        assert!(matches!(other, OptimizeError::Options(OptionsError::Start { .. })), "{other}");
    }

    #[test]
    fn what_cannot_be_run_is_refused() {
        let none = small().size(0, 16, 8).run().unwrap_err();
        assert_eq!(none.to_string(), "width is 0, but a tile needs at least 1");
        let mut options = Preset::Quick.options();
        options.draw.draws = 0;
        let draws = Optimizer::from(options).run().unwrap_err();
        assert!(draws.to_string().starts_with("draws is 0"), "{draws}");
    }

    // Elsewhere the system does not say how much memory is free.
    #[cfg(target_os = "linux")]
    #[test]
    fn what_memory_cannot_hold_is_refused_at_once() {
        let large = small().size(1 << 20, 1 << 20, 1 << 10).run().unwrap_err();
        assert!(matches!(large, OptimizeError::Memory(_)), "{large}");
    }
}
