//! A run's folder on Unix: held open, so that its files are reached through it and not through a
//! path that somebody may have bent meanwhile; no symbolic link is ever followed into or in it.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, Dir, Mode, OFlags};
use rustix::io::Errno;

use super::FolderError;

/// Bits of a mode that let group or others write.
const WRITABLE: u32 = 0o022;

/// An open folder that nobody else may change.
#[derive(Debug)]
pub struct Directory {
    path: PathBuf,
    file: File,
}

impl Directory {
    /// Makes a folder for its owner alone.
    pub fn make(path: &Path) -> io::Result<()> {
        fs::DirBuilder::new().mode(0o700).create(path)
    }

    /// Opens a folder, unless it is not ours alone to write in.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let file: File = match rustix::fs::open(path, flags, Mode::empty()) {
            Ok(folder) => folder.into(),
            Err(Errno::NOTDIR | Errno::LOOP | Errno::MLINK) => {
                return Err(FolderError::NotFolder(path.to_owned()));
            }
            Err(error) => return Err(FolderError::io("open", path)(error.into())),
        };
        let metadata = file.metadata().map_err(FolderError::io("open", path))?;
        check_owner(path, &metadata)?;
        let mode = metadata.mode() & 0o7777;
        if mode & WRITABLE != 0 {
            return Err(FolderError::Writable { path: path.to_owned(), mode });
        }
        Ok(Self { path: path.to_owned(), file })
    }

    /// The path it was opened by, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The names of all that is in it.
    pub fn names(&self) -> io::Result<Vec<OsString>> {
        let mut names = Vec::new();
        for entry in Dir::read_from(&self.file)? {
            let name = entry?.file_name().to_bytes().to_owned();
            if name != b"." && name != b".." {
                names.push(OsStr::from_bytes(&name).to_owned());
            }
        }
        Ok(names)
    }

    /// Opens a file for reading.
    pub fn open_file(&self, name: &str) -> Result<File, FolderError> {
        self.open_own(name, OFlags::RDONLY)
    }

    /// Opens a file for locking, and makes it if need be.
    pub fn open_lock(&self, name: &str) -> Result<File, FolderError> {
        // Locks on network file systems ask for the right to write.
        self.open_own(name, OFlags::RDWR | OFlags::CREATE)
    }

    /// Makes a file that is not there yet.
    pub fn create(&self, name: &str) -> io::Result<File> {
        let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::CLOEXEC;
        Ok(rustix::fs::openat(&self.file, name, flags, Mode::RUSR | Mode::WUSR)?.into())
    }

    /// Gives a file another name, which may be taken.
    pub fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        Ok(rustix::fs::renameat(&self.file, from, &self.file, to)?)
    }

    /// Removes a file.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        Ok(rustix::fs::unlinkat(&self.file, name, AtFlags::empty())?)
    }

    /// Makes the names in it outlive a power cut.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
    }

    /// Whether `file` still has this name.
    pub fn holds(&self, name: &str, file: &File) -> io::Result<bool> {
        let opened = rustix::fs::fstat(file)?;
        match rustix::fs::statat(&self.file, name, AtFlags::SYMLINK_NOFOLLOW) {
            Ok(named) => Ok((named.st_dev, named.st_ino) == (opened.st_dev, opened.st_ino)),
            Err(Errno::NOENT) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Opens a regular file of ours.
    fn open_own(&self, name: &str, flags: OFlags) -> Result<File, FolderError> {
        let path = self.path.join(name);
        // A pipe would have us wait for its other end.
        let flags = flags | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file: File = match rustix::fs::openat(&self.file, name, flags, Mode::RUSR | Mode::WUSR)
        {
            Ok(file) => file.into(),
            Err(Errno::LOOP | Errno::MLINK | Errno::ISDIR | Errno::NXIO) => {
                return Err(FolderError::NotFile(path));
            }
            Err(error) => return Err(FolderError::io("open", &path)(error.into())),
        };
        let metadata = file.metadata().map_err(FolderError::io("open", &path))?;
        if !metadata.is_file() {
            return Err(FolderError::NotFile(path));
        }
        check_owner(&path, &metadata)?;
        Ok(file)
    }
}

/// An error unless the file or folder is the user's for whom we run.
fn check_owner(path: &Path, metadata: &fs::Metadata) -> Result<(), FolderError> {
    let user = rustix::process::geteuid().as_raw();
    if metadata.uid() != user {
        return Err(FolderError::Owner { path: path.to_owned(), owner: metadata.uid(), user });
    }
    Ok(())
}
