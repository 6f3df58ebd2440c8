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
    #[error(
        "{} is not a folder with a report of this program, so --force does not replace it",
        path.display()
    )]
    Foreign {
        /// The output.
        path: PathBuf,
    },
    /// Somebody has added a file to the report that is there, so it is not replaced.
    #[error(
        "{} has {}, which is no part of the report, so --force does not replace it: move it elsewhere",
        path.display(), file.display()
    )]
    Added {
        /// The output.
        path: PathBuf,
        /// The file, as a path in the output.
        file: PathBuf,
    },
    /// The kernel does not fit the first tile.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// The renders cannot be used.
    #[error(transparent)]
    Renders(#[from] RendersError),
}
