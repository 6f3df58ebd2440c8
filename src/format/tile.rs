//! Tiles by their paths, for who asks no more of a file than to hold one.

use std::path::Path;

use super::npy;
use super::source::{SourceError, TileSource};
use super::write::{self, Existing, WriteError};
use crate::tile::Tile;

impl Tile {
    /// Reads a tile: a `.npy` file, a PNG with all slices below each other, or a folder of PNG
    /// slices. The content decides which it is, not the name. [`TileSource`] can say what such
    /// files leave open, such as samples per pixel.
    ///
    /// # Errors
    /// Any [`SourceError`]: nothing there that can be read, damage, or numbers that are no
    /// coordinates.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SourceError> {
        TileSource::new(path.as_ref()).read()
    }

    /// Writes the tile as a `.npy` file, `f32` of shape `(frames, height, width, spp, dims)`,
    /// whatever the path's extension.
    ///
    /// A file that exists is replaced, as by [`std::fs::write`], but at once and only by a whole
    /// one: whatever happens, the path has the old file or the new one.
    ///
    /// # Errors
    /// [`WriteError`]: the path is a folder or a device, its folder is missing, or the system
    /// refuses.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), WriteError> {
        write::write(path.as_ref(), Existing::Replace, |out| npy::write_tile(self, out))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::tile::TileShape;

    #[test]
    fn a_tile_comes_back_and_replaces_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tile.npy");
        let shape = TileShape::new(3, 2, 2, 2, 2).unwrap();
        let tile = |first: f32| {
            let mut samples = vec![0.25; shape.coordinates()];
            samples[0] = first;
            Tile::new(shape, samples).unwrap()
        };
        for first in [0.5, 0.75] {
            tile(first).save(&path).unwrap();
            assert_eq!(Tile::load(&path).unwrap(), tile(first));
        }
        let mut bytes = Vec::new();
        npy::write_tile(&tile(0.75), &mut bytes).unwrap();
        assert_eq!(fs::read(&path).unwrap(), bytes);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let error = tile(0.5).save(folder.path()).unwrap_err();
        assert!(matches!(error, WriteError::IsFolder { .. }), "{error}");
        let error = Tile::load(folder.path().join("none.npy")).unwrap_err();
        assert!(matches!(error, SourceError::Io { .. }), "{error}");
    }
}
