//! Why settings are refused.

use thiserror::Error;

use crate::domain::DomainError;
use crate::kernel::SpecProblem;
use crate::solver::OptionsError;
use crate::tile::ShapeError;

/// Why settings are refused. Messages name flags as the command has them.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum SettingsError {
    /// No setting has this name.
    #[error("there is no setting `{name}`")]
    Unknown {
        /// The name.
        name: String,
    },
    /// A text is no value of a setting.
    #[error("invalid value '{text}' for {flag}: {problem}")]
    Value {
        /// The setting.
        flag: String,
        /// The text.
        text: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A kernel is written out, and follows from how the animation is watched as well.
    #[error(
        "{name} says all of the kernel: leave out --fps, --taa, --sigma and --pixels-per-degree"
    )]
    TwoKernels {
        /// Where it is written out.
        name: &'static str,
    },
    /// Two values for sigma.
    #[error("--pixels-per-degree says sigma: leave out --sigma")]
    TwoSigmas,
    /// A number of how the animation is watched is outside its range.
    #[error(transparent)]
    Viewing(SpecProblem),
    /// No tile has this size.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// The domain cannot be had.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// Options that do not go together.
    #[error(transparent)]
    Options(#[from] OptionsError),
}
