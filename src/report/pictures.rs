//! The pictures of a tile: slices through its samples, spectra of its error, histograms.
//!
//! All are as small as what they show: a page magnifies them by whole factors.

use crate::format::picture::Image;
use crate::format::png::Depth;
use crate::metric::{PairHistogram, Spectrum};
use crate::tile::Tile;

/// Most pixels across and down of a slice; of larger tiles the upper left part is shown.
pub(super) const MOST: usize = 512;
/// How far from its share a cell is that has the full colour.
pub(super) const FULL: f64 = 0.25;

/// Amplitude as brightness, white noise's in the middle: the square root keeps apart the low
/// powers that matter.
///
/// # Panics
/// If the spectrum has no frequencies, or not as many powers as frequencies.
pub fn spectrum_picture(spectrum: &Spectrum) -> Image {
    let level = |power: &f32| (127.5 * power.sqrt()).min(255.0) as u8;
    let levels = spectrum.power.iter().map(level).collect();
    Image::new(spectrum.width, spectrum.height, 1, levels).expect("a power for each frequency")
}

/// Which two axes a slice of samples has.
#[derive(Debug, Clone, Copy)]
pub(super) enum Slice {
    /// The first frame.
    Frame,
    /// The first row of every frame, time down.
    Xt,
    /// The first column of every frame, time across.
    Yt,
}

/// A slice through the first sample of each pixel: dimensions 0, 1 and 2 are red, green and blue,
/// a single dimension is gray.
pub(super) fn slice(tile: &Tile, slice: Slice) -> Image {
    let shape = tile.shape();
    let (width, height) = match slice {
        Slice::Frame => (shape.width(), shape.height()),
        Slice::Xt => (shape.width(), shape.frames()),
        Slice::Yt => (shape.frames(), shape.height()),
    };
    let picture = Image::rgb(width.min(MOST), height.min(MOST), |x, y| {
        let point = match slice {
            Slice::Frame => tile.point(x, y, 0, 0),
            Slice::Xt => tile.point(x, 0, y, 0),
            Slice::Yt => tile.point(0, y, x, 0),
        };
        let level = |x: f32| Depth::Eight.quantize(x) as u8;
        match point {
            [gray] => [level(*gray); 3],
            _ => [0, 1, 2].map(|dim| point.get(dim).map_or(0, |&x| level(x))),
        }
    });
    picture.expect("every tile has a pixel")
}

/// A histogram: gray where a cell has its share, blue where it has less, orange where more.
pub(super) fn heat(histogram: &PairHistogram) -> Image {
    const EVEN: [f64; 3] = [236.0; 3];
    const LESS: [f64; 3] = [0.0, 90.0, 181.0];
    const MORE: [f64; 3] = [214.0, 94.0, 0.0];
    let across = histogram.shares.len() / histogram.rows;
    let picture = Image::rgb(across, histogram.rows, |x, y| {
        let deviation = (histogram.shares[y * across + x] - 1.0) / FULL;
        let far = if deviation < 0.0 { LESS } else { MORE };
        let part = deviation.abs().min(1.0);
        [0, 1, 2].map(|i| (EVEN[i] + part * (far[i] - EVEN[i])).round() as u8)
    });
    picture.expect("every histogram has a cell")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::{Baseline, Ring, pair_histograms};
    use crate::tile::TileShape;

    #[test]
    fn white_noise_is_drawn_in_mid_gray() {
        let radial = vec![Ring { frequency: 0.0, power: 1.0 }];
        let power = vec![0.0, 1.0, 0.01, 100.0];
        let picture = spectrum_picture(&Spectrum { width: 2, height: 2, power, radial });
        assert_eq!(picture.data(), [0, 127, 12, 255]);
    }

    #[test]
    fn slices_show_the_samples_of_their_axes() {
        let tile = Baseline::White.tile(TileShape::new(7, 5, 3, 2, 2).unwrap(), 1);
        let level = |x: f32| (x * 256.0) as u8;
        for (which, size, place) in [
            (Slice::Frame, (7, 5), (2, 3, 0)),
            (Slice::Xt, (7, 3), (2, 0, 1)),
            (Slice::Yt, (3, 5), (0, 3, 1)),
        ] {
            let picture = slice(&tile, which);
            assert_eq!((picture.width(), picture.height()), size);
            let (x, y, t) = place;
            let [a, b] = tile.point(x, y, t, 0) else { panic!() };
            let (column, row) = match which {
                Slice::Frame => (x, y),
                Slice::Xt => (x, t),
                Slice::Yt => (t, y),
            };
            assert_eq!(picture.pixel(column, row), [level(*a), level(*b), 0]);
        }
        let large = Baseline::White.tile(TileShape::new(600, 1, 1, 1, 1).unwrap(), 1);
        assert_eq!(slice(&large, Slice::Frame).width(), MOST);
    }

    #[test]
    fn cells_with_less_are_blue_and_cells_with_more_are_orange() {
        let shares = [1.0, 0.5, 1.5].into_iter().chain([1.0; 13]).collect();
        let picture = heat(&PairHistogram { dims: (0, 0), rows: 1, shares });
        assert_eq!((picture.width(), picture.height()), (16, 1));
        assert_eq!(picture.pixel(0, 0), [236; 3]);
        assert_eq!(picture.pixel(1, 0), [0, 90, 181]);
        assert_eq!(picture.pixel(2, 0), [214, 94, 0]);
        let tile = Baseline::White.tile(TileShape::new(16, 16, 4, 1, 3).unwrap(), 1);
        for pair in pair_histograms(&tile) {
            assert_eq!(heat(&pair).height(), 16);
        }
    }
}
