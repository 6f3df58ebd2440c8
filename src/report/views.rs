//! The ways in which the viewer shows error: raw, as perceived, behind temporal anti-aliasing
//! (TAA), and both. Tiles repeat in time, so kernels may be longer than they are.

use serde::Serialize;

use super::samples::Crop;
use crate::kernel::{
    ClassKind, ClassSpec, Factor, KernelClass, KernelError, KernelPlanes, KernelSpec, Truncation,
};
use crate::tile::TileShape;

/// The view of what the eye sees behind temporal anti-aliasing.
const TAA_AS_PERCEIVED: &str = "TAA, as perceived";

/// One view, for the viewer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct View {
    pub name: &'static str,
    /// `None` for the error itself.
    pub kernel: Option<KernelPlanes>,
    /// Its text form.
    #[serde(skip)]
    pub text: Option<String>,
}

/// The views of a report, and those that it has to do without.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Views {
    pub shown: Vec<View>,
    /// Name and reason.
    pub left_out: Vec<(&'static str, String)>,
}

impl Views {
    /// The views for tiles of which the viewer has these parts; `shape` is the first tile's.
    ///
    /// A kernel that has temporal anti-aliasing already is "TAA, as perceived", its α is that of the
    /// views, and "As perceived" is the rest of it.
    ///
    /// # Errors
    /// A kernel that does not fit the first tile.
    pub fn new(
        kernel: &KernelSpec,
        alpha: f64,
        shape: TileShape,
        parts: &[Crop],
    ) -> Result<Self, KernelError> {
        let least = |side: fn(&Crop) -> usize| parts.iter().map(side).min().unwrap_or(1);
        let room = Room { width: least(|part| part.width), height: least(|part| part.height) };
        let without = kernel.without_taa();
        let resolved = without.as_ref().unwrap_or(kernel).resolve(shape)?;
        let perceived = &resolved.classes()[0];
        let mut views = Self {
            shown: vec![View { name: "Raw", kernel: None, text: None }],
            left_out: Vec::new(),
        };
        views.add("As perceived", room.planes(perceived));
        let average = Average::new(kernel.taa().unwrap_or(alpha));
        views.add(
            "With TAA",
            average.clone().and_then(|average| room.first(&average.alone(average.frames)?)),
        );
        if without.is_some() {
            views.add(TAA_AS_PERCEIVED, room.first(kernel));
            return Ok(views);
        }
        views.add(
            TAA_AS_PERCEIVED,
            average.and_then(|average| {
                let (low, high) = perceived.taps.bounds();
                let side = |low: i32, high: i32| {
                    2 * low.unsigned_abs().max(high.unsigned_abs()) as usize + 1
                };
                let frames = perceived.taps.size()[2] as usize + average.frames - 1;
                let size = [side(low.x, high.x), side(low.y, high.y), frames];
                let behind = kernel.followed_by(average.factor, truncation(size));
                room.first(&behind.map_err(|problem| problem.to_string())?)
            }),
        );
        Ok(views)
    }

    /// The view to begin with: the one that the scores of a kernel are of.
    pub fn first(&self, kernel: &KernelSpec) -> usize {
        let behind_taa = |view: &View| view.name == TAA_AS_PERCEIVED;
        let last = kernel.taa().and_then(|_| self.shown.iter().position(behind_taa));
        let first = || self.shown.iter().position(|view| view.kernel.is_some());
        last.or_else(first).unwrap_or(0)
    }

    fn add(&mut self, name: &'static str, view: Result<(KernelPlanes, String), String>) {
        match view {
            Ok((planes, text)) => {
                self.shown.push(View { name, kernel: Some(planes), text: Some(text) });
            }
            Err(reason) => self.left_out.push((name, reason)),
        }
    }
}

/// The average of frames that temporal anti-aliasing shows.
#[derive(Debug, Clone)]
struct Average {
    factor: Factor,
    /// Frames that hold nearly all of its weight.
    frames: usize,
}

impl Average {
    fn new(alpha: f64) -> Result<Self, String> {
        let unbounded = Self { factor: Factor::Ema { alpha }, frames: 0 };
        let spec = unbounded.spec(None)?;
        let long = spec.resolve_without_tile().map_err(|error| error.to_string())?;
        Ok(Self { frames: long.classes()[0].taps.size()[2] as usize, ..unbounded })
    }

    /// The average over so many frames.
    fn alone(&self, frames: usize) -> Result<KernelSpec, String> {
        self.spec(Some(truncation([1, 1, frames])))
    }

    fn spec(&self, truncation: Option<Truncation>) -> Result<KernelSpec, String> {
        let kind = ClassKind::Product { factors: vec![self.factor.clone()], truncation };
        KernelSpec::new(vec![ClassSpec::lone(kind)]).map_err(|problem| problem.to_string())
    }
}

/// A box of pixels across, down and frames.
fn truncation(size: [usize; 3]) -> Truncation {
    let [width, height, frames] = size.map(|n| u32::try_from(n).unwrap_or(u32::MAX));
    Truncation::Box { width, height, frames }
}

/// The smallest size of all parts: what a kernel may extend over.
struct Room {
    width: usize,
    height: usize,
}

impl Room {
    fn planes(&self, class: &KernelClass) -> Result<(KernelPlanes, String), String> {
        let [width, height, _] = class.taps.size().map(|n| n as usize);
        if width > self.width || height > self.height {
            return Err(format!(
                "its kernel of {width}x{height} pixels is wider than the part of a tile that the viewer has, {}x{}",
                self.width, self.height
            ));
        }
        let planes =
            KernelPlanes::of(&class.taps).ok_or("its kernel has too many weights for a page")?;
        Ok((planes, class.text.clone()))
    }

    /// The first class of a kernel.
    fn first(&self, kernel: &KernelSpec) -> Result<(KernelPlanes, String), String> {
        let resolved = kernel.resolve_without_tile().map_err(|error| error.to_string())?;
        self.planes(&resolved.classes()[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KERNEL: &str = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";

    fn views(kernel: &str, alpha: f64, sizes: &[[usize; 3]]) -> Views {
        let shapes: Vec<TileShape> =
            sizes.iter().map(|&[w, h, f]| TileShape::new(w, h, f, 1, 2).unwrap()).collect();
        let parts: Vec<Crop> = shapes.iter().map(|&shape| Crop::of(shape)).collect();
        Views::new(&kernel.parse().unwrap(), alpha, shapes[0], &parts).unwrap()
    }

    fn names(views: &Views) -> Vec<&'static str> {
        views.shown.iter().map(|view| view.name).collect()
    }

    #[test]
    fn a_tile_of_usual_size_has_all_four_views() {
        let all = views(KERNEL, 0.2, &[[64, 64, 16]]);
        assert_eq!(names(&all), ["Raw", "As perceived", "With TAA", "TAA, as perceived"]);
        assert!(all.left_out.is_empty());
        let text = |i: usize| all.shown[i].text.as_deref();
        assert_eq!(text(1), Some(KERNEL));
        assert_eq!(text(2), Some("ema(0.2) @ 1x1x16"));
        assert_eq!(text(3), Some("gaussian(2.1) * fovvideovdp(60) * ema(0.2) @ 7x7x23"));
        assert_eq!(all.first(&KERNEL.parse().unwrap()), 1);
        // The average alone: weights fall by 1 − α from frame to frame.
        let average = all.shown[2].kernel.as_ref().unwrap();
        assert_eq!(average.planes.len(), 1);
        let scales: Vec<f64> = average.slices.iter().map(|slice| slice.scale).collect();
        assert_eq!(scales.len(), 16);
        assert!(scales.windows(2).all(|pair| (pair[0] / pair[1] - 0.8).abs() < 1e-9));
    }

    #[test]
    fn the_average_of_a_kernel_without_a_box_is_boxed() {
        let all = views("gaussian(2, radius=2)", 0.5, &[[64, 64, 16]]);
        let text = all.shown[3].text.as_deref();
        assert_eq!(text, Some("gaussian(2, radius=2) * ema(0.5) @ 5x5x6"));
    }

    #[test]
    fn a_kernel_with_taa_is_the_last_view_and_the_rest_of_it_the_second() {
        let kernel = "gaussian(2.1) * fovvideovdp(120) * ema(0.1) @ 7x7x35";
        let all = views(kernel, 0.2, &[[64, 64, 16]]);
        let text = |i: usize| all.shown[i].text.as_deref();
        assert_eq!(text(1), Some("gaussian(2.1) * fovvideovdp(120) @ 7x7x35"));
        assert_eq!(text(2), Some("ema(0.1) @ 1x1x34"));
        assert_eq!(text(3), Some(kernel));
        assert_eq!(all.first(&kernel.parse().unwrap()), 3, "the view that the scores are of");
    }

    #[test]
    fn kernels_may_be_longer_than_the_tiles() {
        let all = views(KERNEL, 0.1, &[[64, 64, 16], [64, 64, 4]]);
        assert_eq!(names(&all).len(), 4);
        let average = all.shown[2].kernel.as_ref().unwrap();
        assert_eq!(average.slices.len(), 34);
    }

    #[test]
    fn views_that_do_not_fit_are_left_out_with_a_reason() {
        // A column takes no factor.
        let column = views("column", 0.2, &[[64, 64, 16]]);
        assert_eq!(names(&column), ["Raw", "As perceived", "With TAA"]);
        let wide = views("gaussian(90, radius=200)", 0.2, &[[512, 512, 16]]);
        assert_eq!(names(&wide), ["Raw", "With TAA"]);
    }
}
