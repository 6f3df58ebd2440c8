//! `perceptile export`: a tile as PNG files for a renderer.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use perceptile::format::png::Depth;
use perceptile::format::sidecar::Sidecar;
use perceptile::format::slices::{SliceOptions, write_slices};
use perceptile::format::write::{self, Existing, Staged};
use perceptile::tile::TileShape;

use super::exit::Failure;
use super::source::{self, SourceArgs};
use super::stream::print;

/// Write a tile as PNG files, one for each frame
///
/// A coordinate x becomes the level floor(256 x) or floor(65536 x): read it back as
/// (level + 0.5) / 256 or (level + 0.5) / 65536. Two dimensions are red and green. With several
/// samples per pixel or more than four dimensions, each file has one sample (and a pair of
/// dimensions) and its name says which: TILE_f000_s00_d00.png. The tile's sidecar goes along as
/// TILE.json, so that `evaluate` knows the kernel of the folder, too.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ExportArgs {
    /// The tile: a .npy file, a vertical strip of PNG slices, or a folder of PNG slices
    tile: PathBuf,

    /// What to write
    #[arg(long, value_enum, default_value_t = ExportFormat::Png8, help_heading = "Output")]
    format: ExportFormat,

    /// Folder for the files, and for slices of no other tile; it is made if the folder around it
    /// exists [default: NAME-png8 or NAME-png16 in the working directory, NAME that of the tile]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,

    /// Write one picture with all frames below each other
    #[arg(long, help_heading = "Output")]
    strip: bool,

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
  perceptile export tile.npy --format png16 --out textures";

/// What `--format` offers.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ExportFormat {
    /// PNG with 8 bits per channel
    Png8,
    /// PNG with 16 bits per channel
    Png16,
}

impl ExportFormat {
    fn depth(self) -> Depth {
        match self {
            Self::Png8 => Depth::Eight,
            Self::Png16 => Depth::Sixteen,
        }
    }

    /// The folder for a tile of this name, if none is given.
    fn folder(self, name: &str) -> PathBuf {
        let format = match self {
            Self::Png8 => "png8",
            Self::Png16 => "png16",
        };
        format!("{name}-{format}").into()
    }
}

/// Reads the tile and writes its files.
///
/// # Errors
/// A tile that cannot be read, files that exist without `--force` or cannot be written, a folder
/// with slices of another tile.
pub fn run(args: ExportArgs) -> Result<(), Failure> {
    let ExportArgs { tile: path, format, out, strip, force, source } = args;
    let tile = source.read(&path)?;
    let name = source::name(&path);
    let out = out.unwrap_or_else(|| format.folder(&name));
    let options = SliceOptions { depth: format.depth(), strip };
    let existing = Existing::from_force(force);
    write::make_folder(&out)?;
    // Whole before the first slice has its name, so that slices never stay without it.
    let copy = out.join(name.clone() + ".json");
    let sidecar = sidecar_of(&path, tile.shape())
        // In the tile's own folder it is there already.
        .filter(|sidecar| !source::is_same(sidecar, &copy))
        .map(|sidecar| stage(&sidecar, &copy, existing))
        .transpose()?;
    let earlier = Sidecar::find(&out).filter(|earlier| *earlier != copy);
    let paths = write_slices(&tile, options, &out, &name, existing)?;
    sidecar.map(Staged::finish).transpose()?;
    if let Some(earlier) = earlier.filter(|_| force) {
        remove_orphan(&earlier)?;
    }
    let text = match &paths[..] {
        [first, .., last] => {
            format!("{} … {} ({} files)\n", first.display(), last.display(), paths.len())
        }
        [path] => format!("{}\n", path.display()),
        [] => String::new(),
    };
    Ok(print(&text)?)
}

/// The sidecar of a tile, if it has one: what is none of this tile stays where it is.
fn sidecar_of(tile: &Path, shape: TileShape) -> Option<PathBuf> {
    let path = Sidecar::find(tile)?;
    Sidecar::read(&path).ok()?.describes(tile, shape).then_some(path)
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

/// The copy of a sidecar, without its name yet.
fn stage(sidecar: &Path, copy: &Path, existing: Existing) -> Result<Staged, Failure> {
    write::probe([copy], existing)?;
    Ok(Staged::new(copy, existing, |out| out.write_all(&fs::read(sidecar)?))?)
}
