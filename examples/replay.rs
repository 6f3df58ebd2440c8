//! Plays the accesses of a descent to a cache model and to real memory, where cachegrind can watch.
//!
//! ```text
//! cargo build --release --example replay
//! valgrind --tool=cachegrind --cache-sim=yes --D1=32768,8,64 --LL=786432,12,64 \
//!     target/release/examples/replay 32768,8,64 262144,8,64 786432,12,64
//! ```
//!
//! The accesses are those of the draws of the paper's kernel, as a run does them, on a tile whose
//! cells outgrow the first of these caches, whose blocks the second, and which itself outgrows
//! the third. The arguments are the levels of the model: bytes, ways and bytes of a line of each.
//! It prints what the model counts, as JSON; cachegrind's counts are those of the function
//! `replay::replay`. A second run with the second level as `--LL` gives those of that level, as
//! cachegrind has only two.

use std::hint::black_box;

use anyhow::{Context, bail};
use perceptile::profile::access::{self, Arrangement, DrawOrder, Listener, StepDraws, Streams};
use perceptile::profile::cache::{CacheLevel, Hierarchy};
use perceptile::profile::subject::Subject;
use perceptile::solver::Preset;
use perceptile::tile::TileShape;
use serde_json::json;

/// Bytes of a word; all arrays consist of them.
const WORD: u64 = 4;
/// Accesses that are noted at once; 3 KiB, so that the notes themselves stay in the first cache.
const BATCH: usize = 256;
/// Draws of a step; many, so that not all misses are those of the update.
const DRAWS: usize = 16_384;
/// Steps that are played.
const STEPS: u32 = 2;

/// One access.
#[derive(Debug, Clone, Copy)]
struct Note {
    /// First word.
    offset: u32,
    /// Number of words.
    words: u32,
    write: bool,
}

/// Notes accesses, and gives them on in batches in a place that stays the same.
struct Batches<'a, F> {
    notes: &'a mut Vec<Note>,
    batch: F,
}

impl<F: FnMut(&[Note])> Listener for Batches<'_, F> {
    fn access(&mut self, access: access::Access) {
        let offset = (access.address / WORD) as u32;
        let words = access.touched / WORD as u32;
        self.notes.push(Note { offset, words, write: access.write });
        if self.notes.len() == BATCH {
            (self.batch)(self.notes);
            self.notes.clear();
        }
    }
}

/// Calls `batch` with all accesses.
fn batches(
    streams: &Streams,
    draws: &[StepDraws],
    notes: &mut Vec<Note>,
    batch: impl FnMut(&[Note]),
) {
    notes.clear();
    let mut batches = Batches { notes, batch };
    for draws in draws {
        streams.draws(draws, &mut batches);
        streams.update(u64::MAX, &mut batches);
    }
    (batches.batch)(batches.notes);
}

/// Does the accesses. Not inlined, so that cachegrind tells what they miss.
#[inline(never)]
fn replay(notes: &[Note], memory: &mut [u32]) -> u32 {
    let mut sum = 0_u32;
    for note in notes {
        let first = note.offset as usize;
        let words = &mut memory[first..first + note.words as usize];
        if note.write {
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
    let mut options = Preset::Paper.options();
    options.shape = TileShape::new(64, 64, 32, 1, 2)?;
    options.draw.draws = DRAWS;
    let kernel = options.kernel.resolve(options.shape)?;
    let subject = Subject::new(&options, &kernel, 1)?;
    let streams = Streams::new(&subject, Arrangement::Rows, DrawOrder::Sorted);
    let draws: Vec<StepDraws> =
        (0..STEPS).map(|step| StepDraws::new(&subject, step, u64::MAX, u64::MAX)).collect();

    let mut memory = vec![0; (streams.bytes() / WORD) as usize];
    let mut notes = Vec::with_capacity(BATCH);
    let mut sum = 0_u32;
    batches(&streams, &draws, &mut notes, |notes| {
        sum = sum.wrapping_add(replay(notes, &mut memory))
    });
    black_box(sum);

    let begun = std::time::Instant::now();
    let mut accesses = 0_u64;
    batches(&streams, &draws, &mut notes, |notes| {
        accesses += notes.len() as u64;
        for note in notes {
            let itself = std::ptr::from_ref(note) as u64;
            caches.access(itself, size_of::<Note>() as u32, false);
            let word = std::ptr::from_ref(&memory[note.offset as usize]) as u64;
            caches.access(word, note.words * WORD as u32, note.write);
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
