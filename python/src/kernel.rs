//! Kernels as Python sees them.

use std::hash::{DefaultHasher, Hash, Hasher};

use numpy::ndarray::Array3;
use numpy::{PyArray3, PyArrayMethods};
use perceptile::kernel::{KernelSpec, KernelTaps, ResolveProblem};
use perceptile::settings::Settings;
use perceptile::solver::Preset;
use perceptile::tile::TileShape;
use pyo3::prelude::*;

use crate::arguments;
use crate::failure::Failure;

/// A filter through which error is seen, from its text or from how the animation is watched.
///
/// `spec` is what `perceptile kernel` takes; without it the kernel is the mixture that `optimize` makes
/// a tile with for `fps`, `taa`, `sigma` and `pixels_per_degree`. `tile` is the size of the tile as
/// (width, height, frames) or "WxHxF", which `column` and `frame` need, and in which a longer kernel
/// wraps in time.
///
/// >>> kernel = perceptile.Kernel("gaussian(2.1) * ema(0.2) @ 7x7x15")
/// >>> kernel.taps.shape
/// (15, 7, 7)
/// >>> kernel.origin
/// (14, 3, 3)
/// >>> print(perceptile.Kernel(fps=120, taa=0.1))
/// 0.84: gaussian(2.1) * fovvideovdp(120) * ema(0.1) @ 7x7x16 + 0.06: column + 0.1: box(8)
#[pyclass(frozen, module = "perceptile")]
#[derive(Debug, Clone)]
pub struct Kernel {
    /// What it says.
    pub spec: KernelSpec,
    shape: Option<TileShape>,
}

#[pymethods]
impl Kernel {
    #[new]
    #[pyo3(signature = (spec=None, *, tile=None, fps=None, taa=None, sigma=None, pixels_per_degree=None))]
    fn new(
        spec: Option<&Bound<'_, PyAny>>,
        tile: Option<&Bound<'_, PyAny>>,
        fps: Option<f64>,
        taa: Option<f64>,
        sigma: Option<f64>,
        pixels_per_degree: Option<f64>,
    ) -> Result<Self, Failure> {
        let mut settings = Settings::default();
        if let Some(tile) = tile {
            settings.put("tile", &arguments::size(tile)?)?;
        }
        let shape = settings.tile.map(|size| size.shape(1, 1)).transpose()?;
        let viewing = arguments::viewing(fps, taa, sigma, pixels_per_degree);
        let spec = spec.map(arguments::kernel).transpose()?;
        viewing.refuse_beside(spec.as_ref(), "spec")?;
        let default = Preset::Best.options().shape;
        match spec {
            Some(spec) => Ok(Self { spec, shape }),
            None => {
                let shape = shape.unwrap_or(default);
                Ok(Self { spec: viewing.kernel(shape)?, shape: Some(shape) })
            }
        }
    }

    /// Its text, as settings and files have it.
    #[getter]
    fn text(&self) -> String {
        self.spec.to_string()
    }

    /// The weights, float64 (frames, height, width), newest frame last; of a mixture, those of its first
    /// term.
    #[getter]
    fn taps<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray3<f64>>, Failure> {
        let taps = self.first()?;
        let (low, size) = bounds(&taps);
        let mut weights = Array3::zeros(size);
        for tap in taps.taps() {
            let at = [tap.offset.z, tap.offset.y, tap.offset.x];
            let at: [usize; 3] = std::array::from_fn(|i| (at[i] - low[i]) as usize);
            weights[at] = tap.weight;
        }
        let array = PyArray3::from_owned_array(py, weights);
        array.readwrite().make_nonwriteable();
        Ok(array)
    }

    /// Where in `taps` the pixel itself is: (frame, row, column).
    #[getter]
    fn origin(&self) -> Result<(usize, usize, usize), Failure> {
        let [t, y, x] = bounds(&self.first()?).0.map(|low| -low as usize);
        Ok((t, y, x))
    }

    fn __str__(&self) -> String {
        self.text()
    }

    fn __repr__(&self) -> String {
        format!("Kernel({:?})", self.text())
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.spec == other.spec
    }

    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.text().hash(&mut hasher);
        hasher.finish()
    }
}

impl Kernel {
    /// The taps of the first term.
    fn first(&self) -> Result<KernelTaps, Failure> {
        let first = self.spec.first();
        let kernel = match self.shape {
            Some(shape) => first.resolve(shape)?,
            None => first.resolve_without_tile().map_err(|error| {
                let needs_tile = error.problem == ResolveProblem::NeedsTile;
                let explained = needs_tile.then(|| Failure::value(format!("give tile: {error}")));
                explained.unwrap_or_else(|| error.into())
            })?,
        };
        Ok(kernel.classes()[0].taps.clone())
    }
}

/// The first place (t, y, x) of a box that holds all taps and the origin, and its size.
fn bounds(taps: &KernelTaps) -> ([i32; 3], [usize; 3]) {
    let (low, high) = taps.bounds();
    let low = [low.z, low.y, low.x].map(|low| low.min(0));
    let high = [high.z, high.y, high.x].map(|high| high.max(0));
    (low, std::array::from_fn(|i| (high[i] - low[i] + 1) as usize))
}
