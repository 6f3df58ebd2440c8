//! Which program this process runs: workers are the same program once more.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use super::error::{ProcessError, system};

/// On Linux it names the file that this process runs, also after another was put in its place.
const SELF: &str = "/proc/self/exe";

/// The program that this process runs, for [`Launch::program`](super::Launch::program).
///
/// # Errors
/// A system that does not say, such as Linux without `/proc`.
pub fn this_program() -> Result<PathBuf, ProcessError> {
    if cfg!(target_os = "linux") {
        named_by(Path::new(SELF))
    } else {
        std::env::current_exe().map_err(system("find this program to start workers from"))
    }
}

/// The program behind a link, which is started through the link.
fn named_by(link: &Path) -> Result<PathBuf, ProcessError> {
    match fs::metadata(link) {
        Ok(_) => Ok(link.to_owned()),
        Err(error) => Err(ProcessError::NoProgram { link: link.to_owned(), error }),
    }
}

/// The name of this process, for workers whose program's path is not one.
pub(super) fn own_name(program: &Path) -> Option<OsString> {
    (program == Path::new(SELF)).then(|| std::env::args_os().next()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_cannot_be_found_is_no_error_of_starting_it() {
        let error = named_by(Path::new("/no/proc/self/exe")).unwrap_err();
        assert_eq!(
            error.to_string(),
            "cannot find this program to start workers from: /no/proc/self/exe is not there; is \
             /proc mounted? (No such file or directory (os error 2))"
        );
        assert!(this_program().is_ok());
    }
}
