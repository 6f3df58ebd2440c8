//! Levels that stand equally often: for thresholds and dithering, where a tile's density must be exact in
//! every frame.
//!
//! In every slice (a frame, a sample, a dimension) coordinates are ranked, and the rank says the level: of
//! n pixels the one of rank r has the level ⌊(r + ½) levels / n⌋. So counts of levels differ by one at
//! most, and by none where n is a multiple of the levels.

use super::png::Depth;
use crate::tile::Tile;

/// The tile whose slices have every level equally often, as the middles of levels' bins.
///
/// Equal coordinates are ranked in the order of rows and columns.
pub fn exact(tile: &Tile, depth: Depth) -> Tile {
    let shape = tile.shape();
    let pixels = shape.width() * shape.height();
    let stride = shape.spp() * shape.dims();
    let levels = u64::from(depth.levels());
    let mut samples = tile.samples().to_vec();
    let mut order: Vec<usize> = Vec::with_capacity(pixels);
    for frame in samples.chunks_exact_mut(pixels * stride) {
        for slice in 0..stride {
            let value = |pixel: usize| frame[pixel * stride + slice];
            order.clear();
            order.extend(0..pixels);
            order.sort_by(|&a, &b| value(a).total_cmp(&value(b)));
            for (rank, &pixel) in order.iter().enumerate() {
                let level = (2 * rank as u64 + 1) * levels / (2 * pixels as u64);
                frame[pixel * stride + slice] = depth.coordinate(level as u16);
            }
        }
    }
    Tile::new(shape, samples).expect("middles of levels are coordinates")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::tile::TileShape;

    #[test]
    fn equal_coordinates_take_turns() {
        let shape = TileShape::new(4, 1, 1, 1, 1).unwrap();
        let tile = Tile::new(shape, vec![0.5, 0.25, 0.5, 0.0]).unwrap();
        let levels: Vec<u16> = exact(&tile, Depth::Eight)
            .samples()
            .iter()
            .map(|&x| Depth::Eight.quantize(x))
            .collect();
        assert_eq!(levels, [160, 96, 224, 32]);
    }

    proptest! {
        #[test]
        fn every_level_stands_equally_often_and_order_stays(
            size in [1_usize..40, 1..40, 1..3, 1..3, 1..3],
            seed: u64,
            coarse: bool,
        ) {
            let [width, height, frames, spp, dims] = size;
            let shape = TileShape::new(width, height, frames, spp, dims).unwrap();
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                let x = (state >> 40) as f32 / (1_u32 << 24) as f32;
                // With ties.
                if coarse { (x * 8.0).floor() / 8.0 } else { x }
            };
            let samples: Vec<f32> = (0..shape.coordinates()).map(|_| next()).collect();
            let tile = Tile::new(shape, samples).unwrap();
            for depth in [Depth::Eight, Depth::Sixteen] {
                let made = exact(&tile, depth);
                for t in 0..frames {
                    for s in 0..spp {
                        for d in 0..dims {
                            let pixels = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
                            let pair = |(x, y)| (tile.point(x, y, t, s)[d], made.point(x, y, t, s)[d]);
                            let mut pairs: Vec<(f32, f32)> = pixels().map(pair).collect();
                            pairs.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.total_cmp(&b.0)));
                            prop_assert!(pairs.windows(2).all(|pair| pair[0].0 <= pair[1].0));
                            let mut counts = vec![0_usize; depth.levels() as usize];
                            for (_, x) in &pairs {
                                counts[usize::from(depth.quantize(*x))] += 1;
                            }
                            let (least, most) = (counts.iter().min(), counts.iter().max());
                            let whole = (width * height) % counts.len() == 0;
                            let differ = most.unwrap() - least.unwrap();
                            prop_assert!(differ <= usize::from(!whole), "{:?}", counts);
                        }
                    }
                }
            }
        }
    }
}
