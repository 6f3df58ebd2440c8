//! The folder of a report: it appears whole under its name or not at all.
//!
//! Files go to a temporary folder beside it, which takes the name when all are there.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::error::ReportError;
use crate::format::picture::Image;
use crate::format::unfinished::Unfinished;
use crate::format::write::{self, Existing, WriteError};

/// By this, near its start, a page is known to be of this program.
pub(super) const GENERATOR: &str = "Perceptile report";
/// Bytes of a page that reach beyond the element that says so.
const START: usize = 4096;
/// The page's file.
pub(super) const PAGE: &str = "index.html";

/// A folder that is being filled.
pub(super) struct Folder {
    out: PathBuf,
    existing: Existing,
    temporary: Temporary,
}

/// A folder without a lasting name.
struct Temporary {
    /// Removed before it is no longer unfinished.
    folder: TempDir,
    unfinished: Unfinished,
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
        let path = self.temporary.folder.path().join(name);
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
        let Self { out, existing, mut temporary } = self;
        check(&out, existing)?;
        let refuse = |error| io_error(&out, error);
        let new = temporary.folder.path();
        let around = new.parent().unwrap_or(Path::new("."));
        let is_old = out.symlink_metadata().is_ok();
        let old = is_old.then(|| self::temporary(around)).transpose().map_err(refuse)?;
        let place = old.as_ref().map(|old| old.folder.path().join("old"));
        let named = temporary.unfinished.complete(|| {
            if let Some(place) = &place {
                fs::rename(&out, place)?;
            }
            fs::rename(new, &out).inspect_err(|_| {
                if let Some(place) = &place {
                    // Better the old one than none.
                    let _ = fs::rename(place, &out);
                }
            })
        });
        named.map_err(refuse)?;
        // Nothing is left under the temporary name.
        let _ = temporary.folder.keep();
        Ok(())
    }
}

fn io_error(path: &Path, error: io::Error) -> ReportError {
    WriteError::Io { path: path.to_owned(), error }.into()
}

/// Whether a report may take the name `out`: nobody has it, or a report that may be replaced and
/// to which nobody has added a file.
fn check(out: &Path, existing: Existing) -> Result<(), ReportError> {
    match fs::symlink_metadata(out) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(io_error(out, error)),
        Ok(_) if existing == Existing::Keep => {
            Err(WriteError::Exists { path: out.to_owned() }.into())
        }
        Ok(metadata) => {
            let foreign = || ReportError::Foreign { path: out.to_owned() };
            let page = metadata.is_dir().then(|| page_of(out)).flatten().ok_or_else(foreign)?;
            match added(out, Path::new(""), &page).map_err(|error| io_error(out, error))? {
                Some(file) => Err(ReportError::Added { path: out.to_owned(), file }),
                None => Ok(()),
            }
        }
    }
}

/// The page of a folder, if it is one of ours.
fn page_of(folder: &Path) -> Option<String> {
    let path = folder.join(PAGE);
    let ours = format!("<meta name=\"generator\" content=\"{GENERATOR} ");
    // Asked before opening, which would wait for ever on a pipe.
    let page = path.is_file().then(|| fs::read_to_string(&path)).and_then(Result::ok);
    page.filter(|page| page.find(&ours).is_some_and(|place| place < START))
}

/// The first thing below `place` in a report that its page does not name, as it names all its files.
fn added(folder: &Path, place: &Path, page: &str) -> io::Result<Option<PathBuf>> {
    for entry in fs::read_dir(folder.join(place))? {
        let entry = entry?;
        let place = place.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            if let Some(file) = added(folder, &place, page)? {
                return Ok(Some(file));
            }
        } else if place != Path::new(PAGE)
            && !place.to_str().is_some_and(|name| page.contains(&format!("\"{name}\"")))
        {
            return Ok(Some(place));
        }
    }
    Ok(None)
}

/// A temporary folder with the permissions that any new folder would get.
fn temporary(around: &Path) -> io::Result<Temporary> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".perceptile-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The process's mask applies, as to a folder that it creates itself.
        builder.permissions(fs::Permissions::from_mode(0o777));
    }
    let (folder, unfinished) = Unfinished::make(|| {
        let folder = builder.tempdir_in(around)?;
        let path = folder.path().to_owned();
        Ok::<_, io::Error>((folder, path))
    })?;
    Ok(Temporary { folder, unfinished })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::unfinished;

    fn page() -> String {
        let generator =
            format!("<!DOCTYPE html><meta name=\"generator\" content=\"{GENERATOR} 0\">");
        generator + "<img src=\"deep/er/file\">"
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
    fn a_report_with_a_file_of_somebody_else_is_not_replaced() {
        let room = tempfile::tempdir().unwrap();
        let out = room.path().join("report");
        for place in ["notes", "deep/tile.npy", "deep/er/files", "deep/index.html"] {
            make(&out, Existing::Replace, "old").unwrap();
            fs::write(out.join(place), "theirs").unwrap();
            let error = make(&out, Existing::Replace, "new").unwrap_err();
            assert!(matches!(&error, ReportError::Added { file, .. } if file == Path::new(place)));
            assert_eq!(fs::read_to_string(out.join(place)).unwrap(), "theirs");
            fs::remove_file(out.join(place)).unwrap();
        }
        // Somebody adds it while the new one is made.
        let folder = Folder::new(&out, Existing::Replace).unwrap();
        folder.write(PAGE, page().as_bytes()).unwrap();
        fs::write(out.join("late"), "theirs").unwrap();
        assert!(matches!(folder.finish(), Err(ReportError::Added { .. })));
        assert!(out.join("late").exists());
    }

    #[test]
    fn a_folder_is_unfinished_until_it_has_its_name() {
        let room = tempfile::tempdir().unwrap();
        let out = room.path().join("report");
        for existing in [Existing::Keep, Existing::Replace] {
            let folder = Folder::new(&out, existing).unwrap();
            folder.write(PAGE, page().as_bytes()).unwrap();
            let temporary = folder.temporary.folder.path().to_owned();
            assert!(unfinished::is_registered(&temporary));
            folder.finish().unwrap();
            assert!(!unfinished::is_registered(&temporary) && !unfinished::is_registered(&out));
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
