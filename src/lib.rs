//! Perceptile: spatio-temporal sample tiles for Monte Carlo animation rendering.

pub mod format;
pub mod kernel;
pub mod tile;
