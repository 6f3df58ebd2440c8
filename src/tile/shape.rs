//! How large a tile is, and where a pixel lies in it.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Most samples per pixel.
pub const MAX_SPP: usize = 64;
/// Most dimensions of a sample.
pub const MAX_DIMS: usize = 16;

/// Why five numbers are not the shape of a tile.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum ShapeError {
    /// A size is zero.
    #[error("{name} is 0, but a tile needs at least 1")]
    Zero {
        /// Which size.
        name: &'static str,
    },
    /// A size is above its limit.
    #[error("{name} is {value}, but at most {limit} is allowed")]
    Limit {
        /// Which size.
        name: &'static str,
        /// What was asked for.
        value: usize,
        /// The largest allowed.
        limit: usize,
    },
    /// The product of the sizes does not fit the machine's memory addresses.
    #[error(
        "a tile of {width}x{height}x{frames} with {spp} spp and {dims} dims has more coordinates than memory can address"
    )]
    Overflow {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Frames.
        frames: usize,
        /// Samples per pixel.
        spp: usize,
        /// Dimensions per sample.
        dims: usize,
    },
}

/// The size of a tile: pixels across and down, frames, samples per pixel, dimensions.
///
/// Every size is at least 1, `spp` at most [`MAX_SPP`], `dims` at most [`MAX_DIMS`], and the
/// product of all, as `f32`, is addressable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "RawShape", into = "RawShape")]
pub struct TileShape {
    width: usize,
    height: usize,
    frames: usize,
    spp: usize,
    dims: usize,
}

impl TileShape {
    /// Checks the sizes.
    ///
    /// # Errors
    /// The first rule that they break.
    pub fn new(
        width: usize,
        height: usize,
        frames: usize,
        spp: usize,
        dims: usize,
    ) -> Result<Self, ShapeError> {
        const MAX_SIDE: usize = 1 << 20;
        for (name, value, limit) in [
            ("width", width, MAX_SIDE),
            ("height", height, MAX_SIDE),
            ("frames", frames, MAX_SIDE),
            ("spp", spp, MAX_SPP),
            ("dims", dims, MAX_DIMS),
        ] {
            if value == 0 {
                return Err(ShapeError::Zero { name });
            }
            if value > limit {
                return Err(ShapeError::Limit { name, value, limit });
            }
        }
        [width, height, frames, spp, dims, size_of::<f32>()]
            .into_iter()
            .try_fold(1_usize, usize::checked_mul)
            .filter(|&bytes| bytes <= isize::MAX as usize)
            .map(|_| Self { width, height, frames, spp, dims })
            .ok_or(ShapeError::Overflow { width, height, frames, spp, dims })
    }

    /// The shape with at most as many samples per pixel.
    pub(super) fn with_spp(self, spp: usize) -> Self {
        debug_assert!((1..=self.spp).contains(&spp));
        Self { spp, ..self }
    }

    /// The shape with at most as many frames.
    pub(super) fn with_frames(self, frames: usize) -> Self {
        debug_assert!((1..=self.frames).contains(&frames));
        Self { frames, ..self }
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Samples per pixel.
    pub fn spp(&self) -> usize {
        self.spp
    }

    /// Dimensions per sample.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// Pixels in all frames together: `width · height · frames`.
    pub fn pixels(&self) -> usize {
        self.width * self.height * self.frames
    }

    /// Samples in all pixels together: `pixels · spp`.
    pub fn samples(&self) -> usize {
        self.pixels() * self.spp
    }

    /// Numbers in the tile: `samples · dims`.
    pub fn coordinates(&self) -> usize {
        self.samples() * self.dims
    }

    /// Position of pixel `(x, y)` of frame `t` among the pixels in C order.
    ///
    /// # Panics
    /// If it is outside the tile.
    pub fn pixel(&self, x: usize, y: usize, t: usize) -> usize {
        assert!(
            x < self.width && y < self.height && t < self.frames,
            "pixel ({x}, {y}, {t}) of {self}"
        );
        (t * self.height + y) * self.width + x
    }
}

/// `64x64x16, 1 spp, 2 dims`
impl fmt::Display for TileShape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { width, height, frames, spp, dims } = self;
        write!(f, "{width}x{height}x{frames}, {spp} spp, {dims} dims")
    }
}

/// The sizes as files hold them, unchecked.
#[derive(Serialize, Deserialize)]
struct RawShape {
    width: usize,
    height: usize,
    frames: usize,
    spp: usize,
    dims: usize,
}

impl TryFrom<RawShape> for TileShape {
    type Error = ShapeError;

    fn try_from(raw: RawShape) -> Result<Self, ShapeError> {
        Self::new(raw.width, raw.height, raw.frames, raw.spp, raw.dims)
    }
}

impl From<TileShape> for RawShape {
    fn from(shape: TileShape) -> Self {
        let TileShape { width, height, frames, spp, dims } = shape;
        Self { width, height, frames, spp, dims }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_checked() {
        assert!(TileShape::new(64, 64, 16, 1, 2).is_ok());
        assert_eq!(TileShape::new(0, 64, 16, 1, 2), Err(ShapeError::Zero { name: "width" }));
        assert!(matches!(
            TileShape::new(64, 64, 16, 65, 2),
            Err(ShapeError::Limit { name: "spp", value: 65, limit: 64 })
        ));
        assert!(matches!(
            TileShape::new(1 << 20, 1 << 20, 1 << 20, 64, 16),
            Err(ShapeError::Overflow { .. })
        ));
    }

    #[test]
    fn pixels_lie_in_c_order() {
        let shape = TileShape::new(5, 3, 2, 1, 1).unwrap();
        let mut seen = 0;
        for t in 0..2 {
            for y in 0..3 {
                for x in 0..5 {
                    assert_eq!(shape.pixel(x, y, t), seen);
                    seen += 1;
                }
            }
        }
        assert_eq!(seen, shape.pixels());
    }
}
