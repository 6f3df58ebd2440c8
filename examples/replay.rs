//! Plays a stream of accesses to a cache model and to real memory, where cachegrind can watch.
//!
//! ```text
//! cargo build --release --example replay
//! valgrind --tool=cachegrind --cache-sim=yes --D1=32768,8,64 --LL=786432,12,64 \
//!     target/release/examples/replay 32768,8,64 262144,8,64 786432,12,64
//! ```
//!
//! The arguments are the levels of the model: bytes, ways and bytes of a line of each. It prints
//! what the model counts, as JSON; cachegrind's counts are those of the function `replay::replay`.
//! A second run with the second level as `--LL` gives those of that level, as cachegrind has
//! only two.

use std::hint::black_box;

use anyhow::{Context, bail};
use perceptile::profile::cache::{CacheLevel, Hierarchy};
use serde_json::json;

/// Bytes of a word; all arrays consist of them.
const WORD: usize = 4;
/// Words in each array: 4 MiB.
const WORDS: usize = 1 << 20;
/// Accesses that are noted at once; 2 KiB, so that the notes themselves stay in the first cache.
const BATCH: usize = 256;

/// The arrays: what draws read and change, and three more that only the update touches.
const SAMPLES: u8 = 0;
const GRADIENT: u8 = 1;
const MOMENTS: [u8; 2] = [2, 3];
const OTHER_SAMPLES: u8 = 4;
const ARRAYS: usize = 5;

/// One access of a stream.
#[derive(Debug, Clone, Copy)]
struct Access {
    /// First word in the array.
    offset: u32,
    /// Number of words.
    words: u16,
    array: u8,
    write: bool,
}

/// Steps of a descent in miniature: draws scattered over one block of the samples after the
/// other, then an update that goes through all arrays.
fn stream(emit: &mut impl FnMut(Access)) {
    const STEPS: usize = 1;
    /// Points of two words in a row of a block, rows in a frame of it, frames, and all its words.
    const ROW: usize = 64;
    const ROWS: usize = 32;
    const FRAMES: usize = 32;
    const BLOCK: usize = ROW * ROWS * FRAMES * 2;
    const DRAWS: usize = 5000;
    /// Words of a line of the update.
    const RUN: usize = 16;

    let mut random = Random(1);
    for _ in 0..STEPS {
        for block in (0..WORDS).step_by(BLOCK) {
            for _ in 0..DRAWS {
                // A subset like that of a spatial kernel over the last frames.
                let radius = 1 + random.below(3);
                let (x, y) = (random.below(ROW - 7), random.below(ROWS - 7));
                let frame = random.below(FRAMES);
                let depth = 1 + random.below(4);
                let rows = || {
                    let row = move |row: usize| {
                        let narrow = radius.abs_diff(row);
                        let left = x + 3 - radius + narrow / 2;
                        let points = (2 * radius + 1).saturating_sub(narrow).max(1);
                        (row, left, points)
                    };
                    let frames = move |back| (frame + FRAMES - back) % FRAMES;
                    (0..depth).flat_map(move |back| {
                        (0..2 * radius + 1).map(row).map(move |(row, left, points)| {
                            let place = (frames(back) * ROWS + y + row) * ROW + left;
                            ((block + 2 * place) as u32, 2 * points as u16)
                        })
                    })
                };
                for (offset, words) in rows() {
                    emit(Access { offset, words, array: SAMPLES, write: false });
                }
                for (offset, words) in rows() {
                    for write in [false, true] {
                        emit(Access { offset, words, array: GRADIENT, write });
                    }
                }
            }
        }
        for offset in (0..WORDS as u32).step_by(RUN) {
            let mut access =
                |array, write| emit(Access { offset, words: RUN as u16, array, write });
            for array in [GRADIENT, MOMENTS[0], MOMENTS[1]] {
                access(array, false);
                access(array, true);
            }
            // The new samples replace others, which nobody reads.
            access(SAMPLES, false);
            access(OTHER_SAMPLES, true);
        }
    }
}

/// A linear congruential generator, of which the high bits are used (Knuth's MMIX).
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as usize * n) >> 31
    }
}

/// Calls `batch` with all accesses of the stream, in a place that stays the same.
fn batches(notes: &mut Vec<Access>, mut batch: impl FnMut(&[Access])) {
    notes.clear();
    stream(&mut |access| {
        notes.push(access);
        if notes.len() == BATCH {
            batch(notes);
            notes.clear();
        }
    });
    batch(notes);
}

/// Does the accesses. Not inlined, so that cachegrind tells what they miss.
#[inline(never)]
fn replay(notes: &[Access], arrays: &mut [Vec<u32>; ARRAYS]) -> u32 {
    let mut sum = 0_u32;
    for access in notes {
        let first = access.offset as usize;
        let words = &mut arrays[access.array as usize][first..first + access.words as usize];
        if access.write {
            words.fill(sum);
        } else {
            sum = words.iter().fold(sum, |sum, &word| sum.wrapping_add(word | 1));
        }
    }
    sum
}

/// A level as cachegrind writes it: `32768,8,64`.
fn level(number: u32, text: &str) -> anyhow::Result<CacheLevel> {
    let fields: Vec<&str> = text.split(',').collect();
    let [bytes, ways, line] = fields[..] else { bail!("{text:?} is not BYTES,WAYS,LINE") };
    let context = || format!("{text:?} is not BYTES,WAYS,LINE");
    Ok(CacheLevel {
        level: number,
        bytes: bytes.parse().with_context(context)?,
        ways: ways.parse().with_context(context)?,
        line: line.parse().with_context(context)?,
    })
}

fn main() -> anyhow::Result<()> {
    let levels: Vec<CacheLevel> = (1..)
        .zip(std::env::args().skip(1))
        .map(|(i, text)| level(i, &text))
        .collect::<Result<_, _>>()?;
    let mut caches = Hierarchy::new(&levels).context("usage: replay BYTES,WAYS,LINE...")?;
    let mut arrays: [Vec<u32>; ARRAYS] = std::array::from_fn(|_| vec![0; WORDS]);
    let mut notes = Vec::with_capacity(BATCH);
    let mut sum = 0_u32;
    batches(&mut notes, |notes| sum = sum.wrapping_add(replay(notes, &mut arrays)));
    black_box(sum);

    let begun = std::time::Instant::now();
    let mut accesses = 0_u64;
    batches(&mut notes, |notes| {
        accesses += notes.len() as u64;
        for access in notes {
            let note = std::ptr::from_ref(access) as u64;
            caches.access(note, size_of::<Access>() as u32, false);
            let word = &arrays[access.array as usize][access.offset as usize];
            let bytes = u32::from(access.words) * WORD as u32;
            caches.access(std::ptr::from_ref(word) as u64, bytes, access.write);
        }
    });
    let levels: Vec<_> = caches
        .counts()
        .map(|(geometry, counts)| {
            json!({
                "geometry": geometry, "counts": counts, "misses": counts.misses(),
            })
        })
        .collect();
    let seconds = begun.elapsed().as_secs_f64();
    println!("{}", json!({ "accesses": accesses, "levels": levels, "model_seconds": seconds }));
    Ok(())
}
