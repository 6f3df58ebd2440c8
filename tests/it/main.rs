//! The integration tests, one module for each room.

mod format;
mod gradient;
mod metric;
