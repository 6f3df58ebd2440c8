//! Writing tiles for engines.

use std::path::PathBuf;

use perceptile::format::png::Depth;
use perceptile::format::slices::{SliceOptions, write_slices};
use perceptile::format::write::{self, Existing};
use pyo3::prelude::*;

use crate::arguments;
use crate::failure::Failure;
use crate::tile::Tile;

/// What there is to write: the name of a format, and what writes it.
const FORMATS: [(&str, Writer); 2] =
    [("png8", Writer::Png(Depth::Eight)), ("png16", Writer::Png(Depth::Sixteen))];

/// What writes a format.
#[derive(Debug, Clone, Copy)]
enum Writer {
    /// PNG slices, or a strip of them.
    Png(Depth),
}

/// Writes a tile for an engine, as `perceptile export` does, and returns the paths of the files.
///
/// `path` is the folder for PNG slices of 8 or 16 bits (`format` "png8" or "png16"), one for each frame,
/// or with `strip` one with all frames below each other. `name` is what their names begin with. The
/// provenance goes along as NAME.json, if it is known.
///
/// `tile` is a Tile, an array or the path of a tile. Files that exist stay as they are, and
/// FileExistsError is raised, unless `force` is true: then slices of an earlier export that are in the
/// folder are removed.
#[pyfunction]
#[pyo3(signature = (tile, path, *, format="png8", strip=false, name="tile", force=false))]
pub fn export(
    tile: &Bound<'_, PyAny>,
    path: PathBuf,
    format: &str,
    strip: bool,
    name: &str,
    force: bool,
) -> Result<Vec<PathBuf>, Failure> {
    let py = tile.py();
    let Some((_, writer)) = FORMATS.into_iter().find(|(it, _)| *it == format) else {
        let known = FORMATS.map(|(name, _)| name).join(", ");
        return Err(Failure::value(format!(
            "invalid value '{format}' for format: there are: {known}"
        )));
    };
    let (samples, own) = arguments::tile(tile)?;
    let sidecar = own.as_ref().and_then(|own: &Bound<'_, Tile>| own.get().provenance.clone());
    let existing = Existing::from_force(force);
    py.detach(|| match writer {
        Writer::Png(depth) => {
            let copy = path.join(format!("{name}.json"));
            write::make_folder(&path)?;
            write::probe(sidecar.iter().map(|_| &copy), existing)?;
            let paths =
                write_slices(&samples, SliceOptions { depth, strip }, &path, name, existing)?;
            sidecar.map(|sidecar| sidecar.write(&copy, existing)).transpose()?;
            Ok(paths)
        }
    })
}
