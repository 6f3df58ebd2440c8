//! Letters of 5×7 dots for the labels of a picture, so that no font need be found or linked.
//!
//! Only what labels say is there: small letters, digits, X and T, and a little punctuation. The
//! lowest two rows of the nine belong to the tails of g, j, p, q and y.

/// Dots across a letter.
pub(super) const WIDTH: usize = 5;
/// Dots from one letter to the next.
pub(super) const ADVANCE: usize = WIDTH + 1;
/// Dots down a letter, its tail included.
pub(super) const HEIGHT: usize = 9;

/// Rows of a letter from the top; the highest of five bits is the leftmost dot.
pub(super) type Glyph = [u8; HEIGHT];

/// The dots of a character, if it has some.
pub(super) fn glyph(character: char) -> Option<Glyph> {
    let rows = match character {
        ' ' => [0, 0, 0, 0, 0, 0, 0, 0, 0],
        'a' => [0, 0, 14, 1, 15, 17, 15, 0, 0],
        'b' => [16, 16, 22, 25, 17, 17, 30, 0, 0],
        'c' => [0, 0, 14, 16, 16, 17, 14, 0, 0],
        'd' => [1, 1, 13, 19, 17, 17, 15, 0, 0],
        'e' => [0, 0, 14, 17, 31, 16, 14, 0, 0],
        'f' => [6, 9, 8, 28, 8, 8, 8, 0, 0],
        'g' => [0, 0, 15, 17, 17, 17, 15, 1, 14],
        'h' => [16, 16, 22, 25, 17, 17, 17, 0, 0],
        'i' => [4, 0, 12, 4, 4, 4, 14, 0, 0],
        'j' => [2, 0, 6, 2, 2, 2, 2, 18, 12],
        'k' => [16, 16, 18, 20, 24, 20, 18, 0, 0],
        'l' => [12, 4, 4, 4, 4, 4, 14, 0, 0],
        'm' => [0, 0, 26, 21, 21, 21, 21, 0, 0],
        'n' => [0, 0, 22, 25, 17, 17, 17, 0, 0],
        'o' => [0, 0, 14, 17, 17, 17, 14, 0, 0],
        'p' => [0, 0, 30, 17, 17, 17, 30, 16, 16],
        'q' => [0, 0, 15, 17, 17, 17, 15, 1, 1],
        'r' => [0, 0, 22, 25, 16, 16, 16, 0, 0],
        's' => [0, 0, 15, 16, 14, 1, 30, 0, 0],
        't' => [8, 8, 28, 8, 8, 9, 6, 0, 0],
        'u' => [0, 0, 17, 17, 17, 19, 13, 0, 0],
        'v' => [0, 0, 17, 17, 17, 10, 4, 0, 0],
        'w' => [0, 0, 17, 17, 21, 21, 10, 0, 0],
        'x' => [0, 0, 17, 10, 4, 10, 17, 0, 0],
        'y' => [0, 0, 17, 17, 17, 17, 15, 1, 14],
        'z' => [0, 0, 31, 2, 4, 8, 31, 0, 0],
        'T' => [31, 4, 4, 4, 4, 4, 4, 0, 0],
        'X' => [17, 17, 10, 4, 10, 17, 17, 0, 0],
        '0' => [14, 17, 19, 21, 25, 17, 14, 0, 0],
        '1' => [4, 12, 4, 4, 4, 4, 14, 0, 0],
        '2' => [14, 17, 1, 6, 8, 16, 31, 0, 0],
        '3' => [31, 2, 4, 2, 1, 17, 14, 0, 0],
        '4' => [2, 6, 10, 18, 31, 2, 2, 0, 0],
        '5' => [31, 16, 30, 1, 1, 17, 14, 0, 0],
        '6' => [6, 8, 16, 30, 17, 17, 14, 0, 0],
        '7' => [31, 1, 2, 4, 8, 8, 8, 0, 0],
        '8' => [14, 17, 17, 14, 17, 17, 14, 0, 0],
        '9' => [14, 17, 17, 15, 1, 2, 12, 0, 0],
        '(' => [2, 4, 8, 8, 8, 4, 2, 0, 0],
        ')' => [8, 4, 2, 2, 2, 4, 8, 0, 0],
        ',' => [0, 0, 0, 0, 0, 12, 12, 4, 8],
        '.' => [0, 0, 0, 0, 0, 12, 12, 0, 0],
        ':' => [0, 12, 12, 0, 12, 12, 0, 0, 0],
        '-' => [0, 0, 0, 31, 0, 0, 0, 0, 0],
        _ => return None,
    };
    Some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_differ_and_stay_in_their_boxes() {
        let known: Vec<(char, Glyph)> =
            (' '..='~').filter_map(|letter| Some((letter, glyph(letter)?))).collect();
        assert!(('a'..='z').chain('0'..='9').all(|letter| glyph(letter).is_some()));
        for (i, (letter, rows)) in known.iter().enumerate() {
            assert!(rows.iter().all(|row| *row < 1 << WIDTH), "{letter}");
            for (other, others) in &known[..i] {
                assert_ne!(rows, others, "{letter} and {other}");
            }
        }
        assert_eq!(glyph('§'), None);
    }
}
