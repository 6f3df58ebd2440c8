//! `perceptile export`: a tile as files for engines, renderers and scripts.

mod form;

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use perceptile::domain::Domain;
use perceptile::format::exact::exact;
use perceptile::format::header::Header;
use perceptile::format::sidecar::Sidecar;
use perceptile::format::slices::write_slices;
use perceptile::format::texture::{Texels, packed, texels_for};
use perceptile::format::write::{self, Existing, Staged};
use perceptile::format::{ktx2, npy, raw};
use perceptile::metric::{Coordinates, ScoreOptions, Scores, digits};
use perceptile::tile::{Tile, TileShape};

use self::form::{ExportFormat, FileForm, Form};
use super::exit::{Failure, Misuse};
use super::source::{self, SourceArgs};
use super::stream::{print, say};
use super::{domain, perceived};
use perceptile::settings::whole;

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
    #[arg(long, value_enum, default_value_t = ExportFormat::Png8, help_heading = "Output")]
    format: ExportFormat,

    /// Bits of a channel, 8 or 16 [default: 8; npy 16]
    #[arg(long, value_name = "N", value_parser = whole::<u32>, help_heading = "Output")]
    bits: Option<u32>,

    /// Channels of a texel or pixel: r, rg, rgb or rgba [default: as many as dimensions; three
    /// take rgba in textures, and two take rgb in pictures]
    #[arg(long, value_name = "CHANNELS", value_parser = form::texels, help_heading = "Output")]
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
    #[arg(long, value_enum, help_heading = "Output")]
    language: Option<form::LanguageName>,

    /// Header: the format that it reads [default: raw8 in C, else ktx2]
    #[arg(long = "for", value_enum, value_name = "FORMAT", help_heading = "Output")]
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

/// Reads the tile and writes its files.
///
/// # Errors
/// A tile that cannot be read, a combination that no format has, files that exist without `--force` or
/// cannot be written, a folder with slices of another tile.
pub fn run(args: ExportArgs) -> Result<(), Failure> {
    let form = Form::new(&args)?;
    let mut tiles = Vec::new();
    for path in &args.tiles {
        tiles.push(args.source.read(path)?);
    }
    let domain = domain_of(&args.tiles, &tiles)?;
    let mut lines = String::new();
    if args.exact {
        if !domain.is_square() {
            let rule = "--exact is for tiles of the square, whose levels are thresholds";
            return Err(Misuse(format!("the tile has samples of `{domain}`, but {rule}")).into());
        }
        let depth =
            form.depth().ok_or_else(|| Misuse("--exact needs a format with levels".into()))?;
        for (path, tile) in args.tiles.iter().zip(&mut tiles) {
            let made = exact(tile, depth);
            if !matches!(form, Form::File(FileForm::Header { .. })) {
                lines += &loss(path, tile, &made)?;
            }
            *tile = made;
        }
    }
    let tile = packed(&tiles)?;
    if let Form::File(FileForm::Ktx2 { .. }) = form {
        warn_of_sides(tile.shape());
    }
    let name = source::name(&args.tiles[0]);
    let existing = Existing::from_force(args.force);
    let paths = match form {
        Form::Pictures { options, folder } => {
            form::check_pictures(tile.shape(), &options)?;
            let folder = args.out.unwrap_or_else(|| format!("{name}-{folder}").into());
            write::make_folder(&folder)?;
            let named = |path: &Path| folder.join(format!("{}.json", source::name(path)));
            // Whole before the first slice has its name, so that slices never stay without it.
            let sidecars = sidecars(&args.tiles, &tiles, existing, named)?;
            let own = folder.join(name.clone() + ".json");
            let earlier = Sidecar::find(&folder).filter(|earlier| *earlier != own);
            let paths = write_slices(&tile, options, &folder, &name, existing)?;
            sidecars.into_iter().try_for_each(Staged::finish)?;
            if let Some(earlier) = earlier.filter(|_| args.force) {
                remove_orphan(&earlier)?;
            }
            paths
        }
        Form::File(form) => {
            let file = form.name(&name);
            let path = match args.out {
                Some(out) if out.is_dir() => out.join(file),
                out => out.unwrap_or_else(|| file.into()),
            };
            let mut staged = Vec::new();
            if form.has_samples() {
                let single = args.tiles.len() == 1;
                let beside = |tile: &Path| match single {
                    true => Sidecar::path_of(&path),
                    false => path.with_file_name(format!("{}.json", source::name(tile))),
                };
                staged = sidecars(&args.tiles, &tiles, existing, beside)?;
            }
            let files = stage_file(&form, (&tile, domain, &name), &path, existing)?;
            let (paths, files): (Vec<PathBuf>, Vec<Staged>) = files.into_iter().unzip();
            staged.into_iter().chain(files).try_for_each(Staged::finish)?;
            paths
        }
    };
    lines += &match &paths[..] {
        [first, .., last] if paths.len() > 2 => {
            format!("{} … {} ({} files)\n", first.display(), last.display(), paths.len())
        }
        paths => paths.iter().map(|path| format!("{}\n", path.display())).collect(),
    };
    Ok(print(&lines)?)
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

/// Where the samples of the tile live, as far as one domain says it: packed tiles are numbers.
fn domain_of(paths: &[PathBuf], tiles: &[Tile]) -> Result<Domain, Failure> {
    match (paths, tiles) {
        ([path], [tile]) => domain::of_tile(path, tile.shape()),
        _ => Ok(Domain::Square),
    }
}

/// The files of a texture, array or header, whole but without their names yet.
fn stage_file(
    form: &FileForm,
    (tile, domain, name): (&Tile, Domain, &str),
    path: &Path,
    existing: Existing,
) -> Result<Vec<(PathBuf, Staged)>, Failure> {
    let shape = tile.shape();
    let stage = |content: &mut dyn FnMut(&mut dyn std::io::Write) -> std::io::Result<()>| {
        Staged::new(path, existing, content).map(|staged| (path.to_owned(), staged))
    };
    match *form {
        FileForm::Ktx2 { texels, depth, layout } => {
            let texels = texels_for(shape, texels)?;
            Ok(vec![stage(&mut |out| ktx2::write(tile, (texels, depth), layout, out))?])
        }
        FileForm::Raw { texels, depth } => {
            let texels = texels_for(shape, texels)?;
            let beside = raw::description_of(path);
            write::probe([path, &beside], existing)?;
            let mut description = None;
            let raw = stage(&mut |out| {
                description = Some(raw::write(tile, (texels, depth), out)?);
                Ok(())
            })?;
            let json = Staged::new(&beside, existing, |out| {
                serde_json::to_writer_pretty(&mut *out, &description)?;
                writeln!(out)
            })?;
            Ok(vec![raw, (beside, json)])
        }
        FileForm::Npy { depth } => Ok(vec![stage(&mut |out| npy::write_levels(tile, depth, out))?]),
        FileForm::Header { language, storage, texels, depth } => {
            let header = Header { name, shape, domain, texels, depth, storage };
            let text = header.text(language)?;
            Ok(vec![stage(&mut |out| out.write_all(text.as_bytes()))?])
        }
    }
}

/// What exact levels do to the scores, behind the kernel that the tile was made for.
fn loss(path: &Path, tile: &Tile, exact: &Tile) -> Result<String, Failure> {
    let kernel = perceived::of_tile(path, tile.shape());
    let resolved = kernel.spec.resolve(tile.shape())?;
    let taps = &resolved.classes()[0].taps;
    let scores = |tile: &Tile| Scores::of(tile, taps, ScoreOptions::default());
    let (before, after) = (scores(tile)?, scores(exact)?);
    let origin = &kernel.origin;
    let mut text = format!("perceived error of {}, kernel {origin}:\n", path.display());
    for score in before.classes.iter().filter(|score| score.coordinates == Coordinates::All) {
        let class = score.class;
        let Some(other) = after.class(class, Coordinates::All) else { continue };
        let (a, b) = (score.perceived.mean, other.perceived.mean);
        let (from, to) = (digits(a, 3), digits(b, 3));
        text += &format!("  {:<10} {from} -> {to} ({:.2} times)\n", class.to_string(), b / a);
    }
    Ok(text)
}

/// Copies of the sidecars of tiles, for those that have one that is theirs, without their names yet.
fn sidecars(
    paths: &[PathBuf],
    tiles: &[Tile],
    existing: Existing,
    copy: impl Fn(&Path) -> PathBuf,
) -> Result<Vec<Staged>, Failure> {
    let mut staged = Vec::new();
    for (path, tile) in paths.iter().zip(tiles) {
        let Some(sidecar) = Sidecar::find(path) else { continue };
        let is_its = Sidecar::read(&sidecar).is_ok_and(|it| it.describes(path, tile.shape()));
        let copy = copy(path);
        // In the tile's own folder it is there already.
        if is_its && !source::is_same(&sidecar, &copy) {
            write::probe([&copy], existing)?;
            staged.push(Staged::new(&copy, existing, |out| out.write_all(&fs::read(sidecar)?))?);
        }
    }
    Ok(staged)
}

/// Removes the sidecar of an earlier export whose slices are gone, and nothing else: not one that is
/// beside its tile, nor what only has the name of one.
fn remove_orphan(sidecar: &Path) -> Result<(), Failure> {
    let is_used = Sidecar::has_slices(sidecar) || sidecar.with_extension("npy").exists();
    if is_used || Sidecar::read(sidecar).is_err() {
        return Ok(());
    }
    let what = format!("cannot remove {}", sidecar.display());
    fs::remove_file(sidecar).map_err(Failure::refused(&what))
}
