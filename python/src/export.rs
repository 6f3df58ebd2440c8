//! Writing tiles for engines.

use std::path::PathBuf;

use perceptile::domain::Domain;
use perceptile::export::header::Language;
use perceptile::export::{self as exporting, ExportFormat, ExportOptions, Form, Named};
use perceptile::format::texture::Texels;
use perceptile::format::write::Existing;
use pyo3::prelude::*;

use crate::arguments;
use crate::failure::Failure;
use crate::tile::Tile;

/// Writes a tile for an engine, as `perceptile export` does, and returns the paths of the files.
///
/// `format` is "png8", "png16" or "exr" (`path` is a folder), "ktx2", "ktx2-3d", "raw8", "raw16", "npy" or
/// "header" (`path` is the file, or a folder that exists). `bits` is 8 or 16 where the format does not say it,
/// `texels` "r", "rg", "rgb" or "rgba". `exact` gives every level equally often in each slice. `strip` puts all
/// frames of a PNG below each other, `layers` all into one EXR file, and `plain_numbers` leaves zeros out of names.
/// A header has a `language`, "c", "hlsl", "glsl" or "wgsl", and reads the format `reads`. `name` is what files
/// and functions are called.
///
/// `tile` is a Tile, an array or the path of a tile, or a list of them, whose dimensions share one texture.
/// The provenance goes along as NAME.json, if it is known. Files that exist stay as they are, and
/// FileExistsError is raised, unless `force` is true: then slices of an earlier export that are in the
/// folder are removed.
///
/// >>> import tempfile
/// >>> tile = perceptile.baseline("white", (8, 8, 4))
/// >>> with tempfile.TemporaryDirectory() as folder:
/// ...     [path.name for path in perceptile.export(tile, folder, format="ktx2")]
/// ['tile.ktx2']
#[pyfunction]
#[pyo3(signature = (
    tile, path, *, format="png8", bits=None, texels=None, exact=false, strip=false, layers=false,
    plain_numbers=false, language=None, reads=None, name="tile", force=false
))]
#[allow(clippy::too_many_arguments, reason = "they are Python's, by name")]
pub fn export(
    tile: &Bound<'_, PyAny>,
    path: PathBuf,
    format: &str,
    bits: Option<u32>,
    texels: Option<&str>,
    exact: bool,
    strip: bool,
    layers: bool,
    plain_numbers: bool,
    language: Option<&str>,
    reads: Option<&str>,
    name: &str,
    force: bool,
) -> Result<Vec<PathBuf>, Failure> {
    let py = tile.py();
    let format: ExportFormat = format.parse()?;
    let texels = texels.map(str::parse::<Texels>).transpose();
    let texels = texels.map_err(|error| Failure::value(format!("texels: {error}")))?;
    let form = Form::new(&ExportOptions {
        format,
        bits,
        texels,
        exact,
        strip,
        layers,
        plain_numbers,
        language: language.map(named_language).transpose()?,
        reads: reads.map(str::parse).transpose()?,
    })?;
    let mut tiles = Vec::new();
    match tile.cast::<pyo3::types::PyList>() {
        Ok(list) => {
            for (number, one) in list.iter().enumerate() {
                // Sidecars need names of their own.
                let name = if number == 0 { name.to_owned() } else { format!("{name}-{number}") };
                tiles.push(read(&one, name)?);
            }
        }
        Err(_) => tiles.push(read(tile, name.to_owned())?),
    }
    if tiles.is_empty() {
        return Err(Failure::value("there is no tile to export"));
    }
    py.detach(|| {
        for named in &mut tiles {
            if exact {
                named.tile = exporting::with_exact_levels(&form, named)?;
            }
        }
        Ok(exporting::write(&form, &tiles, Some(&path), Existing::from_force(force))?)
    })
}

fn named_language(name: &str) -> Result<Language, Failure> {
    let named = Language::ALL.into_iter().find(|&(_, its)| its == name);
    let names = || Language::ALL.map(|(_, name)| name).join(", ");
    named.map(|(language, _)| language).ok_or_else(|| {
        Failure::value(format!("invalid value '{name}' for language: there are: {}", names()))
    })
}

/// A tile with what is known of it.
fn read(tile: &Bound<'_, PyAny>, name: String) -> Result<Named, Failure> {
    let (tile, own) = arguments::tile(tile)?;
    let own = own.as_ref().map(|own: &Bound<'_, Tile>| own.get());
    let sidecar = own.and_then(|own| own.provenance.clone());
    let text = sidecar.map(|sidecar| sidecar.text()).transpose();
    let text = text.map_err(|error| Failure::run(error.to_string()))?;
    let domain = own.map_or(Some(Domain::Square), |own| own.domain);
    Ok(Named { name, tile, domain, provenance: text.map(|text| (text, None)) })
}
