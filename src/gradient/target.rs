//! Where ranked samples should be: quantiles of the domain's density, projected.
//!
//! The target of rank i among n is the mean of the inverse CDF over [i/n, (i+1)/n] (supplement,
//! Eq. 8). Along a direction with at most two components the density of the cube is a trapezoid and
//! the mean has a closed form, written so that nothing cancels; along others, and in other domains,
//! it comes from tables.

use std::collections::HashMap;
use std::f64;
use std::sync::{Arc, LazyLock, Mutex, OnceLock, PoisonError};

use super::simd::{Isa, PLACES};
use crate::domain::{Cdf, Domain, Symmetry};
use crate::draw::{Direction, DirectionSet, Projection};
use crate::tile::MAX_DIMS;

/// Targets along the directions of a tile's domain.
#[derive(Debug, Clone)]
pub struct Targets {
    dims: usize,
    /// Whether the domain is in a ball of radius ½.
    round: bool,
    /// Whether tables count from the middle of the cube on, not from the lower end of a projection.
    centred: bool,
    /// Whether projections may have gaps.
    has_gaps: bool,
    /// Whether a projection's distribution may be other than its mirror image.
    skewed: bool,
    /// For every direction of the fixed set.
    tables: Arc<[Table]>,
    /// Means of √u over [i, i + 1].
    root_means: Vec<f32>,
}

/// The quantiles along one direction.
#[derive(Debug)]
struct Table {
    /// What is projected, and on which direction.
    domain: Domain,
    theta: Vec<f32>,
    /// The integral of the inverse CDF from 0 to j/[`NODES`], j = 0..=NODES.
    integrals: Vec<f64>,
    /// The CDF that it is made from, for subsets of more samples than there are nodes.
    cdf: OnceLock<Cdf>,
}

/// Intervals of a table.
pub(super) const NODES: usize = 2048;

/// Tables of every domain and every number of dimensions that was asked for: they depend on nothing
/// else, and take a tenth of a second and some megabytes.
static TABLES: LazyLock<Mutex<Tables>> = LazyLock::new(Mutex::default);

/// The tables of each domain and number of dimensions.
type Tables = HashMap<(Domain, usize), Arc<[Table]>>;

impl Targets {
    /// Tables for the directions of `set`.
    pub fn new(set: &DirectionSet) -> Self {
        let (domain, dims) = (set.domain(), set.dims());
        let table = |theta: &[f32; MAX_DIMS]| Table::new(domain, &theta[..dims]);
        let all = || set.representatives().iter().map(table).collect();
        let mut known = TABLES.lock().unwrap_or_else(PoisonError::into_inner);
        let tables = known.entry((domain, dims)).or_insert_with(all).clone();
        Self {
            dims,
            round: domain.surface().is_round(),
            centred: !domain.is_square(),
            has_gaps: domain.symmetry() == Symmetry::None,
            skewed: matches!(domain.symmetry(), Symmetry::Axial | Symmetry::None),
            tables,
            root_means: root_means(1024),
        }
    }

    /// Lowest projection of a point of the domain, and how far above it the highest one may be.
    pub fn extent(&self, direction: &Direction) -> (f32, f32) {
        let (low, length) = direction.extent(self.dims);
        if self.round { (low + 0.5 * length - 0.5, 1.0) } else { (low, length) }
    }

    /// The inverse CDF along `direction` at `u` in [0, 1], counted from the start of its extent.
    pub fn quantile(&self, direction: &Direction, u: f64) -> f64 {
        match direction.projection {
            Projection::Trapezoid => {
                let (mut a, mut b) = (0.0_f64, 0.0_f64);
                for x in direction.theta.map(|x| f64::from(x.abs())) {
                    (a, b) = (a.max(x), b.max(a.min(x)));
                }
                let half = |u: f64| {
                    if u * 2.0 * a <= b { libm::sqrt(2.0 * a * b * u) } else { a * u + 0.5 * b }
                };
                if u <= 0.5 { half(u) } else { a + b - half(1.0 - u) }
            }
            Projection::Uniform => u,
            Projection::Table { index } => {
                let half = 0.5 / NODES as f64;
                let mean = self.mean_of(index, (u - half).max(0.0), (u + half).min(1.0));
                if self.centred { mean + 0.5 * f64::from(self.extent(direction).1) } else { mean }
            }
        }
    }

    /// How far a sample at a place has to go that should be the quantile of `u`, both counted from the
    /// start of the extent. Across a gap in a density a whole range of places is as good: to the
    /// nearest of them.
    pub fn displacement(&self, direction: &Direction, u: f64, place: f64) -> f64 {
        match direction.projection {
            Projection::Table { index } if self.has_gaps => {
                let step = 1.0 / NODES as f64;
                let (low, high) = ((u - step).max(0.0), (u + step).min(1.0));
                let length = f64::from(self.extent(direction).1);
                let mean = |low: f64, high: f64| self.mean_of(index, low, high) + 0.5 * length;
                let below = if low < u { mean(low, u) } else { 0.0 };
                let above = if u < high { mean(u, high) } else { length };
                place.clamp(below.min(above), above) - place
            }
            _ => self.quantile(direction, u) - place,
        }
    }

    /// The mean of the inverse CDF of a table from `low` to `high`.
    fn mean_of(&self, index: u32, low: f64, high: f64) -> f64 {
        let table = &self.tables[index as usize].integrals;
        (integral(table, high) - integral(table, low)) / (high - low)
    }

    /// Writes the targets along `direction` of all ranks of a set of `targets.len()` samples;
    /// `integrals` is scratch that the caller lends.
    #[inline(always)]
    pub fn fill<I: Isa>(
        &self,
        isa: I,
        direction: &Direction,
        integrals: &mut Vec<f64>,
        targets: &mut [f32],
    ) {
        // Negative components mirror the projection; it then starts below 0.
        let (low, _) = direction.extent(self.dims);
        match direction.projection {
            Projection::Trapezoid => {
                let (mut a, mut b) = (0.0_f32, 0.0_f32);
                for x in &direction.theta[..self.dims] {
                    let x = x.abs();
                    (a, b) = (a.max(x), b.max(a.min(x)));
                }
                trapezoid(a, b, low, &self.root_means, targets);
            }
            Projection::Uniform => {
                let (low, _) = self.extent(direction);
                trapezoid(1.0, 0.0, low, &self.root_means, targets);
            }
            Projection::Table { index } if self.skewed => {
                let n = targets.len();
                let integrals = self.integrals(isa, index, n, n, integrals);
                let (low, length) = self.extent(direction);
                let middle = low + 0.5 * length;
                for (target, ends) in targets.iter_mut().zip(integrals.windows(2)) {
                    *target = middle + ((ends[1] - ends[0]) * n as f64) as f32;
                }
            }
            Projection::Table { index } => {
                // The distribution is symmetric, so one half of the targets gives the other.
                let (low, length) = self.extent(direction);
                // From where on the table counts.
                let origin = if self.centred { low + 0.5 * length } else { low };
                let (n, half) = (targets.len(), targets.len().div_ceil(2));
                let integrals = self.integrals(isa, index, n, half, integrals);
                let (front, back) = targets.split_at_mut(half);
                for (target, ends) in front.iter_mut().zip(integrals.windows(2)) {
                    *target = ((ends[1] - ends[0]) * n as f64) as f32;
                }
                let length = if self.centred { 0.0 } else { length };
                for (target, mirror) in back.iter_mut().rev().zip(&*front) {
                    *target = (length - mirror) + origin;
                }
                front.iter_mut().for_each(|target| *target += origin);
            }
        }
    }

    /// The integral of the inverse CDF from 0 to i/n for i up to `last` at least, in scratch.
    #[inline(always)]
    fn integrals<'a, I: Isa>(
        &self,
        isa: I,
        index: u32,
        n: usize,
        last: usize,
        scratch: &'a mut Vec<f64>,
    ) -> &'a [f64] {
        let places = (last + 1).next_multiple_of(PLACES);
        if scratch.len() < places {
            scratch.resize(places, 0.0);
        }
        let integrals = &mut scratch[..places];
        let table = &self.tables[index as usize];
        if n <= NODES {
            isa.interpolate(&table.integrals, NODES as f64 / n as f64, integrals);
        } else {
            table.integrate(n, integrals);
        }
        integrals
    }
}

/// The integral of the inverse CDF from 0 to `u`, from a table of it.
#[inline(always)]
fn integral(table: &[f64], u: f64) -> f64 {
    let place = u * NODES as f64;
    let node = (place as usize).min(NODES - 1);
    table[node] + (table[node + 1] - table[node]) * (place - node as f64)
}

/// Targets for the sum of two independent uniform numbers on [0, a] and [0, b], a ≥ b ≥ 0.
///
/// With c = b/2a, the inverse CDF is √(2abu) for u ≤ c and au + b/2 up to 1/2; the rest is its
/// mirror image. `means` are those of √u over [i, i + 1].
#[inline(always)]
fn trapezoid(a: f32, b: f32, low: f32, means: &[f32], targets: &mut [f32]) {
    let n = targets.len();
    let count = n as f32;
    let knee = count * (b / (2.0 * a));
    let root = (2.0 * a * b / count).sqrt();
    let slope = a / (2.0 * count);
    let half = n / 2;
    let (front, back) = targets.split_at_mut(n - half);
    let (near, far) = front[..half].split_at_mut(half.min(means.len()));
    let pick = |i: f32, mean: f32| {
        let straight = slope * (2.0 * i + 1.0) + 0.5 * b;
        if i + 1.0 <= knee { root * mean } else { straight }
    };
    for (i, (target, &mean)) in near.iter_mut().zip(means).enumerate() {
        *target = pick(i as u32 as f32, mean);
    }
    for (i, target) in far.iter_mut().enumerate() {
        let i = (i + means.len()) as u32 as f32;
        *target = pick(i, (i + 0.5).sqrt());
    }
    let bend = knee as usize;
    if bend < half {
        // The interval that has both parts; their means by their lengths.
        let start = bend as f32;
        let (s0, s1) = (start.sqrt(), knee.sqrt());
        let below = (knee - start) * (start + s0 * s1 + knee) / (s0 + s1 + f32::MIN_POSITIVE);
        let end = start + 1.0;
        let above = (end - knee) * (slope * (knee + end) + 0.5 * b);
        front[bend] = root * (2.0 / 3.0) * below + above;
    }
    for (target, mirror) in back.iter_mut().rev().zip(&front[..half]) {
        *target = (a + b - mirror) + low;
    }
    for target in &mut front[..half] {
        *target += low;
    }
    if n % 2 == 1 {
        front[half] = 0.5 * (a + b) + low;
    }
}

/// Means of √u over [i, i + 1] for i below `count`; from 1024 on √(i + ½) is as good in f32.
fn root_means(count: u32) -> Vec<f32> {
    let power = |i: u32| f64::from(i) * f64::from(i).sqrt();
    (0..count).map(|i| (2.0 / 3.0 * (power(i + 1) - power(i))) as f32).collect()
}

impl Table {
    /// Of a domain along a direction.
    fn new(domain: Domain, theta: &[f32]) -> Self {
        let mut integrals = vec![0.0; NODES + 1];
        domain.cdf(theta).integrate_inverse(NODES, &mut integrals);
        let theta = theta.to_vec();
        Self { domain, theta, integrals, cdf: OnceLock::new() }
    }

    /// The integral of the inverse CDF from 0 to i/n, for every i that there is a place for.
    #[cold]
    #[inline(never)]
    fn integrate(&self, n: usize, integrals: &mut [f64]) {
        self.cdf.get_or_init(|| self.domain.cdf(&self.theta)).integrate_inverse(n, integrals);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::tests::densities;
    use crate::draw::{Stream, Use};
    use crate::gradient::reference::ProjectedDensity;
    use crate::gradient::simd::Plain;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_trapezoid_has_the_targets_of_its_exact_cdf(
            a in 0.1_f32..2.0, n in prop_oneof![1_usize..90, 1000_usize..5000],
            ratio in prop_oneof![0.0..=1.0_f32, Just(0.0), (-9.0..0.0_f32).prop_map(|x| 10_f32.powf(x))],
        ) {
            let b = a * ratio;
            let mut targets = vec![0.0; n];
            trapezoid(a, b, 0.0, &root_means(1024), &mut targets);
            let exact = ProjectedDensity::new(&[b, a]);
            let pairs = exact.targets(n).into_iter().zip(exact.slack(n));
            for (rank, (expected, slack)) in pairs.enumerate() {
                let error = (f64::from(targets[rank]) - expected).abs();
                prop_assert!(error <= slack, "{rank} of {n}: {error}, not {slack}");
            }
        }
    }

    #[test]
    fn means_of_quantiles_are_targets() {
        for dims in [1, 2, 3, 7] {
            let set = DirectionSet::new(Domain::Square, dims);
            let all = Targets::new(&set);
            let mut stream = Stream::new(9, Use::Directions, 0, 0);
            for u in [0.1, 0.6] {
                let direction = set.any(u, &mut stream);
                let low: f64 = direction.theta.iter().map(|x| f64::from(x.min(0.0))).sum();
                let mut targets = [0.0; 20];
                all.fill(Plain, &direction, &mut Vec::new(), &mut targets);
                for (rank, target) in targets.into_iter().enumerate() {
                    let points = (0..200).map(|k| (rank as f64 + (k as f64 + 0.5) / 200.0) / 20.0);
                    let mean = points.map(|u| all.quantile(&direction, u)).sum::<f64>() / 200.0;
                    assert!((mean + low - f64::from(target)).abs() < 1e-4, "{dims}: {rank}");
                }
            }
        }
    }

    #[test]
    fn an_axis_has_equally_spaced_targets() {
        let set = DirectionSet::new(Domain::Square, 2);
        let mut targets = vec![0.0; 5];
        Targets::new(&set).fill(Plain, &set.axis(1), &mut Vec::new(), &mut targets);
        for (target, expected) in targets.into_iter().zip([0.1, 0.3, 0.5, 0.7, 0.9]) {
            assert!((target - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn mirrored_directions_have_mirrored_targets() {
        let set = DirectionSet::new(Domain::Square, 2);
        let targets = Targets::new(&set);
        let mut direction = set.pair(0, 1, 0.2);
        let mut forward = vec![0.0; 7];
        targets.fill(Plain, &direction, &mut Vec::new(), &mut forward);
        direction.theta = direction.theta.map(|x| -x);
        let mut backward = vec![0.0; 7];
        targets.fill(Plain, &direction, &mut Vec::new(), &mut backward);
        for (a, b) in forward.iter().zip(backward.iter().rev()) {
            assert!((a + b).abs() < 1e-6);
        }
    }

    #[test]
    fn tables_equal_sorted_projections() {
        for dims in [3, 5, 16] {
            let set = DirectionSet::new(Domain::Square, dims);
            let targets = Targets::new(&set);
            let mut stream = Stream::new(3, Use::Directions, 0, 0);
            for u in [0.0, 0.3, 0.77] {
                let direction = set.any(u, &mut stream);
                let count = 200_000;
                let mut projections: Vec<f64> = (0..count)
                    .map(|_| {
                        direction.theta[..dims]
                            .iter()
                            .map(|&theta| f64::from(theta) * stream.unit())
                            .sum()
                    })
                    .collect();
                projections.sort_by(f64::total_cmp);
                let n = 8;
                let mut found = vec![0.0; n];
                targets.fill(Plain, &direction, &mut Vec::new(), &mut found);
                for (target, chunk) in found.iter().zip(projections.chunks(count / n)) {
                    let mean = chunk.iter().sum::<f64>() / chunk.len() as f64;
                    assert!((f64::from(*target) - mean).abs() < 4e-3, "{dims}: {target} {mean}");
                }
            }
        }
    }

    #[test]
    fn tables_have_the_targets_of_the_exact_cdf_for_subsets_of_any_size() {
        for (dims, sizes) in [(3, &[1, 60, 2048, 2049, 4096, 50_000][..]), (6, &[4096]), (8, &[60])]
        {
            let set = DirectionSet::new(Domain::Square, dims);
            let targets = Targets::new(&set);
            let mut stream = Stream::new(5, Use::Directions, 0, 0);
            for (&n, u) in sizes.iter().flat_map(|n| [0.0, 0.4, 0.9].map(|u| (n, u))) {
                let direction = set.any(u, &mut stream);
                let mut found = vec![0.0; n];
                targets.fill(Plain, &direction, &mut Vec::new(), &mut found);
                let exact = ProjectedDensity::new(&direction.theta[..dims]);
                let pairs = exact.targets(n).into_iter().zip(exact.slack(n));
                for (rank, (expected, slack)) in pairs.enumerate() {
                    let error = (f64::from(found[rank]) - expected).abs();
                    assert!(error <= slack, "{dims}: {rank} of {n}: {error}, not {slack}");
                }
                assert!(found.windows(2).all(|pair| pair[0] < pair[1]), "{dims}: {n}");
            }
        }
    }

    /// Columns 9 and 10 of the islands are empty: there and at their borders samples are right that have
    /// the share of what is left of them below them. Elsewhere they go to the quantile.
    #[test]
    fn nobody_has_to_go_across_a_gap() {
        let domain = densities()[0];
        let set = DirectionSet::new(domain, 2);
        let targets = Targets::new(&set);
        let axis = Projection::Table { index: DirectionSet::ANGLES as u32 };
        let mut theta = [0.0; MAX_DIMS];
        theta[0] = 1.0;
        let direction = Direction { theta, projection: axis };
        let below = domain.below(&[1.0, 0.0], 10.0 / 14.0);
        for place in [9.0, 9.4, 10.7, 11.0].map(|column| column / 14.0) {
            let by = targets.displacement(&direction, below, place);
            // The gap is within an interval of the table, which knows its middle only.
            assert!(by.abs() < 0.01, "{place}: {by}");
        }
        for u in [0.1, below - 0.05, below + 0.05, 0.9] {
            let quantile = targets.quantile(&direction, u);
            for place in [quantile - 0.1, quantile + 0.07] {
                let by = targets.displacement(&direction, u, place);
                assert!((by - (quantile - place)).abs() < 2e-3, "{u} {place}: {by}");
            }
        }
    }

    #[test]
    fn a_table_of_two_components_equals_the_trapezoid() {
        let (a, b) = (0.8_f32, 0.6_f32);
        let tables = Arc::new([Table::new(Domain::Square, &[a, b])]);
        let targets = Targets {
            dims: 3,
            round: false,
            centred: false,
            has_gaps: false,
            skewed: false,
            tables,
            root_means: root_means(1024),
        };
        let mut theta = [0.0; MAX_DIMS];
        (theta[0], theta[2]) = (b, a);
        for n in [1, 4, 61, 1000] {
            let mut expected = vec![0.0; n];
            trapezoid(a, b, 0.0, &root_means(9), &mut expected);
            let mut found = vec![0.0; n];
            let direction = Direction { theta, projection: Projection::Table { index: 0 } };
            targets.fill(Plain, &direction, &mut Vec::new(), &mut found);
            for (x, y) in found.iter().zip(&expected) {
                assert!((x - y).abs() < 1e-4, "{n}: {x} {y}");
            }
        }
    }
}
