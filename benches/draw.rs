//! What a draw costs: by the size of its subset and the number of dimensions, by layout, and for
//! the paper's kernel. One thread does all draws of a step, from making them to their patches.
//!
//! `cargo run --release --example draw_costs` prints the first of these as a table.

mod common;

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use perceptile::domain::Domain;
use perceptile::metric::Baseline;
use perceptile::tile::Layout;

use common::subsets::{self, DIMS, SUBSETS};
use common::{
    Gradients, PAPER_DRAWS, PAPER_SIZE, gradient, gradient_in, paper_options, paper_taps, shape,
};

/// Draws by size and dimensions; a throughput of 1 Gelem/s is a nanosecond for each sample of a
/// subset, whatever its dimensions.
fn sizes(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("draw");
    group.measurement_time(Duration::from_millis(300));
    for dims in DIMS {
        for (taps, spp) in SUBSETS {
            let samples = taps * spp;
            group.throughput(Throughput::Elements((subsets::DRAWS * samples) as u64));
            let (mut gradients, mut step) = (None, 0);
            group.bench_function(format!("{samples} samples, {dims} dims"), |bencher| {
                let gradients =
                    gradients.get_or_insert_with(|| subsets::gradients((taps, spp), dims));
                bencher.iter(|| {
                    step += 1;
                    gradients.run(black_box(step))
                });
            });
        }
    }
}

/// The same draws in each layout. Those that are not rows pay for copying what a cell sees.
fn layouts(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("layout");
    group.throughput(Throughput::Elements(PAPER_DRAWS as u64));
    for spp in [1, 16] {
        let shape = shape([64, 64, 16], spp, 2);
        let taps = paper_taps(shape);
        let tile = Baseline::White.tile(shape, 3);
        let rows = gradient(shape, &taps, paper_options(PAPER_DRAWS));
        let mut expected = Gradients::new(rows.clone(), &tile);
        expected.check_some(&tile, &taps, 16);
        expected.run(1);
        for layout in Layout::ALL {
            let mut gradients = Gradients::new(rows.clone().with_layout(layout), &tile);
            gradients.run(1);
            assert!(gradients.patches() == expected.patches(), "{layout} differs from rows");
            let mut step = 0;
            group.bench_function(format!("{layout}, {spp} spp, 64x64x16"), |bencher| {
                bencher.iter(|| {
                    step += 1;
                    gradients.run(black_box(step))
                });
            });
        }
    }
}

/// The same draws in each domain, to be compared with the square's.
fn domains(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("domain");
    group.throughput(Throughput::Elements(PAPER_DRAWS as u64));
    for domain in Domain::ALL {
        let shape = shape([64, 64, 16], 1, domain.dims().unwrap_or(2));
        let taps = paper_taps(shape);
        let tile = Baseline::White.tile_of(domain, shape, 3);
        let gradient = gradient_in(domain, shape, &taps, paper_options(PAPER_DRAWS));
        let (mut gradients, mut step) = (Gradients::new(gradient, &tile), 0);
        group.bench_function(domain.to_string(), |bencher| {
            bencher.iter(|| {
                step += 1;
                gradients.run(black_box(step))
            });
        });
    }
}

/// The draws of a step on the paper's tile.
fn paper(criterion: &mut Criterion) {
    let shape = shape(PAPER_SIZE, 1, 2);
    let taps = paper_taps(shape);
    let tile = Baseline::White.tile(shape, 1);
    let mut gradients = Gradients::new(gradient(shape, &taps, paper_options(PAPER_DRAWS)), &tile);
    gradients.check_some(&tile, &taps, 16);
    gradients.check_sum(&tile);
    let mut group = criterion.benchmark_group("paper");
    group.throughput(Throughput::Elements(PAPER_DRAWS as u64));
    let mut step = 0;
    group.bench_function(format!("{PAPER_DRAWS} draws, 128x128x30"), |bencher| {
        bencher.iter(|| {
            step += 1;
            gradients.run(black_box(step))
        });
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(100))
        .measurement_time(Duration::from_millis(500));
    targets = sizes, layouts, domains, paper
}
criterion_main!(benches);
