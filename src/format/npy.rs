//! Tiles as `.npy` files: our own out, and our own and foreign ones in.

use std::io::{self, Read, Write};

use thiserror::Error;

use super::numbers::{ArraySource, NumberSink, NumberWriter};
use super::png::Depth;
use crate::array::{self, ArrayError, ArrayHeader, ElementKind};
use crate::tile::{ShapeError, Tile, TileShape, clamp_coordinate};

/// Why a `.npy` file is not a tile.
#[derive(Debug, Error)]
pub enum NpyError {
    /// There is no array that can be read.
    #[error(transparent)]
    Array(#[from] ArrayError),
    /// The machine refuses the memory for the values.
    #[error("{values} values do not fit in memory")]
    Memory {
        /// Numbers to be kept.
        values: usize,
    },
    /// A number of axes that says nothing about tiles.
    #[error(
        "shape {shape:?} has {} axes, but a tile has (frames, height, width), \
         (frames, height, width, dims) or (frames, height, width, spp, dims)",
        shape.len()
    )]
    Axes {
        /// Sizes in the header.
        shape: Vec<usize>,
    },
    /// The samples per pixel asked for contradict the shape.
    #[error("shape {shape:?} cannot hold {spp} samples per pixel")]
    Spp {
        /// Sizes in the header.
        shape: Vec<usize>,
        /// Samples per pixel asked for.
        spp: usize,
    },
    /// The sizes are not those of a tile.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A value that is no coordinate.
    #[error("the value at {index:?} is {value}, but every coordinate must be in [0, 1)")]
    Coordinate {
        /// Position along each axis of the file.
        index: Vec<usize>,
        /// The value there.
        value: f64,
    },
}

impl ArraySource for Tile {
    fn array(&self, _: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        sink.put(self.samples())
    }
}

/// Writes a tile as little-endian `f32` of shape `(frames, height, width, spp, dims)`, C order.
///
/// The bytes depend on the tile alone.
///
/// # Errors
/// What `out` reports.
pub fn write_tile(tile: &Tile, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    write_pieces(tile.shape(), out, tile)
}

/// Writes a tile, with the same bytes as [`write_tile`], whose coordinates come in pieces: they are
/// array 0 of `tile`, in C order.
///
/// # Errors
/// What `out` or `tile` reports, and [`io::ErrorKind::InvalidData`] if there are more coordinates
/// than the shape has, or fewer, or a number that is none.
pub fn write_pieces(
    shape: TileShape,
    out: &mut (impl Write + ?Sized),
    tile: &dyn ArraySource,
) -> io::Result<()> {
    let axes = [shape.frames(), shape.height(), shape.width(), shape.spp(), shape.dims()];
    array::write_header(&axes, out)?;
    let mut stray = None;
    let mut writer = NumberWriter::new(out, shape.coordinates() as u64);
    tile.array(0, &mut |piece: &[f32]| {
        stray = stray.or_else(|| piece.iter().copied().find(|x| !(0.0..1.0).contains(x)));
        writer.put(piece)
    })?;
    writer.finish()?;
    match stray {
        Some(x) => {
            let message = format!("a coordinate is {x}, but every one must be in [0, 1)");
            Err(io::Error::new(io::ErrorKind::InvalidData, message))
        }
        None => Ok(()),
    }
}

/// Writes a tile as unsigned integers of 8 or 16 bits, little-endian, of the same shape: the levels of its
/// coordinates.
///
/// # Errors
/// What `out` reports.
pub fn write_levels(tile: &Tile, depth: Depth, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    /// Coordinates that are written at a time.
    const BLOCK: usize = 1 << 15;
    let shape = tile.shape();
    let axes = [shape.frames(), shape.height(), shape.width(), shape.spp(), shape.dims()];
    let kind = match depth {
        Depth::Eight => ElementKind::U8,
        Depth::Sixteen => ElementKind::U16,
    };
    array::write_header_of(kind, &axes, out)?;
    for block in tile.samples().chunks(BLOCK) {
        let levels = block.iter().map(|&x| depth.quantize(x).to_le_bytes());
        let bytes: Vec<u8> =
            levels.flat_map(|level| level.into_iter().take(depth.bytes())).collect();
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// Whether a `.npy` file has integers, which are levels of coordinates.
pub(super) fn has_levels(mut input: impl Read, bytes: u64) -> bool {
    let header = ArrayHeader::read(&mut input, bytes);
    header.is_ok_and(|it| matches!(it.kind(), ElementKind::U8 | ElementKind::U16))
}

/// Reads a tile: one of ours exactly, or a foreign one.
///
/// `input` is the whole file of `bytes` bytes. Axes are `(frames, height, width)`,
/// `(frames, height, width, dims)` or `(frames, height, width, spp, dims)`, in C or Fortran
/// order; with four axes, `spp` splits the last one into samples of `size / spp` dimensions.
/// Elements of either byte order are floats of 16, 32 or 64 bits, which must be in `[0, 1]` (1
/// itself, and what rounds to it, becomes the largest `f32` below 1; −0 becomes 0), or unsigned
/// integers of 8 or 16 bits, where b stands for the middle of its bin, (b + 1/2)/256 or
/// (b + 1/2)/65536.
///
/// # Errors
/// Any [`NpyError`]: the file is damaged or contradicts itself, its shape is no tile's or
/// contradicts `spp`, or a value is no coordinate.
pub fn read_tile(mut input: impl Read, bytes: u64, spp: Option<usize>) -> Result<Tile, NpyError> {
    let header = ArrayHeader::read(&mut input, bytes)?;
    let shape = tile_shape(header.shape(), spp)?;
    let count = header.count();
    let mut samples = Vec::new();
    samples.try_reserve_exact(count).map_err(|_| NpyError::Memory { values: count })?;
    samples.resize(count, 0.0_f32);
    header.read_values(input, |place, value| {
        samples[place] = coordinate(header.kind(), value)
            .ok_or_else(|| NpyError::Coordinate { index: header.index_of(place), value })?;
        Ok::<(), NpyError>(())
    })?;
    Ok(Tile::new(shape, samples).expect("every coordinate was brought into [0, 1)"))
}

/// The coordinate that an element stands for.
fn coordinate(kind: ElementKind, value: f64) -> Option<f32> {
    match kind {
        ElementKind::U8 => Some(((value + 0.5) / 256.0) as f32),
        ElementKind::U16 => Some(((value + 0.5) / 65536.0) as f32),
        ElementKind::F16 | ElementKind::F32 | ElementKind::F64 => {
            (0.0..=1.0).contains(&value).then(|| clamp_coordinate(value as f32))
        }
    }
}

/// The tile that an array of this shape is.
fn tile_shape(shape: &[usize], spp: Option<usize>) -> Result<TileShape, NpyError> {
    let wrong_spp = |spp| NpyError::Spp { shape: shape.to_vec(), spp };
    let (frames, height, width, held, dims) = match *shape {
        [frames, height, width] => (frames, height, width, 1, 1),
        [frames, height, width, values] => {
            let spp = spp.unwrap_or(1);
            if spp == 0 || !values.is_multiple_of(spp) {
                return Err(wrong_spp(spp));
            }
            (frames, height, width, spp, values / spp)
        }
        [frames, height, width, spp, dims] => (frames, height, width, spp, dims),
        _ => return Err(NpyError::Axes { shape: shape.to_vec() }),
    };
    match spp {
        Some(spp) if spp != held => Err(wrong_spp(spp)),
        _ => Ok(TileShape::new(width, height, frames, held, dims)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::array::{array_file, file};
    use crate::tile::BELOW_ONE;

    fn read(bytes: &[u8]) -> Result<Tile, NpyError> {
        read_tile(bytes, bytes.len() as u64, None)
    }

    fn floats(values: &[f64]) -> Vec<u8> {
        let data: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        array_file("<f8", &format!("(1, 1, {})", values.len()), &data)
    }

    #[test]
    fn coordinates_are_checked_and_brought_into_range() {
        let tile = read(&array_file(">f2", "(1, 1, 2)", &[0x38, 0x00, 0x3c, 0x00])).unwrap();
        assert_eq!(tile.samples(), [0.5, BELOW_ONE]);
        let tile = read(&array_file(">u2", "(1, 1, 2)", &[0x13, 0x88, 0xff, 0xff])).unwrap();
        assert_eq!(tile.samples(), [5000.5 / 65536.0, 65535.5 / 65536.0]);
        let tile = read(&floats(&[0.0, -0.0, 0.1, 1.0 - 1e-12, 1.0])).unwrap();
        let bits: Vec<u32> = tile.samples().iter().map(|x| x.to_bits()).collect();
        assert_eq!(bits, [0.0, 0.0, 0.1, BELOW_ONE, BELOW_ONE].map(f32::to_bits));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.0 + 1e-15, -1e-300, 255.0] {
            match read(&floats(&[0.5, 0.5, bad])).unwrap_err() {
                NpyError::Coordinate { index, value } => {
                    assert_eq!(index, [0, 0, 2]);
                    assert_eq!(value.to_bits(), bad.to_bits());
                }
                other => panic!("{other}"),
            }
        }
        let fortran = "{'descr': '<f4', 'fortran_order': True, 'shape': (1, 2, 3), }";
        let data: Vec<u8> =
            [0.0, 0.0, 0.0, 7.0, 0.0, 0.0_f32].iter().flat_map(|x| x.to_le_bytes()).collect();
        let error = read(&file(fortran, &data)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the value at [0, 1, 1] is 7, but every coordinate must be in [0, 1)"
        );
    }

    #[test]
    fn samples_per_pixel_split_the_last_axis_of_four() {
        let bytes = array_file("|u1", "(1, 1, 1, 6)", &[0, 1, 2, 3, 4, 5]);
        let spp = |bytes: &[u8], spp| read_tile(bytes, bytes.len() as u64, Some(spp));
        let tile = spp(&bytes, 2).unwrap();
        assert_eq!(tile.shape(), TileShape::new(1, 1, 1, 2, 3).unwrap());
        assert_eq!(tile.point(0, 0, 0, 1), [3.5 / 256.0, 4.5 / 256.0, 5.5 / 256.0]);
        assert!(matches!(spp(&bytes, 4), Err(NpyError::Spp { spp: 4, .. })));
        assert!(matches!(spp(&bytes, 0), Err(NpyError::Spp { spp: 0, .. })));
        let three = array_file("|u1", "(1, 1, 2)", &[0, 1]);
        assert!(spp(&three, 1).is_ok() && spp(&three, 2).is_err());
        let five = array_file("|u1", "(1, 1, 1, 2, 1)", &[0, 1]);
        assert!(spp(&five, 2).is_ok() && spp(&five, 1).is_err());
    }

    #[test]
    fn sizes_that_are_no_tile_are_refused() {
        for (axes, shape) in [("1 axes", "(8,)"), ("6 axes", "(1, 1, 1, 1, 2, 4)")] {
            let error = read(&array_file("|u1", shape, &[0; 8])).unwrap_err().to_string();
            assert!(error.contains(axes), "{error}");
        }
        let empty = array_file("<f4", "(0, 4, 4)", &[]);
        assert!(matches!(read(&empty), Err(NpyError::Shape(ShapeError::Zero { .. }))));
        let many = array_file("|u1", "(1, 1, 1, 17)", &[0; 17]);
        assert!(matches!(read(&many), Err(NpyError::Shape(ShapeError::Limit { .. }))));
    }

    #[test]
    fn coordinates_in_pieces_make_the_file_of_the_whole() {
        let shape = TileShape::new(5, 4, 3, 2, 3).unwrap();
        let count = shape.coordinates();
        let samples: Vec<f32> = (0..count).map(|i| i as f32 / count as f32).collect();
        let give = |samples: &[f32], size: usize| {
            let mut bytes = Vec::new();
            let pieces = |_: usize, sink: &mut dyn NumberSink| {
                samples.chunks(size).try_for_each(|piece| sink.put(piece))
            };
            let result = write_pieces(shape, &mut bytes, &pieces);
            result.map(|()| bytes).map_err(|error| (error.kind(), error.to_string()))
        };
        let data: Vec<u8> = samples.iter().flat_map(|x| x.to_le_bytes()).collect();
        let mut whole = Vec::new();
        write_tile(&Tile::new(shape, samples.clone()).unwrap(), &mut whole).unwrap();
        assert_eq!(whole[whole.len() - data.len()..], data);
        for size in [1, 7, 30, count - 1, count] {
            assert_eq!(give(&samples, size).unwrap(), whole);
            let (few, more) = (&samples[1..], [&samples[..], &[0.5]].concat());
            for (wrong, part) in [(few, "359 numbers instead of 360"), (&more, "more than 360")] {
                let (kind, message) = give(wrong, size).unwrap_err();
                assert_eq!(kind, io::ErrorKind::InvalidData);
                assert!(message.contains(part), "{message}");
            }
        }
        for bad in [1.0, -0.5, f32::NAN] {
            let mut wrong = samples.clone();
            wrong[100] = bad;
            let (kind, message) = give(&wrong, 7).unwrap_err();
            assert_eq!(kind, io::ErrorKind::InvalidData);
            assert!(message.contains(&bad.to_string()), "{message}");
        }
    }
}
