//! Scoring tiles.

use perceptile::TileShape;
use perceptile::domain::Domain;
use perceptile::metric::{Baseline, ScoreOptions, ScoredTile, UnknownBaseline};
use perceptile::settings::{Settings, SettingsError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::arguments;
use crate::failure::Failure;
use crate::running;
use crate::tile::Tile;

/// Scores a tile, as `perceptile evaluate` does: a Tile, an array or the path of a tile.
///
/// Returns the `kernel` and its `kernel_origin`, `options`, `shape`, and the scores of the tile as it is
/// (`scores`), `after_8_bits` and `after_16_bits`. White noise has 1, and lower is better. Scores are
/// comparable only for equal kernel, set and integrands.
///
/// Without a kernel or fps, taa, sigma and pixels_per_degree, it is the one that the tile is made for,
/// if that is known, else the default tile's. `domain` is the tile's, else the square.
///
/// >>> white = perceptile.baseline("white", (16, 16, 8))
/// >>> result = perceptile.evaluate(white, kernel="gaussian(2.1) @ 7x7x1", integrands=16)
/// >>> result["kernel_origin"]
/// 'from kernel'
/// >>> 0.5 < result["scores"]["classes"][0]["perceived"]["mean"] < 2
/// True
#[pyfunction]
#[pyo3(signature = (
    tile, *, kernel=None, fps=None, taa=None, sigma=None, pixels_per_degree=None, domain=None,
    integrands=256, set=0, threads=None
))]
#[allow(clippy::too_many_arguments, reason = "they are Python's, by name")]
pub fn evaluate<'py>(
    py: Python<'py>,
    tile: &Bound<'py, PyAny>,
    kernel: Option<&Bound<'py, PyAny>>,
    fps: Option<f64>,
    taa: Option<f64>,
    sigma: Option<f64>,
    pixels_per_degree: Option<f64>,
    domain: Option<&Bound<'py, PyAny>>,
    integrands: usize,
    set: u64,
    threads: Option<usize>,
) -> Result<Bound<'py, PyDict>, Failure> {
    let viewing = arguments::viewing(fps, taa, sigma, pixels_per_degree);
    let kernel = kernel.map(arguments::kernel).transpose()?;
    viewing.refuse_beside(kernel.as_ref(), "kernel")?;
    let domain = domain.map(arguments::domain).transpose()?;
    let (samples, own) = arguments::tile(tile)?;
    let own = match own {
        Some(own) => own,
        None => Bound::new(py, Tile::new(py, samples.clone(), Some(Domain::Square), None))?,
    };
    let (own, shape) = (own.get(), samples.shape());
    let (kernel, origin) = match kernel {
        Some(kernel) => (kernel, "from kernel".to_owned()),
        None if viewing.is_given() => {
            let typed = viewing.typed().replace("--", "").replace('-', "_");
            (viewing.perceived(shape)?, format!("from {typed}"))
        }
        None if own.provenance.is_some() => (own.perceived(), "from the provenance".to_owned()),
        None => (own.perceived(), "the default".to_owned()),
    };
    let domain = domain.map_or_else(|| own.known_domain(), Ok)?;
    let options = ScoreOptions { domain, set, integrands };
    options.validate()?;
    let text = kernel.to_string();
    let scored = running::run(py, threads, None, move |_| {
        // As far as rounding left it.
        let samples = domain.adopt(&samples)?;
        let kernel = kernel.resolve(shape)?;
        let taps = &kernel.classes()[0].taps;
        Ok(ScoredTile::of("tile".into(), None, &samples, taps, options, false, || ())?)
    })?;
    let ScoredTile { shape, scores, after_8_bits, after_16_bits, .. } = scored;
    let result = json!({
        "kernel": text,
        "kernel_origin": origin,
        "options": options,
        "shape": shape,
        "scores": scores,
        "after_8_bits": after_8_bits,
        "after_16_bits": after_16_bits,
    });
    arguments::dictionary(py, &result)
}

/// A tile to compare with: "white" noise, or "sobol", an Owen-scrambled Sobol' sequence in each pixel.
///
/// `tile` is (width, height, frames) or "WxHxF".
///
/// >>> perceptile.baseline("sobol", "8x8x4", spp=4)
/// Tile(8x8x4, 4 spp, 2 dims)
#[pyfunction]
#[pyo3(signature = (name, tile, *, spp=1, dims=None, domain=None, seed=1))]
pub fn baseline(
    py: Python<'_>,
    name: &str,
    tile: &Bound<'_, PyAny>,
    spp: usize,
    dims: Option<usize>,
    domain: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> Result<Tile, Failure> {
    let wrong = |problem| SettingsError::Value { flag: "name".into(), text: name.into(), problem };
    let baseline: Baseline =
        name.parse().map_err(|error: UnknownBaseline| wrong(error.to_string()))?;
    let mut settings = Settings::default();
    settings.put("tile", &arguments::size(tile)?)?;
    let domain = domain.map_or(Ok(Domain::Square), arguments::domain)?;
    let dims = dims.or(domain.dims()).unwrap_or(2);
    domain.check(dims)?;
    let shape: TileShape = settings.tile.expect("it was put").shape(spp, dims)?;
    let samples = py.detach(|| baseline.tile_of(domain, shape, seed));
    Ok(Tile::new(py, samples, Some(domain), None))
}
