//! The gradient as Algorithm 1 of the paper is written: every draw goes through the whole tile.
//!
//! A draw compares the kernel's weight at every pixel with its threshold, projects all samples,
//! sorts the selected ones, and adds to the gradient of the whole tile. It is written to be fast
//! at that: the kernel is a table as large as the tile, which is read in rows around the torus;
//! coordinates lie in one plane for each dimension; targets have closed forms; and it is compiled
//! for the same instruction set as the fast path. One thread, f32.

use glam::IVec3;
use perceptile::domain::Domain;
use perceptile::draw::{Direction, DirectionSet, LevelSets, Stream, Use};
use perceptile::gradient::Targets;
use perceptile::gradient::reference::ReferenceDraw;
use perceptile::gradient::simd::{Isa, Simd, Vectorized};
use perceptile::kernel::KernelTaps;
use perceptile::tile::{Tile, TileShape};

use super::size;

/// A draw that knows nothing of others.
#[derive(Debug, Clone, Copy)]
pub struct DenseDraw {
    pixel: IVec3,
    /// Which sign of the kernel.
    set: usize,
    /// In units of the largest weight of that sign.
    threshold: f32,
    direction: Direction,
}

impl DenseDraw {
    /// Independent draws: any pixel, any threshold of either sign, any direction.
    pub fn independent(shape: TileShape, levels: &LevelSets, count: usize) -> Vec<Self> {
        let directions = DirectionSet::new(Domain::Square, shape.dims());
        let mut stream = Stream::new(1, Use::Draws, 0, 0);
        let draw = |_| {
            let pixel = size(shape).to_array().map(|size| stream.below(size as u32) as i32).into();
            Self {
                pixel,
                set: levels.select(stream.unit()).0,
                threshold: stream.unit() as f32,
                direction: directions.any(stream.unit(), &mut stream),
            }
        };
        (0..count).map(draw).collect()
    }

    /// The same draw with the number of its taps, in a tile of one sample per pixel.
    pub fn reference(&self, levels: &LevelSets) -> ReferenceDraw {
        ReferenceDraw {
            pixel: self.pixel,
            set: self.set,
            taps: levels.sets()[self.set].above(f64::from(self.threshold)),
            samples: 1,
            directions: vec![self.direction],
        }
    }
}

/// A tile and all that its dense gradient needs.
pub struct Dense {
    shape: TileShape,
    simd: Simd,
    targets: Targets,
    /// For each sign, the weight of every pixel seen from pixel 0 in C order, in units of the
    /// largest of that sign.
    weights: Vec<Vec<f32>>,
    /// Coordinates and gradient, dimension after dimension.
    samples: Vec<f32>,
    gradient: Vec<f32>,
    /// The projection of every sample, later its distance to its target.
    along: Vec<f32>,
    /// Projection and index of the samples above the threshold, and the targets of their ranks.
    selected: Vec<(f32, u32)>,
    wanted: Vec<f32>,
    integrals: Vec<f64>,
}

impl Dense {
    /// Prepares the tables.
    pub fn new(tile: &Tile, taps: &KernelTaps, simd: Simd) -> Self {
        let shape = tile.shape();
        let weights = taps
            .sign_classes()
            .iter()
            .map(|class| {
                let mut weights = vec![0.0; shape.pixels()];
                for tap in &class.taps {
                    let place = tap.offset.rem_euclid(size(shape)).as_usizevec3();
                    weights[shape.pixel(place.x, place.y, place.z)] =
                        (tap.weight / class.peak) as f32;
                }
                weights
            })
            .collect();
        let dims = shape.dims();
        let plane = |k: usize| tile.samples().iter().skip(k).step_by(dims).copied();
        Self {
            shape,
            simd,
            targets: Targets::new(&DirectionSet::new(Domain::Square, dims)),
            weights,
            samples: (0..dims).flat_map(plane).collect(),
            gradient: vec![0.0; shape.coordinates()],
            along: vec![0.0; shape.samples()],
            selected: Vec::new(),
            wanted: Vec::new(),
            integrals: Vec::new(),
        }
    }

    /// The gradient of a step.
    pub fn gradients(&mut self, draws: &[DenseDraw]) {
        self.gradient.fill(0.0);
        for draw in draws {
            self.simd.run(DrawGradient { dense: self, draw });
        }
    }

    /// The gradient of the last step, for every coordinate in C order.
    pub fn gradient(&self) -> Vec<f64> {
        let (samples, dims) = (self.shape.samples(), self.shape.dims());
        let coordinate = |i: usize| self.gradient[i % dims * samples + i / dims];
        (0..self.shape.coordinates()).map(|i| f64::from(coordinate(i))).collect()
    }

    /// Projects all samples, and selects those of the pixels above the threshold.
    #[inline(always)]
    fn project(&mut self, draw: &DenseDraw) {
        let Self { shape, weights, samples, along, selected, .. } = self;
        let (width, spp) = (shape.width(), shape.spp());
        let weights = &weights[draw.set];
        // Seen from the draw's pixel, a row begins with what is left of the table's row.
        let left = draw.pixel.x as usize;
        let around = |i: usize, from: i32, size: usize| (i + size - from as usize) % size;
        selected.clear();
        for (row, along) in along.chunks_exact_mut(width * spp).enumerate() {
            let first = row * width * spp;
            along.fill(0.0);
            for (plane, theta) in samples.chunks_exact(shape.samples()).zip(draw.direction.theta) {
                let plane = &plane[first..first + width * spp];
                along.iter_mut().zip(plane).for_each(|(sum, &x)| *sum += theta * x);
            }
            let y = around(row % shape.height(), draw.pixel.y, shape.height());
            let t = around(row / shape.height(), draw.pixel.z, shape.frames());
            let from = shape.pixel(0, y, t);
            let weights = &weights[from..from + width];
            for (x, weights) in [(0, &weights[width - left..]), (left, &weights[..width - left])] {
                for (x, _) in (x..).zip(weights).filter(|(_, weight)| **weight > draw.threshold) {
                    let samples = x * spp..(x + 1) * spp;
                    selected.extend(samples.map(|i| (along[i], (first + i) as u32)));
                }
            }
        }
    }

    /// Adds the gradients of a draw to the gradient.
    #[inline(always)]
    fn add<I: Isa>(&mut self, isa: I, draw: &DenseDraw) {
        self.project(draw);
        let Self { shape, targets, integrals, gradient, along, selected, wanted, .. } = self;
        selected.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        wanted.resize(selected.len(), 0.0);
        targets.fill(isa, &draw.direction, integrals, wanted);
        along.fill(0.0);
        for (&(projection, i), target) in selected.iter().zip(wanted) {
            along[i as usize] = *target - projection;
        }
        for (plane, theta) in gradient.chunks_exact_mut(shape.samples()).zip(draw.direction.theta) {
            plane.iter_mut().zip(&*along).for_each(|(sum, &along)| *sum += theta * along);
        }
    }
}

/// One draw.
struct DrawGradient<'a> {
    dense: &'a mut Dense,
    draw: &'a DenseDraw,
}

impl Vectorized for DrawGradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.dense.add(isa, self.draw);
    }
}
