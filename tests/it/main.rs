//! The integration tests, one module for each room.

mod child;
#[cfg(target_os = "linux")]
mod command;
mod densities;
mod determinism;
#[cfg(target_os = "linux")]
mod docs;
#[cfg(target_os = "linux")]
mod domain;
mod export;
#[cfg(target_os = "linux")]
mod failures;
mod format;
#[cfg(target_os = "linux")]
mod gallery;
mod gradient;
mod hostile;
#[cfg(target_os = "linux")]
mod launcher;
#[cfg(target_os = "linux")]
mod library;
mod metric;
mod npy;
mod profile;
#[cfg(all(target_os = "linux", feature = "mpi"))]
mod ranks;
mod report;
#[cfg(target_os = "linux")]
mod resume;
#[cfg(target_os = "linux")]
mod select;
mod solver;
#[cfg(target_os = "linux")]
mod tool;
#[cfg(target_os = "linux")]
mod workers;
