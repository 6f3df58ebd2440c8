//! The gradient as the paper's equations say it, in f64 and without haste: the oracle that the
//! fast one is compared with.
//!
//! Nothing here is shared with the fast path but the draws themselves: pixels wrap by remainder,
//! ranks come from a stable sort, targets from the exact CDF of the projected density, inverted
//! by bisection and averaged by quadrature.

use glam::IVec3;

use crate::draw::{Direction, LevelSets};
use crate::tile::Tile;

/// A draw in coordinates of the tile.
#[derive(Debug, Clone)]
pub struct ReferenceDraw {
    /// Pixel `(x, y, t)`.
    pub pixel: IVec3,
    /// Which level set.
    pub set: usize,
    /// How many of its taps.
    pub taps: usize,
    /// Directions of the projections.
    pub directions: Vec<Direction>,
}

/// Half the sum over draws, directions and samples of (projection − target)².
pub fn objective(tile: &Tile, levels: &LevelSets, draws: &[ReferenceDraw]) -> f64 {
    let mut sum = 0.0;
    visit(tile, levels, draws, |_, _, difference| sum += 0.5 * difference * difference);
    sum
}

/// The negative gradient of [`objective`]: for every coordinate in C order, the sum of its pulls.
pub fn pulls(tile: &Tile, levels: &LevelSets, draws: &[ReferenceDraw]) -> Vec<f64> {
    let dims = tile.shape().dims();
    let mut pulls = vec![0.0; tile.shape().coordinates()];
    visit(tile, levels, draws, |sample, direction, difference| {
        for k in 0..dims {
            pulls[sample * dims + k] += difference * f64::from(direction.theta[k]);
        }
    });
    pulls
}

/// Calls `pull(sample, direction, target − projection)` for every sample of every draw.
fn visit(
    tile: &Tile,
    levels: &LevelSets,
    draws: &[ReferenceDraw],
    mut pull: impl FnMut(usize, &Direction, f64),
) {
    let shape = tile.shape();
    let size = IVec3::new(shape.width() as i32, shape.height() as i32, shape.frames() as i32);
    for draw in draws {
        // Where projections are equal, the order of the offsets decides (y first, then t and x).
        let mut offsets = levels.sets()[draw.set].offsets[..draw.taps].to_vec();
        offsets.sort_by_key(|offset| (offset.y, offset.z % size.z, offset.x));
        let subset: Vec<usize> = offsets
            .into_iter()
            .flat_map(|offset| {
                let place = (draw.pixel + offset).rem_euclid(size).as_usizevec3();
                let pixel = shape.pixel(place.x, place.y, place.z);
                (0..shape.spp()).map(move |s| pixel * shape.spp() + s)
            })
            .collect();
        for direction in &draw.directions {
            let projections: Vec<f64> = subset
                .iter()
                .map(|sample| {
                    let first = sample * shape.dims();
                    let point = &tile.samples()[first..first + shape.dims()];
                    point
                        .iter()
                        .zip(direction.theta)
                        .map(|(&x, theta)| f64::from(x) * f64::from(theta))
                        .sum()
                })
                .collect();
            let mut order: Vec<usize> = (0..subset.len()).collect();
            order.sort_by(|&a, &b| projections[a].total_cmp(&projections[b]));
            for (rank, &place) in order.iter().enumerate() {
                let target = target(&direction.theta[..shape.dims()], rank, subset.len());
                pull(subset[place], direction, target - projections[place]);
            }
        }
    }
}

/// Mean of the inverse CDF of the projected uniform density over [rank/n, (rank+1)/n].
pub fn target(theta: &[f32], rank: usize, n: usize) -> f64 {
    // Nodes and weights of Gauss–Legendre quadrature with four points on [0, 1], in eight pieces.
    const NODES: [(f64, f64); 4] = [
        (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
        (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
        (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
        (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
    ];
    const PIECES: usize = 8;
    let mut mean = 0.0;
    for piece in 0..PIECES {
        for (node, weight) in NODES {
            let s = (piece as f64 + node) / PIECES as f64;
            // In s the square roots at both ends of the distribution are smooth.
            let (v, slope) = (s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s));
            let u = (rank as f64 + v) / n as f64;
            mean += weight / PIECES as f64 * slope * quantile(theta, u);
        }
    }
    mean
}

/// Inverse CDF of θ·u for u uniform on the cube, by bisection.
fn quantile(theta: &[f32], u: f64) -> f64 {
    let sum = |keep: fn(f64) -> f64| theta.iter().map(|&x| keep(f64::from(x))).sum::<f64>();
    let (mut low, mut high) = (sum(|x| x.min(0.0)), sum(|x| x.max(0.0)));
    let start = low;
    // Components this small move the distribution by less than they disturb the formula.
    let sides: Vec<f64> =
        theta.iter().map(|x| f64::from(x.abs())).filter(|&side| side > 1e-4).collect();
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if volume_below(&sides, middle - start) < u {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Volume of {u in the unit cube: Σ sideₖ·uₖ < x}, by inclusion and exclusion of the corners.
fn volume_below(sides: &[f64], x: f64) -> f64 {
    let dims = sides.len() as i32;
    let mut sum = 0.0;
    for corner in 0..1_u32 << dims {
        let inside = sides.iter().enumerate().filter(|(k, _)| corner >> k & 1 == 1);
        let rest = x - inside.map(|(_, side)| side).sum::<f64>();
        let sign = if corner.count_ones() % 2 == 0 { 1.0 } else { -1.0 };
        sum += sign * rest.max(0.0).powi(dims);
    }
    let factorial: f64 = (1..=dims).map(f64::from).product();
    sum / (factorial * sides.iter().product::<f64>())
}
