//! Why there is no report.

use std::path::PathBuf;

use thiserror::Error;

use super::renders::RendersError;
use crate::format::write::WriteError;
use crate::kernel::KernelError;

/// Why there is no report.
#[derive(Debug, Error)]
pub enum ReportError {
    /// A file cannot be written, or the output exists.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The output is there, but no report, so it is not replaced.
    #[error("{} is not a report of this program, so --force does not replace it", path.display())]
    Foreign {
        /// The output.
        path: PathBuf,
    },
    /// The kernel does not fit the first tile.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// The renders cannot be used.
    #[error(transparent)]
    Renders(#[from] RendersError),
}
