//! How long a run will take: some steps of every phase, done and timed before it.
//!
//! No formula knows the machine, the kernel's subsets and who else computes here. The steps are those
//! of the run itself, from a random start, so what they cost is what it costs; those of a large tile are
//! done on a part of it.

use std::time::{Duration, Instant};

use crate::draw::DrawOptions;
use crate::gradient::simd::Simd;
use crate::run::driver::{self, Parallel};
use crate::run::error::RunError;
use crate::run::nested;
use crate::run::observer::{Observer, Progress};
use crate::run::plan::{Plan, Position};
use crate::run::start::InitialState;
use crate::solver::{Options, Parallelism, Phase, Start, StopReason};
use crate::tile::TileShape;

/// How long steps of the descent are timed.
const TIMED: Duration = Duration::from_millis(150);
/// Most steps of the polish that are done, of which all but the first are timed.
const POLISH_STEPS: u32 = 2;
/// Most frames of the warp that are timed.
const WARP_FRAMES: u32 = 8;

/// Most samples that steps are timed with. Those of a larger tile are timed on a part of it, whose blocks
/// cost what all blocks do: else a dry run of a large tile takes minutes.
const SAMPLES: usize = 1 << 20;
/// No side of a part is shorter, unless the tile's is.
const LEAST: usize = 64;

/// Foreseen seconds of each phase of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecast {
    /// The phases that the run has, in their order.
    pub seconds: Vec<(Phase, f64)>,
}

impl Forecast {
    /// Times a plan with the threads of the current pool; workers and ranks are taken to share the
    /// work evenly.
    ///
    /// # Errors
    /// As for the run itself.
    pub fn of(plan: &Plan, simd: Simd) -> Result<Self, RunError> {
        let options = &plan.options;
        let (mut timed, parts) = part(plan);
        timed.parallelism = Parallelism::threads();
        timed.from = Position::START;
        timed.options.stop_after = None;
        let mut seconds = Vec::new();
        if options.start == Start::Nested && plan.from == Position::START {
            seconds.push((Phase::Start, Self::of(&nested::first_plan(plan)?, simd)?.total()));
        }
        if matches!(options.start, Start::Tile | Start::Nested) {
            timed.options.start = Start::Random;
        }
        let mut foresee = |phase: Phase, steps: u32, of_one: Option<f64>| {
            let Parallelism { ranks, .. } = plan.parallelism;
            let shares = (ranks * plan.parallelism.processes()) as f64;
            let done = if plan.from.phase == phase { plan.from.step } else { 0 };
            let left = f64::from(steps.saturating_sub(done));
            if let Some(of_one) = of_one.filter(|_| left > 0.0 && phase >= plan.from.phase) {
                seconds.push((phase, left * of_one * parts / shares));
            }
        };

        timed.options.polish.steps = 0;
        timed.options.warp.frames = options.warp.frames.min(WARP_FRAMES);
        let mut clock = Clock { limit: TIMED, ..Clock::default() };
        let start = InitialState::new(&timed, None)?;
        let output = driver::run(&timed, start, simd, Parallel::Threads, &mut clock, None)?;
        foresee(Phase::Descent, options.steps, clock.of_one());
        let warp = output.summary.seconds.iter().find(|(phase, _)| *phase == Phase::Warp);
        let warp = warp.map(|(_, seconds)| seconds / f64::from(timed.options.warp.frames.max(1)));

        if options.polish.steps > 0 {
            timed.options.polish.steps = options.polish.steps.min(POLISH_STEPS);
            (timed.options.steps, timed.options.warp.frames) = (0, 0);
            let mut clock = Clock::default();
            let start = InitialState::new(&timed, None)?;
            driver::run(&timed, start, simd, Parallel::Threads, &mut clock, None)?;
            foresee(Phase::Polish, options.polish.steps, clock.of_one());
        }
        foresee(Phase::Warp, options.warp.frames, warp);
        Ok(Self { seconds })
    }

    /// Seconds of the phases after one.
    pub fn after(&self, phase: Phase) -> f64 {
        self.seconds.iter().filter(|(other, _)| *other > phase).map(|(_, seconds)| seconds).sum()
    }

    /// Seconds of all phases.
    pub fn total(&self) -> f64 {
        self.seconds.iter().map(|(_, seconds)| seconds).sum()
    }
}

/// The plan for a part of the tile that is small enough, with as many draws for each pixel, and how many
/// such parts the tile has.
fn part(plan: &Plan) -> (Plan, f64) {
    let Options { shape, draw, .. } = plan.options;
    let [mut width, mut height] = [shape.width(), shape.height()];
    let others = shape.frames() * shape.spp();
    while width * height * others > SAMPLES && width.max(height) >= 2 * LEAST {
        if width > height { width /= 2 } else { height /= 2 }
    }
    let whole = (plan.clone(), 1.0);
    let Ok(small) = TileShape::new(width, height, shape.frames(), shape.spp(), shape.dims()) else {
        return whole;
    };
    if small == shape {
        return whole;
    }
    let parts = shape.pixels() as f64 / small.pixels() as f64;
    let draws = (draw.draws as f64 / parts).round().max(1.0) as usize;
    let draw = DrawOptions { draws, ..draw };
    let options = Options { shape: small, draw, ..plan.options.clone() };
    // A kernel may need the whole tile.
    Plan::new(&options, Parallelism::threads()).map_or(whole, |small| (small, parts))
}

/// Times steps between the first and the last that it hears of, and ends the run in time.
#[derive(Debug, Default)]
struct Clock {
    /// How long steps may go on; for ever, if zero.
    limit: Duration,
    first: Option<(Instant, u32)>,
    last: Option<(Instant, u32)>,
}

impl Clock {
    /// Seconds of one step; of a run of a single step nothing is known.
    fn of_one(&self) -> Option<f64> {
        let ((start, first), (end, last)) = (self.first?, self.last?);
        (last > first).then(|| end.duration_since(start).as_secs_f64() / f64::from(last - first))
    }
}

impl Observer for Clock {
    fn progress(&mut self, progress: Progress) {
        let now = (Instant::now(), progress.done);
        self.first.get_or_insert(now);
        self.last = Some(now);
    }

    fn stop(&self) -> Option<StopReason> {
        let ((start, first), (end, last)) = (self.first?, self.last?);
        let over = !self.limit.is_zero() && last > first + 1 && end - start >= self.limit;
        over.then_some(StopReason::Time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::Preset;

    fn plan(change: impl FnOnce(&mut crate::solver::Options)) -> Plan {
        let mut options = Preset::Best.options();
        options.shape = TileShape::new(16, 16, 4, 1, 2).unwrap();
        options.draw.draws = 64;
        change(&mut options);
        Plan::new(&options, Parallelism::threads()).unwrap()
    }

    #[test]
    fn large_tiles_are_timed_on_a_part() {
        let of = |width, height, frames, spp| {
            let whole = plan(|options| {
                options.shape = TileShape::new(width, height, frames, spp, 2).unwrap();
                options.draw.draws = width * height * frames / 16;
            });
            let (part, parts) = part(&whole);
            let shape = part.options.shape;
            assert_eq!(part.options.draw.draws, shape.pixels() / 16);
            assert_eq!(shape.pixels() as f64 * parts, whole.options.shape.pixels() as f64);
            ([shape.width(), shape.height(), shape.frames(), shape.spp()], parts)
        };
        assert_eq!(of(256, 256, 64, 4), ([64, 64, 64, 4], 16.0));
        assert_eq!(of(512, 64, 64, 4), ([64, 64, 64, 4], 8.0));
        assert_eq!(of(128, 128, 64, 1), ([128, 128, 64, 1], 1.0));
        // Nothing but width and height is taken away.
        assert_eq!(of(64, 64, 300, 4), ([64, 64, 300, 4], 1.0));
    }

    fn phases(plan: &Plan) -> Vec<Phase> {
        let forecast = Forecast::of(plan, Simd::detect()).unwrap();
        assert!(forecast.seconds.iter().all(|&(_, seconds)| seconds > 0.0), "{forecast:?}");
        forecast.seconds.into_iter().map(|(phase, _)| phase).collect()
    }

    #[test]
    fn every_phase_that_takes_place_is_foreseen() {
        assert_eq!(phases(&plan(|_| ())), [Phase::Descent, Phase::Polish, Phase::Warp]);
        assert_eq!(phases(&plan(|it| it.polish.steps = 0)), [Phase::Descent, Phase::Warp]);
        assert_eq!(
            phases(&plan(|it| (it.polish.steps, it.warp.frames) = (0, 0))),
            [Phase::Descent]
        );
        assert_eq!(phases(&plan(|it| it.steps = 0)), [Phase::Polish, Phase::Warp]);
        assert_eq!(phases(&plan(|it| it.start = Start::Tile)).len(), 3);
        let mut resumed = plan(|_| ());
        resumed.from = Position { phase: Phase::Polish, step: 3 };
        assert_eq!(phases(&resumed), [Phase::Polish, Phase::Warp]);
    }

    #[test]
    fn what_comes_after_a_phase_adds_up() {
        let seconds = vec![(Phase::Descent, 4.0), (Phase::Polish, 2.0), (Phase::Warp, 1.0)];
        let forecast = Forecast { seconds };
        assert_eq!(forecast.total(), 7.0);
        assert_eq!(
            [Phase::Start, Phase::Descent, Phase::Warp].map(|it| forecast.after(it)),
            [7.0, 3.0, 0.0]
        );
    }
}
