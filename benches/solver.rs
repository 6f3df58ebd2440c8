//! What a step is made of. Every benchmark checks its answer first, then measures.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::IVec3;
use perceptile::draw::{CellDraws, DrawOptions, Draws, LevelSets};
use perceptile::gradient::reference::{self, ReferenceDraw};
use perceptile::gradient::simd::Simd;
use perceptile::gradient::{Gradient, Patch, Quantum, Workspace};
use perceptile::kernel::{KernelSpec, KernelTaps, Tap};
use perceptile::metric::{Baseline, Class, Domain, ScoreOptions, Scorer};
use perceptile::solver::adam::{AdamOptions, Update};
use perceptile::solver::polish::{Polish, PolishOptions};
use perceptile::solver::{CellSamples, Descent};
use perceptile::tile::{Partition, Reach, Tile, TileShape};
use perceptile_cluster::World;

const ADAM: AdamOptions =
    AdamOptions { rate: 0.01, final_rate: 0.0, beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };

fn kernel(text: &str, shape: TileShape) -> KernelTaps {
    let spec: KernelSpec = text.parse().expect("a kernel");
    spec.resolve(shape).expect("a kernel that fits").classes()[0].taps.clone()
}

fn options(draws: usize) -> DrawOptions {
    DrawOptions { draws, directions: 1, threshold_range: 1.0, axis_share: 0.1, pair_share: 0.3 }
}

fn gradient(shape: TileShape, taps: &KernelTaps, draws: usize) -> Gradient {
    let draws = Draws::new(options(draws), 1, LevelSets::new([(1.0, taps)]), shape.dims());
    let partition = Partition::new(shape, draws.levels().reach(), 1);
    let quantum = Quantum::new(&draws, &partition).expect("a unit");
    Gradient::new(draws, partition, quantum, Simd::detect())
}

/// 64 draws of subsets of n equal taps in a tile of one cell.
fn draws(criterion: &mut Criterion) {
    const DRAWS: usize = 64;
    let mut group = criterion.benchmark_group("64 draws");
    for n in [4, 16, 64, 256, 1024_usize] {
        let shape = TileShape::new(16, 16, 16, 1, 2).expect("sizes");
        let tap = |i: usize| Tap { offset: IVec3::new(0, 0, -(i as i32)), weight: 1.0 };
        let column = |i: usize| {
            let Tap { offset, weight } = tap(i % 16);
            let across = IVec3::new((i / 16 % 8) as i32, (i / 128) as i32, 0);
            Tap { offset: offset + across, weight }
        };
        let taps = KernelTaps::new((0..n).map(column)).expect("taps");
        let gradient = gradient(shape, &taps, DRAWS);
        let tile = Baseline::White.tile(shape, 2);
        let block = gradient.partition().block(0);
        // The cell with its halo, around the torus.
        let samples: Vec<f32> = (0..block.pixels())
            .flat_map(|i| {
                let x = (i % block.width + 16 - block.left % 16) % 16;
                let y = (i / block.width % block.height + 16 - block.up % 16) % 16;
                tile.point(x, y, i / block.width / block.height, 0).to_vec()
            })
            .collect();
        let mut words = vec![0; samples.len()];
        let mut workspace = Workspace::default();
        let found = gradient.cell(0, 0, &samples, Patch { words: &mut words }, &mut workspace);
        check_draws(&gradient, &tile, found.squared_distance, &words);
        group.bench_function(format!("of {n} samples"), |bencher| {
            let mut step = 0;
            bencher.iter(|| {
                step += 1;
                let patch = Patch { words: &mut words };
                gradient.cell(step, 0, black_box(&samples), patch, &mut workspace)
            });
        });
    }
}

/// The objective, and the sum of all pulls, against the plain gradient.
fn check_draws(gradient: &Gradient, tile: &Tile, squared_distance: f64, words: &[i32]) {
    let mut drawn = CellDraws::default();
    gradient.draws().cell(gradient.partition(), 0, 0, &mut drawn);
    let draws: Vec<ReferenceDraw> = drawn
        .draws
        .iter()
        .zip(&drawn.directions)
        .map(|(draw, direction)| ReferenceDraw {
            pixel: IVec3::new(draw.x as i32, draw.y as i32, draw.t as i32),
            set: draw.set as usize,
            taps: draw.taps as usize,
            directions: vec![*direction],
        })
        .collect();
    let levels = gradient.draws().levels();
    let expected: f64 = draws
        .iter()
        .map(|draw| {
            let half = reference::objective(tile, levels, std::slice::from_ref(draw));
            2.0 * half / draw.taps as f64
        })
        .sum();
    assert!((squared_distance / expected - 1.0).abs() < 1e-3, "{squared_distance} {expected}");
    let unit = f64::from(gradient.quantum().unit());
    let pulls = reference::pulls(tile, levels, &draws);
    for k in 0..2 {
        let found: f64 = words.iter().skip(k).step_by(2).map(|&x| f64::from(x) * unit).sum();
        let expected: f64 = pulls.iter().skip(k).step_by(2).sum();
        assert!((found - expected).abs() < 0.05, "{found} {expected}");
    }
}

/// One step of the default tile with 4096 draws.
fn step(criterion: &mut Criterion) {
    let shape = TileShape::new(64, 64, 16, 1, 2).expect("sizes");
    let taps = kernel("gaussian(2.1) * fovvideovdp(60) @ 7x7x8", shape);
    let gradient = gradient(shape, &taps, 4096);
    let partition = gradient.partition().clone();
    let start = CellSamples::from_tile(&Baseline::White.tile(shape, 1), &partition);
    let simd = Simd::detect();
    let mut descent = Descent::new(World::Local, gradient, ADAM, 1000, simd, &start);
    let objective = |descent: &mut Descent, step| {
        let found = descent.step(step).1;
        found.squared_distance / found.directions as f64
    };
    let first = objective(&mut descent, 0);
    let later = (1..60).map(|step| objective(&mut descent, step)).last().unwrap_or(first);
    assert!(later < 0.8 * first, "{first} -> {later}");
    let mut step = 60;
    criterion.bench_function("step of 4096 draws, 64x64x16", |bencher| {
        bencher.iter(|| {
            step = 60 + (step + 1) % 900;
            descent.step(step)
        });
    });
}

/// Adam on a cell's worth of coordinates.
fn adam(criterion: &mut Criterion) {
    const N: usize = 1 << 14;
    let pulls: Vec<i32> = (0..N as i32).map(|i| i % 201 - 100).collect();
    let old = vec![0.5_f32; N];
    let zero = vec![0.0_f32; N];
    let (mut x, mut m, mut v) = (old.clone(), zero.clone(), zero.clone());
    let simd = Simd::detect();
    let mut update = || {
        simd.run(Update {
            factors: ADAM.factors(0, 100, 0.01),
            pulls: black_box(&pulls),
            samples: (&old, &mut x),
            first: (&zero, &mut m),
            second: (&zero, &mut v),
        });
        x[0] + x[N - 1]
    };
    update();
    criterion.bench_function("Adam on 16384 coordinates", |bencher| bencher.iter(&mut update));
    // The first step goes by the rate, whatever the gradient's size.
    for (x, pull) in x.iter().zip(&pulls) {
        let expected = 0.5 + 0.01 * pull.signum() as f32;
        assert!((x - expected).abs() < 1e-5, "{x} {expected}");
    }
}

/// One step of the polish, whose energy must fall.
fn polish(criterion: &mut Criterion) {
    let shape = TileShape::new(32, 32, 8, 1, 2).expect("sizes");
    let taps = kernel("gaussian(2.1) * fovvideovdp(60) @ 7x7x8", shape);
    let partition = Partition::new(shape, Reach::default(), 1);
    let tile = Baseline::White.tile(shape, 1);
    let options = PolishOptions { steps: 1000, axis_weight: 0.2, linear_weight: 0.0, adam: ADAM };
    let samples = CellSamples::from_tile(&tile, &partition);
    let classes = [(1.0, &taps)];
    let simd = Simd::detect();
    let mut polish = Polish::new(&partition, &classes, options, simd, &samples);
    (0..20).for_each(|step| polish.step(step));
    let scorer = scorer(shape, &taps);
    let edge = |tile: &Tile| edge(&scorer, tile);
    let (before, after) = (edge(&tile), edge(&polish.samples().to_tile(&partition)));
    assert!(after < 0.6 * before, "{before} -> {after}");
    let mut step = 20;
    criterion.bench_function("step of the polish, 32x32x8", |bencher| {
        bencher.iter(|| {
            step = 20 + (step + 1) % 900;
            polish.step(step);
        });
    });
}

fn scorer(shape: TileShape, taps: &KernelTaps) -> Scorer {
    Scorer::new(shape, taps, ScoreOptions { set: 0, integrands: 8 }).expect("a scorer")
}

fn edge(scorer: &Scorer, tile: &Tile) -> f64 {
    let scores = scorer.score(tile).expect("scores");
    scores.class(Class::Edge, Domain::All).expect("a class of all tiles").perceived.mean
}

/// All scores of a tile, on eight integrands of each class.
fn score(criterion: &mut Criterion) {
    let shape = TileShape::new(64, 64, 16, 1, 2).expect("sizes");
    let taps = kernel("gaussian(2.1) * fovvideovdp(60) @ 7x7x8", shape);
    let scorer = scorer(shape, &taps);
    let tile = Baseline::White.tile(shape, 4);
    let found = edge(&scorer, &tile);
    assert!((found - 1.0).abs() < 0.2, "white noise scores {found}");
    criterion.bench_function("scores on 8 integrands, 64x64x16", |bencher| {
        bencher.iter(|| edge(&scorer, black_box(&tile)));
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(std::time::Duration::from_millis(300))
        .measurement_time(std::time::Duration::from_secs(1));
    targets = draws, step, adam, polish, score
}
criterion_main!(benches);
