//! One tile, one kernel, one set of integrands: all scores in one pass.
//!
//! A score is a ratio of means over the integrands of a class, not a mean of ratios. An edge that
//! cuts off 0.1 % of the square has a hundredth of the variance of most others, so a few samples in
//! a corner would move its own ratio by as much as all others together. Measured on the preset
//! `quick` (set 0, 128 integrands): the warp raised the mean of ratios of edges by 11 %, 98 % of
//! it in ten edges that cut off at most 7 %; it raises the ratio of means by 0.3 %. From set to
//! set of 256 integrands the default tile's mean of ratios varies by 5.6 % (edge) and 10 % (axis
//! edge), its ratio of means by 1.8 % and 2.6 %.

use std::fmt;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::accumulation::accumulated_mean_square;
use super::error::{MOST_INTEGRANDS, ScoreError};
use super::figure::{figure, ratio};
use super::integrand::{Class, Coordinates, Integrand, IntegrandSet, integrand_sets};
use super::perceived::Perceived;
use super::uniformity::{Histogram, histogram, residual};
use crate::domain::Domain;
use crate::kernel::{KernelSpec, KernelTaps};
use crate::tile::{Tile, TileShape};

/// Which integrands a tile is scored on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ScoreOptions {
    /// Where the tile's samples live; default the square.
    pub domain: Domain,
    /// Number of the set of integrands; default 0. Compare tiles only on the same set.
    pub set: u64,
    /// Integrands of each class, 1–65536; default 256. Fewer are quicker and less certain.
    pub integrands: usize,
}

impl Default for ScoreOptions {
    fn default() -> Self {
        Self { domain: Domain::Square, set: 0, integrands: 256 }
    }
}

impl ScoreOptions {
    /// Checks the options.
    ///
    /// # Errors
    /// [`ScoreError::Integrands`] if their number is out of range.
    pub fn validate(&self) -> Result<(), ScoreError> {
        if (1..=MOST_INTEGRANDS).contains(&self.integrands) {
            Ok(())
        } else {
            Err(ScoreError::Integrands(self.integrands))
        }
    }
}

/// A mean square relative to white noise's, over the integrands of a class: 1 is white noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// Mean over the integrands, divided by white noise's: Σ mᵢ / Σ wᵢ, where mᵢ is the mean square
    /// that the tile leaves of integrand i, and wᵢ what white noise leaves of it in expectation.
    pub mean: f64,
    /// Standard error of that ratio r by the delta method: √(n/(n − 1) · Σ (mᵢ − r·wᵢ)²) / Σ wᵢ for
    /// n integrands, 0 for one. It says how much the score would move on another set; tiles on one
    /// set move together.
    pub standard_error: f64,
}

impl Ratio {
    /// Over single integrands: what a tile leaves of each, and what white noise does.
    fn over<T>(items: &[T], tile: impl Fn(&T) -> f64, white: impl Fn(&T) -> f64) -> Self {
        let n = items.len() as f64;
        let total = items.iter().map(&white).sum::<f64>();
        let mean = items.iter().map(&tile).sum::<f64>() / total;
        let square: f64 = items.iter().map(|item| (tile(item) - mean * white(item)).powi(2)).sum();
        Self { mean, standard_error: (square * n / (n - 1.0).max(1.0)).sqrt() / total }
    }
}

/// The scores of one class of integrands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClassScore {
    /// The class.
    pub class: Class,
    /// Which coordinates its integrands read.
    pub coordinates: Coordinates,
    /// The perceived-error ratio: m = mean over pixels of (g*e)², w = Var f · Σg² / spp.
    pub perceived: Ratio,
    /// The error of each pixel's mean over half a period (n = ⌊frames/2⌋ frames, from every start):
    /// m = its mean square, w = Var f / (n·spp). `None` for a tile of one frame.
    pub half_period: Option<Ratio>,
    /// The same over the whole period.
    pub whole_period: Ratio,
    /// The mean over the whole period as the kernel shows it: filtered in space, with
    /// w = Var f · Σ over (x, y) of (Σ over t of g)² / (frames·spp). `None` for a kernel that sees
    /// no still picture.
    pub whole_period_perceived: Option<Ratio>,
    /// Bias·√N: √(Σ b² / Σ Var f) over the integrands, where b is the mean over the tile of e,
    /// times the root of the number of samples in the tile. Its square has the expectation 1 for
    /// white noise.
    pub bias: f64,
}

/// Everything that is measured of a tile. Lower is better, white noise has 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// The integrands that were used.
    pub options: ScoreOptions,
    /// One score for each class, and above two dimensions for each class that reads pairs.
    pub classes: Vec<ClassScore>,
    /// Bias·√N over all classes together: the rms of theirs, so that each counts alike.
    pub bias: f64,
    /// How the whole tile fills the 16×16 cells of each pair of dimensions; in other domains than the
    /// square, 16×16 cells of equal area, or 16 arcs.
    pub histogram: Histogram,
    /// Rms over pixels and dimensions of (mean over all frames − the domain's mean), relative to independent
    /// samples'.
    pub residual: f64,
}

impl Scores {
    /// Scores a tile; for several of one shape, keep a [`Scorer`].
    ///
    /// # Errors
    /// A kernel wider than the tile, or a number of integrands out of range.
    pub fn of(tile: &Tile, kernel: &KernelTaps, options: ScoreOptions) -> Result<Self, ScoreError> {
        Scorer::new(tile.shape(), kernel, options)?.score(tile)
    }

    /// The score of one class, if the tile has that one.
    pub fn class(&self, class: Class, coordinates: Coordinates) -> Option<&ClassScore> {
        self.classes.iter().find(|score| score.class == class && score.coordinates == coordinates)
    }
}

/// A line for each figure, as the command prints them when a run has ended.
impl fmt::Display for Scores {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for class in &self.classes {
            let pairs = if class.coordinates == Coordinates::Pairs { ", pairs" } else { "" };
            let name = format!("{}{pairs}", class.class);
            writeln!(f, "{name:22} {}", ratio(class.perceived))?;
        }
        let Histogram { smallest, largest, rms } = self.histogram;
        writeln!(f, "bias·√N                {}", figure(self.bias))?;
        writeln!(f, "histogram              {smallest:.2}–{largest:.2} (rms {})", figure(rms))?;
        write!(f, "residual               {}", figure(self.residual))
    }
}

impl Tile {
    /// Scores the tile through a kernel, of a mixture through its first class, on the integrands
    /// of [`ScoreOptions::default`], as the command does. [`Scores::of`] takes others.
    ///
    /// ```
    /// use perceptile::metric::{Baseline, Class, Coordinates};
    /// use perceptile::TileShape;
    ///
    /// let noise = Baseline::White.tile(TileShape::new(32, 32, 8, 1, 2)?, 1);
    /// let scores = noise.scores(&"gaussian(2.1) * ema(0.2) @ 7x7x8".parse()?)?;
    /// let edges = scores.class(Class::Edge, Coordinates::All).expect("a class of every tile");
    /// assert!((edges.perceived.mean - 1.0).abs() < 0.2, "white noise has 1, lower is better");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// A kernel that cannot be made, or that is wider than the tile.
    pub fn scores(&self, kernel: &KernelSpec) -> Result<Scores, ScoreError> {
        let kernel = kernel.resolve(self.shape())?;
        Scores::of(self, &kernel.classes()[0].taps, ScoreOptions::default())
    }
}

/// What scoring tiles of one shape with one kernel needs: integrands, and the kernel's spectrum.
pub struct Scorer {
    options: ScoreOptions,
    perceived: Perceived,
    sets: Vec<IntegrandSet>,
}

/// What is measured with one integrand: mean squares, in units in which white noise has the
/// integrand's variance.
struct Measured {
    variance: f64,
    perceived: f64,
    half_period: f64,
    whole_period: f64,
    whole_period_perceived: f64,
    bias: f64,
}

impl Scorer {
    /// Prepares integrands and kernel for tiles of a shape.
    ///
    /// # Errors
    /// A kernel wider than the tile, or a number of integrands out of range.
    pub fn new(
        shape: TileShape,
        kernel: &KernelTaps,
        options: ScoreOptions,
    ) -> Result<Self, ScoreError> {
        options.validate()?;
        let perceived = Perceived::new(shape, kernel)?;
        options.domain.check(shape.dims())?;
        let sets = integrand_sets(options.domain, options.set, shape.dims(), options.integrands);
        Ok(Self { options, perceived, sets })
    }

    /// Scores a tile. The result does not depend on the number of threads; between machines the
    /// last digits may differ, as the Fourier transform uses what the processor offers.
    ///
    /// # Errors
    /// A tile of another shape than the scorer's.
    pub fn score(&self, tile: &Tile) -> Result<Scores, ScoreError> {
        let (expected, found) = (self.perceived.shape(), tile.shape());
        if expected != found {
            return Err(ScoreError::Shape { expected, found });
        }
        let half = expected.frames() / 2;
        // Weights that cancel leave rounding behind, not exactly 0.
        let sees_still = self.perceived.still_squares() > 1e-12 * self.perceived.squares();
        let mut biases = 0.0;
        let mut classes = Vec::with_capacity(self.sets.len());
        for set in &self.sets {
            let measured = self.measure(tile, &set.integrands, half);
            let over = |tile: fn(&Measured) -> f64| Ratio::over(&measured, tile, |m| m.variance);
            let bias = over(|m| m.bias).mean;
            biases += bias;
            classes.push(ClassScore {
                class: set.class,
                coordinates: set.coordinates,
                perceived: over(|m| m.perceived),
                half_period: (half > 0).then(|| over(|m| m.half_period)),
                whole_period: over(|m| m.whole_period),
                whole_period_perceived: sees_still.then(|| over(|m| m.whole_period_perceived)),
                bias: bias.sqrt(),
            });
        }
        let domain = self.options.domain;
        let residuals = residual(domain, tile);
        let square: f64 = residuals.iter().map(|r| r * r).sum();
        Ok(Scores {
            options: self.options,
            bias: (biases / classes.len() as f64).sqrt(),
            classes,
            histogram: histogram(&domain.places(tile)),
            residual: (square / residuals.len() as f64).sqrt(),
        })
    }

    fn measure(&self, tile: &Tile, integrands: &[Integrand], half: usize) -> Vec<Measured> {
        let shape = tile.shape();
        let frames = shape.frames();
        integrands
            .par_iter()
            .map_init(
                || (vec![0.0_f32; shape.pixels()], self.perceived.workspace()),
                |(errors, workspace), f| {
                    let bias = f.errors(tile, errors);
                    let spp = shape.spp() as f64;
                    let period = |window: usize| match window {
                        0 => 0.0,
                        _ => accumulated_mean_square(shape, errors, window) * window as f64 * spp,
                    };
                    let (half_period, whole_period) = (period(half), period(frames));
                    let squares = self.perceived.mean_squares(errors, workspace);
                    Measured {
                        variance: f.variance(),
                        perceived: squares.perceived * spp / self.perceived.squares(),
                        half_period,
                        whole_period,
                        whole_period_perceived: squares.accumulated * spp * frames as f64
                            / self.perceived.still_squares(),
                        bias: bias * bias * shape.samples() as f64,
                    }
                },
            )
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::super::baseline::Baseline;
    use super::*;
    use crate::kernel::Tap;

    const FEW: ScoreOptions = ScoreOptions { domain: Domain::Square, set: 7, integrands: 24 };

    fn kernel(weights: &[f64]) -> KernelTaps {
        let taps = weights.iter().enumerate().flat_map(|(t, &weight)| {
            [-1, 0, 1].map(|x| Tap { offset: IVec3::new(x, 0, -(t as i32)), weight })
        });
        KernelTaps::new(taps).unwrap()
    }

    /// Every ratio of a score with its name.
    fn ratios(score: &ClassScore) -> Vec<(&'static str, f64)> {
        let mut all = vec![
            ("perceived", score.perceived.mean),
            ("whole period", score.whole_period.mean),
            ("bias", score.bias),
        ];
        all.extend(score.half_period.map(|r| ("half period", r.mean)));
        all.extend(score.whole_period_perceived.map(|r| ("filtered", r.mean)));
        all
    }

    #[test]
    fn shown_scores_have_a_line_for_each_figure() {
        let shape = TileShape::new(8, 8, 4, 1, 3).unwrap();
        let tile = Baseline::White.tile(shape, 1);
        let text = Scores::of(&tile, &kernel(&[1.0]), FEW).unwrap().to_string();
        let names = ["linear ", "axis edge, pairs ", "bias·√N ", "histogram ", "residual "];
        for name in names {
            assert_eq!(text.lines().filter(|line| line.starts_with(name)).count(), 1, "{text}");
        }
        assert_eq!(text.lines().count(), 13, "{text}");
    }

    #[test]
    fn ratios_are_of_means_and_what_hardly_varies_hardly_counts() {
        let over = |pairs: &[(f64, f64)]| Ratio::over(pairs, |p| p.0, |p| p.1);
        // By hand: 6 / 10, and deviations of -1.4, 0.6 and 0.8 from 0.6 w.
        let pairs = [(1.0, 4.0), (3.0, 4.0), (2.0, 2.0)];
        let found = over(&pairs);
        assert!((found.mean - 0.6).abs() < 1e-15, "{found:?}");
        assert!((found.standard_error - 0.444_f64.sqrt() / 10.0_f64.sqrt()).abs() < 1e-15);
        // The mean of the single ratios would go from 0.67 to 5.5.
        let more = over(&[&pairs[..], &[(0.02, 0.001)]].concat());
        assert!((more.mean - 0.6).abs() < 0.002, "{more:?}");
        assert_eq!(over(&[(1.0, 2.0)]), Ratio { mean: 0.5, standard_error: 0.0 });
    }

    #[test]
    fn white_noise_scores_one_in_every_column() {
        for (spp, dims) in [(1, 2), (2, 1), (1, 4)] {
            let shape = TileShape::new(32, 32, 9, spp, dims).unwrap();
            let scorer = Scorer::new(shape, &kernel(&[2.0, -1.0, 0.5]), FEW).unwrap();
            let tiles = 8;
            let mut sums = vec![vec![0.0; 5]; if dims > 2 { 10 } else { 5 }];
            for seed in 0..tiles {
                let scores = scorer.score(&Baseline::White.tile(shape, seed)).unwrap();
                for (sums, score) in sums.iter_mut().zip(&scores.classes) {
                    for (sum, (name, ratio)) in sums.iter_mut().zip(ratios(score)) {
                        // The bias is a root, and few integrands share one tile's luck.
                        *sum += if name == "bias" { ratio * ratio } else { ratio } / tiles as f64;
                    }
                }
            }
            for (sums, score) in sums.iter().zip(&scorer.sets) {
                let class = score.class;
                assert!((sums[0] - 1.0).abs() < 0.06, "{class} perceived {sums:?}");
                assert!((sums[1] - 1.0).abs() < 0.1, "{class} whole {sums:?}");
                assert!((sums[2] - 1.0).abs() < 0.9, "{class} bias {sums:?}");
                assert!((sums[3] - 1.0).abs() < 0.1, "{class} half {sums:?}");
                assert!((sums[4] - 1.0).abs() < 0.2, "{class} filtered {sums:?}");
            }
        }
    }

    #[test]
    fn a_still_tile_accumulates_nothing() {
        // The same frame again and again: the mean over n frames is as bad as one.
        let shape = TileShape::new(32, 32, 8, 1, 2).unwrap();
        let frame = Baseline::White.tile(TileShape::new(32, 32, 1, 1, 2).unwrap(), 5);
        let still = Tile::new(shape, frame.samples().repeat(8)).unwrap();
        let scores = Scores::of(&still, &kernel(&[1.0, 1.0]), FEW).unwrap();
        for score in &scores.classes {
            assert!((score.half_period.unwrap().mean - 4.0).abs() < 0.4, "{score:?}");
            assert!((score.whole_period.mean - 8.0).abs() < 0.8, "{score:?}");
            // Seen through a box over two equal frames, the error is twice white noise's.
            assert!((score.perceived.mean - 2.0).abs() < 0.3, "{score:?}");
        }
        assert!((scores.residual - 8.0_f64.sqrt()).abs() < 0.2);
    }

    #[test]
    fn several_samples_are_compared_with_as_many_independent_ones() {
        let shape = TileShape::new(16, 16, 4, 16, 2).unwrap();
        let kernel = kernel(&[1.0, 0.5]);
        let score = |baseline: Baseline| {
            Scores::of(&baseline.tile(shape, 1), &kernel, FEW).unwrap().classes
        };
        for (sobol, white) in score(Baseline::Sobol).iter().zip(score(Baseline::White)) {
            assert!((white.perceived.mean - 1.0).abs() < 0.15, "{white:?}");
            // 16 points of a net: smooth functions gain 16-fold and more, edges about fourfold.
            assert!(sobol.perceived.mean < 0.35, "{sobol:?}");
        }
    }

    #[test]
    fn the_threads_do_not_change_a_score() {
        let shape = TileShape::new(16, 8, 4, 1, 3).unwrap();
        let tile = Baseline::White.tile(shape, 1);
        let scores = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Scores::of(&tile, &kernel(&[1.0]), FEW).unwrap())
        });
        assert_eq!(scores[0], scores[1]);
    }

    #[test]
    fn one_frame_and_kernels_that_see_no_still_picture_leave_columns_out() {
        let shape = TileShape::new(16, 8, 1, 1, 2).unwrap();
        let scores = Scores::of(&Baseline::White.tile(shape, 1), &kernel(&[1.0]), FEW).unwrap();
        assert!(scores.classes.iter().all(|score| score.half_period.is_none()));
        let shape = TileShape::new(16, 8, 4, 1, 2).unwrap();
        let flicker = kernel(&[1.0, -1.0]);
        let scores = Scores::of(&Baseline::White.tile(shape, 1), &flicker, FEW).unwrap();
        for score in &scores.classes {
            assert!(score.whole_period_perceived.is_none());
            assert!((score.perceived.mean - 1.0).abs() < 0.3, "{score:?}");
        }
    }

    #[test]
    fn wrong_numbers_and_shapes_are_refused() {
        let shape = TileShape::new(8, 8, 2, 1, 2).unwrap();
        for integrands in [0, 65_537] {
            let options = ScoreOptions { set: 0, integrands, ..ScoreOptions::default() };
            let error = Scorer::new(shape, &kernel(&[1.0]), options).err().unwrap();
            assert_eq!(error, ScoreError::Integrands(integrands));
        }
        let other = TileShape::new(8, 8, 3, 1, 2).unwrap();
        let scorer = Scorer::new(shape, &kernel(&[1.0]), FEW).unwrap();
        let error = scorer.score(&Baseline::White.tile(other, 1)).unwrap_err();
        assert_eq!(error, ScoreError::Shape { expected: shape, found: other });
    }

    #[test]
    fn scores_survive_json() {
        let shape = TileShape::new(8, 8, 2, 1, 3).unwrap();
        let scores = Scores::of(&Baseline::White.tile(shape, 1), &kernel(&[1.0]), FEW).unwrap();
        let text = serde_json::to_string(&scores).unwrap();
        assert!(text.contains("\"axis_edge\"") && text.contains("\"pairs\""), "{text}");
        let back: Scores = serde_json::from_str(&text).unwrap();
        assert_eq!(back.classes.len(), 10);
        let bias = back.class(Class::Bump, Coordinates::Pairs).unwrap().bias;
        assert!(
            (bias / scores.class(Class::Bump, Coordinates::Pairs).unwrap().bias - 1.0).abs()
                < 1e-12
        );
    }
}
