//! What users may set for a run, as flags, in a file or as arguments in Python: the same names, values
//! and refusals everywhere.

mod error;
mod number;
mod preset;
mod provenance;
mod size;
mod value;
mod viewing;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::domain::DomainSpec;
use crate::kernel::KernelSpec;
use crate::solver::{Options, Preset, Start};
pub use error::SettingsError;
pub use number::whole;
pub use preset::purpose;
pub use provenance::{provenance, shell_line};
pub use size::TileSize;
use value::read;
pub use viewing::ViewingSettings;

/// Makes [`Settings`] of lines `name: type => option`: each is a flag of the command, a name in a file
/// and in Python, and sets that option, if it is one.
macro_rules! settings {
    ($($(#[doc = $doc:tt])* #[arg($($arg:tt)*)] $name:ident: $value:ty $(=> $($option:ident).+)?,)*) => {
        /// Everything that a tile depends on; what is not set comes from the preset.
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
        #[cfg_attr(feature = "cli", derive(clap::Args))]
        #[serde(rename_all = "kebab-case")]
        pub struct Settings {
            $($(#[doc = $doc])* #[cfg_attr(feature = "cli", arg(long, $($arg)*))]
            pub $name: Option<$value>,)*

            /// How the animation is watched, from which a kernel follows.
            #[cfg_attr(feature = "cli", command(flatten))]
            #[serde(flatten)]
            pub viewing: ViewingSettings,
        }

        /// The names of all settings but those of [`ViewingSettings`].
        const NAMES: &[&str] = &[$(stringify!($name)),*];

        impl Settings {
            /// Sets one of [`NAMES`] from text; nothing, if it has another name.
            fn set_text(&mut self, name: &str, text: &str) -> Result<bool, SettingsError> {
                match name {
                    $(stringify!($name) => self.$name = Some(read(name, text)?),)*
                    _ => return Ok(false),
                }
                Ok(true)
            }

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

    /// Width x height x frames [default: 64x64x16; paper 128x128x30; paper-taa 128x128x30; engine 128x128x32;
    /// engine-64 128x128x64; engine-taa 128x128x32; upscaler 128x128x32; scalar 128x128x32; scalar-64 128x128x64]
    #[arg(value_name = "WxHxF", help_heading = "Tile")]
    tile: TileSize,

    /// Samples per pixel, 1 to 64 [default: 1; progressive 16]
    #[arg(value_name = "N", help_heading = "Tile", value_parser = whole::<usize>)]
    spp: usize,

    /// Dimensions of a sample, 1 to 16 [default: 2; scalar 1; scalar-64 1]
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
    /// [default: 16000; quick 500; paper 10000; paper-taa 10000; salaun 3000; progressive 10000; engine 4000;
    /// engine-64 4000; engine-taa 1500; upscaler 4000; scalar 4000; scalar-64 4000]
    #[arg(value_name = "N", help_heading = "Descent (for experts)", value_parser = whole::<u32>)]
    steps: u32 => steps,

    /// Stop after so many steps of descent and polish together; schedules stay as they are
    #[arg(value_name = "STEPS", help_heading = "Descent (for experts)", value_parser = whole::<u32>)]
    stop_after: u32 => stop_after,

    /// Random draws per step (each: a pixel, a threshold, directions); without it, as many for each pixel
    /// as in the preset's own tile [default: 4096; engine 32768; engine-64 65536; engine-taa 32768;
    /// upscaler 32768; scalar 32768; scalar-64 65536]
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
    /// two dimensions [default: 150; quick 30; paper 80; paper-taa 80; salaun 50; progressive 0; engine 100;
    /// engine-64 100; engine-taa 50; upscaler 100; scalar 0; scalar-64 0]
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
    /// The names of all settings, with `_` between words.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMES.iter().chain(&ViewingSettings::NAMES).copied()
    }

    /// Sets one of [`Self::names`] from text, by the rules of the command line.
    ///
    /// # Errors
    /// Another name, and text that is no value of the setting.
    pub fn put(&mut self, name: &str, text: &str) -> Result<(), SettingsError> {
        match self.set_text(name, text)? || self.viewing.set_text(name, text)? {
            true => Ok(()),
            false => Err(SettingsError::Unknown { name: name.to_owned() }),
        }
    }

    /// The options of the run, and the tile that it starts from, if it does.
    ///
    /// # Errors
    /// A size that no tile has, and settings that say one thing twice.
    pub fn options(&self) -> Result<(Options, Option<PathBuf>), SettingsError> {
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
        self.viewing.refuse_beside(self.kernel.as_ref(), "--kernel")?;
        if self.viewing.is_given() {
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
    use proptest::prelude::*;

    use super::*;

    #[cfg(feature = "cli")]
    #[derive(Debug, clap::Parser)]
    struct Command {
        #[command(flatten)]
        settings: Settings,
    }

    /// What the command reads of a line.
    #[cfg(feature = "cli")]
    fn parse(line: &[String]) -> Settings {
        let program = "perceptile".to_owned();
        let line = std::iter::once(&program).chain(line);
        <Command as clap::Parser>::try_parse_from(line).unwrap().settings
    }

    /// What others set, name by name.
    fn put(line: &[String]) -> Settings {
        let mut settings = Settings::default();
        for pair in line.chunks_exact(2) {
            let name = pair[0].trim_start_matches("--").replace('-', "_");
            settings.put(&name, &pair[1]).unwrap();
        }
        settings
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
            viewing: ViewingSettings::default(),
        }
    }

    proptest! {
        #[test]
        fn a_command_line_says_the_settings(x in 0.0..1.0_f64, tiny in 0_i32..300, n: u32) {
            let settings = full(x * 10.0_f64.powi(-tiny), n);
            // Every setting is there; a new one that is left out here fails to compile above.
            prop_assert!(settings.command_line().len() > 40);
            prop_assert_eq!(&put(&settings.command_line()), &settings);
            #[cfg(feature = "cli")]
            prop_assert_eq!(&parse(&settings.command_line()), &settings);
        }
    }

    #[test]
    fn every_name_can_be_put() {
        let viewing = ViewingSettings {
            fps: Some(90.0),
            taa: Some(0.5),
            sigma: Some(1.5),
            pixels_per_degree: Some(60.0),
        };
        let settings = Settings { viewing, ..full(0.5, 3) };
        let line = settings.command_line();
        assert_eq!(put(&line), settings);
        assert_eq!(line.len(), 2 * Settings::names().count());
    }

    #[test]
    fn what_is_no_value_is_refused_with_its_name() {
        let put = |name, text| Settings::default().put(name, text).unwrap_err().to_string();
        assert_eq!(put("step", "3"), "there is no setting `step`");
        let digits = "it must be a whole number in digits, such as 256";
        assert_eq!(
            put("stop_after", "1e4"),
            format!("invalid value '1e4' for --stop-after: {digits}")
        );
        assert_eq!(put("rate", "x"), "invalid value 'x' for --rate: invalid float literal");
        assert!(put("preset", "slow").contains("there are: best, quick, paper, paper-taa"));
        assert!(put("tile", "3x4").contains("is not width x height x frames"));
        assert!(put("kernel", "gaussian(0)").contains("sigma is 0"));
        assert!(put("pixels_per_degree", "many").contains("--pixels-per-degree"));
    }

    /// "[default: 16000; quick 500; paper 10000]" is what the presets have.
    #[cfg(feature = "cli")]
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
