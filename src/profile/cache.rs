//! Caches as a model: what a stream of accesses would miss, whatever the machine it runs on.
//!
//! [`Hierarchy`] is the model of valgrind's cachegrind with any number of levels: LRU sets,
//! write-allocate, and a level is asked only for what the one above it misses. Departures from
//! cachegrind: an access that straddles lines counts once for each line, the number of sets need
//! not be a power of two, and dirty lines are followed on their way to memory. Like cachegrind it
//! has no prefetcher, no TLB and no second core. [`Reuse`] gives the misses of all fully
//! associative sizes at once, and [`Footprint`] what a few accesses touch.

use std::collections::HashMap;
use std::fmt;
use std::hash::{BuildHasherDefault, Hasher};

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Bytes of a page in [`Footprint`].
pub const PAGE: u64 = 4096;
/// Fewest bytes of a line: two bits of a line's number are then free for its state.
const SMALLEST_LINE: u32 = 4;
/// Most lines of a level, 4 GiB of the usual ones, which the model keeps in half a gigabyte.
const MOST_LINES: u64 = 1 << 26;
/// A way that holds no line; line numbers end below it.
const EMPTY: u64 = u64::MAX;
/// The bit of a way whose line was written to.
const DIRTY: u64 = 1;

/// Why caches cannot be like that.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum CacheError {
    /// There is no cache at all.
    #[error("a hierarchy needs at least one level of cache")]
    NoLevels,
    /// A line has an impossible size.
    #[error("lines of {0} bytes; they must be a power of two of at least {SMALLEST_LINE}")]
    Line(u32),
    /// A set or the whole has no room.
    #[error("{0} has no bytes or no ways")]
    Zero(CacheLevel),
    /// The size is not a whole number of sets.
    #[error("{0}: the size is not a multiple of ways × line")]
    Fraction(CacheLevel),
    /// The level is larger than the model can follow.
    #[error("{0} has more than {MOST_LINES} lines")]
    Huge(CacheLevel),
    /// A line is smaller than those of the level above.
    #[error("{0} has smaller lines than the level above it")]
    Shrinking(CacheLevel),
}

/// The geometry of one cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CacheLevel {
    /// Its level, 1 nearest to the core; only a name.
    pub level: u32,
    /// Its size in bytes, a multiple of `ways * line`.
    pub bytes: u64,
    /// Lines in a set, at least 1.
    pub ways: u32,
    /// Bytes of a line, a power of two of at least 4.
    pub line: u32,
}

impl CacheLevel {
    /// The number of sets, at least 1 and not always a power of two.
    ///
    /// # Errors
    /// If the geometry is impossible.
    pub fn sets(&self) -> Result<u64, CacheError> {
        if !self.line.is_power_of_two() || self.line < SMALLEST_LINE {
            return Err(CacheError::Line(self.line));
        }
        if self.bytes == 0 || self.ways == 0 {
            return Err(CacheError::Zero(*self));
        }
        let set = u64::from(self.ways) * u64::from(self.line);
        if !self.bytes.is_multiple_of(set) {
            return Err(CacheError::Fraction(*self));
        }
        if self.bytes / u64::from(self.line) > MOST_LINES {
            return Err(CacheError::Huge(*self));
        }
        Ok(self.bytes / set)
    }
}

impl fmt::Display for CacheLevel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { level, bytes, ways, line } = self;
        write!(f, "L{level} of {bytes} bytes, {ways} ways, {line} bytes a line")
    }
}

/// What happened at one level, in lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Reads that came to this level.
    pub reads: u64,
    /// Writes that came to this level.
    pub writes: u64,
    /// Reads of lines that were not there.
    pub read_misses: u64,
    /// Writes to lines that were not there; they are fetched first.
    pub write_misses: u64,
    /// Changed lines that went from here to the level below, or on their way there passed by.
    /// They are no accesses, and those still here at the end are not among them.
    pub write_backs: u64,
}

impl Counts {
    /// Reads and writes.
    pub fn accesses(&self) -> u64 {
        self.reads + self.writes
    }

    /// Misses of both kinds: lines fetched from the level below.
    pub fn misses(&self) -> u64 {
        self.read_misses + self.write_misses
    }

    /// Lines exchanged with the level below, in both directions.
    pub fn traffic(&self) -> u64 {
        self.misses() + self.write_backs
    }
}

/// How a line's number gives its set.
#[derive(Debug, Clone, Copy)]
enum Index {
    /// By its low bits.
    Mask(u64),
    /// By the remainder, when the number of sets is no power of two.
    Modulo(u64),
}

/// One cache with what it holds.
#[derive(Debug, Clone)]
struct Cache {
    geometry: CacheLevel,
    /// Binary logarithm of the bytes of a line.
    shift: u32,
    index: Index,
    ways: usize,
    /// `line << 1 | dirty` of all sets one after the other, the last used first in each.
    slots: Vec<u64>,
    counts: Counts,
}

impl Cache {
    fn new(geometry: CacheLevel) -> Result<Self, CacheError> {
        let sets = geometry.sets()?;
        let lines = (geometry.bytes / u64::from(geometry.line)) as usize;
        Ok(Self {
            geometry,
            shift: geometry.line.trailing_zeros(),
            index: if sets.is_power_of_two() { Index::Mask(sets - 1) } else { Index::Modulo(sets) },
            ways: geometry.ways as usize,
            slots: vec![EMPTY; lines],
            counts: Counts::default(),
        })
    }

    /// The ways in which a line can be.
    #[inline]
    fn set(&mut self, line: u64) -> &mut [u64] {
        let set = match self.index {
            Index::Mask(mask) => line & mask,
            Index::Modulo(sets) => line % sets,
        };
        let first = set as usize * self.ways;
        &mut self.slots[first..first + self.ways]
    }

    /// Makes a line the last used of its set. If it was not there, returns the slot that it
    /// pushed out.
    #[inline]
    fn touch(&mut self, line: u64, dirty: bool) -> Option<u64> {
        let set = self.set(line);
        let dirty = u64::from(dirty);
        if set[0] >> 1 == line {
            set[0] |= dirty;
            return None;
        }
        // Everything moves back by one, up to the place where the line was.
        let mut carried = line << 1 | dirty;
        for slot in set.iter_mut() {
            std::mem::swap(slot, &mut carried);
            if carried >> 1 == line {
                set[0] |= carried & DIRTY;
                return None;
            }
        }
        Some(carried)
    }

    /// Marks a line as changed, if it is here; it does not count as a use.
    fn soil(&mut self, line: u64) -> bool {
        let slot = self.set(line).iter_mut().find(|slot| **slot >> 1 == line);
        slot.map(|slot| *slot |= DIRTY).is_some()
    }
}

/// Several levels of cache, the one nearest to the core first.
///
/// ```
/// use perceptile::profile::cache::{CacheLevel, Hierarchy};
///
/// let l1 = CacheLevel { level: 1, bytes: 32 << 10, ways: 8, line: 64 };
/// let l2 = CacheLevel { level: 2, bytes: 1 << 20, ways: 16, line: 64 };
/// let mut caches = Hierarchy::new(&[l1, l2])?;
/// for _ in 0..2 {
///     for address in (0..65536).step_by(4) {
///         caches.access(address, 4, false);
///     }
/// }
/// // 64 KiB pass through L1 twice, but stay in L2.
/// assert_eq!(caches.counts().map(|(_, counts)| counts.misses()).collect::<Vec<_>>(), [2048, 1024]);
/// # Ok::<(), perceptile::profile::cache::CacheError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Hierarchy {
    caches: Vec<Cache>,
}

impl Hierarchy {
    /// Empty caches of these geometries.
    ///
    /// # Errors
    /// If there are none, one of them is impossible or larger than the model can follow, or lines
    /// become smaller from one level to the next.
    pub fn new(levels: &[CacheLevel]) -> Result<Self, CacheError> {
        if levels.is_empty() {
            return Err(CacheError::NoLevels);
        }
        if let Some(pair) = levels.windows(2).find(|pair| pair[1].line < pair[0].line) {
            return Err(CacheError::Shrinking(pair[1]));
        }
        let caches = levels.iter().copied().map(Cache::new).collect::<Result<_, _>>()?;
        Ok(Self { caches })
    }

    /// Reads or writes bytes. Those past the end of the address space are left out, and no bytes
    /// are no access.
    #[inline]
    pub fn access(&mut self, address: u64, bytes: u32, write: bool) {
        let Some(further) = bytes.checked_sub(1) else { return };
        let shift = self.caches[0].shift;
        for line in address >> shift..=address.saturating_add(u64::from(further)) >> shift {
            self.line(line << shift, write);
        }
    }

    /// Reads or writes the line of the first level that begins at `address`.
    #[inline]
    fn line(&mut self, address: u64, write: bool) {
        for depth in 0..self.caches.len() {
            let cache = &mut self.caches[depth];
            let count = if write { &mut cache.counts.writes } else { &mut cache.counts.reads };
            *count += 1;
            // What is written to is the copy in the first level; the others hear of it later.
            let pushed = cache.touch(address >> cache.shift, write && depth == 0);
            let Some(pushed) = pushed else { return };
            let Counts { read_misses, write_misses, .. } = &mut cache.counts;
            *if write { write_misses } else { read_misses } += 1;
            if pushed != EMPTY && pushed & DIRTY != 0 {
                let address = (pushed >> 1) << cache.shift;
                self.write_back(depth, address);
            }
        }
    }

    /// Sends a changed line down from the level `depth` until one is found that has it.
    fn write_back(&mut self, depth: usize, address: u64) {
        self.caches[depth].counts.write_backs += 1;
        for cache in &mut self.caches[depth + 1..] {
            if cache.soil(address >> cache.shift) {
                return;
            }
            cache.counts.write_backs += 1;
        }
    }

    /// The levels and what happened at each, nearest to the core first.
    pub fn counts(&self) -> impl ExactSizeIterator<Item = (CacheLevel, Counts)> {
        self.caches.iter().map(|cache| (cache.geometry, cache.counts))
    }

    /// Counts from zero again; the caches keep what they hold.
    pub fn restart(&mut self) {
        for cache in &mut self.caches {
            cache.counts = Counts::default();
        }
    }
}

/// Spreads the numbers of lines, of which neighbours are used together, over a table.
#[derive(Debug, Clone, Copy, Default)]
struct LineHasher(u64);

impl Hasher for LineHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_u64(&mut self, line: u64) {
        // The golden ratio brings entropy into the high bits, which the table looks at first; the
        // shift brings it into the low ones.
        let product = (self.0 ^ line).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ product >> 32;
    }
}

/// How far apart the uses of a line are, in distinct other lines used between them.
///
/// That is the stack distance of LRU: a fully associative cache of n lines hits exactly when it
/// is below n. By the method of Olken (1981): each line has the time of its last use, a Fenwick
/// tree over time marks those times, and the marks after a line's last use are the distance. An
/// access takes time logarithmic in the number of distinct lines.
#[derive(Debug, Clone)]
pub struct Reuse {
    shift: u32,
    /// The time of each line's last use.
    last: HashMap<u64, usize, BuildHasherDefault<LineHasher>>,
    /// The line used at each time; [`EMPTY`] once it is used again.
    used: Vec<u64>,
    /// The Fenwick tree of the marks: node `i` sums as many as the lowest bit of `i + 1` says.
    marks: Vec<u32>,
    histogram: ReuseHistogram,
}

/// Uses of lines, by the distance from the one before.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ReuseHistogram {
    /// First uses.
    pub cold: u64,
    /// Bin 0 is distance 0, bin k > 0 the distances from 2ᵏ⁻¹ to 2ᵏ − 1; ends with the last one
    /// that is not empty.
    pub bins: Vec<u64>,
}

impl ReuseHistogram {
    /// Misses of a fully associative LRU cache of `2^log2` lines.
    pub fn misses(&self, log2: u32) -> u64 {
        self.cold + self.bins.iter().skip(log2 as usize + 1).sum::<u64>()
    }

    fn count(&mut self, distance: usize) {
        let bin = (usize::BITS - distance.leading_zeros()) as usize;
        if bin >= self.bins.len() {
            self.bins.resize(bin + 1, 0);
        }
        self.bins[bin] += 1;
    }
}

impl Reuse {
    /// Fewest times between two compactions.
    const SHORTEST: usize = 1 << 12;

    /// Nothing used yet, with lines of `line` bytes.
    ///
    /// # Errors
    /// If that is not a power of two of at least 4.
    pub fn new(line: u32) -> Result<Self, CacheError> {
        Ok(Self {
            shift: shift(line)?,
            last: HashMap::default(),
            used: Vec::with_capacity(Self::SHORTEST),
            marks: vec![0; Self::SHORTEST],
            histogram: ReuseHistogram::default(),
        })
    }

    /// Uses bytes; a write is a use like a read. Those past the end of the address space are left
    /// out.
    pub fn access(&mut self, address: u64, bytes: u32) {
        for line in lines(address, bytes, self.shift) {
            self.line(line);
        }
    }

    fn line(&mut self, line: u64) {
        if self.used.len() == self.marks.len() {
            self.compact();
        }
        let now = self.used.len();
        let lines = self.last.len();
        match self.last.insert(line, now) {
            None => self.histogram.cold += 1,
            Some(then) => {
                self.histogram.count(lines - self.marks_until(then));
                self.used[then] = EMPTY;
                self.mark(then, u32::MAX);
            }
        }
        self.used.push(line);
        self.mark(now, 1);
    }

    /// Marks at times up to and with `time`.
    fn marks_until(&self, time: usize) -> usize {
        let mut end = time + 1;
        let mut sum = 0;
        while end > 0 {
            sum += self.marks[end - 1] as usize;
            end &= end - 1;
        }
        sum
    }

    /// Adds to the marks of a time, modulo 2³².
    fn mark(&mut self, time: usize, change: u32) {
        let mut end = time + 1;
        while end <= self.marks.len() {
            self.marks[end - 1] = self.marks[end - 1].wrapping_add(change);
            end += end & end.wrapping_neg();
        }
    }

    /// Leaves out the times that no longer matter, so that their number stays within twice that
    /// of the lines (at which the cost of this, spread over the accesses, is constant).
    fn compact(&mut self) {
        self.used.retain(|&line| line != EMPTY);
        for (time, &line) in self.used.iter().enumerate() {
            self.last.insert(line, time);
        }
        let lines = self.used.len();
        let len = (2 * lines).max(Self::SHORTEST);
        self.marks.clear();
        // A node sums the marks of the times that end with its own.
        self.marks.extend((1..=len).map(|end| {
            let start = end & (end - 1);
            (end.min(lines) - start.min(lines)) as u32
        }));
        self.used.reserve(len - lines);
    }

    /// What was counted until now.
    pub fn histogram(&self) -> &ReuseHistogram {
        &self.histogram
    }
}

/// The distinct lines and pages of a few accesses.
#[derive(Debug, Clone)]
pub struct Footprint {
    shift: u32,
    lines: Vec<u64>,
    pages: Vec<u64>,
}

/// What a group of accesses touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Touched {
    /// Distinct cache lines.
    pub lines: u64,
    /// Distinct pages of 4 KiB.
    pub pages: u64,
}

impl Footprint {
    /// Nothing touched yet, with lines of `line` bytes.
    ///
    /// # Errors
    /// If that is not a power of two of at least 4.
    pub fn new(line: u32) -> Result<Self, CacheError> {
        Ok(Self { shift: shift(line)?, lines: Vec::new(), pages: Vec::new() })
    }

    /// Touches bytes. Those past the end of the address space are left out.
    pub fn access(&mut self, address: u64, bytes: u32) {
        self.lines.extend(lines(address, bytes, self.shift));
        self.pages.extend(lines(address, bytes, PAGE.trailing_zeros()));
    }

    /// Ends the group, and begins the next one with nothing touched. The room for it is kept.
    pub fn take(&mut self) -> Touched {
        let distinct = |items: &mut Vec<u64>| {
            items.sort_unstable();
            items.dedup();
            items.drain(..).len() as u64
        };
        Touched { lines: distinct(&mut self.lines), pages: distinct(&mut self.pages) }
    }
}

/// The binary logarithm of the bytes of a line.
fn shift(line: u32) -> Result<u32, CacheError> {
    if line.is_power_of_two() && line >= SMALLEST_LINE {
        Ok(line.trailing_zeros())
    } else {
        Err(CacheError::Line(line))
    }
}

/// The lines of `2^shift` bytes that an access touches.
fn lines(address: u64, bytes: u32, shift: u32) -> impl Iterator<Item = u64> {
    let further = bytes.checked_sub(1);
    let last = further.map(|further| address.saturating_add(u64::from(further)) >> shift);
    last.into_iter().flat_map(move |last| address >> shift..=last)
}

#[cfg(test)]
mod tests {
    use std::collections::{HashSet, VecDeque};

    use proptest::prelude::*;

    use super::*;

    fn level(level: u32, sets: u64, ways: u32, line: u32) -> CacheLevel {
        CacheLevel { level, bytes: sets * u64::from(ways) * u64::from(line), ways, line }
    }

    /// A line in the naive cache.
    #[derive(Clone, Copy)]
    struct Kept {
        line: u64,
        dirty: bool,
    }

    /// A cache as lists, the last used line in front, one for each set.
    struct Naive {
        geometry: CacheLevel,
        sets: Vec<VecDeque<Kept>>,
        counts: Counts,
    }

    impl Naive {
        fn set(&mut self, address: u64) -> (u64, &mut VecDeque<Kept>) {
            let line = address / u64::from(self.geometry.line);
            let sets = self.sets.len() as u64;
            (line, &mut self.sets[(line % sets) as usize])
        }
    }

    fn naive(levels: &[CacheLevel]) -> Vec<Naive> {
        let cache = |&geometry: &CacheLevel| Naive {
            geometry,
            sets: vec![VecDeque::new(); geometry.sets().unwrap() as usize],
            counts: Counts::default(),
        };
        levels.iter().map(cache).collect()
    }

    /// One line through the naive caches, by recursion.
    fn touch(caches: &mut [Naive], address: u64, write: bool, first: bool) {
        let Some((cache, below)) = caches.split_first_mut() else { return };
        *if write { &mut cache.counts.writes } else { &mut cache.counts.reads } += 1;
        let ways = cache.geometry.ways as usize;
        let (line, set) = cache.set(address);
        let found = set.iter().position(|kept| kept.line == line);
        let before = found.and_then(|place| set.remove(place));
        let dirty = before.is_some_and(|kept| kept.dirty) || (write && first);
        set.push_front(Kept { line, dirty });
        let pushed = if set.len() > ways { set.pop_back() } else { None };
        if before.is_some() {
            return;
        }
        *if write { &mut cache.counts.write_misses } else { &mut cache.counts.read_misses } += 1;
        if let Some(Kept { line, dirty: true }) = pushed {
            let address = line * u64::from(cache.geometry.line);
            cache.counts.write_backs += 1;
            for cache in &mut *below {
                let (line, set) = cache.set(address);
                if let Some(kept) = set.iter_mut().find(|kept| kept.line == line) {
                    kept.dirty = true;
                    break;
                }
                cache.counts.write_backs += 1;
            }
        }
        touch(below, address, write, false);
    }

    fn counts(caches: &Hierarchy) -> Vec<Counts> {
        caches.counts().map(|(_, counts)| counts).collect()
    }

    /// Accesses that come back to where they were, some across lines.
    fn accesses() -> impl Strategy<Value = Vec<(u64, u32, bool)>> {
        let near = (0..6000_u64, 1..200_u32, any::<bool>());
        let far = (any::<u64>(), 1..9_u32, any::<bool>());
        prop::collection::vec(prop_oneof![9 => near, 1 => far], 1..600)
    }

    fn geometries() -> impl Strategy<Value = Vec<CacheLevel>> {
        let one = (1..9_u64, 1..6_u32, 0..2_u32);
        prop::collection::vec(one, 1..4).prop_map(|levels| {
            let mut line = 8;
            let grow = |(depth, &(sets, ways, larger)): (usize, &(u64, u32, u32))| {
                line <<= larger;
                level(depth as u32 + 1, sets << (2 * depth), ways, line)
            };
            levels.iter().enumerate().map(grow).collect()
        })
    }

    proptest! {
        #[test]
        fn model_counts_like_lists(levels in geometries(), accesses in accesses()) {
            let mut caches = Hierarchy::new(&levels).unwrap();
            let mut lists = naive(&levels);
            let line = u64::from(levels[0].line);
            for &(address, bytes, write) in &accesses {
                caches.access(address, bytes, write);
                let touched: HashSet<u64> = (0..u64::from(bytes))
                    .filter_map(|byte| Some(address.checked_add(byte)? / line))
                    .collect();
                let mut touched: Vec<u64> = touched.into_iter().collect();
                touched.sort_unstable();
                for number in touched {
                    touch(&mut lists, number * line, write, true);
                }
            }
            let expected: Vec<Counts> = lists.iter().map(|list| list.counts).collect();
            prop_assert_eq!(counts(&caches), expected);
        }

        #[test]
        fn reuse_counts_like_looking_back(accesses in accesses(), log2 in 2..7_u32) {
            let mut reuse = Reuse::new(1 << log2).unwrap();
            let mut used: Vec<u64> = Vec::new();
            let mut expected = ReuseHistogram::default();
            for &(address, bytes, _) in &accesses {
                reuse.access(address, bytes);
                let last = address.saturating_add(u64::from(bytes) - 1) >> log2;
                for line in address >> log2..=last {
                    match used.iter().rposition(|&before| before == line) {
                        None => expected.cold += 1,
                        Some(before) => {
                            let between: HashSet<u64> = used[before + 1..].iter().copied().collect();
                            let bin = (0..).find(|&bin| between.len() < 1 << bin).unwrap();
                            if expected.bins.len() <= bin {
                                expected.bins.resize(bin + 1, 0);
                            }
                            expected.bins[bin] += 1;
                        }
                    }
                    used.push(line);
                }
            }
            prop_assert_eq!(reuse.histogram(), &expected);
        }

        #[test]
        fn reuse_tells_the_misses_of_full_associativity(accesses in accesses()) {
            let mut reuse = Reuse::new(16).unwrap();
            for &(address, bytes, _) in &accesses {
                reuse.access(address, bytes);
            }
            for log2 in 0..10 {
                let mut cache = Hierarchy::new(&[level(1, 1, 1 << log2, 16)]).unwrap();
                for &(address, bytes, write) in &accesses {
                    cache.access(address, bytes, write);
                }
                prop_assert_eq!(counts(&cache)[0].misses(), reuse.histogram().misses(log2));
            }
        }

        #[test]
        fn footprints_are_the_distinct_lines_and_pages(accesses in accesses(), log2 in 2..8_u32) {
            let mut footprint = Footprint::new(1 << log2).unwrap();
            for group in accesses.chunks(7) {
                let (mut lines, mut pages) = (HashSet::new(), HashSet::new());
                for &(address, bytes, _) in group {
                    footprint.access(address, bytes);
                    for byte in (0..u64::from(bytes)).filter_map(|i| address.checked_add(i)) {
                        lines.insert(byte >> log2);
                        pages.insert(byte / PAGE);
                    }
                }
                let expected = Touched { lines: lines.len() as u64, pages: pages.len() as u64 };
                prop_assert_eq!(footprint.take(), expected);
            }
        }
    }

    #[test]
    fn sweeps_miss_always_or_only_at_first() {
        for (sets, ways, line) in [(64, 8, 64), (1, 16, 32), (96, 3, 128), (7, 1, 4)] {
            let geometry = level(1, sets, ways, line);
            let lines = geometry.bytes / u64::from(line);
            let sweeps = 5;
            for (extra, expected) in [(0, lines), (sets, (lines + sets) * sweeps)] {
                let mut cache = Hierarchy::new(&[geometry]).unwrap();
                for _ in 0..sweeps {
                    for number in 0..lines + extra {
                        cache.access(number * u64::from(line), 4, true);
                    }
                }
                let found = counts(&cache)[0];
                assert_eq!(found.write_misses, expected, "{geometry}, {extra} lines more");
                assert_eq!(found.write_backs, if extra == 0 { 0 } else { expected - lines });
                assert_eq!(found.accesses(), sweeps * (lines + extra));
            }
        }
    }

    #[test]
    fn changed_lines_reach_memory_through_all_levels() {
        let mut caches = Hierarchy::new(&[level(1, 2, 2, 64), level(2, 4, 4, 64)]).unwrap();
        // 100 lines written once each, then 16 others read, which push all of them out.
        for number in 0..100 {
            caches.access(number * 64, 64, true);
        }
        for number in 100..116 {
            caches.access(number * 64, 64, false);
        }
        for counts in counts(&caches) {
            assert_eq!(counts.write_backs, 100);
            assert_eq!(counts.traffic(), 216);
        }
        caches.restart();
        assert_eq!(counts(&caches), [Counts::default(); 2]);
        caches.access(115 * 64, 1, false);
        assert_eq!(counts(&caches)[0].misses(), 0);
    }

    #[test]
    fn distances_survive_many_compactions() {
        // A cycle of n lines has the distance n − 1, for ever.
        for lines in [1, 100, 5000, 20_000_u64] {
            let mut reuse = Reuse::new(64).unwrap();
            let rounds = 100_000 / lines + 2;
            for _ in 0..rounds {
                for line in 0..lines {
                    reuse.access(line * 64 + 3, 8);
                }
            }
            let histogram = reuse.histogram();
            assert_eq!(histogram.cold, lines);
            assert_eq!(*histogram.bins.last().unwrap(), lines * (rounds - 1));
            assert_eq!(histogram.bins.iter().sum::<u64>(), lines * (rounds - 1));
            assert_eq!(histogram.bins.len() as u32, 64 - (lines - 1).leading_zeros() + 1);
            assert!(reuse.marks.len() <= (2 * lines as usize).max(Reuse::SHORTEST));
        }
    }

    #[test]
    fn impossible_geometries_are_refused() {
        let new = |bytes, ways, line| {
            Hierarchy::new(&[CacheLevel { level: 1, bytes, ways, line }]).map(|_| ())
        };
        assert!(matches!(new(0, 8, 64), Err(CacheError::Zero(_))));
        assert!(matches!(new(4096, 0, 64), Err(CacheError::Zero(_))));
        assert!(matches!(new(4096, 8, 0), Err(CacheError::Line(0))));
        assert!(matches!(new(4096, 8, 48), Err(CacheError::Line(48))));
        assert!(matches!(new(4096, 8, 2), Err(CacheError::Line(2))));
        assert!(matches!(new(4100, 8, 64), Err(CacheError::Fraction(_))));
        assert!(matches!(new(u64::MAX, u32::MAX, 1 << 31), Err(CacheError::Fraction(_))));
        assert!(matches!(new(1 << 60, 16, 64), Err(CacheError::Huge(_))));
        assert!(matches!(Hierarchy::new(&[]), Err(CacheError::NoLevels)));
        let shrinking = Hierarchy::new(&[level(1, 1, 1, 64), level(2, 1, 1, 32)]);
        assert!(matches!(shrinking, Err(CacheError::Shrinking(_))));
        assert_eq!(Reuse::new(0).err(), Some(CacheError::Line(0)));
        assert_eq!(Footprint::new(1).err(), Some(CacheError::Line(1)));
    }

    #[test]
    fn no_bytes_are_no_access_and_the_last_byte_is_one() {
        let mut cache = Hierarchy::new(&[level(1, 3, 2, 64)]).unwrap();
        cache.access(5, 0, true);
        assert_eq!(counts(&cache)[0], Counts::default());
        cache.access(u64::MAX, 100, true);
        assert_eq!(counts(&cache)[0].write_misses, 1);
    }
}
