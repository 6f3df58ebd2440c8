//! Workers as processes: the coordinator starts them, watches them and replaces lost ones.
//!
//! A worker is the same program once more, with a socket as its standard input. Through the
//! socket go only the start ([`Launch`], [`attach`]) and the end ([`Attached::report`]) of its
//! life: its work lies in a file of shared memory, whose descriptor it is sent. The socket is also
//! how a worker notices that its coordinator has gone.

mod coordinator;
mod error;
mod loss;
mod memory;
mod message;
mod options;
mod program;
#[cfg(test)]
mod tests;
mod worker;

pub use coordinator::{Launch, Workers};
pub use error::ProcessError;
pub use loss::{Cause, Loss};
pub use memory::memory_file;
pub use message::MessageError;
pub use options::WorkersOptions;
pub use program::this_program;
pub use worker::{Attached, attach};
