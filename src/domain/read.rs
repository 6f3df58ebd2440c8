//! A density from a file: a PNG of gray levels, or a `.npy` array of two axes. The file is not trusted.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};

use super::density::{Density, DensityError, MAX_PIXELS};
use crate::array::{ArrayError, ArrayHeader};
use crate::format::png::{self, PixelFormat, Raster};

/// Why a file is no density, in words that follow its name.
type Refusal = String;

/// Reads the density in a file, which is its name.
pub(super) fn read(file: &str) -> Result<Density, Refusal> {
    let failed = |why: std::io::Error| format!("cannot be read: {why}");
    // Asked before opening, because opening a pipe waits for its writer.
    if !std::fs::metadata(file).map_err(failed)?.is_file() {
        return Err("is not a regular file".to_owned());
    }
    let input = File::open(file).map_err(failed)?;
    let bytes = input.metadata().map_err(failed)?.len();
    parse(file, BufReader::new(input), bytes)
}

/// Makes the density of a file of so many bytes.
fn parse(file: &str, mut input: impl BufRead + Seek, bytes: u64) -> Result<Density, Refusal> {
    let start = input.fill_buf().map_err(|why| format!("cannot be read: {why}"))?;
    let (size, levels) = if start.starts_with(png::SIGNATURE) {
        of_png(png::decode(input, bytes).map_err(|error| format!("is refused: {error}"))?)?
    } else if start.starts_with(b"\x93NUMPY") {
        of_array(input, bytes)?
    } else {
        return Err("is neither a PNG nor a .npy file".to_owned());
    };
    Density::new(file, size, &levels).map_err(|error| format!("is refused: {error}"))
}

/// Levels of a PNG, as they are stored.
fn of_png(raster: Raster) -> Result<([usize; 2], Vec<f64>), Refusal> {
    let Raster { width, height, layout, levels, .. } = raster;
    let channels = layout.channels();
    if !matches!(layout, PixelFormat::Gray | PixelFormat::Rgb) {
        return Err("has an alpha channel, but must have gray levels alone".to_owned());
    }
    // Palettes of grays become three equal channels.
    let is_gray = |pixel: &[u16]| pixel.iter().all(|level| *level == pixel[0]);
    if let Some(i) = levels.chunks_exact(channels).position(|pixel| !is_gray(pixel)) {
        let (row, column) = (i / width, i % width);
        return Err(format!("has a color at row {row}, column {column}, but must be gray"));
    }
    Ok(([width, height], levels.iter().step_by(channels).map(|&level| f64::from(level)).collect()))
}

/// Values of an array of two axes, rows and columns.
fn of_array(mut input: impl Read, bytes: u64) -> Result<([usize; 2], Vec<f64>), Refusal> {
    let refuse = |error: ArrayError| format!("is refused: {error}");
    let header = ArrayHeader::read(&mut input, bytes).map_err(refuse)?;
    let &[height, width] = header.shape() else {
        let axes = header.shape().len();
        return Err(format!("has {axes} axes, but must have 2, rows and columns"));
    };
    if header.count() > MAX_PIXELS {
        return Err(format!("is refused: {}", DensityError::Size { width, height }));
    }
    let mut levels = vec![0.0; header.count()];
    let read = header.read_values(input, |place, level| {
        levels[place] = level;
        Ok(())
    });
    read.map_err(refuse)?;
    Ok(([width, height], levels))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;
    use crate::array::array_file;
    use crate::format::png::Depth;

    fn parsed(bytes: &[u8]) -> Result<Density, String> {
        parse("d", BufReader::new(Cursor::new(bytes)), bytes.len() as u64)
    }

    fn array(shape: &str, values: &[f64]) -> Vec<u8> {
        array_file("<f8", shape, &values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
    }

    fn picture(layout: PixelFormat, width: usize, levels: &[u16]) -> Vec<u8> {
        let height = levels.len() / (width * layout.channels());
        let raster =
            Raster { width, height, layout, depth: Depth::Sixteen, levels: levels.to_vec() };
        let mut bytes = Vec::new();
        png::encode(&raster, &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn a_picture_and_an_array_are_the_same_density() {
        let levels = [0, 3, 65535, 7, 0, 1];
        let one = parsed(&picture(PixelFormat::Gray, 3, &levels)).unwrap();
        let other = parsed(&array("(2, 3)", &levels.map(f64::from))).unwrap();
        assert_eq!((one, one.size()), (other, [3, 2]));
        // Ratios count alone.
        let doubled = parsed(&array("(2, 3)", &levels.map(|x| 2.0 * f64::from(x)))).unwrap();
        assert_eq!(doubled, one);
        let gray: Vec<u16> = levels.iter().flat_map(|&x| [x; 3]).collect();
        assert_eq!(parsed(&picture(PixelFormat::Rgb, 3, &gray)).unwrap(), one);
        assert_ne!(parsed(&array("(3, 2)", &levels.map(f64::from))).unwrap(), one);
    }

    #[test]
    fn what_is_no_density_is_refused() {
        let gray = PixelFormat::Gray;
        let row = |values: &[f64]| array(&format!("(1, {})", values.len()), values);
        for (bytes, word) in [
            (b"P5 2 1".to_vec(), "neither a PNG nor a .npy file"),
            (Vec::new(), "neither a PNG nor a .npy file"),
            (picture(gray, 2, &[0, 0]), "only zeros"),
            (picture(gray, 1, &[9]), "1x1 pixels, but must have 2 to 1048576"),
            (picture(PixelFormat::Rgb, 1, &[9, 9, 9, 9, 8, 9]), "a color at row 1, column 0"),
            (picture(PixelFormat::GrayAlpha, 1, &[9, 9, 9, 8]), "an alpha channel"),
            (picture(gray, 1025, &[1; 1025 * 1024]), "1025x1024 pixels"),
            (row(&[1.0, -0.5]), "row 0, column 1 holds -0.5"),
            (row(&[f64::NAN, 1.0]), "row 0, column 0 holds NaN"),
            (row(&[1.0, f64::INFINITY]), "column 1 holds inf"),
            (row(&[0.0, -0.0]), "only zeros"),
            (row(&[]), "0x1 pixels"),
            (array("(1, 2, 1)", &[1.0, 2.0]), "3 axes"),
            (array("(9, 2)", &[1.0, 2.0]), "needs 144 bytes"),
        ] {
            let error = parsed(&bytes).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
        // A header alone costs nothing.
        let header = array("(1048576, 2)", &[]);
        let error =
            parse("d", BufReader::new(Cursor::new(&header)), header.len() as u64 + (1 << 24));
        assert!(error.unwrap_err().contains("2x1048576 pixels"));
        assert!(read("no such file").unwrap_err().contains("cannot be read"));
        assert!(read("/").unwrap_err().contains("not a regular file"));
    }

    proptest! {
        /// A file with a few bytes changed reads or is refused; never a panic.
        #[test]
        fn damaged_densities_get_an_answer(
            damage in prop::collection::vec((any::<usize>(), any::<u8>()), 1..6), is_png: bool,
        ) {
            let mut bytes = match is_png {
                true => picture(PixelFormat::Gray, 2, &[1, 2, 3, 4]),
                false => array("(2, 2)", &[1.0, 2.0, 0.0, 4.0]),
            };
            for (place, byte) in damage {
                let place = place % bytes.len();
                bytes[place] = byte;
            }
            let _ = parsed(&bytes);
        }
    }
}
