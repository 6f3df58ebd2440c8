//! What users may set for a run, as flags or in a file: the same names, and the flags win.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use perceptile::kernel::KernelSpec;
use perceptile::solver::{Options, Preset, Start};
use perceptile::tile::{ShapeError, TileShape};
use serde::{Deserialize, Serialize};

use super::exit::{Failure, Misuse};

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

/// Reads the name of a preset.
fn presets() -> impl TypedValueParser<Value = Preset> {
    let help = |preset| match preset {
        Preset::Best => "The best 64x64x16 tile that a minute of two cores allows",
        Preset::Quick => "The same tile in seconds",
        Preset::Paper => "The paper's job: 128x128x30, 10000 steps of 4096 draws",
        Preset::PaperTaa => "The paper's job for frames accumulated with alpha 0.2",
        Preset::Salaun => "Spatial blue noise, every frame its own",
    };
    let names = Preset::ALL.map(|(preset, name)| PossibleValue::new(name).help(help(preset)));
    let preset = |name: String| Preset::ALL.into_iter().find(|&(_, its)| its == name);
    PossibleValuesParser::new(names).map(move |name| preset(name).expect("one of the names").0)
}

/// Makes [`Settings`] of lines `name: type => option`: each is a flag and a name in a file, and sets
/// that option, if it is one.
macro_rules! settings {
    ($($(#[$meta:meta])* $name:ident: $value:ty $(=> $($option:ident).+)?,)*) => {
        /// Everything that a tile depends on; what is not set comes from the preset.
        #[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case", deny_unknown_fields)]
        pub struct Settings {
            $($(#[$meta])* #[arg(long)] pub $name: Option<$value>,)*

            /// Settings from a TOML file with the names of the flags; flags win
            #[arg(long, value_name = "FILE")]
            #[serde(skip)]
            pub config: Option<PathBuf>,
        }

        impl Settings {
            /// These settings, and those of `other` where there are none.
            fn or(self, other: Self) -> Self {
                Self { $($name: self.$name.or(other.$name),)* config: None }
            }

            /// Puts what is set into the options.
            fn set(self, options: &mut Options) {
                $($(if let Some(value) = self.$name {
                    options.$($option).+ = value.into();
                })?)*
            }
        }
    };
}

settings! {
    /// Where all other settings come from [default: best]
    #[arg(value_parser = presets())]
    preset: Preset,

    /// Width x height x frames of the tile
    #[arg(value_name = "WxHxF")]
    tile: TileSize,

    /// Samples per pixel, 1 to 64
    spp: usize,

    /// Dimensions of a sample, 1 to 16
    dims: usize,

    /// The filter through which error is seen; see `perceptile kernel --help`
    #[arg(value_name = "SPEC")]
    kernel: KernelSpec => kernel,

    /// What all random numbers depend on
    seed: u64 => seed,

    /// `random`, `stratified`, or a tile to start from
    #[arg(value_name = "START")]
    start: String,

    /// Steps of stochastic gradient descent
    steps: u32 => steps,

    /// Stop after so many steps of descent and polish together; schedules stay as they are
    #[arg(value_name = "STEPS")]
    stop_after: u32 => stop_after,

    /// Draws of a step: pixel, threshold and directions
    draws: usize => draw.draws,

    /// Directions for each draw
    directions: usize => draw.directions,

    /// Share of the threshold range that is drawn from; the paper draws from all of it, 1
    #[arg(value_name = "SHARE")]
    threshold_range: f64 => draw.threshold_range,

    /// Share of directions along single axes
    #[arg(value_name = "SHARE")]
    axis_share: f64 => draw.axis_share,

    /// Share of directions in the planes of axis pairs, for more than two dimensions
    #[arg(value_name = "SHARE")]
    pair_share: f64 => draw.pair_share,

    /// Adam's step size at the start, in units of the cube
    rate: f64 => adam.rate,

    /// Adam's step size at the end of its cosine
    final_rate: f64 => adam.final_rate,

    /// Decay of Adam's first moment
    beta1: f64 => adam.beta1,

    /// Decay of Adam's second moment
    beta2: f64 => adam.beta2,

    /// Adam's epsilon
    epsilon: f64 => adam.epsilon,

    /// Full-batch steps on the energy distance after the descent [default: the preset's for one
    /// sample per pixel in two dimensions, else 0]
    #[arg(value_name = "STEPS")]
    polish: u32 => polish.steps,

    /// Adam's step size at the start of the polish
    #[arg(value_name = "RATE")]
    polish_rate: f64 => polish.adam.rate,

    /// Weight of single coordinates' energy in the polish
    #[arg(value_name = "WEIGHT")]
    polish_axis_weight: f64 => polish.axis_weight,

    /// Weight of single coordinates' means in the polish
    #[arg(value_name = "WEIGHT")]
    polish_linear_weight: f64 => polish.linear_weight,

    /// Frames of the uniformity step that ends the run; 0 leaves it out
    #[arg(value_name = "FRAMES")]
    warp: u32 => warp.frames,

    /// Share of the way that the uniformity step goes for each frame
    #[arg(value_name = "SHARE")]
    warp_rate: f64 => warp.rate,
}

impl Settings {
    /// These settings, and those of their file where there are none.
    ///
    /// # Errors
    /// As for [`Self::read`].
    pub fn with_file(mut self) -> Result<Self, Failure> {
        match self.config.take() {
            Some(path) => Ok(self.or(Self::read(&path)?)),
            None => Ok(self),
        }
    }

    /// Reads settings from a TOML file.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML, or has a name or value that is no setting.
    fn read(path: &Path) -> Result<Self, Failure> {
        const MAX_BYTES: u64 = 1 << 20;
        let shown = path.display();
        let unreadable = format!("cannot read {shown}");
        let metadata = std::fs::metadata(path).map_err(Failure::refused(&unreadable))?;
        if !metadata.is_file() {
            // A pipe or a device may never end.
            return Err(Failure::refused(&unreadable)("it is not a file"));
        }
        let size = metadata.len();
        if size > MAX_BYTES {
            let rule = format!("settings have at most {MAX_BYTES}");
            return Err(Misuse(format!("{shown} has {size} bytes, but {rule}")).into());
        }
        let text = std::fs::read_to_string(path).map_err(Failure::refused(&unreadable))?;
        let refused =
            |error: toml::de::Error| Misuse(format!("{shown}: {error}").trim_end().into());
        Ok(toml::from_str(&text).map_err(refused)?)
    }

    /// The options of the run, and the tile that it starts from, if it does.
    ///
    /// # Errors
    /// A size that no tile has.
    pub fn options(self) -> Result<(Options, Option<PathBuf>), ShapeError> {
        let mut options = self.preset.unwrap_or(Preset::Best).options();
        let shape = options.shape;
        let preset_size = TileSize([shape.width(), shape.height(), shape.frames()]);
        let size = self.tile.unwrap_or(preset_size);
        let (spp, dims) = (self.spp.unwrap_or(shape.spp()), self.dims.unwrap_or(shape.dims()));
        options.shape = size.shape(spp, dims)?;
        if spp > 1 || dims != 2 {
            // The polish compares all pairs of samples and of dimensions: too slow to be a default.
            options.polish.steps = 0;
        }
        let (start, tile) = match self.start.as_deref() {
            None => (options.start, None),
            Some("random") => (Start::Random, None),
            Some("stratified") => (Start::Stratified, None),
            Some(path) => (Start::Tile, Some(PathBuf::from(path))),
        };
        options.start = start;
        self.set(&mut options);
        Ok((options, tile))
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
            config: None,
        }
    }

    proptest! {
        #[test]
        fn the_command_line_and_a_file_say_the_same(x in 0.0..1.0_f64, tiny in 0_i32..300, n: u32) {
            let settings = full(x * 10.0_f64.powi(-tiny), n);
            // Every setting is there; a new one that is left out here fails to compile above.
            prop_assert!(settings.command_line().len() > 40);
            prop_assert_eq!(&parse(&settings.command_line()), &settings);
            // TOML has no integers above 2⁶³.
            let settings = Settings { seed: Some(n.into()), ..settings };
            let text = toml::to_string(&settings).unwrap();
            prop_assert_eq!(&toml::from_str::<Settings>(&text).unwrap(), &settings);
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

    #[test]
    fn flags_win_over_a_file_one_by_one() {
        let flags = Settings { seed: Some(1), steps: Some(2), ..Settings::default() };
        let file = full(0.5, 7);
        let both = flags.or(file.clone());
        assert_eq!(both, Settings { seed: Some(1), steps: Some(2), ..file });
        assert!(Settings::default().command_line().is_empty());
    }

    #[test]
    fn settings_reach_the_options() {
        let (options, start) = full(0.25, 7).options().unwrap();
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
