//! How tiles are read that their files do not fully describe: flags of every command that does.

use std::path::PathBuf;

use clap::Args;
use perceptile::format::png::Channels;
use perceptile::format::source::TileSource;

/// What the file of a tile may leave open.
#[derive(Debug, Clone, Args)]
pub struct SourceArgs {
    /// Dimensions of a tile to take, in order, such as `rg` (r, g, b, a are 0, 1, 2, 3).
    #[arg(long)]
    channels: Option<Channels>,

    /// Samples per pixel of a tile, where its file does not say them.
    #[arg(long)]
    spp: Option<usize>,

    /// Frames of a tile, where its file does not say them.
    #[arg(long)]
    frames: Option<usize>,
}

impl SourceArgs {
    /// The tile at a path, read that way.
    pub fn at(&self, path: PathBuf) -> TileSource {
        TileSource { path, channels: self.channels.clone(), spp: self.spp, frames: self.frames }
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
