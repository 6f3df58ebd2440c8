//! Perceptile from Python: the settings, tiles and scores of the command, as functions and arrays.
//!
//! ```text
//! arguments   Python's values -> settings, tiles, kernels
//! running     work on a thread of its own, with the interpreter free; Ctrl-C and progress
//! failure     errors of the library -> exceptions
//! optimize, evaluate, select, export, kernel, tile    what users call
//! ```

mod arguments;
mod evaluate;
mod export;
mod failure;
mod kernel;
mod optimize;
mod running;
mod select;
mod tile;

/// What `import perceptile` gives, but for its Python parts.
#[pyo3::pymodule]
mod _perceptile {
    #[pymodule_export]
    use crate::evaluate::{baseline, evaluate};
    #[pymodule_export]
    use crate::export::export;
    #[pymodule_export]
    use crate::kernel::Kernel;
    #[pymodule_export]
    use crate::optimize::{optimize, settings};
    #[pymodule_export]
    use crate::select::{Selection, select};
    #[pymodule_export]
    use crate::tile::Tile;

    /// The version of the package, which is the library's.
    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "Python's name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
