//! What users may set for a run, as flags or in a file: the same names, and the flags win.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, ValueEnum};
use perceptile::kernel::KernelSpec;
use perceptile::solver::{Options, Preset, Start};
use perceptile::tile::{ShapeError, TileShape};
use serde::{Deserialize, Serialize};

use super::exit::{Failure, Misuse};

/// Width × height × frames of a tile, written `128x128x30`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TileSize {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Frames.
    pub frames: usize,
}

impl TileSize {
    /// The shape of a tile of this size.
    ///
    /// # Errors
    /// A size of 0, or too large.
    pub fn shape(self, spp: usize, dims: usize) -> Result<TileShape, ShapeError> {
        TileShape::new(self.width, self.height, self.frames, spp, dims)
    }
}

impl FromStr for TileSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sizes: Option<Vec<usize>> = text.split('x').map(|part| part.parse().ok()).collect();
        match sizes.as_deref() {
            Some(&[width, height, frames]) => Ok(Self { width, height, frames }),
            _ => Err(format!("`{text}` is not width x height x frames, such as 128x128x30")),
        }
    }
}

impl TryFrom<String> for TileSize {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<TileSize> for String {
    fn from(size: TileSize) -> Self {
        size.to_string()
    }
}

impl fmt::Display for TileSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}x{}", self.width, self.height, self.frames)
    }
}

/// Names of the presets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PresetName {
    /// The best 64x64x16 tile that a minute of two cores allows
    Best,
    /// The same tile in seconds
    Quick,
    /// The paper's job: 128x128x30, 10000 steps of 4096 draws
    Paper,
    /// The paper's job for frames accumulated with alpha 0.2
    PaperTaa,
    /// Spatial blue noise, every frame its own
    Salaun,
}

impl From<PresetName> for Preset {
    fn from(name: PresetName) -> Self {
        match name {
            PresetName::Best => Self::Best,
            PresetName::Quick => Self::Quick,
            PresetName::Paper => Self::Paper,
            PresetName::PaperTaa => Self::PaperTaa,
            PresetName::Salaun => Self::Salaun,
        }
    }
}

/// Everything that a tile depends on; what is not set comes from the preset.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Settings {
    /// Where all other settings come from [default: best]
    #[arg(long)]
    pub preset: Option<PresetName>,

    /// Width x height x frames of the tile
    #[arg(long, value_name = "WxHxF")]
    pub tile: Option<TileSize>,

    /// Samples per pixel, 1 to 64
    #[arg(long)]
    pub spp: Option<usize>,

    /// Dimensions of a sample, 1 to 16
    #[arg(long)]
    pub dims: Option<usize>,

    /// The filter through which error is seen; see `perceptile kernel --help`
    #[arg(long, value_name = "SPEC")]
    pub kernel: Option<KernelSpec>,

    /// What all random numbers depend on
    #[arg(long)]
    pub seed: Option<u64>,

    /// `random`, `stratified`, or a tile to start from
    #[arg(long, value_name = "START")]
    pub start: Option<String>,

    /// Steps of stochastic gradient descent
    #[arg(long)]
    pub steps: Option<u32>,

    /// Stop after so many steps of descent and polish together; schedules stay as they are
    #[arg(long, value_name = "STEPS")]
    pub stop_after: Option<u32>,

    /// Draws of a step: pixel, threshold and directions
    #[arg(long)]
    pub draws: Option<usize>,

    /// Directions for each draw
    #[arg(long)]
    pub directions: Option<usize>,

    /// Share of the threshold range that is drawn from; the paper draws from all of it, 1
    #[arg(long, value_name = "SHARE")]
    pub threshold_range: Option<f64>,

    /// Share of directions along single axes
    #[arg(long, value_name = "SHARE")]
    pub axis_share: Option<f64>,

    /// Share of directions in the planes of axis pairs, for more than two dimensions
    #[arg(long, value_name = "SHARE")]
    pub pair_share: Option<f64>,

    /// Adam's step size at the start, in units of the cube
    #[arg(long)]
    pub rate: Option<f64>,

    /// Adam's step size at the end of its cosine
    #[arg(long)]
    pub final_rate: Option<f64>,

    /// Decay of Adam's first moment
    #[arg(long)]
    pub beta1: Option<f64>,

    /// Decay of Adam's second moment
    #[arg(long)]
    pub beta2: Option<f64>,

    /// Adam's epsilon
    #[arg(long)]
    pub epsilon: Option<f64>,

    /// Full-batch steps on the energy distance after the descent [default: the preset's for one
    /// sample per pixel in two dimensions, else 0]
    #[arg(long, value_name = "STEPS")]
    pub polish: Option<u32>,

    /// Adam's step size at the start of the polish
    #[arg(long, value_name = "RATE")]
    pub polish_rate: Option<f64>,

    /// Weight of single coordinates' energy in the polish
    #[arg(long, value_name = "WEIGHT")]
    pub polish_axis_weight: Option<f64>,

    /// Weight of single coordinates' means in the polish
    #[arg(long, value_name = "WEIGHT")]
    pub polish_linear_weight: Option<f64>,

    /// Frames of the uniformity step that ends the run; 0 leaves it out
    #[arg(long, value_name = "FRAMES")]
    pub warp: Option<u32>,

    /// Share of the way that the uniformity step goes for each frame
    #[arg(long, value_name = "SHARE")]
    pub warp_rate: Option<f64>,
}

impl Settings {
    /// Reads settings from a TOML file.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML, or has a name or value that is no setting.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        const MAX_BYTES: u64 = 1 << 20;
        let unreadable = format!("cannot read {}", path.display());
        let metadata = std::fs::metadata(path).map_err(Failure::refused(&unreadable))?;
        if !metadata.is_file() {
            // A pipe or a device may never end.
            return Err(Failure::refused(&unreadable)("it is not a file"));
        }
        let size = metadata.len();
        if size > MAX_BYTES {
            let message = format!(
                "{} has {size} bytes, but settings have at most {MAX_BYTES}",
                path.display()
            );
            return Err(Misuse(message).into());
        }
        let text = std::fs::read_to_string(path).map_err(Failure::refused(&unreadable))?;
        toml::from_str(&text).map_err(|error| {
            Misuse(format!("{}: {error}", path.display()).trim_end().into()).into()
        })
    }

    /// These settings, and those of `other` where there are none.
    pub fn or(self, other: Self) -> Self {
        macro_rules! first {
            ($($name:ident),*) => { Self { $($name: self.$name.or(other.$name)),* } };
        }
        first!(
            preset,
            tile,
            spp,
            dims,
            kernel,
            seed,
            start,
            steps,
            stop_after,
            draws,
            directions,
            threshold_range,
            axis_share,
            pair_share,
            rate,
            final_rate,
            beta1,
            beta2,
            epsilon,
            polish,
            polish_rate,
            polish_axis_weight,
            polish_linear_weight,
            warp,
            warp_rate
        )
    }

    /// The options of the run, and the tile that it starts from, if it does.
    ///
    /// # Errors
    /// A size that no tile has.
    pub fn options(self) -> Result<(Options, Option<PathBuf>), Failure> {
        let mut options = Preset::from(self.preset.unwrap_or(PresetName::Best)).options();
        let shape = options.shape;
        let size = self.tile.unwrap_or(TileSize {
            width: shape.width(),
            height: shape.height(),
            frames: shape.frames(),
        });
        let (spp, dims) = (self.spp.unwrap_or(shape.spp()), self.dims.unwrap_or(shape.dims()));
        options.shape = size.shape(spp, dims).map_err(|error| Misuse(error.to_string()))?;
        if spp > 1 || dims != 2 {
            // The polish compares all pairs of samples and of dimensions: too slow to be a default.
            options.polish.steps = 0;
        }
        macro_rules! set {
            ($($field:expr => $setting:ident),* $(,)?) => {
                $(if let Some(value) = self.$setting { $field = value; })*
            };
        }
        set!(
            options.kernel => kernel,
            options.seed => seed,
            options.steps => steps,
            options.draw.draws => draws,
            options.draw.directions => directions,
            options.draw.threshold_range => threshold_range,
            options.draw.axis_share => axis_share,
            options.draw.pair_share => pair_share,
            options.adam.rate => rate,
            options.adam.final_rate => final_rate,
            options.adam.beta1 => beta1,
            options.adam.beta2 => beta2,
            options.adam.epsilon => epsilon,
            options.polish.steps => polish,
            options.polish.adam.rate => polish_rate,
            options.polish.axis_weight => polish_axis_weight,
            options.polish.linear_weight => polish_linear_weight,
            options.warp.frames => warp,
            options.warp.rate => warp_rate,
        );
        options.stop_after = self.stop_after;
        let start = match self.start.as_deref() {
            None => None,
            Some("random") => {
                options.start = Start::Random;
                None
            }
            Some("stratified") => {
                options.start = Start::Stratified;
                None
            }
            Some(path) => {
                options.start = Start::Tile;
                Some(PathBuf::from(path))
            }
        };
        Ok((options, start))
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
            preset: Some(PresetName::PaperTaa),
            tile: Some(TileSize { width: 9, height: n as usize, frames: 4 }),
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
            let size = TileSize { width, height, frames };
            prop_assert_eq!(size.to_string().parse::<TileSize>(), Ok(size));
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
