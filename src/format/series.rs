//! Puts the files of a folder of slices in order, by the numbers in their names.
//!
//! Names sort by the value of their numbers, so `_2` stands before `_10`. All names must be one
//! name but for the numbers, and no slice may be missing: a folder with two series in it, or with
//! a gap, would give a tile that looks right and is not.

use std::collections::BTreeSet;

use thiserror::Error;

/// Why file names are not those of the slices of one tile.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum SeriesError {
    /// Two names differ in more than numbers.
    #[error("{first:?} and {other:?} do not belong to one series of slices")]
    Mixed {
        /// A name.
        first: String,
        /// One with other text around its numbers.
        other: String,
    },
    /// A number that no slice has.
    #[error("the number in {name:?} is too large for a slice")]
    Number {
        /// The name.
        name: String,
    },
    /// Two names have the same numbers.
    #[error("{first:?} and {other:?} have the same number")]
    Twice {
        /// A name.
        first: String,
        /// One that differs in leading zeros only.
        other: String,
    },
    /// More than one number differs between slices, and nothing says which is which.
    #[error(
        "{first:?} and {other:?} differ in more than one number, which only names like \
         `tile_f000_s00_d00.png` (frame, sample, dimension) may"
    )]
    Ambiguous {
        /// The first name in order.
        first: String,
        /// The last name in order.
        other: String,
    },
    /// A slice is missing.
    #[error("{found} slices lie from {first:?} to {last:?}, but {expected} should")]
    Gap {
        /// The first name in order.
        first: String,
        /// The last name in order.
        last: String,
        /// Slices that the numbers promise.
        expected: u64,
        /// Slices that there are.
        found: usize,
    },
}

/// The slices of a tile in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Series {
    /// File names: frame by frame, within it sample by sample, within it by group of dimensions.
    pub names: Vec<String>,
    /// Samples per pixel and the first dimension of each group, if the names say them.
    pub layout: Option<SeriesLayout>,
}

/// What names like `tile_f000_s00_d00.png` say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SeriesLayout {
    /// Samples per pixel.
    pub spp: usize,
    /// The first dimension of each file of a sample, rising from 0.
    pub first_dims: Vec<usize>,
}

impl Series {
    /// Orders the names of the files of one tile.
    ///
    /// Names in which a single number changes are slices in its order, without gaps. Names that
    /// end like `_f000_s00_d00.png` are frames, samples and groups of dimensions, all of them
    /// there.
    ///
    /// # Errors
    /// Any [`SeriesError`].
    pub fn new(names: Vec<String>) -> Result<Self, SeriesError> {
        let mut parsed = names.into_iter().map(SliceName::parse).collect::<Result<Vec<_>, _>>()?;
        parsed.sort_by(|a, b| (&a.numbers, &a.whole).cmp(&(&b.numbers, &b.whole)));
        let (Some(first), Some(last)) = (parsed.first(), parsed.last()) else {
            return Ok(Self { names: Vec::new(), layout: None });
        };
        if let Some(other) = parsed.iter().find(|name| name.text != first.text) {
            return Err(SeriesError::Mixed {
                first: first.whole.clone(),
                other: other.whole.clone(),
            });
        }
        if let Some(pair) = parsed.windows(2).find(|pair| pair[0].numbers == pair[1].numbers) {
            return Err(SeriesError::Twice {
                first: pair[0].whole.clone(),
                other: pair[1].whole.clone(),
            });
        }

        let columns = first.numbers.len();
        let values: Vec<BTreeSet<u64>> = (0..columns)
            .map(|column| parsed.iter().map(|name| name.numbers[column]).collect())
            .collect();
        let varying: Vec<usize> = (0..columns).filter(|&column| values[column].len() > 1).collect();
        let own = first.is_own() && varying.iter().all(|&column| column + 3 >= columns);
        let counted = if own { &[columns - 3, columns - 2][..] } else { &varying[..] };
        if !own && varying.len() > 1 {
            return Err(SeriesError::Ambiguous {
                first: first.whole.clone(),
                other: last.whole.clone(),
            });
        }
        // Numbers without gaps, in every combination.
        let expected = counted
            .iter()
            .map(|&column| last.numbers[column].abs_diff(first.numbers[column]).saturating_add(1))
            .chain(own.then(|| values[columns - 1].len() as u64))
            .fold(1, u64::saturating_mul);
        if expected != parsed.len() as u64 {
            return Err(SeriesError::Gap {
                first: first.whole.clone(),
                last: last.whole.clone(),
                expected,
                found: parsed.len(),
            });
        }
        let layout = own.then(|| SeriesLayout {
            spp: values[columns - 2].len(),
            first_dims: values[columns - 1].iter().map(|&dim| dim as usize).collect(),
        });
        Ok(Self { names: parsed.into_iter().map(|name| name.whole).collect(), layout })
    }
}

/// A file name, taken apart into its numbers and the text around them.
struct SliceName {
    whole: String,
    /// One more than numbers; text may be empty.
    text: Vec<String>,
    numbers: Vec<u64>,
}

impl SliceName {
    fn parse(whole: String) -> Result<Self, SeriesError> {
        let mut text = vec![String::new()];
        let mut numbers = Vec::new();
        let mut rest = whole.as_str();
        while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
            let end = rest[start..]
                .find(|c: char| !c.is_ascii_digit())
                .map_or(rest.len(), |length| start + length);
            let Ok(number) = rest[start..end].parse() else {
                return Err(SeriesError::Number { name: whole });
            };
            numbers.push(number);
            if let Some(last) = text.last_mut() {
                last.push_str(&rest[..start]);
            }
            text.push(String::new());
            rest = &rest[end..];
        }
        if let Some(last) = text.last_mut() {
            last.push_str(rest);
        }
        Ok(Self { whole, text, numbers })
    }

    /// Whether the name ends like `_f000_s00_d00.png`.
    fn is_own(&self) -> bool {
        matches!(
            &self.text[..],
            [.., frame, sample, dim, end]
                if frame.ends_with("_f") && sample == "_s" && dim == "_d" && !end.contains('_')
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn order(names: &[&str]) -> Result<Series, SeriesError> {
        Series::new(names.iter().map(|name| name.to_string()).collect())
    }

    #[test]
    fn numbers_sort_by_value() {
        let series = order(&["n_10.png", "n_9.png", "n_8.png", "n_11.png"]).unwrap();
        assert_eq!(series.names, ["n_8.png", "n_9.png", "n_10.png", "n_11.png"]);
        assert_eq!(series.layout, None);
        // Numbers that do not change take no part.
        let series = order(&["a2_128x128x64_1.png", "a2_128x128x64_0.png"]).unwrap();
        assert_eq!(series.names, ["a2_128x128x64_0.png", "a2_128x128x64_1.png"]);
        assert_eq!(order(&["plain.png"]).unwrap().names, ["plain.png"]);
        assert_eq!(order(&[]).unwrap().names, [""; 0]);
    }

    #[test]
    fn what_is_not_one_series_is_refused() {
        assert!(matches!(order(&["a_0.png", "b_1.png"]), Err(SeriesError::Mixed { .. })));
        assert!(matches!(order(&["a.png", "b.png"]), Err(SeriesError::Mixed { .. })));
        assert!(matches!(order(&["a_1.png", "a_01.png"]), Err(SeriesError::Twice { .. })));
        assert_eq!(
            order(&["a_0.png", "a_1.png", "a_3.png"]),
            Err(SeriesError::Gap {
                first: "a_0.png".into(),
                last: "a_3.png".into(),
                expected: 4,
                found: 3
            })
        );
        let far = ["a_0.png", "a_18446744073709551615.png"];
        assert!(matches!(order(&far), Err(SeriesError::Gap { .. })));
        let huge = ["a_18446744073709551616.png"];
        assert!(matches!(order(&huge), Err(SeriesError::Number { .. })));
        let grid = ["a_0_0.png", "a_0_1.png", "a_1_0.png", "a_1_1.png"];
        assert!(matches!(order(&grid), Err(SeriesError::Ambiguous { .. })));
    }

    #[test]
    fn a_missing_file_of_a_grid_is_noticed() {
        let names: Vec<String> = (0..12)
            .map(|i| format!("t_f{:03}_s{:02}_d{:02}.png", i / 4, i / 2 % 2, i % 2 * 2))
            .collect();
        let series = Series::new(names.clone()).unwrap();
        assert_eq!(series.layout, Some(SeriesLayout { spp: 2, first_dims: vec![0, 2] }));
        for missing in 0..12 {
            let mut some = names.clone();
            some.remove(missing);
            assert!(matches!(Series::new(some), Err(SeriesError::Gap { .. })), "{missing}");
        }
    }

    proptest! {
        #[test]
        fn any_order_of_files_gives_the_same(
            count in 1_usize..40,
            digits in 1_usize..4,
            seed in any::<u64>(),
        ) {
            let sorted: Vec<String> =
                (0..count).map(|i| format!("x{i:0digits$}.png")).collect();
            let mut shuffled = sorted.clone();
            shuffled.sort_by_key(|name| {
                name.bytes().fold(seed, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3))
            });
            prop_assert_eq!(Series::new(shuffled).unwrap().names, sorted);
        }

        #[test]
        fn no_names_are_a_panic(names in proptest::collection::vec("[a-c_fsd0-2é.]{0,12}", 0..6)) {
            let _ = Series::new(names);
        }
    }
}
