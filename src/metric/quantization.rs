//! A tile as integer textures hold it.

use crate::tile::Tile;

/// The tile after rounding to 8 or 16 bits per coordinate and back: (⌊x·2ᵇ⌋ + ½) / 2ᵇ, the
/// middle of the interval that a stored integer stands for.
///
/// # Panics
/// If `bits` is not 1 to 16; above, the middles are no longer `f32` numbers below 1.
pub fn quantized(tile: &Tile, bits: u32) -> Tile {
    assert!((1..=16).contains(&bits), "{bits} bits per coordinate");
    let levels = (1_u32 << bits) as f32;
    let samples = tile.samples().iter().map(|x| ((x * levels).floor() + 0.5) / levels).collect();
    // x < 1 gives at most (levels − ½) / levels, which is exact: the new samples are in [0, 1).
    Tile::new(tile.shape(), samples).expect("middles of intervals within [0, 1)")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::tile::{BELOW_ONE, TileShape};

    proptest! {
        #[test]
        fn quantizing_moves_by_half_a_step_and_only_once(
            x in 0.0_f32..1.0, bits in 1_u32..=16,
        ) {
            let shape = TileShape::new(2, 1, 1, 1, 1).unwrap();
            let tile = Tile::new(shape, vec![x, BELOW_ONE]).unwrap();
            let once = quantized(&tile, bits);
            let step = 1.0 / (1_u32 << bits) as f32;
            for (a, b) in tile.samples().iter().zip(once.samples()) {
                prop_assert!((a - b).abs() <= step / 2.0);
                let level = b / step - 0.5;
                prop_assert!(level == level.round());
            }
            prop_assert_eq!(quantized(&once, bits), once);
        }
    }
}
