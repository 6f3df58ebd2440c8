//! Claims on outputs: who is going to write a file claims it before the work begins, so that two
//! who mean the same file do not both work for it.
//!
//! A claim is a lock on an empty file beside the output, `.tile.npy.lock` for `tile.npy`. The
//! system takes the lock back however the process ends, and a file that is left behind without a
//! lock claims nothing.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::unfinished::Unfinished;
use super::write::{Existing, Target, WriteError};

/// How often a lock is tried that others make and remove at the same time.
const ATTEMPTS: usize = 16;

/// An output that nobody else claims, for as long as this lives.
#[derive(Debug)]
pub struct Claim {
    /// Nothing where the system has no locks.
    _lock: Option<Lock>,
}

/// A file that is locked.
#[derive(Debug)]
struct Lock {
    path: PathBuf,
    /// Dropped before the lock, so that nobody else's is removed.
    unfinished: Unfinished,
    _file: File,
}

impl Claim {
    /// Claims an output. Paths that lead to one file are one output: a symbolic link is followed
    /// as [`write`](super::write::write) does.
    ///
    /// Where the file system has no locks, or the output's name leaves no room for the lock's, it
    /// goes unclaimed.
    ///
    /// # Errors
    /// [`WriteError::Claimed`] if somebody else claims it, [`WriteError::NotLock`] if something
    /// else has the lock's name, and as for [`probe`](super::write::probe).
    pub fn new(output: &Path, existing: Existing) -> Result<Self, WriteError> {
        let target = Target::new(output, existing)?;
        // A link to it may lead elsewhere by the time the lock is removed.
        let folder = target.folder.canonicalize().map_err(WriteError::io(&target.folder))?;
        let mut name = std::ffi::OsString::from(".");
        name.extend(target.path.file_name());
        name.push(".lock");
        let path = folder.join(name);
        // Only one's own lock is removed at the end of the process, so it is registered when held.
        let made = Unfinished::make(|| match lock(output, &path) {
            Ok(Some(file)) => Ok((file, path.clone())),
            Ok(None) => Err(None),
            Err(error) => Err(Some(error)),
        });
        let lock = match made {
            Ok((file, unfinished)) => Some(Lock { path, unfinished, _file: file }),
            Err(None) => None,
            Err(Some(error)) => return Err(error),
        };
        let claim = Self { _lock: lock };
        // Somebody may have finished it just before.
        Target::new(output, existing)?;
        Ok(claim)
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // A file that stays claims nothing.
        let _ = self.unfinished.complete(|| fs::remove_file(&self.path));
    }
}

/// Locks the file `path`, to be made if it is not there; nothing where there are no locks.
fn lock(output: &Path, path: &Path) -> Result<Option<File>, WriteError> {
    for _ in 0..ATTEMPTS {
        // What is no empty file is not ours to remove. It is not even opened, as a device may do
        // something then.
        if let Ok(metadata) = fs::symlink_metadata(path)
            && (!metadata.is_file() || metadata.len() > 0)
        {
            return Err(WriteError::NotLock { path: output.to_owned(), lock: path.to_owned() });
        }
        let file = match open(path) {
            Ok(file) => file,
            // The name is too long.
            Err(error) if error.kind() == ErrorKind::InvalidFilename => return Ok(None),
            // Somebody made it meanwhile.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
            Err(error) => return Err(WriteError::io(path)(error)),
        };
        match file.try_lock() {
            Ok(()) => (),
            Err(TryLockError::WouldBlock) => break,
            Err(TryLockError::Error(error)) if is_unsupported(&error) => {
                let _ = fs::remove_file(path);
                return Ok(None);
            }
            Err(TryLockError::Error(error)) => return Err(WriteError::io(path)(error)),
        }
        // A lock on a file that was removed meanwhile would keep nobody out.
        if has_name(&file, path).map_err(WriteError::io(path))? {
            return Ok(Some(file));
        }
    }
    Err(WriteError::Claimed { path: output.to_owned() })
}

/// Opens a file for locking. It is never emptied, and no link is followed to it.
fn open(path: &Path) -> io::Result<File> {
    let mut options = File::options();
    // Locks on network file systems ask for the right to write.
    options.read(true).write(true);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        // A pipe would have us wait for its other end.
        options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32);
    }
    match options.open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => options.create_new(true).open(path),
        // Another user left it behind.
        Err(error) if error.kind() == ErrorKind::PermissionDenied => {
            options.write(false).open(path)
        }
        result => result,
    }
}

/// Whether the system says that it has no locks there.
fn is_unsupported(error: &io::Error) -> bool {
    // What network file systems say whose lock service does not run.
    #[cfg(unix)]
    if error.raw_os_error() == Some(rustix::io::Errno::NOLCK.raw_os_error()) {
        return true;
    }
    error.kind() == ErrorKind::Unsupported
}

/// Whether an open file has this name.
#[cfg(unix)]
fn has_name(file: &File, path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    let opened = file.metadata()?;
    match fs::symlink_metadata(path) {
        Ok(named) => Ok((named.dev(), named.ino()) == (opened.dev(), opened.ino())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

/// Whether an open file has this name, which it does not lose here.
#[cfg(not(unix))]
fn has_name(_file: &File, _path: &Path) -> io::Result<bool> {
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::unfinished;

    const LOCK: &str = ".tile.npy.lock";

    fn names(folder: &Path) -> Vec<String> {
        let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = names.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn claim(output: &Path) -> Result<Claim, WriteError> {
        Claim::new(output, Existing::Keep)
    }

    #[test]
    fn one_claims_an_output_and_others_wait() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("tile.npy");
        for existing in [Existing::Keep, Existing::Replace] {
            let first = Claim::new(&path, existing).unwrap();
            assert_eq!(names(room.path()), [LOCK]);
            let around = room.path().join("..").join(room.path().file_name().unwrap());
            for same in [&path, &room.path().join(".").join("tile.npy"), &around.join("tile.npy")] {
                let error = Claim::new(same, existing).unwrap_err();
                assert!(matches!(error, WriteError::Claimed { .. }), "{error}");
                assert!(error.to_string().contains(&same.display().to_string()), "{error}");
            }
            // Who was refused took nothing away.
            assert!(matches!(Claim::new(&path, existing), Err(WriteError::Claimed { .. })));
            let _other = claim(&room.path().join("other.npy")).unwrap();
            drop(first);
            drop(Claim::new(&path, existing).unwrap());
        }
        assert!(names(room.path()).is_empty());
    }

    #[test]
    fn a_lock_that_was_left_behind_claims_nothing() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("tile.npy");
        File::create(room.path().join(LOCK)).unwrap();
        let claim = claim(&path).unwrap();
        assert!(matches!(Claim::new(&path, Existing::Keep), Err(WriteError::Claimed { .. })));
        drop(claim);
        assert!(names(room.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn a_lock_that_was_removed_keeps_nobody_out() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join(LOCK);
        let lock = open(&path).unwrap();
        assert!(has_name(&lock, &path).unwrap());
        fs::remove_file(&path).unwrap();
        assert!(!has_name(&lock, &path).unwrap());
        let other = open(&path).unwrap();
        assert!(!has_name(&lock, &path).unwrap());
        assert!(has_name(&other, &path).unwrap());
        // A link is not the file.
        fs::rename(&path, room.path().join("file")).unwrap();
        std::os::unix::fs::symlink("file", &path).unwrap();
        assert!(!has_name(&other, &path).unwrap());
    }

    #[test]
    fn an_output_that_is_there_is_not_claimed() {
        let room = tempfile::tempdir().unwrap();
        let at = |name: &str| room.path().join(name);
        fs::write(at("tile.npy"), "").unwrap();
        assert!(matches!(claim(&at("tile.npy")), Err(WriteError::Exists { .. })));
        assert!(matches!(claim(&at("no/tile.npy")), Err(WriteError::NoFolder { .. })));
        assert!(matches!(claim(&at("..")), Err(WriteError::NoName { .. })));
        assert_eq!(names(room.path()), ["tile.npy"]);
        drop(Claim::new(&at("tile.npy"), Existing::Replace).unwrap());
        assert_eq!(names(room.path()), ["tile.npy"]);
    }

    #[test]
    fn a_lock_does_not_outlive_the_process() {
        let room = tempfile::tempdir().unwrap();
        let lock = room.path().canonicalize().unwrap().join(LOCK);
        let path = room.path().join("tile.npy");
        let first = claim(&path).unwrap();
        assert!(unfinished::is_registered(&lock));
        // Nobody else's is removed, now or at the end.
        assert!(claim(&path).is_err());
        assert!(lock.exists());
        drop(first);
        assert!(!unfinished::is_registered(&lock));
    }

    #[test]
    fn names_may_be_as_long_as_the_system_lets_them() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("n".repeat(254));
        let _claim = claim(&path).unwrap();
        assert!(names(room.path()).is_empty());
        fs::write(&path, "").unwrap();
    }

    #[test]
    fn one_of_many_claims_an_output_at_a_time() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("tile.npy");
        let (held, claims) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    while claims.load(Ordering::SeqCst) < 200 {
                        match claim(&path) {
                            Ok(claim) => {
                                assert_eq!(held.fetch_add(1, Ordering::SeqCst), 0);
                                // Nor has anybody finished it.
                                File::create_new(&path).unwrap();
                                held.fetch_sub(1, Ordering::SeqCst);
                                drop(claim);
                                std::thread::yield_now();
                                fs::remove_file(&path).unwrap();
                                claims.fetch_add(1, Ordering::SeqCst);
                            }
                            Err(WriteError::Claimed { .. } | WriteError::Exists { .. }) => (),
                            Err(error) => panic!("{error}"),
                        }
                    }
                });
            }
        });
        assert!(names(room.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn links_lead_to_what_is_claimed() {
        use std::os::unix::fs::symlink;
        let room = tempfile::tempdir().unwrap();
        let at = |name: &str| room.path().join(name);
        fs::create_dir(at("folder")).unwrap();
        symlink("folder", at("there")).unwrap();
        let _claim = claim(&at("folder/tile.npy")).unwrap();
        let error = claim(&at("there/tile.npy")).unwrap_err();
        assert!(matches!(error, WriteError::Claimed { .. }), "{error}");
        // Also if a link leads elsewhere meanwhile, each claim ends where it began.
        fs::create_dir(at("new")).unwrap();
        let through_link = claim(&at("there/other.npy")).unwrap();
        let new = claim(&at("new/other.npy")).unwrap();
        fs::remove_file(at("there")).unwrap();
        symlink("new", at("there")).unwrap();
        drop(through_link);
        assert_eq!(names(&at("folder")), [LOCK]);
        assert_eq!(names(&at("new")), [".other.npy.lock"]);
        drop(new);
        // A link to a file that is replaced is that file.
        fs::write(at("real.npy"), "").unwrap();
        symlink("real.npy", at("link.npy")).unwrap();
        let _claim = Claim::new(&at("link.npy"), Existing::Replace).unwrap();
        let error = Claim::new(&at("real.npy"), Existing::Replace).unwrap_err();
        assert!(matches!(error, WriteError::Claimed { .. }), "{error}");
        assert!(names(room.path()).contains(&".real.npy.lock".to_owned()));
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_lock_is_neither_followed_nor_removed() {
        use std::os::unix::fs::symlink;
        use std::os::unix::net::UnixListener;
        let room = tempfile::tempdir().unwrap();
        let at = |name: &str| room.path().join(name);
        let refused = || {
            let error = claim(&at("tile.npy")).unwrap_err();
            assert!(matches!(&error, WriteError::NotLock { .. }), "{error}");
            assert!(error.to_string().contains(LOCK), "{error}");
        };
        fs::write(at(LOCK), "theirs").unwrap();
        refused();
        assert_eq!(fs::read_to_string(at(LOCK)).unwrap(), "theirs");
        fs::rename(at(LOCK), at("file")).unwrap();
        for target in ["file", "nowhere"] {
            symlink(target, at(LOCK)).unwrap();
            refused();
            fs::remove_file(at(LOCK)).unwrap();
        }
        fs::create_dir(at(LOCK)).unwrap();
        refused();
        fs::remove_dir(at(LOCK)).unwrap();
        let _socket = UnixListener::bind(at(LOCK)).unwrap();
        refused();
        fs::remove_file(at(LOCK)).unwrap();
        #[cfg(target_os = "linux")]
        {
            use rustix::fs::{CWD, FileType, Mode, mknodat};
            mknodat(CWD, at(LOCK), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
            refused();
        }
        assert!(!at("nowhere").exists());
        assert_eq!(fs::read_to_string(at("file")).unwrap(), "theirs");
    }

    #[cfg(unix)]
    #[test]
    fn a_system_without_locks_is_told_from_one_that_fails() {
        use rustix::io::Errno;
        for (error, expected) in [
            (Errno::NOLCK, true),
            (Errno::OPNOTSUPP, true),
            (Errno::NOSYS, true),
            (Errno::IO, false),
            (Errno::ACCESS, false),
        ] {
            assert_eq!(is_unsupported(&error.into()), expected, "{error}");
        }
    }
}
