//! Any density on the square, from a picture's gray values: an aperture, a lamp, a map of what matters.

use std::fmt;
use std::sync::Mutex;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser::SerializeStruct};
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::picture::Picture;

/// Most pixels of a picture: a thousand each way, far more than a tile has samples for.
pub const MAX_PIXELS: usize = 1 << 20;

/// Why levels are no density.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DensityError {
    /// Another number of levels than the picture has pixels.
    #[error("there are {found} levels for {width}x{height} pixels")]
    Count {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Levels.
        found: usize,
    },
    /// A picture of no pixel, of one, or of too many.
    #[error("it has {width}x{height} pixels, but must have 2 to {MAX_PIXELS}")]
    Size {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
    /// A level that is no share.
    #[error("row {row}, column {column} holds {level}, but levels must be finite and not negative")]
    Level {
        /// From the top, from 0.
        row: usize,
        /// From the left, from 0.
        column: usize,
        /// What stands there.
        level: f64,
    },
    /// Nowhere is there a sample.
    #[error("it holds only zeros, so no sample may be anywhere")]
    Empty,
}

/// A density on the square, even within each pixel of a picture.
///
/// It is a small handle: pictures are kept until the process ends, each once.
#[derive(Clone, Copy)]
pub struct Density(&'static Entry);

struct Entry {
    name: String,
    sha256: String,
    picture: Picture,
}

/// All pictures of this process.
static ENTRIES: Mutex<Vec<&'static Entry>> = Mutex::new(Vec::new());

impl Density {
    /// A density with a name for messages, in proportion to `levels`: row by row, of which row 0 is at
    /// y = 0. Only their ratios count.
    ///
    /// # Errors
    /// Another number of levels than pixels, less than two or more than [`MAX_PIXELS`] of them, a level
    /// that is negative, infinite or not a number, and none above 0.
    pub fn new(
        name: &str,
        [width, height]: [usize; 2],
        levels: &[f64],
    ) -> Result<Self, DensityError> {
        let pixels = width.checked_mul(height).filter(|pixels| (2..=MAX_PIXELS).contains(pixels));
        let pixels = pixels.ok_or(DensityError::Size { width, height })?;
        if levels.len() != pixels {
            return Err(DensityError::Count { width, height, found: levels.len() });
        }
        let bad = levels.iter().position(|level| !(level.is_finite() && *level >= 0.0));
        if let Some(i) = bad {
            let (row, column) = (i / width, i % width);
            return Err(DensityError::Level { row, column, level: levels[i] });
        }
        let most = levels.iter().fold(0.0_f64, |most, &level| most.max(level));
        if most == 0.0 {
            return Err(DensityError::Empty);
        }
        // What is not empty stays so, and −0 is 0.
        let level = |&level: &f64| {
            let share = (level / most) as f32;
            if level > 0.0 { share.max(f32::MIN_POSITIVE) } else { 0.0 }
        };
        let levels = levels.iter().map(level).collect();
        Ok(Self::kept(name, [width, height], levels))
    }

    /// The one that is kept for these levels, of which the largest is 1.
    fn kept(name: &str, [width, height]: [usize; 2], levels: Vec<f32>) -> Self {
        let mut hash = Sha256::new();
        hash.update([width, height].map(|n| (n as u64).to_le_bytes()).concat());
        levels.iter().for_each(|level| hash.update(level.to_le_bytes()));
        let sha256: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        let mut entries = ENTRIES.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let same = |entry: &&&Entry| entry.sha256 == sha256 && entry.name == name;
        if let Some(entry) = entries.iter().find(same) {
            return Self(entry);
        }
        let picture = Picture::new(width, height, levels);
        let entry = Box::leak(Box::new(Entry { name: name.to_owned(), sha256, picture }));
        entries.push(entry);
        Self(entry)
    }

    /// Its name: the path of the picture, if it is read from one.
    pub fn name(self) -> &'static str {
        &self.0.name
    }

    /// SHA-256 of width, height (64 bits, little-endian) and levels (`f32`, the largest 1), in hexadecimal.
    pub fn sha256(self) -> &'static str {
        &self.0.sha256
    }

    /// Pixels across and down.
    pub fn size(self) -> [usize; 2] {
        self.0.picture.size()
    }

    pub(super) fn picture(self) -> &'static Picture {
        &self.0.picture
    }
}

/// The same levels and name.
impl PartialEq for Density {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self.0, other.0)
    }
}

impl Eq for Density {}

impl std::hash::Hash for Density {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        std::ptr::hash(self.0, state);
    }
}

impl fmt::Debug for Density {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = self.size();
        write!(f, "Density({:?}, {width}x{height})", self.name())
    }
}

/// What other processes and checkpoints get: all of it.
#[derive(Serialize, Deserialize)]
struct Whole {
    name: String,
    size: [u32; 2],
    levels: Vec<f32>,
}

/// For people the name and the digest, for programs all of it.
impl Serialize for Density {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            let mut fields = serializer.serialize_struct("Density", 2)?;
            fields.serialize_field("name", self.name())?;
            fields.serialize_field("sha256", self.sha256())?;
            return fields.end();
        }
        let levels = self.picture().levels().to_vec();
        let size = self.size().map(|n| n as u32);
        Whole { name: self.name().to_owned(), size, levels }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Density {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Whole { name, size, levels } = Whole::deserialize(deserializer)?;
        let levels: Vec<f64> = levels.into_iter().map(f64::from).collect();
        Self::new(&name, size.map(|n| n as usize), &levels).map_err(de::Error::custom)
    }
}
