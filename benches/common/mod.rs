//! What benches and examples share: kernels, tiles with draws that are ready to be moved, and
//! the checks of their gradients against the plain gradient.

#![allow(dead_code, reason = "every bench uses a part of it")]

pub mod dense;
pub mod subsets;

use std::cell::Cell;
use std::time::{Duration, Instant};

use glam::IVec3;
use perceptile::domain::Domain;
use perceptile::draw::{CellDraws, DirectionSet, DrawOptions, Draws, LevelSets};
use perceptile::gradient::probe::Unprobed;
use perceptile::gradient::reference::{self, ReferenceDraw};
use perceptile::gradient::simd::Simd;
use perceptile::gradient::{Gradient, Objective, Patch, Quantum, Workspace};
use perceptile::kernel::{Kernel, KernelSpec, KernelTaps};
use perceptile::solver::BLOCKS_PER_THREAD;
use perceptile::solver::adam::AdamOptions;
use perceptile::tile::{Block, Overlap, Partition, Region, SLACK, Tile, TileShape};

/// The kernel of the paper without temporal antialiasing.
pub const PAPER_KERNEL: &str = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";
/// Width, height and frames of the paper's tiles.
pub const PAPER_SIZE: [usize; 3] = [128, 128, 30];
/// Draws of a step in the paper.
pub const PAPER_DRAWS: usize = 4096;

/// Adam as it is used by default.
pub const ADAM: AdamOptions =
    AdamOptions { rate: 0.01, final_rate: 0.0, beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };

/// A tile's shape.
pub fn shape([width, height, frames]: [usize; 3], spp: usize, dims: usize) -> TileShape {
    TileShape::new(width, height, frames, spp, dims).expect("sizes")
}

/// The paper's kernel.
pub fn paper_kernel(shape: TileShape) -> Kernel {
    let spec: KernelSpec = PAPER_KERNEL.parse().expect("a kernel");
    spec.resolve(shape).expect("a kernel that fits")
}

/// Its taps.
pub fn paper_taps(shape: TileShape) -> KernelTaps {
    paper_kernel(shape).classes()[0].taps.clone()
}

/// Draws as the paper has them: all thresholds, any direction, and one for each subset.
pub fn paper_options(draws: usize) -> DrawOptions {
    DrawOptions { draws, directions: 1, threshold_range: 1.0, axis_share: 0.0, pair_share: 0.0 }
}

/// The gradient of a kernel, in the square.
pub fn gradient(shape: TileShape, taps: &KernelTaps, options: DrawOptions) -> Gradient {
    gradient_in(Domain::Square, shape, taps, options)
}

/// The gradient of a kernel in a domain.
pub fn gradient_in(
    domain: Domain,
    shape: TileShape,
    taps: &KernelTaps,
    options: DrawOptions,
) -> Gradient {
    let draws = Draws::new(
        options,
        1,
        LevelSets::new([(1.0, taps)]),
        DirectionSet::new(domain, shape.dims()),
    );
    let partition = Partition::new(shape, draws.levels().reach());
    let quantum = Quantum::new(&draws, &partition).expect("a unit");
    Gradient::new(draws, partition, quantum, Simd::detect())
}

/// One thread's work in the first half of a step: all draws, from samples that stay.
pub struct Gradients {
    gradient: Gradient,
    blocks: Vec<Block>,
    samples: Vec<f32>,
    patches: Vec<Vec<i32>>,
    workspace: Workspace,
}

impl Gradients {
    /// Lays out the samples of `tile`, in as many blocks as one thread has in a run.
    pub fn new(gradient: Gradient, tile: &Tile) -> Self {
        let (shape, rows) = (tile.shape(), gradient.rows());
        let mut samples = vec![0.0; rows.words() + SLACK];
        let own = rows.own();
        for (i, row) in samples[rows.lines()].chunks_mut(rows.stride()).enumerate() {
            let (y, t) = (i / shape.frames(), i % shape.frames());
            let from = shape.pixel(0, y, t) * rows.pixel();
            row[rows.lead()..rows.lead() + own].copy_from_slice(&tile.samples()[from..from + own]);
            rows.close_row(row);
        }
        rows.close_lines(&mut samples);
        let blocks = gradient.partition().blocks(gradient.rows().region(), BLOCKS_PER_THREAD);
        let patches = blocks.iter().map(|block| vec![0; block.words() + SLACK]).collect();
        Self { gradient, blocks, samples, patches, workspace: Workspace::default() }
    }

    /// Does all draws of a step.
    pub fn run(&mut self, step: u32) -> Objective {
        let Self { gradient, blocks, samples, patches, workspace } = self;
        let block = |(block, words): (&Block, &mut Vec<i32>)| {
            gradient.block(step, block, samples, Patch { words }, workspace, &mut Unprobed)
        };
        blocks.iter().zip(patches).map(block).sum()
    }

    /// The integer gradients of all blocks.
    pub fn patches(&self) -> &[Vec<i32>] {
        &self.patches
    }

    /// The gradient of the last step, for every coordinate in C order.
    fn sums(&self) -> Vec<f64> {
        let shape = self.gradient.partition().shape();
        let (pixel, unit) = (shape.spp() * shape.dims(), f64::from(self.gradient.quantum().unit()));
        let overlap = Overlap::new(Region::whole(shape), self.blocks.iter().map(Block::window));
        let mut sums = vec![0.0; shape.coordinates()];
        for (y, t) in (0..shape.height()).flat_map(|y| (0..shape.frames()).map(move |t| (y, t))) {
            let row = shape.pixel(0, y, t) * pixel;
            for &(block, line) in overlap.line(y) {
                let from = line + t * overlap.stride(block);
                for segment in overlap.segments(block) {
                    let gradients = &self.patches[block][from + segment.from..][..segment.len];
                    let sums = &mut sums[row + segment.to..][..segment.len];
                    sums.iter_mut()
                        .zip(gradients)
                        .for_each(|(sum, &x)| *sum += f64::from(x) * unit);
                }
            }
        }
        sums
    }

    /// Compares the gradient and the objective of a few draws with the plain ones.
    ///
    /// They are draws of other directions than those of `self`: along single axes and pairs of
    /// them, whose targets the plain gradient finds in any number of dimensions.
    ///
    /// # Panics
    /// If anything differs by more than rounding explains.
    pub fn check_some(&self, tile: &Tile, taps: &KernelTaps, few: usize) {
        let options = DrawOptions { axis_share: 0.1, pair_share: 0.9, ..paper_options(few) };
        let mut few = Self::new(gradient(tile.shape(), taps, options), tile);
        let found = few.run(0).squared_distance();
        let levels = few.gradient.draws().levels();
        let (mut expected, mut objective) = (vec![0.0; tile.samples().len()], 0.0);
        for draw in reference_draws(&few.gradient, 0) {
            let gradients =
                reference::gradient((tile, Domain::Square), levels, std::slice::from_ref(&draw));
            // Along one direction of length 1, gradients are as long as the differences to targets.
            let squares: f64 = gradients.iter().map(|x| x * x).sum();
            objective += squares / (draw.taps * draw.samples) as f64;
            expected.iter_mut().zip(gradients).for_each(|(sum, x)| *sum += x);
        }
        assert!((found / objective - 1.0).abs() < 1e-2, "objective {found}, not {objective}");
        assert_near(&few.sums(), &expected);
    }

    /// Sees that the gradients of all draws of a step add up to what their samples lack of the center
    /// of the cube: it is the mean of all targets, so this needs no ranks.
    ///
    /// # Panics
    /// If it differs by more than rounding explains.
    pub fn check_sum(&mut self, tile: &Tile) {
        self.run(0);
        let (shape, sums) = (tile.shape(), self.sums());
        let (dims, size) = (shape.dims(), size(shape));
        let levels = self.gradient.draws().levels();
        let (mut expected, mut samples) = (vec![0.0_f64; dims], 0);
        for draw in reference_draws(&self.gradient, 0) {
            let mut lack = vec![0.0; dims];
            for &offset in &levels.sets()[draw.set].offsets[..draw.taps] {
                let place = (draw.pixel + offset).rem_euclid(size).as_usizevec3();
                for point in (0..draw.samples).map(|s| tile.point(place.x, place.y, place.z, s)) {
                    lack.iter_mut().zip(point).for_each(|(sum, &x)| *sum += 0.5 - f64::from(x));
                    samples += 1;
                }
            }
            for direction in &draw.directions {
                let theta = direction.theta[..dims].iter().map(|&x| f64::from(x));
                let along: f64 = theta.clone().zip(&lack).map(|(theta, x)| theta * x).sum();
                expected.iter_mut().zip(theta).for_each(|(sum, theta)| *sum += theta * along);
            }
        }
        for (k, expected) in expected.into_iter().enumerate() {
            let found: f64 = sums.iter().skip(k).step_by(dims).sum();
            let error = (found - expected).abs() / f64::from(samples);
            assert!(error < 2e-6, "axis {k}: {found}, not {expected}, of {samples} samples");
        }
    }
}

/// The draws of all cells in a step, in coordinates of the tile.
pub fn reference_draws(gradient: &Gradient, step: u32) -> Vec<ReferenceDraw> {
    let partition = gradient.partition();
    let per_draw = gradient.draws().options().directions;
    let (mut found, mut drawn) = (Vec::new(), CellDraws::default());
    for cell in 0..partition.cells() {
        let place = partition.cell(cell);
        gradient.draws().cell(partition, step, cell, &mut drawn);
        for (draw, directions) in drawn.draws.iter().zip(drawn.directions.chunks(per_draw)) {
            let (x, y) = (place.x as u32 + draw.x, place.y as u32 + draw.y);
            found.push(ReferenceDraw {
                pixel: IVec3::new(x as i32, y as i32, draw.t as i32),
                set: draw.set as usize,
                taps: draw.taps as usize,
                samples: draw.samples as usize,
                directions: directions.to_vec(),
            });
        }
    }
    found
}

/// Width, height and frames.
pub fn size(shape: TileShape) -> IVec3 {
    IVec3::new(shape.width() as i32, shape.height() as i32, shape.frames() as i32)
}

/// Two gradients differ by less than a hundredth of their length.
///
/// # Panics
/// If they do not.
pub fn assert_near(found: &[f64], expected: &[f64]) {
    let length = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>().sqrt();
    let expected_length = length(&mut expected.iter().copied());
    let error = length(&mut found.iter().zip(expected).map(|(a, b)| a - b));
    assert!(expected_length > 0.0 && error < 0.01 * expected_length, "{error}, {expected_length}");
}

/// The shortest time that something took, which other work on the machine disturbed least.
#[derive(Debug, Default)]
pub struct Shortest(Cell<Option<Duration>>);

impl Shortest {
    /// Does it `times` times. Returns the time of all together.
    pub fn measure(&self, times: u64, mut work: impl FnMut()) -> Duration {
        (0..times)
            .map(|_| {
                let begun = Instant::now();
                work();
                self.note(begun.elapsed())
            })
            .sum()
    }

    /// Takes note of a time, and returns it.
    pub fn note(&self, time: Duration) -> Duration {
        self.0.set(Some(self.0.get().map_or(time, |shortest| shortest.min(time))));
        time
    }

    /// In nanoseconds, of each of `parts` alike; `None` if it was never done.
    pub fn nanoseconds(&self, parts: usize) -> Option<f64> {
        self.0.get().map(|shortest| shortest.as_secs_f64() * 1e9 / parts as f64)
    }
}
