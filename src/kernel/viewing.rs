//! How an animation is watched, and the kernel that follows from that: users know their frame rate
//! and their temporal anti-aliasing, and not the terms of a mixture.

use crate::kernel::factor::perception_taps;
use crate::kernel::spec::{
    ClassKind, ClassSpec, DEFAULT_PERCENT, Factor, KernelSpec, SpecProblem, Truncation,
};
use crate::tile::TileShape;

/// Standard deviation of the paper's spatial kernel, in pixels.
pub const PAPER_SIGMA: f64 = 2.1;
/// Pixels for each degree of the visual field for which [`PAPER_SIGMA`] is taken to hold: 2560 pixels
/// across a screen of 27 inches, seen from 60 cm. The paper gives pixels only.
pub const PAPER_PIXELS_PER_DEGREE: f64 = 45.0;
/// Half the side of the box that the paper cuts its spatial kernel to, in standard deviations: 7 pixels
/// for 2.1.
const HALF_SIDE: f64 = 3.5 / PAPER_SIGMA;

/// How an animation is watched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewing {
    /// Frames per second, above 4.
    pub fps: f64,
    /// Weight of the newest frame in the renderer's temporal anti-aliasing, in (0, 1], if it has any.
    pub taa: Option<f64>,
    /// Standard deviation of the eye's spatial filter in pixels, above 0.
    pub sigma: f64,
}

impl Default for Viewing {
    /// The paper's: 60 frames per second, no temporal anti-aliasing, σ = 2.1 pixels.
    fn default() -> Self {
        Self { fps: 60.0, taa: None, sigma: PAPER_SIGMA }
    }
}

impl Viewing {
    /// The standard deviation on a screen of so many pixels for each degree of the visual field.
    pub fn sigma_at(pixels_per_degree: f64) -> f64 {
        PAPER_SIGMA * pixels_per_degree / PAPER_PIXELS_PER_DEGREE
    }

    /// What the eye sees behind the renderer's filter: one product, cut to a box.
    ///
    /// In space the box holds what the paper's 7×7 pixels hold for σ = 2.1 (82 %), as far as the tile
    /// is as large. In time it has the newest frames that hold 97 % of Σ|g|, be they more than the
    /// tile's: scores fold them.
    ///
    /// # Errors
    /// A number outside its range.
    pub fn perceived(&self, shape: TileShape) -> Result<KernelSpec, SpecProblem> {
        let kind = self.product(shape, u32::MAX)?;
        KernelSpec::new(vec![ClassSpec::lone(kind)])
    }

    /// The same for pictures, which have no period: its box is as large as the filter asks for.
    ///
    /// # Errors
    /// A number outside its range.
    pub fn of_pictures(&self) -> Result<KernelSpec, SpecProblem> {
        self.perceived(TileShape::new(1 << 10, 1 << 10, 1, 1, 1).expect("a shape"))
    }

    /// The mixture that a tile for this is made with: `perceived`, with a share of 0.06 on whole columns
    /// and 0.1 on half of them, which keeps the error of a still picture small while it accumulates.
    ///
    /// Its box has no more frames than the tile. That is better than the whole kernel, folded, even
    /// where the whole is what error is seen through. For 120 frames per second, α = 0.1, 64×64×16 and
    /// 16,000 steps, seen through all 35 frames, set 7 (linear, edge, axis edge, bump, disk):
    ///
    /// | box | scores |
    /// |---|---|
    /// | 16 frames | .0003 .0438 .0190 .0029 .0543 |
    /// | 35 frames, folded | .0004 .0444 .0204 .0037 .0544 |
    /// | 12 frames | .0003 .0474 .0196 .0032 .0588 |
    ///
    /// # Errors
    /// A number outside its range.
    pub fn kernel(&self, shape: TileShape) -> Result<KernelSpec, SpecProblem> {
        let frames = u32::try_from(shape.frames()).unwrap_or(u32::MAX);
        let half = vec![Factor::Box { frames: (frames / 2).max(1) }];
        let half = ClassKind::Product { factors: half, truncation: None };
        let classes =
            [(0.84, self.product(shape, frames)?), (0.06, ClassKind::Column), (0.1, half)];
        let class = |(weight, kind)| ClassSpec { weight, kind, prefix: None };
        KernelSpec::new(classes.into_iter().map(class).collect())
    }

    /// The viewing whose kernel for a tile of this shape is this one.
    fn of(kernel: &KernelSpec, shape: TileShape) -> Option<Self> {
        let ClassKind::Product { factors, .. } = &kernel.classes()[0].kind else { return None };
        let [Factor::Gaussian { sigma, radius: None }, Factor::FovVideoVdp { fps }, rest @ ..] =
            factors.as_slice()
        else {
            return None;
        };
        let taa = match rest {
            [] => None,
            [Factor::Ema { alpha }] => Some(*alpha),
            _ => return None,
        };
        let viewing = Self { fps: *fps, taa, sigma: *sigma };
        (viewing.kernel(shape).ok()? == *kernel).then_some(viewing)
    }

    /// The product, cut to at most so many frames.
    fn product(&self, shape: TileShape, most: u32) -> Result<ClassKind, SpecProblem> {
        let mut factors = vec![
            Factor::Gaussian { sigma: self.sigma, radius: None },
            Factor::FovVideoVdp { fps: self.fps },
        ];
        factors.extend(self.taa.map(|alpha| Factor::Ema { alpha }));
        factors.iter().try_for_each(Factor::check)?;
        let radius = (HALF_SIDE * self.sigma - 0.5 - 1e-9).ceil().max(0.0);
        let side = |pixels: usize| (2.0 * radius + 1.0).min(pixels as f64) as u32;
        let truncation = Some(Truncation::Box {
            width: side(shape.width()),
            height: side(shape.height()),
            frames: self.frames().min(most),
        });
        Ok(ClassKind::Product { factors, truncation })
    }

    /// The newest frames that hold [`DEFAULT_PERCENT`] of the temporal weight.
    fn frames(&self) -> u32 {
        let mut weights = perception_taps(self.fps);
        if let Some(alpha) = self.taa.filter(|&alpha| alpha < 1.0) {
            // The average has a tail of its own: long enough that what is beyond it is not noticed.
            let tail = (libm::log(1e-6) / libm::log1p(-alpha)).min(1e6) as usize;
            weights.resize(weights.len() + tail, 0.0);
            let mut average = 0.0;
            for weight in &mut weights {
                average += alpha * (*weight - average);
                *weight = average;
            }
        }
        let all: f64 = weights.iter().map(|weight| weight.abs()).sum();
        let mut held = 0.0;
        let enough = weights.iter().position(|weight| {
            held += weight.abs();
            held >= DEFAULT_PERCENT / 100.0 * all
        });
        enough.map_or(1, |last| last as u32 + 1)
    }
}

impl KernelSpec {
    /// The kernel through which the error of a tile is seen that is made with this one. Of a mixture that
    /// a [`Viewing`] makes that is the whole of its filter, also where the tile is shorter in time;
    /// else it is the first class.
    pub fn perceived(&self, shape: TileShape) -> Self {
        Viewing::of(self, shape)
            .and_then(|viewing| viewing.perceived(shape).ok())
            .unwrap_or_else(|| self.first())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(frames: usize) -> TileShape {
        TileShape::new(64, 64, frames, 1, 2).unwrap()
    }

    #[test]
    fn the_default_is_the_papers_kernel() {
        let text = |viewing: Viewing, frames| viewing.kernel(shape(frames)).unwrap().to_string();
        let paper = "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.06: column + 0.1: box(8)";
        assert_eq!(text(Viewing::default(), 16), paper);
        let taa = Viewing { fps: 120.0, taa: Some(0.1), ..Viewing::default() };
        let behind = "gaussian(2.1) * fovvideovdp(120) * ema(0.1) @ 7x7x";
        assert_eq!(text(taa, 30), format!("0.84: {behind}30 + 0.06: column + 0.1: box(15)"));
        assert_eq!(text(taa, 64), format!("0.84: {behind}35 + 0.06: column + 0.1: box(32)"));
        assert_eq!(text(taa, 1), format!("0.84: {behind}1 + 0.06: column + 0.1: box(1)"));
        assert_eq!(taa.perceived(shape(1)).unwrap().to_string(), format!("{behind}35"));
    }

    #[test]
    fn a_tile_is_seen_through_the_whole_of_what_it_is_made_for() {
        let taa = Viewing { fps: 120.0, taa: Some(0.1), ..Viewing::default() };
        let seen = |spec: &KernelSpec, frames| spec.perceived(shape(frames)).to_string();
        let made = taa.kernel(shape(16)).unwrap();
        assert_eq!(seen(&made, 16), "gaussian(2.1) * fovvideovdp(120) * ema(0.1) @ 7x7x35");
        // It is no viewing's for a tile of another length, nor with another box.
        let short = "gaussian(2.1) * fovvideovdp(120) * ema(0.1) @ 7x7x16";
        assert_eq!(seen(&made, 20), short);
        assert_eq!(seen(&short.parse().unwrap(), 16), short);
        let default = Viewing::default();
        let plain = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";
        assert_eq!(seen(&default.kernel(shape(16)).unwrap(), 16), plain);
        assert_eq!(seen(&"0.5: frame + 0.5: column".parse().unwrap(), 16), "frame");
    }

    #[test]
    fn the_box_holds_as_much_for_every_display() {
        for (viewing, least) in [
            (Viewing::default(), 0.97),
            (Viewing { fps: 24.0, sigma: 0.9, ..Viewing::default() }, 0.97),
            (Viewing { fps: 144.0, taa: Some(0.05), sigma: 4.0 }, 0.97),
            (Viewing { fps: 60.0, taa: Some(1.0), sigma: 1.9 }, 0.97),
            (Viewing { fps: 60.0, taa: Some(0.002), sigma: 2.1 }, 0.97),
        ] {
            let spec = viewing.perceived(shape(16)).unwrap();
            let dropped = spec.resolve_without_tile().unwrap().classes()[0].dropped;
            assert!(dropped.time.unwrap() <= 1.0 - least + 1e-5, "{spec}: {dropped:?}");
            assert!((0.02..0.19).contains(&dropped.space.unwrap()), "{spec}: {dropped:?}");
        }
    }

    #[test]
    fn small_tiles_get_smaller_boxes() {
        let shape = TileShape::new(5, 64, 2, 1, 2).unwrap();
        let spec = Viewing::default().perceived(shape).unwrap();
        assert_eq!(spec.to_string(), "gaussian(2.1) * fovvideovdp(60) @ 5x7x8");
    }

    #[test]
    fn numbers_outside_their_range_are_refused() {
        for wrong in [
            Viewing { fps: 4.0, ..Viewing::default() },
            Viewing { fps: f64::NAN, ..Viewing::default() },
            Viewing { taa: Some(0.0), ..Viewing::default() },
            Viewing { taa: Some(1.5), ..Viewing::default() },
            Viewing { sigma: -1.0, ..Viewing::default() },
            Viewing { sigma: f64::INFINITY, ..Viewing::default() },
        ] {
            assert!(wrong.kernel(shape(16)).is_err(), "{wrong:?}");
        }
        // Longer than any kernel may be.
        let slow = Viewing { taa: Some(1e-9), ..Viewing::default() };
        assert!(slow.kernel(shape(16)).is_err());
    }

    #[test]
    fn sigma_grows_with_the_pixels_of_a_degree() {
        assert_eq!(Viewing::sigma_at(PAPER_PIXELS_PER_DEGREE), PAPER_SIGMA);
        assert_eq!(Viewing::sigma_at(90.0), 4.2);
    }
}
