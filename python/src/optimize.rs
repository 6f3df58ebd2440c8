//! Making a tile.

use std::sync::Arc;
use std::time::Instant;

use perceptile::format::sidecar::{self, Sidecar};
use perceptile::gradient::simd::Simd;
use perceptile::metric::Scorer;
use perceptile::run::driver::{self, Parallel};
use perceptile::run::memory;
use perceptile::run::plan::Plan;
use perceptile::run::start::InitialState;
use perceptile::settings::{Settings, provenance};
use perceptile::solver::{Options, Parallelism, Start};
use perceptile::{ScoreOptions, TileSource};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Map;

use crate::arguments::{self, Asked};
use crate::failure::Failure;
use crate::running::{self, Watch, Watcher};
use crate::tile::Tile;

/// Makes a tile, as `perceptile optimize` does: the same settings make the same bytes.
///
/// Settings have the names of the command's flags, with `_` for `-`. `perceptile.settings` lists them
/// with their values. `tile` may also be (width, height, frames), `kernel` a Kernel, `start` a Tile or
/// an array, and `domain` an array of levels, rows and columns, for a density.
///
/// `threads` are as many as there are cores without a number, and of no influence on the tile.
/// `progress(phase, step, steps)` is called at most 20 times a second; if it returns False, the run ends
/// with the tile so far. `integrands` of each class are what the tile is scored on at the end; 0 leaves
/// scores out. An exception in `progress`, and Ctrl-C, end the run without a tile.
///
/// >>> tile = perceptile.optimize(preset="quick", tile=(8, 8, 4), steps=20, seed=7, integrands=0)
/// >>> tile.provenance["command"]
/// 'perceptile optimize --preset quick --seed 7 --steps 20 --tile 8x8x4'
#[pyfunction]
#[pyo3(signature = (*, threads=None, progress=None, integrands=256, **settings))]
pub fn optimize(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    integrands: usize,
    settings: Option<&Bound<'_, PyDict>>,
) -> Result<Tile, Failure> {
    let Asked { settings, start } = Asked::new(settings)?;
    let (options, file) = settings.options()?;
    options.validate()?;
    let scored = ScoreOptions { domain: options.domain, integrands, ..ScoreOptions::default() };
    if integrands > 0 {
        scored.validate()?;
    }
    let start = match (options.start, start, file) {
        (Start::Tile, None, Some(file)) => Some(py.detach(|| TileSource::new(file).read())?),
        (_, start, _) => start,
    };
    let domain = options.domain;
    let work = move |watch: &Arc<Watch>| make(&settings, &options, start.as_ref(), scored, watch);
    let (tile, sidecar) = running::run(py, threads, progress, work)?;
    Ok(Tile::new(py, tile, Some(domain), Some(sidecar)))
}

/// Makes and scores the tile by the threads of the current pool.
fn make(
    settings: &Settings,
    options: &Options,
    start: Option<&perceptile::Tile>,
    scored: ScoreOptions,
    watch: &Arc<Watch>,
) -> Result<(perceptile::Tile, Sidecar), Failure> {
    let plan = Plan::new(options, Parallelism::threads())?;
    memory::check(&plan)?;
    plan.check_batch()?;
    let start = InitialState::new(&plan, start)?;
    let started = Instant::now();
    let mut observer = Watcher(Arc::clone(watch));
    let output = driver::run(&plan, start, Simd::detect(), Parallel::Threads, &mut observer, None)?;
    let (tile, seconds) = (output.tile(), started.elapsed().as_secs_f64());
    let score = || -> Result<_, Failure> {
        let seen = options.kernel.perceived(options.shape).resolve(options.shape)?;
        Ok(Scorer::new(options.shape, &seen.classes()[0].taps, scored)?.score(&tile)?)
    };
    let is_scored = scored.integrands > 0 && !watch.stops();
    let scores = is_scored.then(score).transpose()?;
    let sha256 = sidecar::digest(&tile);
    let sidecar = provenance(settings, options, &output, scores.as_ref(), seconds, sha256);
    Ok((tile, sidecar))
}

/// All settings with the values that `optimize` would take, by name, as `perceptile optimize
/// --print-config` prints them.
///
/// >>> perceptile.settings(preset="quick")["steps"]
/// 500
/// >>> perceptile.settings(step=3)
/// Traceback (most recent call last):
/// TypeError: there is no setting `step`; is it `steps`?
#[pyfunction]
#[pyo3(signature = (**settings))]
pub fn settings<'py>(
    py: Python<'py>,
    settings: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyDict>, Failure> {
    let Asked { settings, .. } = Asked::new(settings)?;
    let all = settings.effective(&settings.options()?.0);
    let all: Map<_, _> =
        all.into_iter().map(|(name, value)| (name.replace('-', "_"), value)).collect();
    arguments::dictionary(py, &all)
}
