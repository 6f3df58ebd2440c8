//! The folder of a report: it appears whole under its name or not at all.
//!
//! Files go to a temporary folder beside it, which takes the name when all are there.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::error::ReportError;
use crate::format::picture::Image;
use crate::format::write::{self, Existing, WriteError};

/// By this, near its start, a page is known to be of this program.
pub(super) const GENERATOR: &str = "Perceptile report";
/// The page's file.
pub(super) const PAGE: &str = "index.html";

/// A folder that is being filled.
pub(super) struct Folder {
    out: PathBuf,
    existing: Existing,
    temporary: TempDir,
}

impl Folder {
    /// A new folder, later to be `out`.
    ///
    /// # Errors
    /// `out` exists and is to be kept, or is no report; or the folder around it takes no files.
    pub fn new(out: &Path, existing: Existing) -> Result<Self, ReportError> {
        check(out, existing)?;
        let Some(name) = out.file_name() else {
            return Err(WriteError::NoName { path: out.to_owned() }.into());
        };
        let around = match out.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        if !around.is_dir() {
            return Err(
                WriteError::NoFolder { path: out.to_owned(), folder: around.to_owned() }.into()
            );
        }
        let temporary = temporary(around).map_err(|error| io_error(out, error))?;
        Ok(Self { out: around.join(name), existing, temporary })
    }

    /// Writes one of its files; folders on the way are made.
    ///
    /// # Errors
    /// What the system reports.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        let path = self.path(name)?;
        write::write(&path, Existing::Keep, |out| out.write_all(bytes))
    }

    /// Writes one of its pictures.
    ///
    /// # Errors
    /// What the system reports.
    pub fn picture(&self, name: &str, picture: &Image) -> Result<(), WriteError> {
        picture.save(&self.path(name)?, Existing::Keep)
    }

    fn path(&self, name: &str) -> Result<PathBuf, WriteError> {
        let path = self.temporary.path().join(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)
                .map_err(|error| WriteError::Io { path: folder.to_owned(), error })?;
        }
        Ok(path)
    }

    /// Gives the folder its name. A report that had it goes once the new one is in its place.
    ///
    /// # Errors
    /// Something else took the name meanwhile, or the system refuses.
    pub fn finish(self) -> Result<(), ReportError> {
        let Self { out, existing, temporary } = self;
        check(&out, existing)?;
        let refuse = |error| io_error(&out, error);
        let old = if out.symlink_metadata().is_ok() {
            let around = temporary.path().parent().unwrap_or(Path::new("."));
            let old = self::temporary(around).map_err(refuse)?;
            fs::rename(&out, old.path().join("old")).map_err(refuse)?;
            Some(old)
        } else {
            None
        };
        if let Err(error) = fs::rename(temporary.path(), &out) {
            if let Some(old) = old {
                // Better the old one than none.
                let _ = fs::rename(old.path().join("old"), &out);
            }
            return Err(refuse(error));
        }
        // Nothing is left under the temporary name.
        let _ = temporary.keep();
        Ok(())
    }
}

fn io_error(path: &Path, error: io::Error) -> ReportError {
    WriteError::Io { path: path.to_owned(), error }.into()
}

/// Whether a report may take the name `out`.
fn check(out: &Path, existing: Existing) -> Result<(), ReportError> {
    match fs::symlink_metadata(out) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(io_error(out, error)),
        Ok(_) if existing == Existing::Keep => {
            Err(WriteError::Exists { path: out.to_owned() }.into())
        }
        Ok(metadata) if metadata.is_dir() && is_report(out) => Ok(()),
        Ok(_) => Err(ReportError::Foreign { path: out.to_owned() }),
    }
}

/// Whether the page of a folder is one of ours.
fn is_report(folder: &Path) -> bool {
    let page = folder.join(PAGE);
    let mut start = Vec::new();
    let read = || File::open(&page)?.take(4096).read_to_end(&mut start);
    // Asked before opening, which would wait for ever on a pipe.
    let ours = format!("<meta name=\"generator\" content=\"{GENERATOR} ");
    page.is_file() && { read }().is_ok() && String::from_utf8_lossy(&start).contains(&ours)
}

/// A temporary folder with the permissions that any new folder would get.
fn temporary(around: &Path) -> io::Result<TempDir> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".perceptile-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The process's mask applies, as to a folder that it creates itself.
        builder.permissions(fs::Permissions::from_mode(0o777));
    }
    builder.tempdir_in(around)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page() -> String {
        format!("<!DOCTYPE html><meta name=\"generator\" content=\"{GENERATOR} 0\">")
    }

    fn make(out: &Path, existing: Existing, mark: &str) -> Result<(), ReportError> {
        let folder = Folder::new(out, existing)?;
        folder.write(PAGE, page().as_bytes())?;
        folder.write("deep/er/file", mark.as_bytes())?;
        folder.finish()
    }

    fn names(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_folder_appears_whole_and_is_replaced_only_on_request() {
        let room = tempfile::tempdir().unwrap();
        let out = room.path().join("report");
        make(&out, Existing::Keep, "first").unwrap();
        let refused = make(&out, Existing::Keep, "second").unwrap_err();
        assert!(matches!(refused, ReportError::Write(WriteError::Exists { .. })));
        let mark = || fs::read_to_string(out.join("deep/er/file")).unwrap();
        assert_eq!(mark(), "first");
        make(&out, Existing::Replace, "third").unwrap();
        assert_eq!((mark().as_str(), names(room.path())), ("third", 1));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
            fs::create_dir(room.path().join("usual")).unwrap();
            assert_eq!(mode(&out), mode(&room.path().join("usual")));
        }
    }

    #[test]
    fn nothing_is_left_of_a_folder_that_is_not_finished() {
        let room = tempfile::tempdir().unwrap();
        let out = room.path().join("report");
        let folder = Folder::new(&out, Existing::Keep).unwrap();
        folder.write("file", b"").unwrap();
        drop(folder);
        assert_eq!(names(room.path()), 0);
        // Someone else takes the name while the folder is filled.
        let folder = Folder::new(&out, Existing::Keep).unwrap();
        fs::create_dir(&out).unwrap();
        fs::write(out.join("theirs"), "").unwrap();
        assert!(folder.finish().is_err());
        assert_eq!((names(room.path()), names(&out)), (1, 1));
    }

    #[test]
    fn what_is_no_report_is_never_replaced() {
        let room = tempfile::tempdir().unwrap();
        let at = |name: &str| room.path().join(name);
        fs::create_dir(at("empty")).unwrap();
        fs::create_dir_all(at("other")).unwrap();
        fs::write(at("other/index.html"), "<!DOCTYPE html><title>Holidays</title>").unwrap();
        fs::create_dir_all(at("odd/index.html")).unwrap();
        fs::write(at("file"), page()).unwrap();
        for name in ["empty", "other", "odd", "file"] {
            let error = make(&at(name), Existing::Replace, "").unwrap_err();
            assert!(matches!(error, ReportError::Foreign { .. }), "{name}: {error}");
        }
        for name in ["no/report", "file/report", "..", ""] {
            assert!(make(&at(name), Existing::Replace, "").is_err(), "{name}");
        }
        assert_eq!(names(room.path()), 4);
    }
}
