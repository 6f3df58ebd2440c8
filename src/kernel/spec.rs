//! What a kernel is made of, as the user says it: one page with every factor and its text form.
//!
//! ```text
//! mixture    = class { "+" class }
//! class      = [ WEIGHT ":" ] ( product [ "@" truncation ] | "column" | "frame" ) [ "of" samples ]
//! product    = factor { "*" factor }
//! factor     = "none" | "gaussian(SIGMA)" | "gaussian(SIGMA, radius=PIXELS)"
//!            | "box_xy(PIXELS)" | "binomial(N)"
//!            | "fovvideovdp(FPS)" | "ema(ALPHA)" | "exponential(ALPHA)" | "box(FRAMES)"
//!            | "gaussian_t(SIGMA)" | "gaussian_t(SIGMA, radius=FRAMES)" | "binomial_t(N)"
//!            | "table(\"FILE\", origin=(T, Y, X))" | "every(FRAMES)"
//! truncation = WIDTH "x" HEIGHT "x" FRAMES | PERCENT "%"
//! samples    = COUNT [ ".." [ COUNT ] ]
//! ```
//!
//! For example `0.9: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.1: column`. Blanks mean nothing.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::kernel::prefix::Prefix;

/// Most pixels or frames that a kernel may extend over in one axis before it is truncated.
pub const MAX_LENGTH: u32 = 1 << 14;
/// Largest N of binomial weights: the least of them is 2⁻⁵¹² times their sum.
pub const MAX_BINOMIAL: u32 = 512;
/// Most classes of a mixture.
pub const MAX_CLASSES: usize = 64;
/// The share of Σ|g|, in per cent, that an infinite kernel keeps if no truncation is written.
pub const DEFAULT_PERCENT: f64 = 97.0;

/// Where the weights of an infinite factor fall below this part of their peak, it ends; so small
/// that no truncation notices.
pub(crate) const NEGLIGIBLE: f64 = 1e-12;

/// One factor of a product (Eq. 5). Times are frames; a causal factor reaches into the past only.
#[derive(Debug, Clone, PartialEq)]
pub enum Factor {
    /// `none`: the identity, one tap of weight 1 at the pixel itself.
    None,
    /// `gaussian(SIGMA)`: exp(−r²/2σ²) over the pixels of one frame.
    Gaussian {
        /// Standard deviation σ in pixels, above 0.
        sigma: f64,
        /// Half the window: `2·radius + 1` pixels square. Without it the factor is infinite.
        radius: Option<u32>,
    },
    /// `fovvideovdp(FPS)`: temporal perception, sustained and transient channel together
    /// (Mantiuk et al. 2021); causal, a quarter of a second long, weights of both signs.
    FovVideoVdp {
        /// Frames per second, above 4 (for two taps) and at most `4 ·` [`MAX_LENGTH`].
        fps: f64,
    },
    /// `ema(ALPHA)`, or `exponential(ALPHA)` as FAST has it: exponential moving average, weight α(1−α)^j for the frame j in the past;
    /// causal and, unless α is 1, infinite.
    Ema {
        /// Weight α of the newest frame, in (0, 1].
        alpha: f64,
    },
    /// `gaussian_t(SIGMA)`: exp(−t²/2σ²) over past and future frames.
    GaussianTime {
        /// Standard deviation σ in frames, above 0.
        sigma: f64,
        /// Half the window: `2·radius + 1` frames. Without it the factor is infinite.
        radius: Option<u32>,
    },
    /// `box(FRAMES)`: the mean of that many frames, the newest and those before it; causal.
    Box {
        /// Number of frames, 1 to [`MAX_LENGTH`].
        frames: u32,
    },
    /// `box_xy(PIXELS)`: the mean of a square of that many pixels across, from −⌊n/2⌋ to ⌈n/2⌉ − 1.
    BoxSpace {
        /// Pixels across, 1 to [`MAX_LENGTH`].
        pixels: u32,
    },
    /// `binomial(N)`: binomial coefficients of N over the N + 1 pixels around the own one, along x and
    /// along y; FAST's filter of that name (Donnelly et al. 2024), where 2 is 3×3.
    Binomial {
        /// N, 1 to [`MAX_BINOMIAL`].
        n: u32,
    },
    /// `binomial_t(N)`: the same over the N + 1 frames around the own one.
    BinomialTime {
        /// N, 1 to [`MAX_BINOMIAL`].
        n: u32,
    },
    /// `table("FILE", origin=(T, Y, X))`: any weights, from a `.npy` file of `f32` or `f64` with
    /// axes (dt, dy, dx). The file is read when the kernel is resolved.
    Table {
        /// Path of the file, relative to the working directory.
        file: String,
        /// Index (t, y, x) of the entry at offset 0: entry (i, j, k) weights the pixel at
        /// dt = i − t, dy = j − y, dx = k − x, so the frames after the origin are the future.
        origin: [u32; 3],
    },
    /// `every(FRAMES)`: the filter sees every so many frames only, as an upscaler does that shows
    /// one of its jitter phases again. The times of all other factors and of a truncation count the
    /// frames that are seen.
    Every {
        /// Frames from one that is seen to the next, 1 to [`MAX_LENGTH`].
        frames: u32,
    },
}

/// What is kept of a product.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Truncation {
    /// `@ 7x7x8`: the taps inside a box.
    ///
    /// In space the box is centred, n pixels from −⌊n/2⌋ to ⌈n/2⌉−1. In time it holds the newest
    /// frames, n of them from −(n−1) to 0, if the product reaches into the past only; otherwise
    /// it is centred as in space.
    Box {
        /// Pixels across, 1 to [`MAX_LENGTH`].
        width: u32,
        /// Pixels down, 1 to [`MAX_LENGTH`].
        height: u32,
        /// Frames, 1 to [`MAX_LENGTH`].
        frames: u32,
    },
    /// `@ 95%`: the fewest and largest taps that hold this share of Σ|g|, with all that tie with
    /// the smallest of them (so a symmetric kernel stays symmetric).
    Share {
        /// Share in per cent, in (0, 100].
        percent: f64,
    },
}

/// The kernel of one class of a mixture.
#[derive(Debug, Clone, PartialEq)]
pub enum ClassKind {
    /// A product of factors, composed by convolution.
    Product {
        /// At least one.
        factors: Vec<Factor>,
        /// Without one, finite products stay whole and infinite ones (those with `gaussian` or
        /// `gaussian_t` without a radius, or `ema`) keep [`DEFAULT_PERCENT`].
        truncation: Option<Truncation>,
    },
    /// `column`: a pixel over all frames of the tile, with equal weights.
    Column,
    /// `frame`: all pixels of one frame of the tile, with equal weights.
    Frame,
}

/// One kernel of a mixture with its weight.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassSpec {
    /// Share of the draws that take this kernel, relative to the other weights; from 1e−9 to 1e9.
    pub weight: f64,
    /// The kernel.
    pub kind: ClassKind,
    /// The samples of a pixel that the class sees; without it, all.
    pub prefix: Option<Prefix>,
}

/// A kernel as the user describes it: a mixture of one or more weighted classes.
///
/// It reads from text (see the grammar at the top of this file) and prints back a text that reads
/// as the same value; in files it is that text.
///
/// ```
/// use perceptile::kernel::KernelSpec;
///
/// let spec: KernelSpec = "0.9: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.1: column".parse()?;
/// assert_eq!(spec.classes().len(), 2);
/// assert_eq!(spec.to_string().parse(), Ok(spec));
/// # Ok::<(), perceptile::kernel::ParseError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct KernelSpec {
    classes: Vec<ClassSpec>,
}

/// Why a description is not a kernel.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum SpecProblem {
    /// The text goes on in another way than it may.
    #[error("expected {expected}, found {found}")]
    Unexpected {
        /// What may stand here.
        expected: &'static str,
        /// What stands here.
        found: String,
    },
    /// No factor or class has this name.
    #[error("there is no kernel named `{name}`; known are {known}")]
    Name {
        /// The name.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// A factor has other arguments than it takes.
    #[error("`{name}` is written {usage}")]
    Arguments {
        /// The factor.
        name: &'static str,
        /// How it is written.
        usage: &'static str,
    },
    /// A number breaks its rule.
    #[error("{name} is {value}, but must be {rule}")]
    Value {
        /// Which number.
        name: &'static str,
        /// What it is, as it was written.
        value: String,
        /// What it must be.
        rule: &'static str,
    },
    /// A factor is too long to compute.
    #[error("{name} of {value} reaches over more than {MAX_LENGTH} {unit}{advice}")]
    Reach {
        /// Which number.
        name: &'static str,
        /// What it is.
        value: f64,
        /// Pixels or frames.
        unit: &'static str,
        /// What helps.
        advice: &'static str,
    },
    /// A class that is a kernel of its own was multiplied or truncated.
    #[error("`{name}` stands alone: it takes no other factors and no truncation")]
    Alone {
        /// The class.
        name: &'static str,
    },
    /// There are too many classes, or none, or a product has no factor.
    #[error(
        "a mixture has {classes} classes, but must have 1 to {MAX_CLASSES} of at least one factor each"
    )]
    Classes {
        /// Their number.
        classes: usize,
    },
}

impl KernelSpec {
    /// A mixture of `classes`.
    ///
    /// # Errors
    /// No classes or more than [`MAX_CLASSES`], a product without factors, or the first number
    /// outside the range given at its field.
    pub fn new(classes: Vec<ClassSpec>) -> Result<Self, SpecProblem> {
        let empty = |class: &ClassSpec| matches!(&class.kind, ClassKind::Product { factors, .. } if factors.is_empty());
        if classes.is_empty() || classes.len() > MAX_CLASSES || classes.iter().any(empty) {
            return Err(SpecProblem::Classes { classes: classes.len() });
        }
        for class in &classes {
            check_weight(class.weight)?;
            class.prefix.map_or(Ok(()), Prefix::check)?;
            if let ClassKind::Product { factors, truncation } = &class.kind {
                factors.iter().try_for_each(Factor::check)?;
                truncation.iter().try_for_each(Truncation::check)?;
            }
        }
        Ok(Self { classes })
    }

    /// Frames per second of the perception kernel of the first class, if it has one.
    pub fn frame_rate(&self) -> Option<f64> {
        match &self.classes[0].kind {
            ClassKind::Product { factors, .. } => factors.iter().find_map(|factor| match factor {
                Factor::FovVideoVdp { fps } => Some(*fps),
                _ => None,
            }),
            ClassKind::Column | ClassKind::Frame => None,
        }
    }

    /// The kernel of the first class alone, of all samples.
    pub fn first(&self) -> Self {
        Self { classes: vec![ClassSpec::lone(self.classes[0].kind.clone())] }
    }

    /// Weight of the newest frame in the temporal anti-aliasing of the first class, if it has any.
    pub fn taa(&self) -> Option<f64> {
        let ClassKind::Product { factors, .. } = &self.classes[0].kind else { return None };
        factors.iter().find_map(|factor| match factor {
            Factor::Ema { alpha } => Some(*alpha),
            _ => None,
        })
    }

    /// The first class alone, without its temporal anti-aliasing, if it has any.
    pub fn without_taa(&self) -> Option<Self> {
        let mut alone = self.first();
        let ClassKind::Product { factors, .. } = &mut alone.classes[0].kind else { return None };
        let average = factors.iter().position(|factor| matches!(factor, Factor::Ema { .. }))?;
        factors.remove(average);
        if factors.is_empty() {
            factors.push(Factor::None);
        }
        Some(alone)
    }

    /// The same mixture, whose first class sees the samples that the first class of another one sees.
    pub fn of_samples_like(mut self, other: &Self) -> Self {
        self.classes[0].prefix = other.classes[0].prefix;
        self
    }

    /// The same mixture, with every class of all samples.
    pub fn of_all_samples(&self) -> Self {
        let class = |class: &ClassSpec| ClassSpec { prefix: None, ..class.clone() };
        Self { classes: self.classes.iter().map(class).collect() }
    }

    /// The classes in the order they were given.
    pub fn classes(&self) -> &[ClassSpec] {
        &self.classes
    }

    /// The first class alone, behind one more factor and truncated anew.
    ///
    /// # Errors
    /// A class that takes no factors, and numbers outside their ranges.
    pub fn followed_by(&self, factor: Factor, truncation: Truncation) -> Result<Self, SpecProblem> {
        let ClassKind::Product { factors, .. } = &self.classes[0].kind else {
            let column = self.classes[0].kind == ClassKind::Column;
            return Err(SpecProblem::Alone { name: if column { "column" } else { "frame" } });
        };
        let mut factors = factors.clone();
        factors.push(factor);
        let kind = ClassKind::Product { factors, truncation: Some(truncation) };
        Self::new(vec![ClassSpec::lone(kind)])
    }
}

impl ClassSpec {
    /// The one class of a kernel that is no mixture, of all samples.
    pub fn lone(kind: ClassKind) -> Self {
        Self { weight: 1.0, kind, prefix: None }
    }
}

/// Whether `weight` can be the weight of a class.
pub(crate) fn check_weight(weight: f64) -> Result<(), SpecProblem> {
    in_range("weight", weight, (1e-9..=1e9).contains(&weight), "a number from 1e-9 to 1e9")
}

fn in_range(
    name: &'static str,
    value: f64,
    inside: bool,
    rule: &'static str,
) -> Result<(), SpecProblem> {
    if inside { Ok(()) } else { Err(SpecProblem::Value { name, value: number(value), rule }) }
}

impl Factor {
    /// Whether every number of the factor is in its range; the problem names the number.
    pub(crate) fn check(&self) -> Result<(), SpecProblem> {
        match *self {
            Self::None => Ok(()),
            Self::Gaussian { sigma, radius } => check_gaussian(sigma, radius, "pixels"),
            Self::GaussianTime { sigma, radius } => check_gaussian(sigma, radius, "frames"),
            Self::FovVideoVdp { fps } => in_range(
                "fps",
                fps,
                fps > 4.0 && fps <= 4.0 * f64::from(MAX_LENGTH),
                "above 4 and at most 65536",
            ),
            Self::Ema { alpha } => {
                in_range("alpha", alpha, alpha > 0.0 && alpha <= 1.0, "above 0 and at most 1")?;
                // (1−α)^j ≥ exp(−2αj) for the small α that matter here.
                let frames = -libm::log(NEGLIGIBLE) / -libm::log1p(-alpha);
                if frames + 2.0 > f64::from(MAX_LENGTH) {
                    return Err(SpecProblem::Reach {
                        name: "alpha",
                        value: alpha,
                        unit: "frames",
                        advice: ": take a larger one, or box(FRAMES)",
                    });
                }
                Ok(())
            }
            Self::Box { frames } | Self::Every { frames } => check_length("frames", frames),
            Self::BoxSpace { pixels } => check_length("pixels", pixels),
            Self::Binomial { n } | Self::BinomialTime { n } => {
                let inside = (1..=MAX_BINOMIAL).contains(&n);
                in_range("n", f64::from(n), inside, "a whole number from 1 to 512")
            }
            Self::Table { origin, .. } => origin.iter().try_for_each(|&index| {
                let inside = index < MAX_LENGTH;
                in_range("origin", f64::from(index), inside, "whole numbers from 0 to 16383")
            }),
        }
    }

    /// Whether the factor goes on for ever, so that a product with it must be truncated.
    pub(crate) fn is_infinite(&self) -> bool {
        match *self {
            Self::Gaussian { radius, .. } | Self::GaussianTime { radius, .. } => radius.is_none(),
            Self::Ema { alpha } => alpha < 1.0,
            Self::None
            | Self::FovVideoVdp { .. }
            | Self::Box { .. }
            | Self::BoxSpace { .. }
            | Self::Binomial { .. }
            | Self::BinomialTime { .. }
            | Self::Table { .. }
            | Self::Every { .. } => false,
        }
    }
}

fn check_gaussian(sigma: f64, radius: Option<u32>, unit: &'static str) -> Result<(), SpecProblem> {
    let finite = sigma > 0.0 && sigma.is_finite();
    in_range("sigma", sigma, finite, "a finite number above 0")?;
    match radius {
        Some(radius) => {
            let inside = 2 * u64::from(radius) < u64::from(MAX_LENGTH);
            in_range("radius", f64::from(radius), inside, "a whole number from 0 to 8191")
        }
        None if 2.0 * gaussian_radius(sigma) + 1.0 > f64::from(MAX_LENGTH) => {
            Err(SpecProblem::Reach {
                name: "sigma",
                value: sigma,
                unit,
                advice: ": give its window, `radius=…`",
            })
        }
        _ => Ok(()),
    }
}

/// Pixels from the centre of a Gaussian to where it is negligible.
pub(crate) fn gaussian_radius(sigma: f64) -> f64 {
    (sigma * libm::sqrt(-2.0 * libm::log(NEGLIGIBLE))).ceil()
}

fn check_length(name: &'static str, length: u32) -> Result<(), SpecProblem> {
    let inside = (1..=MAX_LENGTH).contains(&length);
    in_range(name, f64::from(length), inside, "a whole number from 1 to 16384")
}

impl Truncation {
    /// Whether every number is in its range; the problem names the number.
    pub(crate) fn check(&self) -> Result<(), SpecProblem> {
        match *self {
            Self::Box { width, height, frames } => {
                check_length("width", width)?;
                check_length("height", height)?;
                check_length("frames", frames)
            }
            Self::Share { percent } => in_range(
                "share",
                percent,
                percent > 0.0 && percent <= 100.0,
                "above 0% and at most 100%",
            ),
        }
    }
}

/// The shortest text that reads as `x`, without long runs of zeros.
pub(crate) fn number(x: f64) -> String {
    if x == 0.0 || !x.is_finite() || (1e-4..1e16).contains(&x.abs()) {
        format!("{x}")
    } else {
        format!("{x:e}")
    }
}

impl fmt::Display for Factor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gaussian = |f: &mut fmt::Formatter<'_>, name, sigma, radius| match radius {
            None => write!(f, "{name}({})", number(sigma)),
            Some(radius) => write!(f, "{name}({}, radius={radius})", number(sigma)),
        };
        match self {
            Self::None => write!(f, "none"),
            Self::Gaussian { sigma, radius } => gaussian(f, "gaussian", *sigma, *radius),
            Self::GaussianTime { sigma, radius } => gaussian(f, "gaussian_t", *sigma, *radius),
            Self::FovVideoVdp { fps } => write!(f, "fovvideovdp({})", number(*fps)),
            Self::Ema { alpha } => write!(f, "ema({})", number(*alpha)),
            Self::Box { frames } => write!(f, "box({frames})"),
            Self::BoxSpace { pixels } => write!(f, "box_xy({pixels})"),
            Self::Binomial { n } => write!(f, "binomial({n})"),
            Self::BinomialTime { n } => write!(f, "binomial_t({n})"),
            Self::Every { frames } => write!(f, "every({frames})"),
            Self::Table { file, origin: [t, y, x] } => {
                let quoted = file.replace('\\', "\\\\").replace('"', "\\\"");
                write!(f, "table(\"{quoted}\", origin=({t}, {y}, {x}))")
            }
        }
    }
}

impl fmt::Display for Truncation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Box { width, height, frames } => write!(f, "{width}x{height}x{frames}"),
            Self::Share { percent } => write!(f, "{}%", number(*percent)),
        }
    }
}

impl fmt::Display for ClassKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Column => write!(f, "column"),
            Self::Frame => write!(f, "frame"),
            Self::Product { factors, truncation } => {
                for (i, factor) in factors.iter().enumerate() {
                    write!(f, "{}{factor}", if i == 0 { "" } else { " * " })?;
                }
                truncation.iter().try_for_each(|truncation| write!(f, " @ {truncation}"))
            }
        }
    }
}

impl ClassSpec {
    /// The text form without the weight.
    pub(crate) fn unweighted(&self) -> String {
        let prefix = self.prefix.map(|prefix| format!(" {prefix}")).unwrap_or_default();
        format!("{}{prefix}", self.kind)
    }
}

/// The weight is left out where there is one class of weight 1.
impl fmt::Display for KernelSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let [class @ ClassSpec { weight: 1.0, .. }] = self.classes.as_slice() {
            return write!(f, "{}", class.unweighted());
        }
        for (i, class) in self.classes.iter().enumerate() {
            let sign = if i == 0 { "" } else { " + " };
            write!(f, "{sign}{}: {}", number(class.weight), class.unweighted())?;
        }
        Ok(())
    }
}

impl From<KernelSpec> for String {
    fn from(spec: KernelSpec) -> Self {
        spec.to_string()
    }
}
