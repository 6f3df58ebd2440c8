//! `perceptile presets`: what the presets set.

use clap::Args;
use perceptile::settings::{Settings, purpose};
use perceptile::solver::Preset;
use serde_json::{Map, Value};

use super::exit::Failure;
use super::stream::show;

/// Show what the presets set
///
/// A preset is a set of defaults of `optimize` and `profile`; any other flag overrides it. --json
/// prints all settings, under the names of their flags.
#[derive(Debug, Args)]
pub struct PresetsArgs {
    /// Print JSON, with all settings
    #[arg(long)]
    json: bool,
}

/// The settings in which presets differ, or that people ask for first, with the width of their
/// columns.
const COLUMNS: [(&str, usize); 7] = [
    ("tile", 12),
    ("spp", 5),
    ("dims", 6),
    ("steps", 7),
    ("draws", 7),
    ("directions", 12),
    ("polish", 8),
];

/// Prints the presets.
///
/// # Errors
/// An output that cannot be written.
pub fn run(args: &PresetsArgs) -> Result<(), Failure> {
    let all = |(preset, _)| -> Result<Map<String, Value>, Failure> {
        let settings = Settings { preset: Some(preset), ..Settings::default() };
        let mut all = settings.effective(&settings.options()?.0);
        all.insert("purpose".into(), purpose(preset).into());
        Ok(all)
    };
    let presets: Vec<_> = Preset::ALL.into_iter().map(all).collect::<Result<_, _>>()?;
    Ok(show(args.json, &presets, || table(&presets))?)
}

/// The form for people: a line of numbers for each preset, and one with its kernel.
fn table(presets: &[Map<String, Value>]) -> String {
    let text = |preset: &Map<String, Value>, name: &str| match &preset[name] {
        Value::String(text) => text.clone(),
        number => number.to_string(),
    };
    let heading = COLUMNS.map(|(name, width)| format!("{name:>width$}")).concat();
    let mut table = format!("{:<12}{heading}  what for\n", "preset");
    for preset in presets {
        let cells = COLUMNS.map(|(name, width)| format!("{:>width$}", text(preset, name)));
        let [name, purpose] = ["preset", "purpose"].map(|name| text(preset, name));
        table += &format!("{name:<12}{}  {purpose}\n", cells.concat());
    }
    table += "\npreset      kernel\n";
    for preset in presets {
        table += &format!("{:<12}{}\n", text(preset, "preset"), text(preset, "kernel"));
    }
    table
}
