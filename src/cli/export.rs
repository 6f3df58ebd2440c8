//! `perceptile export`: a tile as files for engines, renderers and scripts.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use perceptile::export::header::Language;
use perceptile::export::{self, ExportFormat, ExportOptions, Form, Named};
use perceptile::format::sidecar::Sidecar;
use perceptile::format::texture::Texels;
use perceptile::format::write::{self, Existing};
use perceptile::metric::{Coordinates, ScoreOptions, Scores, digits};
use perceptile::settings::whole;
use perceptile::tile::{Tile, TileShape};

use super::exit::{Failure, Misuse};
use super::source::{self, SourceArgs};
use super::stream::{print, say};
use super::{domain, perceived};

/// Write a tile as pictures, textures or arrays for engines, and the function that reads them
///
/// A coordinate x becomes the level floor(256 x) or floor(65536 x): read it back as
/// (level + 0.5) / 256 or (level + 0.5) / 65536. Dimensions are channels. Textures have a layer for each
/// frame, with several samples per pixel one for each sample of it. Pictures with several samples or
/// more than four dimensions hold one sample (and a pair of dimensions) and their names say which:
/// TILE_f000_s00_d00.png. Several tiles go into one texture, channel after channel. The tile's sidecar
/// goes along as TILE.json, so that `evaluate` knows the kernel of what was exported, too.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ExportArgs {
    /// The tile: a file or folder that `evaluate` reads; several have up to 4 dimensions together
    #[arg(value_name = "TILE", required = true)]
    tiles: Vec<PathBuf>,

    /// What to write
    #[arg(long, value_parser = format(), default_value = "png8", help_heading = "Output")]
    format: ExportFormat,

    /// Bits of a channel, 8 or 16 [default: 8; npy 16]
    #[arg(long, value_name = "N", value_parser = whole::<u32>, help_heading = "Output")]
    bits: Option<u32>,

    /// Channels of a texel or pixel: r, rg, rgb or rgba [default: as many as dimensions; three
    /// take rgba in textures, and two take rgb in pictures]
    #[arg(long, value_name = "CHANNELS", help_heading = "Output")]
    texels: Option<Texels>,

    /// Every level equally often in each slice, by the ranks of its coordinates: for thresholds and
    /// dithering; prints what that does to the scores
    #[arg(long, help_heading = "Output")]
    exact: bool,

    /// PNG: one picture with all frames below each other
    #[arg(long, help_heading = "Output")]
    strip: bool,

    /// EXR: one file with a layer for each frame
    #[arg(long, help_heading = "Output")]
    layers: bool,

    /// Numbers in names without leading zeros: TILE_f0.png, TILE_f1.png and so on
    #[arg(long, help_heading = "Output")]
    plain_numbers: bool,

    /// Header: its language [default: c]
    #[arg(long, value_parser = language(), help_heading = "Output")]
    language: Option<Language>,

    /// Header: the format that it reads [default: raw8 in C, else ktx2]
    #[arg(long = "for", value_parser = format(), value_name = "FORMAT", help_heading = "Output")]
    reads: Option<ExportFormat>,

    /// Pictures: a folder for them, and for slices of no other tile; it is made if the folder around it
    /// exists [default: NAME-png8 and so on in the working directory, NAME that of the tile]. Others:
    /// the file, or a folder for it [default: NAME with the format's extension in the working directory]
    #[arg(long, value_name = "PATH", help_heading = "Output")]
    out: Option<PathBuf>,

    /// Replace files that exist, and remove slices of earlier exports that are in the folder, with
    /// their sidecar
    #[arg(long, help_heading = "Output")]
    force: bool,

    #[command(flatten)]
    source: SourceArgs,
}

const EXAMPLES: &str = "\
Examples:
  perceptile export tile.npy
  perceptile export tile.npy --format ktx2
  perceptile export tile.npy --format header --language glsl
  perceptile export tile.npy --format png16 --out textures
  perceptile export pair.npy scalar.npy --format ktx2 --out packed.ktx2";

/// Reads the name of a format.
fn format() -> impl TypedValueParser<Value = ExportFormat> {
    let name = |(_, name, purpose): &(_, &'static str, &'static str)| {
        PossibleValue::new(*name).help(*purpose)
    };
    let names: Vec<PossibleValue> = ExportFormat::ALL.iter().map(name).collect();
    PossibleValuesParser::new(names).try_map(|name| name.parse())
}

/// Reads the name of a language.
fn language() -> impl TypedValueParser<Value = Language> {
    let language = |name: String| Language::ALL.into_iter().find(|&(_, its)| its == name);
    PossibleValuesParser::new(Language::ALL.map(|(_, name)| name))
        .map(move |name| language(name).expect("one of the names").0)
}

/// Reads the tiles and writes their files.
///
/// # Errors
/// A tile that cannot be read, a combination that no format has, files that exist without `--force` or
/// cannot be written, a folder with slices of another tile.
pub fn run(args: &ExportArgs) -> Result<(), Failure> {
    let ExportArgs { format, bits, texels, exact, strip, layers, plain_numbers, .. } = *args;
    let ExportArgs { language, reads, .. } = *args;
    let form = Form::new(&ExportOptions {
        format,
        bits,
        texels,
        exact,
        strip,
        layers,
        plain_numbers,
        language,
        reads,
    })?;
    check_outputs(args)?;
    let mut lines = String::new();
    let mut tiles = Vec::new();
    for path in &args.tiles {
        let mut named = read(path, &args.source)?;
        if exact {
            let made = export::with_exact_levels(&form, &named)?;
            if form.has_samples() {
                lines += &loss(path, &named.tile, &made)?;
            }
            named.tile = made;
        }
        tiles.push(named);
    }
    if form.is_texture() {
        warn_of_sides(tiles[0].tile.shape());
    }
    let existing = Existing::from_force(args.force);
    let paths = export::write(&form, &tiles, args.out.as_deref(), existing)?;
    lines += &match &paths[..] {
        [first, .., last] if paths.len() > 2 => {
            format!("{} … {} ({} files)\n", first.display(), last.display(), paths.len())
        }
        paths => paths.iter().map(|path| format!("{}\n", path.display())).collect(),
    };
    Ok(print(&lines)?)
}

/// Checks that no tile would be replaced by its export.
fn check_outputs(args: &ExportArgs) -> Result<(), Misuse> {
    let Some(out) = args.out.as_ref().filter(|out| out.is_file()) else { return Ok(()) };
    if args.tiles.iter().any(|tile| write::is_same(tile, out)) {
        let what = format!("the export would replace the tile {}", out.display());
        return Err(Misuse(format!("{what}: give another --out")));
    }
    Ok(())
}

/// Reads a tile with what is known of it.
fn read(path: &Path, source: &SourceArgs) -> Result<Named, Failure> {
    let tile = source.read(path)?;
    // That of a density that is not at hand is all that cannot be known.
    let domain = domain::of_tile(path, tile.shape()).ok();
    // A sidecar that is none of this tile stays where it is.
    let sidecar = Sidecar::find(path)
        .filter(|sidecar| Sidecar::read(sidecar).is_ok_and(|it| it.describes(path, tile.shape())));
    let text = |sidecar: PathBuf| {
        let what = format!("cannot read {}", sidecar.display());
        let text = fs::read(&sidecar).map_err(Failure::refused(&what))?;
        Ok::<_, Failure>((text, Some(sidecar)))
    };
    let provenance = sidecar.map(text).transpose()?;
    Ok(Named { name: source::name(path), tile, domain, provenance })
}

/// Says which sides of a texture engines will not take.
fn warn_of_sides(shape: TileShape) {
    let sides = [shape.width(), shape.height(), shape.frames()];
    if !sides.iter().all(|side| side.is_power_of_two()) {
        let [width, height, frames] = sides;
        let rule = "some engines take powers of two only, such as --preset engine has";
        say(format_args!("warning: the texture has {width}x{height}x{frames} texels, but {rule}"));
    }
}

/// What exact levels do to the scores, behind the kernel that the tile was made for.
fn loss(path: &Path, tile: &Tile, exact: &Tile) -> Result<String, Failure> {
    let kernel = perceived::of_tile(path, tile.shape());
    let resolved = kernel.spec.resolve(tile.shape())?;
    let taps = &resolved.classes()[0].taps;
    let scores = |tile: &Tile| Scores::of(tile, taps, ScoreOptions::default());
    let (before, after) = (scores(tile)?, scores(exact)?);
    let mut text = format!("perceived error of {}, kernel {}:\n", path.display(), kernel.origin);
    for score in before.classes.iter().filter(|score| score.coordinates == Coordinates::All) {
        let Some(other) = after.class(score.class, Coordinates::All) else { continue };
        let (a, b) = (score.perceived.mean, other.perceived.mean);
        let (class, from, to) = (score.class.to_string(), digits(a, 3), digits(b, 3));
        text += &format!("  {class:<10} {from} -> {to} ({:.2} times)\n", b / a);
    }
    Ok(text)
}
