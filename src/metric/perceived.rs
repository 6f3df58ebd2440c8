//! The error that remains visible through a kernel.
//!
//! The perceived error at a pixel is (g*e) there, the error image filtered by the kernel in space
//! and time, toroidally. Its mean square over the tile needs no filtered image: by Parseval it is
//! Σ |ĝ|²|ê|² over the frequencies, and |ĝ|² is computed once for a tile's shape.

use super::fourier::{FieldTransform, Workspace};
use super::scores::ScoreError;
use crate::kernel::KernelTaps;
use crate::tile::TileShape;

/// Mean squares of filtered error images of one shape, for one kernel.
///
/// Images are transformed in `f32`, with sums in `f64`: a mean square is off by less than 10⁻⁶ of
/// itself, or 10⁻¹³ of the unfiltered one if the kernel leaves next to nothing.
pub struct Perceived {
    shape: TileShape,
    plan: FieldTransform<f32>,
    /// |ĝ|² in the order of the transform, times how often the frequency stands for another,
    /// divided by pixels².
    weights: Vec<f32>,
    squares: f64,
    still_squares: f64,
}

/// What one image needs while it is measured.
pub struct PerceivedWorkspace(Workspace<f32>);

/// The filtered mean squares of one error image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanSquares {
    /// Mean over all pixels and frames of (g*e)².
    pub perceived: f64,
    /// The same with each pixel's error replaced by its mean over all frames: what is left to see
    /// when a still picture has accumulated over a whole period.
    pub accumulated: f64,
}

impl Perceived {
    /// Prepares a kernel for tiles of a shape.
    ///
    /// # Errors
    /// [`ScoreError::Kernel`] if the kernel is wider than the tile: it would meet itself.
    pub fn new(shape: TileShape, kernel: &KernelTaps) -> Result<Self, ScoreError> {
        let (width, height, frames) = (shape.width(), shape.height(), shape.frames());
        let (low, high) = kernel.bounds();
        for (axis, low, high, size) in [
            ("x", low.x, high.x, width),
            ("y", low.y, high.y, height),
            ("t", low.z, high.z, frames),
        ] {
            let extent = i64::from(high) - i64::from(low) + 1;
            if extent > size as i64 {
                return Err(ScoreError::Kernel { axis, extent, size });
            }
        }
        let mut image = vec![0.0_f64; shape.pixels()];
        let mut still = vec![0.0_f64; width * height];
        for tap in kernel.taps() {
            let wrap =
                |offset: i32, size: usize| i64::from(offset).rem_euclid(size as i64) as usize;
            let (x, y) = (wrap(tap.offset.x, width), wrap(tap.offset.y, height));
            image[shape.pixel(x, y, wrap(tap.offset.z, frames))] = tap.weight;
            still[y * width + x] += tap.weight;
        }
        let sum_of_squares = |image: &[f64]| image.iter().map(|g| g * g).sum::<f64>();
        let (squares, still_squares) = (sum_of_squares(&image), sum_of_squares(&still));

        let exact = FieldTransform::<f64>::new(width, height, frames);
        let mut workspace = exact.workspace();
        exact.transform(&mut image, &mut workspace);
        let pixels = shape.pixels() as f64;
        let weights = workspace
            .spectrum
            .chunks_exact(height * frames)
            .enumerate()
            .flat_map(|(kx, column)| {
                let factor = exact.multiplicity(kx) / (pixels * pixels);
                column.iter().map(move |g| (g.norm_sqr() * factor) as f32)
            })
            .collect();
        let plan = FieldTransform::new(width, height, frames);
        Ok(Self { shape, plan, weights, squares, still_squares })
    }

    /// The shape of the error images.
    pub fn shape(&self) -> TileShape {
        self.shape
    }

    /// Σg², the perceived mean square of white noise of variance 1.
    pub fn squares(&self) -> f64 {
        self.squares
    }

    /// Σ over (x, y) of (Σ over t of g)²: the accumulated mean square of white noise, times the
    /// number of frames. 0 for a kernel that sees no still picture.
    pub fn still_squares(&self) -> f64 {
        self.still_squares
    }

    /// A workspace for [`Self::mean_squares`].
    pub fn workspace(&self) -> PerceivedWorkspace {
        PerceivedWorkspace(self.plan.workspace())
    }

    /// Mean squares of the filtered `errors`, one per pixel in C order; they are overwritten.
    ///
    /// # Panics
    /// If their number is not the shape's, or the workspace is of another shape.
    pub fn mean_squares(
        &self,
        errors: &mut [f32],
        workspace: &mut PerceivedWorkspace,
    ) -> MeanSquares {
        self.plan.transform(errors, &mut workspace.0);
        let frames = self.shape.frames();
        let (mut perceived, mut accumulated) = (0.0, 0.0);
        for (spectrum, weights) in
            workspace.0.spectrum.chunks_exact(frames).zip(self.weights.chunks_exact(frames))
        {
            let energy = |k: usize| f64::from(spectrum[k].norm_sqr()) * f64::from(weights[k]);
            let still = energy(0);
            accumulated += still;
            perceived += still + (1..frames).map(energy).sum::<f64>();
        }
        MeanSquares { perceived, accumulated }
    }
}
