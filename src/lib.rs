//! Perceptile: spatio-temporal sample tiles for Monte Carlo animation rendering.

pub mod draw;
pub mod format;
pub mod gradient;
pub mod kernel;
pub mod metric;
pub mod run;
pub mod solver;
pub mod tile;
