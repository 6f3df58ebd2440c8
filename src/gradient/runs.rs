//! The subsets of a kernel as runs of neighbouring pixels.
//!
//! The taps above a threshold lie in runs along x, which are runs in memory, too: a draw of the
//! paper's kernel has 60 samples in 12 runs. The samples of a subset stand in the order of the
//! offsets (dy, dt, dx), whatever the layout; where projections are equal this order decides.

use crate::draw::{LevelSet, LevelSets};

/// Pixels side by side, as an offset from the draw's pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
    /// Rows down.
    pub dy: i32,
    /// Frames onwards, less than a period either way.
    pub dt: i32,
    /// Columns to the right.
    pub dx: i32,
    /// Number of pixels.
    pub len: u32,
}

/// Most runs that are kept in tables; sets with more are taken apart draw by draw.
const TABLE_LIMIT: usize = 1 << 17;

/// The runs of all subsets that draws can have.
#[derive(Debug, Clone)]
pub struct RunTables {
    sets: Vec<SetRuns>,
}

/// The runs of one level set.
#[derive(Debug, Clone)]
enum SetRuns {
    /// For every number of taps, where its runs begin and end in a list.
    Table { places: Vec<(u32, u32)>, runs: Vec<Run> },
    /// The taps by offset, each with its position by weight.
    Taps(Vec<(Run, u32)>),
}

impl RunTables {
    /// Runs of `levels` on a tile of `frames`.
    pub fn new(levels: &LevelSets, frames: usize) -> Self {
        let set = |set| SetRuns::new(set, frames, TABLE_LIMIT);
        Self { sets: levels.sets().iter().map(set).collect() }
    }

    /// The runs of the first `taps` taps of a set, by weight; `scratch` is lent to make them in.
    #[inline(always)]
    pub fn of<'a>(&'a self, set: usize, taps: usize, scratch: &'a mut Vec<Run>) -> &'a [Run] {
        self.sets[set].of(taps, scratch)
    }
}

impl SetRuns {
    /// Tables of at most about `limit` runs, or none.
    fn new(set: &LevelSet, frames: usize, limit: usize) -> Self {
        let mut taps: Vec<(Run, u32)> = set
            .offsets
            .iter()
            .zip(0..)
            // However far a tap lies, it is less than a period away around the torus.
            .map(|(o, by)| (Run { dy: o.y, dt: o.z % frames as i32, dx: o.x, len: 1 }, by))
            .collect();
        taps.sort_by_key(|(tap, by)| (tap.dy, tap.dt, tap.dx, *by));
        let mut places = vec![(0, 0)];
        let mut runs = Vec::new();
        for count in 1..=taps.len() {
            let start = runs.len();
            // Taps of equal weight are in a subset together, so no subset ends between them.
            if set.ends_level(count) {
                join(&taps, count as u32, &mut runs);
            }
            places.push((start as u32, runs.len() as u32));
            if runs.len() > limit {
                return Self::Taps(taps);
            }
        }
        Self::Table { places, runs }
    }

    #[inline(always)]
    fn of<'a>(&'a self, taps: usize, scratch: &'a mut Vec<Run>) -> &'a [Run] {
        match self {
            Self::Table { places, runs } => {
                let (start, end) = places[taps];
                &runs[start as usize..end as usize]
            }
            Self::Taps(all) => {
                scratch.clear();
                join(all, taps as u32, scratch);
                scratch
            }
        }
    }
}

/// Joins the taps whose position by weight is below `count`, which are sorted by offset.
fn join(taps: &[(Run, u32)], count: u32, runs: &mut Vec<Run>) {
    let start = runs.len();
    for &(tap, _) in taps.iter().filter(|(_, by)| *by < count) {
        match runs[start..].last_mut() {
            Some(run) if (run.dy, run.dt, run.dx + run.len as i32) == (tap.dy, tap.dt, tap.dx) => {
                run.len += 1;
            }
            _ => runs.push(tap),
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::IVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::kernel::{KernelTaps, Tap};

    proptest! {
            #[test]
            fn runs_are_the_taps_above_a_threshold_in_order(
                weights in prop::collection::btree_map(
                    (-4_i32..5, -3_i32..4, -9_i32..9), prop::sample::select(vec![0.1, 0.2, 0.5, -0.3]),
                    1..80),
                frames in 1_usize..8,
            ) {
                let tap = |(&(x, y, t), &weight): (&(i32, i32, i32), &f64)| {
                    Tap { offset: IVec3::new(x, y, t), weight }
                };
                let kernel = KernelTaps::new(weights.iter().map(tap)).unwrap();
                let levels = LevelSets::new([(1.0, &kernel)]);
                for set in levels.sets() {
                    let (table, taps) = (SetRuns::new(set, frames, 1 << 20), SetRuns::new(set, frames, 0));
    let kinds = (&table, &taps);
                    let both = matches!(kinds, (SetRuns::Table { .. }, SetRuns::Taps(_)));
                    prop_assert!(both);
                    for threshold in [0.0, 0.15, 0.35, 0.5, 0.9] {
                        let count = set.above(threshold);
                        let mut expected: Vec<(i32, i32, i32)> = set.offsets[..count]
                            .iter()
                            .map(|o| (o.y, o.z % frames as i32, o.x))
                            .collect();
                        expected.sort_unstable();
                        for runs in [&table, &taps] {
                            let mut scratch = Vec::new();
                            let runs = runs.of(count, &mut scratch);
                            let found: Vec<_> = runs
                                .iter()
                                .flat_map(|run| {
                                    (0..run.len as i32).map(|i| (run.dy, run.dt, run.dx + i))
                                })
                                .collect();
                            prop_assert_eq!(&found, &expected);
                            // Neighbours are in one run, as far as no pixel is there twice.
                            let apart = runs.windows(2).all(|pair| {
                                let end = pair[0].dx + pair[0].len as i32;
                                (pair[0].dy, pair[0].dt, end) != (pair[1].dy, pair[1].dt, pair[1].dx)
                            });
                            prop_assert!(apart);
                        }
                    }
                }
            }
        }
}
