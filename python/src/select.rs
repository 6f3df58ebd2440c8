//! Choosing among renders.

use std::collections::BTreeMap;
use std::sync::Arc;

use numpy::ndarray::{ArrayD, ArrayViewD, Axis, Dimension, IxDyn};
use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use perceptile::gradient::simd::Simd;
use perceptile::kernel::{KernelSpec, Viewing};
use perceptile::run::memory;
use perceptile::select::{
    AnimationShape, Candidates, Continuation, Filters, Frame, Norm, SelectOptions,
    SelectParallelism, SelectPlan, SelectScores,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::arguments;
use crate::failure::Failure;
use crate::running::{self, Watch};

/// What was chosen among renders.
#[pyclass(frozen, module = "perceptile")]
pub struct Selection {
    array: Py<PyArrayDyn<f32>>,
    scores: SelectScores,
    chosen: BTreeMap<String, u64>,
}

#[pymethods]
impl Selection {
    /// The animation: float32, in the shape of the candidates.
    #[getter]
    fn array<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f32>> {
        self.array.bind(py).clone()
    }

    /// Perceived error (pRelMSE) of the selection, the mean of all renders and each of them.
    #[getter]
    fn scores<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyDict>, Failure> {
        arguments::dictionary(py, &self.scores)
    }

    /// In how many pixels each candidate was chosen.
    #[getter]
    fn chosen<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyDict>, Failure> {
        arguments::dictionary(py, &json!(self.chosen))
    }
}

/// Chooses among renders of an animation, for every pixel and frame, as `perceptile select` does.
///
/// `candidates` are arrays of floats, (frames, height, width) or with 1 or 3 channels behind it. The true
/// animation is `reference`; a stand-in for it, such as the denoised mean of the renders, is `guide`.
/// With `subsets` the means of all non-empty subsets of the renders are candidates. All other arguments
/// are those of the command. Everything is held in memory.
///
/// >>> import numpy as np
/// >>> random = np.random.default_rng(1)
/// >>> reference = np.full((4, 12, 12), 0.5, np.float32)
/// >>> renders = [reference + random.normal(0, 0.1, reference.shape) for _ in range(4)]
/// >>> best = perceptile.select(renders, reference=reference, subsets=True)
/// >>> best.array.shape, sum(best.chosen.values())
/// ((4, 12, 12), 576)
/// >>> best.scores["selection"]["plain"] < 0.1 * best.scores["mean"]["plain"]
/// True
#[pyfunction]
#[pyo3(signature = (
    candidates, *, reference=None, guide=None, subsets=false, kernel=None, fps=None, sigma=None,
    pixels_per_degree=None, taa=None, norm="L2", sweeps=12, continuation=None, threads=None,
    progress=None
))]
#[allow(clippy::too_many_arguments, reason = "they are Python's, by name")]
pub fn select(
    py: Python<'_>,
    candidates: Vec<Bound<'_, PyAny>>,
    reference: Option<&Bound<'_, PyAny>>,
    guide: Option<&Bound<'_, PyAny>>,
    subsets: bool,
    kernel: Option<&Bound<'_, PyAny>>,
    fps: Option<f64>,
    sigma: Option<f64>,
    pixels_per_degree: Option<f64>,
    taa: Option<f64>,
    norm: &str,
    sweeps: u32,
    continuation: Option<&str>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> Result<Selection, Failure> {
    let picture = match (reference, guide) {
        (Some(picture), None) | (None, Some(picture)) => picture,
        _ => return Err(Failure::value("either reference or guide must be given")),
    };
    let kernel = kernel.map(arguments::kernel).transpose()?;
    let viewing = arguments::viewing(fps, None, sigma, pixels_per_degree);
    viewing.refuse_beside(kernel.as_ref(), "kernel")?;
    let eye = eye(kernel.as_ref(), viewing.viewing()?)?;
    let norm = match norm {
        "L1" => Norm::L1,
        "L2" => Norm::L2,
        other => {
            return Err(Failure::value(format!(
                "invalid value '{other}' for norm: there are: L1, L2"
            )));
        }
    };
    let continuation = continuation.map(|text| {
        let wrong = |problem| format!("invalid value '{text}' for continuation: {problem}");
        text.parse().map_err(|problem| Failure::value(wrong(problem)))
    });
    let suited = Continuation::suited(guide.is_some(), subsets);
    let continuation = continuation.transpose()?.unwrap_or(suited);
    let options = SelectOptions { norm, sweeps, continuation };
    let guide = arguments::floats::<f32>(picture, "float32")?;
    let renders = candidates.iter().map(|render| arguments::floats::<f32>(render, "float32"));
    let renders: Vec<PyReadonlyArrayDyn<'_, f32>> = renders.collect::<Result<_, _>>()?;
    let size = guide.shape().to_vec();
    if let Some((i, other)) = renders.iter().enumerate().find(|(_, it)| it.shape() != size) {
        let (found, expected) = (other.shape(), size);
        return Err(Failure::value(format!(
            "candidate {i} has the shape {found:?}, but it must be {expected:?}, as the other's"
        )));
    }
    let shape = shape(&size)?;
    let filters = Filters::new(eye.resolve_without_tile()?.classes()[0].taps.clone(), taa)?;
    let candidates = Candidates { renders: renders.len(), subsets, half: false };
    // The threads of the pool are known once it is there, and of no influence.
    let parallelism = SelectParallelism { ranks: 1, workers: 0, threads: 1 };
    let plan = SelectPlan::new(shape, filters, candidates, options, parallelism)?;
    memory::check_bytes(plan.foreseen()?.0 as u64)?;
    let owned = |array: &PyReadonlyArrayDyn<'_, f32>| array.as_array().to_owned();
    let pictures: Vec<ArrayD<f32>> = [&guide].into_iter().chain(&renders).map(owned).collect();
    let work = move |watch: &Arc<Watch>| choose(&plan, &pictures, watch);
    let Outcome { samples, scores, chosen } = running::run(py, threads, progress, work)?;
    let array = ArrayD::from_shape_vec(IxDyn(&size), samples).expect("as many as the shape has");
    Ok(Selection { array: PyArrayDyn::from_owned_array(py, array).unbind(), scores, chosen })
}

/// The eye's filter.
fn eye(kernel: Option<&KernelSpec>, viewing: Viewing) -> Result<KernelSpec, Failure> {
    match kernel {
        None => Ok(viewing.of_pictures()?),
        Some(kernel) if kernel.taa().is_some() => {
            Err(Failure::value("leave ema out of kernel: taa says the renderer's filter"))
        }
        Some(kernel) => Ok(kernel.first()),
    }
}

/// The shape of an animation, from that of its array.
fn shape(size: &[usize]) -> Result<AnimationShape, Failure> {
    let (frames, height, width, channels) = match *size {
        [frames, height, width] => (frames, height, width, 1),
        [frames, height, width, channels] => (frames, height, width, channels),
        _ => {
            let rule = "an animation has 3, (frames, height, width), or channels as a fourth";
            return Err(Failure::value(format!("the array has {} axes, but {rule}", size.len())));
        }
    };
    Ok(AnimationShape::new(width, height, frames, channels)?)
}

/// What comes of a selection.
struct Outcome {
    /// The animation, in C order.
    samples: Vec<f32>,
    scores: SelectScores,
    chosen: BTreeMap<String, u64>,
}

/// Selects by the threads of the current pool: the pictures are the guide and the renders.
fn choose(plan: &SelectPlan, pictures: &[ArrayD<f32>], watch: &Watch) -> Result<Outcome, Failure> {
    let shape = plan.shape();
    let plan = plan.clone().with_threads(rayon::current_num_threads());
    let mut selection = perceptile::select::Selection::new(&plan, Simd::detect())?;
    let mut samples = Vec::with_capacity(shape.frames() * shape.values());
    loop {
        for frame in selection.needed() {
            let mut planes =
                pictures.iter().enumerate().map(|(i, picture)| planes(picture, frame, i));
            let guide = planes.next().expect("the guide comes first")?;
            let renders = planes.collect::<Result<_, _>>()?;
            selection.load(&Frame { guide, renders });
        }
        let mut done = None;
        let goes_on = selection.advance(|frame, picture, _| {
            done = Some(frame);
            // Channel by channel there, pixel by pixel here.
            let pixels = 0..shape.pixels();
            let of_pixel = |pixel| picture[pixel..].iter().step_by(shape.pixels());
            samples.extend(pixels.flat_map(of_pixel));
        });
        if let Some(frame) = done {
            watch.report("select", frame as u64 + 1, shape.frames() as u64);
        }
        if !goes_on {
            let (scores, chosen) = (selection.scores(), selection.chosen().collect());
            return Ok(Outcome { samples, scores, chosen });
        }
        if watch.stops() {
            return Err(Failure::run("the selection was stopped, so there is none"));
        }
    }
}

/// A frame of an animation, channel by channel; number 0 is the guide, others are renders.
fn planes(animation: &ArrayD<f32>, frame: usize, number: usize) -> Result<Vec<f32>, Failure> {
    /// Beyond it, sums of squares are none.
    const MOST: f32 = 1e12;
    let frame_of: ArrayViewD<'_, f32> = animation.index_axis(Axis(0), frame);
    if let Some((at, value)) =
        frame_of.indexed_iter().find(|(_, value)| !value.is_finite() || value.abs() > MOST)
    {
        let what = match number {
            0 => "the reference or guide".to_owned(),
            n => format!("candidate {}", n - 1),
        };
        let rule = "values must be finite and at most 1e12";
        let at = at.slice();
        return Err(Failure::value(format!(
            "frame {frame} of {what} has {value} at {at:?}, but {rule}"
        )));
    }
    match frame_of.ndim() {
        2 => Ok(frame_of.iter().copied().collect()),
        _ => Ok(frame_of.axis_iter(Axis(2)).flat_map(|channel| channel.to_owned()).collect()),
    }
}
