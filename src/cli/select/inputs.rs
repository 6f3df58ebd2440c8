//! The animations that a selection reads, and frame by frame what the engine gets of them.

use std::path::PathBuf;

use perceptile::format::animation::{Animation, AnimationError};
use perceptile::select::{AnimationShape, Frame};

use super::{SelectArgs, Transfer};
use crate::cli::exit::{Failure, Misuse};

/// What is read.
#[derive(Debug)]
pub struct Inputs {
    pub candidates: Vec<Animation>,
    pub guide: Animation,
    /// The names as given: the guide first.
    pub names: Vec<PathBuf>,
    /// Whether the guide is the true picture.
    pub is_true: bool,
    pub subsets: bool,
    pub display: Option<Display>,
}

/// The levels of a display.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Display {
    pub levels: u32,
    pub transfer: Transfer,
}

impl Display {
    /// Most levels.
    const MOST: u32 = 1 << 16;

    /// The light of a level, at most 1.
    pub fn light(self, level: u32) -> f32 {
        let value = f64::from(level) / f64::from(self.levels - 1);
        let light = match self.transfer {
            Transfer::Linear => value,
            Transfer::Srgb if value <= 0.04045 => value / 12.92,
            Transfer::Srgb => libm::pow((value + 0.055) / 1.055, 2.4),
        };
        light as f32
    }

    /// The level whose light is the most that is not above this one, but never the last level.
    pub fn below(self, light: f32) -> u32 {
        let light = f64::from(light.clamp(0.0, 1.0));
        let value = match self.transfer {
            Transfer::Linear => light,
            Transfer::Srgb if light <= 0.003_130_8 => light * 12.92,
            Transfer::Srgb => 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055,
        };
        let mut level = ((value * f64::from(self.levels - 1)) as u32).min(self.levels - 2);
        // The curve there and the one back round differently.
        let light = light as f32;
        while level > 0 && self.light(level) > light {
            level -= 1;
        }
        while level + 2 < self.levels && self.light(level + 1) <= light {
            level += 1;
        }
        level
    }

    /// The level that has this light.
    pub fn level(self, light: f32) -> u32 {
        let below = self.below(light);
        if self.light(below + 1) <= light { below + 1 } else { below }
    }
}

impl Inputs {
    /// Opens all animations.
    ///
    /// # Errors
    /// Files that are missing or are no animation, sizes that differ, numbers out of range.
    pub fn open(args: &SelectArgs) -> Result<Self, Failure> {
        let display = args.levels.map(|levels| {
            if !(2..=Display::MOST).contains(&levels) {
                let most = Display::MOST;
                let rule = format!("--levels is {levels}, but it must be 2 to {most}");
                return Err(Misuse(rule));
            }
            Ok(Display { levels, transfer: args.transfer })
        });
        let display = display.transpose()?;
        let is_true = args.reference.is_some();
        let name = args.reference.as_ref().or(args.guide.as_ref());
        let name = name.ok_or_else(|| Misuse("--reference or --guide must be given".into()))?;
        let guide = Animation::open(name)?;
        let candidates = args
            .candidates
            .iter()
            .map(|name| Animation::open(name))
            .collect::<Result<Vec<_>, _>>()?;
        let size = |animation: &Animation| {
            let [width, height] = animation.size();
            (width, height, animation.channels(), animation.frames())
        };
        for (path, animation) in args.candidates.iter().zip(&candidates) {
            if size(animation) != size(&guide) {
                let words = |animation: &Animation| {
                    let (width, height, channels, frames) = size(animation);
                    format!("{width}x{height} pixels, {channels} channels and {frames} frames")
                };
                return Err(Misuse(format!(
                    "{} has {}, but {} has {}",
                    path.display(),
                    words(animation),
                    name.display(),
                    words(&guide)
                ))
                .into());
            }
        }
        let names = std::iter::once(name).chain(&args.candidates).cloned().collect();
        Ok(Self { candidates, guide, names, is_true, subsets: args.subsets, display })
    }

    /// The size of what one selection works on: with levels, a channel of its own.
    pub fn shape(&self) -> Result<AnimationShape, Failure> {
        let [width, height] = self.guide.size();
        let channels = if self.display.is_some() { 1 } else { self.guide.channels() };
        Ok(AnimationShape::new(width, height, self.guide.frames(), channels)?)
    }

    /// How many selections there are.
    pub fn selections(&self) -> usize {
        if self.display.is_some() { self.guide.channels() } else { 1 }
    }

    /// Renders of a frame, and whether their subsets are candidates.
    pub fn renders(&self) -> (usize, bool) {
        if self.display.is_some() { (2, false) } else { (self.candidates.len(), self.subsets) }
    }

    /// Whether all values of renders are those of half floats.
    pub fn are_half(&self) -> bool {
        self.display.is_none() && self.candidates.iter().all(Animation::is_half)
    }

    /// What each selection gets of a frame.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn read(&self, frame: usize) -> Result<Vec<Frame>, AnimationError> {
        let guide = self.guide.read(frame)?;
        let Some(display) = self.display else {
            let renders = self.candidates.iter().map(|animation| animation.read(frame));
            return Ok(vec![Frame { guide, renders: renders.collect::<Result<_, _>>()? }]);
        };
        let [width, height] = self.guide.size();
        let channel = |plane: &[f32]| {
            let below: Vec<u32> = plane.iter().map(|&light| display.below(light)).collect();
            let of = |step: u32| below.iter().map(|level| display.light(level + step)).collect();
            let guide = plane.iter().map(|light| light.clamp(0.0, 1.0)).collect();
            Frame { guide, renders: vec![of(0), of(1)] }
        };
        Ok(guide.chunks_exact(width * height).map(channel).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_light_lies_between_its_two_levels() {
        for transfer in [Transfer::Srgb, Transfer::Linear] {
            for levels in [2, 3, 64, 256, 65536] {
                let display = Display { levels, transfer };
                assert_eq!((display.light(0), display.light(levels - 1)), (0.0, 1.0));
                for i in 0..=1000 {
                    let light = i as f32 / 1000.0;
                    let below = display.below(light);
                    assert!(display.light(below) <= light && light <= display.light(below + 1));
                }
                // A level itself needs no dithering, and is known by its light.
                for level in (0..levels - 1).step_by(1.max(levels as usize / 100)) {
                    assert_eq!(display.below(display.light(level)), level);
                    assert_eq!(display.level(display.light(level)), level);
                }
                assert_eq!(display.level(1.0), levels - 1);
                assert_eq!((display.below(-1.0), display.below(9.0)), (0, levels - 2));
            }
        }
    }
}
