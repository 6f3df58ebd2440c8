//! How a picture is cut for jobs: strips of whole rows, of two colours by turns.
//!
//! What a visit changes of the residual reaches over as many rows as the kernel has. Between two
//! strips of one colour lies another one with at least so many, so that the order in which they
//! are done cannot matter. The strips depend on picture and kernel alone, as their order decides
//! which candidates are chosen.

use std::ops::Range;

/// Fewest rows of a strip, so that what lies around it is not most of the work.
const FEWEST: usize = 8;

/// The strips of a picture.
#[derive(Debug, Clone)]
pub(super) struct Strips {
    height: usize,
    rows: usize,
}

/// Strips of one colour never see each other.
pub(super) const COLOURS: usize = 2;

impl Strips {
    /// Cuts a picture for a kernel of so many rows.
    pub fn new(height: usize, kernel_rows: usize) -> Self {
        Self { height, rows: FEWEST.max(kernel_rows.saturating_sub(1)) }
    }

    /// Number of strips.
    pub fn len(&self) -> usize {
        self.height.div_ceil(self.rows)
    }

    /// The rows of a strip.
    pub fn rows(&self, strip: usize) -> Range<usize> {
        strip * self.rows..((strip + 1) * self.rows).min(self.height)
    }

    /// The rows of some strips together.
    pub fn all_rows(&self, strips: &Range<usize>) -> Range<usize> {
        self.rows(strips.start).start..self.rows(strips.end - 1).end
    }

    /// Rows of the largest strip.
    pub fn most_rows(&self) -> usize {
        self.rows.min(self.height)
    }

    /// Those of some strips that have a colour, from above.
    pub fn of_colour(strips: &Range<usize>, colour: usize) -> impl Iterator<Item = usize> + use<> {
        strips.clone().filter(move |strip| strip % COLOURS == colour)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn strips_are_the_picture_and_those_of_a_colour_are_apart(
            height in 1_usize..200, kernel in 1_usize..40,
        ) {
            let strips = Strips::new(height, kernel);
            let all: Vec<usize> = (0..strips.len()).flat_map(|strip| strips.rows(strip)).collect();
            prop_assert_eq!(all, Vec::from_iter(0..height));
            let mut count = 0;
            for colour in 0..COLOURS {
                let of_colour = Strips::of_colour(&(0..strips.len()), colour);
                let rows: Vec<_> = of_colour.map(|strip| strips.rows(strip)).collect();
                count += rows.len();
                prop_assert!(rows.windows(2).all(|pair| pair[0].end + kernel <= pair[1].start + 1));
            }
            prop_assert_eq!(count, strips.len());
        }
    }
}
