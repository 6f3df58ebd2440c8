//! Where the time and the memory traffic of a run go.
//!
//! ```text
//!  subject: the descent of a run, taken apart
//!    ├─► measure: time of its steps ◄── stages, spans: what listens to the stages
//!    ├─► workers: the same by worker processes: work, waiting, traffic, what going in step costs
//!    ├─► traffic: samples, bytes and operations of each stage
//!    └─► access: addresses, in several layouts and orders ──► cache: misses, a model
//!  machine: its caches and cores ──► roofline: what it could do at best
//!  counters: misses as the processor counts them, if it does
//!        all of it ──► report: the profile, a table ──► picture: an SVG
//!                        ├─► row: a stage in numbers ◄──┐
//!                        └─► advice: what to do about it┘
//!                      trace: who did what when, for a viewer
//!  scaling: costs of this machine, and what they come to on a cluster
//! ```
//!
//! The tools (`cache`, `counters`, `machine`, `roofline`, `trace`) know nothing of tiles or
//! draws: accesses come as addresses, work as numbers of operations, bytes and seconds. It is not
//! a sampling profiler; for that there is `perf`.

pub mod access;
pub mod advice;
pub mod cache;
pub mod counters;
pub mod machine;
pub mod measure;
pub mod picture;
pub mod report;
pub mod roofline;
pub mod row;
pub mod scaling;
pub mod spans;
pub mod stages;
pub mod subject;
pub mod trace;
pub mod traffic;
#[cfg(unix)]
pub mod workers;
