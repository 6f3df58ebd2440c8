//! How tiles are read that their files do not fully describe: flags of every command that does.

use std::path::{Path, PathBuf};

use clap::Args;
use perceptile::format::png::Channels;
use perceptile::format::source::{SourceError, TileSource};
use perceptile::settings::whole;
use perceptile::tile::Tile;

/// What the file of a tile may leave open.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Reading tiles")]
pub struct SourceArgs {
    /// Dimensions of a tile to take, in order, such as `rg` (r, g, b, a are 0, 1, 2, 3)
    #[arg(long)]
    channels: Option<Channels>,

    /// Samples per pixel of a tile, where its file does not say them
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    spp: Option<usize>,

    /// Frames of a tile, where its file does not say them
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    frames: Option<usize>,
}

impl SourceArgs {
    fn at(&self, path: PathBuf) -> TileSource {
        TileSource { path, channels: self.channels.clone(), spp: self.spp, frames: self.frames }
    }

    /// Reads the tile at a path.
    ///
    /// # Errors
    /// What keeps it from being read.
    pub fn read(&self, path: &Path) -> Result<Tile, SourceError> {
        self.at(path.to_owned()).read()
    }

    /// The flags that say the same.
    pub fn command_line(&self) -> Vec<String> {
        let flags = [
            ("--channels", self.channels.as_ref().map(ToString::to_string)),
            ("--spp", self.spp.map(|spp| spp.to_string())),
            ("--frames", self.frames.map(|frames| frames.to_string())),
        ];
        let given = |(flag, value): (&str, Option<String>)| Some([flag.to_owned(), value?]);
        flags.into_iter().filter_map(given).flatten().collect()
    }
}

/// What a tile at a path is called. A folder's name has no extension, whatever dots it contains.
pub fn name(path: &Path) -> String {
    let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
    name.unwrap_or("tile".as_ref()).to_string_lossy().into_owned()
}
