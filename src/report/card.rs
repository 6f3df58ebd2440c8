//! What a page shows of one tile, with the files that go with it.

use super::contour::contours;
use super::error::ReportError;
use super::folder::Folder;
use super::pictures::{self, Slice};
use super::plot::PlotLine;
use super::provenance::Provenance;
use super::samples::Crop;
use crate::format::picture::Image;
use crate::kernel::{KernelTaps, Response};
use crate::metric::{
    ClassSpectra, Coordinates, PairHistogram, Ring, ScoredTile, Spectrum, marginals,
    pair_histograms,
};
use crate::tile::Tile;

/// What the tile that was read nowhere is called.
pub(super) const WHITE: &str = "White noise";
/// Frequencies across and down of the grid on which contours are drawn.
const FREQUENCIES: usize = 96;
/// Amplitudes, relative to the largest, at which the window is drawn: one half and −20 dB.
const LEVELS: [f64; 2] = [0.5, 0.1];
/// Intervals of the histograms of single coordinates.
const BINS: usize = 32;
/// Powers below are drawn as this one: no one sees a ten-thousandth.
const LEAST_POWER: f64 = 1e-4;

/// One tile of the page.
pub(super) struct Card {
    /// As the page calls the tile.
    pub title: String,
    pub entry: ScoredTile,
    /// Whether it is white noise that repeats within the kernel, and so has more error than the white
    /// noise that scores are relative to.
    pub is_repeated_noise: bool,
    /// What the viewer has of it.
    pub part: Crop,
    pub provenance: Provenance,
    /// Frame, XT and YT slice.
    pub slices: [Shown; 3],
    /// XY and XT spectrum, each with the window over it.
    pub spectra: [KernelWindow; 2],
    /// Power by distance from frequency 0: XY and XT.
    pub rings: [PlotLine; 2],
    /// How much of it the kernel lets pass along x.
    pub kernel_power: PlotLine,
    pub pairs: Vec<(PairHistogram, Shown)>,
    /// Shares of the intervals of each coordinate, as lines.
    pub marginals: Vec<PlotLine>,
}

/// A picture of the report.
pub(super) struct Shown {
    pub file: String,
    pub width: usize,
    pub height: usize,
}

/// A spectrum and the kernel's window over it.
pub(super) struct KernelWindow {
    pub picture: Shown,
    /// One path for each of the levels, in pixels of the picture.
    pub contours: [String; 2],
}

impl Card {
    /// Writes the files of tile `number` and keeps what the page shows of it.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn new(
        number: usize,
        mut entry: ScoredTile,
        tile: &Tile,
        kernel: &KernelTaps,
        folder: &Folder,
    ) -> Result<Self, ReportError> {
        let save = |name: &str, picture: &Image| -> Result<Shown, ReportError> {
            let file = format!("pictures/{number}-{name}.png");
            folder.picture(&file, picture)?;
            Ok(Shown { file, width: picture.width(), height: picture.height() })
        };
        // What is shown as a function on the square, or counted in its cells, goes by places there.
        let domain = entry.scores.options.domain;
        let places = domain.places(tile);
        let part = Crop::of(places.shape());
        folder.write(&format!("tiles/{number}.js"), part.script(number, &places).as_bytes())?;
        // Their powers are not needed any more once they are drawn.
        let spectra = entry.spectra.take().unwrap_or_default();
        let window = |name: &str,
                      which: fn(&ClassSpectra) -> &Spectrum,
                      response: Response|
         -> Result<(KernelWindow, Vec<Ring>), ReportError> {
            let mean = mean(&spectra, which);
            let picture = save(name, &pictures::spectrum_picture(&mean))?;
            let contours = LEVELS.map(|level| window_path(&response, level, &mean));
            Ok((KernelWindow { picture, contours }, mean.radial))
        };
        let n = FREQUENCIES;
        let (xy, xy_rings) = window("xy", |class| &class.xy, Response::spatial(kernel, n, n))?;
        let (xt, xt_rings) = window("xt", |class| &class.xt, Response::space_time(kernel, n, n))?;
        let pairs = pair_histograms(&places)
            .into_iter()
            .map(|pair| {
                let (i, j) = pair.dims;
                let shown = save(&format!("histogram-{i}-{j}"), &pictures::heat(&pair))?;
                Ok((pair, shown))
            })
            .collect::<Result<_, ReportError>>()?;
        let title = entry.path.as_ref().map_or(WHITE, |_| &entry.name).to_owned();
        let is_short = kernel.size()[2] > tile.shape().frames() as u64;
        Ok(Self {
            is_repeated_noise: entry.path.is_none() && is_short,
            part,
            provenance: Provenance::of(entry.path.as_deref()),
            slices: [
                save("frame", &pictures::slice(tile, Slice::Frame))?,
                save("row", &pictures::slice(tile, Slice::Xt))?,
                save("column", &pictures::slice(tile, Slice::Yt))?,
            ],
            spectra: [xy, xt],
            rings: [rings(&title, &xy_rings), rings(&title, &xt_rings)],
            kernel_power: power_along_x(kernel),
            pairs,
            marginals: marginals(&places, BINS).iter().enumerate().map(steps).collect(),
            title,
            entry,
        })
    }
}

/// The mean over the classes of integrands that read all coordinates.
fn mean(spectra: &[ClassSpectra], which: fn(&ClassSpectra) -> &Spectrum) -> Spectrum {
    let all: Vec<&Spectrum> =
        spectra.iter().filter(|class| class.coordinates == Coordinates::All).map(which).collect();
    let count = all.len() as f64;
    let Some(first) = all.first() else {
        return Spectrum { width: 1, height: 1, power: vec![0.0], radial: Vec::new() };
    };
    let over = |value: &dyn Fn(&Spectrum) -> f64| all.iter().map(|s| value(s)).sum::<f64>() / count;
    let power = (0..first.power.len()).map(|i| over(&|s| f64::from(s.power[i])) as f32).collect();
    let ring = |(i, ring): (usize, &Ring)| Ring {
        frequency: ring.frequency,
        power: over(&|s| s.radial[i].power),
    };
    let radial = first.radial.iter().enumerate().map(ring).collect();
    Spectrum { width: first.width, height: first.height, power, radial }
}

/// The lines where |ĝ| is so much of its largest value, in pixels of a spectrum's picture.
fn window_path(response: &Response, level: f64, spectrum: &Spectrum) -> String {
    let peak = response.magnitude.iter().copied().fold(0.0, f64::max);
    // The frequency behind the last one is the first: the grid reaches from −1/2 to 1/2.
    let (columns, rows) = (response.columns, response.rows);
    let values: Vec<f64> = (0..=rows)
        .flat_map(|y| (0..=columns).map(move |x| (x % columns, y % rows)))
        .map(|(x, y)| response.magnitude[y * columns + x])
        .collect();
    let mut path = String::new();
    for line in contours(&values, columns + 1, level * peak) {
        for (i, [x, y]) in line.into_iter().enumerate() {
            // Frequency 0 is in the middle of its pixel.
            let pixel = |place: f64, count: usize, size: usize| {
                (place - (count / 2) as f64) / count as f64 * size as f64 + (size / 2) as f64 + 0.5
            };
            path += if i == 0 { "M" } else { "L" };
            let (x, y) = (pixel(x, columns, spectrum.width), pixel(y, rows, spectrum.height));
            path += &format!("{x:.2} {y:.2}");
        }
    }
    path
}

fn rings(name: &str, rings: &[Ring]) -> PlotLine {
    let point = |ring: &Ring| [ring.frequency, ring.power.max(LEAST_POWER)];
    PlotLine { name: name.into(), points: rings.iter().map(point).collect(), band: Vec::new() }
}

/// |ĝ|² along x, relative to its largest value.
fn power_along_x(kernel: &KernelTaps) -> PlotLine {
    let response = Response::spatial(kernel, 2 * FREQUENCIES, 1);
    let peak = response.magnitude.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let point = |i: usize| {
        let part = response.magnitude[(FREQUENCIES + i) % (2 * FREQUENCIES)] / peak;
        [i as f64 / (2 * FREQUENCIES) as f64, (part * part).max(LEAST_POWER)]
    };
    let points = (0..=FREQUENCIES).map(point).collect();
    PlotLine { name: "kernel’s power |ĝ|² (along x)".into(), points, band: Vec::new() }
}

/// The shares of a coordinate's intervals as steps.
fn steps((dim, shares): (usize, &Vec<f64>)) -> PlotLine {
    let at = |i: usize| i as f64 / shares.len() as f64;
    let points =
        shares.iter().enumerate().flat_map(|(i, &share)| [[at(i), share], [at(i + 1), share]]);
    PlotLine { name: format!("dimension {dim}"), points: points.collect(), band: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::KernelSpec;

    fn gaussian() -> KernelTaps {
        let spec: KernelSpec = "gaussian(2.1) @ 100%".parse().unwrap();
        spec.resolve_without_tile().unwrap().classes()[0].taps.clone()
    }

    /// Pairs of numbers of a path.
    fn places(path: &str) -> Vec<[f64; 2]> {
        let numbers: Vec<f64> =
            path.split(['M', 'L', ' ']).filter_map(|word| word.parse().ok()).collect();
        numbers.chunks(2).map(|pair| [pair[0], pair[1]]).collect()
    }

    #[test]
    fn the_window_of_a_gaussian_is_an_ellipse_around_frequency_0() {
        let taps = gaussian();
        let response = Response::spatial(&taps, FREQUENCIES, FREQUENCIES);
        let spectrum = Spectrum { width: 64, height: 31, power: vec![], radial: vec![] };
        for level in LEVELS {
            let places = places(&window_path(&response, level, &spectrum));
            assert!(places.len() > 20);
            // exp(−(2πσf)²/2) = level
            let radius = (-2.0 * level.ln()).sqrt() / (std::f64::consts::TAU * 2.1);
            for [x, y] in places {
                // The middle pixels of 64 and 31 are 32 and 15.
                let f = [(x - 32.5) / 64.0, (y - 15.5) / 31.0];
                assert!((f[0].hypot(f[1]) / radius - 1.0).abs() < 0.02, "{level}: {f:?}");
            }
        }
    }

    #[test]
    fn steps_and_windows_reach_their_ends() {
        let series = steps((3, &vec![1.0, 2.0]));
        assert_eq!(series.points, [[0.0, 1.0], [0.5, 1.0], [0.5, 2.0], [1.0, 2.0]]);
        let taps = gaussian();
        let points = power_along_x(&taps).points;
        assert_eq!((points[0], points[points.len() - 1][0]), ([0.0, 1.0], 0.5));
    }
}
