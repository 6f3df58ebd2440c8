//! Tiles as files for engines: one way for all formats, with which every program exports the same.
//!
//! [`Form`] says what options ask for, and refuses what no reader takes; [`write`](fn@write) makes the files,
//! together, and loses nothing that exists. [`header`] has the functions that read textures in programs and
//! shaders.
//!
//! ```
//! use perceptile::export::{self, ExportFormat, ExportOptions, Form, Named};
//! use perceptile::format::write::Existing;
//! use perceptile::{Optimizer, Preset};
//!
//! # let folder = tempfile::tempdir()?;
//! let run = Optimizer::new(Preset::Quick).size(16, 16, 8).steps(20).run()?;
//! let form = Form::new(&ExportOptions { format: ExportFormat::Ktx2, ..ExportOptions::default() })?;
//! let tile = Named::new("tile", run.tile().clone());
//! let out = folder.path().join("tile.ktx2");
//! let paths = export::write(&form, &[tile], Some(&out), Existing::Keep)?;
//! assert_eq!(paths, [out]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod form;
pub mod header;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::domain::Domain;
use crate::format::exact::exact;
use crate::format::sidecar::Sidecar;
use crate::format::slices::write_slices;
use crate::format::texture::{TextureError, packed, texels_for};
use crate::format::write::{self, Existing, Staged, WriteError};
use crate::format::{ktx2, npy, raw};
use crate::tile::Tile;

pub use form::{ExportFormat, ExportOptions, Form, FormError};
use form::{FileKind, Kind};
use header::{Header, HeaderError};

/// Why a tile is not exported.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ExportError {
    /// Options that do not go together.
    #[error(transparent)]
    Form(#[from] FormError),
    /// Tiles that no texture of that kind holds.
    #[error(transparent)]
    Texture(#[from] TextureError),
    /// A header that could not read.
    #[error(transparent)]
    Header(#[from] HeaderError),
    /// Exact levels of what is no threshold.
    #[error(
        "the tile has samples of {}, but --exact is for tiles of the square, whose levels are thresholds",
        .domain.map_or_else(|| "a density".to_owned(), |domain| format!("`{domain}`"))
    )]
    Exact {
        /// Where the samples live, if it is known.
        domain: Option<Domain>,
    },
    /// Exact levels where there are none.
    #[error("--exact needs a format with levels, such as png8, ktx2 or raw8")]
    Levels,
    /// Files that exist or cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// A tile that is exported.
#[derive(Debug, Clone)]
pub struct Named {
    /// What it is called: files are, and names in programs.
    pub name: String,
    /// The tile.
    pub tile: Tile,
    /// Where its samples live; `None` if that is a density that is not at hand, of which an export needs no
    /// more.
    pub domain: Option<Domain>,
    /// The text of its sidecar, which goes along, and the file that this is from if it is from one.
    pub provenance: Option<(Vec<u8>, Option<PathBuf>)>,
}

impl Named {
    /// A tile of the square, of whose provenance nothing is known.
    pub fn new(name: impl Into<String>, tile: Tile) -> Self {
        Self { name: name.into(), tile, domain: Some(Domain::Square), provenance: None }
    }
}

/// The tile with every level equally often, if the form has levels.
///
/// # Errors
/// A tile of another domain than the square, and a form without levels.
pub fn with_exact_levels(form: &Form, named: &Named) -> Result<Tile, ExportError> {
    if !named.domain.is_some_and(Domain::is_square) {
        return Err(ExportError::Exact { domain: named.domain });
    }
    Ok(exact(&named.tile, form.depth().ok_or(ExportError::Levels)?))
}

/// Writes tiles, at least one; several share a texture, channel after channel. Returns the paths of the
/// files, without those of sidecars, which go along.
///
/// Pictures go into the folder `out`, which is made if the folder around it exists, or into one in the
/// working directory that is called after the tile and the format. Others are the file `out`, or a file
/// called after the tile in the folder `out` or in the working directory.
///
/// # Errors
/// Any [`ExportError`] but those of options and exact levels, before anything is written if that can be
/// known.
///
/// # Panics
/// Without any tile.
pub fn write(
    form: &Form,
    tiles: &[Named],
    out: Option<&Path>,
    existing: Existing,
) -> Result<Vec<PathBuf>, ExportError> {
    let all: Vec<Tile> = tiles.iter().map(|named| named.tile.clone()).collect();
    let tile = packed(&all)?;
    let name = &tiles[0].name;
    match &form.0 {
        Kind::Pictures { options, folder } => {
            form::check_pictures(tile.shape(), options)?;
            let folder = out.map_or_else(|| format!("{name}-{folder}").into(), Path::to_owned);
            write::make_folder(&folder)?;
            let beside = |name: &str| folder.join(format!("{name}.json"));
            // Whole before the first slice has its name, so that slices never stay without it.
            let sidecars = sidecars(tiles, existing, beside)?;
            let own = beside(name);
            let earlier = Sidecar::find(&folder).filter(|earlier| *earlier != own);
            let paths = write_slices(&tile, *options, &folder, name, existing)?;
            sidecars.into_iter().try_for_each(Staged::finish)?;
            if let Some(earlier) = earlier.filter(|_| existing == Existing::Replace) {
                remove_orphan(&earlier)?;
            }
            Ok(paths)
        }
        Kind::File(kind) => {
            let file = kind.name(name);
            let path = match out {
                Some(out) if out.is_dir() => out.join(file),
                out => out.map_or_else(|| file.into(), Path::to_owned),
            };
            let beside = |name: &str| match tiles {
                [_] => Sidecar::path_of(&path),
                _ => path.with_file_name(format!("{name}.json")),
            };
            let with = if form.has_samples() { tiles } else { &[] };
            let sidecars = sidecars(with, existing, beside)?;
            // What several tiles share are numbers, and so are samples of a density.
            let alone = if let [one] = tiles { one.domain } else { None };
            let domain = alone.unwrap_or(Domain::Square);
            let files = stage(kind, (&tile, domain, name), &path, existing)?;
            let (paths, files): (Vec<PathBuf>, Vec<Staged>) = files.into_iter().unzip();
            sidecars.into_iter().chain(files).try_for_each(Staged::finish)?;
            Ok(paths)
        }
    }
}

/// The files of a texture, array or header, whole but without their names yet.
fn stage(
    kind: &FileKind,
    (tile, domain, name): (&Tile, Domain, &str),
    path: &Path,
    existing: Existing,
) -> Result<Vec<(PathBuf, Staged)>, ExportError> {
    let shape = tile.shape();
    let stage = |content: &mut dyn FnMut(&mut dyn io::Write) -> io::Result<()>| {
        Staged::new(path, existing, content).map(|staged| (path.to_owned(), staged))
    };
    match *kind {
        FileKind::Ktx2 { texels, depth, layout } => {
            let texels = texels_for(shape, texels)?;
            Ok(vec![stage(&mut |out| ktx2::write(tile, (texels, depth), layout, out))?])
        }
        FileKind::Raw { texels, depth } => {
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
        FileKind::Npy { depth } => Ok(vec![stage(&mut |out| npy::write_levels(tile, depth, out))?]),
        FileKind::Header { language, storage, texels, depth } => {
            let text = Header { name, shape, domain, texels, depth, storage }.text(language)?;
            Ok(vec![stage(&mut |out| out.write_all(text.as_bytes()))?])
        }
    }
}

/// The sidecars of tiles, for those that have one, without their names yet; `place` is where the one of a
/// tile of that name goes.
fn sidecars(
    tiles: &[Named],
    existing: Existing,
    place: impl Fn(&str) -> PathBuf,
) -> Result<Vec<Staged>, WriteError> {
    let mut staged = Vec::new();
    let mut places = Vec::new();
    for Named { name, provenance, .. } in tiles {
        let Some((text, from)) = provenance else { continue };
        let place = place(name);
        // In the tile's own folder it is there already.
        if from.as_ref().is_some_and(|from| write::is_same(from, &place)) {
            continue;
        }
        places.push(place.clone());
        write::probe(&places, existing)?;
        staged.push(Staged::new(&place, existing, |out| out.write_all(text))?);
    }
    Ok(staged)
}

/// Removes the sidecar of an earlier export whose slices are gone, and nothing else: not one that is
/// beside its tile, nor what only has the name of one.
fn remove_orphan(sidecar: &Path) -> Result<(), WriteError> {
    let is_used = Sidecar::has_slices(sidecar) || sidecar.with_extension("npy").exists();
    if is_used || Sidecar::read(sidecar).is_err() {
        return Ok(());
    }
    fs::remove_file(sidecar).map_err(WriteError::io(sidecar))
}
