//! The start of a sequence: a tile of one sample per pixel, made first, and for every further sample
//! that tile shifted around the cube.
//!
//! One sample per pixel costs a fraction of many, so the first sample is at its best soon; from there
//! the descent of all has to go a short way only, in small steps. A shift by a step of an additive
//! recurrence (the generalised golden ratio, Roberts 2018) leaves each further sample as good by
//! itself, and spreads the samples of a pixel. In other domains than the square it is their places
//! ([`Domain::place`]) that are shifted. At 32×32×16 and 16 samples, 3,000 steps from such a
//! start make up for most of 9,000 from random samples (edges of the first 1, 4 and 16 samples: .090
//! .064 .044; from random samples .100 .069 .049 after 3,000 and .091 .061 .041 after 12,000).

use crate::domain::Domain;
use crate::gradient::simd::Simd;
use crate::run::driver::{self, Parallel};
use crate::run::error::RunError;
use crate::run::observer::{Observer, Progress};
use crate::run::plan::Plan;
use crate::run::start::InitialState;
use crate::solver::{Options, Parallelism, Phase, Preset, Samples, StopReason};
use crate::tile::{Tile, TileShape};

/// The plan of the tile of one sample per pixel that a plan's start is made of: by the threads of
/// this process, with the steps of the default tile, or as many less as the plan's are less than its
/// preset's.
///
/// # Errors
/// Options that cannot be run.
pub fn first_plan(plan: &Plan) -> Result<Plan, RunError> {
    let Options { shape, domain, ref kernel, seed, draw, steps, .. } = plan.options;
    let (all, best) = (Preset::Progressive.options().steps, Preset::Best.options());
    let share = u64::from(best.steps) * u64::from(steps.min(all)) / u64::from(all);
    let one = TileShape::new(shape.width(), shape.height(), shape.frames(), 1, shape.dims());
    let one = one.expect("sizes of a larger tile");
    let best = best.with_domain(domain).with_shape(one).with_steps(share as u32);
    let options = Options { kernel: kernel.of_all_samples(), seed, draw, ..best };
    Ok(Plan::new(&options, Parallelism::threads())?)
}

/// The samples of a plan whose start is nested, in line order.
///
/// # Errors
/// As for a run, and if the observer stops it.
pub fn samples(plan: &Plan, simd: Simd, observer: &mut dyn Observer) -> Result<Samples, RunError> {
    let first = first_plan(plan)?;
    let start = InitialState::new(&first, None)?;
    let mut observer = AtStart { observer, of: first.steps_of(Phase::Descent) };
    let output = driver::run(&first, start, simd, Parallel::Threads, &mut observer, None)?;
    if output.summary.reason != StopReason::Completed {
        return Err(RunError::Stopped);
    }
    Ok(shifted(plan.options.domain, &output.tile(), plan.options.shape.spp()))
}

/// As many samples for each that a tile has: shifted around the cube, each by a step more.
fn shifted(domain: Domain, tile: &Tile, spp: usize) -> Samples {
    let dims = tile.shape().dims();
    let steps = recurrence(domain.parameters(dims));
    let first = Samples::from_tile(tile).words;
    let mut words = vec![0.0; first.len() * spp];
    for (point, all) in first.chunks_exact(dims).zip(words.chunks_exact_mut(dims * spp)) {
        let place = domain.place(point);
        for (s, to) in all.chunks_exact_mut(dims).enumerate() {
            let shifted = place.iter().zip(&steps).map(|(u, step)| (u + s as f64 * step).fract());
            domain.point(&shifted.collect::<Vec<f64>>(), to);
        }
        // It is not to be rounded on its way to its place and back.
        all[..dims].copy_from_slice(point);
    }
    Samples { words }
}

/// Powers of 1/ρ, with ρ the positive root of x^(d + 1) = x + 1.
fn recurrence(dims: usize) -> Vec<f64> {
    let mut root = 2.0_f64;
    // It converges by a digit or more every few rounds.
    (0..64).for_each(|_| root = libm::pow(1.0 + root, 1.0 / (dims as f64 + 1.0)));
    let mut power = 1.0;
    let next = |_| {
        power /= root;
        power
    };
    (0..dims).map(next).collect()
}

/// Hears of the first run as of the start of another.
struct AtStart<'a> {
    observer: &'a mut dyn Observer,
    of: u32,
}

impl Observer for AtStart<'_> {
    fn progress(&mut self, progress: Progress) {
        if progress.phase == Phase::Descent {
            let phase = Phase::Start;
            self.observer.progress(Progress { phase, of: self.of, objective: None, ..progress });
        }
    }

    fn report(&mut self, message: &str) {
        self.observer.report(message);
    }

    fn stop(&self) -> Option<StopReason> {
        self.observer.stop()
    }

    fn gives_up(&self) -> bool {
        self.observer.gives_up()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::observer::Unobserved;
    use crate::solver::Start;

    #[test]
    fn every_sample_is_the_first_one_shifted_by_a_recurrence() {
        // The golden ratio and the plastic number.
        for (dims, steps) in
            [(1, vec![0.618_033_988_75]), (2, vec![0.754_877_666_2, 0.569_840_290_9])]
        {
            let mut options = Preset::Progressive.options();
            options.shape = TileShape::new(9, 8, 4, 3, dims).unwrap();
            options.kernel =
                "0.9: gaussian(1) * box(2) @ 3x3x2 of 1.. + 0.1: column".parse().unwrap();
            (options.steps, options.draw.draws) = (50, 30);
            let plan = Plan::new(&options, Parallelism::threads()).unwrap();
            let simd = Simd::detect();
            let found = samples(&plan, simd, &mut Unobserved).unwrap().to_tile(options.shape);

            let first = first_plan(&plan).unwrap().options;
            assert_eq!((first.steps, first.shape.spp(), first.start), (80, 1, Start::Random));
            let (tile, _) = driver::optimize(&first, None, simd, &mut Unobserved).unwrap();
            assert_eq!(found.first(1), tile);
            for (point, x) in found.samples().chunks(3 * dims).zip(tile.samples().chunks(dims)) {
                for (i, found) in point.iter().enumerate() {
                    let (s, k) = (i / dims, i % dims);
                    let expected = (f64::from(x[k]) + s as f64 * steps[k]).fract();
                    let error = (f64::from(*found) - expected).abs();
                    assert!(error.min(1.0 - error) < 1e-6, "{found}, not {expected}");
                }
            }
        }
    }

    #[test]
    fn a_stop_while_the_start_is_made_is_an_error() {
        struct Stopping;
        impl Observer for Stopping {
            fn stop(&self) -> Option<StopReason> {
                Some(StopReason::Time)
            }
        }
        let mut options = Preset::Progressive.options();
        options.shape = TileShape::new(8, 8, 8, 2, 2).unwrap();
        let plan = Plan::new(&options, Parallelism::threads()).unwrap();
        let stopped = samples(&plan, Simd::detect(), &mut Stopping).unwrap_err();
        assert!(matches!(stopped, RunError::Stopped), "{stopped}");
    }
}
