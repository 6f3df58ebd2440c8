//! A polish beyond the paper: full-batch descent on the energy distance of all kernels at once.
//!
//! The perceived squared error of all half-planes together is an energy distance,
//!
//! E = −½ Σᵢⱼ Gᵢⱼ |xᵢ − xⱼ| + Σᵢ V(xᵢ) ΣG,
//!
//! with G the autocorrelation of the kernel over pixel offsets and V(x) the mean distance from x
//! to the square (Székely and Rizzo 2004 for the distance). It has neither sorting nor noise,
//! and needs only neighbours within twice the kernel's reach. Mixtures add up their G. An axis
//! term, the same energy of single coordinates, adds what axis-aligned edges see. In more than
//! two dimensions the energy is summed over all pairs of dimensions.
//!
//! In other domains than the square |xᵢ − xⱼ| is the chord between two points in all their
//! dimensions: on a sphere it adds up the errors of all caps (Stolarsky 1973). There is no term of
//! single coordinates where the axes are directions like others; in a density it counts the share
//! between two coordinates instead of their distance.
//!
//! Every sample's gradient is summed by one thread in the order of the offsets, so no order of
//! execution can change it.

use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::sync::Arc;

use glam::IVec3;
use perceptile_cluster::shared::{MapError, Parts, Section, Words};
use perceptile_cluster::{Ends, Worker};
use serde::{Deserialize, Serialize};

use crate::domain::{Attraction, Domain, Plane, Pull, Surface};
use crate::format::numbers::{ArraySource, NumberSink};
use crate::gradient::simd::{Isa, Simd, Vectorized};
use crate::kernel::KernelClass;
use crate::solver::adam::AdamOptions;
use crate::solver::rounds::{self, Part};
use crate::solver::state::{Line, State, by_line};
use crate::solver::storage::{Objectives, Record, Storage, StoragePlan};
use crate::solver::{Parallelism, Phase, Samples, faults};
use crate::tile::{Cell, Partition, Reach, Regions, Rows, TileShape, Window};

/// How the polish is done.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PolishOptions {
    /// Full-batch steps; 0 leaves the tile as it is.
    pub steps: u32,
    /// Weight of the energy of single coordinates against that of pairs, at least 0.
    pub axis_weight: f64,
    /// Weight of the squared mean of single coordinates (−½|xᵢ − xⱼ|² in place of the distance),
    /// at least 0.
    pub linear_weight: f64,
    /// How Adam moves the samples.
    pub adam: AdamOptions,
}

/// Offsets whose weight is smaller, against that of a sample with itself, are left out: of the
/// default kernel's they are half, with 1.3 % of the sum of all weights.
const LEAST_WEIGHT: f64 = 0.005;

/// Samples of a row that are worked on together.
const LANES: usize = 8;

/// Lines of the tile that a thread works on at a time, in all frames.
const BAND: usize = 8;

/// At which offsets samples see each other, and with what weight.
///
/// Two samples see each other through all classes whose prefix has both, so the one that comes later
/// in its pixel says through which.
#[derive(Debug, Clone)]
struct Sight {
    /// The offsets of each layer with their weights, sorted by place; times are from 0 to the tile's
    /// frames.
    layers: Vec<Vec<(IVec3, f64)>>,
    /// The layer of each sample of a pixel.
    of_samples: Vec<usize>,
}

impl Sight {
    /// All offsets of a mixture of kernels whose weight, against that of a sample with itself, is at
    /// least `least`.
    fn new(classes: &[KernelClass], shape: TileShape, least: f64) -> Self {
        let spp = shape.spp();
        // How much each class has to say for the pairs whose later sample is number m. The energy of
        // a prefix of k samples has k² pairs, and independent samples have an error of 1/k.
        let share = |class: &KernelClass, m: usize| -> f64 {
            let shares = class.prefix.map_or_else(|| vec![(spp, 1.0)], |prefix| prefix.shares(spp));
            let seen = shares.into_iter().filter(|&(samples, _)| samples > m);
            let sum: f64 = seen.map(|(samples, share)| share * spp as f64 / samples as f64).sum();
            class.weight * sum
        };
        let shares = |m: usize| classes.iter().map(|class| share(class, m)).collect();
        let all: Vec<Vec<f64>> = (0..spp).map(shares).collect();
        let same = || all.chunk_by(PartialEq::eq);
        let of_samples = same().enumerate().flat_map(|(i, same)| vec![i; same.len()]).collect();
        let layers = same().map(|same| layer(classes, &same[0], shape.frames(), least)).collect();
        Self { layers, of_samples }
    }

    /// How far it reaches in x and y.
    fn reach(&self) -> Reach {
        let places = || self.layers.iter().flatten().map(|(place, _)| place);
        let far = |of: fn(&IVec3) -> i32| places().map(of).max().unwrap_or(0).max(0) as usize;
        Reach { left: far(|o| -o.x), right: far(|o| o.x), up: far(|o| -o.y), down: far(|o| o.y) }
    }

    /// For each sample of a pixel, the sum of the weights of all samples that it sees, for the
    /// gradient of the uniform density.
    fn totals(&self) -> Vec<f32> {
        let sum = |layer: &Vec<(IVec3, f64)>| layer.iter().map(|(_, g)| g).sum();
        let sums: Vec<f64> = self.layers.iter().map(sum).collect();
        let spp = self.of_samples.len();
        let total =
            |s: usize| -> f64 { (0..spp).map(|other| sums[self.of_samples[s.max(other)]]).sum() };
        (0..spp).map(|s| total(s) as f32).collect()
    }
}

/// Σ over classes of share · autocorrelation, each scaled to 1 at offset 0, without what is smaller
/// than `least` of that.
fn layer(classes: &[KernelClass], shares: &[f64], frames: usize, least: f64) -> Vec<(IVec3, f64)> {
    let mut sums = BTreeMap::<(i32, i32, i32), f64>::new();
    for (class, share) in classes.iter().zip(shares).filter(|(_, share)| **share > 0.0) {
        let (taps, square) = (class.taps.taps(), class.taps.power());
        for (a, b) in taps.iter().flat_map(|a| taps.iter().map(move |b| (a, b))) {
            let o = b.offset - a.offset;
            let place = (o.z.rem_euclid(frames as i32), o.y, o.x);
            *sums.entry(place).or_default() += share * a.weight * b.weight / square;
        }
    }
    let least = least * shares.iter().sum::<f64>();
    let all = sums.into_iter().filter(|(_, g)| g.abs() >= least);
    all.map(|((t, y, x), g)| (IVec3::new(x, y, t), g)).collect()
}

/// Full-batch descent on the energy.
pub struct Polish {
    worker: Arc<Worker>,
    options: PolishOptions,
    simd: Simd,
    state: State,
    sight: Sight,
    /// For each sample of a pixel, Σ over all pairs of weights, for the gradient of the uniform
    /// density.
    totals: Vec<f32>,
    pull: Pull,
    surface: Surface,
    /// Downhill gradient in the order of the rows, without copies.
    gradients: Parts<f32>,
    /// The lines that are worked on together, of which the first so many see nobody else's
    /// samples.
    bands: Vec<Range<usize>>,
    inside: usize,
    objectives: Arc<Objectives>,
    owners: Arc<Words>,
    record: Arc<Record>,
    counts: [Section; 2],
}

impl Polish {
    /// Prepares the descent from `samples` for a mixture of kernels with weights, by the threads
    /// of the current pool.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn alone(
        shape: TileShape,
        classes: &[KernelClass],
        options: PolishOptions,
        simd: Simd,
        samples: &Samples,
    ) -> Result<Self, MapError> {
        let sight = Sight::new(classes, shape, LEAST_WEIGHT);
        Self::with_sight((shape, Domain::Square), sight, options, simd, samples)
    }

    fn with_sight(
        (shape, domain): (TileShape, Domain),
        sight: Sight,
        options: PolishOptions,
        simd: Simd,
        samples: &Samples,
    ) -> Result<Self, MapError> {
        let regions = Regions::whole(shape);
        let partition = Partition::new(shape, Reach::default());
        let plan = StoragePlan::new(&partition, regions.own(), Parallelism::threads());
        let (worker, mut storage) = plan.with_polish(sight.reach()).private()?;
        storage.tile_mut(shape).copy_from_slice(&samples.words);
        Ok(Self::on(worker, storage, (&regions, domain), sight, options, (simd, 0)))
    }

    /// Prepares the descent in a domain from the samples of a region that lie in the storage, by all ranks of
    /// a worker and of its communicator; from step `first_step` on. After step 0, it goes on with the
    /// moments that are there.
    pub fn enter(
        worker: Arc<Worker>,
        storage: Storage,
        (regions, domain): (&Regions, Domain),
        classes: &[KernelClass],
        options: PolishOptions,
        (simd, first_step): (Simd, u32),
    ) -> Self {
        let sight = Sight::new(classes, regions.own().tile(), LEAST_WEIGHT);
        Self::on(worker, storage, (regions, domain), sight, options, (simd, first_step))
    }

    fn on(
        worker: Arc<Worker>,
        storage: Storage,
        (regions, domain): (&Regions, Domain),
        sight: Sight,
        options: PolishOptions,
        (simd, first_step): (Simd, u32),
    ) -> Self {
        let (shape, reach, totals) = (regions.own().shape(), sight.reach(), sight.totals());
        let Storage { samples, first, second, work, counts, objectives, owners, record } = storage;
        let sections = [samples, first, second];
        let line = shape.coordinates() / shape.height();
        let seen = (regions, reach);
        let state = State::enter(&worker, Phase::Polish, seen, sections, work.slice(), first_step);
        let mut bands: Vec<Range<usize>> =
            (0..shape.height()).step_by(BAND).map(|y| y..(y + BAND).min(shape.height())).collect();
        // Those that see samples of others come last.
        let place = regions.own().place();
        let touches = |band: &Range<usize>| {
            let lines = Cell { y: place.y + band.start, height: band.len(), ..place };
            state.halo.touches(Window::of(lines, reach))
        };
        bands.sort_by_key(touches);
        let inside = bands.iter().take_while(|band| !touches(band)).count();
        let part = |band: &Range<usize>| std::iter::once(band.start * line..band.end * line);
        Self {
            worker,
            options,
            simd,
            state,
            sight,
            totals,
            pull: domain.pull(),
            surface: domain.surface_on_the_way(),
            gradients: work.parts(bands.iter().map(|band| part(band).collect()).collect()),
            bands,
            inside,
            objectives,
            owners,
            record,
            counts,
        }
    }

    /// Hands the samples on to the next phase.
    pub fn leave(self) -> Storage {
        let Self { worker, state, gradients, objectives, owners, record, counts, .. } = self;
        let shape = state.rows.shape();
        let words = state.rows.own() * shape.frames();
        let mut plain = by_line(gradients.into_section(), words, shape.height());
        let [samples, first, second] = state.leave(&worker, Phase::Polish, &mut plain);
        let work = plain.into_section();
        Storage { samples, first, second, work, counts, objectives, owners, record }
    }

    /// Does step number `step`.
    pub fn step(&mut self, step: u32) {
        self.gradients(step);
        let Self { worker, options, simd, state, gradients, surface, .. } = self;
        let factors = options.adam.factors(step, options.steps, 1.0);
        let slots = state.slots;
        let turns = slots.turns(step);
        state.step = step + 1;
        let (rows, shards) = state.shards();
        let (frames, own, height) = (rows.shape().frames(), rows.own(), rows.shape().height());
        let gradients = gradients.whole();
        let round = rounds::step(Phase::Polish, step, Part::Update);
        worker.round(round, Ends::Step, 0..height, shards, |job, shards| {
            let mut line = Line::new((rows, slots), shards, job.units_done());
            for t in job.units_done()..frames {
                let row = job.index() * frames + t;
                line.update(
                    (worker, job),
                    (t, turns),
                    (factors, *surface),
                    &gradients[row * own..][..own],
                    *simd,
                );
            }
        });
        state.send(worker);
    }

    /// Goes on from other samples, with the moments as they are; for a polish of one rank.
    pub fn replace(&mut self, samples: &Samples) {
        self.state.replace(&samples.words);
    }

    /// The samples as of the last step.
    pub fn samples(&self) -> Samples {
        Samples { words: self.state.line_order() }
    }

    fn gradients(&mut self, step: u32) {
        let (inside, all) = (self.inside, self.bands.len());
        if self.worker.communicator().size() > 1 {
            self.gradients_of_bands(step, Part::Early, 0..inside);
            self.state.receive(&self.worker);
            self.gradients_of_bands(step, Part::Gradient, inside..all);
        } else {
            self.gradients_of_bands(step, Part::Gradient, 0..all);
        }
    }

    fn gradients_of_bands(&mut self, step: u32, part: Part, which: Range<usize>) {
        let Self { worker, state, sight, pull, gradients, simd, options, .. } = self;
        let (bands, totals) = (&self.bands, &self.totals);
        let rows = &state.rows;
        let samples = state.samples.whole();
        let shape = rows.shape();
        let PolishOptions { axis_weight, linear_weight, .. } = *options;
        let terms = Terms { axis: axis_weight as f32, linear: linear_weight as f32 };
        let round = rounds::step(Phase::Polish, step, part);
        worker.round(round, Ends::Half, which, (gradients,), |job, (mut gradients,)| {
            let (band, gradients) = (&bands[job.index()], gradients.piece(0));
            state.halo.progress();
            let planes = Planes::new(rows, samples, band.start, band.len());
            gradients.fill(0.0);
            for t in 0..shape.frames() {
                let layers: Vec<Layer> =
                    sight.layers.iter().map(|layer| planes.layer(layer, t)).collect();
                let (planes, of_samples) = (&planes, sight.of_samples.as_slice());
                let frame = Frame { t, shape, planes, layers, of_samples, terms, totals, pull };
                simd.run(FrameJob { frame, gradients: &mut *gradients });
                worker.fault(faults::GRADIENT);
            }
        });
    }
}

impl ArraySource for Polish {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self.state.array(index).into_iter().try_for_each(|piece| sink.put(piece))
    }
}

/// How far samples of a mixture of kernels see each other in the polish.
pub fn sight(classes: &[KernelClass], shape: TileShape) -> Reach {
    Sight::new(classes, shape, LEAST_WEIGHT).reach()
}

/// Samples of a band of lines and around it, taken apart: one plane for each number of a pixel,
/// in the order `(t, y, x)`.
struct Planes {
    words: Vec<Vec<f32>>,
    reach: Reach,
    /// Columns and rows, halo included.
    width: usize,
    height: usize,
    frames: usize,
}

/// Whom the samples of a frame see in a layer: how far each neighbour's word is from that of a pixel,
/// with its weight; and the weight of other samples of the pixel itself.
struct Layer {
    words: Vec<(i32, f32)>,
    own: f32,
}

impl Planes {
    /// The planes of `lines` lines from `y` on.
    fn new(rows: &Rows, samples: &[f32], y: usize, lines: usize) -> Self {
        let (pixel, frames, reach) = (rows.pixel(), rows.shape().frames(), rows.reach());
        let (width, height) = (rows.stride() / pixel, reach.up + lines + reach.down);
        // Room behind the last row for lanes that run over it.
        let size = width * height * frames + LANES;
        let mut words = vec![vec![0.0; size]; pixel];
        for t in 0..frames {
            for j in 0..height {
                let row = &samples[(y + j) * rows.line() + t * rows.stride()..][..rows.stride()];
                for (k, plane) in words.iter_mut().enumerate() {
                    let to = &mut plane[(t * height + j) * width..][..width];
                    let from = row[k..].iter().step_by(pixel);
                    to.iter_mut().zip(from).for_each(|(to, &from)| *to = from);
                }
            }
        }
        Self { words, reach, width, height, frames }
    }

    /// Place of pixel `(x, y)` of the band in frame `t`.
    fn place(&self, x: usize, y: usize, t: usize) -> usize {
        (t * self.height + y + self.reach.up) * self.width + x + self.reach.left
    }

    /// The words of a layer for the pixels of frame `t`.
    fn layer(&self, offsets: &[(IVec3, f64)], t: usize) -> Layer {
        let word = |&(offset, weight): &(IVec3, f64)| {
            let frame = (t as i32 + offset.z) % self.frames as i32;
            let row = (frame - t as i32) * self.height as i32 + offset.y;
            (row * self.width as i32 + offset.x, weight as f32)
        };
        let others = offsets.iter().filter(|(offset, _)| *offset != IVec3::ZERO);
        let own = offsets.iter().find(|(offset, _)| *offset == IVec3::ZERO);
        Layer { words: others.map(word).collect(), own: own.map_or(0.0, |&(_, g)| g as f32) }
    }
}

/// One frame of a band.
struct Frame<'a> {
    t: usize,
    shape: TileShape,
    planes: &'a Planes,
    layers: Vec<Layer>,
    /// The layer of each sample of a pixel.
    of_samples: &'a [usize],
    terms: Terms,
    totals: &'a [f32],
    pull: &'a Pull,
}

struct FrameJob<'a> {
    frame: Frame<'a>,
    gradients: &'a mut [f32],
}

impl Vectorized for FrameJob<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self { frame, gradients } = self;
        let (spp, dims) = (frame.shape.spp(), frame.shape.dims());
        match frame.pull {
            Pull::Even(plane) => frame.each(|place, s, at, size| {
                for b in 0..dims {
                    // A lone dimension is its own pair.
                    for a in 0..b.max(usize::from(dims == 1)) {
                        let [first, second] = frame.pair(plane, place, s, a, b);
                        for lane in 0..size {
                            let word = (at + lane * spp) * dims;
                            gradients[word + a] += first[lane];
                            if a != b {
                                gradients[word + b] += second[lane];
                            }
                        }
                    }
                }
            }),
            Pull::Uneven(plane) => frame.each(|place, s, at, size| {
                let [first, second] = frame.pair(plane, place, s, 0, 1);
                for lane in 0..size {
                    let word = (at + lane * spp) * dims;
                    (gradients[word], gradients[word + 1]) = (first[lane], second[lane]);
                }
            }),
            Pull::Chords(attraction) if dims == 2 => frame.each(|place, s, at, size| {
                frame.chords::<2>(attraction, place, s, &mut gradients[at * dims..], size);
            }),
            Pull::Chords(attraction) => frame.each(|place, s, at, size| {
                frame.chords::<3>(attraction, place, s, &mut gradients[at * dims..], size);
            }),
        }
    }
}

impl Frame<'_> {
    /// Calls `then` for each sample of each [`LANES`] pixels of the band: with their place in the
    /// planes, the sample's number in its pixel and in the band, and how many pixels they are.
    #[inline(always)]
    fn each(&self, mut then: impl FnMut(usize, usize, usize, usize)) {
        let Planes { reach, width, height, frames, .. } = *self.planes;
        let (width, lines) = (width - reach.left - reach.right, height - reach.up - reach.down);
        let spp = self.shape.spp();
        for y in 0..lines {
            for x in (0..width).step_by(LANES) {
                let place = self.planes.place(x, y, self.t);
                for s in 0..spp {
                    let at = ((y * frames + self.t) * width + x) * spp + s;
                    then(place, s, at, LANES.min(width - x));
                }
            }
        }
    }

    /// The gradient on sample `s` of the pixels from `place` on, by the chords to all that it sees;
    /// to be added to those of the first `size` of them.
    #[inline(always)]
    fn chords<const N: usize>(
        &self,
        attraction: &Attraction,
        place: usize,
        s: usize,
        gradients: &mut [f32],
        size: usize,
    ) {
        let (planes, linear, spp) = (self.planes, self.terms.linear, self.shape.spp());
        let load = |s: usize, place: usize| -> [[f32; LANES]; N] {
            std::array::from_fn(|k| {
                let plane = &planes.words[s * N + k];
                plane[place..place + LANES].try_into().expect("a slice of that length")
            })
        };
        let at = load(s, place);
        let mut sums = [[0.0_f32; LANES]; N];
        let mut push = |other: [[f32; LANES]; N], weight: f32| {
            for lane in 0..LANES {
                let by: [f32; N] = std::array::from_fn(|k| at[k][lane] - other[k][lane]);
                let mut square = 0.0;
                for x in by {
                    square += x * x;
                }
                let weight = weight * (inverse_root(square) + linear);
                for k in 0..N {
                    sums[k][lane] += weight * by[k];
                }
            }
        };
        for other in 0..spp {
            let Layer { words, own } = &self.layers[self.of_samples[s.max(other)]];
            if other != s {
                push(load(other, place), *own);
            }
            for &(word, weight) in words {
                push(load(other, (place as i32 + word) as usize), weight);
            }
        }
        let mean = attraction.mean();
        for lane in 0..size {
            let point: [f32; N] = std::array::from_fn(|k| at[k][lane]);
            let pull = attraction.gradient(point);
            for k in 0..N {
                let away = pull[k] + linear * (point[k] - mean[k]);
                gradients[lane * spp * N + k] = sums[k][lane] - self.totals[s] * away;
            }
        }
    }

    /// The gradient on dimensions `a` and `b` of sample `s` of the pixels from `place` on; where they
    /// are one, on that alone.
    #[inline(always)]
    fn pair<P: Plane>(
        &self,
        plane: &P,
        place: usize,
        s: usize,
        a: usize,
        b: usize,
    ) -> [[f32; LANES]; 2] {
        let (planes, dims) = (self.planes, self.shape.dims());
        let load = |s: usize, place: usize| -> [[f32; LANES]; 2] {
            let row = |k: usize| -> [f32; LANES] {
                let plane = &planes.words[s * dims + k];
                plane[place..place + LANES].try_into().expect("a slice of that length")
            };
            [row(a), if a == b { [0.0; LANES] } else { row(b) }]
        };
        let at = load(s, place);
        let mut densities = [[0.0_f32; LANES]; 2];
        for lane in 0..LANES {
            [densities[0][lane], densities[1][lane]] = plane.densities([at[0][lane], at[1][lane]]);
        }
        let mut gradient = [[0.0_f32; LANES]; 2];
        let mut push = |other: [[f32; LANES]; 2], weight: f32| {
            self.terms.push::<P>(&mut gradient, (at, densities), other, weight);
        };
        for other in 0..self.shape.spp() {
            let Layer { words, own } = &self.layers[self.of_samples[s.max(other)]];
            if other != s {
                push(load(other, place), *own);
            }
            for &(word, weight) in words {
                push(load(other, (place as i32 + word) as usize), weight);
            }
        }
        for lane in 0..LANES {
            let point @ [x, _] = [at[0][lane], at[1][lane]];
            let [gx, gy] = if a == b { [2.0 * x - 1.0, 0.0] } else { plane.gradient(point) };
            let [sx, sy] = plane.sides(point, self.terms.axis, self.terms.linear);
            gradient[0][lane] -= self.totals[s] * (gx + sx);
            gradient[1][lane] -= self.totals[s] * (gy + sy);
        }
        gradient
    }
}

/// Weights of the energy's terms of single coordinates against the distance.
#[derive(Debug, Clone, Copy)]
struct Terms {
    axis: f32,
    linear: f32,
}

impl Terms {
    /// Adds the push of one neighbour for each lane, at whose coordinates samples are so dense.
    #[inline(always)]
    fn push<P: Plane>(
        self,
        gradient: &mut [[f32; LANES]; 2],
        (at, densities): ([[f32; LANES]; 2], [[f32; LANES]; 2]),
        other: [[f32; LANES]; 2],
        weight: f32,
    ) {
        let axis = weight * self.axis;
        for lane in 0..LANES {
            let dx = at[0][lane] - other[0][lane];
            let dy = at[1][lane] - other[1][lane];
            let by = weight * (inverse_root(dx * dx + dy * dy) + self.linear);
            let [along_x, along_y] = match P::IS_EVEN {
                true => [axis; 2],
                false => [axis * densities[0][lane], axis * densities[1][lane]],
            };
            // At 0 the sign does not matter: samples on one line are a chance of rounding.
            gradient[0][lane] += by * dx + signed(along_x, dx);
            gradient[1][lane] += by * dy + signed(along_y, dy);
        }
    }
}

/// `x` with its sign turned where that of `by` is negative.
#[inline(always)]
fn signed(x: f32, by: f32) -> f32 {
    f32::from_bits(x.to_bits() ^ (by.to_bits() & 1 << 31))
}

/// 1/√x to five digits for x ≥ 0 (finite at 0): a first guess by halving the exponent in the bit
/// pattern, then two Newton steps. Plain arithmetic, so that it is the same on every machine.
#[inline(always)]
fn inverse_root(x: f32) -> f32 {
    /// 3/2 · 2²³ · (127 − 0.045), which the halved bit pattern is taken from; 0.045 makes the
    /// guess best on average over a significand.
    const GUESS: u32 = 0x5f37_59df;
    let x = x + 1e-30;
    let half = 0.5 * x;
    let mut y = f32::from_bits(GUESS - (x.to_bits() >> 1));
    for _ in 0..2 {
        y *= 1.5 - half * y * y;
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::tests::densities;
    use crate::kernel::KernelSpec;
    use crate::metric::Baseline;
    use crate::tile::{Tile, TileShape};

    /// A class of a mixture.
    struct SlowClass {
        /// G between each two pixels.
        weights: Vec<Vec<f64>>,
        /// The numbers of samples that it sees, each with its weight.
        prefixes: Vec<(usize, f64)>,
    }

    /// The energy in f64 by the double sum over all samples, with nothing of the fast path: G
    /// from the filter's own rows, V by quadrature.
    struct Slow {
        shape: TileShape,
        /// Points of the domain in whose dimensions chords are, if it is not the square, and the mean
        /// density of coordinates along each axis that it has.
        domain: Option<(Domain, Tile, Vec<f64>)>,
        classes: Vec<SlowClass>,
        axis: f64,
        linear: f64,
    }

    impl Slow {
        fn new(
            (shape, domain): (TileShape, Domain),
            classes: &[KernelClass],
            axis: f64,
            linear: f64,
        ) -> Self {
            // One pixel's points are those of a sequence.
            let many = TileShape::new(1, 1, 1 << 14, 1, shape.dims()).unwrap();
            let known = || {
                let points = Baseline::Sobol.tile_of(domain, many, 1);
                // ∫f² from the shares of a thousand strips or so.
                let mean = |k: usize| {
                    const STRIPS: usize = 35 * 30;
                    let below = |i: usize| share_below(domain, k, i as f64 / STRIPS as f64);
                    let rise = |i: usize| below(i + 1) - below(i);
                    (0..STRIPS).map(|i| rise(i) * rise(i)).sum::<f64>() * STRIPS as f64
                };
                let axes = if domain.has_axes() { shape.dims() } else { 0 };
                (domain, points, (0..axes).map(mean).collect())
            };
            let domain = (!domain.is_square()).then(known);
            let size =
                IVec3::new(shape.width() as i32, shape.height() as i32, shape.frames() as i32);
            let mut all = Vec::new();
            for KernelClass { weight: share, taps: kernel, prefix, .. } in classes {
                let mut weights = vec![vec![0.0; shape.pixels()]; shape.pixels()];
                for filtered in 0..shape.pixels() as i32 {
                    let place = IVec3::new(
                        filtered % size.x,
                        filtered / size.x % size.y,
                        filtered / size.x / size.y,
                    );
                    // A kernel that is longer than the tile meets a pixel several times.
                    let mut row = BTreeMap::new();
                    for tap in kernel.taps() {
                        let from = (place + tap.offset).rem_euclid(size).as_usizevec3();
                        *row.entry(shape.pixel(from.x, from.y, from.z)).or_insert(0.0) +=
                            tap.weight;
                    }
                    let square: f64 = row.values().map(|weight: &f64| weight * weight).sum();
                    for (i, a) in &row {
                        for (j, b) in &row {
                            weights[*i][*j] += share * a * b / square;
                        }
                    }
                }
                let spp = shape.spp() as f64;
                let prefixes = prefix.map_or(vec![(shape.spp(), 1.0)], |prefix| {
                    let samples =
                        prefix.least as usize..=prefix.most.map_or(shape.spp(), |k| k as usize);
                    let total: f64 = samples.clone().map(|k| (k as f64).powf(-0.5)).sum();
                    samples.map(|k| (k, spp * (k as f64).powf(-1.5) / total)).collect()
                });
                all.push(SlowClass { weights, prefixes });
            }
            Self { shape, domain, classes: all, axis, linear }
        }

        /// How much two samples see of each other: through each class, in every prefix with both.
        fn weight(&self, a: usize, b: usize) -> f64 {
            let spp = self.shape.spp();
            let of_class = |SlowClass { weights, prefixes }: &SlowClass| {
                let both = prefixes.iter().filter(|(k, _)| a % spp < *k && b % spp < *k);
                weights[a / spp][b / spp] * both.map(|(_, weight)| weight).sum::<f64>()
            };
            self.classes.iter().map(of_class).sum()
        }

        /// What takes the place of the distance, between points of one pair of dimensions.
        fn distance(&self, d: [f64; 2]) -> f64 {
            let square = d[0] * d[0] + d[1] * d[1];
            square.sqrt() + self.axis * (d[0].abs() + d[1].abs()) + 0.5 * self.linear * square
        }

        /// Its mean over the unit square, or over the unit interval for a lone dimension.
        fn mean(&self, x: [f64; 2], planar: bool) -> f64 {
            // ∫|x − u| du and ∫½(x − u)² du over [0, 1].
            let line = |x: f64| 0.5 * (x * x + (1.0 - x) * (1.0 - x));
            let square = |x: f64| (x.powi(3) + (1.0 - x).powi(3)) / 6.0;
            let single = |x: f64| self.axis * line(x) + self.linear * square(x);
            if !planar {
                return line(x[0]) + single(x[0]);
            }
            const N: usize = 250;
            let at = |i: usize| (i as f64 + 0.5) / N as f64;
            let sum: f64 = (0..N * N).map(|i| (x[0] - at(i % N)).hypot(x[1] - at(i / N))).sum();
            sum / (N * N) as f64 + single(x[0]) + single(x[1])
        }

        /// The part of the energy of chords that depends on one sample.
        fn energy_of_chords(
            &self,
            (domain, many, densities): &(Domain, Tile, Vec<f64>),
            points: &[f64],
            sample: usize,
        ) -> f64 {
            let dims = self.shape.dims();
            let x = &points[sample * dims..(sample + 1) * dims];
            let distance = |u: &mut dyn Iterator<Item = f64>| {
                let square: f64 = x.iter().zip(u).map(|(x, u)| (x - u) * (x - u)).sum();
                square.sqrt() + 0.5 * self.linear * square
            };
            let all = many.samples().chunks(dims);
            let mean = all.clone().map(|u| distance(&mut u.iter().map(|&u| f64::from(u))));
            let mean = mean.sum::<f64>() / all.len() as f64;
            // Of single coordinates it is the share between them that counts.
            let share = |k: usize, x: f64| share_below(*domain, k, x);
            let between = |u: &[f64]| -> f64 {
                let of =
                    |(k, density): (usize, &f64)| (share(k, x[k]) - share(k, u[k])).abs() / density;
                self.axis * densities.iter().enumerate().map(of).sum::<f64>()
            };
            let mean_between = |(k, density): (usize, &f64)| {
                let below = share(k, x[k]);
                0.5 * (below * below + (1.0 - below) * (1.0 - below)) / density
            };
            let mean_between: f64 = densities.iter().enumerate().map(mean_between).sum();
            (0..self.shape.samples())
                .map(|other| {
                    let u = &points[other * dims..(other + 1) * dims];
                    let away = distance(&mut u.iter().copied()) + between(u);
                    self.weight(sample, other) * (mean + self.axis * mean_between - away)
                })
                .sum()
        }

        /// The part of the energy that depends on one sample.
        fn energy(&self, points: &[f64], sample: usize) -> f64 {
            if let Some(domain) = &self.domain {
                return self.energy_of_chords(domain, points, sample);
            }
            let dims = self.shape.dims();
            let planar = dims > 1;
            let mut energy = 0.0;
            for b in 0..dims {
                for a in 0..if planar { b } else { 1 } {
                    let at = |s: usize| {
                        [points[s * dims + a], if planar { points[s * dims + b] } else { 0.0 }]
                    };
                    let x = at(sample);
                    let mut total = 0.0;
                    for other in 0..self.shape.samples() {
                        let weight = self.weight(sample, other);
                        let u = at(other);
                        energy -= weight * self.distance([x[0] - u[0], x[1] - u[1]]);
                        total += weight;
                    }
                    energy += total * self.mean(x, planar);
                }
            }
            energy
        }
    }

    /// The share of a domain whose coordinate `k` is below `x`.
    fn share_below(domain: Domain, k: usize, x: f64) -> f64 {
        let mut axis = vec![0.0; domain.dims().unwrap()];
        axis[k] = 1.0;
        domain.below(&axis, x)
    }

    fn polish((tile, domain): (&Tile, Domain), classes: &[KernelClass], simd: Simd) -> Polish {
        let adam =
            AdamOptions { rate: 0.01, final_rate: 0.0, beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };
        let options = PolishOptions { steps: 10, axis_weight: 0.3, linear_weight: 0.7, adam };
        let samples = Samples::from_tile(tile);
        // With all offsets: the slow energy leaves none out.
        let sight = Sight::new(classes, tile.shape(), 0.0);
        Polish::with_sight((tile.shape(), domain), sight, options, simd, &samples).unwrap()
    }

    #[test]
    fn gradients_are_the_slope_of_the_energy() {
        const SIGNED: &str = "0.8: gaussian(1) * fovvideovdp(30) @ 3x4x8 + 0.2: column";
        const SEQUENCE: &str =
            "0.8: gaussian(1) * box(2) * every(2) @ 3x3x2 of 1.. + 0.2: column of 2";
        for ([width, height, frames, spp, dims], kernel, domain) in [
            ([9, 5, 8, 1, 2], SIGNED, Domain::Square),
            ([5, 4, 8, 2, 1], SIGNED, Domain::Square),
            ([4, 5, 3, 2, 3], "gaussian(1) * ema(0.5) @ 4x3x3", Domain::Square),
            ([33, 4, 1, 1, 2], "gaussian(1) @ 3x3x1", Domain::Square),
            ([7, 5, 3, 1, 2], SIGNED, Domain::Square),
            ([5, 4, 4, 3, 2], SEQUENCE, Domain::Square),
            ([9, 5, 3, 1, 2], SIGNED, Domain::Circle),
            ([5, 4, 4, 2, 2], SEQUENCE, Domain::Disk),
            ([9, 4, 3, 1, 3], SIGNED, Domain::Sphere),
            ([5, 4, 4, 2, 3], SEQUENCE, Domain::Hemisphere),
            ([7, 5, 3, 1, 3], SIGNED, Domain::Cosine),
            ([9, 5, 3, 1, 2], SIGNED, densities()[0]),
            ([5, 4, 4, 2, 2], SEQUENCE, densities()[1]),
        ] {
            let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
            let tile = Baseline::White.tile_of(domain, shape, 6);
            let whole = kernel.parse::<KernelSpec>().unwrap().resolve(shape).unwrap();
            let folded = whole.folded(frames).unwrap();
            let (whole, classes) = (whole.classes(), folded.classes());
            let mut fast = polish((&tile, domain), classes, Simd::detect());
            fast.gradients(0);
            // The gradients in C order.
            let mut gradients = vec![0.0_f64; shape.coordinates()];
            let own = width * spp * dims;
            for (row, words) in fast.gradients.whole()[..gradients.len()].chunks(own).enumerate() {
                let to = shape.pixel(0, row / frames, row % frames) * spp * dims;
                (0..own).for_each(|k| gradients[to + k] = f64::from(words[k]));
            }

            let slow = Slow::new((shape, domain), whole, 0.3, 0.7);
            let points: Vec<f64> = tile.samples().iter().map(|&x| f64::from(x)).collect();
            let mut largest = 0.0_f64;
            for sample in (0..shape.samples()).step_by(4) {
                const STEP: f64 = 1e-6;
                let words = sample * dims..(sample + 1) * dims;
                let slope = |word: usize| {
                    let energy = |by: f64| {
                        let mut points = points.clone();
                        points[word] += by;
                        slow.energy(&points, sample)
                    };
                    (energy(STEP) - energy(-STEP)) / (2.0 * STEP)
                };
                let mut found = gradients[words.clone()].to_vec();
                let mut expected: Vec<f64> = words.clone().map(|word| -slope(word)).collect();
                // On a surface only what leads along it matters.
                let normal: Vec<f64> = points[words].iter().map(|x| 2.0 * x - 1.0).collect();
                for gradient in [&mut found, &mut expected] {
                    if domain.surface().is_curved() {
                        let away: f64 = normal.iter().zip(&*gradient).map(|(n, g)| n * g).sum();
                        gradient.iter_mut().zip(&normal).for_each(|(g, n)| *g -= away * n);
                    }
                }
                for (found, expected) in found.iter().zip(&expected) {
                    largest = largest.max(expected.abs());
                    let label = format!("{domain} {shape}, sample {sample}");
                    // A domain's pull is a mean over 2¹⁴ of its points.
                    let most = if domain.is_square() { 5e-3 } else { 3e-2 };
                    assert!((found - expected).abs() < most, "{label}: {found} {expected}");
                }
            }
            assert!(largest > 0.5, "{shape}: slopes up to {largest} only");

            let mut plain = polish((&tile, domain), classes, Simd::plain());
            plain.gradients(0);
            let bits = |polish: &Polish| {
                polish.gradients.whole()[..gradients.len()]
                    .iter()
                    .map(|x| x.to_bits())
                    .collect::<Vec<_>>()
            };
            assert_eq!(bits(&plain), bits(&fast));
        }
    }

    #[test]
    fn inverse_roots_are_good_to_five_digits() {
        for i in 0..4000 {
            let x = 2.0_f32.powf(-40.0 + 0.01 * i as f32);
            let exact = 1.0 / f64::from(x).sqrt();
            let error = f64::from(inverse_root(x)) / exact - 1.0;
            assert!(error.abs() < 1e-5, "{x}: {error}");
        }
        assert!(inverse_root(0.0).is_finite());
    }
}
