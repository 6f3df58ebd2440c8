//! Where the time and the memory traffic of a run go.
//!
//! Nothing here knows of tiles or draws: accesses come as addresses, work as numbers of
//! operations, bytes and seconds. It is not a sampling profiler; for that there is `perf`.

pub mod cache;
pub mod machine;
pub mod roofline;
pub mod trace;
