//! The command `perceptile`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
