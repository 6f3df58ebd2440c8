//! What it costs ranks to go in step, and what it costs a step to be safe from the loss of a rank.

mod common;

use std::hint::black_box;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use perceptile::gradient::probe::Unprobed;
use perceptile::gradient::simd::Simd;
use perceptile::metric::Baseline;
use perceptile::solver::{Descent, Parallelism, Samples, StoragePlan};
use perceptile::tile::Regions;
use perceptile_cluster::shared::{Arena, Board, BoardPlan, Map, MapHeader};
use perceptile_cluster::{Ends, Worker};

use common::{ADAM, PAPER_DRAWS, PAPER_SIZE, gradient, paper_options, paper_taps, shape};

/// Jobs of the two rounds of a step of the paper's tile by two threads.
const JOBS: [usize; 2] = [8, 128];

/// Rounds without work by ranks that share a file, each a thread of this process.
fn rounds(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("step without work");
    for ranks in [1, 2] {
        let plan = BoardPlan { workers: ranks, threads: 1, jobs: 128, journal: 1024 };
        let file = tempfile::tempfile().expect("a file");
        let header = MapHeader { len: plan.room() as u64, run: 1 };
        Map::create(&file, &std::env::temp_dir(), header).expect("shared memory");
        let worker = |rank| {
            let map = Map::open(&file, header).expect("shared memory");
            Worker::new(Board::new(&mut Arena::new(map), plan), rank, None)
        };
        let done = AtomicU64::new(0);
        let step = |worker: &Worker, step: u64| {
            for (half, jobs) in JOBS.into_iter().enumerate() {
                worker.round(2 * step + half as u64 + 1, Ends::Step, 0..jobs, (), |_, ()| {
                    done.fetch_add(1, Ordering::Relaxed);
                });
            }
        };
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for rank in 1..ranks {
                let (step, worker, over) = (&step, worker(rank), &over);
                scope.spawn(move || {
                    // It follows the first rank, and sleeps where that one does.
                    for number in 0.. {
                        if over.load(Ordering::Relaxed) {
                            break;
                        }
                        step(&worker, number);
                    }
                });
            }
            let first = worker(0);
            let mut number = 0;
            group.bench_function(format!("{ranks} ranks"), |bencher| {
                bencher.iter(|| {
                    step(&first, number);
                    number += 1;
                });
            });
            over.store(true, Ordering::Relaxed);
            // Those who wait in a round that nobody else does do it alone.
            assert!(done.load(Ordering::Relaxed) >= number * (JOBS[0] + JOBS[1]) as u64);
        });
    }
    group.finish();
}

/// A step of the paper's job on one thread, with the journal and without it.
fn journal(criterion: &mut Criterion) {
    let shape = shape(PAPER_SIZE, 1, 2);
    let gradient = gradient(shape, &paper_taps(shape), paper_options(PAPER_DRAWS));
    let start = Samples::from_tile(&Baseline::White.tile(shape, 1));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let regions = Regions::whole(shape);
    let mut descents = [false, true].map(|can_fail| {
        let parallelism = Parallelism { ranks: 1, workers: can_fail.into(), threads: 1 };
        let (worker, mut storage) =
            StoragePlan::new(gradient.partition(), regions.own(), parallelism)
                .private()
                .expect("memory");
        storage.tile_mut(shape).copy_from_slice(&start.words);
        let how = (Simd::detect(), 0);
        one.install(|| {
            Descent::enter(worker, storage, (gradient.clone(), &regions), ADAM, 10_000, how, || {
                Unprobed
            })
        })
    });
    let mut step = 0;
    let mut times = [Duration::MAX; 2];
    let mut both = || {
        let mut objectives = [0.0; 2];
        for (i, descent) in descents.iter_mut().enumerate() {
            let begun = Instant::now();
            objectives[i] = one.install(|| black_box(descent.step(step))).mean();
            times[i] = times[i].min(begun.elapsed());
        }
        step += 1;
        assert_eq!(objectives[0], objectives[1]);
        times
    };
    both();
    let mut group = criterion.benchmark_group("step, 128x128x30");
    group.bench_function("without and with journal", |bencher| bencher.iter(&mut both));
    group.finish();
    let [without, with] = both();
    println!("with the journal: {:.3} of the time", with.as_secs_f64() / without.as_secs_f64());
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(1000));
    targets = rounds, journal
}
criterion_main!(benches);
