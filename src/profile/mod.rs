//! Where the time and the memory traffic of a run go.
//!
//! ```text
//!  stages: time of each stage of a step
//!  machine: caches, cores ──► cache: misses of an access stream, model
//!            │                counters: misses as the processor counts them, if it does
//!            └──────────────► roofline: what this machine could do at best
//!                             trace: who did what when, for a viewer
//! ```
//!
//! Nothing here knows of tiles or draws: accesses come as addresses, work as numbers of
//! operations, bytes and seconds. It is not a sampling profiler; for that there is `perf`.

pub mod cache;
pub mod counters;
pub mod machine;
pub mod roofline;
pub mod stages;
pub mod trace;
