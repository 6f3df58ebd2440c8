//! What is done in which wave: known beforehand, so that all processes do the same without a word.
//!
//! In wave n, sweep k visits frame n − k·[`LAG`]. Before its first visit the frames that see it must
//! have a residual, and for that the frames around those must be there.

use std::ops::Range;

use super::footprint::Footprint;

/// Frames between one sweep and the next. A larger distance makes the window larger and the result no
/// better; without one, frames that come later are not yet there to make up for the error.
pub const LAG: usize = 1;

/// Waves after which the residual is made anew from what is chosen: no rounding error stays, and a
/// selection can go on from there with nothing but its choices.
pub const RENEWAL: usize = 32;

/// The waves of a selection.
#[derive(Debug, Clone, Copy)]
pub(super) struct Schedule {
    frames: usize,
    sweeps: usize,
    /// Frames behind a pixel's, and before it, whose error it is part of.
    past: usize,
    future: usize,
}

/// A wave: ranges of frames, in the order in which they have their turn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Wave {
    /// Those whose residual is made anew.
    pub renews: Range<usize>,
    /// Those that get a residual, and whose renders are scored if they are in `scored_renders`.
    pub prepares: Range<usize>,
    pub scored_renders: Range<usize>,
    /// Those that get a curvature.
    pub curves: Range<usize>,
    /// Sweeps and the frames that they visit.
    pub visits: Vec<(usize, usize)>,
    /// The one that is done.
    pub done: Option<usize>,
    /// Those whose choices are scored.
    pub scored: Range<usize>,
    pub is_last: bool,
}

impl Schedule {
    pub fn new(frames: usize, footprint: &Footprint, sweeps: usize) -> Self {
        let (past, future) = (footprint.high.z as usize, -footprint.low.z as usize);
        Self { frames, sweeps, past, future }
    }

    /// Frames that the first sweep is ahead of the last.
    pub fn spread(&self) -> usize {
        (self.sweeps - 1) * LAG
    }

    /// Number of waves.
    pub fn waves(&self) -> usize {
        self.frames + self.spread()
    }

    /// Frames that must be there for the waves before this one.
    pub fn started(&self, wave: usize) -> usize {
        match wave {
            0 => 0,
            _ => (wave + self.past + self.future).min(self.frames),
        }
    }

    /// Frames that have a residual before this wave.
    fn prepared(&self, wave: usize) -> usize {
        match wave {
            0 => 0,
            _ => (wave + self.past).min(self.frames),
        }
    }

    /// Whether the residual is made anew in this wave.
    pub fn is_renewal(wave: usize) -> bool {
        wave > 0 && wave.is_multiple_of(RENEWAL)
    }

    /// The first frame whose error a wave can change.
    fn oldest_seen(&self, wave: usize) -> usize {
        wave.saturating_sub(self.spread() + self.future)
    }

    /// The first frame whose choices a wave that is a renewal looks at.
    pub fn oldest_read(&self, wave: usize) -> usize {
        self.oldest_seen(wave).saturating_sub(self.past)
    }

    /// The frames that are scored: those in which the kernel has all its frames, or all frames of an
    /// animation that is too short for that.
    fn scored(&self) -> Range<usize> {
        let whole = self.past..self.frames.saturating_sub(self.future);
        if whole.is_empty() { 0..self.frames } else { whole }
    }

    /// A wave of a selection that began with wave `first`.
    pub fn wave(&self, wave: usize, first: usize) -> Wave {
        let (frames, spread) = (self.frames, self.spread());
        let prepares = self.prepared(wave)..self.prepared(wave + 1);
        let renews = match Self::is_renewal(wave) {
            true => self.oldest_seen(wave)..self.prepared(wave),
            false => 0..0,
        };
        // Who goes on has none of the frames that are under way.
        let oldest = if wave == first { wave.saturating_sub(spread) } else { wave };
        let visit = |sweep: usize| {
            let frame = wave.checked_sub(sweep * LAG).filter(|&frame| frame < frames);
            frame.map(|frame| (sweep, frame))
        };
        let done = wave.checked_sub(spread).filter(|&frame| frame < frames);
        let before = |frame: usize| frame.saturating_sub(self.future);
        let seen = match done {
            Some(last) if last + 1 == frames => before(last)..frames,
            Some(last) => before(last)..before(last + 1),
            None => 0..0,
        };
        Wave {
            renews,
            scored_renders: common(prepares.clone(), self.scored()),
            prepares,
            curves: oldest..(wave + 1).min(frames),
            visits: (0..self.sweeps).filter_map(visit).collect(),
            done,
            scored: common(seen, self.scored()),
            is_last: wave + 1 == self.waves(),
        }
    }
}

/// What two ranges have in common.
fn common(a: Range<usize>, b: Range<usize>) -> Range<usize> {
    a.start.max(b.start)..a.end.min(b.end)
}

#[cfg(test)]
mod tests {
    use glam::IVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::kernel::{KernelTaps, Tap};

    proptest! {
        #[test]
        fn every_frame_has_its_turn_once_and_after_what_it_needs(
            frames in 1_usize..40, sweeps in 1_usize..8, past in 0..6_i32, future in 0..4_i32,
        ) {
            let ends = [-past, 0, future];
            let tap = |z: i32| Tap { offset: IVec3::new(0, 0, z), weight: 1.0 };
            let ends: std::collections::BTreeSet<i32> = ends.into_iter().collect();
            let kernel = KernelTaps::new(ends.into_iter().map(tap)).unwrap();
            let schedule = Schedule::new(frames, &Footprint::new(&kernel, 1.0), sweeps);
            let (past, future) = (past as usize, future as usize);
            let (mut started, mut prepared, mut curved) = (0, 0, 0);
            let mut visited = vec![0; frames];
            let (mut done, mut scored) = (Vec::new(), Vec::new());
            let mut renders = Vec::new();
            for wave in 0..schedule.waves() {
                let it = schedule.wave(wave, 0);
                prop_assert!(schedule.started(wave) == started);
                started = schedule.started(wave + 1);
                prop_assert_eq!(it.prepares.start, prepared);
                prepared = it.prepares.end;
                // All that the residual of a frame is made of.
                prop_assert!(started >= (prepared + future).min(frames));
                renders.extend(it.scored_renders.clone());
                if !it.curves.is_empty() {
                    prop_assert_eq!(it.curves.start, curved);
                    curved = it.curves.end;
                }
                for &(sweep, frame) in &it.visits {
                    prop_assert!(frame < curved);
                    prop_assert_eq!(visited[frame], sweep);
                    visited[frame] += 1;
                    // Every frame that sees it has a residual.
                    prop_assert!(prepared >= (frame + past + 1).min(frames));
                }
                done.extend(it.done);
                for frame in it.scored.clone() {
                    prop_assert!((frame + future).min(frames - 1) <= *done.last().unwrap());
                    scored.push(frame);
                }
                prop_assert_eq!(it.is_last, wave + 1 == schedule.waves());
            }
            prop_assert_eq!(&done, &Vec::from_iter(0..frames));
            prop_assert!(visited.iter().all(|&count| count == sweeps));
            prop_assert_eq!(&scored, &renders);
            prop_assert_eq!(&scored, &Vec::from_iter(schedule.scored()));
        }
    }
}
