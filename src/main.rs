//! The command `perceptile`.
fn main() {}
