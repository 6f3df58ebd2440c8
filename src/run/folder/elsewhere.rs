//! A run's folder where there are no modes, owners and open folders: reached by its path.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::FolderError;

/// A folder.
#[derive(Debug)]
pub struct Directory {
    path: PathBuf,
}

impl Directory {
    /// Makes a folder.
    pub fn make(path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    /// Makes sure that there is a folder.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let metadata = fs::symlink_metadata(path).map_err(FolderError::io("open", path))?;
        if !metadata.is_dir() {
            return Err(FolderError::NotFolder(path.to_owned()));
        }
        Ok(Self { path: path.to_owned() })
    }

    /// The path it was opened by, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The names of all that is in it.
    pub fn names(&self) -> io::Result<Vec<OsString>> {
        fs::read_dir(&self.path)?.map(|entry| Ok(entry?.file_name())).collect()
    }

    /// Opens a file for reading.
    pub fn open_file(&self, name: &str) -> Result<File, FolderError> {
        self.open_own(name, File::options().read(true))
    }

    /// Opens a file for locking, and makes it if need be.
    pub fn open_lock(&self, name: &str) -> Result<File, FolderError> {
        self.open_own(name, File::options().read(true).write(true).create(true).truncate(false))
    }

    /// Makes a file that is not there yet.
    pub fn create(&self, name: &str) -> io::Result<File> {
        File::create_new(self.path.join(name))
    }

    /// Gives a file another name, which may be taken.
    pub fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.path.join(from), self.path.join(to))
    }

    /// Removes a file.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        fs::remove_file(self.path.join(name))
    }

    /// Folders cannot be flushed to the disk here.
    pub fn sync(&self) -> io::Result<()> {
        Ok(())
    }

    /// Whether the file still has this name, which an open file does not lose here.
    pub fn holds(&self, _name: &str, _file: &File) -> io::Result<bool> {
        Ok(true)
    }

    /// Opens a regular file.
    fn open_own(&self, name: &str, options: &fs::OpenOptions) -> Result<File, FolderError> {
        let path = self.path.join(name);
        match fs::symlink_metadata(&path) {
            Ok(metadata) if !metadata.is_file() => return Err(FolderError::NotFile(path)),
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(FolderError::io("open", &path)(error));
            }
            _ => (),
        }
        options.open(&path).map_err(FolderError::io("open", &path))
    }
}
