//! From the description of a kernel to the taps of each of its classes, for one tile.
//!
//! Factors compose by convolution in f64, then the truncation drops taps, then what is left is
//! scaled to Σ|g| = 1. Every value comes from sums in a fixed order and from `libm`, so it is the
//! same on every machine.

use std::ops::Range;

use glam::IVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::kernel::factor::Weights;
use crate::kernel::grid::{Grid, GridAxis};
use crate::kernel::prefix::Prefix;
use crate::kernel::spec::{ClassKind, DEFAULT_PERCENT, Factor, KernelSpec, MAX_LENGTH, Truncation};
use crate::kernel::table::TableError;
use crate::kernel::taps::{KernelTaps, Tap, TapsError};
use crate::tile::TileShape;

/// Most taps of a mixture, in all its classes together, and of one product before truncation.
pub const MAX_TAPS: usize = 1 << 22;
/// Most multiplications of one convolution.
const MAX_WORK: usize = 1 << 28;
/// Taps whose weights differ by less than this part tie: the last digits of a sum may differ
/// between offsets that mirror each other.
const TIE: f64 = 1e-9;

/// A kernel ready for use: its classes in the order of the description.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<KernelClass>", into = "Vec<KernelClass>")]
pub struct Kernel {
    classes: Vec<KernelClass>,
}

impl TryFrom<Vec<KernelClass>> for Kernel {
    type Error = TapsError;

    fn try_from(classes: Vec<KernelClass>) -> Result<Self, TapsError> {
        let known = |class: &KernelClass| {
            let prefix = class.prefix.map_or(Ok(()), Prefix::check);
            class.weight > 0.0 && class.weight <= 1.0 && prefix.is_ok()
        };
        let known = !classes.is_empty() && classes.iter().all(known);
        if known { Ok(Self { classes }) } else { Err(TapsError::Unscaled) }
    }
}

impl From<Kernel> for Vec<KernelClass> {
    fn from(kernel: Kernel) -> Self {
        kernel.classes
    }
}

/// One class of a mixture, resolved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KernelClass {
    /// Share of the draws that take this class; the shares of a mixture sum to 1.
    pub weight: f64,
    /// Its taps, scaled to Σ|g| = 1.
    pub taps: KernelTaps,
    /// The samples of a pixel that it sees; without it, all.
    pub prefix: Option<Prefix>,
    /// What its truncation left out.
    pub dropped: Dropped,
    /// Its text form.
    pub text: String,
}

/// The share of Σ|g| that a truncation leaves out, each in [0, 1].
///
/// Infinite factors end where they are below 1e−12 of their peak, and a Gaussian at its radius;
/// what lies beyond is not counted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Dropped {
    /// In all.
    pub total: f64,
    /// Outside the width or the height of the box, whatever the frame; for a product of space
    /// and time this is the share of its spatial part. None if the truncation is not a box.
    pub space: Option<f64>,
    /// Outside the frames of the box, wherever in space. None if the truncation is not a box.
    pub time: Option<f64>,
}

impl Dropped {
    const NOTHING: Self = Self { total: 0.0, space: Some(0.0), time: Some(0.0) };
}

/// Why a described kernel cannot be used with a tile.
#[derive(Debug, Error, Clone, PartialEq)]
#[error("the kernel `{class}` {problem}")]
pub struct KernelError {
    /// Text form of the class concerned.
    pub class: String,
    /// What is wrong with it.
    pub problem: ResolveProblem,
}

/// What is wrong with a class; continues the words "the kernel".
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ResolveProblem {
    /// It does not fit into the pixels of the tile.
    #[error(
        "is {kernel} pixels {wide}, but the tile has only {tile}: truncate it to a box, `@ WIDTHxHEIGHTxFRAMES`, of at most {tile} pixels, or take a larger tile"
    )]
    Wider {
        /// "wide" or "high".
        wide: &'static str,
        /// Size of the kernel.
        kernel: u64,
        /// Size of the tile.
        tile: usize,
    },
    /// It depends on the size of the tile, and there is none.
    #[error("covers a whole tile, so it needs the size of one")]
    NeedsTile,
    /// It has too many taps, before or after truncation.
    #[error(
        "has {taps} taps, but all kernels together may have at most {MAX_TAPS}: truncate it to a box, or its factors by their radius"
    )]
    Taps {
        /// Their number.
        taps: usize,
    },
    /// Its factors together are too long, before truncation.
    #[error(
        "extends over {length} pixels or frames before truncation, but at most {MAX_LENGTH} are allowed: give its factors a radius"
    )]
    Length {
        /// The largest of its sizes.
        length: usize,
    },
    /// Composing its factors would take too long.
    #[error(
        "takes {work} multiplications to compose, but at most {MAX_WORK} are allowed: give its factors a radius"
    )]
    Work {
        /// Multiplications of one convolution.
        work: usize,
    },
    /// A table cannot be used.
    #[error("cannot be made: {0}")]
    Table(#[from] TableError),
    /// Its taps are not a kernel, for example because they cancel or all lie outside the box.
    #[error("cannot be used: {0}")]
    Empty(#[from] TapsError),
}

impl KernelSpec {
    /// The kernel for a tile of that shape. It may be longer than the tile in time: a tile repeats,
    /// and [`Kernel::folded`] says what it sees.
    ///
    /// # Errors
    /// A class that is wider than the tile, too large to compute, without taps, or made of a
    /// table that cannot be read.
    pub fn resolve(&self, shape: TileShape) -> Result<Kernel, KernelError> {
        self.resolve_in(Some(shape))
    }

    /// The kernel without regard to a tile, to look at.
    ///
    /// # Errors
    /// As [`resolve`](Self::resolve), and `column` or `frame`, which are made for a tile.
    pub fn resolve_without_tile(&self) -> Result<Kernel, KernelError> {
        self.resolve_in(None)
    }

    fn resolve_in(&self, shape: Option<TileShape>) -> Result<Kernel, KernelError> {
        let sum: f64 = self.classes().iter().map(|class| class.weight).sum();
        let mut left = MAX_TAPS;
        let mut classes = Vec::with_capacity(self.classes().len());
        for class in self.classes() {
            let resolved = resolve_class(&class.kind, shape, left).and_then(|(taps, dropped)| {
                shape.map_or(Ok(()), |shape| check_size(&taps, shape))?;
                Ok((taps, dropped))
            });
            let text = class.unweighted();
            let (taps, dropped) =
                resolved.map_err(|problem| KernelError { class: text.clone(), problem })?;
            left -= taps.taps().len();
            let (weight, prefix) = (class.weight / sum, class.prefix);
            classes.push(KernelClass { weight, taps, prefix, dropped, text });
        }
        Ok(Kernel { classes })
    }
}

impl Kernel {
    /// The classes, in the order of the description.
    pub fn classes(&self) -> &[KernelClass] {
        &self.classes
    }

    /// The samples of a pixel in groups of which a draw sees all or none: the ends of all prefixes
    /// part them. Without prefixes there is one group.
    pub fn layers(&self, spp: usize) -> Vec<Range<usize>> {
        let prefixes = self.classes.iter().filter_map(|class| class.prefix);
        let mut ends: Vec<usize> = prefixes
            .flat_map(|prefix| prefix.shares(spp))
            .map(|(samples, _)| samples)
            .filter(|&samples| samples < spp)
            .chain([spp])
            .collect();
        ends.sort_unstable();
        ends.dedup();
        let start = |i: usize| i.checked_sub(1).map_or(0, |before| ends[before]);
        (0..ends.len()).map(|i| start(i)..ends[i]).collect()
    }

    /// What a tile sees that repeats after so many frames: every class folded at its period
    /// ([`KernelTaps::folded`]).
    ///
    /// # Errors
    /// A class whose weights cancel each other.
    pub fn folded(&self, frames: usize) -> Result<Self, KernelError> {
        let fold = |class: &KernelClass| {
            let taps = class.taps.folded(frames).map_err(|error| class.error(error.into()))?;
            Ok(KernelClass { taps, ..class.clone() })
        };
        Ok(Self { classes: self.classes.iter().map(fold).collect::<Result<_, _>>()? })
    }

    /// Whether every class fits into the pixels of a tile of that shape.
    ///
    /// # Errors
    /// The first class that is wider or higher than the tile.
    pub fn check(&self, shape: TileShape) -> Result<(), KernelError> {
        let fits = |class: &KernelClass| {
            check_size(&class.taps, shape).map_err(|problem| class.error(problem))
        };
        self.classes.iter().try_for_each(fits)
    }
}

impl KernelClass {
    fn error(&self, problem: ResolveProblem) -> KernelError {
        KernelError { class: self.text.clone(), problem }
    }
}

fn check_size(taps: &KernelTaps, shape: TileShape) -> Result<(), ResolveProblem> {
    let [width, height, _] = taps.size();
    for (kernel, tile, wide) in [(width, shape.width(), "wide"), (height, shape.height(), "high")] {
        if kernel > tile as u64 {
            return Err(ResolveProblem::Wider { wide, kernel, tile });
        }
    }
    Ok(())
}

/// The taps of a class, at most `left` of them, and what truncation dropped.
fn resolve_class(
    kind: &ClassKind,
    shape: Option<TileShape>,
    left: usize,
) -> Result<(KernelTaps, Dropped), ResolveProblem> {
    let (taps, dropped) = match kind {
        ClassKind::Column => {
            let frames = shape.ok_or(ResolveProblem::NeedsTile)?.frames();
            (equal([1, 1, frames], left)?, Dropped::NOTHING)
        }
        ClassKind::Frame => {
            let shape = shape.ok_or(ResolveProblem::NeedsTile)?;
            (equal([shape.width(), shape.height(), 1], left)?, Dropped::NOTHING)
        }
        ClassKind::Product { factors, truncation } => {
            let product = Product::new(factors)?;
            let by_default = factors
                .iter()
                .any(Factor::is_infinite)
                .then_some(Truncation::Share { percent: DEFAULT_PERCENT });
            product.truncate(truncation.or(by_default), left)?
        }
    };
    Ok((KernelTaps::new(taps)?, dropped))
}

/// Equal weights over a box of pixels across, down and frames, in the places of a truncation box.
fn equal([width, height, frames]: [usize; 3], left: usize) -> Result<Vec<Tap>, ResolveProblem> {
    let count = width * height * frames;
    if count > left {
        return Err(ResolveProblem::Taps { taps: count });
    }
    let first = |n: usize| -((n / 2) as i32);
    let mut taps = Vec::with_capacity(count);
    for t in 0..frames as i32 {
        for y in 0..height as i32 {
            for x in 0..width as i32 {
                let offset = IVec3::new(first(width) + x, first(height) + y, -t);
                taps.push(Tap { offset, weight: 1.0 });
            }
        }
    }
    Ok(taps)
}

/// The composition of the factors of a class: `x` × `y` × `time`, convolved with all tables, with
/// every so many frames seen.
struct Product {
    x: Grid,
    y: Grid,
    time: Grid,
    tables: Option<Grid>,
    every: u64,
}

impl Product {
    fn new(factors: &[Factor]) -> Result<Self, ResolveProblem> {
        let one = Grid::one;
        let mut product = Self { x: one(), y: one(), time: one(), tables: None, every: 1 };
        for factor in factors {
            match factor.weights()? {
                Weights::One => {}
                Weights::Space { low, row } => {
                    product.x = convolve(&product.x, &Grid::row(GridAxis::X, low, row.clone()))?;
                    product.y = convolve(&product.y, &Grid::row(GridAxis::Y, low, row))?;
                }
                Weights::Time(row) => product.time = convolve(&product.time, &row)?,
                Weights::Every(frames) => {
                    product.every = product.every.saturating_mul(u64::from(frames));
                }
                Weights::Table(table) => {
                    product.tables = Some(match &product.tables {
                        Some(tables) => convolve(tables, &table)?,
                        None => table,
                    });
                }
            }
        }
        Ok(product)
    }

    /// All weights on one grid.
    fn compose(&self) -> Result<Grid, ResolveProblem> {
        // The spatial product first: gx·gy is the same for mirrored offsets, whatever comes after.
        let space = convolve(&self.y, &self.x)?;
        match &self.tables {
            None => convolve(&self.time, &space),
            // Row by row: one multiplication per weight and axis instead of their product.
            Some(tables) => {
                let long = convolve(tables, &self.time)?;
                convolve(&convolve(&long, &self.y)?, &self.x)
            }
        }
    }

    fn truncate(
        self,
        truncation: Option<Truncation>,
        left: usize,
    ) -> Result<(Vec<Tap>, Dropped), ResolveProblem> {
        let every = self.every;
        let (taps, dropped) = match truncation {
            None => (self.compose()?.taps().collect(), Dropped::NOTHING),
            Some(Truncation::Share { percent }) => keep_share(&self.compose()?, percent / 100.0),
            Some(Truncation::Box { width, height, frames }) => {
                self.keep_box([width, height, frames].map(|n| n as i32))?
            }
        };
        let mut taps: Vec<Tap> = taps.into_iter().filter(|tap: &Tap| tap.weight != 0.0).collect();
        for tap in &mut taps {
            // Frames in between are not seen, and no truncation counts them.
            let seen = u64::from(tap.offset.z.unsigned_abs());
            let length = seen.saturating_mul(every);
            if length >= u64::from(MAX_LENGTH) {
                let length = usize::try_from(length).unwrap_or(usize::MAX);
                return Err(ResolveProblem::Length { length });
            }
            tap.offset.z = length as i32 * tap.offset.z.signum();
        }
        if taps.len() > left {
            Err(ResolveProblem::Taps { taps: taps.len() })
        } else {
            Ok((taps, dropped))
        }
    }

    /// The taps inside a box of pixels across, down and frames.
    fn keep_box(mut self, size: [i32; 3]) -> Result<(Vec<Tap>, Dropped), ResolveProblem> {
        let full = match &self.tables {
            Some(_) => Some(self.compose()?),
            None => None,
        };
        let into_future =
            |grid: &Grid| grid.taps().any(|tap| tap.weight != 0.0 && tap.offset.z > 0);
        let centred = into_future(full.as_ref().unwrap_or(&self.time));
        let mut low = IVec3::from_array(size.map(|n| -(n / 2)));
        if !centred {
            low.z = 1 - size[2];
        }
        let high = low + IVec3::from_array(size) - 1;

        let frames =
            (low.with_x(i32::MIN).with_y(i32::MIN), high.with_x(i32::MAX).with_y(i32::MAX));
        let pixels = (low.with_z(i32::MIN), high.with_z(i32::MAX));
        let kept = |grid: &Grid, (low, high)| {
            let all = grid.mass();
            if all > 0.0 { grid.clip(low, high).mass() / all } else { 0.0 }
        };
        if let Some(full) = full {
            let dropped = Dropped {
                total: 1.0 - kept(&full, (low, high)),
                space: Some(1.0 - kept(&full, pixels)),
                time: Some(1.0 - kept(&full, frames)),
            };
            return Ok((full.clip(low, high).taps().collect(), dropped));
        }
        // A product of rows is cut before it is multiplied out, which may be far larger.
        let space = kept(&self.x, pixels) * kept(&self.y, pixels);
        let time = kept(&self.time, frames);
        let dropped =
            Dropped { total: 1.0 - space * time, space: Some(1.0 - space), time: Some(1.0 - time) };
        for row in [&mut self.x, &mut self.y, &mut self.time] {
            *row = row.clip(low, high);
            if row.len() == 0 {
                return Err(TapsError::Empty.into());
            }
        }
        Ok((self.compose()?.taps().collect(), dropped))
    }
}

/// The largest taps that hold `share` of Σ|g|, and all that tie with the last of them.
fn keep_share(full: &Grid, share: f64) -> (Vec<Tap>, Dropped) {
    let mut taps: Vec<Tap> = full.taps().filter(|tap| tap.weight != 0.0).collect();
    taps.sort_by(|a, b| b.weight.abs().total_cmp(&a.weight.abs()));
    let all: f64 = taps.iter().map(|tap| tap.weight.abs()).sum();
    let mut kept = 0.0;
    let mut last = f64::INFINITY;
    let mut count = 0;
    for tap in &taps {
        let magnitude = tap.weight.abs();
        if kept >= share * all && magnitude < last * (1.0 - TIE) {
            break;
        }
        kept += magnitude;
        last = last.min(magnitude);
        count += 1;
    }
    taps.truncate(count);
    let total = if count > 0 { 1.0 - kept / all } else { 0.0 };
    (taps, Dropped { total, space: None, time: None })
}

/// The convolution of both, if it is of a reasonable size.
fn convolve(a: &Grid, b: &Grid) -> Result<Grid, ResolveProblem> {
    let size = a.convolved_size(b);
    let length = size.into_iter().max().unwrap_or(0);
    if length > MAX_LENGTH as usize {
        return Err(ResolveProblem::Length { length });
    }
    let taps = size.iter().product();
    if taps > MAX_TAPS {
        return Err(ResolveProblem::Taps { taps });
    }
    let work = a.len().saturating_mul(b.len());
    if work > MAX_WORK {
        return Err(ResolveProblem::Work { work });
    }
    Ok(a.convolve(b))
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use proptest::prelude::*;

    use super::*;
    use crate::kernel::perception_taps;

    #[test]
    fn every_eighth_frame_is_the_same_filter_of_other_frames() {
        let taps = |text: &str| -> Vec<(IVec3, f64)> {
            let kernel = text.parse::<KernelSpec>().unwrap().resolve_without_tile().unwrap();
            let taps = kernel.classes()[0].taps.taps();
            taps.iter().map(|tap| (tap.offset, tap.weight)).collect()
        };
        for cut in ["@ 5x5x6", "@ 90%", "* gaussian_t(1) @ 3x3x9"] {
            let text = format!("gaussian(1.5) * fovvideovdp(60) * every(8) {cut}");
            let moved = |(offset, weight): (IVec3, f64)| (offset.with_z(8 * offset.z), weight);
            let all = taps(&text.replace("* every(8) ", "")).into_iter().map(moved);
            let mut all: Vec<_> = all.collect();
            let mut found = taps(&text);
            // Ties are in the order of their frames, which are others.
            for taps in [&mut all, &mut found] {
                taps.sort_by_key(|(offset, _)| offset.to_array());
            }
            assert_eq!(found, all, "{text}");
            assert_eq!(taps(&text.replace("every(8)", "every(2) * every(4)")).len(), all.len());
        }
        let far: KernelSpec = "box(3) * every(9000)".parse().unwrap();
        let problem = far.resolve_without_tile().unwrap_err().problem;
        assert_eq!(problem, ResolveProblem::Length { length: 18_000 });
    }

    #[test]
    fn prefixes_part_a_pixel_into_layers() {
        let layers = |text: &str, spp: usize| {
            let kernel = text.parse::<KernelSpec>().unwrap().resolve_without_tile().unwrap();
            kernel.layers(spp).into_iter().map(|layer| layer.end).collect::<Vec<_>>()
        };
        assert_eq!(layers("gaussian(1)", 16), [16]);
        assert_eq!(layers("gaussian(1) of 16", 16), [16]);
        assert_eq!(layers("none of 4 + none of 1 + box(2)", 16), [1, 4, 16]);
        assert_eq!(layers("none of 2..4 + none of 3..", 6), [2, 3, 4, 5, 6]);
    }

    fn tile(width: usize, height: usize, frames: usize) -> TileShape {
        TileShape::new(width, height, frames, 1, 2).unwrap()
    }

    fn spec(text: &str) -> KernelSpec {
        text.parse().unwrap()
    }

    fn free(text: &str) -> KernelClass {
        spec(text).resolve_without_tile().unwrap().classes[0].clone()
    }

    fn weights(taps: &KernelTaps) -> HashMap<IVec3, f64> {
        taps.taps().iter().map(|tap| (tap.offset, tap.weight)).collect()
    }

    fn assert_equal(a: &KernelTaps, b: &KernelTaps, tolerance: f64) {
        let (a, b) = (weights(a), weights(b));
        for offset in a.keys().chain(b.keys()) {
            let of = |map: &HashMap<IVec3, f64>| map.get(offset).copied().unwrap_or(0.0);
            assert!((of(&a) - of(&b)).abs() < tolerance, "{offset}: {} {}", of(&a), of(&b));
        }
    }

    /// The paper's kernel, written out from its formula.
    #[test]
    fn the_paper_s_kernel_is_what_its_formula_says() {
        let class = free("gaussian(2.1) * fovvideovdp(60) @ 7x7x8");
        assert_eq!(class.taps.taps().len(), 7 * 7 * 8);
        assert_eq!(class.taps.bounds(), (IVec3::new(-3, -3, -7), IVec3::new(3, 3, 0)));
        let time = perception_taps(60.0);
        let weight = |d: IVec3| {
            let r2 = f64::from(d.x * d.x + d.y * d.y);
            (-r2 / (2.0 * 2.1 * 2.1)).exp() * time[-d.z as usize]
        };
        let mass: f64 = class.taps.taps().iter().map(|tap| weight(tap.offset).abs()).sum();
        for tap in class.taps.taps() {
            assert!((tap.weight - weight(tap.offset) / mass).abs() < 1e-14, "{tap:?}");
        }
        // The published shares.
        let Dropped { total, space: Some(space), time: Some(time) } = class.dropped else {
            panic!()
        };
        assert_eq!(((1.0 - space) * 100.0).round(), 82.0);
        assert_eq!(((1.0 - time) * 100.0).round(), 97.0);
        assert!((1.0 - total - (1.0 - space) * (1.0 - time)).abs() < 1e-15);
        // Only a third in time at 240 frames per second.
        let fast = free("gaussian(2.1) * fovvideovdp(240) @ 7x7x8").dropped.time.unwrap();
        assert!((0.6..0.72).contains(&fast), "{fast}");
    }

    #[test]
    fn gaussians_compose_to_gaussians() {
        let both = free("gaussian(3) * gaussian(4) @ 100%");
        assert_equal(&both.taps, &free("gaussian(5, radius=53) @ 100%").taps, 1e-12);
        let both = free("gaussian_t(3) * gaussian_t(4) @ 100%");
        assert_equal(&both.taps, &free("gaussian_t(5, radius=53) @ 100%").taps, 1e-12);
    }

    /// An average of an average has the weight (j+1)·α²(1−α)^j, for the frame j in the past.
    #[test]
    fn an_average_of_an_average_is_known() {
        let twice = free("ema(0.5) * ema(0.5) @ 1x1x12");
        let weight = |j: i32| f64::from(j + 1) * 0.5_f64.powi(j);
        let mass: f64 = (0..12).map(weight).sum();
        assert_eq!(twice.taps.taps().len(), 12);
        for tap in twice.taps.taps() {
            assert!((tap.weight - weight(-tap.offset.z) / mass).abs() < 1e-12);
        }
        // All of it is 1/α² = 4 of which the box keeps the sum above.
        assert!((twice.dropped.time.unwrap() - (1.0 - mass / 4.0)).abs() < 1e-11);
        assert_eq!(twice.dropped.space, Some(0.0));
    }

    #[test]
    fn boxes_lie_in_the_past_or_around_the_pixel() {
        let bounds = |text| free(text).taps.bounds();
        let around = |x: i32, y: i32, past: i32, future: i32| {
            (IVec3::new(-x, -y, -past), IVec3::new(x, y, future))
        };
        assert_eq!(bounds("gaussian(5) * ema(0.1) @ 5x3x4"), around(2, 1, 3, 0));
        assert_eq!(bounds("gaussian(5) * gaussian_t(5) @ 5x3x5"), around(2, 1, 2, 2));
        assert_eq!(bounds("gaussian_t(5) * ema(0.1) @ 1x1x4"), around(0, 0, 2, 1));
        assert_eq!(bounds("gaussian(5) @ 4x2x9"), (IVec3::new(-2, -1, 0), IVec3::new(1, 0, 0)));
        assert_eq!(bounds("gaussian(2, radius=1) * box(3) @ 99x99x99"), around(1, 1, 2, 0));
        assert_eq!(bounds("none"), around(0, 0, 0, 0));
    }

    #[test]
    fn finite_products_stay_whole_and_infinite_ones_keep_the_default_share() {
        let finite = free("gaussian(2, radius=4) * fovvideovdp(60) * box(2)");
        assert_eq!(finite.taps.taps().len(), 81 * 16);
        assert_eq!(finite.dropped, Dropped::NOTHING);
        for text in ["gaussian(2.1)", "ema(0.2) * box(2)", "gaussian_t(3)"] {
            let class = free(text);
            assert_eq!(class, KernelClass { text: text.into(), ..free(&format!("{text} @ 97%")) });
            assert!(class.dropped.total > 0.0 && class.dropped.total <= 0.03);
        }
        assert_eq!(free("ema(1)").taps.taps().len(), 1);
    }

    #[test]
    fn classes_without_factors_cover_the_tile_evenly() {
        let kernel = spec("3: column + 1: frame").resolve(tile(4, 3, 5)).unwrap();
        let [column, frame] = kernel.classes() else { panic!() };
        assert_eq!((column.weight, frame.weight), (0.75, 0.25));
        for (class, size) in [(column, [1, 1, 5]), (frame, [4, 3, 1])] {
            let count = size.iter().product::<u64>() as usize;
            assert_eq!(class.taps.size(), size);
            assert_eq!(class.taps.taps().len(), count);
            assert!(class.taps.taps().iter().all(|tap| tap.weight == 1.0 / count as f64));
        }
        assert_eq!(column.taps.bounds().1.z, 0);
        let error = spec("column").resolve_without_tile().unwrap_err();
        assert_eq!(error.problem, ResolveProblem::NeedsTile);
    }

    #[test]
    fn a_kernel_wider_than_the_tile_is_refused() {
        let text = "gaussian(2.1) * fovvideovdp(60) @ 7x5x8";
        for frames in [8, 1] {
            assert!(spec(text).resolve(tile(7, 5, frames)).is_ok());
        }
        for (shape, words) in [
            (tile(6, 5, 8), "is 7 pixels wide, but the tile has only 6"),
            (tile(7, 4, 8), "is 5 pixels high, but the tile has only 4"),
        ] {
            let error = spec(text).resolve(shape).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
            assert!(error.to_string().contains(text), "{error}");
            let kernel = spec(text).resolve_without_tile().unwrap();
            assert_eq!(kernel.check(shape), Err(error));
        }
    }

    #[test]
    fn what_is_too_large_is_refused_before_it_is_made() {
        for text in [
            "gaussian(1000)",
            "gaussian(50) * ema(0.002)",
            "ema(0.002) * ema(0.002)",
            "gaussian(1e9, radius=8191)",
            "gaussian(1, radius=8000) * gaussian(1, radius=8000)",
            "box(16384) * box(2)",
            "gaussian(100, radius=1000) + gaussian(100, radius=1000) @ 100%",
        ] {
            assert!(spec(text).resolve_without_tile().is_err(), "{text}");
        }
        assert!(spec("frame").resolve(tile(1 << 12, 1 << 12, 1)).is_err());
        // A box makes the same products small.
        for text in ["gaussian(1000) * ema(0.002) @ 9x9x9", "gaussian(1e9, radius=8191) @ 3x3x1"] {
            assert!(spec(text).resolve_without_tile().is_ok(), "{text}");
        }
    }

    /// A table that is the kernel gives the kernel, and composes as any other factor.
    #[test]
    fn tables_are_factors() {
        use npyz::WriterBuilder;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edge.npy");
        let mut bytes = Vec::new();
        // Frames −1 and 0 of one row: a difference in time, an average in space.
        let options = npyz::WriteOptions::new().default_dtype().shape(&[2, 1, 3]);
        let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
        writer.extend([-1.0_f64, -2.0, -1.0, 1.0, 2.0, 1.0]).unwrap();
        writer.finish().unwrap();
        std::fs::write(&path, bytes).unwrap();
        let table = format!("table({:?}, origin=(1, 0, 1))", path.to_str().unwrap());

        let class = free(&table);
        let weight = |x, t| weights(&class.taps)[&IVec3::new(x, 0, t)];
        assert_eq!((weight(0, 0), weight(-1, -1), weight(1, 0)), (0.25, -0.125, 0.125));
        assert_eq!(class.taps.sum(), 0.0);

        // The difference of a running mean of n frames is a difference n frames apart.
        let differences = free(&format!("box(3) * {table}"));
        let expected: Vec<Tap> = [(0, 1.0), (-3, -1.0)]
            .into_iter()
            .flat_map(|(t, sign)| {
                [(-1, 0.125), (0, 0.25), (1, 0.125)]
                    .map(|(x, weight)| Tap { offset: IVec3::new(x, 0, t), weight: sign * weight })
            })
            .collect();
        assert_equal(&differences.taps, &KernelTaps::new(expected).unwrap(), 1e-15);

        // With a table too, a box says what lies outside it: here a quarter on each side.
        let cut = free(&format!("{table} @ 1x1x2"));
        assert_eq!(cut.dropped, Dropped { total: 0.5, space: Some(0.5), time: Some(0.0) });
        let cut = free(&format!("{table} @ 3x1x1"));
        assert_eq!(cut.dropped, Dropped { total: 0.5, space: Some(0.0), time: Some(0.5) });

        let missing = spec("table(\"no such file\", origin=(0, 0, 0))");
        assert!(missing.resolve_without_tile().unwrap_err().to_string().contains("no such file"));
    }

    /// Factors to shuffle: with both signs, both directions of time, and no symmetry in t.
    fn factors() -> impl Strategy<Value = Vec<&'static str>> {
        let all = vec![
            "gaussian(1.3)",
            "fovvideovdp(30)",
            "ema(0.3)",
            "box(3)",
            "gaussian_t(0.8)",
            "none",
        ];
        prop::sample::subsequence(all, 1..=4).prop_shuffle()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// Convolution commutes, so the order of the factors does not matter.
        #[test]
        fn the_order_of_factors_does_not_matter(factors in factors()) {
            let mut sorted = factors.clone();
            sorted.sort_unstable();
            let [a, b] = [factors, sorted].map(|f| free(&format!("{} @ 9x9x20", f.join(" * "))));
            assert_equal(&a.taps, &b.taps, 1e-12);
        }

        /// The truncated kernel is the largest part of the full one: it holds the share, would
        /// not without its smallest taps, and nothing left out is larger than anything kept.
        #[test]
        fn a_share_keeps_the_largest_taps(factors in factors(), percent in 1.0..100.0) {
            let text = factors.join(" * ");
            let full = free(&format!("{text} @ 100%"));
            let part = free(&format!("{text} @ {percent}%"));
            let kept = part.taps.taps().len();
            let mass: f64 = full.taps.taps()[..kept].iter().map(|tap| tap.weight.abs()).sum();
            prop_assert!((part.dropped.total - (1.0 - mass)).abs() < 1e-9);
            prop_assert!(mass >= percent / 100.0 - 1e-9);
            let last = part.taps.taps()[kept - 1].weight.abs() * mass;
            let tied = full.taps.taps()[..kept].iter().rev()
                .take_while(|tap| tap.weight.abs() <= last * (1.0 + 1e-6)).count();
            let without: f64 = full.taps.taps()[..kept - tied].iter().map(|tap| tap.weight.abs()).sum();
            prop_assert!(without < percent / 100.0);
            prop_assert!((part.taps.magnitude() - 1.0).abs() < 1e-12);
            // Space is symmetric, so what is kept is too.
            let part = weights(&part.taps);
            for (&offset, &weight) in &part {
                for other in [offset * IVec3::new(-1, 1, 1), IVec3::new(offset.y, offset.x, offset.z)] {
                    prop_assert!((part[&other] - weight).abs() <= 1e-9 * weight.abs());
                }
            }
        }
    }
}
