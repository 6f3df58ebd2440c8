//! The filter g through which error is seen: from its description to its taps.
//!
//! `spec` says what the filter is made of (Eq. 5: spatial × temporal perception × accumulation)
//! and `parse` reads that from text; `resolve` composes and truncates it (`factor` and `table`
//! give the weights of each factor, `grid` convolves them); `taps` is what the optimizer and the
//! scores use: offsets with weights, sorted by falling magnitude, so that the taps above any
//! threshold are a prefix (Eq. 7); `planes` is
//! the same for whole pictures. `viewing` writes the description for a frame rate and a display;
//! `response` and `picture` show a kernel to people.

mod factor;
mod grid;
mod parse;
mod picture;
mod planes;
mod prefix;
mod resolve;
mod response;
mod spec;
mod table;
mod taps;
mod viewing;

pub use factor::perception_taps;
pub use parse::ParseError;
pub use picture::{Picture, picture};
pub use planes::{KernelFrame, KernelPlanes, Plane};
pub use prefix::Prefix;
pub use resolve::{Dropped, Kernel, KernelClass, KernelError, MAX_TAPS, ResolveProblem};
pub use response::Response;
pub use spec::{
    ClassKind, ClassSpec, DEFAULT_PERCENT, Factor, KernelSpec, MAX_BINOMIAL, MAX_CLASSES,
    MAX_LENGTH, SpecProblem, Truncation,
};
pub use table::TableError;
pub use taps::{KernelTaps, SignClass, Tap, TapsError};
pub use viewing::{PAPER_PIXELS_PER_DEGREE, PAPER_SIGMA, Viewing};
