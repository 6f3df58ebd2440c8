//! Perceptile precomputes spatio-temporal sample tiles for Monte Carlo animation rendering.
//!
//! A renderer that reads its random numbers from such a tile has the same error in every pixel,
//! arranged so that the eye and the renderer's temporal filter see far less of it. The method is
//! that of Korać et al., "Perceptual error optimization for Monte Carlo animation rendering"
//! (SIGGRAPH Asia 2023): stochastic gradient descent with Adam on filtered sliced Wasserstein
//! distances.
//!
//! ```text
//!  kernel ──► draw ──► gradient ──► solver ──► run ──► format      tile.npy, .json, .png
//!  spec→taps  cells'    project,     patches    driver, files
//!             draws     rank, move   → Adam     backends
//!                 ╲        ╱           ├─► profile    ├─► metric  scores, spectra
//!             tile: shape, cells, blocks,  stages,         ├─► preview  the picture beside a tile
//!             rows (all index arithmetic)  caches, roofline └─► report  a page with an animation
//! ```
//!
//! Arrows run one way. A step of the solver ([`solver::Descent::step`]) has two halves. In the
//! first, the draws of every block of cells read the samples in their rows and fill a private
//! integer patch; in the second, patches add up line by line, and Adam moves the samples of the
//! line. Both are rounds of jobs, which threads of this process or worker processes take from one
//! board ([`perceptile_cluster`]). On a cluster each rank does so with a region of the tile
//! ([`tile::Regions`]), and ranks send each other what their regions see of others. Why it is fast
//! stands where it is done: rows in [`tile::Rows`], the stages of a draw in [`gradient`], sorting
//! and transpositions in [`gradient::simd`], pages of memory in the solver; [`profile`] shows what
//! comes of it.
//!
//! ```
//! use perceptile::gradient::simd::Simd;
//! use perceptile::run::{driver::optimize, observer::Unobserved};
//! use perceptile::solver::Preset;
//! use perceptile::tile::TileShape;
//!
//! let mut options = Preset::Quick.options();
//! options.shape = TileShape::new(16, 16, 8, 1, 2)?;
//! options.steps = 100;
//! let (tile, summary) = optimize(&options, None, Simd::detect(), &mut Unobserved)?;
//! assert_eq!(tile.samples().len(), 16 * 16 * 8 * 2);
//! assert!(summary.objective_after < summary.objective_before);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod array;
pub mod draw;
pub mod format;
pub mod gradient;
pub mod kernel;
pub mod metric;
pub mod preview;
pub mod profile;
pub mod report;
pub mod run;
pub mod solver;
pub mod tile;
