//! The size of a tile as users type it.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::tile::{ShapeError, TileShape};

/// Width × height × frames of a tile, written `128x128x30`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TileSize(pub [usize; 3]);

impl TileSize {
    /// The shape of a tile of this size.
    ///
    /// # Errors
    /// A size of 0, or too large.
    pub fn shape(self, spp: usize, dims: usize) -> Result<TileShape, ShapeError> {
        let Self([width, height, frames]) = self;
        TileShape::new(width, height, frames, spp, dims)
    }
}

impl FromStr for TileSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sizes: Option<Vec<usize>> = text.split('x').map(|part| part.parse().ok()).collect();
        sizes
            .and_then(|sizes| sizes.try_into().ok())
            .map(Self)
            .ok_or_else(|| format!("`{text}` is not width x height x frames, such as 128x128x30"))
    }
}

impl TryFrom<String> for TileSize {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<TileSize> for String {
    fn from(TileSize([width, height, frames]): TileSize) -> Self {
        format!("{width}x{height}x{frames}")
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn sizes_are_read_as_they_are_written(width: usize, height: usize, frames: usize) {
            let size = TileSize([width, height, frames]);
            prop_assert_eq!(String::from(size).parse(), Ok(size));
        }

        #[test]
        fn no_text_makes_a_size_panic(text: String) {
            let _ = text.parse::<TileSize>();
        }
    }
}
