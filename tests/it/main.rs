//! The integration tests, one module for each room.

#[cfg(target_os = "linux")]
mod command;
mod determinism;
mod format;
mod gradient;
mod metric;
mod profile;
mod solver;
