//! Candidates: what a pixel can be, as mixtures of the renders of that pixel.
//!
//! Either each render as it is, or the means of all their non-empty subsets: four renders make the
//! 15 candidates of the paper's Figure 5 (as we take it; Chizhov et al. 2022 call choosing among
//! candidates of the same pixel "vertical").

use crate::gradient::simd::LANES;

/// Most renders whose subsets are candidates: they have 63.
pub const MAX_SUBSET_RENDERS: usize = 6;
/// Most candidates of a pixel.
pub const MAX_CANDIDATES: usize = 64;

/// The choice of a pixel that is still the reference.
pub(super) const UNSET: u8 = u8::MAX;

/// The weights of all renders in every candidate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mixture {
    renders: usize,
    candidates: usize,
    /// `[register][render]`, a lane for each candidate; lanes beyond the last have weights of 0.
    weights: Vec<[f32; LANES]>,
}

impl Mixture {
    /// Each render as it is.
    pub fn single(renders: usize) -> Self {
        Self::new(renders, renders, |candidate, render| (candidate == render).into())
    }

    /// The means of all non-empty subsets, in the order of the binary number that has bit k set if
    /// render k belongs to it.
    pub fn subsets(renders: usize) -> Self {
        Self::new(renders, (1 << renders) - 1, |candidate, render| {
            let subset = candidate + 1;
            if subset >> render & 1 == 0 { 0.0 } else { 1.0 / subset.count_ones() as f32 }
        })
    }

    fn new(renders: usize, candidates: usize, weight: impl Fn(usize, usize) -> f32) -> Self {
        let registers = candidates.div_ceil(LANES);
        let mut weights = vec![[0.0; LANES]; registers * renders];
        for candidate in 0..candidates {
            for render in 0..renders {
                weights[candidate / LANES * renders + render][candidate % LANES] =
                    weight(candidate, render);
            }
        }
        Self { renders, candidates, weights }
    }

    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.candidates
    }

    /// Registers of all candidates.
    #[inline(always)]
    pub fn registers(&self) -> usize {
        self.weights.len() / self.renders
    }

    /// The weights in the candidates of a register, render by render.
    #[inline(always)]
    pub fn register(&self, register: usize) -> &[[f32; LANES]] {
        &self.weights[register * self.renders..][..self.renders]
    }

    /// A candidate's value by those of the renders; the same operations as in a lane.
    #[inline(always)]
    pub fn value(&self, candidate: usize, render: impl Fn(usize) -> f32) -> f32 {
        let (register, lane) = (candidate / LANES, candidate % LANES);
        let mut sum = 0.0;
        for (k, weights) in self.register(register).iter().enumerate() {
            sum += weights[lane] * render(k);
        }
        sum
    }

    /// What a candidate is called: the numbers of its renders, from 1, such as `1+3`.
    pub fn name(&self, candidate: usize) -> String {
        let (register, lane) = (candidate / LANES, candidate % LANES);
        let members = self.register(register).iter().enumerate();
        let names: Vec<String> = members
            .filter(|(_, weights)| weights[lane] != 0.0)
            .map(|(render, _)| (render + 1).to_string())
            .collect();
        names.join("+")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_renders_have_fifteen_means() {
        let mixture = Mixture::subsets(4);
        assert_eq!((mixture.candidates(), mixture.registers()), (15, 2));
        let renders = [1.0, 10.0, 100.0, 1000.0];
        let value = |candidate| mixture.value(candidate, |k| renders[k]);
        assert_eq!([value(0), value(1), value(2), value(11)], [1.0, 10.0, 5.5, 550.0]);
        assert_eq!(value(14), 277.75);
        assert_eq!([mixture.name(0), mixture.name(12)], ["1", "1+3+4"]);
        let mut values: Vec<f32> = (0..15).map(value).collect();
        values.sort_by(f32::total_cmp);
        values.dedup();
        assert_eq!(values.len(), 15);
    }

    #[test]
    fn single_candidates_are_the_renders_to_the_bit() {
        let mixture = Mixture::single(9);
        assert_eq!((mixture.candidates(), mixture.registers()), (9, 2));
        let render = |k: usize| 0.1 + k as f32;
        assert!((0..9).all(|k| mixture.value(k, render) == render(k)));
        assert_eq!(mixture.name(8), "9");
    }
}
