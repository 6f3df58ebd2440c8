//! The subsets of a kernel as runs of neighbouring pixels.
//!
//! The taps above a threshold lie in runs along x, which are runs in memory, too: a draw of the
//! paper's kernel has 60 samples in 12 runs. The samples of a subset stand in the order of the
//! offsets (dy, dt, dx), whatever the layout; where projections are equal this order decides.

use crate::draw::LevelSets;

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
        let frames = frames as i32;
        let set = |set: &crate::draw::LevelSet| {
            let mut taps: Vec<(Run, u32)> = set
                .offsets
                .iter()
                .zip(0..)
                // However far a tap lies, it is less than a period away around the torus.
                .map(|(o, by)| (Run { dy: o.y, dt: o.z % frames, dx: o.x, len: 1 }, by))
                .collect();
            taps.sort_by_key(|(tap, by)| (tap.dy, tap.dt, tap.dx, *by));
            let mut places = vec![(0, 0)];
            let mut runs = Vec::new();
            for count in 1..=taps.len() {
                // Taps of equal weight are in a subset together, so no subset ends between them.
                if set.ends_level(count) {
                    let start = runs.len();
                    join(&taps, count as u32, &mut runs);
                    places.push((start as u32, runs.len() as u32));
                } else {
                    places.push((0, 0));
                }
                if runs.len() > TABLE_LIMIT {
                    return SetRuns::Taps(taps);
                }
            }
            SetRuns::Table { places, runs }
        };
        Self { sets: levels.sets().iter().map(set).collect() }
    }

    /// The runs of the first `taps` taps of a set, by weight; `scratch` is lent to make them in.
    #[inline(always)]
    pub fn of<'a>(&'a self, set: usize, taps: usize, scratch: &'a mut Vec<Run>) -> &'a [Run] {
        match &self.sets[set] {
            SetRuns::Table { places, runs } => {
                let (start, end) = places[taps];
                &runs[start as usize..end as usize]
            }
            SetRuns::Taps(all) => {
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
