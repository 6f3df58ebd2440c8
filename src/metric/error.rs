//! Why a tile cannot be scored.

use thiserror::Error;

use crate::domain::DomainError;
use crate::kernel::KernelError;
use crate::tile::TileShape;

/// Most integrands of a class.
pub(super) const MOST_INTEGRANDS: usize = 1 << 16;

/// Why a tile cannot be scored.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ScoreError {
    /// The kernel cannot be made for the tile.
    #[error(transparent)]
    Spec(#[from] KernelError),
    /// The samples are not of the domain.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The kernel is wider than the tile.
    #[error(
        "the kernel spans {extent} in {axis}, but the tile only {size}: it must not be wider than the tile"
    )]
    Kernel {
        /// `x` or `y`.
        axis: &'static str,
        /// From the kernel's first tap to its last, both included.
        extent: i64,
        /// The tile's size.
        size: usize,
    },
    /// The number of integrands is out of range.
    #[error("{0} integrands of each class were asked for, but 1 to 65536 are possible")]
    Integrands(usize),
    /// The tile has another shape than the scorer was made for.
    #[error("a tile of {found} was given to the scorer of {expected}")]
    Shape {
        /// The scorer's.
        expected: TileShape,
        /// The tile's.
        found: TileShape,
    },
}
