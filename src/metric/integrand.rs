//! The integrands on which tiles are scored: five classes, drawn from a set number.
//!
//! An integrand is a function of (domain, set, class, coordinates, number) alone, the same on every machine,
//! and comes with its exact integral and variance. Scores move by 10 % and more with the set, so
//! tiles are compared on one set, and on sets that nothing was tuned on.

use std::fmt;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::exact::{self, Balls};
use super::split_mix::SplitMix;
use crate::domain::Domain;
use crate::tile::Tile;

/// Integrands with less variance than this over the cube are drawn again, half-spaces that miss
/// all but 0.1 % of it: they would take time and say next to nothing.
pub const LEAST_VARIANCE: f64 = 1e-3;

/// What kind of function is integrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// θ·x, θ a uniform random direction.
    Linear,
    /// 1 on one side of a hyperplane through a uniform random point of the cube, with a uniform
    /// random normal; 0 on the other.
    Edge,
    /// The same with a random axis as normal.
    AxisEdge,
    /// Isotropic Gaussian of height 1 around a uniform random point, standard deviation uniform
    /// in 0.1–0.25.
    Bump,
    /// 1 in a ball around a uniform random point, radius uniform in 0.2–0.5; 0 outside.
    Disk,
}

impl Class {
    /// All classes, in the order in which scores list them.
    pub const ALL: [Self; 5] = [Self::Linear, Self::Edge, Self::AxisEdge, Self::Bump, Self::Disk];
    const ROUND: [Self; 4] = [Self::Linear, Self::Edge, Self::Bump, Self::Disk];

    /// The classes of a domain. The axes of a round one are directions like others, whose half-spaces
    /// are among the edges.
    pub fn of(domain: Domain) -> &'static [Self] {
        if domain.has_axes() { &Self::ALL } else { &Self::ROUND }
    }
}

/// The name that tables show: `linear`, `edge`, `axis edge`, `bump`, `disk`.
impl fmt::Display for Class {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Linear => "linear",
            Self::Edge => "edge",
            Self::AxisEdge => "axis edge",
            Self::Bump => "bump",
            Self::Disk => "disk",
        })
    }
}

/// Which coordinates of a sample the integrands of a column read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coordinates {
    /// All of them.
    All,
    /// A random pair for each integrand.
    Pairs,
}

impl Coordinates {
    /// What integrands for samples of `dims` dimensions read: pairs only above two, in a cube.
    pub fn of(domain: Domain, dims: usize) -> &'static [Self] {
        if dims > 2 && domain.is_square() { &[Self::All, Self::Pairs] } else { &[Self::All] }
    }
}

/// The function's formula, over the coordinates in [`Integrand::dims`].
#[derive(Debug, Clone, PartialEq)]
enum Form {
    Linear {
        direction: Vec<f64>,
    },
    HalfSpace {
        normal: Vec<f64>,
        offset: f64,
    },
    /// exp(−`scale`·|x − centre|²)
    Gaussian {
        centre: Vec<f64>,
        scale: f64,
    },
    Ball {
        centre: Vec<f64>,
        squared_radius: f64,
    },
}

/// One function on `[0, 1]^d` with its exact integral and variance.
#[derive(Debug, Clone, PartialEq)]
pub struct Integrand {
    dims: Vec<usize>,
    form: Form,
    integral: f64,
    variance: f64,
}

impl Integrand {
    /// Draws number `index` of a class in a set, for samples of a domain in `dims` dimensions.
    ///
    /// Above two dimensions the widths of bumps and disks grow with √(dims/2), as the diagonal of
    /// the cube does; otherwise they would hold next to nothing of it (a ball of radius ½ holds
    /// 4·10⁻⁶ of the cube of 16 dimensions).
    fn draw(
        (domain, balls): (Domain, &Balls),
        set: u64,
        class: Class,
        coordinates: Coordinates,
        dims: usize,
        index: usize,
    ) -> Self {
        let key = [set, class as u64, coordinates as u64, dims as u64, index as u64];
        let mut stream = SplitMix::new(&key);
        // In the square every class has a fixed chance of at least a tenth to pass, so this ends. In a
        // density that is nearly all in one place, it may be none: then the best of some counts.
        const ATTEMPTS: usize = 64;
        let mut best: Option<Self> = None;
        let mut attempts = 0;
        loop {
            attempts += 1;
            let dims = match coordinates {
                Coordinates::All => (0..dims).collect(),
                Coordinates::Pairs => {
                    let first = stream.below(dims);
                    let second = (first + 1 + stream.below(dims - 1)) % dims;
                    vec![first, second]
                }
            };
            let integrand = if domain.is_square() {
                Self::attempt(balls, &mut stream, class, dims)
            } else {
                Some(Self::in_domain(domain, &mut stream, class, dims))
            };
            let least = match class {
                Class::Linear => LEAST_VARIANCE * domain.spread() * domain.spread(),
                _ => LEAST_VARIANCE,
            };
            let Some(integrand) = integrand else { continue };
            if integrand.variance >= least {
                return integrand;
            }
            if best.as_ref().is_none_or(|best| integrand.variance > best.variance) {
                best = Some(integrand);
            }
            if let Some(best) = best.take_if(|_| !domain.is_square() && attempts >= ATTEMPTS) {
                return best;
            }
        }
    }

    /// One try; `None` if its integral is not known well enough.
    fn attempt(
        balls: &Balls,
        stream: &mut SplitMix,
        class: Class,
        mut dims: Vec<usize>,
    ) -> Option<Self> {
        let n = dims.len();
        let widening = libm::sqrt((n as f64 / 2.0).max(1.0));
        let indicator = |share: f64| (share, share * (1.0 - share));
        let (form, (integral, variance)) = match class {
            Class::Linear => {
                let direction = stream.direction(n);
                let mean = direction.iter().sum::<f64>() / 2.0;
                (Form::Linear { direction }, (mean, 1.0 / 12.0))
            }
            Class::Edge => {
                let normal = stream.direction(n);
                let point = stream.point(n);
                let offset = normal.iter().zip(&point).map(|(a, x)| a * x).sum();
                let share = exact::half_space(&normal, offset)?;
                (Form::HalfSpace { normal, offset }, indicator(share))
            }
            Class::AxisEdge => {
                dims = vec![dims[stream.below(n)]];
                let position = stream.uniform();
                let form = Form::HalfSpace { normal: vec![1.0], offset: position };
                (form, indicator(1.0 - position))
            }
            Class::Bump => {
                let centre = stream.point(n);
                let sigma = stream.range(0.1, 0.25) * widening;
                let mean = exact::gaussian(&centre, sigma);
                // The square of a Gaussian is one of σ/√2.
                let square = exact::gaussian(&centre, sigma / std::f64::consts::SQRT_2);
                let scale = 1.0 / (2.0 * sigma * sigma);
                (Form::Gaussian { centre, scale }, (mean, square - mean * mean))
            }
            Class::Disk => {
                let centre = stream.point(n);
                let radius = stream.range(0.2, 0.5) * widening;
                let share = balls.volume(&centre, radius);
                (Form::Ball { centre, squared_radius: radius * radius }, indicator(share))
            }
        };
        Some(Self { dims, form, integral, variance })
    }

    /// One of a domain whose shares of half-spaces and balls are known: the classes of the square, with
    /// the domain's points where that has points, and all half-spaces as they are cut. Bumps and disks
    /// are as wide as the domain, relative to the square.
    fn in_domain(domain: Domain, stream: &mut SplitMix, class: Class, dims: Vec<usize>) -> Self {
        let n = dims.len();
        let indicator = |share: f64| (share, share * (1.0 - share));
        let point = |stream: &mut SplitMix| -> Vec<f64> {
            let mut point = vec![0.0; n];
            domain.point(&stream.point(domain.parameters(n)), &mut point);
            point.into_iter().map(f64::from).collect()
        };
        let half_space = |normal: Vec<f64>, through: Vec<f64>| {
            let offset = normal.iter().zip(&through).map(|(a, x)| a * x).sum();
            let share = 1.0 - domain.below(&normal, offset);
            (Form::HalfSpace { normal, offset }, indicator(share))
        };
        let (form, (integral, variance)) = match class {
            Class::Linear => {
                let direction = stream.direction(n);
                let moments = domain.along(&direction);
                (Form::Linear { direction }, moments)
            }
            Class::Edge => {
                let normal = stream.direction(n);
                half_space(normal, point(stream))
            }
            Class::AxisEdge => {
                let mut normal = vec![0.0; n];
                normal[stream.below(n)] = 1.0;
                half_space(normal, point(stream))
            }
            Class::Bump => {
                let centre = point(stream);
                let sigma = stream.range(0.1, 0.25) * domain.spread();
                let mean = domain.gaussian(&centre, sigma);
                let square = domain.gaussian(&centre, sigma / std::f64::consts::SQRT_2);
                let scale = 1.0 / (2.0 * sigma * sigma);
                (Form::Gaussian { centre, scale }, (mean, square - mean * mean))
            }
            Class::Disk => {
                let centre = point(stream);
                let radius = stream.range(0.2, 0.5) * domain.spread();
                let share = domain.within(&centre, radius);
                (Form::Ball { centre, squared_radius: radius * radius }, indicator(share))
            }
        };
        Self { dims, form, integral, variance }
    }

    /// Which coordinates of a sample the function reads.
    pub fn dims(&self) -> &[usize] {
        &self.dims
    }

    /// ∫f over the domain; off by less than 10⁻⁷.
    pub fn integral(&self) -> f64 {
        self.integral
    }

    /// ∫f² − (∫f)², at least [`LEAST_VARIANCE`] but in densities that are nearly all in one place.
    pub fn variance(&self) -> f64 {
        self.variance
    }

    /// f at a point, given all its coordinates.
    ///
    /// # Panics
    /// If the point has fewer dimensions than the integrand was made for.
    pub fn at(&self, point: &[f32]) -> f64 {
        let mut value = 0.0;
        self.each(point, point.len(), |f| value = f);
        value
    }

    /// e = mean over the samples of each pixel of f − ∫f, in the pixels' C order, into `errors`;
    /// returns its mean over the tile.
    ///
    /// # Panics
    /// If `errors` is not of the tile's number of pixels, or the tile has too few dimensions.
    pub fn errors(&self, tile: &Tile, errors: &mut [f32]) -> f64 {
        let shape = tile.shape();
        assert_eq!(errors.len(), shape.pixels(), "one error per pixel");
        let spp = shape.spp();
        let mut total = 0.0;
        if spp == 1 {
            let mut pixels = errors.iter_mut();
            self.each(tile.samples(), shape.dims(), |f| {
                let error = f - self.integral;
                total += error;
                if let Some(pixel) = pixels.next() {
                    *pixel = error as f32;
                }
            });
        } else {
            for (pixel, samples) in
                errors.iter_mut().zip(tile.samples().chunks_exact(spp * shape.dims()))
            {
                let mut sum = 0.0;
                self.each(samples, shape.dims(), |f| sum += f);
                let error = sum / spp as f64 - self.integral;
                total += error;
                *pixel = error as f32;
            }
        }
        total / shape.pixels() as f64
    }

    /// Calls `then` with f of every point of `samples`, which have `stride` coordinates each.
    #[inline]
    fn each(&self, samples: &[f32], stride: usize, mut then: impl FnMut(f64)) {
        let points = samples.chunks_exact(stride);
        let indicator = |inside: bool| f64::from(u8::from(inside));
        match (&self.form, &self.dims[..]) {
            (Form::Linear { direction }, dims) => {
                points.for_each(|p| then(dot(p, dims, direction)));
            }
            (Form::HalfSpace { normal, offset }, dims) => {
                points.for_each(|p| then(indicator(dot(p, dims, normal) > *offset)));
            }
            (Form::Gaussian { centre, scale }, dims) => {
                points.for_each(|p| then(libm::exp(-scale * squared_distance(p, dims, centre))));
            }
            (Form::Ball { centre, squared_radius }, dims) => {
                points.for_each(|p| {
                    then(indicator(squared_distance(p, dims, centre) < *squared_radius));
                });
            }
        }
    }
}

/// Σ direction·point over the chosen coordinates; two of them, the usual case, without a loop.
#[inline(always)]
fn dot(point: &[f32], dims: &[usize], direction: &[f64]) -> f64 {
    match (dims, direction) {
        (&[i, j], &[a, b]) => a * f64::from(point[i]) + b * f64::from(point[j]),
        _ => dims.iter().zip(direction).map(|(&i, a)| a * f64::from(point[i])).sum(),
    }
}

/// Σ (point − centre)² over the chosen coordinates.
#[inline(always)]
fn squared_distance(point: &[f32], dims: &[usize], centre: &[f64]) -> f64 {
    let squared = |i: usize, c: f64| {
        let difference = f64::from(point[i]) - c;
        difference * difference
    };
    match (dims, centre) {
        (&[i, j], &[a, b]) => squared(i, a) + squared(j, b),
        _ => dims.iter().zip(centre).map(|(&i, &c)| squared(i, c)).sum(),
    }
}

/// The integrands of one column of a table: one class that reads all coordinates or pairs.
#[derive(Debug, Clone, PartialEq)]
pub struct IntegrandSet {
    /// Their class.
    pub class: Class,
    /// Which coordinates they read.
    pub coordinates: Coordinates,
    /// The functions.
    pub integrands: Vec<Integrand>,
}

/// All integrands of set number `set` for samples of a domain in `dims` dimensions, `count` of
/// each class that reads all coordinates, and of each that reads pairs.
pub fn integrand_sets(domain: Domain, set: u64, dims: usize, count: usize) -> Vec<IntegrandSet> {
    let balls = Balls::new();
    Coordinates::of(domain, dims)
        .iter()
        .flat_map(|&coordinates| Class::of(domain).iter().map(move |&class| (class, coordinates)))
        .map(|(class, coordinates)| IntegrandSet {
            class,
            coordinates,
            integrands: (0..count)
                .into_par_iter()
                .map(|index| {
                    Integrand::draw((domain, &balls), set, class, coordinates, dims, index)
                })
                .collect(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::baseline::Baseline;
    use super::*;
    use crate::domain::Density;
    use crate::tile::TileShape;

    #[test]
    fn integrals_and_variances_agree_with_quasi_monte_carlo() {
        for dims in [1, 2, 3, 5, 8, 16] {
            let shape = TileShape::new(256, 1, 64, 1, dims).unwrap();
            let tile = Baseline::Sobol.tile(shape, 1);
            let n = shape.samples() as f64;
            for set in integrand_sets(Domain::Square, 11, dims, 6) {
                for f in &set.integrands {
                    let (mut sum, mut squares, mut largest) = (0.0, 0.0, 0.0_f64);
                    for point in tile.samples().chunks_exact(dims) {
                        let value = f.at(point);
                        sum += value;
                        squares += value * value;
                        largest = largest.max(value.abs());
                    }
                    let (mean, square) = (sum / n, squares / n);
                    // 256 scrambled sets of 64 points err by at most 3.5 of what as many
                    // independent points do, and mostly by far less.
                    let bound = 3.5 * (f.variance() / n).sqrt();
                    assert!((mean - f.integral()).abs() < bound, "{dims} {f:?}: {mean}");
                    // f² varies at most 2·max|f| times as much as f, and so does (∫f)².
                    let error = square - mean * mean - f.variance();
                    assert!(error.abs() < 4.0 * largest * bound, "{dims} {f:?}: {error}");
                }
            }
        }
    }

    /// A spot has the integrands of the whole square, as much smaller as it is.
    #[test]
    fn integrands_are_as_wide_as_the_density() {
        let sets = |size: [usize; 2], is_full: fn(usize) -> bool| {
            let level = |i: usize| f64::from(u8::from(is_full(i)));
            let levels: Vec<f64> = (0..size[0] * size[1]).map(level).collect();
            let density = Density::new("spot", size, &levels).unwrap();
            integrand_sets(Domain::Density(density), 1, 2, 6)
        };
        let whole = sets([2, 1], |_| true);
        let spot = sets([16, 16], |i| (4..8).contains(&(i % 16)) && (8..12).contains(&(i / 16)));
        for (whole, spot) in whole.iter().zip(&spot).filter(|(it, _)| it.class != Class::Linear) {
            for (f, g) in whole.integrands.iter().zip(&spot.integrands) {
                let error = f.integral() - g.integral();
                assert!(error.abs() < 1e-5, "{}: {error}", whole.class);
            }
        }
    }

    /// Nearly all in one place: no disk cuts it, and there are integrands all the same.
    #[test]
    fn densities_that_are_nearly_points_have_integrands() {
        let mut levels = vec![0.0; 64 * 64];
        (levels[0], levels[64 * 64 - 1]) = (1.0, 5e-4);
        let density = Density::new("spots", [64, 64], &levels).unwrap();
        for set in integrand_sets(Domain::Density(density), 1, 2, 3) {
            assert!(set.integrands.iter().all(|f| f.variance() > 0.0), "{:?}", set.class);
        }
    }

    #[test]
    fn integrals_in_other_domains_are_means_over_their_points() {
        for domain in crate::domain::tests::domains() {
            let dims = domain.dims().unwrap();
            let shape = TileShape::new(256, 1, 256, 1, dims).unwrap();
            let tile = Baseline::Sobol.tile_of(domain, shape, 1);
            let n = shape.samples() as f64;
            let sets = integrand_sets(domain, 11, dims, 12);
            assert_eq!(sets.len(), if domain.has_axes() { 5 } else { 4 }, "{domain}");
            for f in sets.iter().flat_map(|set| &set.integrands) {
                let values = || tile.samples().chunks_exact(dims).map(|point| f.at(point));
                let mean = values().sum::<f64>() / n;
                let square = values().map(|value| value * value).sum::<f64>() / n;
                let bound = 3.5 * (f.variance() / n).sqrt();
                assert!((mean - f.integral()).abs() < bound, "{domain} {f:?}: {mean}");
                let error = square - mean * mean - f.variance();
                assert!(error.abs() < 8.0 * bound, "{domain} {f:?}: {error}");
            }
        }
    }

    #[test]
    fn errors_are_means_over_the_samples_of_a_pixel() {
        for (spp, dims) in [(1, 2), (3, 3)] {
            let shape = TileShape::new(5, 4, 2, spp, dims).unwrap();
            let tile = Baseline::White.tile(shape, 2);
            for f in
                integrand_sets(Domain::Square, 1, dims, 2).iter().flat_map(|set| &set.integrands)
            {
                let mut errors = vec![0.0; shape.pixels()];
                let bias = f.errors(&tile, &mut errors);
                let mut total = 0.0;
                for (x, y, t) in
                    (0..2).flat_map(|t| (0..4).flat_map(move |y| (0..5).map(move |x| (x, y, t))))
                {
                    let sum: f64 = (0..spp).map(|s| f.at(tile.point(x, y, t, s))).sum();
                    let expected = sum / spp as f64 - f.integral();
                    let found = f64::from(errors[shape.pixel(x, y, t)]);
                    assert!((found - expected).abs() < 1e-7, "{found} {expected}");
                    total += expected;
                }
                assert!((bias - total / shape.pixels() as f64).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn sets_are_functions_of_their_number() {
        let set = |number, count| integrand_sets(Domain::Square, number, 3, count);
        let (a, b) = (set(1, 4), set(1, 8));
        for (few, many) in a.iter().zip(&b) {
            assert_eq!(few.integrands[..], many.integrands[..4]);
        }
        assert_ne!(a, set(2, 4));
        assert_eq!(a.len(), 10);
        assert!(a.iter().flat_map(|s| &s.integrands).all(|f| f.variance() >= LEAST_VARIANCE));
    }

    #[test]
    fn pairs_are_of_two_different_dimensions_and_reach_all() {
        let mut seen = [[false; 4]; 4];
        for set in integrand_sets(Domain::Square, 5, 4, 64)
            .iter()
            .filter(|set| set.coordinates == Coordinates::Pairs)
        {
            for f in set.integrands.iter().filter(|f| f.dims().len() == 2) {
                seen[f.dims()[0]][f.dims()[1]] = true;
            }
        }
        for (i, row) in seen.iter().enumerate() {
            for (j, &pair) in row.iter().enumerate() {
                assert_eq!(pair, i != j);
            }
        }
    }

    #[test]
    fn published_sets_stay_as_they_are() {
        // Scores are quoted with the number of their set: a change here breaks every quotation.
        let published = [
            -0.5477971053294525,
            0.13224084344954304,
            0.7427821683733837,
            0.14974661116556487,
            0.1786746646105618,
        ];
        for (set, integral) in integrand_sets(Domain::Square, 0, 2, 1).iter().zip(published) {
            let found = set.integrands[0].integral();
            assert!((found - integral).abs() < 1e-14, "{}: {found}", set.class);
        }
    }
}
