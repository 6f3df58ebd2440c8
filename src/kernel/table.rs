//! A kernel table from a `.npy` file, read with strict limits: the file is not trusted.

use std::fs::File;
use std::io::Read;

use glam::IVec3;
use npyz::{DType, NpyFile, Order};
use thiserror::Error;

use crate::kernel::grid::Grid;
use crate::kernel::spec::MAX_LENGTH;

/// Most weights of a table.
const MAX_WEIGHTS: u64 = 1 << 20;
/// Most bytes of the header's text: numpy pads to 64, and a table needs about 80.
const MAX_HEADER: usize = 1024;

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
    let most = MAX_WEIGHTS * size_of::<f64>() as u64 + MAX_HEADER as u64;
    let mut bytes = Vec::new();
    File::open(file).map_err(failed)?.take(most + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > most {
        return Err(TableError::Size {
            file: file.into(),
            found: format!("has more than {most} bytes"),
            rule: format!("at most {MAX_WEIGHTS} weights"),
        });
    }
    parse(file, &bytes, origin)
}

/// Makes the table of the `bytes` of a `.npy` file; `file` is its name in messages.
fn parse(file: &str, bytes: &[u8], origin: [u32; 3]) -> Result<Grid, TableError> {
    let kind = |found: String| TableError::Kind { file: file.into(), found };
    let size = |found: String, rule: String| TableError::Size { file: file.into(), found, rule };

    let header = header(bytes).ok_or_else(|| kind("has no header of such a file".into()))?;
    let data = &bytes[header..];
    let npy = NpyFile::new(bytes).map_err(|why| kind(format!("does not read as one ({why})")))?;
    let shape = npy.shape().to_vec();
    let &[frames, height, width] = shape.as_slice() else {
        return Err(kind(format!("has {} axes", shape.len())));
    };
    let length = u64::from(MAX_LENGTH);
    if shape.iter().any(|&n| n == 0 || n > length) || npy.len() > MAX_WEIGHTS {
        return Err(size(
            format!("has shape {shape:?}"),
            format!("1 to {length} entries along each axis and at most {MAX_WEIGHTS} in all"),
        ));
    }
    let wide = match npy.dtype() {
        DType::Plain(dtype) => match dtype.to_string().get(1..) {
            Some("f4") => 4,
            Some("f8") => 8,
            _ => return Err(kind(format!("holds `{dtype}`"))),
        },
        _ => return Err(kind("holds records".into())),
    };
    if data.len() as u64 != npy.len() * wide {
        return Err(size(
            format!("has {} bytes of weights", data.len()),
            format!("{} for its shape {shape:?}", npy.len() * wide),
        ));
    }
    let axes = ["t", "y", "x"];
    for ((&n, origin), axis) in shape.iter().zip(origin).zip(axes) {
        if u64::from(origin) >= n {
            return Err(size(
                format!("has {n} entries along {axis}"),
                format!("its origin inside, not at {axis} = {origin}"),
            ));
        }
    }

    let fortran = npy.order() == Order::Fortran;
    let failed = |why: std::io::Error| TableError::Read { file: file.into(), why: why.to_string() };
    let stored: Vec<f64> = if wide == 8 {
        npy.into_vec().map_err(failed)?
    } else {
        npy.into_vec::<f32>().map_err(failed)?.into_iter().map(f64::from).collect()
    };
    if let Some(place) = stored.iter().position(|w| !w.is_finite()) {
        let found = format!("{} at position {place}", stored[place]);
        return Err(TableError::Weight { file: file.into(), found });
    }
    let peak = stored.iter().fold(0.0_f64, |peak, w| peak.max(w.abs()));
    if peak == 0.0 {
        return Err(TableError::Weight { file: file.into(), found: "only zeros".into() });
    }
    let [frames, height, width] = [frames as usize, height as usize, width as usize];
    let mut weights = Vec::with_capacity(stored.len());
    for t in 0..frames {
        for y in 0..height {
            for x in 0..width {
                let place = if fortran {
                    (x * height + y) * frames + t
                } else {
                    (t * height + y) * width + x
                };
                // By the peak first, so that no sum of large weights overflows.
                weights.push(stored[place] / peak);
            }
        }
    }
    let [t, y, x] = origin.map(|index| -(index as i32));
    Ok(Grid::new(IVec3::new(x, y, t), [frames, height, width], weights))
}

/// Where the data begins, if the header is short and plain enough to be given to a parser that
/// recurses into brackets and multiplies the sizes unchecked: 4 brackets, 19 digits (a product
/// of numbers with 19 digits in all is below 2⁶⁴), no hexadecimal.
fn header(bytes: &[u8]) -> Option<usize> {
    let &[0x93, b'N', b'U', b'M', b'P', b'Y', major, _, low, high, ref rest @ ..] = bytes else {
        return None;
    };
    let short = usize::from(u16::from_le_bytes([low, high]));
    let (from, length) = match (major, rest) {
        (1, _) => (10, short),
        (2 | 3, [0, 0, ..]) => (12, short),
        _ => return None,
    };
    let text = bytes.get(from..from + length).filter(|text| text.len() <= MAX_HEADER)?;
    let count = |of: fn(&u8) -> bool| text.iter().filter(|&byte| of(byte)).count();
    let plain = count(|byte| b"([{".contains(byte)) <= 4
        && count(u8::is_ascii_digit) <= 19
        && count(|byte| b"xX".contains(byte)) == 0;
    plain.then_some(from + length)
}

#[cfg(test)]
mod tests {
    use npyz::WriterBuilder;
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

    fn weight(grid: &Grid, x: i32, y: i32, t: i32) -> f64 {
        grid.taps().find(|tap| tap.offset == IVec3::new(x, y, t)).unwrap().weight
    }

    #[test]
    fn entries_are_placed_around_the_origin() {
        // Two frames of two rows of three pixels: 1 … 12, whose sum is 78.
        let data: Vec<f64> = (1..=12).map(f64::from).collect();
        let grid = parse("k", &npy(&[2, 2, 3], Order::C, &data), [1, 0, 1]).unwrap();
        assert_eq!(grid.len(), 12);
        for (x, y, t, entry) in [(-1, 0, -1, 1.0), (0, 1, -1, 5.0), (0, 0, 0, 8.0), (1, 1, 0, 12.0)]
        {
            assert!((weight(&grid, x, y, t) - entry / 78.0).abs() < 1e-15);
        }
        let single: Vec<f32> = data.iter().map(|&w| w as f32).collect();
        assert_eq!(parse("k", &npy(&[2, 2, 3], Order::C, &single), [1, 0, 1]).unwrap(), grid);
        // The same array stored with the first axis fastest.
        let turned = [1, 7, 4, 10, 2, 8, 5, 11, 3, 9, 6, 12].map(f64::from);
        assert_eq!(parse("k", &npy(&[2, 2, 3], Order::Fortran, &turned), [1, 0, 1]).unwrap(), grid);
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let good = npy(&[1, 2, 2], Order::C, &[0.5_f64, -1.0, 2.0, 0.0]);
        assert!(parse("k", &good, [0, 0, 0]).is_ok());
        let with = |old: &str, new: &str| {
            let text = String::from_utf8_lossy(&good[10..]).into_owned();
            assert!(text.contains(old) && old.len() == new.len(), "{text}");
            let place = good.windows(old.len()).position(|part| part == old.as_bytes()).unwrap();
            let mut bad = good.clone();
            bad[place..place + new.len()].copy_from_slice(new.as_bytes());
            bad
        };
        for (bytes, word) in [
            (b"no table".to_vec(), "no header"),
            (good[..good.len() - 1].to_vec(), "31 bytes"),
            ([good.clone(), vec![0]].concat(), "33 bytes"),
            (with("(1, 2, 2, )", "(1, 2, 0, )"), "shape [1, 2, 0]"),
            (with("(1, 2, 2, )", "(2, 2)     "), "2 axes"),
            (with("(1, 2, 2, )", "(9999999)  "), "does not read"),
            (with("(1, 2, 2, )", "(((((1,))))"), "no header"),
            (with("<f8", "<i8"), "holds `<i8`"),
            (npy(&[1, 1, 2], Order::C, &[1.0, f64::NAN]), "NaN at position 1"),
            (npy(&[1, 1, 2], Order::C, &[f32::INFINITY, 1.0]), "inf at position 0"),
            (npy(&[1, 1, 2], Order::C, &[0.0, 0.0]), "only zeros"),
        ] {
            let error = parse("k", &bytes, [0, 0, 0]).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        let error = parse("k", &good, [0, 2, 0]).unwrap_err().to_string();
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
            assert!(parse("k", &bytes, [0, 0, 0]).is_err());
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
            let _ = parse("k", &bytes, [0, 0, 0]);
        }
    }
}
