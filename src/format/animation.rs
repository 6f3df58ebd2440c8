//! Animations as files: a `.npy` array of frames, or an EXR file for each frame. Frames are read one
//! at a time.
//!
//! A sequence is named by one `#` or more where its files have the number of the frame, such as
//! `x.####.exr`; the number has at least so many digits. Its frames are all files of that name, and
//! none may be missing between the first and the last.

use std::fs::{self, File};
use std::io::{self, BufReader, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::exr::{self, ExrError, ExrTemplate};
use crate::array::{ArrayError, ArrayHeader, ElementKind};

/// Largest magnitude of a value: the squares of what is added up still fit into an `f32`.
pub const MAX_VALUE: f32 = 1e12;

/// Why an animation cannot be read.
#[derive(Debug, Error)]
pub enum AnimationError {
    /// Opening or reading failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// No array.
    #[error("cannot read {}: {error}", path.display())]
    Array {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: ArrayError,
    },
    /// An array that is no animation.
    #[error(
        "{} has the shape {shape:?}, but an animation has (frames, height, width), or the same and 1 or 3 channels, each at least 1",
        path.display()
    )]
    Axes {
        /// The file.
        path: PathBuf,
        /// Its sizes.
        shape: Vec<usize>,
    },
    /// An array of another kind.
    #[error("{} must have floats, frame after frame (C order)", path.display())]
    Kind {
        /// The file.
        path: PathBuf,
    },
    /// No picture.
    #[error("cannot read {}: {error}", path.display())]
    Exr {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: ExrError,
    },
    /// No file of the sequence.
    #[error("there is no file {}", pattern.display())]
    Nothing {
        /// Its name.
        pattern: PathBuf,
    },
    /// A name that is no pattern.
    #[error(
        "{pattern:?} is neither a .npy file nor an .exr file or sequence, such as frames/x.####.exr"
    )]
    Pattern {
        /// The name.
        pattern: String,
    },
    /// A frame is missing.
    #[error("{} is missing: there are frames {first} to {last} of {}", path.display(), pattern.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The first frame.
        first: u64,
        /// The last frame.
        last: u64,
        /// The sequence.
        pattern: PathBuf,
    },
    /// Two files of one number.
    #[error("{} and {} have the same number", first.display(), other.display())]
    Twice {
        /// A file.
        first: PathBuf,
        /// Another one.
        other: PathBuf,
    },
    /// A picture of another size than the first.
    #[error("{} has {}x{} pixels, but {} has {}x{}", path.display(), size[0], size[1], first.display(), expected[0], expected[1])]
    Size {
        /// The file.
        path: PathBuf,
        /// Pixels across and down.
        size: [usize; 2],
        /// The first file.
        first: PathBuf,
        /// Its pixels.
        expected: [usize; 2],
    },
    /// Floats of another size than in the first.
    #[error("{} has 32-bit colours, but {} has half floats", path.display(), first.display())]
    Depth {
        /// The file.
        path: PathBuf,
        /// The first file.
        first: PathBuf,
    },
    /// A value that is no number, or too large a one.
    #[error(
        "frame {frame} of {} has the value {value} at pixel ({x}, {y}), channel {channel}, but values must be finite and at most 1e12",
        path.display()
    )]
    Value {
        /// The file.
        path: PathBuf,
        /// The frame, from 0.
        frame: usize,
        /// The column.
        x: usize,
        /// The row.
        y: usize,
        /// The channel.
        channel: usize,
        /// The value.
        value: f32,
    },
}

/// An animation that is open.
#[derive(Debug)]
pub struct Animation {
    files: Files,
    size: [usize; 2],
    channels: usize,
}

#[derive(Debug)]
enum Files {
    /// One array: its frames, and where the first begins.
    Npy { path: PathBuf, frames: usize, entry: ArrayHeader, bytes: u64, start: u64 },
    /// A file for each frame.
    Exr { paths: Vec<PathBuf>, first: u64, template: Box<ExrTemplate> },
}

impl Animation {
    /// Opens an animation by the name of its file or sequence.
    ///
    /// # Errors
    /// Files that are missing or are no animation.
    pub fn open(name: &Path) -> Result<Self, AnimationError> {
        match name.extension().and_then(|extension| extension.to_str()) {
            Some(extension) if extension.eq_ignore_ascii_case("npy") => Self::open_array(name),
            Some(extension) if extension.eq_ignore_ascii_case("exr") => Self::open_sequence(name),
            _ => Err(AnimationError::Pattern { pattern: name.display().to_string() }),
        }
    }

    fn open_array(path: &Path) -> Result<Self, AnimationError> {
        let of_io = |error| AnimationError::Io { path: path.to_owned(), error };
        let mut file = File::open(path).map_err(of_io)?;
        let length = file.metadata().map_err(of_io)?.len();
        let header = ArrayHeader::read(&mut file, length)
            .map_err(|error| AnimationError::Array { path: path.to_owned(), error })?;
        let shape = header.shape().to_vec();
        let (frames, height, width, channels) = match *shape {
            [frames, height, width] => (frames, height, width, 1),
            [frames, height, width, channels @ (1 | 3)] => (frames, height, width, channels),
            _ => return Err(AnimationError::Axes { path: path.to_owned(), shape }),
        };
        if frames == 0 || height == 0 || width == 0 {
            return Err(AnimationError::Axes { path: path.to_owned(), shape });
        }
        let floats =
            matches!(header.kind(), ElementKind::F16 | ElementKind::F32 | ElementKind::F64);
        let (entry, bytes) = header
            .entry()
            .filter(|_| floats)
            .ok_or_else(|| AnimationError::Kind { path: path.to_owned() })?;
        let start = file.stream_position().map_err(of_io)?;
        let files = Files::Npy { path: path.to_owned(), frames, entry, bytes, start };
        Ok(Self { files, size: [width, height], channels })
    }

    fn open_sequence(pattern: &Path) -> Result<Self, AnimationError> {
        let (first, paths) = sequence(pattern)?;
        let template = exr::read_template(&paths[0])
            .map_err(|error| AnimationError::Exr { path: paths[0].clone(), error })?;
        let size = template.size();
        let files = Files::Exr { paths, first, template: Box::new(template) };
        Ok(Self { files, size, channels: 3 })
    }

    /// Pixels across and down.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        match &self.files {
            Files::Npy { frames, .. } => *frames,
            Files::Exr { paths, .. } => paths.len(),
        }
    }

    /// Numbers of a pixel: 1 or 3.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// What files of a sequence say besides their pixels, and the number of its first frame.
    pub fn template(&self) -> Option<(&ExrTemplate, u64)> {
        match &self.files {
            Files::Npy { .. } => None,
            Files::Exr { first, template, .. } => Some((template, *first)),
        }
    }

    /// Whether every value is that of a half float.
    pub fn is_half(&self) -> bool {
        match &self.files {
            Files::Npy { entry, .. } => entry.kind() == ElementKind::F16,
            Files::Exr { template, .. } => template.is_half(),
        }
    }

    /// The file of a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn path(&self, frame: usize) -> &Path {
        match &self.files {
            Files::Npy { path, .. } => path,
            Files::Exr { paths, .. } => &paths[frame],
        }
    }

    /// Reads a frame: a plane of `height × width` numbers for each channel.
    ///
    /// # Errors
    /// A file that cannot be read, a picture of another size, and a value that is no finite number.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn read(&self, frame: usize) -> Result<Vec<f32>, AnimationError> {
        assert!(frame < self.frames());
        let [width, height] = self.size;
        let planes = match &self.files {
            Files::Npy { path, entry, bytes, start, .. } => {
                let of_io = |error| AnimationError::Io { path: path.clone(), error };
                let mut file = File::open(path).map_err(of_io)?;
                file.seek(SeekFrom::Start(start + bytes * frame as u64)).map_err(of_io)?;
                let mut planes = vec![0.0; entry.count()];
                let (pixels, channels) = (width * height, self.channels);
                entry
                    .read_values(BufReader::new(file), |place, value| {
                        planes[place % channels * pixels + place / channels] = value as f32;
                        Ok::<(), ArrayError>(())
                    })
                    .map_err(|error| AnimationError::Array { path: path.clone(), error })?;
                planes
            }
            Files::Exr { paths, .. } => {
                let path = &paths[frame];
                let (template, planes) = exr::read(path)
                    .map_err(|error| AnimationError::Exr { path: path.clone(), error })?;
                if template.size() != self.size {
                    return Err(AnimationError::Size {
                        path: path.clone(),
                        size: template.size(),
                        first: paths[0].clone(),
                        expected: self.size,
                    });
                }
                if self.is_half() && !template.is_half() {
                    let (path, first) = (path.clone(), paths[0].clone());
                    return Err(AnimationError::Depth { path, first });
                }
                planes
            }
        };
        let is_strange = |value: &f32| value.is_nan() || value.abs() > MAX_VALUE;
        match planes.iter().position(is_strange) {
            None => Ok(planes),
            Some(at) => Err(AnimationError::Value {
                path: self.path(frame).to_owned(),
                frame,
                x: at % width,
                y: at / width % height,
                channel: at / (width * height),
                value: planes[at],
            }),
        }
    }
}

/// A name as the text before and after its number, and the digits of that; none for a single file.
pub fn numbered(pattern: &Path) -> Option<(String, usize, String)> {
    let name = pattern.file_name()?.to_str()?;
    let from = name.find('#')?;
    let digits = name[from..].bytes().take_while(|&byte| byte == b'#').count();
    Some((name[..from].to_owned(), digits, name[from + digits..].to_owned()))
}

/// The file of a frame of a sequence; the pattern itself if it has no number.
pub fn path_of(pattern: &Path, number: u64) -> PathBuf {
    match numbered(pattern) {
        Some((before, digits, after)) => {
            pattern.with_file_name(format!("{before}{number:0digits$}{after}"))
        }
        None => pattern.to_owned(),
    }
}

/// The number of the first frame and the files of all frames.
fn sequence(pattern: &Path) -> Result<(u64, Vec<PathBuf>), AnimationError> {
    let Some((before, digits, after)) = numbered(pattern) else {
        return Ok((0, vec![pattern.to_owned()]));
    };
    let folder = match pattern.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let of_io = |error| AnimationError::Io { path: folder.to_owned(), error };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(of_io)? {
        let name = entry.map_err(of_io)?.file_name();
        let number = name.to_str().and_then(|name| {
            let number = name.strip_prefix(before.as_str())?.strip_suffix(after.as_str())?;
            let is_number = number.len() >= digits && number.bytes().all(|c| c.is_ascii_digit());
            if is_number { number.parse::<u64>().ok() } else { None }
        });
        if let Some(number) = number {
            found.push((number, pattern.with_file_name(name)));
        }
    }
    found.sort();
    let (Some(&(first, _)), Some(&(last, _))) = (found.first(), found.last()) else {
        return Err(AnimationError::Nothing { pattern: pattern.to_owned() });
    };
    for (pair, expected) in found.windows(2).zip(first + 1..) {
        if pair[0].0 == pair[1].0 {
            return Err(AnimationError::Twice {
                first: pair[0].1.clone(),
                other: pair[1].1.clone(),
            });
        }
        if pair[1].0 != expected {
            return Err(AnimationError::Missing {
                path: path_of(pattern, expected),
                first,
                last,
                pattern: pattern.to_owned(),
            });
        }
    }
    Ok((first, found.into_iter().map(|(_, path)| path).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_a_sequence_are_all_files_of_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let pattern = folder.path().join("x.##.exr");
        assert!(matches!(sequence(&pattern), Err(AnimationError::Nothing { .. })));
        for name in ["x.08.exr", "x.09.exr", "x.10.exr", "x.7.exr", "y.11.exr", "x.12.exr.part"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let (first, paths) = sequence(&pattern).unwrap();
        assert_eq!((first, paths.len()), (8, 3));
        assert_eq!(paths[2], folder.path().join("x.10.exr"));
        assert_eq!(path_of(&pattern, 8), paths[0]);
        fs::write(folder.path().join("x.101.exr"), "").unwrap();
        let error = sequence(&pattern).unwrap_err();
        assert!(error.to_string().contains("x.11.exr is missing: there are frames 8 to 101"));
        fs::remove_file(folder.path().join("x.101.exr")).unwrap();
        fs::write(folder.path().join("x.009.exr"), "").unwrap();
        assert!(matches!(sequence(&pattern), Err(AnimationError::Twice { .. })));
    }

    #[test]
    fn arrays_are_read_frame_by_frame_and_strange_values_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let write = |shape: &[usize], values: &[f32]| {
            let mut file = File::create(&path).unwrap();
            crate::array::write_header(shape, &mut file).unwrap();
            io::Write::write_all(&mut file, bytemuck::cast_slice(values)).unwrap();
        };
        let mut values: Vec<f32> = (0..36).map(|i| i as f32).collect();
        write(&[2, 3, 2, 3], &values);
        let animation = Animation::open(&path).unwrap();
        assert_eq!((animation.size(), animation.frames(), animation.channels()), ([2, 3], 2, 3));
        let frame = animation.read(1).unwrap();
        assert_eq!(frame[..7], [18.0, 21.0, 24.0, 27.0, 30.0, 33.0, 19.0]);
        values[18 + 10] = f32::NAN;
        write(&[2, 3, 2, 3], &values);
        let error = Animation::open(&path).unwrap().read(1).unwrap_err().to_string();
        assert!(error.contains("frame 1 of") && error.contains("NaN at pixel (1, 1), channel 1"));
        for (shape, word) in
            [(&[36][..], "shape [36]"), (&[2, 3, 3, 2], "shape"), (&[0, 3, 3], "shape")]
        {
            write(shape, &values[..shape.iter().product()]);
            let error = Animation::open(&path).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        assert!(Animation::open(&folder.path().join("a.png")).is_err());
    }
}
