//! The engine against the definition: sums over every pixel and tap in double precision.

use std::sync::Arc;

use glam::IVec3;
use perceptile_cluster::communicator::{Communicator, InProcess};
use proptest::prelude::*;

use super::mixture::Mixture;
use super::*;
use crate::draw::{Stream, Use};
use crate::gradient::simd::Simd;
use crate::kernel::Tap;

/// An animation in memory.
#[derive(Debug, Clone)]
struct Animation {
    shape: AnimationShape,
    frames: Vec<Frame>,
}

/// Everything that a selection says.
#[derive(Debug, Clone, PartialEq)]
struct Outcome {
    pictures: Vec<Vec<u32>>,
    choices: Vec<Vec<u8>>,
    scores: SelectScores,
    chosen: Vec<(String, u64)>,
    sweeps: Vec<(f32, u64)>,
}

impl Animation {
    /// A smooth reference, and renders with noise around it.
    fn new([width, height, frames, channels]: [usize; 4], renders: usize, seed: u64) -> Self {
        let shape = AnimationShape::new(width, height, frames, channels).unwrap();
        let mut stream = Stream::new(seed, Use::Baseline, 0, 0);
        let mut uniform = || stream.below(1 << 20) as f32 / (1 << 20) as f32;
        let frames = (0..frames).map(|t| {
            let value = |i: usize| {
                let (x, y) = (i % width, i / width % height);
                0.3 + 0.2 * ((x + t) as f32 * 0.4).sin() + 0.1 * (y as f32 * 0.3).cos()
            };
            let guide: Vec<f32> = (0..shape.values()).map(value).collect();
            let mut noisy = || guide.iter().map(|&value| 2.0 * value * uniform()).collect();
            Frame { renders: (0..renders).map(|_| noisy()).collect(), guide: guide.clone() }
        });
        Self { shape, frames: frames.collect() }
    }

    fn select(
        &self,
        filters: &Filters,
        subsets: bool,
        options: &SelectOptions,
        (simd, threads): (Simd, usize),
    ) -> Outcome {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| self.go_on(&mut self.selection(filters, subsets, options, simd)))
    }

    fn selection(
        &self,
        filters: &Filters,
        subsets: bool,
        options: &SelectOptions,
        simd: Simd,
    ) -> Selection {
        let threads = SelectParallelism { ranks: 1, workers: 0, threads: 8 };
        Selection::new(&self.plan(filters, subsets, options, threads), simd).unwrap()
    }

    fn plan(
        &self,
        filters: &Filters,
        subsets: bool,
        options: &SelectOptions,
        parallelism: SelectParallelism,
    ) -> SelectPlan {
        let renders = self.frames[0].renders.len();
        let candidates = Candidates { renders, subsets, half: false };
        SelectPlan::new(self.shape, filters.clone(), candidates, *options, parallelism).unwrap()
    }

    /// The same by ranks, of which the root gets all that there is.
    fn by_ranks(
        &self,
        plan: &SelectPlan,
        state: Option<&SelectState>,
    ) -> (Outcome, Vec<SelectState>) {
        let run = |communicator: InProcess| {
            let is_root = communicator.rank() == 0;
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            pool.install(|| {
                let mut selection =
                    Selection::of_ranks(plan, Simd::detect(), Arc::new(communicator)).unwrap();
                match state {
                    Some(state) if is_root => selection.restore(state.clone()).unwrap(),
                    Some(state) => selection.go_on_from(state.wave),
                    None => (),
                }
                let mut states = Vec::new();
                let outcome = self.follow(&mut selection, is_root, &mut states);
                (outcome, states)
            })
        };
        std::thread::scope(|scope| {
            let run = &run;
            let ranks: Vec<_> = InProcess::group(plan.parallelism().ranks)
                .into_iter()
                .map(|communicator| scope.spawn(move || run(communicator)))
                .collect();
            let outcomes: Vec<_> = ranks.into_iter().map(|rank| rank.join().unwrap()).collect();
            outcomes.into_iter().next().unwrap()
        })
    }

    /// All waves that are left.
    fn go_on(&self, selection: &mut Selection) -> Outcome {
        self.follow(selection, true, &mut Vec::new())
    }

    fn follow(
        &self,
        selection: &mut Selection,
        is_root: bool,
        states: &mut Vec<SelectState>,
    ) -> Outcome {
        let (mut pictures, mut choices) = (Vec::new(), Vec::new());
        loop {
            states.extend(selection.state());
            for frame in selection.needed() {
                if is_root { selection.load(&self.frames[frame]) } else { selection.receive() }
            }
            let more = selection.advance(|_, picture, choice| {
                pictures.push(picture.iter().map(|value| value.to_bits()).collect());
                choices.push(choice.to_vec());
            });
            if !more {
                break;
            }
        }
        Outcome {
            pictures,
            choices,
            scores: selection.scores(),
            chosen: selection.chosen().collect(),
            sweeps: selection.sweeps().collect(),
        }
    }

    /// ε at a pixel of a picture sequence, by the definition, and (G*I)² + 0.01 there.
    fn error(
        &self,
        filters: &Filters,
        picture: &impl Fn(usize, usize) -> f64,
        (t, c, y, x): (usize, usize, usize, usize),
    ) -> (f64, f64) {
        let [width, height, frames] =
            [self.shape.width(), self.shape.height(), self.shape.frames()].map(|n| n as i64);
        let through = |kernel: &KernelTaps, value: &dyn Fn(i64, usize) -> f64, same: bool| -> f64 {
            let taps = kernel.taps().iter().map(|tap| {
                let [dx, dy, dt] = tap.offset.to_array().map(i64::from);
                let (to_x, to_y) = (x as i64 + dx, y as i64 + dy);
                let (in_x, in_y) = (to_x.clamp(0, width - 1), to_y.clamp(0, height - 1));
                if !same && (in_x != to_x || in_y != to_y) {
                    return 0.0;
                }
                let pixel = (c as i64 * height + in_y) * width + in_x;
                tap.weight * scale(kernel) * value(t as i64 + dt, pixel as usize)
            });
            taps.sum()
        };
        let guide =
            |t: i64, i: usize| f64::from(self.frames[t.clamp(0, frames - 1) as usize].guide[i]);
        let difference = |t: i64, i: usize| match usize::try_from(t) {
            Ok(t) if t < frames as usize => picture(t, i) - guide(t as i64, i),
            _ => 0.0,
        };
        let seen = through(&filters.eye, &guide, true);
        let shift = match &filters.taa {
            Some(taa) => through(taa, &guide, true) - seen,
            None => 0.0,
        };
        (through(filters.render(), &difference, false) + shift, seen * seen + 0.01)
    }

    /// Every place of a number: frame, channel, row, column.
    fn places(&self) -> impl Iterator<Item = (usize, usize, usize, usize)> + use<> {
        let shape = self.shape;
        (0..shape.frames()).flat_map(move |t| {
            (0..shape.values()).map(move |i| {
                (t, i / shape.pixels(), i / shape.width() % shape.height(), i % shape.width())
            })
        })
    }

    /// The objective of choices.
    fn objective(
        &self,
        filters: &Filters,
        mixture: &Mixture,
        choices: &[Vec<u8>],
        (norm, lambda): (Norm, f64),
    ) -> f64 {
        let pixels = self.shape.pixels();
        let picture = |t: usize, i: usize| {
            let choice = usize::from(choices[t][i % pixels]);
            f64::from(mixture.value(choice, |k| self.frames[t].renders[k][i]))
        };
        let terms = self.places().map(|place| {
            let (t, c, y, x) = place;
            let i = (c * self.shape.height() + y) * self.shape.width() + x;
            let (error, square) = self.error(filters, &picture, place);
            let own = picture(t, i) - f64::from(self.frames[t].guide[i]);
            match norm {
                Norm::L2 => (error * error + lambda * own * own) / square,
                Norm::L1 => (error.abs() + lambda * own.abs()) / square.sqrt(),
            }
        });
        terms.sum()
    }
}

fn taps(weights: &[(i32, i32, i32, f64)]) -> KernelTaps {
    let tap = |&(x, y, t, weight)| Tap { offset: IVec3::new(x, y, t), weight };
    KernelTaps::new(weights.iter().map(tap)).unwrap()
}

/// 3×3 pixels and three frames, of which the oldest has a negative weight.
fn eye() -> KernelTaps {
    let space = [0.5, 1.0, 0.5];
    let time = [1.0, 0.7, -0.2];
    let mut weights = Vec::new();
    for (t, c) in time.iter().enumerate() {
        for (y, b) in space.iter().enumerate() {
            for (x, a) in space.iter().enumerate() {
                weights.push((x as i32 - 1, y as i32 - 1, -(t as i32), a * b * c));
            }
        }
    }
    taps(&weights)
}

fn options(norm: Norm, sweeps: u32, from: f64, to: f64) -> SelectOptions {
    SelectOptions { norm, sweeps, continuation: Continuation { from, to } }
}

const PLAIN: (fn() -> Simd, usize) = (Simd::plain, 1);

#[test]
fn no_sweep_raises_the_objective_at_any_lambda() {
    for (norm, channels, alpha) in [
        (Norm::L2, 3, None),
        (Norm::L1, 3, Some(0.5)),
        (Norm::L2, 1, Some(0.5)),
        (Norm::L1, 1, None),
    ] {
        let animation = Animation::new([7, 11, 5, channels], 3, 5);
        let filters = Filters::new(eye(), alpha).unwrap();
        let mixture = Mixture::subsets(3);
        for lambda in [1.0, 0.1, 0.0] {
            // All frames are in the window at once.
            let options = options(norm, 5, lambda, lambda);
            let mut selection = animation.selection(&filters, true, &options, Simd::detect());
            animation.frames.iter().for_each(|frame| selection.load(frame));
            selection.engine.prepare_all();
            let objective = |selection: &Selection| {
                let choices = selection.choices();
                animation.objective(&filters, &mixture, &choices, (norm, lambda))
            };
            // In the first sweep pixels get what they did not have: an error.
            (0..5).for_each(|frame| selection.engine.sweep(frame, 0));
            let mut before = objective(&selection);
            let start = before;
            for sweep in 1..5 {
                for frame in 0..5 {
                    selection.engine.sweep(frame, sweep);
                    let now = objective(&selection);
                    assert!(
                        now <= before * (1.0 + 1e-6),
                        "{norm:?} {lambda}: {now} after {before}"
                    );
                    before = now;
                }
            }
            assert!(before < start, "{before} of {start}");
        }
    }
}

#[test]
fn a_tiny_animation_is_as_good_as_the_best_of_all_choices() {
    let (mut found, mut best) = (0.0, 0.0);
    for seed in 0..20 {
        let animation = Animation::new([2, 2, 3, 1], 2, seed);
        let filters = Filters::new(eye(), None).unwrap();
        let mixture = Mixture::single(2);
        let outcome = animation.select(
            &filters,
            false,
            &options(Norm::L2, 12, 0.2, 0.0),
            (Simd::detect(), 1),
        );
        let goal = (Norm::L2, 0.0);
        let of = |choices: &[Vec<u8>]| animation.objective(&filters, &mixture, choices, goal);
        let all = (0..1_u32 << 12).map(|bits| {
            let choice = |t: u32| (0..4).map(|i| (bits >> (4 * t + i) & 1) as u8).collect();
            of(&(0..3).map(choice).collect::<Vec<_>>())
        });
        let least = all.fold(f64::INFINITY, f64::min);
        let chosen = of(&outcome.choices);
        assert!(chosen >= least * (1.0 - 1e-9), "the search is not complete");
        (found, best) = (found + chosen, best + least);
    }
    assert!(found <= 1.35 * best, "{found} for {best}");
}

#[test]
fn scores_are_those_of_the_definition() {
    for alpha in [None, Some(0.4)] {
        let animation = Animation::new([9, 6, 8, 3], 2, 3);
        let filters = Filters::new(eye(), alpha).unwrap();
        let outcome =
            animation.select(&filters, true, &SelectOptions::default(), (PLAIN.0(), PLAIN.1));
        let first = -filters.render().bounds().0.z as usize;
        let first = if first < 8 { first } else { 0 };
        let eye = Filters { taa: None, ..filters.clone() };
        let score = |filters: &Filters, picture: &dyn Fn(usize, usize) -> f64| {
            let places = animation.places().filter(|place| place.0 >= first);
            let (sum, count) = places.fold((0.0, 0.0), |(sum, count), place| {
                let (error, square) = animation.error(filters, &|t, i| picture(t, i), place);
                (sum + error * error / square, count + 1.0)
            });
            sum / count
        };
        let render = |k: usize| {
            let frames = &animation.frames;
            move |t: usize, i: usize| f64::from(frames[t].renders[k][i])
        };
        let chosen = |t: usize, i: usize| f64::from(f32::from_bits(outcome.pictures[t][i]));
        let mean = |t: usize, i: usize| (render(0)(t, i) + render(1)(t, i)) / 2.0;
        let SelectScores { selection, mean: of_mean, renders, .. } = &outcome.scores;
        let pictures: [&dyn Fn(usize, usize) -> f64; 4] = [&chosen, &mean, &render(0), &render(1)];
        for (found, picture) in
            [selection, of_mean, &renders[0], &renders[1]].into_iter().zip(pictures)
        {
            let right = score(&eye, picture);
            assert!((found.plain / right - 1.0).abs() < 2e-4, "{} for {right}", found.plain);
            if let Some(taa) = found.taa {
                let right = score(&filters, picture);
                assert!((taa / right - 1.0).abs() < 2e-4, "{taa} for {right}");
            }
            assert_eq!(found.taa.is_some(), alpha.is_some());
        }
        assert!(alpha.is_some() || selection.plain < of_mean.plain);
    }
}

#[test]
fn the_bytes_do_not_depend_on_threads_or_instructions() {
    for norm in [Norm::L2, Norm::L1] {
        let animation = Animation::new([70, 41, 6, 3], 3, 1);
        let filters = Filters::new(eye(), Some(0.5)).unwrap();
        let options = options(norm, 5, 0.2, 0.0);
        let one = animation.select(&filters, true, &options, (Simd::plain(), 1));
        for threads in [1, 2, 8] {
            let other = animation.select(&filters, true, &options, (Simd::detect(), threads));
            assert!(one == other, "{norm:?}, {threads} threads");
        }
        assert_eq!(one.chosen.iter().map(|(_, count)| count).sum::<u64>(), 70 * 41 * 6);
        assert_eq!(one.chosen.len(), 7);
    }
}

#[test]
fn a_selection_goes_on_from_its_choices() {
    for (norm, alpha) in [(Norm::L2, None), (Norm::L1, Some(0.6))] {
        let animation = Animation::new([9, 17, 3 * RENEWAL, 1], 2, 8);
        let filters = Filters::new(eye(), alpha).unwrap();
        let options = options(norm, 5, 0.2, 0.0);
        let whole = animation.select(&filters, true, &options, (Simd::detect(), 1));
        let mut selection = animation.selection(&filters, true, &options, Simd::detect());
        let mut states = Vec::new();
        loop {
            states.extend(selection.state());
            selection.needed().for_each(|frame| selection.load(&animation.frames[frame]));
            if !selection.advance(|_, _, _| ()) {
                break;
            }
        }
        assert_eq!(states.len(), 3);
        for state in states {
            let done = state.done();
            let bytes = perceptile_cluster::codec::encode(&state).unwrap();
            let state: SelectState =
                perceptile_cluster::codec::decode::<_, { 1 << 24 }>(&bytes).unwrap();
            let mut other = animation.selection(&filters, true, &options, Simd::plain());
            other.restore(state).unwrap();
            let rest = animation.go_on(&mut other);
            assert!(rest.pictures[..] == whole.pictures[done..]);
            assert_eq!(
                (rest.scores, rest.chosen, rest.sweeps),
                (whole.scores.clone(), whole.chosen.clone(), whole.sweeps.clone())
            );
        }
    }
}

#[test]
fn ranks_choose_what_one_process_chooses() {
    let tall = taps(&[(0, 0, 0, 1.0), (1, 5, -1, 0.5), (-2, -4, 0, 0.3), (0, 9, 1, 0.2)]);
    for (size, norm, alpha, kernel) in [
        ([13, 70, 7, 3], Norm::L2, None, eye()),
        ([9, 41, 5, 1], Norm::L1, Some(0.5), eye()),
        // The last strip is a single row.
        ([7, 33, 6, 3], Norm::L2, Some(0.4), eye()),
        ([11, 60, 6, 1], Norm::L2, None, tall),
        ([5, 34, 2 * RENEWAL, 1], Norm::L2, None, eye()),
    ] {
        let animation = Animation::new(size, 3, 4);
        let filters = Filters::new(kernel, alpha).unwrap();
        let options = options(norm, 4, 0.2, 0.0);
        let one = animation.select(&filters, true, &options, (Simd::detect(), 1));
        for ranks in 1..=4 {
            let parallelism = SelectParallelism { ranks, workers: 0, threads: 1 };
            let plan = animation.plan(&filters, true, &options, parallelism);
            let (whole, states) = animation.by_ranks(&plan, None);
            assert!(whole == one, "{size:?} on {ranks} ranks");
            // Any number of ranks goes on from what any other left.
            for state in states {
                let (rest, _) = animation.by_ranks(&plan, Some(&state));
                assert!(rest.pictures[..] == one.pictures[state.done()..]);
                assert_eq!((&rest.scores, &rest.sweeps), (&one.scores, &one.sweeps));
            }
        }
    }
}

#[test]
fn renders_of_half_floats_lose_nothing() {
    let mut animation = Animation::new([13, 20, 7, 3], 3, 4);
    for render in animation.frames.iter_mut().flat_map(|frame| &mut frame.renders) {
        render.iter_mut().for_each(|value| *value = half::f16::from_f32(*value).to_f32());
    }
    let filters = Filters::new(eye(), None).unwrap();
    let options = options(Norm::L2, 4, 0.2, 0.0);
    let single = animation.select(&filters, true, &options, (Simd::detect(), 2));
    let threads = SelectParallelism { ranks: 1, workers: 0, threads: 2 };
    let mut plan = animation.plan(&filters, true, &options, threads);
    let bytes = plan.foreseen().unwrap().0;
    plan.candidates.half = true;
    assert!(plan.foreseen().unwrap().0 < bytes);
    let mut selection = Selection::new(&plan, Simd::plain()).unwrap();
    assert!(animation.go_on(&mut selection) == single);
}

#[test]
fn the_state_of_another_selection_is_refused() {
    let animation = Animation::new([5, 5, 2 * RENEWAL, 1], 2, 8);
    let filters = Filters::new(eye(), None).unwrap();
    let mut selection =
        animation.selection(&filters, true, &SelectOptions::default(), Simd::detect());
    let state = loop {
        if let Some(state) = selection.state() {
            break state;
        }
        selection.needed().for_each(|frame| selection.load(&animation.frames[frame]));
        selection.advance(|_, _, _| ());
    };
    assert!(matches!(selection.restore(state.clone()), Err(SelectError::State)), "under way");
    let refuses = |animation: &Animation, subsets, options: &SelectOptions| {
        let mut other = animation.selection(&filters, subsets, options, Simd::detect());
        assert!(matches!(other.restore(state.clone()), Err(SelectError::State)));
    };
    refuses(&animation, true, &options(Norm::L2, 3, 0.2, 0.0));
    refuses(&animation, false, &SelectOptions::default());
    refuses(&Animation::new([5, 4, 2 * RENEWAL, 1], 2, 8), true, &SelectOptions::default());
    refuses(&Animation::new([5, 5, 3, 1], 2, 8), true, &SelectOptions::default());
}

#[test]
fn what_is_one_of_a_kind_works() {
    let filters = Filters::new(eye(), Some(0.3)).unwrap();
    for size in [[1, 1, 1, 1], [1, 9, 4, 3], [9, 1, 4, 3], [6, 5, 1, 3]] {
        for renders in [1, 2] {
            let animation = Animation::new(size, renders, 2);
            let outcome =
                animation.select(&filters, false, &SelectOptions::default(), (Simd::detect(), 2));
            assert_eq!(outcome.pictures.len(), size[2]);
            for (t, picture) in outcome.pictures.iter().enumerate() {
                let renders = &animation.frames[t].renders;
                let is_one = |(i, value): (usize, &u32)| {
                    let choice = outcome.choices[t][i % animation.shape.pixels()];
                    renders[usize::from(choice)][i].to_bits() == *value
                };
                assert!(picture.iter().enumerate().all(is_one), "{size:?}");
            }
        }
    }
    // Equal candidates: nothing changes, and the first is taken.
    let mut animation = Animation::new([6, 5, 3, 3], 1, 2);
    for frame in &mut animation.frames {
        frame.renders = vec![frame.renders[0].clone(); 3];
    }
    let outcome = animation.select(&filters, false, &SelectOptions::default(), (Simd::detect(), 1));
    assert!(outcome.choices.iter().flatten().all(|&choice| choice == 0));
    let changes: Vec<u64> = outcome.sweeps.iter().map(|&(_, changes)| changes).collect();
    assert!(changes[0] == 6 * 5 * 3 && changes[1..].iter().all(|&changes| changes == 0));
}

#[test]
fn what_cannot_be_is_refused() {
    assert!(AnimationShape::new(0, 1, 1, 1).is_err() && AnimationShape::new(1, 1, 0, 1).is_err());
    assert!(
        AnimationShape::new(1, 1, 1, 2).is_err()
            && AnimationShape::new(1 << 20, 1 << 20, 1, 1).is_err()
    );
    for alpha in [0.0, -1.0, 1.5, f64::NAN] {
        assert!(Filters::new(eye(), Some(alpha)).is_err());
    }
    let shape = AnimationShape::new(4, 4, 2, 1).unwrap();
    let filters = Filters::new(eye(), None).unwrap();
    let options = SelectOptions::default();
    let new = |renders, subsets, ranks| {
        let candidates = Candidates { renders, subsets, half: false };
        let parallelism = SelectParallelism { ranks, workers: 0, threads: 1 };
        SelectPlan::new(shape, filters.clone(), candidates, options, parallelism)
    };
    for (renders, subsets) in [(0, false), (65, false), (7, true)] {
        assert!(matches!(new(renders, subsets, 1), Err(SelectError::Renders { .. })));
    }
    assert!(new(64, false, 1).is_ok() && new(6, true, 1).is_ok());
    assert!(matches!(new(2, false, 2), Err(SelectError::Ranks { strips: 1, .. })));
}

#[test]
fn the_renderers_filter_follows_the_eyes() {
    let filters = Filters::new(taps(&[(0, 0, 0, 1.0)]), Some(0.25)).unwrap();
    let taa = filters.taa.unwrap();
    // 1 − 0.75ⁿ first passes 0.97 at n = 13.
    assert_eq!(taa.size(), [1, 1, 13]);
    for tap in taa.taps() {
        let right = 0.25 * 0.75_f64.powi(-tap.offset.z) / (1.0 - 0.75_f64.powi(13));
        assert!((tap.weight - right).abs() < 1e-12);
    }
    let alone = Filters::new(eye(), Some(1.0)).unwrap();
    assert_eq!(alone.taa.unwrap().size(), eye().size());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_kernel_ends_where_no_pixel_gains_by_a_change(
        size in (1_usize..7, 1_usize..7, 1_usize..5),
        weights in prop::collection::btree_map((-2..3_i32, -2..3_i32, -2..2_i32), -0.3..1.0_f64, 1..9),
        seed: u64,
        magnitudes: bool,
    ) {
        let tap = |((x, y, z), weight)| Tap { offset: IVec3::new(x, y, z), weight };
        let Ok(kernel) = KernelTaps::new(weights.into_iter().map(tap)) else { return Ok(()) };
        let animation = Animation::new([size.0, size.1, size.2, 1], 3, seed);
        let filters = Filters { eye: kernel, taa: None };
        let norm = if magnitudes { Norm::L1 } else { Norm::L2 };
        // Enough to come to rest.
        let options = options(norm, 60, 0.05, 0.05);
        let outcome = animation.select(&filters, false, &options, (Simd::detect(), 1));
        prop_assert_eq!(outcome.sweeps.last().unwrap().1, 0);
        let goal = (norm, 0.05);
        let mixture = Mixture::single(3);
        let of = |choices: &[Vec<u8>]| animation.objective(&filters, &mixture, choices, goal);
        let least = of(&outcome.choices);
        let mut choices = outcome.choices.clone();
        for t in 0..size.2 {
            for i in 0..size.0 * size.1 {
                for other in 0..3 {
                    choices[t][i] = other;
                    prop_assert!(of(&choices) >= least * (1.0 - 1e-5) - 1e-7);
                }
                choices[t][i] = outcome.choices[t][i];
            }
        }
    }
}
