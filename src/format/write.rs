//! Output that loses nothing: a file appears whole under its name or not at all, and an existing
//! one is replaced only on request.
//!
//! Content goes to a temporary file in the same folder, is flushed to the disk, and takes its
//! name in one step. [`probe`] asks beforehand what would go wrong, so that an hour's work does
//! not end at a closed door.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempPath};
use thiserror::Error;

use super::unfinished::Unfinished;

/// Why an output cannot be written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The output is there already, and replacing it was not asked for.
    #[error("{} exists already; --force replaces it", path.display())]
    Exists {
        /// The output.
        path: PathBuf,
    },
    /// The output's folder is not there.
    #[error("cannot write {}: there is no folder {}", path.display(), folder.display())]
    NoFolder {
        /// The output.
        path: PathBuf,
        /// The folder that it should be in.
        folder: PathBuf,
    },
    /// The output is a folder, but a file is to be written.
    #[error("cannot write {}: it is a folder", path.display())]
    IsFolder {
        /// The output.
        path: PathBuf,
    },
    /// The output is a device, a pipe or the like, which a file must not replace.
    #[error("cannot write {}: it is neither a file nor free", path.display())]
    Special {
        /// The output.
        path: PathBuf,
    },
    /// The path does not end in a name.
    #[error("cannot write {:?}: the path does not end in the name of a file", path.display().to_string())]
    NoName {
        /// The path.
        path: PathBuf,
    },
    /// Two outputs would have one path.
    #[error("two outputs would be written to {}", path.display())]
    Twice {
        /// The path.
        path: PathBuf,
    },
    /// A picture would stand beside the slices of a tile as if it were one of them.
    #[error(
        "{} is no slice of this tile, but a folder of slices is read as one tile: choose another \
         folder; --force removes slices of earlier exports",
        path.display()
    )]
    Beside {
        /// The picture.
        path: PathBuf,
    },
    /// The same, and no export has written it, so it is not removed.
    #[error(
        "{} is no slice of an export, so --force does not remove it: choose another folder",
        path.display()
    )]
    Foreign {
        /// The picture.
        path: PathBuf,
    },
    /// Somebody else claims the output.
    #[error(
        "another run is making {}: wait for it to end, or write to another path",
        path.display()
    )]
    Claimed {
        /// The output.
        path: PathBuf,
    },
    /// Something else has the name of the lock that claims the output.
    #[error(
        "cannot write {}: {} is not an empty file, as the lock of a run would be",
        path.display(), lock.display()
    )]
    NotLock {
        /// The output.
        path: PathBuf,
        /// What is in the way.
        lock: PathBuf,
    },
    /// The system refuses.
    #[error("cannot write {}: {error}", path.display())]
    Io {
        /// The output, or the folder that refuses files.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
}

impl WriteError {
    /// What the system says about `path`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::Io { path: path.to_owned(), error }
    }
}

/// What to do with an output that exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    /// Keep it, and fail.
    Keep,
    /// Replace it, once the new one is complete.
    Replace,
}

impl Existing {
    /// From the flag `--force`.
    pub fn from_force(force: bool) -> Self {
        if force { Self::Replace } else { Self::Keep }
    }
}

/// Checks that all `outputs` could be written now, and leaves no trace.
///
/// # Errors
/// The first reason against: an output that exists (unless `existing` lets it be replaced), is a
/// folder or a device, or occurs twice; a folder that is missing or takes no files.
pub fn probe(
    outputs: impl IntoIterator<Item = impl AsRef<Path>>,
    existing: Existing,
) -> Result<(), WriteError> {
    let mut seen = HashSet::new();
    let mut folders = HashSet::new();
    for output in outputs {
        let target = Target::new(output.as_ref(), existing)?;
        // One spelling for `tile.npy` and `./tile.npy`.
        let whole = target.folder.canonicalize().map_err(WriteError::io(&target.folder))?;
        if !seen.insert(target.path.file_name().map(|name| whole.join(name))) {
            return Err(WriteError::Twice { path: target.path });
        }
        if folders.insert(whole) {
            temporary(&target.folder).map_err(WriteError::io(&target.folder))?;
        }
    }
    Ok(())
}

/// Writes a file: `content` fills it, and it takes its name when it is complete and on the disk.
///
/// On any failure nothing has changed under `path`. A symbolic link to a file is followed, so
/// that the link stays and the file is replaced.
///
/// # Errors
/// As for [`probe`], and what the system or `content` reports on the way.
pub fn write(
    path: &Path,
    existing: Existing,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), WriteError> {
    Staged::new(path, existing, content)?.finish()
}

/// A file that is complete and on the disk, but does not have its name yet. Dropped, it is gone.
///
/// Of files that belong together, all can be staged before the first takes its name.
pub struct Staged {
    path: PathBuf,
    target: Target,
    existing: Existing,
    file: TempPath,
    unfinished: Unfinished,
}

impl Staged {
    /// A file that is to be `path`; `content` fills it.
    ///
    /// # Errors
    /// As for [`write()`].
    pub fn new(
        path: &Path,
        existing: Existing,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<Self, WriteError> {
        let target = Target::new(path, existing)?;
        let Temporary { mut file, unfinished } =
            temporary(&target.folder).map_err(WriteError::io(path))?;
        let mut buffer = BufWriter::new(file.as_file_mut());
        content(&mut buffer).and_then(|()| buffer.flush()).map_err(WriteError::io(path))?;
        drop(buffer);
        file.as_file().sync_all().map_err(WriteError::io(path))?;
        let file = file.into_temp_path();
        Ok(Self { path: path.to_owned(), target, existing, file, unfinished })
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// Somebody else took the name meanwhile and it is to be kept, or the system refuses.
    pub fn finish(self) -> Result<(), WriteError> {
        let Self { path, target, existing, file, mut unfinished } = self;
        let persisted = unfinished.complete(|| match existing {
            Existing::Keep => file.persist_noclobber(&target.path),
            Existing::Replace => file.persist(&target.path),
        });
        persisted.map_err(|failure| match failure.error.kind() {
            // Someone else took the name while the file was written.
            io::ErrorKind::AlreadyExists => WriteError::Exists { path: path.clone() },
            _ => WriteError::Io { path: path.clone(), error: failure.error },
        })?;
        // The file is whole; that its name outlives a power cut is asked for, but not every file
        // system can promise it.
        if let Ok(folder) = File::open(&target.folder) {
            let _ = folder.sync_all();
        }
        Ok(())
    }
}

/// Makes the folder `path` unless it exists; the folder around it must.
///
/// # Errors
/// `path` is something else, or the system refuses.
pub fn make_folder(path: &Path) -> Result<(), WriteError> {
    match fs::create_dir(path) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            Err(WriteError::Exists { path: path.to_owned() })
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(WriteError::NoFolder { path: path.to_owned(), folder: folder_of(path).to_owned() })
        }
        result => result.map_err(WriteError::io(path)),
    }
}

/// Whether two paths lead to one file.
pub fn is_same(a: &Path, b: &Path) -> bool {
    a == b || matches!((fs::canonicalize(a), fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
}

/// Where a file will be, after all checks that can be made before writing.
pub(super) struct Target {
    pub path: PathBuf,
    pub folder: PathBuf,
}

impl Target {
    pub fn new(path: &Path, existing: Existing) -> Result<Self, WriteError> {
        let owned = || path.to_owned();
        if path.file_name().is_none() {
            return Err(WriteError::NoName { path: owned() });
        }
        let folder = folder_of(path);
        if !folder.is_dir() {
            return Err(WriteError::NoFolder { path: owned(), folder: folder.to_owned() });
        }
        let plain = || Self { path: owned(), folder: folder.to_owned() };
        let link = match fs::symlink_metadata(path) {
            Ok(metadata) => metadata.is_symlink(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(plain()),
            Err(error) => return Err(WriteError::io(path)(error)),
        };
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => Err(WriteError::IsFolder { path: owned() }),
            Ok(metadata) if !metadata.is_file() => Err(WriteError::Special { path: owned() }),
            _ if existing == Existing::Keep => Err(WriteError::Exists { path: owned() }),
            Ok(_) if link => {
                let path = fs::canonicalize(path).map_err(WriteError::io(path))?;
                Ok(Self { folder: folder_of(&path).to_owned(), path })
            }
            // A link that leads nowhere is itself replaced.
            _ => Ok(plain()),
        }
    }
}

/// The folder that a path's last name is in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// A file without a lasting name.
struct Temporary {
    /// Removed before it is no longer unfinished.
    file: NamedTempFile,
    unfinished: Unfinished,
}

/// An empty file without a lasting name, with the permissions that any new file would get.
fn temporary(folder: &Path) -> io::Result<Temporary> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".perceptile-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The process's mask applies, as to a file that it creates itself.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let (file, unfinished) = Unfinished::make(|| {
        let file = builder.tempfile_in(folder).map_err(unnamed)?;
        let path = file.path().to_owned();
        Ok::<_, io::Error>((file, path))
    })?;
    Ok(Temporary { file, unfinished })
}

/// An error without the name of a temporary file, which means nothing to people.
fn unnamed(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path ") {
        Some((what, _)) => io::Error::new(error.kind(), what),
        None => error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::unfinished;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn put(path: &Path, existing: Existing, text: &str) -> Result<(), WriteError> {
        write(path, existing, |out| out.write_all(text.as_bytes()))
    }

    #[test]
    fn an_existing_file_is_replaced_only_on_request() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        probe([&path], Existing::Keep).unwrap();
        assert!(names(folder.path()).is_empty());
        put(&path, Existing::Keep, "first").unwrap();
        let refused = put(&path, Existing::Keep, "second").unwrap_err();
        assert!(matches!(&refused, WriteError::Exists { .. }));
        assert!(refused.to_string().contains("--force"));
        assert!(matches!(probe([&path], Existing::Keep), Err(WriteError::Exists { .. })));
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        probe([&path], Existing::Replace).unwrap();
        put(&path, Existing::Replace, "third").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "third");
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[test]
    fn a_name_taken_while_writing_is_not_lost() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let result = write(&path, Existing::Keep, |out| {
            fs::write(&path, "theirs")?;
            out.write_all(b"ours")
        });
        assert!(matches!(result, Err(WriteError::Exists { .. })));
        assert_eq!(fs::read_to_string(&path).unwrap(), "theirs");
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[test]
    fn a_file_is_unfinished_until_it_has_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let only = || folder.path().join(&names(folder.path())[0]);
        let mut temporary = PathBuf::new();
        write(&folder.path().join("a"), Existing::Keep, |out| {
            temporary = only();
            assert!(unfinished::is_registered(&temporary));
            out.write_all(b"content")
        })
        .unwrap();
        assert_eq!(only(), folder.path().join("a"));
        assert!(!unfinished::is_registered(&temporary) && !unfinished::is_registered(&only()));
    }

    #[test]
    fn a_folder_that_refuses_files_is_told_without_a_temporary_name() {
        let error = temporary(Path::new("/nowhere")).err().unwrap();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(!error.to_string().contains("perceptile"), "{error}");
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        put(&path, Existing::Keep, "old").unwrap();
        let result = write(&path, Existing::Replace, |out| {
            out.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(result.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[test]
    fn places_that_take_no_file_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("file"), "").unwrap();
        for existing in [Existing::Keep, Existing::Replace] {
            let check = |path: PathBuf| {
                let error = probe([&path], existing).unwrap_err();
                assert_eq!(error.to_string(), put(&path, existing, "").unwrap_err().to_string());
                error
            };
            assert!(matches!(check(at("no/a")), WriteError::NoFolder { .. }));
            assert!(matches!(check(at("file/a")), WriteError::NoFolder { .. }));
            assert!(matches!(check(at("")), WriteError::IsFolder { .. }));
            assert!(matches!(check(at("..")), WriteError::NoName { .. }));
            assert!(matches!(check(PathBuf::new()), WriteError::NoName { .. }));
            if cfg!(unix) {
                assert!(matches!(check("/dev/null".into()), WriteError::Special { .. }));
            }
        }
        assert!(matches!(make_folder(&at("no/a")), Err(WriteError::NoFolder { .. })));
        assert!(matches!(make_folder(&at("file")), Err(WriteError::Exists { .. })));
        make_folder(&at("new")).unwrap();
        make_folder(&at("new")).unwrap();
        assert!(at("new").is_dir());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_that_takes_no_files_is_found_out_beforehand() {
        // Nobody, not even root, makes files there.
        let error = probe(["/proc/tile.npy"], Existing::Keep).unwrap_err();
        assert!(matches!(error, WriteError::Io { .. }), "{error}");
    }

    #[test]
    fn a_set_of_outputs_is_checked_as_one() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("b"), "").unwrap();
        assert!(probe([at("a"), at("c")], Existing::Keep).is_ok());
        let error = probe([at("a"), at("b")], Existing::Keep).unwrap_err();
        assert!(error.to_string().contains(&at("b").display().to_string()));
        let twice = probe([at("a"), folder.path().join(".").join("a")], Existing::Keep);
        assert!(matches!(twice, Err(WriteError::Twice { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_permissions_are_the_usual() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        File::create(at("usual")).unwrap();
        put(&at("a"), Existing::Keep, "old").unwrap();
        let mode = |name| fs::metadata(at(name)).unwrap().permissions().mode();
        assert_eq!(mode("a"), mode("usual"));
        symlink("a", at("link")).unwrap();
        symlink("nowhere", at("dangling")).unwrap();
        for name in ["link", "dangling"] {
            let result = put(&at(name), Existing::Keep, "");
            assert!(matches!(result, Err(WriteError::Exists { .. })), "{name}");
        }
        put(&at("link"), Existing::Replace, "new").unwrap();
        assert!(fs::symlink_metadata(at("link")).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(at("a")).unwrap(), "new");
    }
}
