//! White paper for panels and their labels.

use super::font;
use crate::format::picture::Image;

/// A colour.
pub type Rgb = [u8; 3];

/// Side of a dot of a letter.
const DOT: usize = 2;
/// Pixels down a line of text.
pub const LINE: usize = font::HEIGHT * DOT;
const PAPER: Rgb = [255; 3];
const INK: Rgb = [28, 27, 25];

/// An RGB picture that is being drawn.
#[derive(Debug)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
}

impl Canvas {
    /// White paper of a size.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![PAPER; width * height] }
    }

    /// Fills the part of a rectangle that lies inside.
    pub fn fill(&mut self, [left, top]: [usize; 2], [width, height]: [usize; 2], colour: Rgb) {
        let columns = left.min(self.width)..(left + width).min(self.width);
        for y in top..(top + height).min(self.height) {
            self.pixels[y * self.width..][columns.clone()].fill(colour);
        }
    }

    /// Writes a line of text from its upper left corner on. A character without dots is a gap.
    pub fn text(&mut self, [left, top]: [usize; 2], text: &str) {
        for (place, rows) in text.chars().map(font::glyph).enumerate() {
            for (y, row) in rows.into_iter().flatten().enumerate() {
                for x in (0..font::WIDTH).filter(|x| row >> (font::WIDTH - 1 - x) & 1 == 1) {
                    let at = [left + DOT * (place * font::ADVANCE + x), top + DOT * y];
                    self.fill(at, [DOT; 2], INK);
                }
            }
        }
    }

    /// The picture that has been drawn.
    ///
    /// # Panics
    /// If it has no pixels.
    pub fn into_image(self) -> Image {
        let data = self.pixels.into_iter().flatten().collect();
        Image::new(self.width, self.height, 3, data).expect("a canvas has pixels")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_stand_where_they_are_written() {
        let mut canvas = Canvas::new(40, 30);
        canvas.text([4, 6], "T.");
        let image = canvas.into_image();
        // The beam of the T, its foot, and the white beside it.
        for x in 4..14 {
            assert_eq!(image.pixel(x, 6), INK);
        }
        assert_eq!(image.pixel(9, 19), INK);
        assert_eq!(image.pixel(4, 10), PAPER);
        // The second letter begins six dots on.
        assert_eq!(image.pixel(4 + 12 + 2, 6 + 10), INK);
    }

    #[test]
    fn what_reaches_beyond_the_paper_is_cut() {
        let mut canvas = Canvas::new(3, 3);
        canvas.fill([2, 2], [9, 9], [0; 3]);
        canvas.fill([7, 0], [1, 1], [0; 3]);
        let image = canvas.into_image();
        assert_eq!(image.pixel(2, 2), [0; 3]);
        assert_eq!(image.data().iter().filter(|&&level| level == 0).count(), 3);
    }
}
