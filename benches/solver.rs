//! What a step is made of, the polish, and the scores.

mod common;

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use perceptile::domain::Surface;
use perceptile::gradient::probe::{Probe, Stage};
use perceptile::gradient::simd::Simd;
use perceptile::kernel::KernelTaps;
use perceptile::metric::{Baseline, Class, Coordinates, ScoreOptions, Scorer};
use perceptile::solver::adam::Update;
use perceptile::solver::polish::{Polish, PolishOptions};
use perceptile::solver::{Descent, Samples};
use perceptile::tile::{Tile, TileShape};

use common::{
    ADAM, PAPER_DRAWS, PAPER_SIZE, gradient, paper_kernel, paper_options, paper_taps, shape,
};

/// Notes when the first patches of a step are added up: where its halves meet.
#[derive(Clone)]
struct Halves {
    begun: Instant,
    /// Nanoseconds; 0 in the first half.
    met: Arc<AtomicU64>,
}

impl Probe for Halves {
    fn begin(&mut self) {}

    #[inline(always)]
    fn lap(&mut self, stage: Stage) {
        if let Stage::Reduce = stage
            && self.met.load(Ordering::Relaxed) == 0
        {
            self.met.store(self.begun.elapsed().as_nanos() as u64, Ordering::Relaxed);
        }
    }
}

/// Steps of 4096 draws, and their halves: the gradients, and the update that adds up the patches and
/// moves the samples by Adam.
fn steps(criterion: &mut Criterion) {
    for (size, label) in [([64, 64, 16], "64x64x16"), (PAPER_SIZE, "128x128x30")] {
        let shape = shape(size, 1, 2);
        let gradient = gradient(shape, &paper_taps(shape), paper_options(PAPER_DRAWS));
        let start = Baseline::White.tile(shape, 1);
        let start = Samples::from_tile(&start);
        let halves = Halves { begun: Instant::now(), met: Arc::default() };
        let mut group = criterion.benchmark_group(format!("step, {label}"));
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.expect("threads");
            let (gradient, simd) = (gradient.clone(), Simd::detect());
            let mut descent = pool.install(|| {
                let probe = || halves.clone();
                Descent::probed(gradient, ADAM, 10_000, simd, &start, probe).expect("memory")
            });
            let mut step = 0;
            // The whole step, its gradients, and its update.
            let mut times = || {
                halves.met.store(0, Ordering::Relaxed);
                let begun = halves.begun.elapsed();
                let objective = pool.install(|| descent.step(step));
                let ended = halves.begun.elapsed();
                step = step % 9000 + 1;
                let met = Duration::from_nanos(halves.met.load(Ordering::Relaxed));
                (objective.mean(), [ended - begun, met - begun, ended - met])
            };
            let first = times().0;
            let later = (1..100).map(|_| times().0).last().unwrap_or(first);
            assert!(later < 0.9 * first, "{first} -> {later}");
            for (part, name) in ["whole", "gradients", "update"].into_iter().enumerate() {
                // An update is the same for any number of draws.
                let (draws, words) = (PAPER_DRAWS as u64, shape.coordinates() as u64);
                group.throughput(Throughput::Elements(if part == 2 { words } else { draws }));
                group.bench_function(format!("{name}, {threads} threads"), |bencher| {
                    bencher.iter_custom(|n| (0..n).map(|_| times().1[part]).sum());
                });
            }
        }
    }
}

/// Adam on a cell's worth of coordinates.
fn adam(criterion: &mut Criterion) {
    const N: usize = 1 << 14;
    let gradients: Vec<i32> = (0..N as i32).map(|i| i % 201 - 100).collect();
    let (mut x, mut m, mut v) = (vec![0.5_f32; N], vec![0.0_f32; N], vec![0.0_f32; N]);
    let simd = Simd::detect();
    let mut update = |step: u32| {
        simd.run(Update {
            place: (Surface::Cube, 1),
            factors: ADAM.factors(step, 10_000, 0.01),
            gradients: black_box(&gradients),
            samples: &mut x,
            first: &mut m,
            second: &mut v,
        });
        [x[0], x[N - 1]]
    };
    // The first step goes by the rate, whatever the gradient's size.
    let moved = update(0);
    for (x, gradient) in moved.into_iter().zip([gradients[0], gradients[N - 1]]) {
        let expected = 0.5 + 0.01 * gradient.signum() as f32;
        assert!((x - expected).abs() < 1e-5, "{x} {expected}");
    }
    let mut group = criterion.benchmark_group("Adam");
    group.throughput(Throughput::Elements(N as u64));
    let mut step = 0;
    group.bench_function("16384 coordinates", |bencher| {
        bencher.iter(|| {
            step = step % 9000 + 1;
            update(step)
        });
    });
}

/// One step of the polish, after which edges must look better.
fn polish(criterion: &mut Criterion) {
    let shape = shape([32, 32, 8], 1, 2);
    let kernel = paper_kernel(shape);
    let (classes, taps) = (kernel.classes(), paper_taps(shape));
    let tile = Baseline::White.tile(shape, 1);
    let options = PolishOptions { steps: 1000, axis_weight: 0.2, linear_weight: 0.0, adam: ADAM };
    let samples = Samples::from_tile(&tile);
    let mut polish =
        Polish::alone(shape, classes, options, Simd::detect(), &samples).expect("memory");
    (0..20).for_each(|step| polish.step(step));
    let scorer = scorer(shape, &taps);
    let edge = |tile: &Tile| edge(&scorer, tile);
    let (before, after) = (edge(&tile), edge(&polish.samples().to_tile(shape)));
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
    Scorer::new(shape, taps, ScoreOptions { set: 0, integrands: 8, ..ScoreOptions::default() })
        .expect("a scorer")
}

fn edge(scorer: &Scorer, tile: &Tile) -> f64 {
    let scores = scorer.score(tile).expect("scores");
    scores.class(Class::Edge, Coordinates::All).expect("a class of all tiles").perceived.mean
}

/// All scores of a tile, on eight integrands of each class.
fn score(criterion: &mut Criterion) {
    let shape = shape([64, 64, 16], 1, 2);
    let scorer = scorer(shape, &paper_taps(shape));
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
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(600));
    targets = steps, adam, polish, score
}
criterion_main!(benches);
