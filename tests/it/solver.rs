//! The solver against what it promises: less error, in the reference's own measure and in the
//! scores, and the moves that Adam's formulas prescribe.

use perceptile::domain::Domain;
use perceptile::draw::{DirectionSet, Draws, LevelSets};
use perceptile::gradient::reference;
use perceptile::gradient::simd::Simd;
use perceptile::gradient::{Gradient, Quantum};
use perceptile::metric::{Baseline, Class, Coordinates, ScoreOptions, Scorer};
use perceptile::solver::adam::AdamOptions;
use perceptile::solver::warp::WarpOptions;
use perceptile::solver::{Descent, Options, Samples};
use perceptile::tile::Partition;

use crate::determinism::{make, options};
use crate::gradient::Case;

const KERNEL: &str = "gaussian(1) * fovvideovdp(60) @ 5x5x8";

/// A run without the uniformity step.
fn unwarped(options: Options) -> Options {
    Options { warp: WarpOptions { frames: 0, rate: 0.5 }, ..options }
}

#[test]
fn descent_lowers_the_plain_objective_of_draws_that_it_never_saw() {
    for (shape, least) in
        [([16, 15, 8, 1, 2], 1.7), ([12, 11, 8, 2, 1], 1.7), ([12, 11, 8, 1, 3], 1.3)]
    {
        let objective = |steps: u32| {
            let options = unwarped(options(shape, KERNEL, steps, 0));
            let mut case = Case::of(options.shape, KERNEL, options.draw, 1);
            case.draw.draws = 40;
            case.seed = 991;
            case.tile = make(&options);
            reference::objective(
                (&case.tile, Domain::Square),
                &case.levels,
                &case.reference_draws(),
            )
        };
        let (before, after) = (objective(0), objective(150));
        assert!(before > least * after, "{shape:?}: {before} -> {after}");
    }
}

#[test]
fn tiles_beat_white_noise_and_the_polish_beats_the_descent() {
    let base = options([16, 16, 8, 1, 2], KERNEL, 400, 0);
    let taps = base.kernel.resolve(base.shape).unwrap().classes()[0].taps.clone();
    let scorer = Scorer::new(
        base.shape,
        &taps,
        ScoreOptions { set: 5, integrands: 64, ..ScoreOptions::default() },
    )
    .unwrap();
    let score = |options: &Options, class: Class| {
        let scores = scorer.score(&make(options)).unwrap();
        scores.class(class, Coordinates::All).unwrap().perceived.mean
    };
    let polished =
        Options { polish: options([16, 16, 8, 1, 2], KERNEL, 0, 60).polish, ..base.clone() };
    for (class, most) in
        [(Class::Linear, 0.1), (Class::Edge, 0.4), (Class::Bump, 0.3), (Class::Disk, 0.4)]
    {
        let (plain, better) = (score(&base, class), score(&polished, class));
        assert!(plain < most, "{class}: {plain}");
        assert!(better < plain, "{class}: {better} after {plain}");
    }
}

#[test]
fn steps_are_adams_on_the_plain_gradient() {
    let case = Case::of(
        options([18, 11, 8, 2, 2], KERNEL, 0, 0).shape,
        KERNEL,
        options([18, 11, 8, 2, 2], KERNEL, 0, 0).draw,
        3,
    );
    let adam =
        AdamOptions { rate: 0.01, final_rate: 0.002, beta1: 0.8, beta2: 0.95, epsilon: 0.05 };
    let shape = case.tile.shape();
    let kernel = options([18, 11, 8, 2, 2], KERNEL, 0, 0).kernel.resolve(shape).unwrap();
    let levels = LevelSets::new([(1.0, &kernel.classes()[0].taps)]);
    let draws = Draws::new(case.draw, case.seed, levels, DirectionSet::new(Domain::Square, 2));
    let partition = Partition::new(shape, draws.levels().reach());
    let quantum = Quantum::new(&draws, &partition).unwrap();
    let gradient = Gradient::new(draws, partition, quantum, Simd::detect());
    let steps = 3;
    let start = Samples::from_tile(&case.tile);
    let mut descent = Descent::alone(gradient, adam, steps, Simd::detect(), &start).unwrap();

    let n = shape.coordinates();
    let (mut m, mut v) = (vec![0.0; n], vec![0.0; n]);
    for step in 0..steps {
        // Every step starts from the tile as it is, so that errors do not add up.
        let mut now = case.clone();
        now.step = step;
        now.tile = descent.samples().to_tile(shape);
        let gradient =
            reference::gradient((&now.tile, Domain::Square), &now.levels, &now.reference_draws());
        descent.step(step);
        let after = descent.samples().to_tile(shape);
        let part = f64::from(step) / f64::from(steps);
        let rate = 0.002 + 0.008 * 0.5 * (1.0 + (std::f64::consts::PI * part).cos());
        let t = step as i32 + 1;
        let mut wrong = 0;
        for i in 0..n {
            m[i] = 0.8 * m[i] + 0.2 * gradient[i];
            v[i] = 0.95 * v[i] + 0.05 * gradient[i] * gradient[i];
            let by = rate * (m[i] / (1.0 - 0.8_f64.powi(t)))
                / ((v[i] / (1.0 - 0.95_f64.powi(t))).sqrt() + 0.05);
            let x = (f64::from(now.tile.samples()[i]) + by).clamp(0.0, 1.0);
            wrong += usize::from((f64::from(after.samples()[i]) - x).abs() > 2e-5);
        }
        // Samples that all but tie may be ranked the other way in f32.
        assert!(wrong <= n / 200, "step {step}: {wrong} of {n} coordinates");
    }
}

#[test]
fn going_on_from_other_samples_keeps_the_moments() {
    let options = options([20, 20, 8, 1, 2], KERNEL, 0, 0);
    let kernel = options.kernel.resolve(options.shape).unwrap();
    let levels = LevelSets::new([(1.0, &kernel.classes()[0].taps)]);
    let draws = Draws::new(options.draw, 1, levels, options.directions());
    let partition = Partition::new(options.shape, draws.levels().reach());
    let quantum = Quantum::new(&draws, &partition).unwrap();
    let gradient = Gradient::new(draws, partition, quantum, Simd::detect());
    let start = |seed| Samples::from_tile(&Baseline::White.tile(options.shape, seed));
    let new = || {
        let gradient = gradient.clone();
        Descent::alone(gradient, options.adam, 4, Simd::detect(), &start(1)).unwrap()
    };
    let (mut through, mut replaced) = (new(), new());
    through.step(0);
    replaced.step(0);
    let middle = through.samples();
    replaced.replace(&start(2));
    assert_eq!(replaced.samples(), start(2));
    replaced.replace(&middle);
    through.step(1);
    replaced.step(1);
    assert_eq!(through.samples(), replaced.samples());
}
