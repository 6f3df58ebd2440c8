//! The numbers of all rounds of a run, in the order in which they are done.
//!
//! They are functions of the phase and the step alone, so that every rank knows them, whenever it
//! began.

use crate::solver::Phase;

/// Bits for the rounds of a phase.
const BITS: u32 = 36;

/// A part of a step. Its gradients are made in three rounds where others need some of them: while
/// samples of others are under way, from those samples, and while gradients are under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Gradients are made from this rank's samples alone.
    Early,
    /// Gradients that others have to do with.
    Edge,
    /// The rest of the gradients; all of them where there are no others.
    Gradient,
    /// They move the samples.
    Update,
}

/// Parts of a step.
const PARTS: u64 = 4;

/// The round in which a phase takes over the samples.
pub fn enter(phase: Phase) -> u64 {
    (phase as u64) << BITS | 1
}

/// A round of a step.
pub fn step(phase: Phase, step: u32, part: Part) -> u64 {
    enter(phase) + 1 + PARTS * u64::from(step) + part as u64
}

/// The round in which a phase hands the samples on.
pub fn leave(phase: Phase) -> u64 {
    (phase as u64) << BITS | ((1 << BITS) - 1)
}

/// The phase and how many of its steps are over when a round is; none before the first phase.
pub fn position(round: u64) -> Option<(Phase, u32)> {
    let phase = [Phase::Descent, Phase::Polish, Phase::Warp]
        .into_iter()
        .find(|&phase| phase as u64 == round >> BITS)?;
    let within = round & ((1 << BITS) - 1);
    Some((phase, (within.saturating_sub(1) / PARTS).min(u64::from(u32::MAX)) as u32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_rise_and_show_where_a_run_is() {
        let rounds = [
            enter(Phase::Descent),
            step(Phase::Descent, 0, Part::Early),
            step(Phase::Descent, 0, Part::Gradient),
            step(Phase::Descent, 0, Part::Update),
            step(Phase::Descent, 1, Part::Early),
            step(Phase::Descent, u32::MAX, Part::Update),
            leave(Phase::Descent),
            enter(Phase::Polish),
            step(Phase::Polish, 7, Part::Update),
            leave(Phase::Polish),
            enter(Phase::Warp),
        ];
        assert!(rounds.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(position(0), None);
        let places = [0, 0, 0, 1, 1].map(|steps| Some((Phase::Descent, steps)));
        assert_eq!([0, 1, 2, 3, 4].map(|i| position(rounds[i])), places);
        assert_eq!(position(rounds[8]), Some((Phase::Polish, 8)));
    }
}
