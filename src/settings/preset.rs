//! Presets as users name them, and what each is for.

#[cfg(feature = "cli")]
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::solver::Preset;

/// Reads the name of a preset for the command, which shows what each is for.
#[cfg(feature = "cli")]
pub(super) fn name() -> impl TypedValueParser<Value = Preset> {
    let names = Preset::ALL.map(|(preset, name)| PossibleValue::new(name).help(purpose(preset)));
    let preset = |name: String| Preset::ALL.into_iter().find(|&(_, its)| its == name);
    PossibleValuesParser::new(names).map(move |name| preset(name).expect("one of the names").0)
}

/// Reads the name of a preset.
pub(super) fn parse(name: &str) -> Result<Preset, String> {
    let named = Preset::ALL.into_iter().find(|&(_, its)| its == name);
    let names = || Preset::ALL.map(|(_, name)| name).join(", ");
    named.map(|(preset, _)| preset).ok_or_else(|| format!("there are: {}", names()))
}

/// What a preset is for.
pub fn purpose(preset: Preset) -> &'static str {
    match preset {
        Preset::Best => "The best 64x64x16 tile that half a minute of two cores allows",
        Preset::Quick => "The same tile in seconds",
        Preset::Paper => "The paper's job: 128x128x30, 10000 steps of 4096 draws",
        Preset::PaperTaa => "The paper's job for frames accumulated with alpha 0.2",
        Preset::Salaun => "Spatial blue noise, every frame its own",
        Preset::Progressive => "16 samples per pixel, of which the first so many are good alone",
        Preset::Engine => "A texture for engines, of powers of two: 128x128x32, in a minute or two",
        Preset::Engine64 => "The same of 64 frames",
        Preset::EngineTaa => "The same of 32 frames behind TAA with alpha 0.1",
        Preset::Upscaler => "The same for upscalers with 8 jitter phases",
        Preset::Scalar => "The same with one number per texel, for thresholds and dithering",
        Preset::Scalar64 => "The same of 64 frames",
    }
}
