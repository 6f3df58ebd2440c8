//! A kernel table from a `.npy` file, read with strict limits: the file is not trusted.

use std::fs::File;
use std::io::{BufReader, Read};

use glam::IVec3;
use thiserror::Error;

use crate::array::{ArrayError, ArrayHeader, ElementKind};
use crate::kernel::grid::Grid;
use crate::kernel::spec::MAX_LENGTH;

/// Most weights of a table.
const MAX_WEIGHTS: u64 = 1 << 20;

/// Why a file is not a kernel table.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum TableError {
    /// It cannot be read at all.
    #[error("cannot read the kernel table `{file}`: {why}")]
    Read {
        /// Path as given.
        file: String,
        /// What the operating system or the reader says.
        why: String,
    },
    /// It is no `.npy` file, or not one of the kind asked for.
    #[error(
        "the kernel table `{file}` {found}, but must be a .npy file of 3 axes (dt, dy, dx) of f32 or f64"
    )]
    Kind {
        /// Path as given.
        file: String,
        /// What it is instead.
        found: String,
    },
    /// Its size or its length is not what it must be.
    #[error("the kernel table `{file}` {found}, but must have {rule}")]
    Size {
        /// Path as given.
        file: String,
        /// What it has.
        found: String,
        /// What it must have.
        rule: String,
    },
    /// A weight is infinite or not a number, or all are 0.
    #[error("the kernel table `{file}` holds {found}, but must hold finite weights, not all 0")]
    Weight {
        /// Path as given.
        file: String,
        /// The value and its place.
        found: String,
    },
}

/// Reads the table at `file`, whose entry `origin` (t, y, x) has offset 0.
pub(crate) fn read(file: &str, origin: [u32; 3]) -> Result<Grid, TableError> {
    let failed = |why: std::io::Error| TableError::Read { file: file.into(), why: why.to_string() };
    // Asked before opening, because opening a pipe waits for its writer.
    if !std::fs::metadata(file).map_err(failed)?.is_file() {
        return Err(TableError::Kind { file: file.into(), found: "is not a regular file".into() });
    }
    let input = File::open(file).map_err(failed)?;
    let bytes = input.metadata().map_err(failed)?.len();
    parse(file, BufReader::new(input), bytes, origin)
}

/// Makes the table of a `.npy` file of so many bytes; `file` is its name in messages.
fn parse(
    file: &str,
    mut input: impl Read,
    bytes: u64,
    origin: [u32; 3],
) -> Result<Grid, TableError> {
    let header = ArrayHeader::read(&mut input, bytes).map_err(|error| refuse(file, error))?;
    if !matches!(header.kind(), ElementKind::F32 | ElementKind::F64) {
        let found = format!("holds `{}`", header.kind());
        return Err(TableError::Kind { file: file.into(), found });
    }
    let [frames, height, width] = check_shape(file, header.shape())?;
    for ((n, origin), axis) in [frames, height, width].into_iter().zip(origin).zip(["t", "y", "x"])
    {
        if origin as usize >= n {
            return Err(TableError::Size {
                file: file.into(),
                found: format!("has {n} entries along {axis}"),
                rule: format!("its origin inside, not at {axis} = {origin}"),
            });
        }
    }

    let mut weights = vec![0.0; header.count()];
    let mut infinite = None;
    let read = header.read_values(input, |place, weight| {
        weights[place] = weight;
        if !weight.is_finite() {
            infinite = infinite.or(Some(place));
        }
        Ok(())
    });
    read.map_err(|error| refuse(file, error))?;
    if let Some(place) = infinite {
        let found = format!("{} at {:?}", weights[place], header.index_of(place));
        return Err(TableError::Weight { file: file.into(), found });
    }
    let peak = weights.iter().fold(0.0_f64, |peak, w| peak.max(w.abs()));
    if peak == 0.0 {
        return Err(TableError::Weight { file: file.into(), found: "only zeros".into() });
    }
    // By the peak first, so that no sum of large weights overflows.
    weights.iter_mut().for_each(|weight| *weight /= peak);
    let [t, y, x] = origin.map(|index| -(index as i32));
    Ok(Grid::new(IVec3::new(x, y, t), [frames, height, width], weights))
}

/// Frames, height and width of a table.
fn check_shape(file: &str, shape: &[usize]) -> Result<[usize; 3], TableError> {
    let &[frames, height, width] = shape else {
        let found = format!("has {} axes", shape.len());
        return Err(TableError::Kind { file: file.into(), found });
    };
    let inside = |&size: &usize| (1..=MAX_LENGTH as usize).contains(&size);
    // Three such lengths have a product.
    let weights = || shape.iter().map(|&size| size as u64).product::<u64>();
    if !shape.iter().all(inside) || weights() > MAX_WEIGHTS {
        return Err(TableError::Size {
            file: file.into(),
            found: format!("has shape {shape:?}"),
            rule: format!(
                "1 to {MAX_LENGTH} entries along each axis and at most {MAX_WEIGHTS} in all"
            ),
        });
    }
    Ok([frames, height, width])
}

/// Says what is wrong with a file that holds no array, in the words of tables.
fn refuse(file: &str, error: ArrayError) -> TableError {
    let shape = match &error {
        ArrayError::Overflow { shape } | ArrayError::Length { shape, .. } => Some(shape),
        _ => None,
    };
    if let Some(Err(wrong)) = shape.map(|shape| check_shape(file, shape)) {
        return wrong;
    }
    match error {
        ArrayError::Element { descr } => TableError::Kind {
            file: file.into(),
            found: format!("holds `{}`", descr.escape_debug()),
        },
        ArrayError::Length { shape, expected, found } => TableError::Size {
            file: file.into(),
            found: format!("has {found} bytes of weights"),
            rule: format!("{expected} for its shape {shape:?}"),
        },
        error => TableError::Read { file: file.into(), why: error.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use npyz::{Order, WriterBuilder};
    use proptest::prelude::*;

    use super::*;

    fn npy<T: npyz::AutoSerialize + Copy>(shape: &[u64], order: Order, data: &[T]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let options = npyz::WriteOptions::new().default_dtype().order(order);
        let mut writer = options.shape(shape).writer(&mut bytes).begin_nd().unwrap();
        writer.extend(data.iter().copied()).unwrap();
        writer.finish().unwrap();
        bytes
    }

    fn parse(bytes: &[u8], origin: [u32; 3]) -> Result<Grid, TableError> {
        super::parse("k", bytes, bytes.len() as u64, origin)
    }

    fn weight(grid: &Grid, x: i32, y: i32, t: i32) -> f64 {
        grid.taps().find(|tap| tap.offset == IVec3::new(x, y, t)).unwrap().weight
    }

    #[test]
    fn entries_are_placed_around_the_origin() {
        // Two frames of two rows of three pixels: 1 … 12, whose sum is 78.
        let data: Vec<f64> = (1..=12).map(f64::from).collect();
        let grid = parse(&npy(&[2, 2, 3], Order::C, &data), [1, 0, 1]).unwrap();
        assert_eq!(grid.len(), 12);
        for (x, y, t, entry) in [(-1, 0, -1, 1.0), (0, 1, -1, 5.0), (0, 0, 0, 8.0), (1, 1, 0, 12.0)]
        {
            assert!((weight(&grid, x, y, t) - entry / 78.0).abs() < 1e-15);
        }
        let single: Vec<f32> = data.iter().map(|&w| w as f32).collect();
        assert_eq!(parse(&npy(&[2, 2, 3], Order::C, &single), [1, 0, 1]).unwrap(), grid);
        // The same array stored with the first axis fastest.
        let turned = [1, 7, 4, 10, 2, 8, 5, 11, 3, 9, 6, 12].map(f64::from);
        assert_eq!(parse(&npy(&[2, 2, 3], Order::Fortran, &turned), [1, 0, 1]).unwrap(), grid);
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let good = npy(&[1, 2, 2], Order::C, &[0.5_f64, -1.0, 2.0, 0.0]);
        assert!(parse(&good, [0, 0, 0]).is_ok());
        let with = |old: &str, new: &str| {
            let text = String::from_utf8_lossy(&good[10..]).into_owned();
            assert!(text.contains(old) && old.len() == new.len(), "{text}");
            let place = good.windows(old.len()).position(|part| part == old.as_bytes()).unwrap();
            let mut bad = good.clone();
            bad[place..place + new.len()].copy_from_slice(new.as_bytes());
            bad
        };
        for (bytes, word) in [
            (b"no table".to_vec(), "does not begin with"),
            (good[..good.len() - 1].to_vec(), "31 bytes"),
            ([good.clone(), vec![0]].concat(), "33 bytes"),
            (with("(1, 2, 2, )", "(1, 2, 0, )"), "shape [1, 2, 0]"),
            (with("(1, 2, 2, )", "(2, 2)     "), "2 axes"),
            (with("(1, 2, 2, )", "(9999999)  "), "1 axes"),
            (with("(1, 2, 2, )", "(((((1,))))"), "a size"),
            (with("<f8", "<i8"), "holds `<i8`"),
            (npy(&[1, 1, 2], Order::C, &[1.0, f64::NAN]), "NaN at [0, 0, 1]"),
            (npy(&[1, 1, 2], Order::C, &[f32::INFINITY, 1.0]), "inf at [0, 0, 0]"),
            (npy(&[1, 1, 2], Order::C, &[0.0, 0.0]), "only zeros"),
        ] {
            let error = parse(&bytes, [0, 0, 0]).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        let error = parse(&good, [0, 2, 0]).unwrap_err().to_string();
        assert!(error.contains("not at y = 2"), "{error}");
    }

    /// Headers that lie about the size, or nest for ever: refused before they cost anything.
    #[test]
    fn hostile_headers_are_refused() {
        let file = |version: u8, text: &[u8]| {
            let mut bytes = [b"\x93NUMPY".as_slice(), &[version, 0]].concat();
            let length = text.len() as u32;
            bytes.extend(&length.to_le_bytes()[..if version == 1 { 2 } else { 4 }]);
            [bytes, text.to_vec()].concat()
        };
        let dict = |shape: &str| {
            format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}").into_bytes()
        };
        for bytes in [
            file(1, &dict("(9999999999, 9999999999, 9999999999)")),
            file(1, &dict("(99999, 99999, 99999)")),
            file(1, &dict("(0xffffffffffff, 0xffffffffffff, 3)")),
            file(1, &dict("(-1, 1, 1)")),
            file(1, &[b'('; 60_000]),
            file(2, &[b'('; 100_000]),
            [b"\x93NUMPY\x02\x00\xff\xff\xff\xff".as_slice(), b"{"].concat(),
            file(9, &dict("(1, 1, 1)")),
        ] {
            assert!(parse(&bytes, [0, 0, 0]).is_err());
        }
    }

    #[test]
    fn files_are_read_and_folders_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("k.npy");
        std::fs::write(&path, npy(&[1, 1, 1], Order::C, &[3.0_f64])).unwrap();
        assert_eq!(read(path.to_str().unwrap(), [0, 0, 0]).unwrap(), Grid::one());
        for path in [folder.path().to_path_buf(), folder.path().join("missing")] {
            assert!(read(path.to_str().unwrap(), [0, 0, 0]).is_err());
        }
    }

    proptest! {
        /// A table with a few bytes changed reads or is refused; never a panic.
        #[test]
        fn damaged_tables_get_an_answer(
            damage in prop::collection::vec((0..160_usize, any::<u8>()), 1..5),
        ) {
            let mut bytes = npy(&[1, 2, 2], Order::C, &[0.5_f64, -1.0, 2.0, 0.0]);
            for (place, byte) in damage {
                let place = place % bytes.len();
                bytes[place] = byte;
            }
            let _ = parse(&bytes, [0, 0, 0]);
        }
    }
}
