//! `perceptile completions`: what a shell has to know to complete the command's words.

use clap::Args;
use clap_complete::{Shell, generate};

use super::exit::Failure;
use super::stream::print;

/// Print the completions for a shell
///
/// For bash, in this session: source <(perceptile completions bash). Where a shell looks for them at
/// its start is in its manual.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Prints the completions of the whole program.
///
/// # Errors
/// An output that cannot be written.
pub fn run(args: &CompletionsArgs, mut program: clap::Command) -> Result<(), Failure> {
    let name = program.get_name().to_owned();
    let mut text = Vec::new();
    generate(args.shell, &mut program, name, &mut text);
    Ok(print(&String::from_utf8_lossy(&text))?)
}
