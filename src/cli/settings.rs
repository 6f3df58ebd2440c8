//! What users may set for a run, as flags or in a file: the same names, and the flags win.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use perceptile::domain::DomainSpec;
use perceptile::kernel::KernelSpec;
use perceptile::solver::{Options, Preset, Start};
use perceptile::tile::{ShapeError, TileShape};
use serde::{Deserialize, Serialize};

use super::exit::{Failure, Misuse};
use super::number::whole;
use super::preset;
use super::viewing::ViewingArgs;

/// Width × height × frames of a tile, written `128x128x30`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TileSize(pub [usize; 3]);

impl TileSize {
    /// The shape of a tile of this size.
    ///
    /// # Errors
    /// A size of 0, or too large.
    pub fn shape(self, spp: usize, dims: usize) -> Result<TileShape, ShapeError> {
        let Self([width, height, frames]) = self;
        TileShape::new(width, height, frames, spp, dims)
    }
}

impl FromStr for TileSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sizes: Option<Vec<usize>> = text.split('x').map(|part| part.parse().ok()).collect();
        sizes
            .and_then(|sizes| sizes.try_into().ok())
            .map(Self)
            .ok_or_else(|| format!("`{text}` is not width x height x frames, such as 128x128x30"))
    }
}

impl TryFrom<String> for TileSize {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<TileSize> for String {
    fn from(TileSize([width, height, frames]): TileSize) -> Self {
        format!("{width}x{height}x{frames}")
    }
}

/// Makes [`Settings`] of lines `name: type => option`: each is a flag and a name in a file, and sets
/// that option, if it is one.
macro_rules! settings {
    ($($(#[$meta:meta])* $name:ident: $value:ty $(=> $($option:ident).+)?,)*) => {
        /// Everything that a tile depends on; what is not set comes from the preset.
        #[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub struct Settings {
            $($(#[$meta])* #[arg(long)] pub $name: Option<$value>,)*

            #[command(flatten)]
            #[serde(flatten)]
            pub viewing: ViewingArgs,

            /// Flags from a TOML file, under their names; what is typed here wins
            #[arg(long, value_name = "FILE", help_heading = "Files")]
            #[serde(skip)]
            pub config: Option<PathBuf>,
        }

        impl Settings {
            /// Puts what is set into the options.
            fn set(&self, options: &mut Options) {
                $($(if let Some(value) = self.$name.clone() {
                    options.$($option).+ = value.into();
                })?)*
            }

            /// What the options have of all that can be set, by name.
            fn of(options: &Options) -> serde_json::Map<String, serde_json::Value> {
                let mut all = serde_json::Map::new();
                $($(
                    let name = stringify!($name).replace('_', "-");
                    all.insert(name, serde_json::json!(options.$($option).+));
                )?)*
                all
            }
        }
    };
}

settings! {
    /// Named set of defaults, see `perceptile presets`; the other flags override it [default: best]
    #[arg(value_parser = preset::name(), help_heading = "Tile")]
    preset: Preset,

    /// Width x height x frames [default: 64x64x16; paper 128x128x30; paper-taa 128x128x30]
    #[arg(value_name = "WxHxF", help_heading = "Tile")]
    tile: TileSize,

    /// Samples per pixel, 1 to 64 [default: 1; progressive 16]
    #[arg(value_name = "N", help_heading = "Tile", value_parser = whole::<usize>)]
    spp: usize,

    /// Dimensions of a sample, 1 to 16 [default: 2]
    #[arg(value_name = "N", help_heading = "Tile", value_parser = whole::<usize>)]
    dims: usize,

    /// Where samples live: `square` (a cube of any dimensions), `circle` and `disk` (2 numbers), `sphere`,
    /// `hemisphere` and `cosine` (3), all of radius 1/2 around 1/2, or `density(FILE)`, the square as dense
    /// as the gray levels of a PNG or of a .npy array of rows and columns [default: square]
    #[arg(value_name = "DOMAIN", help_heading = "Tile")]
    domain: DomainSpec,

    /// Seed of the random numbers [default: 1]
    #[arg(value_name = "N", help_heading = "Tile", value_parser = whole::<u64>)]
    seed: u64 => seed,

    /// `random`, `stratified`, `nested` (a tile of one sample per pixel is made first), or a tile to
    /// start from [default: random; progressive nested]
    #[arg(value_name = "START", help_heading = "Tile")]
    start: String,

    /// The whole filter through which error is seen, instead of --fps, --taa and --sigma; see
    /// `perceptile kernel --help`
    #[arg(value_name = "SPEC", help_heading = "Kernel")]
    kernel: KernelSpec => kernel,

    /// Steps of stochastic gradient descent; fewer than the preset's shorten the polish as well
    /// [default: 16000; quick 500; paper 10000; paper-taa 10000; salaun 3000; progressive 10000]
    #[arg(value_name = "N", help_heading = "Descent (for experts)", value_parser = whole::<u32>)]
    steps: u32 => steps,

    /// Stop after so many steps of descent and polish together; schedules stay as they are
    #[arg(value_name = "STEPS", help_heading = "Descent (for experts)", value_parser = whole::<u32>)]
    stop_after: u32 => stop_after,

    /// Random draws per step (each: a pixel, a threshold, directions); without it, as many for each pixel
    /// as in the preset's own tile [default: 4096]
    #[arg(value_name = "N", help_heading = "Descent (for experts)", value_parser = whole::<usize>)]
    draws: usize => draw.draws,

    /// Directions for each draw, 1 to 16 [default: 2; paper 1; paper-taa 1]
    #[arg(value_name = "N", help_heading = "Descent (for experts)", value_parser = whole::<usize>)]
    directions: usize => draw.directions,

    /// Share of the threshold range that is drawn from; the paper's is 1 [default: 0.75]
    #[arg(value_name = "SHARE", help_heading = "Descent (for experts)")]
    threshold_range: f64 => draw.threshold_range,

    /// Share of directions along single axes [default: 0.1]
    #[arg(value_name = "SHARE", help_heading = "Descent (for experts)")]
    axis_share: f64 => draw.axis_share,

    /// Share of directions in the planes of axis pairs, for more than two dimensions [default: 0.3]
    #[arg(value_name = "SHARE", help_heading = "Descent (for experts)")]
    pair_share: f64 => draw.pair_share,

    /// Adam's step size at the start, in units of the cube [default: 0.02; progressive 0.004]
    #[arg(help_heading = "Descent (for experts)")]
    rate: f64 => adam.rate,

    /// Adam's step size at the end of its cosine [default: 0]
    #[arg(value_name = "RATE", help_heading = "Descent (for experts)")]
    final_rate: f64 => adam.final_rate,

    /// Decay of Adam's first moment [default: 0.9]
    #[arg(value_name = "DECAY", help_heading = "Descent (for experts)")]
    beta1: f64 => adam.beta1,

    /// Decay of Adam's second moment [default: 0.99]
    #[arg(value_name = "DECAY", help_heading = "Descent (for experts)")]
    beta2: f64 => adam.beta2,

    /// Adam's epsilon [default: 1e-8]
    #[arg(help_heading = "Descent (for experts)")]
    epsilon: f64 => adam.epsilon,

    /// Full-batch steps after the descent; fewer with up to 4 samples per pixel, and 0 with more or beside
    /// two dimensions [default: 150; quick 30; paper 80; paper-taa 80; salaun 50; progressive 0]
    #[arg(value_name = "STEPS", help_heading = "Polish (for experts)", value_parser = whole::<u32>)]
    polish: u32 => polish.steps,

    /// Adam's step size at the start of the polish [default: 0.02]
    #[arg(value_name = "RATE", help_heading = "Polish (for experts)")]
    polish_rate: f64 => polish.adam.rate,

    /// Weight of single coordinates' energy in the polish [default: 0.15]
    #[arg(value_name = "WEIGHT", help_heading = "Polish (for experts)")]
    polish_axis_weight: f64 => polish.axis_weight,

    /// Weight of single coordinates' means in the polish [default: 1]
    #[arg(value_name = "WEIGHT", help_heading = "Polish (for experts)")]
    polish_linear_weight: f64 => polish.linear_weight,

    /// Iterations of the final pass that makes the samples uniform, twice as many in other domains
    /// than the square; 0 skips it [default: 400]
    #[arg(value_name = "N", help_heading = "Polish (for experts)", value_parser = whole::<u32>)]
    warp: u32 => warp.frames,

    /// Step length of that pass, above 0 and at most 1 [default: 0.5]
    #[arg(value_name = "SHARE", help_heading = "Polish (for experts)")]
    warp_rate: f64 => warp.rate,
}

impl Settings {
    /// The options of the run, and the tile that it starts from, if it does.
    ///
    /// # Errors
    /// A size that no tile has, and flags that say one thing twice.
    pub fn options(&self) -> Result<(Options, Option<PathBuf>), Failure> {
        let mut options = self.preset.unwrap_or(Preset::Best).options();
        let shape = options.shape;
        let preset_size = TileSize([shape.width(), shape.height(), shape.frames()]);
        let size = self.tile.unwrap_or(preset_size);
        let domain = self.domain.as_ref().map(DomainSpec::resolve).transpose()?;
        let domain = domain.unwrap_or(options.domain);
        let dims = self.dims.or(domain.dims()).unwrap_or(shape.dims());
        let spp = self.spp.unwrap_or(shape.spp());
        options = options.with_domain(domain).with_shape(size.shape(spp, dims)?);
        if let Some(steps) = self.steps {
            options = options.with_steps(steps);
        }
        if self.viewing.is_given() {
            if self.kernel.is_some() {
                let rule = "leave out --fps, --taa, --sigma and --pixels-per-degree";
                return Err(Misuse(format!("--kernel says all of the kernel: {rule}")).into());
            }
            // A number out of its range is named by its flag.
            self.viewing.kernel(options.shape)?;
            options = options.watched(self.viewing.viewing()?)?;
        }
        let (start, tile) = match self.start.as_deref() {
            None => (options.start, None),
            Some("random") => (Start::Random, None),
            Some("stratified") => (Start::Stratified, None),
            Some("nested") => (Start::Nested, None),
            Some(path) => (Start::Tile, Some(PathBuf::from(path))),
        };
        options.start = start;
        self.set(&mut options);
        Ok((options, tile))
    }

    /// All settings, those that are not set with what takes their place.
    pub fn effective(&self, options: &Options) -> serde_json::Map<String, serde_json::Value> {
        let (shape, preset) = (options.shape, self.preset.unwrap_or(Preset::Best));
        let start = match options.start {
            Start::Random => "random".into(),
            Start::Stratified => "stratified".into(),
            Start::Nested => "nested".into(),
            Start::Tile => self.start.clone().unwrap_or_default(),
        };
        let mut all = Self::of(options);
        all.retain(|_, value| !value.is_null());
        if self.viewing.is_given() {
            all.remove("kernel");
        }
        let size = String::from(TileSize([shape.width(), shape.height(), shape.frames()]));
        all.insert("preset".into(), serde_json::json!(preset));
        all.insert("tile".into(), size.into());
        all.insert("spp".into(), shape.spp().into());
        all.insert("dims".into(), shape.dims().into());
        all.insert("domain".into(), options.domain.to_string().into());
        all.insert("start".into(), start.into());
        all
    }

    /// The flags that say the same.
    pub fn command_line(&self) -> Vec<String> {
        let serde_json::Value::Object(fields) = serde_json::json!(self) else {
            return Vec::new();
        };
        fields
            .into_iter()
            .filter(|(_, value)| !value.is_null())
            .flat_map(|(name, value)| {
                let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
                [format!("--{name}"), text]
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        settings: Settings,
    }

    fn parse(line: &[String]) -> Settings {
        let program = "perceptile".to_owned();
        Command::try_parse_from(std::iter::once(&program).chain(line)).unwrap().settings
    }

    /// Every setting with a value of its own.
    fn full(x: f64, n: u32) -> Settings {
        let small = Some(x);
        let count = Some(n);
        Settings {
            preset: Some(Preset::PaperTaa),
            tile: Some(TileSize([9, n as usize, 4])),
            spp: Some(3),
            dims: Some(5),
            domain: Some(DomainSpec::File("a star.png".into())),
            kernel: Some(
                "0.5: gaussian(1.5) @ 90% + 0.5: table(\"a b.npy\", origin=(0, 1, 2))"
                    .parse()
                    .unwrap(),
            ),
            seed: Some(u64::MAX - u64::from(n)),
            start: Some("it's here.npy".into()),
            steps: count,
            stop_after: count,
            draws: Some(n as usize),
            directions: Some(2),
            threshold_range: small,
            axis_share: small,
            pair_share: small,
            rate: small,
            final_rate: small,
            beta1: small,
            beta2: small,
            epsilon: small,
            polish: count,
            polish_rate: small,
            polish_axis_weight: small,
            polish_linear_weight: small,
            warp: count,
            warp_rate: small,
            viewing: ViewingArgs::default(),
            config: None,
        }
    }

    proptest! {
        #[test]
        fn a_command_line_says_the_settings(x in 0.0..1.0_f64, tiny in 0_i32..300, n: u32) {
            let settings = full(x * 10.0_f64.powi(-tiny), n);
            // Every setting is there; a new one that is left out here fails to compile above.
            prop_assert!(settings.command_line().len() > 40);
            prop_assert_eq!(&parse(&settings.command_line()), &settings);
        }

        #[test]
        fn sizes_are_read_as_they_are_written(width: usize, height: usize, frames: usize) {
            let size = TileSize([width, height, frames]);
            prop_assert_eq!(String::from(size).parse(), Ok(size));
        }

        #[test]
        fn no_text_makes_a_size_panic(text: String) {
            let _ = text.parse::<TileSize>();
        }
    }

    /// "[default: 16000; quick 500; paper 10000]" is what the presets have.
    #[test]
    fn help_says_the_presets_defaults() {
        let mut said = 0;
        for argument in <Command as clap::CommandFactory>::command().get_arguments() {
            let name = argument.get_long().unwrap_or_default();
            let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
            let Some((_, defaults)) = help.split_once("[default: ") else { continue };
            let (default, others) = defaults.trim_end_matches(']').split_once("; ").unzip();
            let others = others.unwrap_or_default().split("; ").filter_map(|it| it.split_once(' '));
            let others: Vec<(&str, &str)> = others.collect();
            let default = default.unwrap_or(defaults.trim_end_matches(']'));
            for (preset, of_preset) in Preset::ALL {
                let settings = Settings { preset: Some(preset), ..Settings::default() };
                let all = settings.effective(&settings.options().unwrap().0);
                let Some(value) = all.get(name).filter(|_| name != "preset") else { continue };
                let other = others.iter().find(|(preset, _)| *preset == of_preset);
                let expected = other.map_or(default, |(_, value)| value);
                let is_same = match (value.as_f64(), expected.parse::<f64>()) {
                    (Some(value), Ok(expected)) => value == expected,
                    _ => value.as_str() == Some(expected),
                };
                assert!(is_same, "--{name} of {of_preset} is {value}, but help says {expected}");
                said += 1;
            }
        }
        assert_eq!(said, 23 * Preset::ALL.len());
    }

    #[test]
    fn settings_reach_the_options() {
        let settings = Settings { domain: None, ..full(0.25, 7) };
        let (options, start) = settings.options().unwrap();
        assert_eq!(start, Some("it's here.npy".into()));
        assert_eq!((options.shape.height(), options.shape.spp(), options.shape.dims()), (7, 3, 5));
        assert_eq!((options.steps, options.stop_after, options.warp.frames), (7, Some(7), 7));
        assert_eq!((options.draw.draws, options.polish.steps), (7, 7));
        let x = 0.25;
        let draw = options.draw;
        assert_eq!([draw.threshold_range, draw.axis_share, draw.pair_share], [x; 3]);
        let adam = options.adam;
        assert_eq!([adam.rate, adam.final_rate, adam.beta1, adam.beta2, adam.epsilon], [x; 5]);
        let polish = options.polish;
        assert_eq!([polish.adam.rate, polish.axis_weight, polish.linear_weight], [x; 3]);
        assert_eq!(options.warp.rate, x);
        // Nothing set: the preset, whole.
        assert_eq!(Settings::default().options().unwrap().0, Preset::Best.options());
    }
}
