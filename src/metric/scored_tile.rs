//! All scores of one tile under its name, as the command prints them and the report shows them.

use std::path::PathBuf;

use serde::Serialize;

use super::error::ScoreError;
use super::quantization::quantized;
use super::scores::{ClassScore, Ratio, ScoreOptions, Scorer, Scores};
use super::spectrum::{ClassSpectra, spectra};
use crate::kernel::KernelTaps;
use crate::tile::{Tile, TileShape};

/// One tile with its scores: as it is, and as integer textures hold it.
#[derive(Debug, Clone, Serialize)]
pub struct ScoredTile {
    /// What the tile is called, other than all tiles beside it.
    pub name: String,
    /// Where it was read; `None` for a comparison tile.
    pub path: Option<PathBuf>,
    /// Its shape.
    pub shape: TileShape,
    /// Its scores.
    pub scores: Scores,
    /// Those after rounding to 8 bits.
    pub after_8_bits: Scores,
    /// Those after rounding to 16 bits.
    pub after_16_bits: Scores,
    /// The spectra of its error, if they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spectra: Option<Vec<ClassSpectra>>,
}

impl ScoredTile {
    /// Scores a tile three times; `scored` is called after each.
    ///
    /// # Errors
    /// A kernel wider than the tile, or a number of integrands out of range.
    pub fn of(
        name: String,
        path: Option<PathBuf>,
        tile: &Tile,
        kernel: &KernelTaps,
        options: ScoreOptions,
        with_spectra: bool,
        scored: impl Fn(),
    ) -> Result<Self, ScoreError> {
        let scorer = Scorer::new(tile.shape(), kernel, options)?;
        let score = |tile: &Tile| {
            let scores = scorer.score(tile);
            scored();
            scores
        };
        // What reads a vector makes it one of length 1 again.
        let rounded = |bits| options.domain.adopt(&quantized(tile, bits));
        Ok(Self {
            scores: score(tile)?,
            after_8_bits: score(&rounded(8)?)?,
            after_16_bits: score(&rounded(16)?)?,
            spectra: with_spectra.then(|| spectra(tile, options)).transpose()?,
            name,
            path,
            shape: tile.shape(),
        })
    }
}

/// One of the scores that are shown for each class of integrands: what it is called, and where it
/// stands in an [`ScoredTile`].
#[derive(Debug, Clone, Copy)]
pub struct ShownScore {
    /// What tables call it.
    pub title: &'static str,
    /// The field of the entry.
    pub field: &'static str,
    /// That field.
    pub scores: fn(&ScoredTile) -> &Scores,
    /// The field of a class's scores.
    pub measure: &'static str,
    /// That field, if the tile has such a score.
    pub ratio: fn(&ClassScore) -> Option<Ratio>,
}

impl ShownScore {
    /// All of them in the order in which they are shown.
    pub const ALL: [Self; 6] = [
        Self {
            title: "perceived error",
            field: "scores",
            scores: |entry| &entry.scores,
            measure: "perceived",
            ratio: |class| Some(class.perceived),
        },
        Self {
            title: "perceived error after 8 bits",
            field: "after_8_bits",
            scores: |entry| &entry.after_8_bits,
            measure: "perceived",
            ratio: |class| Some(class.perceived),
        },
        Self {
            title: "perceived error after 16 bits",
            field: "after_16_bits",
            scores: |entry| &entry.after_16_bits,
            measure: "perceived",
            ratio: |class| Some(class.perceived),
        },
        Self {
            title: "mean of half a period",
            field: "scores",
            scores: |entry| &entry.scores,
            measure: "half_period",
            ratio: |class| class.half_period,
        },
        Self {
            title: "mean of a whole period",
            field: "scores",
            scores: |entry| &entry.scores,
            measure: "whole_period",
            ratio: |class| Some(class.whole_period),
        },
        Self {
            title: "mean of a whole period, perceived",
            field: "scores",
            scores: |entry| &entry.scores,
            measure: "whole_period_perceived",
            ratio: |class| class.whole_period_perceived,
        },
    ];
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::super::baseline::Baseline;
    use super::super::integrand::{Class, Coordinates};
    use super::*;
    use crate::kernel::Tap;

    #[test]
    fn every_part_stands_where_it_says() {
        let shape = TileShape::new(8, 8, 4, 1, 2).unwrap();
        let taps = [0, 1].map(|x| Tap { offset: IVec3::new(x, 0, 0), weight: 1.0 });
        let taps = KernelTaps::new(taps).unwrap();
        let tile = Baseline::White.tile(shape, 1);
        let options = ScoreOptions { set: 1, integrands: 2, ..ScoreOptions::default() };
        let entry = ScoredTile::of("a".into(), None, &tile, &taps, options, false, || ()).unwrap();
        let json = serde_json::to_value(&entry).unwrap();
        for part in ShownScore::ALL {
            let scores = (part.scores)(&entry);
            let edge = scores.class(Class::Edge, Coordinates::All).unwrap();
            let place = scores.classes.iter().position(|class| class == edge).unwrap();
            let pointer = format!("/{}/classes/{place}/{}/mean", part.field, part.measure);
            let mean = (part.ratio)(edge).unwrap().mean;
            assert_eq!(json.pointer(&pointer).unwrap().as_f64(), Some(mean), "{pointer}");
        }
    }
}
