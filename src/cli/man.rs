//! `perceptile man`: the help of the command as manual pages, for whoever installs it.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_mangen::Man;
use perceptile::format::write::{self, Existing};

use super::exit::Failure;
use super::stream::print;

/// Print the manual page of the program, or write all pages into a folder
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for the pages of the program and of its commands, such as perceptile-optimize.1; it is
    /// made if the folder around it exists
    #[arg(value_name = "DIR")]
    folder: Option<PathBuf>,

    /// Replace pages that exist
    #[arg(long)]
    force: bool,
}

/// Prints or writes the pages.
///
/// # Errors
/// Pages that exist without `--force` or cannot be written.
pub fn run(args: &ManArgs, program: Command) -> Result<(), Failure> {
    // `help` has nothing to say on a page of its own.
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let Some(folder) = &args.folder else {
        return Ok(print(&String::from_utf8_lossy(&page(&program)))?);
    };
    let shown = program.get_subcommands().filter(|command| !command.is_hide_set());
    let pages: Vec<(PathBuf, Vec<u8>)> = std::iter::once(&program)
        .chain(shown)
        .map(|command| {
            let name = command.get_display_name().unwrap_or(command.get_name());
            (folder.join(format!("{name}.1")), page(command))
        })
        .collect();
    let existing = Existing::from_force(args.force);
    write::make_folder(folder)?;
    write::probe(pages.iter().map(|(path, _)| path), existing)?;
    for (path, page) in &pages {
        write::write(path, existing, |out| out.write_all(page))?;
    }
    Ok(print(&format!("{} pages in {}\n", pages.len(), folder.display()))?)
}

/// The page of a command.
fn page(command: &Command) -> Vec<u8> {
    let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
    let mut text = Vec::new();
    let rendered = Man::new(command.clone()).title(name).render(&mut text);
    rendered.expect("memory takes all that is written");
    text
}
