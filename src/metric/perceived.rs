//! The error that remains visible through a kernel.
//!
//! The perceived error at a pixel is (g*e) there, the error image filtered by the kernel in space
//! and time, toroidally. Its mean square over the tile needs no filtered image: by Parseval it is
//! Σ |ĝ|²|ê|² over the frequencies, and |ĝ|² is computed once for a tile's shape.

use super::error::ScoreError;
use super::fourier::{FieldTransform, FourierWorkspace};
use crate::kernel::KernelTaps;
use crate::tile::TileShape;

/// Mean squares of filtered error images of one shape, for one kernel.
///
/// Images are transformed in `f32`, with sums in `f64`: the root of a mean square is off by less
/// than 10⁻⁶ of the root of the unfiltered one, at worst. The errors of single frequencies are
/// independent, so that of a whole tile is far smaller.
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
pub struct PerceivedWorkspace(FourierWorkspace<f32>);

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
    /// Prepares a kernel for tiles of a shape. Where it is longer than the tile it meets itself in
    /// time, as it does in a renderer that repeats the tile; white noise is not repeated.
    ///
    /// # Errors
    /// [`ScoreError::Kernel`] if the kernel is wider than the tile in pixels.
    pub fn new(shape: TileShape, kernel: &KernelTaps) -> Result<Self, ScoreError> {
        let (width, height, frames) = (shape.width(), shape.height(), shape.frames());
        let (low, high) = kernel.bounds();
        for (axis, low, high, size) in [("x", low.x, high.x, width), ("y", low.y, high.y, height)] {
            let extent = i64::from(high) - i64::from(low) + 1;
            if extent > size as i64 {
                return Err(ScoreError::Kernel { axis, extent, size });
            }
        }
        let (mut image, mut squared) = (vec![0.0_f64; shape.pixels()], vec![0.0; shape.pixels()]);
        let mut still = vec![0.0_f64; width * height];
        for tap in kernel.taps() {
            let wrap =
                |offset: i32, size: usize| i64::from(offset).rem_euclid(size as i64) as usize;
            let (x, y) = (wrap(tap.offset.x, width), wrap(tap.offset.y, height));
            let pixel = shape.pixel(x, y, wrap(tap.offset.z, frames));
            image[pixel] += tap.weight;
            squared[pixel] += tap.weight * tap.weight;
            still[y * width + x] += tap.weight;
        }
        let squares = squared.iter().sum();
        let still_squares = still.iter().map(|g| g * g).sum();

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

    /// Σg², the perceived mean square of white noise of variance 1 that is new in every frame.
    pub fn squares(&self) -> f64 {
        self.squares
    }

    /// Σ over (x, y) of (Σ over t of g)²: the accumulated mean square of white noise, times the
    /// number of frames. Practically 0 for a kernel that sees no still picture.
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

#[cfg(test)]
mod tests {
    use glam::IVec3;
    use proptest::prelude::*;

    use super::super::split_mix::SplitMix;
    use super::*;
    use crate::kernel::Tap;

    /// Mean squares by the definition: every pixel, every tap.
    fn by_convolution(shape: TileShape, kernel: &KernelTaps, errors: &[f32]) -> MeanSquares {
        let (width, height, frames) = (shape.width(), shape.height(), shape.frames());
        let wrap = |at: usize, offset: i32, size: usize| {
            (at as i64 + i64::from(offset)).rem_euclid(size as i64) as usize
        };
        let filtered = |image: &dyn Fn(usize, usize, usize) -> f64| {
            let mut total = 0.0;
            for t in 0..frames {
                for y in 0..height {
                    for x in 0..width {
                        let seen: f64 = kernel
                            .taps()
                            .iter()
                            .map(|Tap { offset, weight }| {
                                let x = wrap(x, offset.x, width);
                                let y = wrap(y, offset.y, height);
                                weight * image(x, y, wrap(t, offset.z, frames))
                            })
                            .sum();
                        total += seen * seen;
                    }
                }
            }
            total / shape.pixels() as f64
        };
        let error = |x, y, t| f64::from(errors[shape.pixel(x, y, t)]);
        MeanSquares {
            perceived: filtered(&error),
            accumulated: filtered(&|x, y, _| {
                (0..frames).map(|t| error(x, y, t)).sum::<f64>() / frames as f64
            }),
        }
    }

    fn random_kernel(stream: &mut SplitMix, size: [usize; 3]) -> KernelTaps {
        let mut taps = Vec::new();
        for z in 0..size[2] as i32 {
            for y in 0..size[1] as i32 {
                for x in 0..size[0] as i32 {
                    // Causal in time, around the pixel in space, of both signs.
                    let offset = IVec3::new(x - size[0] as i32 / 2, y - 1, -z);
                    taps.push(Tap { offset, weight: stream.range(-1.0, 1.0) });
                }
            }
        }
        KernelTaps::new(taps).unwrap()
    }

    /// Whether roots agree to 10⁻⁶ of the unfiltered errors' (√⅓).
    fn close(found: f64, expected: f64) -> bool {
        (found.sqrt() - expected.sqrt()).abs() < 0.57e-6
    }

    proptest! {
        #[test]
        fn parseval_agrees_with_the_convolution(
            seed: u64,
            width in 1_usize..9, height in 1_usize..8, frames in 1_usize..7,
            kernel in [1_usize..=9, 1_usize..=8, 1_usize..=20],
        ) {
            let shape = TileShape::new(width, height, frames, 1, 1).unwrap();
            let mut stream = SplitMix::new(&[seed]);
            let size = [kernel[0].min(width), kernel[1].min(height), kernel[2]];
            let taps = random_kernel(&mut stream, size);
            let errors: Vec<f32> =
                (0..shape.pixels()).map(|_| stream.range(-1.0, 1.0) as f32).collect();
            let perceived = Perceived::new(shape, &taps).unwrap();
            let mut workspace = perceived.workspace();
            let found = perceived.mean_squares(&mut errors.clone(), &mut workspace);
            let expected = by_convolution(shape, &taps, &errors);
            prop_assert!(close(found.perceived, expected.perceived), "{found:?} {expected:?}");
            prop_assert!(close(found.accumulated, expected.accumulated));
            // The workspace holds nothing that matters to the next image.
            let again = perceived.mean_squares(&mut errors.clone(), &mut workspace);
            prop_assert_eq!(found, again);
            let squares: f64 = taps.taps().iter().map(|tap| tap.weight * tap.weight).sum();
            prop_assert!((perceived.squares() - squares).abs() < 1e-12);
        }
    }

    #[test]
    fn what_a_kernel_hides_stays_hidden() {
        // A box over two pixels does not see a checkerboard: the sums in f32 may not show one.
        let shape = TileShape::new(64, 32, 8, 1, 1).unwrap();
        let pair = [0, 1].map(|x| Tap { offset: IVec3::new(x, 0, 0), weight: 0.5 });
        let perceived = Perceived::new(shape, &KernelTaps::new(pair).unwrap()).unwrap();
        let mut errors: Vec<f32> =
            (0..shape.pixels()).map(|i| if i % 2 == 0 { 0.7 } else { -0.7 }).collect();
        let found = perceived.mean_squares(&mut errors, &mut perceived.workspace());
        assert!(found.perceived < 1e-13, "{found:?}");
    }

    #[test]
    fn a_kernel_must_fit_the_tile() {
        let shape = TileShape::new(8, 8, 4, 1, 2).unwrap();
        let taps = |extent: i32| {
            let tap = |y| Tap { offset: IVec3::new(0, y, 0), weight: 1.0 };
            KernelTaps::new([tap(0), tap(1 - extent)]).unwrap()
        };
        assert!(Perceived::new(shape, &taps(8)).is_ok());
        let error = Perceived::new(shape, &taps(9)).err().unwrap();
        assert_eq!(error, ScoreError::Kernel { axis: "y", extent: 9, size: 8 });
        assert_eq!(
            error.to_string(),
            "the kernel spans 9 in y, but the tile only 8: it must not be wider than the tile"
        );
        let far = Tap { offset: IVec3::new(i32::MIN, 0, 0), weight: 1.0 };
        let near = Tap { offset: IVec3::new(i32::MAX, 0, 0), weight: 1.0 };
        let taps = KernelTaps::new([far, near]).unwrap();
        assert!(Perceived::new(shape, &taps).is_err());
    }
}
