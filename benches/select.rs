//! Sweeps of a selection: pixels a second by norm, candidates and kernel, beside a straightforward
//! implementation of the same rule. Compare within one run.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use perceptile::KernelSpec;
use perceptile::gradient::simd::Simd;
use perceptile::kernel::KernelTaps;
use perceptile::select::{
    AnimationShape, Candidates, Filters, Frame, Norm, SelectOptions, SelectParallelism, SelectPlan,
    Selection,
};

const SIZE: usize = 128;
const FRAMES: usize = 24;
const SWEEPS: u32 = 8;

fn kernel(text: &str) -> KernelTaps {
    let spec: KernelSpec = text.parse().expect("a kernel");
    spec.resolve_without_tile().expect("a kernel").classes()[0].taps.clone()
}

/// A slope with noise.
fn animation(renders: usize) -> Vec<Frame> {
    let mut state = 1_u64;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as f32 / (1 << 24) as f32
    };
    let values = SIZE * SIZE * 3;
    (0..FRAMES)
        .map(|t| {
            let guide: Vec<f32> =
                (0..values).map(|i| 0.2 + 0.005 * ((i + t) % SIZE) as f32).collect();
            let mut noisy = || guide.iter().map(|value| 2.0 * value * uniform()).collect();
            Frame { renders: (0..renders).map(|_| noisy()).collect(), guide: guide.clone() }
        })
        .collect()
}

fn run(frames: &[Frame], filters: &Filters, subsets: bool, options: &SelectOptions) -> f64 {
    let shape = AnimationShape::new(SIZE, SIZE, frames.len(), 3).expect("a shape");
    let candidates = Candidates { renders: frames[0].renders.len(), subsets, half: false };
    let threads = rayon::current_num_threads();
    let parallelism = SelectParallelism { ranks: 1, workers: 0, threads };
    let plan = SelectPlan::new(shape, filters.clone(), candidates, *options, parallelism);
    let plan = plan.expect("a plan");
    let mut selection = Selection::new(&plan, Simd::detect()).expect("a selection");
    loop {
        selection.needed().for_each(|frame| selection.load(&frames[frame]));
        if !selection.advance(|_, picture, _| {
            black_box(picture);
        }) {
            return selection.scores().selection.plain;
        }
    }
}

/// The rule as it is written: for each pixel and candidate the objective over all pixels that see it.
/// Squares, every frame in memory, errors beyond the picture left out.
struct Straightforward<'a> {
    frames: &'a [Frame],
    taps: Vec<([i64; 3], f64)>,
    candidates: Vec<Vec<usize>>,
    error: Vec<f64>,
    current: Vec<f64>,
}

impl<'a> Straightforward<'a> {
    fn new(frames: &'a [Frame], kernel: &KernelTaps) -> Self {
        let taps = kernel.taps().iter();
        let taps =
            taps.map(|tap| (tap.offset.to_array().map(i64::from), tap.weight / kernel.sum()));
        let renders = frames[0].renders.len();
        let members = |subset: usize| (0..renders).filter(|k| subset >> k & 1 == 1).collect();
        let values = frames.len() * SIZE * SIZE * 3;
        let mut made = Self {
            frames,
            taps: taps.collect(),
            candidates: (1..1 << renders).map(members).collect(),
            error: vec![0.0; values],
            current: vec![0.0; values],
        };
        for at in 0..values {
            let e = made.value(at, 0) - made.guide(at);
            made.current[at] = e;
            made.spread(at, e);
        }
        made
    }

    fn guide(&self, at: usize) -> f64 {
        let values = SIZE * SIZE * 3;
        self.frames[at / values].guide[at % values].into()
    }

    fn value(&self, at: usize, candidate: usize) -> f64 {
        let values = SIZE * SIZE * 3;
        let members = &self.candidates[candidate];
        let render = |&k: &usize| f64::from(self.frames[at / values].renders[k][at % values]);
        members.iter().map(render).sum::<f64>() / members.len() as f64
    }

    /// Numbers whose error sees a number, and its weight there.
    fn seen(&self, at: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let size = SIZE as i64;
        let at = at as i64;
        let (x, y, c, t) =
            (at % size, at / size % size, at / size / size % 3, at / size / size / 3);
        self.taps.iter().filter_map(move |&([dx, dy, dt], weight)| {
            let (x, y, t) = (x - dx, y - dy, t - dt);
            let inside = (0..size).contains(&x) && (0..size).contains(&y);
            let inside = inside && (0..self.frames.len() as i64).contains(&t);
            inside.then_some(((((t * 3 + c) * size + y) * size + x) as usize, weight))
        })
    }

    fn spread(&mut self, at: usize, change: f64) {
        let seen: Vec<(usize, f64)> = self.seen(at).collect();
        for (to, weight) in seen {
            self.error[to] += change * weight;
        }
    }

    /// Visits one frame.
    fn sweep(&mut self, t: usize, lambda: f64) {
        let pixels = SIZE * SIZE;
        for pixel in 0..pixels {
            let places = [0, 1, 2].map(|c| (t * 3 + c) * pixels + pixel);
            let cost = |candidate: usize| -> f64 {
                let of = |&at: &usize| {
                    let e = self.value(at, candidate) - self.guide(at);
                    let change = e - self.current[at];
                    let seen = self.seen(at).map(|(to, weight)| {
                        let r = self.error[to] + change * weight;
                        r * r / (self.guide(to) * self.guide(to) + 0.01)
                    });
                    seen.sum::<f64>() + lambda * e * e / (self.guide(at) * self.guide(at) + 0.01)
                };
                places.iter().map(of).sum()
            };
            let costs: Vec<f64> = (0..self.candidates.len()).map(cost).collect();
            let best = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b]));
            let best = best.expect("candidates");
            for at in places {
                let e = self.value(at, best) - self.guide(at);
                let change = e - self.current[at];
                if change != 0.0 {
                    self.current[at] = e;
                    self.spread(at, change);
                }
            }
        }
    }
}

fn select(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("select");
    group.sample_size(10);
    let frames = animation(4);
    let default = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";
    let options = |norm| SelectOptions { norm, sweeps: SWEEPS, ..SelectOptions::default() };
    let visits = (SIZE * SIZE * FRAMES) as u64 * u64::from(SWEEPS);
    group.throughput(Throughput::Elements(visits));
    for (name, norm, subsets, text, alpha) in [
        ("L2, 15 subsets", Norm::L2, true, default, None),
        ("L2, 4 renders", Norm::L2, false, default, None),
        ("L2, 15 subsets, TAA 0.2", Norm::L2, true, default, Some(0.2)),
        ("L2, 15 subsets, FAST's kernel", Norm::L2, true, "gaussian(1) * gaussian_t(1)", None),
        ("L1, 15 subsets", Norm::L1, true, default, None),
    ] {
        let filters = Filters::new(kernel(text), alpha).expect("filters");
        assert!(run(&frames, &filters, subsets, &options(norm)) < 0.1);
        group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
            bencher.iter(|| run(&frames, &filters, subsets, &options(norm)));
        });
    }
    // One frame in the middle: it is slow.
    group.throughput(Throughput::Elements((SIZE * SIZE) as u64));
    let taps = kernel(default);
    group.bench_function("straightforward, 15 subsets", |bencher| {
        bencher.iter_batched(
            || Straightforward::new(&frames, &taps),
            |mut plain| plain.sweep(FRAMES / 2, 0.1),
            criterion::BatchSize::LargeInput,
        );
    });
    group.finish();
}

criterion_group!(benches, select);
criterion_main!(benches);
