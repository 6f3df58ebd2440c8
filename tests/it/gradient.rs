//! The fast gradient against the plain one, the plain one against finite differences, and the
//! checker against gradients that are wrong.
//!
//! The property tests of this workspace take their cases from a fixed seed (`.cargo/config.toml`),
//! so that the same commit always gives the same answer. To run those of this file long, on cases
//! that nobody has seen:
//!
//! ```text
//! PROPTEST_RNG_SEED=$(date +%s) PROPTEST_CASES=200000 cargo test --release --test it gradient::
//! ```
//!
//! A seed that fails is written to `tests/proptest-regressions/gradient.txt`, from where it is tried
//! first ever after; commit it with the repair.

use glam::IVec3;
use perceptile::domain::Domain;
use perceptile::draw::{CellDraws, DirectionSet, DrawOptions, Draws, LevelSets, Stream, Use};
use perceptile::gradient::probe::Unprobed;
use perceptile::gradient::reference::{self, ProjectedDensity, ROUNDOFF, ReferenceDraw};
use perceptile::gradient::simd::Simd;
use perceptile::gradient::{Gradient, Objective, Patch, Quantum, Workspace};
use perceptile::kernel::{KernelSpec, KernelTaps, Tap};
use perceptile::metric::Baseline;
use perceptile::tile::{
    BELOW_ONE, Block, Layout, Overlap, Partition, Region, SLACK, Tile, TileShape,
};
use proptest::prelude::*;

use crate::densities::densities;

/// A tile with all that its gradient depends on.
#[derive(Debug, Clone)]
pub struct Case {
    pub tile: Tile,
    pub domain: Domain,
    pub levels: LevelSets,
    pub draw: DrawOptions,
    pub seed: u64,
    pub step: u32,
}

const SHARES: DrawOptions = DrawOptions {
    draws: 40,
    directions: 1,
    threshold_range: 1.0,
    axis_share: 0.2,
    pair_share: 0.3,
};

impl Case {
    /// A tile of white noise with the kernel of a text.
    pub fn of(shape: TileShape, kernel: &str, draw: DrawOptions, seed: u64) -> Self {
        let kernel = kernel.parse::<KernelSpec>().unwrap().resolve(shape).unwrap();
        let tile = Baseline::White.tile(shape, seed);
        Self {
            tile,
            domain: Domain::Square,
            levels: LevelSets::of(&kernel, shape.spp()),
            draw,
            seed,
            step: seed as u32 % 7,
        }
    }

    fn draws(&self) -> Draws {
        Draws::new(
            self.draw,
            self.seed,
            self.levels.clone(),
            DirectionSet::new(self.domain, self.tile.shape().dims()),
        )
    }

    fn partition(&self) -> Partition {
        Partition::new(self.tile.shape(), self.levels.reach())
    }

    fn gradient(&self, simd: Simd) -> Gradient {
        let (draws, partition) = (self.draws(), self.partition());
        let quantum = Quantum::new(&draws, &partition).expect("a unit for these draws");
        Gradient::new(draws, partition, quantum, simd)
    }

    /// The draws of all cells in coordinates of the tile.
    pub fn reference_draws(&self) -> Vec<ReferenceDraw> {
        let (draws, partition) = (self.draws(), self.partition());
        let mut found = Vec::new();
        for cell in 0..partition.cells() {
            let place = partition.cell(cell);
            let mut of_cell = CellDraws::default();
            draws.cell(&partition, self.step, cell, &mut of_cell);
            let directions = of_cell.directions.chunks(self.draw.directions);
            for (draw, directions) in of_cell.draws.iter().zip(directions) {
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

    /// The samples of a draw's subset.
    fn subset(&self, draw: &ReferenceDraw) -> Vec<usize> {
        let shape = self.tile.shape();
        let size = IVec3::new(shape.width() as i32, shape.height() as i32, shape.frames() as i32);
        self.levels.sets()[draw.set].offsets[..draw.taps]
            .iter()
            .flat_map(|&offset| {
                let place = (draw.pixel + offset).rem_euclid(size).as_usizevec3();
                let pixel = shape.pixel(place.x, place.y, place.z);
                (0..draw.samples).map(move |s| pixel * shape.spp() + s)
            })
            .collect()
    }

    /// Projection of a sample.
    fn project(&self, sample: usize, theta: &[f32]) -> f64 {
        let dims = self.tile.shape().dims();
        let point = &self.tile.samples()[sample * dims..(sample + 1) * dims];
        point.iter().zip(theta).map(|(&x, &theta)| f64::from(x) * f64::from(theta)).sum()
    }

    /// The samples of a subset, each with how far its fast target may be from the plain one along a
    /// direction.
    fn target_slack(&self, subset: &[usize], theta: &[f32]) -> Vec<(usize, f64)> {
        let (n, dims) = (subset.len(), theta.len());
        let density = ProjectedDensity::new(theta);
        let (targets, slack) = (density.targets(n), density.slack(n));
        let mut order: Vec<(f64, usize)> =
            subset.iter().map(|&sample| (self.project(sample, theta), sample)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Samples may change places if their keys can be equal or in the other order: if they are no
        // further apart than a step of the keys and what is lost of two projections of c roundings,
        // and of two keys before they are rounded to a step, of two roundings each. Subsets larger
        // than 2¹⁴ are sorted by the projections themselves. Equal points never change places.
        let length: f64 = theta.iter().map(|&x| f64::from(x.abs())).sum();
        let components = theta.iter().filter(|&&x| x != 0.0).count();
        let bits = (n.next_power_of_two().ilog2() as i32).max(9);
        let step = if bits > 14 { 0.0 } else { 1.001 * 2_f64.powi(bits - 32) };
        let reach = length * (step + (2 * components + 4) as f64 * ROUNDOFF);
        let point = |sample: usize| &self.tile.samples()[sample * dims..(sample + 1) * dims];
        let of_rank = |(rank, &(projection, sample)): (usize, &(f64, usize))| {
            let rivals = |others: &mut dyn Iterator<Item = &(f64, usize)>| {
                others
                    .take_while(|other| (other.0 - projection).abs() <= reach)
                    .filter(|other| point(other.1) != point(sample))
                    .count()
            };
            let lowest = rank - rivals(&mut order[..rank].iter().rev());
            let highest = rank + rivals(&mut order[rank + 1..].iter());
            let of = |other: usize| (targets[other] - targets[rank]).abs() + slack[other];
            (sample, (lowest..=highest).map(of).fold(0.0, f64::max))
        };
        order.iter().enumerate().map(of_rank).collect()
    }
}

/// The integer gradient of a tile as blocks have it.
struct Blocks {
    blocks: Vec<Block>,
    patches: Vec<Vec<i32>>,
    objectives: Vec<Objective>,
}

/// The samples of a case as the gradient wants them.
fn rows(case: &Case, gradient: &Gradient) -> Vec<f32> {
    let (shape, rows) = (case.tile.shape(), gradient.rows());
    let mut samples = vec![0.0; rows.words() + SLACK];
    let own = rows.own();
    for (i, row) in samples[rows.lines()].chunks_mut(rows.stride()).enumerate() {
        let (y, t) = (i / shape.frames(), i % shape.frames());
        let from = shape.pixel(0, y, t) * rows.pixel();
        row[rows.lead()..rows.lead() + own].copy_from_slice(&case.tile.samples()[from..from + own]);
        rows.close_row(row);
    }
    rows.close_lines(&mut samples);
    samples
}

/// Computes all of about `count` blocks, from the last one on if told so, with one workspace.
fn fast(case: &Case, gradient: &Gradient, count: usize, backward: bool) -> Blocks {
    let blocks = gradient.partition().blocks(gradient.rows().region(), count);
    let samples = rows(case, gradient);
    let mut patches = vec![Vec::new(); blocks.len()];
    let mut objectives = vec![Objective::default(); blocks.len()];
    let mut workspace = Workspace::default();
    let mut order: Vec<usize> = (0..blocks.len()).collect();
    if backward {
        order.reverse();
    }
    for i in order {
        // What is left in a patch must not matter.
        let mut words = vec![7; blocks[i].words() + SLACK];
        let patch = Patch { words: &mut words };
        objectives[i] =
            gradient.block(case.step, &blocks[i], &samples, patch, &mut workspace, &mut Unprobed);
        patches[i] = words;
    }
    Blocks { blocks, patches, objectives }
}

/// Adds up the patches: one word per coordinate in C order.
fn fold(shape: TileShape, all: &Blocks) -> Vec<i64> {
    let pixel = shape.spp() * shape.dims();
    let overlap = Overlap::new(Region::whole(shape), all.blocks.iter().map(Block::window));
    let mut words = vec![0; shape.coordinates()];
    for (y, t) in (0..shape.height()).flat_map(|y| (0..shape.frames()).map(move |t| (y, t))) {
        let row = shape.pixel(0, y, t) * pixel;
        for &(block, line) in overlap.line(y) {
            let from = line + t * overlap.stride(block);
            for s in overlap.segments(block) {
                for k in 0..s.len {
                    words[row + s.to + k] += i64::from(all.patches[block][from + s.from + k]);
                }
            }
        }
    }
    words
}

/// What the plain gradient says, and by how much the fast one may differ.
struct Oracle {
    gradient: Vec<f64>,
    allowed: Vec<f64>,
}

impl Oracle {
    /// The bounds follow the arithmetic of the fast gradient, with S the length of a direction's
    /// projected cube, c the components that it has, and a rounding [`ROUNDOFF`] of S:
    ///
    /// - a projection, of c products and their sum: c roundings;
    /// - the difference to the target: one, and for each direction of the draw one more, for the
    ///   product with the component and the sum over directions;
    /// - the target: [`ProjectedDensity::slack`], and as much as ranks can be mistaken;
    /// - half a unit for each draw, whose gradient is rounded to integers.
    fn new(case: &Case, unit: f32) -> Self {
        let dims = case.tile.shape().dims();
        let draws = case.reference_draws();
        let mut allowed = vec![0.0; case.tile.samples().len()];
        for draw in &draws {
            let subset = case.subset(draw);
            for sample in &subset {
                (0..dims).for_each(|k| allowed[sample * dims + k] += 0.5 * f64::from(unit));
            }
            for direction in &draw.directions {
                let theta = &direction.theta[..dims];
                let length: f64 = theta.iter().map(|&x| f64::from(x.abs())).sum();
                let components = theta.iter().filter(|&&x| x != 0.0).count();
                let roundings = (components + 1 + draw.directions.len()) as f64;
                let of_targets = case.target_slack(&subset, theta);
                for (sample, of_target) in of_targets {
                    let slack = of_target + roundings * ROUNDOFF * length;
                    for (k, theta) in theta.iter().enumerate() {
                        allowed[sample * dims + k] += slack * f64::from(theta.abs());
                    }
                }
            }
        }
        Self {
            gradient: reference::gradient((&case.tile, case.domain), &case.levels, &draws),
            allowed,
        }
    }

    /// Whether a gradient in units of the quantum is right.
    fn check(&self, words: &[i64], unit: f32) -> Result<(), String> {
        for (i, &word) in words.iter().enumerate() {
            let (found, expected) = (word as f64 * f64::from(unit), self.gradient[i]);
            let allowed = self.allowed[i];
            if (found - expected).abs() > allowed {
                return Err(format!("coordinate {i}: {found}, not {expected} (±{allowed:.1e})"));
            }
        }
        Ok(())
    }
}

/// Compares both gradients.
fn compare(case: &Case) -> Result<(), TestCaseError> {
    let gradient = case.gradient(Simd::detect());
    let unit = gradient.quantum().unit();
    let blocks = fast(case, &gradient, 3, false);
    let oracle = Oracle::new(case, unit);
    let checked = oracle.check(&fold(case.tile.shape(), &blocks), unit);
    prop_assert!(checked.is_ok(), "{}", checked.unwrap_err());
    let objective: Objective = blocks.objectives.into_iter().sum();
    prop_assert_eq!(objective.directions, (case.draw.draws * case.draw.directions) as u64);
    Ok(())
}

/// Kernels of every kind with the smallest tile that they fit.
const KERNELS: [(&str, [usize; 3]); 11] = [
    ("gaussian(1.2) * fovvideovdp(60) @ 5x5x8", [5, 5, 8]),
    ("gaussian(2.1) * ema(0.3) @ 7x7x4", [7, 7, 4]),
    ("gaussian_t(1) * gaussian(0.7) @ 3x3x5", [3, 3, 5]),
    ("gaussian(2.1) @ 7x6x1", [7, 6, 1]),
    ("gaussian(5) @ 17x9x1", [17, 9, 1]),
    ("none", [1, 1, 1]),
    ("column", [1, 1, 1]),
    ("0.5: box(3) + 2: frame", [1, 1, 3]),
    ("0.9: gaussian(1) * fovvideovdp(60) @ 3x3x15 + 0.1: column", [3, 3, 15]),
    ("gaussian(1.2) * fovvideovdp(60) @ 5x5x8 of 1..", [5, 5, 8]),
    ("gaussian(1) * box(3) * every(2) @ 3x3x3 of 1 + 0.2: column of 1..", [3, 3, 5]),
];

/// Any of the kernels on a tile at most a bit larger than it must be.
fn kernel_and_size() -> impl Strategy<Value = (&'static str, [usize; 3])> {
    (prop::sample::select(&KERNELS[..]), [0_usize..14, 0_usize..9, 0_usize..4]).prop_map(
        |((kernel, least), more)| (kernel, [0, 1, 2].map(|axis| least[axis] + more[axis])),
    )
}

/// Any taps that span no more than the size, wherever they lie.
fn taps(size: [i32; 3]) -> impl Strategy<Value = KernelTaps> {
    let place = (0..size[0], 0..size[1], 0..size[2]);
    let low = prop::array::uniform3(-12..12_i32);
    let weight = prop_oneof![-1.0..-0.01, 0.01..2.0_f64];
    (prop::collection::btree_map(place, weight, 1..40), low).prop_map(|(taps, low)| {
        let low = IVec3::from_array(low);
        let tap = |((x, y, z), weight)| Tap { offset: low + IVec3::new(x, y, z), weight };
        KernelTaps::new(taps.into_iter().map(tap)).unwrap()
    })
}

/// The distribution of a·u + b·v, a ≥ b, has the quantile √(2abu) up to u = b/2a, and au + b/2 from
/// there to the middle. So the mean over the first [0, 1/n] is ⅔ √(2ab/n) if n ≥ 2a/b, and the last
/// is as far from the other end; and the mean over [i/n, (i + 1)/n] is a(i + ½)/n + b/2 in between.
#[test]
fn plain_targets_of_pairs_are_exact() {
    for (a, b) in [(0.8_f32, 0.6_f32), (0.96, 0.28), (0.7, 0.7), (1.0, 9e-5), (1.0, 3e-8)] {
        for n in [8, 60, 1001, 30_000] {
            let found = ProjectedDensity::new(&[b, a]).targets(n);
            let (a, b, count) = (f64::from(a), f64::from(b), n as f64);
            let knee = b / (2.0 * a) * count;
            let end = 2.0 / 3.0 * (2.0 * a * b / count).sqrt();
            let ends = [(0, end), (n - 1, a + b - end)];
            let straight = (0..n).map(|rank| (rank, a * (rank as f64 + 0.5) / count + 0.5 * b));
            let straight = straight
                .filter(|&(rank, _)| rank as f64 >= knee && (rank + 1) as f64 <= count - knee);
            for (rank, expected) in ends.into_iter().filter(|_| knee >= 1.0).chain(straight) {
                let error = (found[rank] - expected).abs();
                assert!(error < 1e-8, "{a} {b}, {rank} of {n}: {}", found[rank]);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn the_fast_gradient_equals_the_plain_one(
        (kernel, [width, height, frames]) in kernel_and_size(),
        spp in 1_usize..5, dims in prop_oneof![1_usize..6, Just(8)], directions in 1_usize..4,
        threshold_range in prop_oneof![Just(1.0), 0.3..1.0_f64], seed: u64,
    ) {
        let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
        // The plain targets of general directions take long in many dimensions.
        let pair_share = if dims > 5 { 0.8 } else { 0.3 };
        let draw = DrawOptions { directions, threshold_range, pair_share, ..SHARES };
        compare(&Case::of(shape, kernel, draw, seed))?;
    }

    #[test]
    fn any_taps_wrap_around_any_tile(
        (size, taps) in [1..9_i32, 1..9_i32, 1..7_i32].prop_flat_map(|size| (Just(size), taps(size))),
        more in [0_usize..30, 0_usize..3, 0_usize..3], spp in 1_usize..3, seed: u64,
    ) {
        let [width, height, frames] = [0, 1, 2].map(|axis| size[axis] as usize + more[axis]);
        let shape = TileShape::new(width, height, frames, spp, 2).unwrap();
        let levels = LevelSets::new([(1.0, &taps)]);
        let tile = Baseline::White.tile(shape, seed);
        compare(&Case { tile, domain: Domain::Square, levels, draw: SHARES, seed, step: 3 })?;
    }

    /// A kernel that is longer than the tile: the gradient behind the folded kernel is that of the
    /// tile repeated in time, where each tap of a draw lies in any period, summed over its copies.
    #[test]
    fn a_folded_gradient_equals_the_plain_one_on_the_tile_repeated(
        [width, height, frames] in [1..7_usize, 1..7_usize, 1..7_usize],
        taps in taps([1, 1, 30]), spp in 1_usize..3, dims in 1_usize..4,
        periods in prop::collection::vec(-4..5_i32, 30), seed: u64,
    ) {
        let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
        let folded = taps.folded(frames).unwrap();
        prop_assert!(folded.size()[2] <= frames as u64);
        let moved = folded.taps().iter().zip(&periods).map(|(tap, period)| {
            let offset = tap.offset + IVec3::Z * (period * frames as i32);
            Tap { offset, ..*tap }
        });
        let moved = LevelSets::new([(1.0, &KernelTaps::new(moved).unwrap())]);
        let tile = Baseline::White.tile(shape, seed);
        let levels = LevelSets::new([(1.0, &folded)]);
        let case = Case { tile, domain: Domain::Square, levels, draw: SHARES, seed, step: 3 };
        compare(&case)?;

        const COPIES: usize = 9;
        let repeated = TileShape::new(width, height, COPIES * frames, spp, dims).unwrap();
        let repeated = Tile::new(repeated, case.tile.samples().repeat(COPIES)).unwrap();
        let mut draws = case.reference_draws();
        let expected = reference::gradient((&case.tile, case.domain), &case.levels, &draws);
        draws.iter_mut().for_each(|draw| draw.pixel.z += (COPIES / 2 * frames) as i32);
        let copies = reference::gradient((&repeated, case.domain), &moved, &draws);
        for (i, expected) in expected.iter().enumerate() {
            let sum: f64 = copies.iter().skip(i).step_by(shape.coordinates()).sum();
            prop_assert!((sum - expected).abs() < 1e-9, "coordinate {i}: {sum}, not {expected}");
        }
    }

    /// As many equal gradients on one sample as there can be, each as large as it can be.
    #[test]
    fn sums_stay_exact_at_the_limits(
        width in 1_usize..4, dims in prop_oneof![Just(1_usize), Just(2), Just(4)],
        directions in 1_usize..17, draws in 1_usize..300, ones: u8, seed: u64,
    ) {
        let shape = TileShape::new(width, 1, 2, 1, dims).unwrap();
        let draw = DrawOptions { draws, directions, pair_share: 0.8, ..SHARES };
        let mut case = Case::of(shape, "column", draw, seed);
        let corner = |i: usize| if ones >> (i % 8) & 1 == 1 { BELOW_ONE } else { 0.0 };
        case.tile = Tile::new(shape, (0..shape.coordinates()).map(corner).collect()).unwrap();
        compare(&case)?;
    }

    #[test]
    fn bits_depend_on_neither_instructions_nor_order(
        (kernel, [width, height, frames]) in kernel_and_size(),
        spp in 1_usize..4, dims in 1_usize..17, directions in 1_usize..3, seed: u64,
    ) {
        let shape = TileShape::new(width + 64, height + 20, frames, spp, dims).unwrap();
        let case = Case::of(shape, kernel, DrawOptions { directions, ..SHARES }, seed);
        let gradient = case.gradient(Simd::detect());
        let one = fast(&case, &gradient, 1, false);
        let words = fold(shape, &one);
        let objective: Objective = one.objectives.into_iter().sum();
        let plain = case.gradient(Simd::plain());
        let others = [
            ("another order", fast(&case, &gradient, 4, true)),
            ("a block for each cell", fast(&case, &gradient, usize::MAX, false)),
            ("plain", fast(&case, &plain, 2, false)),
            ("bricks", fast(&case, &gradient.clone().with_layout(Layout::Bricks), 2, false)),
            ("curve", fast(&case, &plain.with_layout(Layout::Curve), 3, false)),
        ];
        for (label, other) in others {
            prop_assert_eq!(&words, &fold(shape, &other), "{}", label);
            prop_assert_eq!(objective, other.objectives.into_iter().sum(), "{}", label);
        }
    }
}

#[test]
fn the_objective_of_the_fast_gradient_is_half_of_the_plain_one_per_sample() {
    for (dims, spp) in [(1, 2), (2, 1), (3, 1)] {
        let shape = TileShape::new(9, 8, 8, spp, dims).unwrap();
        let draw = DrawOptions { draws: 30, directions: 2, ..SHARES };
        let case = Case::of(shape, "gaussian(1) * fovvideovdp(60) @ 5x5x8", draw, 3);
        let gradient = case.gradient(Simd::detect());
        let found: Objective = fast(&case, &gradient, 2, false).objectives.into_iter().sum();
        let found = found.squared_distance();
        let w2 = |draw: &ReferenceDraw| {
            let half_sum = reference::objective(
                (&case.tile, case.domain),
                &case.levels,
                std::slice::from_ref(draw),
            );
            2.0 * half_sum / (draw.taps * draw.samples) as f64
        };
        let expected: f64 = case.reference_draws().iter().map(w2).sum();
        assert!((found / expected - 1.0).abs() < 1e-3, "{dims}: {found} {expected}");
    }
}

/// More samples than are ranked by counting.
#[test]
fn large_subsets_are_sorted_right() {
    for (width, height, spp, dims) in [(21, 19, 1, 2), (21, 19, 2, 3), (64, 64, 1, 3)] {
        let shape = TileShape::new(width, height, 2, spp, dims).unwrap();
        let draw = DrawOptions { draws: 3, axis_share: 0.1, ..SHARES };
        compare(&Case::of(shape, "frame", draw, 11)).unwrap();
    }
    let shape = TileShape::new(13, 13, 4, 2, 2).unwrap();
    let draw = DrawOptions { draws: 30, ..SHARES };
    let case = Case::of(shape, "gaussian(6) * box(3) @ 13x13x3", draw, 4);
    assert!(case.reference_draws().iter().any(|draw| draw.taps > 288));
    compare(&case).unwrap();
}

#[test]
fn the_plain_gradient_equals_finite_differences() {
    const STEP: f32 = 1.0 / (1 << 15) as f32;
    for (kernel, dims, directions) in [
        ("gaussian(1) * fovvideovdp(60) @ 3x3x8", 2, 1),
        ("gaussian(1) * ema(0.5) @ 3x3x3", 1, 1),
        ("gaussian(1) * ema(0.5) @ 3x3x3", 3, 2),
        ("0.7: gaussian(1) @ 3x3x1 + 0.3: column", 4, 2),
    ] {
        let shape = TileShape::new(5, 4, 8, 2, dims).unwrap();
        let draw = DrawOptions { draws: 20, directions, ..SHARES };
        let mut case = Case::of(shape, kernel, draw, 5);
        // Room for a step to both sides, and coordinates to which a step adds up exactly.
        let round = |x: &f32| (x * 4000.0).round() / 4096.0 + 0.01;
        let round = |x: &f32| (round(x) / STEP).round() * STEP;
        case.tile = Tile::new(shape, case.tile.samples().iter().map(round).collect()).unwrap();
        let draws = case.reference_draws();
        // Samples that no step can bring past another one of their subset.
        let mut free = vec![true; shape.samples()];
        let mut touched = vec![false; shape.samples()];
        for draw in &draws {
            let subset = case.subset(draw);
            for direction in &draw.directions {
                let mut order: Vec<(f64, usize)> = subset
                    .iter()
                    .map(|&sample| (case.project(sample, &direction.theta[..dims]), sample))
                    .collect();
                order.sort_by(|a, b| a.0.total_cmp(&b.0));
                for pair in order.windows(2).filter(|pair| pair[1].0 - pair[0].0 < f64::from(STEP))
                {
                    (free[pair[0].1], free[pair[1].1]) = (false, false);
                }
                subset.iter().for_each(|&sample| touched[sample] = true);
            }
        }
        let gradient = reference::gradient((&case.tile, case.domain), &case.levels, &draws);
        let subsets: Vec<Vec<usize>> = draws.iter().map(|draw| case.subset(draw)).collect();
        let objective = |word: usize, by: f32| {
            let mut samples = case.tile.samples().to_vec();
            samples[word] += by;
            let tile = Tile::new(shape, samples).unwrap();
            // Other draws do not see the sample.
            let seeing: Vec<ReferenceDraw> = draws
                .iter()
                .zip(&subsets)
                .filter(|(_, subset)| subset.contains(&(word / dims)))
                .map(|(draw, _)| draw.clone())
                .collect();
            reference::objective((&tile, case.domain), &case.levels, &seeing)
        };
        let words: Vec<usize> = (0..shape.coordinates())
            .filter(|word| free[word / dims] && touched[word / dims])
            .collect();
        assert!(words.len() > shape.coordinates() / 4, "{}", words.len());
        for word in words.into_iter().step_by(13) {
            let slope = (objective(word, STEP) - objective(word, -STEP)) / (2.0 * f64::from(STEP));
            let found = gradient[word];
            assert!((slope + found).abs() < 1e-7, "{kernel}: coordinate {word}: {slope} {found}");
        }
    }
}

#[test]
fn wrong_gradients_are_caught() {
    let shape = TileShape::new(40, 9, 8, 2, 2).unwrap();
    let draw = DrawOptions { draws: 400, ..SHARES };
    let case = Case::of(shape, "gaussian(2.1) * fovvideovdp(60) @ 7x7x8", draw, 8);
    let gradient = case.gradient(Simd::detect());
    let unit = gradient.quantum().unit();
    let oracle = Oracle::new(&case, unit);
    let words = fold(shape, &fast(&case, &gradient, 2, false));
    assert_eq!(oracle.check(&words, unit), Ok(()));

    let damaged = |name: &str, words: Vec<i64>| {
        assert!(oracle.check(&words, unit).is_err(), "{name} was not noticed");
    };
    let of_each = |change: &dyn Fn(i64) -> i64| words.iter().map(|&word| change(word)).collect();
    damaged("the wrong sign", of_each(&|word| -word));
    damaged("a wrong factor", of_each(&|word| word + word / 50));
    let mut one = words.clone();
    *one.iter_mut().find(|word| **word != 0).unwrap() += (0.01 / unit) as i64;
    damaged("one wrong coordinate", one);
    let mut turned = words.clone();
    turned.rotate_left(1);
    damaged("a shift by one coordinate", turned);
    damaged("swapped coordinates", words.chunks(2).flat_map(|p| [p[1], p[0]]).collect());
    let mut lost = fast(&case, &gradient, 2, false);
    let halo = lost.blocks[0].reach().left * 4;
    for row in lost.patches[0].chunks_mut(lost.blocks[0].stride()) {
        let size = row.len().min(halo);
        row[..size].fill(0);
    }
    damaged("a lost halo", fold(shape, &lost));
    let mut stale = case.clone();
    stale.step += 1;
    damaged("another step's draws", fold(shape, &fast(&stale, &gradient, 2, false)));
    let mut whole = case.clone();
    whole.draw.threshold_range = 0.9;
    let other = whole.gradient(Simd::detect());
    damaged("other thresholds", fold(shape, &fast(&whole, &other, 2, false)));
    // Every sample of a draw takes the target of the next rank.
    let mut next: Vec<i64> = words.clone();
    for draw in case.reference_draws() {
        let subset = case.subset(&draw);
        for sample in &subset {
            for k in 0..2 {
                let by = draw.directions[0].theta[k] / subset.len() as f32 / unit;
                next[sample * 2 + k] += by as i64;
            }
        }
    }
    damaged("ranks from 1", next);
}

/// No gradient is larger than the unit was chosen for, whatever the options.
#[test]
fn the_unit_leaves_room_for_all_gradients() {
    let mut stream = Stream::new(2, Use::Baseline, 0, 0);
    for _ in 0..300 {
        let mut below = |limit: u32| 1 + stream.below(limit) as usize;
        let dims = below(16);
        let shape = TileShape::new(below(40), below(40), below(4), below(4), dims).unwrap();
        let kernel = ["column", "frame", "0.5: frame + 0.5: column", "none"][below(4) - 1];
        let draw = DrawOptions { draws: 1 << (below(17) - 1), directions: below(16), ..SHARES };
        let case = Case::of(shape, kernel, draw, 1);
        let (draws, partition) = (case.draws(), case.partition());
        let Some(quantum) = Quantum::new(&draws, &partition) else { continue };
        let mut touches = vec![0_u64; shape.samples()];
        // Frames of many pixels are slow to count; a few draws do for them.
        if draw.draws * draws.levels().longest() > 1 << 22 {
            continue;
        }
        for draw in case.reference_draws() {
            case.subset(&draw).into_iter().for_each(|sample| touches[sample] += 1);
        }
        let largest = draw.directions as f64 * (dims as f64).sqrt() * f64::from(quantum.scale());
        let most = touches.into_iter().max().unwrap() as f64;
        assert!((largest + 0.5) * most < f64::from(i32::MAX), "{case:?}");
        assert!(largest < f64::from(1 << 22));
    }
}

/// Tiles of other domains than the square. Targets from many points are off by up to 10⁻³, and in
/// 400 draws two projections are so near each other that their ranks differ once or so: that moves
/// two samples by a rank's share each.
#[test]
fn the_fast_gradient_is_the_plain_one_in_every_domain() {
    let domains = Domain::ALL.into_iter().filter(|domain| !domain.is_square());
    for domain in domains.chain(densities()) {
        for (spp, directions, seed) in [(1, 2, 1), (2, 1, 2), (3, 3, 3)] {
            let dims = domain.dims().unwrap();
            let shape = TileShape::new(17, 11, 8, spp, dims).unwrap();
            let draw = DrawOptions { directions, ..SHARES };
            let kernel = "gaussian(1.2) * fovvideovdp(60) @ 5x5x8 of 1..";
            let mut case = Case::of(shape, kernel, draw, seed);
            (case.domain, case.tile) = (domain, Baseline::White.tile_of(domain, shape, seed));
            for simd in [Simd::detect(), Simd::plain()] {
                let gradient = case.gradient(simd);
                let found = fold(shape, &fast(&case, &gradient, 3, false));
                let draws = case.reference_draws();
                let expected = reference::gradient((&case.tile, domain), &case.levels, &draws);
                let mut touched = vec![0; shape.samples()];
                for draw in &draws {
                    case.subset(draw).into_iter().for_each(|sample| touched[sample] += directions);
                }
                let unit = f64::from(gradient.quantum().unit());
                let (mut moved, mut sum) = (0, 0.0);
                for (i, (&word, expected)) in found.iter().zip(&expected).enumerate() {
                    let error = (word as f64 * unit - expected).abs();
                    let allowed = 1e-3 * f64::from(touched[i / dims] as u32);
                    moved += usize::from(error > allowed);
                    assert!(error < allowed + 0.2, "{domain}: coordinate {i}: {word} {expected}");
                    sum += expected.abs();
                }
                assert!(moved <= 4 * dims, "{domain}: {moved} coordinates");
                assert!(sum / expected.len() as f64 > 0.003, "{domain}: next to no gradient");
            }
        }
    }
}

#[test]
fn the_plain_gradient_of_a_domain_equals_finite_differences() {
    for domain in [Domain::Disk, Domain::Sphere, Domain::Cosine, densities()[0]] {
        let dims = domain.dims().unwrap();
        let shape = TileShape::new(5, 5, 4, 1, dims).unwrap();
        let mut case = Case::of(shape, "gaussian(1) * ema(0.5) @ 3x3x4", SHARES, 5);
        (case.domain, case.tile) = (domain, Baseline::White.tile_of(domain, shape, 5));
        let draws = case.reference_draws();
        let gradient = reference::gradient((&case.tile, domain), &case.levels, &draws);
        let mut checked = 0;
        for i in (0..shape.coordinates()).step_by(7) {
            let at = |by: f32| {
                let mut samples = case.tile.samples().to_vec();
                samples[i] = (samples[i] + by).clamp(0.0, 0.999);
                let tile = Tile::new(shape, samples).unwrap();
                let moved = f64::from(tile.samples()[i]) - f64::from(case.tile.samples()[i]);
                (moved, reference::objective((&tile, domain), &case.levels, &draws))
            };
            // So short a way changes ranks once in a while, which are left out.
            let ((back, low), (on, high)) = (at(-2e-4), at(2e-4));
            let (_, middle) = at(0.0);
            let (left, right) = ((low - middle) / back, (high - middle) / on);
            if (left - right).abs() < 1e-2 {
                let slope = (high - low) / (on - back);
                assert!((slope + gradient[i]).abs() < 1e-3, "{domain} {i}: {slope}");
                checked += 1;
            }
        }
        assert!(checked > 20, "{domain}: {checked}");
    }
}
