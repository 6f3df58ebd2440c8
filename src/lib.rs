//! Perceptile: spatio-temporal sample tiles for Monte Carlo animation rendering.

pub mod kernel;
pub mod metric;
pub mod tile;
