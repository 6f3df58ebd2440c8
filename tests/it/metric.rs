//! Scores of tiles whose scores are known without measuring them.

use glam::IVec3;
use perceptile::kernel::{KernelSpec, KernelTaps, Tap};
use perceptile::metric::{Baseline, Class, Coordinates, ScoreOptions, Scorer, Scores, spectra};
use perceptile::tile::{Tile, TileShape};
use proptest::prelude::*;

/// The first 8 of the 15 taps of the perception kernel at 60 frames per second.
const PERCEPTION: [f64; 8] = [
    0.0395582850655909,
    0.398409765599820,
    0.404689211439515,
    0.177879764807883,
    0.0419136195197315,
    -0.00678276096076438,
    -0.0170052838869954,
    -0.0150087151111371,
];

/// Gaussian of standard deviation 2.1 on 7×7 pixels × perception on 8 frames.
fn perception_kernel() -> KernelTaps {
    let taps = PERCEPTION.iter().zip(0..).flat_map(|(&in_time, age)| {
        (-3..=3).flat_map(move |dy| {
            (-3..=3).map(move |dx| {
                let squared = f64::from(dx * dx + dy * dy);
                let in_space = (-squared / (2.0 * 2.1 * 2.1)).exp();
                Tap { offset: IVec3::new(dx, dy, -age), weight: in_space * in_time }
            })
        })
    });
    KernelTaps::new(taps).unwrap()
}

/// Σ over p of g(p)·g(p + lag).
fn autocorrelation(kernel: &KernelTaps, lag: IVec3) -> f64 {
    let taps = kernel.taps();
    taps.iter()
        .flat_map(|a| taps.iter().filter(move |b| b.offset == a.offset + lag).map(move |b| (a, b)))
        .map(|(a, b)| a.weight * b.weight)
        .sum()
}

fn perceived(scores: &Scores, class: Class) -> f64 {
    scores.class(class, Coordinates::All).unwrap().perceived.mean
}

#[test]
fn white_noise_has_one_and_the_histogram_of_its_number() {
    let shape = TileShape::new(64, 64, 16, 1, 2).unwrap();
    let tile = Baseline::White.tile(shape, 12);
    let options = ScoreOptions { set: 1, integrands: 64, ..ScoreOptions::default() };
    let scores = Scores::of(&tile, &perception_kernel(), options).unwrap();
    for score in &scores.classes {
        // One tile's perceived mean square has some 2·65536·(share of frequencies that pass)
        // degrees of freedom, about a thousand.
        assert!((score.perceived.mean - 1.0).abs() < 0.15, "{score:?}");
        assert!((score.half_period.unwrap().mean - 1.0).abs() < 0.05, "{score:?}");
        assert!((score.whole_period.mean - 1.0).abs() < 0.1, "{score:?}");
    }
    // 256 samples to a cell, so 1/16 of rms.
    assert!((scores.histogram.rms - 0.0625).abs() < 0.01, "{:?}", scores.histogram);
    assert!((scores.residual - 1.0).abs() < 0.05, "{}", scores.residual);
    assert!((0.1..2.5).contains(&scores.bias), "{}", scores.bias);
}

#[test]
fn mirrored_neighbours_score_what_the_kernels_autocorrelation_says() {
    // Pairs of neighbours at u and 1 − u: linear errors are opposite, so of the filtered square
    // Σ gᵢgⱼ E[eᵢeⱼ] the terms one pixel apart count −1 wherever the two are a pair, half the time.
    let kernel = perception_kernel();
    let along = |lag: IVec3| {
        (autocorrelation(&kernel, IVec3::ZERO) - autocorrelation(&kernel, lag))
            / autocorrelation(&kernel, IVec3::ZERO)
    };
    let shape = TileShape::new(64, 64, 16, 1, 2).unwrap();
    let white = Baseline::White.tile(shape, 3);
    for (axis, step) in [(IVec3::X, 1), (IVec3::Y, 64), (IVec3::Z, 64 * 64)] {
        let samples = (0..shape.coordinates())
            .map(|i| {
                let x = white.samples()[i - i / 2 / step % 2 * 2 * step];
                // The smallest 1 − u is 2⁻²⁴, as u is below 1; u = 0 has no mirror image.
                if i / 2 / step % 2 == 0 { x } else { (1.0 - x).min(1.0 - f32::EPSILON / 2.0) }
            })
            .collect();
        let tile = Tile::new(shape, samples).unwrap();
        let options = ScoreOptions { set: 1, integrands: 32, ..ScoreOptions::default() };
        let found = perceived(&Scores::of(&tile, &kernel, options).unwrap(), Class::Linear);
        let expected = along(axis);
        assert!((found / expected - 1.0).abs() < 0.2, "{axis}: {found}, expected {expected}");
    }
}

#[test]
fn stratified_pixels_score_one_over_their_number_squared() {
    // n scrambled points of one dimension are one jittered point per stratum: their mean has
    // 1/n² of the variance of n independent ones, and pixels are independent of each other, so
    // that the kernel changes nothing.
    for spp in [2, 4, 8] {
        let shape = TileShape::new(32, 32, 8, spp, 1).unwrap();
        let tile = Baseline::Sobol.tile(shape, 5);
        let tap = Tap { offset: IVec3::ZERO, weight: 1.0 };
        let kernel = KernelTaps::new([tap]).unwrap();
        let options = ScoreOptions { set: 2, integrands: 4, ..ScoreOptions::default() };
        let scores = Scores::of(&tile, &kernel, options).unwrap();
        let expected = 1.0 / (spp * spp) as f64;
        let found = perceived(&scores, Class::Linear);
        assert!((found / expected - 1.0).abs() < 0.05, "{spp}: {found}, expected {expected}");
        // A pixel's frames continue its sequence: over all of them, 1/(8·spp)², of 1024 pixels.
        let found = scores.class(Class::Linear, Coordinates::All).unwrap().whole_period.mean;
        assert!((found / expected * 64.0 - 1.0).abs() < 0.2, "{spp}: {found}");
    }
}

/// One pixel, whose only sample of one dimension is at x.
fn one_sample(x: f32) -> (Tile, KernelTaps) {
    let shape = TileShape::new(1, 1, 1, 1, 1).unwrap();
    let tap = Tap { offset: IVec3::ZERO, weight: 1.0 };
    (Tile::new(shape, vec![x]).unwrap(), KernelTaps::new([tap]).unwrap())
}

#[test]
fn edges_next_to_the_border_weigh_as_little_as_they_vary() {
    // An edge at p, uniform in (0, 1), has the variance p(1 − p), 1/6 in the mean, and one sample at
    // x errs by p or 1 − p, with the mean square (x³ + (1 − x)³)/3. The mean of the single ratios
    // has no limit at x = 0, where it is that of (1 − p)/p: nearly 6 for edges that vary by 0.001.
    for (x, expected) in [(0.0, 2.0), (0.25, 0.875), (0.5, 0.5)] {
        let (tile, kernel) = one_sample(x);
        let options = ScoreOptions { set: 3, integrands: 16_384, ..ScoreOptions::default() };
        let scores = Scores::of(&tile, &kernel, options).unwrap();
        let score = scores.class(Class::AxisEdge, Coordinates::All).unwrap();
        for ratio in [score.perceived, score.whole_period] {
            let error = ratio.standard_error;
            assert!((ratio.mean - expected).abs() < 3.0 * error, "{x}: {ratio:?}");
            assert!(error < 0.02 * expected, "{x}: {ratio:?}");
        }
        assert!((score.bias * score.bias - expected).abs() < 0.06 * expected, "{x}: {score:?}");
    }
    // The deviations (1 − p)(1 − 3p) from twice the variance have the mean square 2/15.
    let (tile, kernel) = one_sample(0.0);
    let options = ScoreOptions { set: 3, integrands: 16_384, ..ScoreOptions::default() };
    let scores = Scores::of(&tile, &kernel, options).unwrap();
    let found = scores.class(Class::AxisEdge, Coordinates::All).unwrap().perceived.standard_error;
    let expected = 6.0 * (2.0_f64 / 15.0 / 16_384.0).sqrt();
    assert!((found / expected - 1.0).abs() < 0.05, "{found}, expected {expected}");
}

#[test]
fn standard_errors_say_how_far_sets_differ() {
    let (tile, kernel) = one_sample(0.25);
    let sets = 100;
    let covered = (0..sets)
        .filter(|&set| {
            let options = ScoreOptions { set, integrands: 128, ..ScoreOptions::default() };
            let scores = Scores::of(&tile, &kernel, options).unwrap();
            let ratio = scores.class(Class::AxisEdge, Coordinates::All).unwrap().perceived;
            (ratio.mean - 0.875).abs() < 1.96 * ratio.standard_error
        })
        .count();
    // 95 in expectation.
    assert!((88..=99).contains(&covered), "{covered} of {sets}");
}

#[test]
fn a_kernel_of_one_pixel_sees_all_power_of_a_spectrum() {
    let shape = TileShape::new(16, 12, 4, 2, 2).unwrap();
    let tile = Baseline::Sobol.tile(shape, 6);
    let kernel = KernelTaps::new([Tap { offset: IVec3::ZERO, weight: 1.0 }]).unwrap();
    let options = ScoreOptions { set: 4, integrands: 24, ..ScoreOptions::default() };
    let scores = Scores::of(&tile, &kernel, options).unwrap();
    for class in spectra(&tile, options).unwrap() {
        let expected = scores.class(class.class, class.coordinates).unwrap().perceived.mean;
        for power in [class.xy.power, class.xt.power] {
            let mean = power.iter().map(|&p| f64::from(p)).sum::<f64>() / power.len() as f64;
            assert!((mean / expected - 1.0).abs() < 1e-5, "{}: {mean} {expected}", class.class);
        }
    }
}

/// The tile moved by `(dx, dy, dt)` with wrapping.
/// Behind a filter that sees every third frame, the power of a tile's error is the mean over the
/// phases behind the filter itself.
#[test]
fn phases_score_what_the_tile_scores_behind_every_so_many_frames() {
    let tile = Baseline::White.tile(TileShape::new(12, 10, 12, 2, 2).unwrap(), 5);
    let score = |tile: &Tile, kernel: &str| {
        let kernel = kernel.parse::<KernelSpec>().unwrap().resolve(tile.shape()).unwrap();
        let options = ScoreOptions { set: 3, integrands: 8, ..ScoreOptions::default() };
        Scores::of(tile, &kernel.classes()[0].taps, options).unwrap()
    };
    let whole = score(&tile, "gaussian(1) * fovvideovdp(24) * every(3) @ 3x3x4");
    let phases = [0, 1, 2]
        .map(|phase| score(&tile.every(3, phase), "gaussian(1) * fovvideovdp(24) @ 3x3x4"));
    for class in Class::ALL {
        let mean = phases.iter().map(|scores| perceived(scores, class)).sum::<f64>() / 3.0;
        let whole = perceived(&whole, class);
        assert!((whole / mean - 1.0).abs() < 1e-5, "{class}: {whole}, not {mean}");
    }
}

fn moved(tile: &Tile, by: [usize; 3]) -> Tile {
    let shape = tile.shape();
    let mut samples = Vec::with_capacity(shape.coordinates());
    for t in 0..shape.frames() {
        for y in 0..shape.height() {
            for x in 0..shape.width() {
                let from = [
                    (x + by[0]) % shape.width(),
                    (y + by[1]) % shape.height(),
                    (t + by[2]) % shape.frames(),
                ];
                for s in 0..shape.spp() {
                    samples.extend(tile.point(from[0], from[1], from[2], s));
                }
            }
        }
    }
    Tile::new(shape, samples).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_tile_scores_the_same_wherever_it_starts(
        width in 7_usize..14, height in 7_usize..12, frames in 8_usize..11,
        spp in 1_usize..3, dims in 1_usize..4, by: [u8; 3], seed: u64,
    ) {
        let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
        let tile = Baseline::White.tile(shape, seed);
        let options = ScoreOptions { set: seed, integrands: 2, ..ScoreOptions::default() };
        let scorer = Scorer::new(shape, &perception_kernel(), options).unwrap();
        let here = scorer.score(&tile).unwrap();
        let there = scorer.score(&moved(&tile, by.map(usize::from))).unwrap();
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-4 * b.abs() + 1e-9;
        for (a, b) in here.classes.iter().zip(&there.classes) {
            prop_assert!(close(a.perceived.mean, b.perceived.mean), "{a:?} {b:?}");
            prop_assert!(close(a.whole_period.mean, b.whole_period.mean));
            prop_assert!(close(a.half_period.unwrap().mean, b.half_period.unwrap().mean));
            let filtered = |score: &perceptile::metric::ClassScore| {
                score.whole_period_perceived.unwrap().mean
            };
            prop_assert!(close(filtered(a), filtered(b)));
            prop_assert!(close(a.bias, b.bias));
        }
        prop_assert_eq!(here.histogram, there.histogram);
        prop_assert!(close(here.residual, there.residual));
    }
}
