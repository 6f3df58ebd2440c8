//! What can be chosen about a selection, and how it is checked.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::SelectError;

/// How errors are summed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Norm {
    /// Σ w·|r|, the paper's.
    L1,
    /// Σ w²·r², what pRelMSE measures; faster.
    #[default]
    L2,
}

/// How the weight λ of the unfiltered error falls from the first sweep to the last.
///
/// With λ = 0 from the beginning the objective is the paper's: least error is seen, but much fine noise
/// stays that the filter does not see, and other models of vision do. While λ is large, what is closest
/// is chosen, and later sweeps move the error that is left to where it is not seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Continuation {
    /// λ of the first sweep, at least `to`.
    pub from: f64,
    /// λ of the last sweep, at least 0.
    pub to: f64,
}

impl Default for Continuation {
    fn default() -> Self {
        Self { from: 0.01, to: 0.0 }
    }
}

impl Continuation {
    /// With a guide, whose own error should not be followed to the end.
    const GUIDED: Self = Self { from: 0.2, to: 0.01 };
    /// Among single renders or levels: what is least seen then is best for the eye as well.
    const SINGLE: Self = Self { from: 0.0, to: 0.0 };
    /// Where λ begins if only its end is given.
    const FROM: f64 = 0.2;

    /// What suits a guide, or the true picture, and candidates that are subsets of renders, or single.
    pub fn suited(has_guide: bool, subsets: bool) -> Self {
        match (has_guide, subsets) {
            (true, _) => Self::GUIDED,
            (false, true) => Self::default(),
            (false, false) => Self::SINGLE,
        }
    }
}

/// `FROM..TO`, or the end alone.
impl FromStr for Continuation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let rule = "write FROM..TO, such as 0.2..0.03, or the end alone";
            let error = || format!("{text:?} is no number; {rule}");
            text.trim().parse::<f64>().map_err(|_| error())
        };
        match text.split_once("..") {
            Some((from, to)) => Ok(Self { from: number(from)?, to: number(to)? }),
            None => {
                let to = number(text)?;
                Ok(Self { from: Self::FROM.max(to), to })
            }
        }
    }
}

/// What can be chosen about a selection.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SelectOptions {
    /// How errors are summed.
    pub norm: Norm,
    /// How often every pixel is visited; 1 to [`Self::MAX_SWEEPS`].
    pub sweeps: u32,
    /// λ.
    pub continuation: Continuation,
}

impl Default for SelectOptions {
    fn default() -> Self {
        Self { norm: Norm::default(), sweeps: 12, continuation: Continuation::default() }
    }
}

impl SelectOptions {
    /// Most sweeps.
    pub const MAX_SWEEPS: u32 = 256;
    /// Largest λ.
    pub const MAX_LAMBDA: f64 = 1e6;
    /// What λ falls to, of its first value, before a last sweep with 0.
    const FLOOR: f64 = 0.0003;

    /// Checks every number.
    ///
    /// # Errors
    /// The first that breaks its rule.
    pub fn validate(&self) -> Result<(), SelectError> {
        let Self { sweeps, continuation: Continuation { from, to }, .. } = *self;
        if !(1..=Self::MAX_SWEEPS).contains(&sweeps) {
            return Err(SelectError::Sweeps { sweeps });
        }
        if !(to >= 0.0 && from >= to && from <= Self::MAX_LAMBDA) {
            return Err(SelectError::Continuation { from, to });
        }
        Ok(())
    }

    /// λ of every sweep: it falls by one factor from sweep to sweep. On its way to 0 it is 0.0003 of
    /// its first value in the last sweep but one.
    pub fn lambdas(&self) -> Vec<f32> {
        let Continuation { from, to } = self.continuation;
        let falling = |count: u32, to: f64| {
            let step = move |k: u32| f64::from(k) / f64::from((count - 1).max(1));
            (0..count).map(move |k| (from * libm::pow(to / from, step(k))) as f32)
        };
        match self.sweeps {
            _ if from == 0.0 => vec![0.0; self.sweeps as usize],
            1 => vec![to as f32],
            sweeps if to == 0.0 => falling(sweeps - 1, from * Self::FLOOR).chain([0.0]).collect(),
            sweeps => falling(sweeps, to).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lambda_falls_by_one_factor_from_end_to_end() {
        let lambdas = |sweeps, from, to| {
            let continuation = Continuation { from, to };
            SelectOptions { sweeps, continuation, ..SelectOptions::default() }.lambdas()
        };
        assert_eq!(lambdas(1, 1.0, 0.25), [0.25]);
        assert_eq!(lambdas(3, 1.0, 0.25), [1.0, 0.5, 0.25]);
        assert_eq!(lambdas(3, 0.0, 0.0), [0.0; 3]);
        assert_eq!(lambdas(2, 1.0, 0.0), [1.0, 0.0]);
        assert_eq!(lambdas(3, 10.0, 0.0), [10.0, 0.003, 0.0]);
    }

    #[test]
    fn the_continuation_is_a_range_or_its_end() {
        let of = |from, to| Ok(Continuation { from, to });
        assert_eq!("1..0.01".parse(), of(1.0, 0.01));
        assert_eq!("0.03".parse(), of(0.2, 0.03));
        assert_eq!("2".parse(), of(2.0, 2.0));
        let error = "a..1".parse::<Continuation>().unwrap_err();
        assert!(error.contains("\"a\" is no number"), "{error}");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let check = |sweeps, from, to| {
            let continuation = Continuation { from, to };
            SelectOptions { sweeps, continuation, ..SelectOptions::default() }.validate()
        };
        assert!(check(1, 0.0, 0.0).is_ok() && check(256, 1e6, 1e6).is_ok());
        assert!(check(0, 1.0, 0.0).is_err() && check(257, 1.0, 0.0).is_err());
        for (from, to) in [(0.5, 1.0), (1.0, -0.1), (f64::NAN, 0.0), (1.0, f64::NAN), (2e6, 1.0)] {
            assert!(check(8, from, to).is_err(), "{from} {to}");
        }
    }
}
