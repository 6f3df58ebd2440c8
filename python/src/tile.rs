//! Tiles as Python sees them: an array, where it comes from, and how good it is.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use numpy::{PyArray5, PyArrayMethods};
use perceptile::domain::Domain;
use perceptile::format::npy;
use perceptile::format::sidecar::{self, Sidecar};
use perceptile::format::write::{self, Existing};
use perceptile::kernel::KernelSpec;
use perceptile::solver::Preset;
use perceptile::{ScoreOptions, Scores, TileShape, TileSource};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use crate::arguments;
use crate::failure::Failure;
use crate::running;

/// A sample tile: an array, where it comes from, and how good it is.
///
/// `optimize` makes one, `Tile.load` reads one, and `Tile(array)` is one of numbers of your own: floats
/// in [0, 1) of (frames, height, width, spp, dims), or without spp.
///
/// >>> tile = perceptile.optimize(preset="quick", tile=(8, 8, 4), steps=20, integrands=8)
/// >>> tile
/// Tile(8x8x4, 1 spp, 2 dims)
/// >>> tile.array.shape, tile.array.dtype.name
/// ((4, 8, 8, 1, 2), 'float32')
/// >>> tile.seed, tile.provenance["options"]["options"]["steps"]
/// (1, 20)
/// >>> [score["class"] for score in tile.scores["classes"]]
/// ['linear', 'edge', 'axis_edge', 'bump', 'disk']
#[pyclass(frozen, module = "perceptile")]
pub struct Tile {
    array: Py<PyArray5<f32>>,
    /// Its shape in the library.
    pub shape: TileShape,
    /// Where its samples live; None if that is a density that is not at hand.
    pub domain: Option<Domain>,
    /// Where it comes from, if that is known; of one that was read from pictures, before it was rounded.
    pub provenance: Option<Sidecar>,
    digest: OnceLock<String>,
    scores: OnceLock<Value>,
}

#[pymethods]
impl Tile {
    #[new]
    fn of_array(array: &Bound<'_, PyAny>) -> Result<Self, Failure> {
        Ok(Self::new(array.py(), arguments::tile(array)?.0, Some(Domain::Square), None))
    }

    /// Reads a tile: a .npy file, a PNG with all slices below each other, or a folder of PNG slices.
    ///
    /// `channels` picks dimensions, such as "rg"; `spp` and `frames` are for files that do not say them.
    /// A sidecar of the tile, beside it, is its provenance.
    #[staticmethod]
    #[pyo3(signature = (path, *, channels=None, spp=None, frames=None))]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        channels: Option<&str>,
        spp: Option<usize>,
        frames: Option<usize>,
    ) -> Result<Self, Failure> {
        let channels = channels.map(|text| {
            text.parse().map_err(|problem| {
                Failure::value(format!("invalid value '{text}' for channels: {problem}"))
            })
        });
        let channels = channels.transpose()?;
        Ok(Self::read(py, TileSource { channels, spp, frames, ..TileSource::new(path) })?.1)
    }

    /// The coordinates: float32 (frames, height, width, spp, dims), not to be written to.
    #[getter]
    fn array<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray5<f32>> {
        self.array.bind(py).clone()
    }

    /// (frames, height, width, spp, dims).
    #[getter]
    fn shape(&self) -> (usize, usize, usize, usize, usize) {
        let shape = self.shape;
        (shape.frames(), shape.height(), shape.width(), shape.spp(), shape.dims())
    }

    /// The kernel that it is made for, as text; None if that is not known.
    #[getter]
    fn kernel(&self) -> Option<&str> {
        Some(&self.provenance.as_ref()?.kernel)
    }

    /// The seed of its random numbers; None if that is not known.
    #[getter]
    fn seed(&self) -> Option<u64> {
        Some(self.provenance.as_ref()?.seed)
    }

    /// The domain of its samples, as text; None if it is a density that is not at hand.
    #[getter]
    fn domain(&self) -> Option<String> {
        Some(self.domain?.to_string())
    }

    /// Where it comes from, as its .json file says: options, version, scores, the command that makes it
    /// again; None if that is not known.
    #[getter]
    fn provenance<'py>(&self, py: Python<'py>) -> Result<Option<Bound<'py, PyDict>>, Failure> {
        self.provenance.as_ref().map(|sidecar| arguments::dictionary(py, sidecar)).transpose()
    }

    /// Its scores: those of its provenance, else measured now, through the kernel that it is made for.
    /// White noise has 1, and lower is better.
    #[getter]
    fn scores<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyDict>, Failure> {
        let recorded = self.own_sidecar(py)?.map(|sidecar| &sidecar.scores);
        if let Some(scores) = recorded.filter(|scores| !scores.is_null()).or(self.scores.get()) {
            return arguments::dictionary(py, scores);
        }
        let (tile, shape) = (self.tile(py)?, self.shape);
        let kernel = self.perceived().resolve(shape)?;
        let options = ScoreOptions { domain: self.known_domain()?, ..ScoreOptions::default() };
        let measured = running::run(py, None, None, move |_| {
            let tile = options.domain.adopt(&tile)?;
            Ok(Scores::of(&tile, &kernel.classes()[0].taps, options)?)
        })?;
        arguments::dictionary(py, self.scores.get_or_init(|| serde_json::json!(measured)))
    }

    /// SHA-256 of its .npy file, in hexadecimal.
    #[getter]
    fn digest(&self, py: Python<'_>) -> Result<String, Failure> {
        if let Some(digest) = self.digest.get() {
            return Ok(digest.clone());
        }
        let tile = self.tile(py)?;
        Ok(self.digest.get_or_init(|| sidecar::digest(&tile)).clone())
    }

    /// Writes the tile as a .npy file, and its provenance as a .json file beside it, if it is known. A
    /// tile of pictures has been rounded: its provenance is not that of the file.
    ///
    /// Files that exist stay as they are, and FileExistsError is raised, unless `force` is true.
    #[pyo3(signature = (path, *, force=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, force: bool) -> Result<(), Failure> {
        let existing = Existing::from_force(force);
        let beside = Sidecar::path_of(&path);
        if beside == path {
            let rule = format!("its provenance would be {0} as well", path.display());
            return Err(Failure::value(format!("path names the .npy file, and {rule}")));
        }
        let sidecar = self.own_sidecar(py)?.map(|sidecar| (sidecar, beside));
        write::probe([&path].into_iter().chain(sidecar.iter().map(|(_, path)| path)), existing)?;
        let tile = self.tile(py)?;
        write::write(&path, existing, |out| npy::write_tile(&tile, out))?;
        if let Some((sidecar, path)) = sidecar {
            sidecar.write(&path, existing)?;
        }
        Ok(())
    }

    fn __repr__(&self) -> String {
        let (frames, height, width, spp, dims) = self.shape();
        format!("Tile({width}x{height}x{frames}, {spp} spp, {dims} dims)")
    }
}

impl Tile {
    /// A tile, whose numbers move into the array.
    pub fn new(
        py: Python<'_>,
        tile: perceptile::Tile,
        domain: Option<Domain>,
        provenance: Option<Sidecar>,
    ) -> Self {
        let shape = tile.shape();
        let array = arguments::array(py, tile).unbind();
        let (digest, scores) = (OnceLock::new(), OnceLock::new());
        Self { array, shape, domain, provenance, digest, scores }
    }

    /// Reads a tile and its sidecar.
    pub fn read(py: Python<'_>, source: TileSource) -> Result<(perceptile::Tile, Self), Failure> {
        let tile = py.detach(|| source.read())?;
        let sidecar = py.detach(|| of_file(&source.path, tile.shape()));
        // Channels may be only some of what the sidecar is of.
        let sidecar = sidecar.filter(|sidecar| sidecar.shape == tile.shape());
        let domain = sidecar.as_ref().map_or(Some(Domain::Square), domain_of);
        Ok((tile.clone(), Self::new(py, tile, domain, sidecar)))
    }

    /// The provenance, if it is that of these very numbers.
    fn own_sidecar(&self, py: Python<'_>) -> Result<Option<&Sidecar>, Failure> {
        let Some(sidecar) = &self.provenance else { return Ok(None) };
        Ok((self.digest(py)? == sidecar.sha256).then_some(sidecar))
    }

    /// The tile as the library has it: a copy.
    pub fn tile(&self, py: Python<'_>) -> Result<perceptile::Tile, Failure> {
        let array = self.array.bind(py).try_readonly().map_err(PyErr::from)?;
        let samples = array.as_slice().map_err(PyErr::from)?.to_vec();
        Ok(perceptile::Tile::new(self.shape, samples)?)
    }

    /// The kernel through which its error is seen.
    pub fn perceived(&self) -> KernelSpec {
        let own = self.provenance.as_ref().and_then(|sidecar| sidecar.kernel.parse().ok());
        own.unwrap_or_else(|| Preset::Best.options().kernel).perceived(self.shape)
    }

    /// Where its samples live.
    pub fn known_domain(&self) -> Result<Domain, Failure> {
        let missing = "the tile's samples have a density that is not at hand: give domain";
        self.domain.ok_or_else(|| Failure::value(missing))
    }
}

/// The sidecar of a tile that was read from a path, if there is one of it.
fn of_file(path: &Path, shape: TileShape) -> Option<Sidecar> {
    let sidecar = Sidecar::read(&Sidecar::find(path)?).ok()?;
    sidecar.describes(path, shape).then_some(sidecar)
}

/// The domain that a sidecar says, if it is no density.
fn domain_of(sidecar: &Sidecar) -> Option<Domain> {
    match sidecar.options.pointer("/options/domain") {
        None => Some(Domain::Square),
        Some(domain) => domain.as_str()?.parse().ok(),
    }
}
