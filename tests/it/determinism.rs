//! A tile is a function of its options, its seed and the program's version: not of threads,
//! instruction sets, build profiles or interruptions.

use perceptile::domain::Domain;
use perceptile::draw::DrawOptions;
use perceptile::format::sidecar::digest;
use perceptile::gradient::simd::Simd;
use perceptile::run::driver::optimize;
use perceptile::run::observer::{Observer, Progress, Unobserved};
use perceptile::solver::adam::AdamOptions;
use perceptile::solver::polish::PolishOptions;
use perceptile::solver::warp::WarpOptions;
use perceptile::solver::{Options, Start, StopReason, Summary};
use perceptile::tile::{Tile, TileShape};
use rayon::ThreadPoolBuilder;

use crate::densities::densities;

const PERCEPTION: &str = "0.9: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.1: column";

/// Prefixes of every pixel's samples, and frames that are seen now and then.
const SEQUENCE: &str =
    "0.8: gaussian(1) * box(3) * every(2) @ 5x5x3 of 1.. + 0.1: column of 2 + 0.1: box(4)";

/// A short run in which every option is said.
pub fn options(
    [width, height, frames, spp, dims]: [usize; 5],
    kernel: &str,
    steps: u32,
    polish: u32,
) -> Options {
    let adam = AdamOptions { rate: 0.01, final_rate: 0.0, beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };
    Options {
        shape: TileShape::new(width, height, frames, spp, dims).unwrap(),
        domain: Domain::Square,
        kernel: kernel.parse().unwrap(),
        seed: 7,
        start: Start::Random,
        steps,
        stop_after: None,
        draw: DrawOptions {
            draws: 500,
            directions: 2,
            threshold_range: 0.9,
            axis_share: 0.1,
            pair_share: 0.3,
        },
        adam,
        polish: PolishOptions { steps: polish, axis_weight: 0.2, linear_weight: 0.5, adam },
        warp: WarpOptions { frames: 20, rate: 0.5 },
    }
}

/// The tile of a run that nobody watches.
pub fn make(options: &Options) -> Tile {
    optimize(options, None, Simd::detect(), &mut Unobserved).unwrap().0
}

#[test]
fn threads_and_instruction_sets_leave_no_trace() {
    for (shape, kernel, start, steps, polish) in [
        ([37, 35, 8, 1, 2], PERCEPTION, Start::Random, 8, 3),
        ([33, 50, 5, 3, 3], "gaussian(1.5) * ema(0.4) @ 5x5x4", Start::Stratified, 6, 2),
        ([41, 19, 3, 2, 1], "gaussian(1) * gaussian_t(0.7) @ 5x5x3", Start::Random, 6, 2),
        ([70, 18, 2, 1, 6], "0.5: gaussian(2) @ 6x7x1 + 0.5: box(2)", Start::Random, 6, 0),
        ([32, 32, 2, 1, 2], "0.8: none + 0.2: frame", Start::Stratified, 4, 0),
        ([19, 17, 8, 4, 2], SEQUENCE, Start::Nested, 6, 2),
    ] {
        let options = Options { start, ..options(shape, kernel, steps, polish) };
        let run = |threads: usize, simd: Simd| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| optimize(&options, None, simd, &mut Unobserved)).unwrap()
        };
        let (tile, summary) = run(1, Simd::detect());
        for (threads, simd) in [(2, Simd::detect()), (8, Simd::detect()), (3, Simd::plain())] {
            let (other, again) = run(threads, simd);
            let label = format!("{kernel}, {threads} threads, {}", simd.name());
            assert_eq!(digest(&tile), digest(&other), "{label}");
            assert_eq!(summary.objective_after, again.objective_after, "{label}");
        }
        let other = Options { seed: 8, ..options.clone() };
        assert_ne!(digest(&tile), digest(&make(&other)));
    }
}

#[test]
fn other_domains_leave_no_trace_either() {
    for (domain, size, start) in [
        (Domain::Circle, [37, 35, 8, 1], Start::Random),
        (Domain::Disk, [33, 20, 8, 2], Start::Stratified),
        (Domain::Sphere, [37, 19, 8, 1], Start::Random),
        (Domain::Hemisphere, [21, 18, 8, 3], Start::Nested),
        (Domain::Cosine, [40, 17, 8, 1], Start::Stratified),
        (densities()[0], [37, 35, 8, 1], Start::Nested),
        (densities()[1], [21, 18, 8, 3], Start::Stratified),
    ] {
        let [width, height, frames, spp] = size;
        let size = [width, height, frames, spp, domain.dims().unwrap()];
        let kernel = if spp == 3 { SEQUENCE } else { PERCEPTION };
        let options = Options { domain, start, ..options(size, kernel, 6, 2) };
        let run = |threads: usize, simd: Simd| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| optimize(&options, None, simd, &mut Unobserved)).unwrap().0
        };
        let tile = run(1, Simd::detect());
        assert!(domain.adopt(&tile).is_ok_and(|adopted| adopted == tile), "{domain}: outside");
        for (threads, simd) in [(3, Simd::detect()), (2, Simd::plain())] {
            let label = format!("{domain}, {threads} threads, {}", simd.name());
            assert_eq!(digest(&tile), digest(&run(threads, simd)), "{label}");
        }
    }
}

#[test]
fn bytes_stay_what_they_were() {
    const SIGNED: &str = "gaussian(1) * fovvideovdp(60) @ 3x3x15";
    let found = [
        options([36, 33, 8, 1, 2], PERCEPTION, 25, 0),
        options([20, 21, 15, 2, 3], SIGNED, 25, 0),
        options([24, 34, 9, 1, 2], PERCEPTION, 25, 5),
        Options { domain: Domain::Disk, ..options([24, 34, 9, 1, 2], PERCEPTION, 25, 5) },
        Options { domain: Domain::Sphere, ..options([24, 34, 9, 2, 3], PERCEPTION, 25, 5) },
        Options { domain: Domain::Cosine, ..options([24, 34, 9, 1, 3], PERCEPTION, 25, 5) },
        Options { domain: densities()[0], ..options([24, 34, 9, 1, 2], PERCEPTION, 25, 5) },
    ]
    .map(|options| digest(&make(&options)));
    // Changing these lines says that tiles of this version differ from those of earlier ones.
    let known = [
        "fc6177b94dc5d9aa5094538e2b61f16fc141d655f1aa2662847ce9efab50ac48",
        "c83d29b6e9b3e7dc0dc94fbcc2dc763226b4386995e61c23538577d2b076558b",
        "27776d8068bd77fa41f2f5eb7a7d1f22a5fa6fef6227eca9dceac670c130c030",
        "a159573de61f47538106aabdf9fd8585174a28b84b5e3651a13a1e483ec763d4",
        "9140db67b5bb905999c59c7ae5e168dca2cc6a76b377d039e6ef2c1cb1009d97",
        "f780e28c1d10380ca06c4d171e05c2ba93bc70ea2b0861d6f4070504fd99e2b5",
        "436bdc5d5d6cfc5e4593bf04902e0bc69c25d56cb978a6dce845e56f5de3e2c0",
    ];
    assert_eq!(found, known);
}

/// Stops after a number of steps, counted over all phases.
struct Interrupting {
    after: u32,
    done: u32,
}

impl Observer for Interrupting {
    fn progress(&mut self, progress: Progress) {
        use perceptile::solver::Phase;
        self.done += u32::from(matches!(progress.phase, Phase::Descent | Phase::Polish));
    }

    fn report(&mut self, _: &str) {}

    fn stop(&self) -> Option<StopReason> {
        (self.done >= self.after).then_some(StopReason::Interrupted)
    }
}

#[test]
fn a_run_that_was_interrupted_can_be_made_again() {
    let whole = options([20, 18, 8, 1, 2], PERCEPTION, 9, 4);
    let tile = make(&whole);
    for after in [0, 1, 8, 9, 12, 13] {
        let mut observer = Interrupting { after, done: 0 };
        let (cut, summary) = optimize(&whole, None, Simd::detect(), &mut observer).unwrap();
        assert_eq!(summary.steps, after);
        let again = Options { stop_after: Some(after), ..whole.clone() };
        let (same, told) = optimize(&again, None, Simd::detect(), &mut Unobserved).unwrap();
        assert_eq!(digest(&cut), digest(&same), "{after} steps");
        assert_eq!(cut == tile, after == 13, "{after} steps");
        let reason = |stopped| if after < 13 { stopped } else { StopReason::Completed };
        assert_eq!(summary.reason, reason(StopReason::Interrupted), "{after} steps");
        assert_eq!(told.reason, reason(StopReason::StopAfter), "{after} steps");
        let known = |summary: &Summary| summary.objective_before.is_some();
        assert_eq!(known(&summary), after > 0);
    }
}

#[test]
fn a_start_from_a_tile_depends_on_that_tile_only() {
    let first = make(&options([19, 17, 4, 2, 2], "gaussian(1) @ 3x3x1", 5, 0));
    let options = options([19, 17, 4, 2, 2], "gaussian(1) @ 3x3x1", 5, 2);
    let from = |tile: &Tile| {
        let options = Options { start: Start::Tile, ..options.clone() };
        optimize(&options, Some(tile), Simd::detect(), &mut Unobserved).unwrap().0
    };
    let copy = Tile::new(first.shape(), first.samples().to_vec()).unwrap();
    assert_eq!(digest(&from(&first)), digest(&from(&copy)));
    assert_ne!(digest(&from(&first)), digest(&make(&options)));
    let nothing = Options { start: Start::Tile, steps: 0, ..options.clone() };
    let nothing = Options {
        polish: PolishOptions { steps: 0, ..nothing.polish },
        warp: WarpOptions { frames: 0, rate: 0.5 },
        ..nothing
    };
    let same = optimize(&nothing, Some(&first), Simd::detect(), &mut Unobserved).unwrap().0;
    assert_eq!(digest(&same), digest(&first));
}
