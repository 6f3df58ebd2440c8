//! Python's values as settings, kernels and tiles, and JSON as Python's dictionaries.

use std::path::PathBuf;

use numpy::ndarray::Array5;
use numpy::{PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use perceptile::domain::{Density, Domain, DomainSpec};
use perceptile::kernel::KernelSpec;
use perceptile::settings::{Settings, SettingsError, ViewingSettings};
use perceptile::{TileShape, TileSource};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySequence, PyString};

use crate::failure::Failure;
use crate::kernel::Kernel;
use crate::tile::Tile;

/// What arrays are called where the command has the path of a file.
const ARRAY: &str = "array";

/// What was asked for: settings, and the tile to start from if it is no file.
pub struct Asked {
    /// The settings.
    pub settings: Settings,
    /// The tile.
    pub start: Option<perceptile::Tile>,
}

impl Asked {
    /// Reads keyword arguments; None leaves a setting as the preset has it.
    pub fn new(arguments: Option<&Bound<'_, PyDict>>) -> Result<Self, Failure> {
        let mut asked = Self { settings: Settings::default(), start: None };
        for (name, value) in arguments.into_iter().flatten() {
            let name: String = name.extract()?;
            if !value.is_none() {
                asked.put(&name, &value).map_err(|failure| nearest(value.py(), &name, failure))?;
            }
        }
        Ok(asked)
    }

    fn put(&mut self, name: &str, value: &Bound<'_, PyAny>) -> Result<(), Failure> {
        let text = match name {
            "tile" => size(value)?,
            "kernel" => kernel(value)?.to_string(),
            "domain" if !value.is_instance_of::<PyString>() => {
                self.settings.domain = Some(density(value)?.into());
                return Ok(());
            }
            "start" => match path(value)? {
                Some(path) => path.display().to_string(),
                None => {
                    self.start = Some(tile(value)?.0);
                    ARRAY.to_owned()
                }
            },
            _ => value.str()?.to_string(),
        };
        Ok(self.settings.put(name, &text)?)
    }
}

/// The same failure; of a name that nobody knows, with one that is like it.
fn nearest(py: Python<'_>, name: &str, failure: Failure) -> Failure {
    if Settings::names().any(|known| known == name) {
        return failure;
    }
    let like = || -> PyResult<Option<String>> {
        let names: Vec<&str> = Settings::names().collect();
        let matches = py.import("difflib")?.call_method1("get_close_matches", (name, names))?;
        Ok(matches.extract::<Vec<String>>()?.into_iter().next())
    };
    let unknown = SettingsError::Unknown { name: name.to_owned() };
    match like() {
        Ok(Some(like)) => PyTypeError::new_err(format!("{unknown}; is it `{like}`?")).into(),
        Ok(None) => PyTypeError::new_err(unknown.to_string()).into(),
        Err(error) => error.into(),
    }
}

/// The size of a tile as text: of (width, height, frames), or of text.
pub fn size(value: &Bound<'_, PyAny>) -> Result<String, Failure> {
    if value.is_instance_of::<PyString>() {
        return Ok(value.extract::<String>()?);
    }
    let sizes = value.cast::<PySequence>().map_err(PyErr::from)?;
    let sizes: Vec<String> =
        sizes.try_iter()?.map(|it| Ok(it?.str()?.to_string())).collect::<PyResult<_>>()?;
    Ok(sizes.join("x"))
}

/// A kernel, or the one of a text.
pub fn kernel(value: &Bound<'_, PyAny>) -> Result<KernelSpec, Failure> {
    if let Ok(kernel) = value.cast::<Kernel>() {
        return Ok(kernel.get().spec.clone());
    }
    let mut settings = Settings::default();
    settings.put("kernel", &value.extract::<String>()?)?;
    Ok(settings.kernel.expect("it was put"))
}

/// How the animation is watched.
pub fn viewing(
    fps: Option<f64>,
    taa: Option<f64>,
    sigma: Option<f64>,
    pixels_per_degree: Option<f64>,
) -> ViewingSettings {
    ViewingSettings { fps, taa, sigma, pixels_per_degree }
}

/// A domain by its name, or a density of levels.
pub fn domain(value: &Bound<'_, PyAny>) -> Result<Domain, Failure> {
    if !value.is_instance_of::<PyString>() {
        return density(value);
    }
    let mut settings = Settings::default();
    settings.put("domain", &value.extract::<String>()?)?;
    let spec = settings.domain.as_ref().map(DomainSpec::resolve).transpose();
    Ok(spec.map_err(SettingsError::from)?.expect("it was put"))
}

/// A density of an array of levels, rows and columns.
fn density(value: &Bound<'_, PyAny>) -> Result<Domain, Failure> {
    let levels = floats::<f64>(value, "float64")?;
    let &[height, width] = levels.shape() else {
        let axes = levels.shape().len();
        let rule = "a density has 2: rows and columns";
        return Err(Failure::value(format!("the levels have {axes} axes, but {rule}")));
    };
    let levels = levels.as_slice().map_err(PyErr::from)?;
    Ok(Domain::Density(Density::new(ARRAY, [width, height], levels)?))
}

/// The path that a text or an object of paths is; None for anything else.
pub fn path(value: &Bound<'_, PyAny>) -> Result<Option<PathBuf>, Failure> {
    let is_path = value.is_instance_of::<PyString>() || value.hasattr("__fspath__")?;
    Ok(if is_path { Some(value.extract()?) } else { None })
}

/// A tile, and the one of Python that it is if it is one: of a path, of an array, or as it is.
pub fn tile<'py>(
    value: &Bound<'py, PyAny>,
) -> Result<(perceptile::Tile, Option<Bound<'py, Tile>>), Failure> {
    if let Ok(tile) = value.cast::<Tile>() {
        return Ok((tile.get().tile(value.py())?, Some(tile.clone())));
    }
    if let Some(path) = path(value)? {
        let (tile, own) = Tile::read(value.py(), TileSource::new(path))?;
        return Ok((tile, Some(Bound::new(value.py(), own)?)));
    }
    let array = floats::<f32>(value, "float32")?;
    let (frames, height, width, spp, dims) = match *array.shape() {
        [frames, height, width, spp, dims] => (frames, height, width, spp, dims),
        [frames, height, width, dims] => (frames, height, width, 1, dims),
        ref other => {
            let rule = "a tile has 5: (frames, height, width, spp, dims)";
            return Err(Failure::value(format!("the array has {} axes, but {rule}", other.len())));
        }
    };
    let shape = TileShape::new(width, height, frames, spp, dims)?;
    let samples = array.as_slice().map_err(PyErr::from)?.to_vec();
    Ok((perceptile::Tile::new(shape, samples)?, None))
}

/// An array of floats in C order, which is copied only if it is another kind of array.
pub fn floats<'py, T: numpy::Element>(
    value: &Bound<'py, PyAny>,
    kind: &str,
) -> Result<PyReadonlyArrayDyn<'py, T>, Failure> {
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value,))?;
    let given: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    if kind == "float32" && given != "f" {
        let dtype = array.getattr("dtype")?.str()?;
        return Err(Failure::value(format!("the array is of {dtype}, but must be of floats")));
    }
    let array = numpy.call_method1("ascontiguousarray", (array, kind))?;
    let array = array.cast_into::<PyArrayDyn<T>>().map_err(PyErr::from)?;
    Ok(array.try_readonly().map_err(PyErr::from)?)
}

/// The array of a tile, to which its numbers move; nobody can write to it.
pub fn array(py: Python<'_>, tile: perceptile::Tile) -> Bound<'_, numpy::PyArray5<f32>> {
    let shape = tile.shape();
    let size = (shape.frames(), shape.height(), shape.width(), shape.spp(), shape.dims());
    let array =
        Array5::from_shape_vec(size, tile.into_samples()).expect("as many as the shape has");
    let array = numpy::PyArray5::from_owned_array(py, array);
    array.readwrite().make_nonwriteable();
    array
}

/// A dictionary of Python from what is one in JSON.
pub fn dictionary<'py>(
    py: Python<'py>,
    json: &impl serde::Serialize,
) -> Result<Bound<'py, PyDict>, Failure> {
    let text = serde_json::to_string(json).map_err(|error| Failure::run(error.to_string()))?;
    let value = py.import("json")?.call_method1("loads", (text,))?;
    Ok(value.cast_into::<PyDict>().map_err(PyErr::from)?)
}
