//! The uniformity step: one smooth warp of the whole tile that makes its density uniform.
//!
//! Sliced transport on the bounded cube leaves its corners under-filled, a bias that no averaging
//! removes. The warp moves all samples of the tile as one point set: along the two axes of a
//! random frame in the plane of a pair of dimensions (or, in more than two, along a direction
//! through all, and so in other domains than the cube), it carries the distribution of projections
//! to the one of the uniform density, and does so again for many frames (iterative distribution
//! transfer, Pitié et al. 2005). The map depends on the place of a sample in the cube only, so
//! neighbours in the cube stay neighbours, and the error's distribution over pixels survives.
//!
//! A density on the square may have details that no projection resolves. There the second half of the
//! frames moves the samples' places, as samples of the square. (Alone it would have to move them
//! further, and then it tears neighbours apart at gaps and corners.)
//!
//! Distributions are integer histograms of fixed bins, which add up alike in one process and on
//! a cluster.

use std::ops::Range;
use std::sync::OnceLock;

use perceptile_cluster::shared::{Parts, Section};
use perceptile_cluster::{Ends, Worker};
use serde::{Deserialize, Serialize};

use crate::domain::{Domain, Surface};
use crate::draw::{Direction, DirectionSet, Stream, Use};
use crate::gradient::Targets;
use crate::gradient::simd::{Isa, Simd, Vectorized};
use crate::solver::histograms::{BINS, CHUNK, job_words, jobs};
use crate::solver::{Parallelism, Phase, Storage, faults, rounds};
use crate::tile::{MAX_DIMS, TileShape};

/// How the warp is done.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WarpOptions {
    /// Number of frames, in more than two dimensions for each other dimension that one has; twice as
    /// many are taken in other domains than the square, whose borders even out later. 0 leaves the
    /// tile as it is.
    pub frames: u32,
    /// Share of the way that samples go for each frame, in (0, 1].
    pub rate: f64,
}

impl WarpOptions {
    /// Frames in all: as many times as a dimension has partners, and twice that in other domains
    /// than the square.
    pub fn all_frames(&self, domain: Domain, dims: usize) -> u32 {
        let times = dims.saturating_sub(1).max(1) * if domain.is_square() { 1 } else { 2 };
        self.frames.saturating_mul(times as u32)
    }
}

/// Warps the tile towards uniform density; `shape` is that of the region that lies in the storage,
/// where [`Storage::into_tile`] finds it then. Of every pixel's samples each of the `layers` becomes
/// uniform by itself, and so does every prefix that is made of them. Before that, samples that are
/// where a density is empty leave there.
///
/// Each round moves the samples by one frame, from one section to another and back, and counts
/// them for the next frame. Ranks of a cluster add up what they count, and nothing else.
pub fn warp(
    worker: &Worker,
    storage: Storage,
    (shape, layers, domain): (TileShape, &[Range<usize>], Domain),
    options: WarpOptions,
    seed: u64,
    simd: Simd,
) -> Storage {
    let dims = shape.dims();
    let frames = options.all_frames(domain, dims);
    let mask = match domain.surface() {
        Surface::Mask(mask) => Some(mask),
        _ => None,
    };
    if frames == 0 && mask.is_none() {
        return storage;
    }
    let mut next_round = rounds::enter(Phase::Warp);
    let jobs = jobs(shape, Parallelism::of(worker).all_threads());
    let layers = Layers::new(layers);
    let job_words = job_words(layers.count);
    let points = shape.coordinates() / dims;
    let part = |job: usize| points * job / jobs * dims..points * (job + 1) / jobs * dims;
    let tile =
        |section: Section| section.parts::<f32>((0..jobs).map(|job| vec![part(job)]).collect());
    let Storage { work, samples, counts, first, second, objectives, owners, record } = storage;
    let mut tiles = [work, samples].map(tile);
    // Those of one frame are read while those of the next are made.
    let mut counts = counts.map(|section| {
        let part = |job: usize| std::iter::once(job * job_words..(job + 1) * job_words).collect();
        section.parts::<i64>((0..jobs).map(part).collect())
    });

    // From one section to the other and back, so that work that is done again finds what it found.
    let passes = if mask.is_some() { 2 } else { 0 };
    for pass in 0..passes {
        if worker.board().completed() < next_round {
            let [a, b] = &mut tiles;
            let (from, to) = if pass == 0 { (a, b) } else { (b, a) };
            let from = from.whole();
            worker.round(next_round, Ends::Half, 0..jobs, (to,), |job, (mut to,)| {
                let to = to.piece(0);
                to.copy_from_slice(&from[part(job.index())]);
                for point in to.as_chunks_mut::<2>().0 {
                    *point = mask.map_or(*point, |mask| mask.enter(*point));
                }
            });
        }
        next_round += 1;
    }
    let space = Space::new(domain, dims);
    // The frame after which it is places that are moved, if it is.
    let turn = if domain.is_warped_by_places() { frames / 2 } else { frames };
    let square = (turn < frames).then(|| Space::new(Domain::Square, dims));
    let space_of = |frame: u32| square.as_ref().filter(|_| frame > turn).unwrap_or(&space);
    // Those along which samples are moved in a frame, and counted in the one before.
    let axes_of = |frame: u32| -> Vec<Axis> {
        let Space { set, targets, .. } = space_of(frame + 1);
        let directions = directions(set, frame, &mut Stream::new(seed, Use::Warp, frame, 0));
        directions.into_iter().map(|direction| Axis::new(direction, targets)).collect()
    };
    let (mut before, mut now): (Vec<Axis>, _) = (Vec::new(), axes_of(0));
    // Frame 0 counts only, for the next one.
    let all = if frames == 0 { 0 } else { frames + 1 };
    for frame in 0..all {
        let round = next_round + u64::from(frame);
        if worker.board().completed() < round {
            let ([a, b], [even, odd]) = (&mut tiles, &mut counts);
            // The first frame to be counted is that of the tile as it was.
            let (from, to) = if frame % 2 == 1 || frame == 0 { (a, b) } else { (b, a) };
            let (seen, counts) = if frame % 2 == 1 { (even, odd) } else { (odd, even) };
            let (from, seen) = (from.whole(), seen.whole());
            let maps = OnceLock::new();
            let add_up = || -> Vec<i64> {
                let count = |bin: usize| seen[bin..].iter().step_by(job_words).take(jobs).sum();
                (0..job_words).map(count).collect()
            };
            let communicator = worker.communicator();
            let all_ranks = (frame > 0 && communicator.size() > 1).then(|| {
                let mut sums = add_up();
                communicator.sum(&mut sums);
                sums
            });
            let make_maps = || -> Vec<Vec<f32>> {
                let sums = all_ranks.clone().unwrap_or_else(add_up);
                let targets = &space_of(frame).targets;
                let axes = before.iter().zip(sums.chunks(BINS * layers.count));
                axes.map(|(axis, sums)| {
                    let of_layers = sums.chunks(BINS);
                    of_layers.flat_map(|of| axis.displacements(targets, of, options.rate)).collect()
                })
                .collect()
            };
            worker.round(round, Ends::Half, 0..jobs, (to, counts), |job, (mut to, mut counts)| {
                let (to, counts) = (to.piece(0), counts.piece(0));
                counts.fill(0);
                let part = part(job.index());
                let mut sample = part.start / dims;
                let mut places = Vec::new();
                let from = &from[part];
                let chunk = CHUNK / dims * dims;
                for (to, from) in to.chunks_mut(chunk).zip(from.chunks(chunk)) {
                    let layers = layers.from(sample);
                    sample += from.len() / dims;
                    let mut points = from;
                    if frame > 0 {
                        // Made by who holds a job, so that the counts cannot change meanwhile.
                        let maps = maps.get_or_init(make_maps);
                        to.copy_from_slice(from);
                        if square.is_some() && frame == turn + 1 {
                            domain.to_places(to);
                        }
                        let place = (space_of(frame).surface, dims);
                        simd.run(Move { axes: &before, maps, place, layers, points: to });
                        points = to;
                    }
                    if square.is_some() && frame == turn {
                        places.clear();
                        places.extend_from_slice(points);
                        domain.to_places(&mut places);
                        points = &places;
                    }
                    worker.fault(faults::WARP);
                    let of_axes = counts.chunks_mut(BINS * layers.count);
                    for (axis, counts) in now.iter().zip(of_axes) {
                        simd.run(Count { axis, dims, layers, points, counts });
                    }
                    if square.is_some() && frame == frames {
                        domain.to_points(to);
                    }
                }
            });
        }
        before = std::mem::replace(&mut now, axes_of(frame + 1));
    }
    let [work, samples] = tiles.map(Parts::into_section);
    Storage {
        work,
        samples,
        counts: counts.map(Parts::into_section),
        first,
        second,
        objectives,
        owners,
        record,
    }
}

/// What samples are moved in.
struct Space {
    set: DirectionSet,
    targets: Targets,
    surface: Surface,
}

impl Space {
    fn new(domain: Domain, dims: usize) -> Self {
        let set = DirectionSet::new(domain, dims);
        Self { targets: Targets::new(&set), set, surface: domain.surface() }
    }
}

/// The layers of a pixel's samples.
struct Layers {
    count: usize,
    /// The layer of each sample of a pixel; one for all, if there is one.
    of_samples: Vec<usize>,
}

/// The layers of samples that lie one after the other.
#[derive(Clone, Copy)]
struct LayersFrom<'a> {
    count: usize,
    of_samples: &'a [usize],
    /// Number of the first sample in its pixel.
    first: usize,
}

impl Layers {
    fn new(layers: &[Range<usize>]) -> Self {
        let of_samples =
            layers.iter().enumerate().flat_map(|(i, layer)| layer.clone().map(move |_| i));
        let of_samples = if layers.len() == 1 { vec![0] } else { of_samples.collect() };
        Self { count: layers.len(), of_samples }
    }

    /// The layers of the samples from one of them on.
    fn from(&self, sample: usize) -> LayersFrom<'_> {
        let first = sample % self.of_samples.len();
        LayersFrom { count: self.count, of_samples: &self.of_samples, first }
    }
}

impl LayersFrom<'_> {
    /// The layer of each sample.
    #[inline(always)]
    fn each(self) -> impl Iterator<Item = usize> {
        let mut next = self.first;
        std::iter::from_fn(move || {
            let layer = self.of_samples[next];
            next = if next + 1 == self.of_samples.len() { 0 } else { next + 1 };
            Some(layer)
        })
    }
}

/// The directions of a frame: a right angle in the plane of a pair of dimensions, or, in more
/// than two dimensions every other time, one direction through all of them.
fn directions(set: &DirectionSet, frame: u32, stream: &mut Stream) -> Vec<Direction> {
    let u = stream.unit();
    let dims = set.dims();
    if dims == 1 || (dims > 2 && (frame % 2 == 1 || !set.domain().is_square())) {
        return vec![set.any(u, stream)];
    }
    let first = set.random_pair(u, stream);
    vec![first, set.across(&first)]
}

/// A direction with the ends of its projections.
struct Axis {
    direction: Direction,
    low: f32,
    length: f32,
    /// Bins per unit.
    density: f32,
}

impl Axis {
    fn new(direction: Direction, targets: &Targets) -> Self {
        let (low, length) = targets.extent(&direction);
        Self { direction, low, length, density: BINS as f32 / length }
    }

    /// Place of a point among the bins.
    #[inline(always)]
    fn place(&self, point: &[f32]) -> f32 {
        let mut projection = 0.0;
        for (k, &x) in point.iter().enumerate() {
            projection += self.direction.theta[k] * x;
        }
        ((projection - self.low) * self.density).clamp(0.0, BINS as f32)
    }

    /// How far to move the points at the edges of the bins.
    fn displacements(&self, targets: &Targets, counts: &[i64], rate: f64) -> Vec<f32> {
        let total: i64 = counts.iter().sum();
        let mut below = 0_i64;
        let mut at_edge = |edge: usize| {
            let u = below as f64 / total.max(1) as f64;
            if let Some(count) = counts.get(edge) {
                below += count;
            }
            let place = f64::from(self.length) * edge as f64 / BINS as f64;
            (rate * targets.displacement(&self.direction, u, place)) as f32
        };
        (0..=BINS).map(&mut at_edge).collect()
    }
}

/// Adds points to the histogram along an axis.
struct Count<'a> {
    axis: &'a Axis,
    dims: usize,
    layers: LayersFrom<'a>,
    points: &'a [f32],
    counts: &'a mut [i64],
}

impl Vectorized for Count<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (point, layer) in self.points.chunks_exact(self.dims).zip(self.layers.each()) {
            let bin = (self.axis.place(point) as usize).min(BINS - 1);
            self.counts[layer * BINS + bin] += 1;
        }
    }
}

/// Moves points along all axes at once.
struct Move<'a> {
    axes: &'a [Axis],
    /// For each axis, the displacements of each layer one after the other.
    maps: &'a [Vec<f32>],
    /// Where samples live, and their dimensions.
    place: (Surface, usize),
    layers: LayersFrom<'a>,
    points: &'a mut [f32],
}

impl Vectorized for Move<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let (surface, dims) = self.place;
        for (point, layer) in self.points.chunks_exact_mut(dims).zip(self.layers.each()) {
            let mut moved = [0.0_f32; MAX_DIMS];
            let moved = &mut moved[..dims];
            moved.copy_from_slice(point);
            for (axis, map) in self.axes.iter().zip(self.maps) {
                let map = &map[layer * (BINS + 1)..][..BINS + 1];
                let place = axis.place(point);
                let bin = (place as usize).min(BINS - 1);
                let f = place - bin as f32;
                let by = map[bin] + (map[bin + 1] - map[bin]) * f;
                for (x, theta) in moved.iter_mut().zip(axis.direction.theta) {
                    *x += by * theta;
                }
            }
            surface.settle(point, moved, dims);
            point.copy_from_slice(moved);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::tests::densities;
    use crate::metric::histogram;
    use crate::solver::{Samples, StoragePlan};
    use crate::tile::{Partition, Reach, Region, Tile, clamp_coordinate};

    /// Points of the additive recurrence of the generalised golden ratio: far more even than
    /// random ones, so that what is left of a density's unevenness can be seen.
    fn even(count: usize, dims: usize) -> Vec<f64> {
        let mut root = 2.0_f64;
        (0..60).for_each(|_| root = (1.0 + root).powf(1.0 / (dims as f64 + 1.0)));
        (0..count * dims)
            .map(|i| (0.5 + (i / dims) as f64 * root.powi(-((i % dims) as i32 + 1))).fract())
            .collect()
    }

    fn warped(points: &[f64], dims: usize, options: WarpOptions) -> Samples {
        let words: Vec<f32> = points.iter().map(|&x| clamp_coordinate(x as f32)).collect();
        warp_words(&words, dims, options, Simd::detect())
    }

    fn warp_words(words: &[f32], dims: usize, options: WarpOptions, simd: Simd) -> Samples {
        let one = std::slice::from_ref(&(0..1));
        warp_layers(words, (dims, Domain::Square), options, one, simd)
    }

    fn warp_layers(
        words: &[f32],
        (dims, domain): (usize, Domain),
        options: WarpOptions,
        layers: &[Range<usize>],
        simd: Simd,
    ) -> Samples {
        let spp = layers.last().map_or(1, |layer| layer.end);
        let shape = TileShape::new(words.len() / dims / spp, 1, 1, spp, dims).unwrap();
        let partition = Partition::new(shape, Reach::default());
        let plan = StoragePlan::new(&partition, Region::whole(shape), Parallelism::threads());
        let plan = plan.with_layers(layers.len());
        let (worker, mut storage) = plan.private().unwrap();
        storage.tile_mut(shape).copy_from_slice(words);
        let storage = warp(&worker, storage, (shape, layers, domain), options, 3, simd);
        let tile = storage.into_tile(options.all_frames(domain, dims));
        Samples { words: tile.slice()[..words.len()].to_vec() }
    }

    /// Rms of the shares of 16 strata (one dimension) or of 16×16 cells (each pair) against 1.
    fn unevenness(samples: &Samples, dims: usize) -> f64 {
        if dims == 1 {
            let mut counts = [0_u32; 16];
            samples.words.iter().for_each(|x| counts[(x * 16.0) as usize] += 1);
            let share = |count: &u32| f64::from(*count) * 16.0 / samples.words.len() as f64;
            let square: f64 = counts.iter().map(|count| (share(count) - 1.0).powi(2)).sum();
            return (square / 16.0).sqrt();
        }
        let shape = TileShape::new(samples.words.len() / dims, 1, 1, 1, dims).unwrap();
        histogram(&Tile::new(shape, samples.words.clone()).unwrap()).rms
    }

    const OPTIONS: WarpOptions = WarpOptions { frames: 300, rate: 0.5 };

    #[test]
    fn densities_become_uniform() {
        // Emptied corners, as the descent leaves them, and a density that leans to one side.
        let corners = |x: f64| x + 0.04 * (std::f64::consts::TAU * x).sin();
        let leaning = |x: f64| x.powf(1.3);
        for dims in [1, 2, 3] {
            let points = even(1 << 16, dims);
            for bend in [&corners as &dyn Fn(f64) -> f64, &leaning] {
                let bent: Vec<f64> = points.iter().map(|&x| bend(x)).collect();
                let before =
                    unevenness(&warped(&bent, dims, WarpOptions { frames: 0, ..OPTIONS }), dims);
                let after = unevenness(&warped(&bent, dims, OPTIONS), dims);
                // Random points would have 0.016 on a line and 0.062 in a plane.
                let most = [0.01, 0.03, 0.045][dims - 1];
                assert!(before > 0.15 && after < most, "{dims}: {before} -> {after}");
            }
        }
    }

    /// A density's places are as even as the square's samples, and no sample is where it is empty.
    #[test]
    fn densities_become_even_in_their_own_cells() {
        let bend = |x: f64| (x + 0.03 * (std::f64::consts::TAU * x).sin()).powf(1.1);
        for domain in densities() {
            let mut words: Vec<f32> = even(1 << 16, 2).iter().map(|&x| bend(x) as f32).collect();
            domain.to_points(&mut words);
            let cells = |samples: &Samples| {
                let mut places = samples.words.clone();
                domain.to_places(&mut places);
                unevenness(&Samples { words: places }, 2)
            };
            let of = |frames: u32| {
                let options = WarpOptions { frames, ..OPTIONS };
                let one = std::slice::from_ref(&(0..1));
                warp_layers(&words, (2, domain), options, one, Simd::detect())
            };
            let (before, after) = (of(0), of(OPTIONS.frames));
            assert!(cells(&before) > 0.15, "{domain}: {}", cells(&before));
            assert!(cells(&after) < 0.045, "{domain}: {}", cells(&after));
            let mut back = after.words.clone();
            domain.surface().bring_all_back(&mut back, 2);
            assert_eq!(back, after.words, "{domain}");
        }
    }

    /// Samples of a pixel that lean to different sides: together they are far more even than apart.
    #[test]
    fn every_layer_becomes_uniform() {
        let points = even(1 << 16, 2);
        let bend = |(i, x): (usize, &f64)| x.powf(if i % 6 < 2 { 1.3 } else { 0.85 });
        let words: Vec<f32> = points.iter().enumerate().map(bend).map(|x| x as f32).collect();
        let words = &words[..words.len() / 6 * 6];
        let layers = [0..1, 1..3];
        let place = (2, Domain::Square);
        let samples = warp_layers(words, place, OPTIONS, &layers, Simd::detect());
        for layer in layers {
            let of_layer = |words: &[f32]| {
                let pixels = words.chunks_exact(6);
                let words = pixels.flat_map(|pixel| &pixel[2 * layer.start..2 * layer.end]);
                unevenness(&Samples { words: words.copied().collect() }, 2)
            };
            let (before, after) = (of_layer(words), of_layer(&samples.words));
            assert!(before > 0.15 && after < 0.03, "{layer:?}: {before} -> {after}");
        }
    }

    #[test]
    fn what_is_uniform_stays_nearly_where_it_is() {
        for dims in [1, 2, 3] {
            let points = even(1 << 15, dims);
            let samples = warped(&points, dims, OPTIONS);
            let moves =
                || points.iter().zip(&samples.words).map(|(x, &y)| (x - f64::from(y)).abs());
            let furthest = moves().fold(0.0, f64::max);
            let rms = (moves().map(|x| x * x).sum::<f64>() / points.len() as f64).sqrt();
            assert!(furthest < 0.04 && rms < 0.008, "{dims}: {furthest} {rms}");
        }
    }

    #[test]
    fn order_along_a_line_survives() {
        let bent: Vec<f64> = even(1 << 14, 1).iter().map(|x| x * x).collect();
        let samples = warped(&bent, 1, OPTIONS);
        let mut pairs: Vec<(f64, f32)> = bent.into_iter().zip(samples.words).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert!(pairs.windows(2).all(|pair| pair[0].1 <= pair[1].1));
    }

    #[test]
    fn anything_stays_in_the_cube() {
        for words in [vec![0.0; 64], vec![crate::tile::BELOW_ONE; 64], vec![0.3]] {
            for dims in [1, 2, 4] {
                let samples = warp_words(&words.repeat(dims), dims, OPTIONS, Simd::plain());
                assert!(samples.words.iter().all(|x| (0.0..1.0).contains(x)));
            }
        }
    }
}
