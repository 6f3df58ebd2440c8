//! The weights of each factor of a product.

use crate::kernel::grid::{Grid, GridAxis};
use crate::kernel::spec::{Factor, MAX_LENGTH, NEGLIGIBLE, gaussian_radius};
use crate::kernel::table::{self, TableError};

/// Time span of the temporal perception kernel in seconds.
const PERCEPTION_SECONDS: f64 = 0.25;
/// Delay at which the sustained channel peaks, in seconds.
const SUSTAINED_PEAK: f64 = 0.06;
/// Width of the sustained channel in units of ln(seconds).
const SUSTAINED_WIDTH: f64 = 0.5;
/// Keeps the logarithm finite at delay 0, in seconds.
const DELAY_OFFSET: f64 = 1e-4;
/// Strength of the transient channel, the derivative of the sustained one, in seconds.
const TRANSIENT_GAIN: f64 = 0.062170507756932;

/// A factor as weights: separable ones as rows, tables as they are.
pub(crate) enum Weights {
    /// The identity.
    One,
    /// The same row along x and along y.
    Space { low: i32, row: Vec<f64> },
    /// A row along time.
    Time(Grid),
    /// Frames from one that is seen to the next.
    Every(u32),
    /// Anything else.
    Table(Grid),
}

impl Factor {
    /// The weights; the factor must have passed its check.
    ///
    /// # Errors
    /// A table that cannot be read.
    pub(crate) fn weights(&self) -> Result<Weights, TableError> {
        Ok(match self {
            Self::None => Weights::One,
            Self::Gaussian { sigma, radius } => {
                let (low, row) = gaussian(*sigma, *radius);
                Weights::Space { low, row }
            }
            Self::GaussianTime { sigma, radius } => {
                let (low, row) = gaussian(*sigma, *radius);
                Weights::Time(Grid::row(GridAxis::Time, low, row))
            }
            Self::FovVideoVdp { fps } => Weights::Time(past(perception_taps(*fps))),
            Self::Ema { alpha } => {
                let decay = |&w: &f64| Some(w * (1.0 - alpha));
                let row = std::iter::successors(Some(1.0), decay).take_while(|&w| w > NEGLIGIBLE);
                Weights::Time(past(row.collect()))
            }
            Self::Box { frames } => Weights::Time(past(vec![1.0; *frames as usize])),
            Self::BoxSpace { pixels } => {
                Weights::Space { low: -((*pixels / 2) as i32), row: vec![1.0; *pixels as usize] }
            }
            Self::Binomial { n } => Weights::Space { low: centred(*n), row: binomial(*n) },
            Self::BinomialTime { n } => {
                Weights::Time(Grid::row(GridAxis::Time, centred(*n), binomial(*n)))
            }
            Self::Every { frames } => Weights::Every(*frames),
            Self::Table { file, origin } => Weights::Table(table::read(file, *origin)?),
        })
    }
}

/// A row along time from its weights by falling time: the first is the newest frame's.
fn past(mut weights: Vec<f64>) -> Grid {
    weights.reverse();
    Grid::row(GridAxis::Time, 1 - weights.len() as i32, weights)
}

/// The first offset of n + 1 weights around the own place.
fn centred(n: u32) -> i32 {
    -(n.div_ceil(2) as i32)
}

/// The binomial coefficients of n, in units of 2ⁿ.
fn binomial(n: u32) -> Vec<f64> {
    let mut row = vec![1.0];
    for _ in 0..n {
        row.push(0.0);
        // From the end, where what was there before is not needed any more; halved, so that nothing
        // overflows.
        for k in (1..row.len()).rev() {
            row[k] = 0.5 * (row[k] + row[k - 1]);
        }
        row[0] *= 0.5;
    }
    row
}

/// The first offset and the weights exp(−k²/2σ²), peak 1.
fn gaussian(sigma: f64, radius: Option<u32>) -> (i32, Vec<f64>) {
    let radius = radius.map_or_else(|| gaussian_radius(sigma) as i32, |radius| radius as i32);
    let weight = |k: i32| {
        let deviations = f64::from(k) / sigma;
        libm::exp(-0.5 * deviations * deviations)
    };
    (-radius, (-radius..=radius).map(weight).collect())
}

/// The temporal perception kernel of FovVideoVDP (Mantiuk et al. 2021) at `fps` frames per
/// second, scaled to Σg = 1: element k weights the frame k in the past.
///
/// It has L = ⌈fps/4⌉ taps at the delays t_k = k·(L/fps)/(L−1). The sustained channel is
/// s_k = exp(−(ln(t_k + 1e−4) − ln 0.06)² / (2·0.5²)) divided by its sum, the transient channel
/// is its derivative, 0.0622·(s_{k+1} − s_k)/(t_1 − t_0) with 0 at the end, and the kernel is
/// their sum. `fps` must be above 4, so that there are two taps, and at most `4 ·`
/// [`MAX_LENGTH`](crate::kernel::MAX_LENGTH); outside there are no taps at all.
pub fn perception_taps(fps: f64) -> Vec<f64> {
    let taps = (PERCEPTION_SECONDS * fps).ceil();
    if !(2.0..=f64::from(MAX_LENGTH)).contains(&taps) {
        return Vec::new();
    }
    let interval = taps / fps / (taps - 1.0);
    let mut sustained: Vec<f64> = (0..taps as usize)
        .map(|k| {
            let delay = k as f64 * interval + DELAY_OFFSET;
            let z = (libm::log(delay) - libm::log(SUSTAINED_PEAK)) / SUSTAINED_WIDTH;
            libm::exp(-0.5 * z * z)
        })
        .collect();
    let sum: f64 = sustained.iter().sum();
    sustained.iter_mut().for_each(|s| *s /= sum);
    let both: Vec<f64> = (0..sustained.len())
        .map(|k| match sustained.get(k + 1) {
            Some(next) => sustained[k] + TRANSIENT_GAIN * (next - sustained[k]) / interval,
            None => sustained[k],
        })
        .collect();
    let sum: f64 = both.iter().sum();
    both.into_iter().map(|w| w / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published taps at 60 frames per second.
    const AT_60: [f64; 15] = [
        0.0395582850655909,
        0.398409765599820,
        0.404689211439515,
        0.177879764807883,
        0.0419136195197315,
        -0.00678276096076438,
        -0.0170052838869954,
        -0.0150087151111371,
        -0.0106941128889411,
        -0.00697594351554300,
        -0.00435253914170693,
        -0.00264862667445315,
        -0.00158680181327903,
        -0.000939965263123874,
        0.00354410282340402,
    ];

    #[test]
    fn perception_at_60_fps_is_the_published_one() {
        let taps = perception_taps(60.0);
        assert_eq!(taps.len(), AT_60.len());
        for (k, (ours, published)) in taps.iter().zip(AT_60).enumerate() {
            assert!((ours - published).abs() < 1e-12, "tap {k}: {ours} != {published}");
        }
    }

    #[test]
    fn binomial_weights_are_those_of_pascal() {
        assert_eq!(binomial(1), [0.5, 0.5]);
        assert_eq!(binomial(2), [0.25, 0.5, 0.25]);
        assert_eq!(binomial(4), [1.0, 4.0, 6.0, 4.0, 1.0].map(|w| w / 16.0));
        let long = binomial(512);
        assert!(long.iter().all(|w| w.is_normal()));
        assert!((long.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!((centred(1), centred(2), centred(3), centred(4)), (-1, -1, -2, -2));
    }

    #[test]
    fn perception_spans_a_quarter_of_a_second_at_any_rate() {
        for (fps, taps) in
            [(4.5, 2), (23.976, 6), (24.0, 6), (120.0, 30), (240.0, 60), (65536.0, 16384)]
        {
            let weights = perception_taps(fps);
            assert_eq!(weights.len(), taps, "{fps}");
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{fps}");
        }
        for fps in [4.0, 1.0, 0.0, -60.0, f64::NAN, f64::INFINITY] {
            assert!(perception_taps(fps).is_empty(), "{fps}");
        }
    }
}
