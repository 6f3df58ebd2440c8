//! Where samples live: the square (or cube), and domains that engines ask for as often.
//!
//! The paper's bound (Eq. 6) holds for samples of any distribution. What else differs from domain to
//! domain stands here, one file each: the distribution of projections on a direction, which gives the
//! targets of the descent ([`Domain::below`], [`Cdf`]); how a sample that was moved comes back
//! ([`Surface`]); an equal-area map from the square and back, for starts and for cells
//! ([`Domain::point`], [`Domain::place`]); how strongly the whole domain pulls at a point, for the
//! polish ([`Pull`]); shares of half-spaces and balls, for the scores. The rest of the program
//! asks for these and knows no domain by name.
//!
//! A tile holds numbers in [0, 1), so a circle, disk or sphere is the one of radius ½ around ½; here
//! points are those of the unit circle, disk or sphere, or of the square [−1, 1]², around 0 where they
//! are called *centred*.

mod attraction;
mod cdf;
mod circle;
mod cosine;
mod density;
mod disk;
mod hemisphere;
mod mask;
mod picture;
mod pull;
mod read;
mod spec;
mod sphere;
mod surface;

pub use attraction::Attraction;
pub use cdf::{Cdf, GRID};
pub use density::{Density, DensityError, MAX_PIXELS};
pub use mask::Mask;
pub use pull::{Even, Plane, Pull, Uneven};
pub use spec::DomainSpec;
pub use surface::Surface;

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;

use crate::tile::{Tile, TileShape, clamp_coordinate};

/// Where samples live.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Domain {
    /// The unit square, or the cube of any other number of dimensions.
    #[default]
    Square,
    /// Unit vectors in the plane.
    Circle,
    /// The disk, filled evenly.
    Disk,
    /// Unit vectors in space.
    Sphere,
    /// Unit vectors with a last component of 0 and more, evenly.
    Hemisphere,
    /// The same with a density in proportion to the last component, as light falls on a matt surface.
    Cosine,
    /// The unit square with a density in proportion to a picture's gray levels.
    Density(Density),
}

/// A domain that does not go with the dimensions of a tile, or that there is none of.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DomainError {
    /// Another number of dimensions.
    #[error("a sample of the domain `{domain}` has {expected} dimensions, not {found}")]
    Dims {
        /// The domain.
        domain: Domain,
        /// What its points have.
        expected: usize,
        /// What the tile has.
        found: usize,
    },
    /// A point that is not of the domain.
    #[error("sample {index} is {point:?}, which is not a point of the domain `{domain}`")]
    Outside {
        /// The domain.
        domain: Domain,
        /// Number of the sample in C order.
        index: usize,
        /// Its coordinates.
        point: Vec<f32>,
    },
    /// A tile that cannot be mapped.
    #[error(
        "samples of {expected} dimensions can be mapped to the domain `{domain}`, not of {found}"
    )]
    Places {
        /// The domain.
        domain: Domain,
        /// Numbers that place a point.
        expected: usize,
        /// What the tile has.
        found: usize,
    },
    /// An unknown name.
    #[error("`{found}` is no domain; there are: {}, density(FILE)", Domain::NAMES.join(", "))]
    Name {
        /// What was asked for.
        found: String,
    },
    /// A file that holds no density.
    #[error("the density `{file}` {why}")]
    File {
        /// Path as given.
        file: String,
        /// What is wrong with it.
        why: String,
    },
}

/// Which directions see a domain alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Symmetry {
    /// Signed permutations of the axes.
    Cube,
    /// All of them.
    Round,
    /// Those with the same last component.
    Axial,
    /// None but opposite ones.
    None,
}

/// What a domain other than the square says of itself, in centred coordinates.
trait Shape {
    /// Dimensions of a point.
    fn dims(&self) -> usize;
    /// Numbers that place a point.
    fn parameters(&self) -> usize {
        2
    }
    /// Which directions see it alike.
    fn symmetry(&self) -> Symmetry;
    /// How moved samples come back.
    fn surface(&'static self) -> Surface;
    /// The point of a place in the unit square, such that equal areas have equal shares.
    fn point(&self, place: [f64; 2]) -> [f64; 3];
    /// The place of a point: the inverse of [`Self::point`].
    fn place(&self, point: [f64; 3]) -> [f64; 2];
    /// Whether projections on any direction are uniform.
    fn has_uniform_projections(&self) -> bool {
        false
    }
    /// Whether its axes are other than directions between them.
    fn has_axes(&self) -> bool {
        false
    }
    /// Whether the warp moves places, which then have as many numbers as points.
    fn is_warped_by_places(&self) -> bool {
        false
    }
    /// The share with θ·x < `t`, for a unit vector θ.
    fn below(&self, theta: [f64; 3], t: f64) -> f64;
    /// The distribution of θ·x/2, which is in [−½, ½] on round domains.
    fn cdf(&self, theta: [f64; 3]) -> Cdf {
        Cdf::new(-0.5, 1.0, |t| self.below(theta, 2.0 * t))
    }
    /// The share within a distance of `centre`, a point of the domain: of unit vectors those on one
    /// side of a plane.
    fn within(&self, centre: [f64; 3], distance: f64) -> f64 {
        1.0 - self.below(centre, 1.0 - 0.5 * distance * distance)
    }
    /// The mean of exp(−|x − centre|² / 2σ²): its values on rings, by the shares of these.
    fn gaussian(&self, centre: [f64; 3], sigma: f64) -> f64 {
        /// Rings up to the domain's diameter of 2. Halving them changes no mean by 10⁻⁷.
        const RINGS: usize = 4096;
        let mut sum = 0.0;
        let (mut inner, mut within) = (1.0, 0.0);
        for ring in 1..=RINGS {
            let distance = 2.0 * ring as f64 / RINGS as f64;
            let outer = libm::exp(-0.5 * (distance / sigma) * (distance / sigma));
            let share = self.within(centre, distance);
            sum += 0.5 * (inner + outer) * (share - within);
            (inner, within) = (outer, share);
        }
        sum
    }
    /// Means of a point's coordinates.
    fn mean(&self) -> [f64; 3];
    /// Their variances.
    fn variances(&self) -> [f64; 3];
    /// The variance of θ·x; by the variances alone where coordinates do not depend on each other
    /// linearly.
    fn variance(&self, theta: [f64; 3]) -> f64 {
        theta.iter().zip(self.variances()).map(|(a, variance)| a * a * variance).sum()
    }
    /// How wide it is, in its own units.
    fn spread(&self) -> f64 {
        1.0
    }
}

impl Domain {
    /// All domains that a name says, the one that is meant without a word first.
    pub const ALL: [Self; 6] =
        [Self::Square, Self::Circle, Self::Disk, Self::Sphere, Self::Hemisphere, Self::Cosine];
    /// Their names, which users type.
    pub const NAMES: [&str; 6] = ["square", "circle", "disk", "sphere", "hemisphere", "cosine"];

    /// What it says of itself; nothing of the square.
    fn shape(self) -> Option<&'static dyn Shape> {
        match self {
            Self::Square => None,
            Self::Circle => Some(&circle::Circle),
            Self::Disk => Some(&disk::Disk),
            Self::Sphere => Some(&sphere::Sphere),
            Self::Hemisphere => Some(&hemisphere::Hemisphere),
            Self::Cosine => Some(&cosine::Cosine),
            Self::Density(density) => Some(density.picture()),
        }
    }

    /// Whether it is the square, or the cube.
    pub fn is_square(self) -> bool {
        self == Self::Square
    }

    /// Dimensions of its points; `None` if they may have any number.
    pub fn dims(self) -> Option<usize> {
        self.shape().map(Shape::dims)
    }

    /// Checks that samples of so many dimensions can be its points.
    ///
    /// # Errors
    /// Another number than its points have.
    pub fn check(self, dims: usize) -> Result<(), DomainError> {
        match self.dims() {
            Some(expected) if expected != dims => {
                Err(DomainError::Dims { domain: self, expected, found: dims })
            }
            _ => Ok(()),
        }
    }

    /// A tile whose samples are its points, but for what rounding to 8 bits does to them: that is taken
    /// back as far as it left the domain.
    ///
    /// # Errors
    /// The first sample that is no such point, and samples of another number of dimensions.
    pub fn adopt(self, tile: &Tile) -> Result<Tile, DomainError> {
        /// Half a step of 8 bits along each of three axes.
        const ROUNDING: f32 = 0.0035;
        /// As far off as arithmetic in f32 leaves a point, which stays where it is.
        const EXACT: f32 = 1e-6;
        let dims = tile.shape().dims();
        self.check(dims)?;
        if self.is_square() {
            return Ok(tile.clone());
        }
        let slack = match self.surface() {
            Surface::Mask(mask) => mask.slack(),
            _ => 0.0,
        };
        let mut samples = tile.samples().to_vec();
        self.surface().bring_all_back(&mut samples, dims);
        let pairs = samples.chunks_exact_mut(dims).zip(tile.samples().chunks_exact(dims));
        for (index, (back, point)) in pairs.enumerate() {
            let square: f32 = back.iter().zip(point).map(|(a, b)| (a - b) * (a - b)).sum();
            if square.sqrt() > ROUNDING + slack {
                return Err(DomainError::Outside { domain: self, index, point: point.to_vec() });
            }
            if square < EXACT * EXACT {
                back.copy_from_slice(point);
            }
        }
        Ok(with_dims(tile.shape(), dims, samples))
    }

    /// Which directions see it alike.
    pub fn symmetry(self) -> Symmetry {
        self.shape().map_or(Symmetry::Cube, Shape::symmetry)
    }

    /// Whether projections on any direction are uniform.
    pub fn has_uniform_projections(self) -> bool {
        self.shape().is_some_and(Shape::has_uniform_projections)
    }

    /// Whether its axes are other than directions between them.
    pub fn has_axes(self) -> bool {
        self.shape().is_none_or(Shape::has_axes)
    }

    /// Whether the warp moves places, which then have as many numbers as points.
    pub fn is_warped_by_places(self) -> bool {
        self.shape().is_some_and(Shape::is_warped_by_places)
    }

    /// The density, if it is one.
    pub fn density(self) -> Option<Density> {
        match self {
            Self::Density(density) => Some(density),
            _ => None,
        }
    }

    /// Bytes that each process has of it, beside what all domains take.
    pub fn bytes(self) -> usize {
        self.density().map_or(0, |density| density.picture().bytes())
    }

    /// How wide it is, relative to a square or disk that fills the unit square.
    pub fn spread(self) -> f64 {
        self.shape().map_or(1.0, Shape::spread)
    }

    /// How moved samples come back.
    pub fn surface(self) -> Surface {
        self.shape().map_or(Surface::Cube, Shape::surface)
    }

    /// How samples come back while they are optimized. Those of a density may be where it is empty, on
    /// their way from one part of it to another; [`Mask::enter`] ends that.
    pub fn surface_on_the_way(self) -> Surface {
        match self.surface() {
            Surface::Mask(_) => Surface::Cube,
            surface => surface,
        }
    }

    /// Numbers that place a point of `dims` dimensions: two on a surface or in a plane, one on a line,
    /// all of a cube's.
    pub fn parameters(self, dims: usize) -> usize {
        match self.shape() {
            None => dims,
            Some(shape) => shape.parameters(),
        }
    }

    /// The point, as a tile has it, of a place in the unit square: equal areas have equal shares.
    ///
    /// # Panics
    /// If `place` or `point` is shorter than it must be.
    pub fn point(self, place: &[f64], point: &mut [f32]) {
        let Some(shape) = self.shape() else {
            point.iter_mut().zip(place).for_each(|(x, &u)| *x = clamp_coordinate(u as f32));
            return;
        };
        let centred = shape.point([place[0], place.get(1).copied().unwrap_or_default()]);
        for (x, y) in point.iter_mut().zip(centred) {
            *x = clamp_coordinate((0.5 + 0.5 * y) as f32);
        }
        // Rounding may have put it on the first coordinate of an empty pixel.
        if let (Surface::Mask(mask), [x, y]) = (self.surface(), point) {
            [*x, *y] = mask.bring_back([*x, *y]);
        }
    }

    /// The place in the unit square, of which a point that a tile has is [`Self::point`].
    pub fn place(self, point: &[f32]) -> Vec<f64> {
        match self.shape() {
            None => point.iter().map(|&x| f64::from(x)).collect(),
            Some(shape) => shape.place(centred(point))[..self.parameters(point.len())].to_vec(),
        }
    }

    /// Turns points of two dimensions into their places, where these have two numbers.
    pub fn to_places(self, samples: &mut [f32]) {
        if let Some(shape) = self.shape() {
            for point in samples.as_chunks_mut::<2>().0 {
                *point = shape.place(centred(point)).map(|u| clamp_coordinate(u as f32));
            }
        }
    }

    /// Turns places of two numbers into points, where these have two dimensions.
    pub fn to_points(self, places: &mut [f32]) {
        for place in places.as_chunks_mut::<2>().0 {
            self.point(&place.map(f64::from), place);
        }
    }

    /// A tile of the square's places, mapped to the domain.
    ///
    /// # Errors
    /// A tile whose samples have not as many dimensions as there are numbers in a place.
    pub fn map(self, places: &Tile) -> Result<Tile, DomainError> {
        let shape = places.shape();
        let dims = self.dims().unwrap_or(shape.dims());
        let expected = self.parameters(dims);
        if shape.dims() != expected {
            return Err(DomainError::Places { domain: self, expected, found: shape.dims() });
        }
        let mut samples = vec![0.0; shape.samples() * dims];
        let mut place = vec![0.0; expected];
        for (from, to) in places.samples().chunks(expected).zip(samples.chunks_mut(dims)) {
            place.iter_mut().zip(from).for_each(|(u, &x)| *u = f64::from(x));
            self.point(&place, to);
        }
        Ok(with_dims(shape, dims, samples))
    }

    /// The places in the square of a tile's points: evenly spread where the points are.
    pub fn places(self, tile: &Tile) -> Tile {
        let shape = tile.shape();
        let point =
            |point: &[f32]| self.place(point).into_iter().map(|u| clamp_coordinate(u as f32));
        let samples = tile.samples().chunks(shape.dims()).flat_map(point).collect();
        with_dims(shape, self.parameters(shape.dims()), samples)
    }

    /// The share of the domain with θ·x < `offset`, x as a tile has it and θ a unit vector.
    ///
    /// # Panics
    /// If it is the square.
    pub fn below(self, theta: &[f64], offset: f64) -> f64 {
        let centre = 0.5 * theta.iter().sum::<f64>();
        self.known().below(vector(theta), 2.0 * (offset - centre))
    }

    /// The share of the domain within a distance of one of its points, both as a tile has them.
    ///
    /// # Panics
    /// If it is the square.
    pub fn within(self, centre: &[f64], distance: f64) -> f64 {
        self.known().within(middle(centre), 2.0 * distance)
    }

    /// The mean over the domain of exp(−|x − centre|² / 2σ²) around one of its points, as a tile has
    /// them.
    ///
    /// # Panics
    /// If it is the square.
    pub fn gaussian(self, centre: &[f64], sigma: f64) -> f64 {
        self.known().gaussian(middle(centre), 2.0 * sigma)
    }

    /// Mean and variance of θ·x, x as a tile has it.
    ///
    /// # Panics
    /// If it is the square.
    pub fn along(self, theta: &[f64]) -> (f64, f64) {
        let (shape, theta) = (self.known(), vector(theta));
        let mean: f64 =
            theta.iter().zip(shape.mean()).map(|(a, mean)| a * (0.5 + 0.5 * mean)).sum();
        (mean, 0.25 * shape.variance(theta))
    }

    /// What a domain other than the square says of itself.
    fn known(self) -> &'static dyn Shape {
        self.shape().expect("a domain other than the square")
    }

    /// Means and variances of a point's coordinates, as a tile has them.
    pub fn moments(self, dims: usize) -> Vec<(f64, f64)> {
        let Some(shape) = self.shape() else { return vec![(0.5, 1.0 / 12.0); dims] };
        let of = |(mean, variance): (f64, f64)| (0.5 + 0.5 * mean, 0.25 * variance);
        shape.mean().into_iter().zip(shape.variances()).map(of).take(dims).collect()
    }

    /// The distribution of θ·x for x in the domain and a unit vector θ: of the cube from its lower
    /// end on, of others around the middle of the cube that a tile has.
    pub fn cdf(self, theta: &[f32]) -> Cdf {
        match self.shape() {
            None => Cdf::of_sum(theta),
            Some(shape) => {
                let mut wide = [0.0; 3];
                wide.iter_mut().zip(theta).for_each(|(wide, &x)| *wide = f64::from(x));
                shape.cdf(wide)
            }
        }
    }

    /// How strongly the domain pulls at a sample in the polish.
    pub fn pull(self) -> Pull {
        match self {
            Self::Density(density) => Pull::Uneven(Uneven::new(density.picture())),
            _ => self.shape().map_or_else(
                || Pull::Even(Even::new()),
                |shape| Pull::Chords(Attraction::new(shape)),
            ),
        }
    }
}

/// A tile of another number of dimensions.
fn with_dims(shape: TileShape, dims: usize, samples: Vec<f32>) -> Tile {
    let [width, height, frames] = [shape.width(), shape.height(), shape.frames()];
    let shape = TileShape::new(width, height, frames, shape.spp(), dims);
    Tile::new(shape.expect("a size within limits"), samples).expect("coordinates in [0, 1)")
}

/// A direction with three components.
fn vector(theta: &[f64]) -> [f64; 3] {
    let mut vector = [0.0; 3];
    vector.iter_mut().zip(theta).for_each(|(to, &x)| *to = x);
    vector
}

/// A point in double precision, centred.
fn middle(point: &[f64]) -> [f64; 3] {
    let mut centred = [0.0; 3];
    centred.iter_mut().zip(point).for_each(|(y, x)| *y = 2.0 * x - 1.0);
    centred
}

/// A point of a tile, centred.
fn centred(point: &[f32]) -> [f64; 3] {
    let mut centred = [0.0; 3];
    centred.iter_mut().zip(point).for_each(|(y, &x)| *y = 2.0 * f64::from(x) - 1.0);
    centred
}

/// The text that users type.
impl fmt::Display for Domain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        DomainSpec::from(*self).fmt(f)
    }
}

/// Reads the file of a density.
impl FromStr for Domain {
    type Err = DomainError;

    fn from_str(text: &str) -> Result<Self, DomainError> {
        text.parse::<DomainSpec>()?.resolve()
    }
}

/// How processes and checkpoints have a domain, and people one of a density.
#[derive(Serialize, Deserialize)]
enum Whole {
    Named(u8),
    #[serde(rename = "density")]
    Density(Density),
}

/// What people may say.
#[derive(Deserialize)]
#[serde(untagged)]
enum Said {
    Text(String),
    Other(serde::de::IgnoredAny),
}

/// For people its name.
impl Serialize for Domain {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let number = Self::ALL.iter().position(|domain| domain == self);
        match (self, number) {
            (Self::Density(density), _) => Whole::Density(*density).serialize(serializer),
            _ if serializer.is_human_readable() => serializer.collect_str(self),
            (_, number) => Whole::Named(number.unwrap_or_default() as u8).serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Domain {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            let rule = "a domain is read from its name, and a density from its picture";
            return match Said::deserialize(deserializer)? {
                Said::Text(text) => text.parse().map_err(serde::de::Error::custom),
                Said::Other(_) => Err(serde::de::Error::custom(rule)),
            };
        }
        match Whole::deserialize(deserializer)? {
            Whole::Density(density) => Ok(Self::Density(density)),
            Whole::Named(number) => Self::ALL
                .get(usize::from(number))
                .copied()
                .ok_or_else(|| serde::de::Error::custom(format!("there is no domain {number}"))),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
