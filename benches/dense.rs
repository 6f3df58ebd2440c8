//! The fast path against a baseline that goes through the whole tile for every draw, as the
//! paper's Algorithm 1 is written: the paper's kernel and tile, one thread, in one run.
//!
//! ```text
//! cargo bench --bench dense
//! ```
//!
//! ends with the ratio of the shortest times.

mod common;

use std::time::Duration;

use criterion::{Criterion, Throughput};
use perceptile::domain::Domain;
use perceptile::draw::LevelSets;
use perceptile::gradient::reference::{self, ReferenceDraw};
use perceptile::gradient::simd::Simd;
use perceptile::metric::Baseline;
use perceptile::solver::{Descent, Samples};

use common::dense::{Dense, DenseDraw};
use common::{
    ADAM, Gradients, PAPER_DRAWS, PAPER_SIZE, Shortest, assert_near, gradient, paper_options,
    paper_taps, shape,
};

/// Independent draws of the baseline at a time. Its cost per draw does not depend on how many
/// there are, as each goes through the whole tile; Adam would add nothing to speak of.
const DENSE_DRAWS: usize = 16;

/// Shortest times of all draws together.
#[derive(Default)]
struct Times {
    dense: Shortest,
    gradients: Shortest,
    step: Shortest,
}

fn measure(criterion: &mut Criterion, times: &Times) {
    let shape = shape(PAPER_SIZE, 1, 2);
    let taps = paper_taps(shape);
    let tile = Baseline::White.tile(shape, 1);
    let mut group = criterion.benchmark_group("one draw in 128x128x30");
    group
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));

    let levels = LevelSets::new([(1.0, &taps)]);
    let draws = DenseDraw::independent(shape, &levels, DENSE_DRAWS);
    let mut dense = Dense::new(&tile, &taps, Simd::detect());
    dense.gradients(&draws);
    let plain: Vec<ReferenceDraw> = draws.iter().map(|draw| draw.reference(&levels)).collect();
    assert_near(&dense.gradient(), &reference::gradient((&tile, Domain::Square), &levels, &plain));
    group.throughput(Throughput::Elements(DENSE_DRAWS as u64));
    group.bench_function("dense", |bencher| {
        bencher.iter_custom(|n| times.dense.measure(n, || dense.gradients(&draws)));
    });

    let gradient = gradient(shape, &taps, paper_options(PAPER_DRAWS));
    let mut gradients = Gradients::new(gradient.clone(), &tile);
    gradients.check_some(&tile, &taps, 16);
    gradients.check_sum(&tile);
    group.throughput(Throughput::Elements(PAPER_DRAWS as u64));
    let mut step = 0;
    group.bench_function("fast, gradients", |bencher| {
        bencher.iter_custom(|n| {
            times.gradients.measure(n, || {
                step += 1;
                gradients.run(step);
            })
        });
    });

    let start = Samples::from_tile(&tile);
    let mut descent =
        Descent::alone(gradient, ADAM, 10_000, Simd::detect(), &start).expect("memory");
    let first = descent.step(0).mean();
    let later = (1..100).map(|step| descent.step(step).mean()).last().unwrap_or(first);
    assert!(later < 0.9 * first, "{first} -> {later}");
    let mut step = 100;
    group.bench_function("fast, whole step", |bencher| {
        bencher.iter_custom(|n| {
            times.step.measure(n, || {
                step = 100 + (step + 1) % 9000;
                descent.step(step);
            })
        });
    });
    group.finish();
}

/// Prints the ratio, if all was measured and not just tried.
fn report(times: &Times) {
    let found = (
        times.dense.nanoseconds(DENSE_DRAWS),
        times.gradients.nanoseconds(PAPER_DRAWS),
        times.step.nanoseconds(PAPER_DRAWS),
    );
    let tried = std::env::args().any(|argument| argument == "--test");
    if let ((Some(dense), Some(gradients), Some(step)), false) = (found, tried) {
        println!(
            "dense baseline: {:.2} ms per draw, one thread, {}",
            dense * 1e-6,
            Simd::detect().name()
        );
        println!("fast path: {:.0} times the dense baseline ({step:.0} ns per draw)", dense / step);
        println!(
            "  its gradients alone: {:.0} times ({gradients:.0} ns per draw)",
            dense / gradients
        );
    }
}

fn main() {
    let times = Times::default();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let times = one.install(move || {
        let mut criterion = Criterion::default().configure_from_args();
        measure(&mut criterion, &times);
        criterion.final_summary();
        times
    });
    report(&times);
}
