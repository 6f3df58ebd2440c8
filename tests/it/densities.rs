//! Densities to try everything on: one with parts that are empty, and one without.

use std::fs;
use std::path::{Path, PathBuf};

use perceptile::domain::{Density, Domain};

use crate::npy::npy;

/// Levels of a ring with a gap beside a lone spot.
fn ring(x: f64, y: f64) -> f64 {
    let (from_middle, from_spot) = ((x - 0.4).hypot(y - 0.45), (x - 0.9).hypot(y - 0.85));
    let is_ring = (0.15..0.38).contains(&from_middle) && x + y > 0.45;
    if is_ring {
        1.0 + 2.0 * x
    } else if from_spot < 0.08 {
        4.0
    } else {
        0.0
    }
}

/// Pixels of the ring.
const SIZE: [usize; 2] = [30, 23];

/// Levels of all pixels.
fn levels([width, height]: [usize; 2], level: fn(f64, f64) -> f64) -> Vec<f64> {
    let at = |i: usize, n: usize| (i as f64 + 0.5) / n as f64;
    (0..width * height).map(|i| level(at(i % width, width), at(i / width, height))).collect()
}

/// The ring, and a slope.
pub fn densities() -> [Domain; 2] {
    let make = |name, size, level| {
        Domain::Density(Density::new(name, size, &levels(size, level)).unwrap())
    };
    [make("ring", SIZE, ring), make("slope", [7, 5], |x, y| 0.2 + x + 2.0 * x * y)]
}

/// A `.npy` file of levels.
pub fn rows_and_columns([width, height]: [usize; 2], levels: &[f64]) -> Vec<u8> {
    let levels: Vec<f32> = levels.iter().map(|&level| level as f32).collect();
    npy(&format!("({height}, {width})"), &levels)
}

/// The file of the ring.
pub fn ring_file() -> PathBuf {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ring.npy");
    // Tests that run at the same time find it whole.
    let unfinished = tempfile::NamedTempFile::new_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    fs::write(unfinished.path(), rows_and_columns(SIZE, &levels(SIZE, ring))).unwrap();
    unfinished.persist(&file).unwrap();
    file
}

/// The same for a command line.
pub fn ring_in_a_file() -> String {
    format!("density({})", ring_file().display())
}
