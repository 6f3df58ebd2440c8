//! `perceptile export`: a tile as PNG files for a renderer.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use perceptile::format::png::Depth;
use perceptile::format::slices::{SliceOptions, write_slices};
use perceptile::format::write::{self, Existing};

use super::exit::Failure;
use super::source::SourceArgs;
use super::stream::print;

/// Write a tile as PNG files, one for each frame.
///
/// A coordinate x becomes the level floor(256 x) or floor(65536 x): read it back as
/// (level + 0.5) / 256 or (level + 0.5) / 65536. Two dimensions are red and green. With several
/// samples per pixel or more than four dimensions, each file has one sample (and a pair of
/// dimensions) and its name says which: TILE_f000_s00_d00.png.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The tile: a .npy file, a vertical strip of PNG slices, or a folder of PNG slices.
    tile: PathBuf,

    /// What to write.
    #[arg(long, value_enum)]
    format: ExportFormat,

    /// Folder for the files, and for slices of no other tile; it is made if the folder around it
    /// exists.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Write one picture with all frames below each other.
    #[arg(long)]
    strip: bool,

    #[command(flatten)]
    source: SourceArgs,

    /// Replace files that exist, and remove slices of earlier exports that are in the folder.
    #[arg(long)]
    force: bool,
}

/// What `--format` offers.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ExportFormat {
    /// PNG with 8 bits per channel.
    Png8,
    /// PNG with 16 bits per channel.
    Png16,
}

/// Reads the tile and writes its files.
///
/// # Errors
/// A tile that cannot be read, files that exist without `--force` or cannot be written, a folder
/// with slices of another tile.
pub fn run(args: ExportArgs) -> Result<(), Failure> {
    let source = args.source.at(args.tile);
    let tile = source.read()?;
    let stem = source.path.file_stem().unwrap_or("tile".as_ref()).to_string_lossy();
    let options = SliceOptions {
        depth: match args.format {
            ExportFormat::Png8 => Depth::Eight,
            ExportFormat::Png16 => Depth::Sixteen,
        },
        strip: args.strip,
    };
    write::make_folder(&args.out)?;
    let paths = write_slices(&tile, options, &args.out, &stem, Existing::from_force(args.force))?;
    let text = match &paths[..] {
        [first, .., last] => {
            format!("{} … {} ({} files)\n", first.display(), last.display(), paths.len())
        }
        [path] => format!("{}\n", path.display()),
        [] => String::new(),
    };
    Ok(print(&text)?)
}
