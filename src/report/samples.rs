//! The samples of a tile as the viewer reads them: a script with 16-bit integers in base 64, as a
//! page that was opened from a file may load scripts, but no data.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::format::png::Depth;
use crate::tile::{Tile, TileShape};

/// Most pixels across and down, and most frames, that the viewer takes.
const MOST: [usize; 3] = [256, 256, 64];
/// Most samples: 8 MB of base 64 with two coordinates of two bytes each.
const MOST_SAMPLES: usize = 8_000_000 / 4 * 3 / 4;
/// Pixels across and down below which frames are given up instead.
const LEAST: usize = 32;

/// The part of a tile that the viewer gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Crop {
    pub width: usize,
    pub height: usize,
    pub frames: usize,
    /// Whether it is the whole tile.
    pub whole: bool,
}

impl Crop {
    /// The largest part that the viewer takes; frames are kept as long as possible, because the
    /// period is what is played.
    pub fn of(shape: TileShape) -> Self {
        let [mut width, mut height, mut frames] =
            [shape.width().min(MOST[0]), shape.height().min(MOST[1]), shape.frames().min(MOST[2])];
        let pixels = MOST_SAMPLES / shape.spp();
        let fits = |side: usize, other: usize| (pixels / other).min(side);
        if width * height * frames > pixels {
            let side = ((pixels / frames).isqrt()).max(LEAST);
            // The shorter side may leave room for the longer one.
            if width <= height {
                width = width.min(side);
                height = fits(height, width * frames).max(height.min(side));
            } else {
                height = height.min(side);
                width = fits(width, height * frames).max(width.min(side));
            }
            frames = fits(frames, width * height);
        }
        let whole = (width, height, frames) == (shape.width(), shape.height(), shape.frames());
        Self { width, height, frames, whole }
    }

    /// The script that hands the part of tile `number` to the viewer.
    pub fn script(self, number: usize, tile: &Tile) -> String {
        let (spp, dims) = (tile.shape().spp(), tile.shape().dims());
        let mut bytes = Vec::with_capacity(self.width * self.height * self.frames * spp * 4);
        for t in 0..self.frames {
            for y in 0..self.height {
                let first = tile.shape().pixel(0, y, t) * spp * dims;
                let row = &tile.samples()[first..][..self.width * spp * dims];
                for point in row.chunks_exact(dims) {
                    let second = point.get(1).copied().unwrap_or(0.5);
                    for x in [point[0], second] {
                        bytes.extend(Depth::Sixteen.quantize(x).to_le_bytes());
                    }
                }
            }
        }
        format!("perceptileTile({number}, \"{}\");\n", STANDARD.encode(bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::Baseline;

    fn crop(width: usize, height: usize, frames: usize, spp: usize) -> Crop {
        Crop::of(TileShape::new(width, height, frames, spp, 2).unwrap())
    }

    #[test]
    fn small_tiles_are_whole_and_large_ones_are_cut_to_fit() {
        let whole = Crop { width: 64, height: 64, frames: 16, whole: true };
        assert_eq!(crop(64, 64, 16, 1), whole);
        assert_eq!(
            crop(512, 300, 16, 1),
            Crop { width: 256, height: 256, frames: 16, whole: false }
        );
        for (width, height, frames, spp) in [
            (512, 512, 64, 8),
            (512, 512, 64, 1),
            (4096, 4096, 1, 64),
            (256, 8, 64, 64),
            (8, 256, 64, 64),
            (1, 1, 1 << 20, 64),
            (64, 64, 64, 64),
        ] {
            let part = crop(width, height, frames, spp);
            let samples = part.width * part.height * part.frames * spp;
            assert!(samples <= MOST_SAMPLES && samples > 0, "{part:?}");
            assert!(part.width <= width.min(256) && part.height <= height.min(256), "{part:?}");
            assert!(!part.whole);
        }
        // Frames go last.
        assert_eq!(crop(512, 512, 64, 8).frames, 64);
        assert_eq!(crop(256, 256, 64, 64).frames, 22);
        assert_eq!(crop(256, 8, 64, 64).frames, 64);
    }

    #[test]
    fn the_script_holds_the_samples_of_the_part() {
        for dims in [1, 2, 3] {
            let tile = Baseline::White.tile(TileShape::new(5, 4, 3, 2, dims).unwrap(), 1);
            let part = Crop { width: 3, height: 2, frames: 2, whole: false };
            let script = part.script(7, &tile);
            let data = script.strip_prefix("perceptileTile(7, \"").unwrap();
            let bytes = STANDARD.decode(data.strip_suffix("\");\n").unwrap()).unwrap();
            let mut levels =
                bytes.chunks_exact(2).map(|pair| f64::from(u16::from_le_bytes([pair[0], pair[1]])));
            for t in 0..2 {
                for y in 0..2 {
                    for x in 0..3 {
                        for s in 0..2 {
                            let point = tile.point(x, y, t, s);
                            for dim in 0..2 {
                                let expected = f64::from(*point.get(dim).unwrap_or(&0.5));
                                let found = (levels.next().unwrap() + 0.5) / 65536.0;
                                assert!((found - expected).abs() <= 0.5 / 65536.0);
                            }
                        }
                    }
                }
            }
            assert_eq!(levels.next(), None);
        }
    }
}
