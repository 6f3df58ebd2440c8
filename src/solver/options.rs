//! Everything that a tile is a function of, with the presets.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::domain::{Domain, DomainError};
use crate::draw::{DirectionSet, DrawOptions};
use crate::kernel::{Kernel, KernelClass, KernelError, KernelSpec, SpecProblem, Viewing};
use crate::solver::adam::{AdamOptions, MAX_BETA};
use crate::solver::polish::PolishOptions;
use crate::solver::warp::WarpOptions;
use crate::tile::{TileShape, TooManyRanks};

/// What the optimization starts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// Independent uniform samples (Algorithm 1, line 2).
    Random,
    /// Coordinates stratified over each cell of the tile.
    Stratified,
    /// A tile of one sample per pixel that is made first, and that tile shifted for each further
    /// sample: the start of a sequence.
    Nested,
    /// A tile that is given, for example a pre-optimized one (section 5, "Optimization cost").
    Tile,
}

/// Everything that a tile is a function of, besides the program's version and a starting tile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Size of the tile.
    pub shape: TileShape,
    /// Where samples live.
    pub domain: Domain,
    /// The filter through which error is seen: one kernel, or several with weights.
    pub kernel: KernelSpec,
    /// What all random numbers depend on.
    pub seed: u64,
    /// What the optimization starts from.
    pub start: Start,
    /// Steps of stochastic gradient descent.
    pub steps: u32,
    /// Steps after which to stop, counted over descent and polish; schedules stay as they are.
    pub stop_after: Option<u32>,
    /// How the draws of a step are made.
    pub draw: DrawOptions,
    /// How Adam moves the samples.
    pub adam: AdamOptions,
    /// The full-batch descent that follows.
    pub polish: PolishOptions,
    /// The uniformity step that ends the run.
    pub warp: WarpOptions,
}

/// Why options cannot be run.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum OptionsError {
    /// A number is outside its range.
    #[error("{name} is {value}, but it must be {rule}")]
    Range {
        /// Which number.
        name: &'static str,
        /// What was asked for.
        value: f64,
        /// The range, in words.
        rule: &'static str,
    },
    /// The domain does not go with the tile.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The kernel does not suit the tile.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// A number of the [`Viewing`] is outside its range.
    #[error(transparent)]
    Viewing(#[from] SpecProblem),
    /// So many draws touch a sample in one step that integer gradients would be too coarse.
    #[error(
        "{draws} draws of {directions} directions are too many for one step of this tile: take fewer draws and more steps"
    )]
    Batch {
        /// Draws of a step.
        draws: usize,
        /// Directions of a draw.
        directions: usize,
    },
    /// The kernel is too large for the polish, which compares all pairs of its taps.
    #[error(
        "a kernel of {taps} taps is too large for the polish, which takes at most {MAX_POLISH_TAPS}: set the polish to 0 steps"
    )]
    Polish {
        /// Taps of the largest class.
        taps: usize,
    },
    /// The tile given to start from has another shape.
    #[error("the starting tile is {found}, but the run makes a tile of {expected}")]
    Start {
        /// The run's shape.
        expected: TileShape,
        /// The given tile's shape.
        found: TileShape,
    },
    /// A class sees more samples of a pixel than there are.
    #[error("the kernel `{class}` sees more samples of a pixel than there are, which is {spp}")]
    Prefix {
        /// Text form of the class.
        class: String,
        /// Samples of a pixel.
        spp: usize,
    },
    /// More ranks than the tile has cells.
    #[error(transparent)]
    Ranks(#[from] TooManyRanks),
    /// A start from a tile was asked for, and none was given; or the other way round.
    #[error("a start from a tile and a starting tile belong together")]
    StartMissing,
}

/// Most taps of a kernel in the polish: it then takes a second or two to set up.
pub const MAX_POLISH_TAPS: usize = 4096;

/// Most samples per pixel with a polish by default: it then takes about as long as a fifth of the
/// descent.
const MAX_POLISH_SPP: usize = 4;

/// Ready-made options.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The best 64×64×16 tile that half a minute of two cores allows.
    Best,
    /// The same tile in seconds.
    Quick,
    /// The paper's job: 128×128×30, gaussian(2.1) × perception at 60 fps, 10,000 steps of 4,096
    /// draws.
    Paper,
    /// The paper's job for frames that are accumulated with α = 0.2.
    PaperTaa,
    /// Spatial blue noise, every frame its own (Salaün et al. 2022).
    Salaun,
    /// A sequence of 16 samples in every pixel, of which the first so many are good by themselves.
    Progressive,
    /// A texture for engines: 128×128×32, powers of two throughout.
    Engine,
    /// The same of 64 frames.
    #[serde(rename = "engine-64")]
    Engine64,
    /// The same as [`Preset::Engine`] behind temporal anti-aliasing with α = 0.1.
    EngineTaa,
    /// The same as [`Preset::Engine`] for upscalers with 8 jitter phases, each of which is good by
    /// itself, too.
    Upscaler,
    /// One number per texel, for thresholds and dithering: 128×128×32.
    Scalar,
    /// The same of 64 frames.
    #[serde(rename = "scalar-64")]
    Scalar64,
}

impl Preset {
    /// All presets with the names that users type.
    pub const ALL: [(Self, &str); 12] = [
        (Self::Best, "best"),
        (Self::Quick, "quick"),
        (Self::Paper, "paper"),
        (Self::PaperTaa, "paper-taa"),
        (Self::Salaun, "salaun"),
        (Self::Progressive, "progressive"),
        (Self::Engine, "engine"),
        (Self::Engine64, "engine-64"),
        (Self::EngineTaa, "engine-taa"),
        (Self::Upscaler, "upscaler"),
        (Self::Scalar, "scalar"),
        (Self::Scalar64, "scalar-64"),
    ];

    /// Its options.
    ///
    /// The numbers behind them, all at 64×64×16 with other things equal, as perceived-error ratios
    /// (`linear / edge / axis edge / bump / disk`) on a set of 128 integrands that no published
    /// table uses. They are means of ratios, as `metric` scored before; its ratios of means are
    /// lower, edges by about a quarter and axis edges by about two fifths:
    ///
    /// | choice | taken | instead |
    /// |---|---|---|
    /// | step size, 2,000 steps | 0.02: .0055 .123 .169 .028 .109 | 0.005: .0093 .133 .154 .035 .115; 0.04: .0054 .126 .173 .030 .112 |
    /// | decays, 2,000 steps, axis share 0.1 | β₁ 0.8, β₂ 0.99: .0053 .123 .155 .028 .110 | β₁ 0.9, β₂ 0.999: .0054 .123 .153 .029 .110 |
    /// | directions, 4,000 steps and polish | 2: .0039 .111 .107 .023 .097 | 1: .0042 .114 .107 .024 .099 |
    /// | threshold range, the same | 0.8: .0043 .113 .108 .023 .098 | 1: .0042 .115 .108 .026 .100 |
    /// | polish, 1,000 steps before it | 150 at 0.02: .0059 .112 .095 .026 .103 | none: .0062 .124 .160 .029 .112 |
    /// | polish alone, 200 steps at 0.03 | | .0186 .128 .107 .045 .120 |
    /// | axis weight of the polish, 3,000 steps | 0.2: .0041 .110 .098 .022 .096 | 0.1 (and half the axis share): .0038 .107 .110 .021 .093 |
    /// | spatial share, the defaults, set 3 | none: .0028 .106 .085 .021 .096; single frames, behind gaussian(2.1) alone, .022 .220 .211 .117 .210 | 0.2: .0026 .109 .087 .020 .098; single frames .009 .174 .156 .058 .160 |
    /// | shares of prefixes, their start | see [`Prefix::shares`](crate::kernel::Prefix::shares) and `run::nested` | |
    /// | column share | 0.1: .0042 .114 .107 .024 .099, residual .10 | 0.05: .0039 .112 .103 .023 .097, residual .16 |
    ///
    /// Warping every so often while optimizing is no better than once at the end. The steps of
    /// `Best` are as many as half a minute of two cores takes. Those for engines have a quarter of them,
    /// with as many draws for each pixel, which costs a few per cent of error and saves minutes. In one
    /// dimension a polish makes tiles worse: after 4,000 steps by 6 % in edges and by 16 % in bumps.
    pub fn options(self) -> Options {
        let (size, steps, polish) = match self {
            Self::Best => ((64, 64, 16), 16_000, 150),
            Self::Quick => ((64, 64, 16), 500, 30),
            Self::Salaun => ((64, 64, 16), 3_000, 50),
            Self::Progressive => ((64, 64, 16), 10_000, 0),
            Self::Paper | Self::PaperTaa => ((128, 128, 30), 10_000, 80),
            Self::Engine | Self::Upscaler => ((128, 128, 32), 4_000, 100),
            Self::Engine64 => ((128, 128, 64), 4_000, 100),
            Self::EngineTaa => ((128, 128, 32), 1_500, 50),
            Self::Scalar => ((128, 128, 32), 4_000, 0),
            Self::Scalar64 => ((128, 128, 64), 4_000, 0),
        };
        let kernel = match self {
            Self::Best | Self::Quick => PERCEPTION,
            Self::Paper => PERCEPTION_30,
            Self::PaperTaa => PERCEPTION_TAA_30,
            Self::Salaun => "gaussian(2.1) @ 7x7x1",
            Self::Progressive => PERCEPTION_PREFIXES,
            Self::Engine | Self::Scalar => PERCEPTION_32,
            Self::Engine64 | Self::Scalar64 => PERCEPTION_64,
            Self::EngineTaa => PERCEPTION_TAA_32,
            Self::Upscaler => PERCEPTION_PHASES,
        };
        let dims = if matches!(self, Self::Scalar | Self::Scalar64) { 1 } else { 2 };
        let spp = if self == Self::Progressive { 16 } else { 1 };
        let adam =
            AdamOptions { rate: 0.02, final_rate: 0.0, beta1: 0.9, beta2: 0.99, epsilon: 1e-8 };
        let paper = matches!(self, Self::Paper | Self::PaperTaa);
        let (width, height, frames) = size;
        // As many for each pixel as 4,096 are for those of 64×64×16; the paper's jobs have its own number.
        let draws = if paper { 4096 } else { width * height * frames / 16 };
        let progressive = self == Self::Progressive;
        let rate = if progressive { 0.004 } else { adam.rate };
        Options {
            shape: TileShape::new(width, height, frames, spp, dims)
                .expect("sizes within the limits"),
            domain: Domain::Square,
            kernel: kernel.parse().expect("a kernel of the documented form"),
            seed: 1,
            start: if progressive { Start::Nested } else { Start::Random },
            steps,
            stop_after: None,
            draw: DrawOptions {
                draws,
                directions: if paper { 1 } else { 2 },
                threshold_range: 0.75,
                axis_share: 0.1,
                pair_share: 0.3,
            },
            adam: AdamOptions { rate, ..adam },
            polish: PolishOptions { steps: polish, axis_weight: 0.15, linear_weight: 1.0, adam },
            warp: WarpOptions { frames: 400, rate: 0.5 },
        }
    }
}

/// The paper's kernel, with a share of draws that keep the error of a still picture small while it
/// accumulates, over a whole period and over half of one. Measured at 64×64×16 with 2,000 steps: a
/// share of 0.06 on box(8) took the error of the mean of eight frames from 0.36 to 0.18 (linear)
/// and from 0.56 to 0.46 (edge), and the perceived error of edges from 0.110 to 0.111 (means of
/// ratios, as `metric` scored before).
const PERCEPTION: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.06: column + 0.1: box(8)";
/// The same for the first samples of every pixel, however many.
const PERCEPTION_PREFIXES: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 of 1.. + 0.06: column + 0.1: box(8)";
/// The same for the 30 frames of the paper's tile.
const PERCEPTION_30: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.06: column + 0.1: box(15)";
/// The same for 32 frames, as engines have them.
const PERCEPTION_32: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.06: column + 0.1: box(16)";
/// The same for 64 frames.
const PERCEPTION_64: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.06: column + 0.1: box(32)";
/// The same for 32 frames behind temporal anti-aliasing, as engines do it.
const PERCEPTION_TAA_32: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) * ema(0.1) @ 7x7x32 + 0.06: column + 0.1: box(16)";
/// What is seen of all frames, and of every eighth one.
const PERCEPTION_PHASES: &str = "0.6: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + \
    0.4: gaussian(2.1) * fovvideovdp(60) * every(8) @ 7x7x8";
/// The same behind temporal anti-aliasing.
const PERCEPTION_TAA_30: &str =
    "0.84: gaussian(2.1) * fovvideovdp(60) * ema(0.2) @ 7x7x15 + 0.06: column + 0.1: box(15)";

impl Options {
    /// The options for a tile of another shape: with as many draws for each pixel, so that every
    /// step does to a sample what it does in the preset's tile.
    pub fn with_shape(mut self, shape: TileShape) -> Self {
        let draws = self.draw.draws as u128 * shape.pixels() as u128 / self.shape.pixels() as u128;
        // None at all is a mistake that stays one.
        let least = u128::from(self.draw.draws > 0);
        self.draw.draws = draws.clamp(least, 1 << 30) as usize;
        self.shape = shape;
        // It compares all pairs of samples, and in a cube of dimensions, so its steps cost with their
        // square.
        let compares_pairs = self.domain.is_square() && shape.dims() != 2;
        self.polish.steps = match shape.spp() {
            spp if spp <= MAX_POLISH_SPP && !compares_pairs => self.polish.steps / spp as u32,
            _ => 0,
        };
        self
    }

    /// The options with another number of steps. Fewer have less of a polish behind them, in
    /// proportion: whoever asks for less work does not mean the polish to take longer than all of it.
    pub fn with_steps(mut self, steps: u32) -> Self {
        if steps < self.steps {
            let polish = u64::from(self.polish.steps) * u64::from(steps);
            self.polish.steps = (polish / u64::from(self.steps)) as u32;
        }
        self.steps = steps;
        self
    }

    /// The options for an animation that is watched in another way: with the kernel that follows
    /// from it, and with as many steps as take as long as those of the default kernel, but no more.
    /// What a draw costs is in proportion to its subset.
    ///
    /// For 120 frames per second and α = 0.1 that is 4,329 steps instead of 16,000. A fifth of
    /// the steps raises the score of edges by 2.5 %, and of bumps by 17 % (64×64×16, set 7).
    ///
    /// # Errors
    /// A number outside its range, and a kernel that cannot be composed.
    pub fn watched(mut self, viewing: Viewing) -> Result<Self, OptionsError> {
        let subset = |kernel: &KernelSpec| -> Result<f64, KernelError> {
            Ok(kernel.resolve(self.shape)?.classes()[0].taps.mean_subset())
        };
        let kernel = viewing.kernel(self.shape)?;
        let default = Viewing::default().kernel(self.shape)?;
        let share = (subset(&default)? / subset(&kernel)?).min(1.0);
        self.steps = (f64::from(self.steps) * share).round() as u32;
        let kernel = kernel.of_samples_like(&self.kernel);
        Ok(Self { kernel, ..self })
    }

    /// The options for samples of another domain. The shape has to have its dimensions.
    pub fn with_domain(self, domain: Domain) -> Self {
        Self { domain, ..self }
    }

    /// The directions that samples are projected on.
    pub fn directions(&self) -> DirectionSet {
        DirectionSet::new(self.domain, self.shape.dims())
    }

    /// Checks that a run can do with a kernel, as the tile sees it, what these options ask for.
    ///
    /// # Errors
    /// A class that sees more samples of a pixel than there are, and a kernel too large for the
    /// polish.
    pub fn check_kernel(&self, kernel: &Kernel) -> Result<(), OptionsError> {
        let spp = self.shape.spp();
        let fits = |class: &KernelClass| class.prefix.is_none_or(|prefix| prefix.fits(spp));
        if let Some(class) = kernel.classes().iter().find(|class| !fits(class)) {
            return Err(OptionsError::Prefix { class: class.text.clone(), spp });
        }
        let sizes = kernel.classes().iter().map(|class| class.taps.taps().len());
        match sizes.max() {
            Some(taps) if taps > MAX_POLISH_TAPS && self.polish.steps > 0 => {
                Err(OptionsError::Polish { taps })
            }
            _ => Ok(()),
        }
    }

    /// Checks every number against its range.
    ///
    /// # Errors
    /// The first that is outside.
    pub fn validate(&self) -> Result<(), OptionsError> {
        self.domain.check(self.shape.dims())?;
        let share = "in [0, 1]";
        let positive = "positive and at most 1";
        let decay = "in [0, 0.999999]";
        let DrawOptions { draws, directions, threshold_range, axis_share, pair_share } = self.draw;
        check("draws", draws as f64, "in 1..=2^30", |x| (1.0..=f64::from(1 << 30)).contains(&x))?;
        check("directions", directions as f64, "in 1..=16", |x| (1.0..=16.0).contains(&x))?;
        check("threshold-range", threshold_range, positive, |x| x > 0.0 && x <= 1.0)?;
        for (name, value) in [("axis-share", axis_share), ("pair-share", pair_share)] {
            check(name, value, share, |x| (0.0..=1.0).contains(&x))?;
        }
        check("axis-share + pair-share", axis_share + pair_share, "at most 1", |x| x <= 1.0)?;
        for adam in [&self.adam, &self.polish.adam] {
            check("rate", adam.rate, positive, |x| x > 0.0 && x <= 1.0)?;
            check("final-rate", adam.final_rate, share, |x| (0.0..=1.0).contains(&x))?;
            check("beta1", adam.beta1, decay, |x| (0.0..=MAX_BETA).contains(&x))?;
            check("beta2", adam.beta2, decay, |x| (0.0..=MAX_BETA).contains(&x))?;
            check("epsilon", adam.epsilon, "in 1e-20..=1", |x| (1e-20..=1.0).contains(&x))?;
        }
        for (name, value) in [
            ("polish-axis-weight", self.polish.axis_weight),
            ("polish-linear-weight", self.polish.linear_weight),
        ] {
            check(name, value, "in [0, 1000]", |x| (0.0..=1000.0).contains(&x))?;
        }
        check("warp-rate", self.warp.rate, positive, |x| x > 0.0 && x <= 1.0)
    }
}

/// Whether a number keeps its rule.
fn check(
    name: &'static str,
    value: f64,
    rule: &'static str,
    keeps: impl Fn(f64) -> bool,
) -> Result<(), OptionsError> {
    if keeps(value) { Ok(()) } else { Err(OptionsError::Range { name, value, rule }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_keep_the_rules_they_stand_for() {
        for (preset, name) in Preset::ALL {
            let options = preset.options();
            assert_eq!(options.validate(), Ok(()), "{name}");
            assert!(options.kernel.resolve(options.shape).is_ok(), "{name}");
        }
        let paper = Preset::Paper.options();
        assert_eq!((paper.steps, paper.draw.draws, paper.draw.directions), (10_000, 4096, 1));
        assert_eq!(paper.shape, TileShape::new(128, 128, 30, 1, 2).unwrap());
    }

    #[test]
    fn tiles_of_other_shapes_have_as_many_draws_for_each_pixel() {
        let of = |size: [usize; 3], spp: usize, dims: usize| {
            let shape = TileShape::new(size[0], size[1], size[2], spp, dims).unwrap();
            Preset::Best.options().with_shape(shape)
        };
        assert_eq!(of([64, 64, 16], 1, 2), Preset::Best.options());
        for (size, draws) in
            [([128, 128, 64], 65_536), ([32, 32, 16], 1024), ([1, 1, 1], 1), ([65, 64, 16], 4160)]
        {
            let options = of(size, 1, 2);
            assert_eq!(
                (options.draw.draws, options.steps, options.polish.steps),
                (draws, 16_000, 150)
            );
        }
        let polish = |spp, dims| of([64, 64, 16], spp, dims).polish.steps;
        assert_eq!([polish(2, 2), polish(4, 2), polish(5, 2), polish(1, 3)], [75, 37, 0, 0]);
    }

    #[test]
    fn a_sequence_stays_one_however_it_is_watched() {
        let viewing = Viewing { fps: 120.0, ..Viewing::default() };
        for preset in [Preset::Best, Preset::Progressive] {
            let (before, watched) = (preset.options(), preset.options().watched(viewing).unwrap());
            let prefixes = |options: &Options| {
                options.kernel.classes().iter().map(|class| class.prefix).collect::<Vec<_>>()
            };
            assert_eq!(prefixes(&watched), prefixes(&before));
            assert_ne!(watched.kernel, before.kernel);
        }
    }

    #[test]
    fn classes_see_no_more_samples_than_there_are() {
        let mut options = Preset::Progressive.options();
        let check = |options: &Options| {
            options.check_kernel(&options.kernel.resolve(options.shape).unwrap())
        };
        assert_eq!(check(&options), Ok(()));
        for (kernel, fits) in
            [("none of 16", true), ("none of 17", false), ("none of 2..17", false)]
        {
            options.kernel = kernel.parse().unwrap();
            assert_eq!(check(&options).is_ok(), fits, "{kernel}");
        }
        let message =
            "the kernel `none of 2..17` sees more samples of a pixel than there are, which is 16";
        assert_eq!(check(&options).unwrap_err().to_string(), message);
    }

    #[test]
    fn numbers_outside_their_range_are_named() {
        let with = |change: fn(&mut Options)| {
            let mut options = Preset::Best.options();
            change(&mut options);
            options.validate().unwrap_err().to_string()
        };
        assert_eq!(with(|o| o.draw.draws = 0), "draws is 0, but it must be in 1..=2^30");
        assert!(with(|o| o.adam.rate = f64::NAN).contains("rate is NaN"));
        let decay = "beta2 is 0.99999999, but it must be in [0, 0.999999]";
        assert_eq!(with(|o| o.adam.beta2 = 0.999_999_99), decay);
        assert!(with(|o| o.polish.adam.beta1 = 1.0).contains("beta1 is 1"));
        assert!(with(|o| o.draw.axis_share = 0.8).contains("axis-share + pair-share is 1.1"));
    }
}
