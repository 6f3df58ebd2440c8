//! Perceptile precomputes spatio-temporal sample tiles for Monte Carlo animation rendering.
//!
//! A renderer that reads its random numbers from such a tile has the same error in every pixel,
//! arranged so that the eye and the renderer's temporal filter see far less of it. The method is
//! that of Korać et al., "Perceptual error optimization for Monte Carlo animation rendering"
//! (SIGGRAPH Asia 2023): stochastic gradient descent with Adam on filtered sliced Wasserstein
//! distances.
//!
//! ```
//! use perceptile::{Optimizer, Preset, Tile};
//!
//! # let folder = tempfile::tempdir()?;
//! # std::env::set_current_dir(&folder)?;
//! let run = Optimizer::new(Preset::Quick)
//!     .size(16, 16, 8)
//!     .steps(50)
//!     .seed(7)
//!     .run()?;
//! println!("{}", run.scores()?);
//! run.tile().save("tile.npy")?;
//!
//! let tile = Tile::load("tile.npy")?;
//! let (x, y, frame, sample) = (1, 2, 3, 0);
//! let point = tile.point(x, y, frame, sample);
//! assert!(point.iter().all(|u| (0.0..1.0).contains(u)));
//! # assert_eq!((tile.samples(), point.len()), (run.tile().samples(), 2));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | to | begin at |
//! |---|---|
//! | make a tile | [`Optimizer`] with a [`Preset`]; more options are in [`Options`] |
//! | make unit vectors or points of a disk | [`Optimizer::domain`] with a [`Domain`](domain::Domain) |
//! | watch it being made, or end that | [`Optimizer::observe`] |
//! | say what the eye sees | [`Viewing`] (frame rate, temporal anti-aliasing, display), or a [`KernelSpec`] from text |
//! | read and write tiles | [`Tile::load`], [`Tile::save`]; other files: [`format`](mod@format) |
//! | write textures for engines | [`export`] |
//! | read samples | [`Tile::point`], [`Tile::samples`] |
//! | know how good a tile is | [`Run::scores`], [`Tile::scores`]; what the scores mean: [`metric`] |
//!
//! # How it works
//!
//! ```text
//!  kernel ──► draw ──► gradient ──► solver ──► run ──► format      tile.npy, .json, .png
//!  spec→taps  cells'    project,     patches    driver, files
//!             draws     rank, move   → Adam     backends
//!                 ╲        ╱           ├─► profile    ├─► metric  scores, spectra
//!             tile: shape, cells, blocks,  stages,         ├─► preview  the picture beside a tile
//!             rows (all index arithmetic)  caches, roofline └─► report  a page with an animation
//!             domain: where samples live
//! ```
//!
//! Arrows run one way. A step of the solver (`solver::Descent::step`) has two halves. In the
//! first, the draws of every block of cells read the samples in their rows and fill a private
//! integer patch; in the second, patches add up line by line, and Adam moves the samples of the
//! line. Both are rounds of jobs, which threads of this process or worker processes take from one
//! board ([`perceptile_cluster`]). On a cluster each rank does so with a region of the tile
//! (`tile::Regions`), and ranks send each other what their regions see of others. Why it is fast
//! stands where it is done: rows in `tile::Rows`, the stages of a draw in `gradient`, sorting
//! and transpositions in `gradient::simd`, pages of memory in the solver; `profile` shows what
//! comes of it.
//!
//! These pages have what a program needs. `RUSTDOCFLAGS="--cfg internals" cargo doc` has all rooms.
//!
//! # Features
//!
//! `cli`, on by default, is the command with all that only it needs, profiles and reports. Programs
//! that make or read tiles set `default-features = false`, which leaves two thirds of the crates.
//! `exr`, a part of it, reads and writes tiles as EXR files. `mpi` is for the command on clusters; it needs
//! an MPI library.

// Rooms behind the items below. The command, tests and benches go in; users need not.
#[cfg_attr(not(internals), doc(hidden))]
pub mod array;
pub mod domain;
#[cfg_attr(not(internals), doc(hidden))]
pub mod draw;
pub mod export;
pub mod format;
#[cfg_attr(not(internals), doc(hidden))]
pub mod gradient;
pub mod kernel;
pub mod metric;
mod optimizer;
pub mod preview;
#[cfg(feature = "cli")]
#[cfg_attr(not(internals), doc(hidden))]
pub mod profile;
#[cfg(feature = "cli")]
#[cfg_attr(not(internals), doc(hidden))]
pub mod report;
#[cfg_attr(not(internals), doc(hidden))]
pub mod run;
#[cfg_attr(not(internals), doc(hidden))]
pub mod select;
#[cfg_attr(not(internals), doc(hidden))]
pub mod settings;
#[cfg_attr(not(internals), doc(hidden))]
pub mod solver;
#[cfg_attr(not(internals), doc(hidden))]
pub mod tile;

#[doc(inline)]
pub use draw::DrawOptions;
#[doc(inline)]
pub use format::source::{SourceError, TileSource};
#[doc(inline)]
pub use format::write::WriteError;
#[doc(inline)]
pub use kernel::{KernelError, KernelSpec, ParseError, Viewing};
#[doc(inline)]
pub use metric::{ScoreError, ScoreOptions, Scores};
pub use optimizer::{OptimizeError, Optimizer, Run};
#[doc(inline)]
pub use run::{error::RunError, memory::MemoryError, observer::Progress};
#[doc(inline)]
pub use solver::{
    MAX_POLISH_TAPS, Options, OptionsError, Phase, Preset, Start, StopReason, Summary,
    adam::{AdamOptions, MAX_BETA},
    polish::PolishOptions,
    warp::WarpOptions,
};
#[doc(inline)]
pub use tile::{MAX_DIMS, MAX_SPP, ShapeError, Tile, TileError, TileShape};

/// The programs of the manual, which the tests of the documentation compile.
#[cfg(doctest)]
#[doc = include_str!("../docs/library.md")]
struct Manual;
