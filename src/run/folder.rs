//! The folder of a long run, where its checkpoints are: what a run that was killed goes on from.
//!
//! A run has its folder alone: it holds a lock on the file `lock` there for as long as it lives,
//! and the system takes the lock back however the run ends. A checkpoint takes its name when it
//! is whole and on the disk, and only then do older ones go; the last two stay, should the newest
//! be damaged later. What was not finished has another name and is never read.
//!
//! The folder is not trusted more than any input: its files steer the run, and the run removes
//! files there. So on Unix nobody but the user may be able to write in it, and symbolic links are
//! not followed.

#[cfg_attr(unix, path = "folder/unix.rs")]
#[cfg_attr(not(unix), path = "folder/elsewhere.rs")]
mod system;

use std::fmt::Write as _;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, ErrorKind, Seek};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::format::checkpoint::{self, CheckpointError, Seal};
use crate::format::numbers::{ArraySink, ArraySource};
use crate::format::write::{Existing, folder_of};
use system::Directory;

/// The file whose lock a run holds; it is empty.
const LOCK: &str = "lock";
/// The name of a checkpoint, before its number.
const CHECKPOINT: &str = "checkpoint-";
/// What follows the number while a checkpoint is not whole.
const PARTIAL: &str = ".partial";
/// Checkpoints that stay when a new one is there.
const KEPT: usize = 2;
/// How often a folder is tried that others make and remove at the same time.
const ATTEMPTS: usize = 16;

/// Why the folder of a run cannot be used, or the run in it cannot go on.
#[derive(Debug, Error)]
pub enum FolderError {
    /// The path is empty.
    #[error("the path of a run's folder is empty")]
    NoName,
    /// The folder that it should be in is not there.
    #[error("cannot make {}: there is no folder {}", path.display(), folder.display())]
    NoFolder {
        /// The run's folder.
        path: PathBuf,
        /// The folder that it should be in.
        folder: PathBuf,
    },
    /// It is a symbolic link, a file or the like.
    #[error("{} is not a folder, which a run's must be itself and not by a link", .0.display())]
    NotFolder(PathBuf),
    /// It holds other things than a run.
    #[error(
        "{} holds {found:?} but no run: a run's folder must be new, empty or a run's already",
        path.display()
    )]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// Something in it.
        found: String,
    },
    /// Another run holds its lock.
    #[error("{} is in use by another run, and a run must have its folder alone", .0.display())]
    InUse(PathBuf),
    /// A folder or a file in it belongs to somebody else.
    #[error(
        "{} belongs to user {owner}, but a run's folder and files must be of user {user}, who runs it",
        path.display()
    )]
    Owner {
        /// The folder or file.
        path: PathBuf,
        /// Number of the user whose it is.
        owner: u32,
        /// Number of the user who runs this.
        user: u32,
    },
    /// Others could change what is in the folder.
    #[error(
        "{} has mode {mode:04o}, but group and others must not write in a run's folder: chmod go-w",
        path.display()
    )]
    Writable {
        /// The folder.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Something else has the name of one of the run's files.
    #[error("{} is not a regular file, which a run's files must be", .0.display())]
    NotFile(PathBuf),
    /// A run is there that could be resumed, and giving it up was not asked for.
    #[error(
        "{0} holds an unfinished run, up to {CHECKPOINT}{number}: `perceptile resume {0}` goes on, --force discards it",
        path.display()
    )]
    Unfinished {
        /// The folder.
        path: PathBuf,
        /// The number of its newest checkpoint.
        number: u64,
    },
    /// There is nothing to resume.
    #[error(
        "{} holds no checkpoint that a run could go on from{}", .0.display(),
        if .0.is_dir() { "" } else { ": there is no such folder, and a run writes its first checkpoint after a minute unless --checkpoint says otherwise" }
    )]
    NoRun(PathBuf),
    /// All that there is to resume is damaged.
    #[error("{} holds no checkpoint that can be used:{}", path.display(), list(damaged))]
    Damaged {
        /// The folder.
        path: PathBuf,
        /// Its checkpoints, newest first, and why not.
        damaged: Vec<(PathBuf, CheckpointError)>,
    },
    /// A checkpoint is no longer what it was.
    #[error("{} was good, but not when it was read again: {error}", path.display())]
    Changed {
        /// The checkpoint.
        path: PathBuf,
        /// What is wrong now.
        error: CheckpointError,
    },
    /// The run was made by another version, whose steps may be others.
    #[error(
        "the run in {} was made by version {found}, and this is {}: only that version makes its tile",
        path.display(), env!("CARGO_PKG_VERSION")
    )]
    Version {
        /// The folder.
        path: PathBuf,
        /// The version.
        found: String,
    },
    /// What the checkpoint says cannot be.
    #[error("the checkpoint in {} cannot be used: {rule}", path.display())]
    Content {
        /// The folder.
        path: PathBuf,
        /// What is wrong.
        rule: String,
    },
    /// A checkpoint that would not be the newest.
    #[error(
        "cannot write {CHECKPOINT}{number} in {}: numbers rise, and the run is at {last}",
        path.display()
    )]
    Number {
        /// The folder.
        path: PathBuf,
        /// The number asked for.
        number: u64,
        /// The number that it must exceed.
        last: u64,
    },
    /// The system refuses.
    #[error("cannot {action} {}: {error}", path.display())]
    Io {
        /// What was to be done.
        action: &'static str,
        /// With which file or folder.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
}

impl FolderError {
    fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::Io { action, path: path.to_owned(), error }
    }

    /// Whether something was gone when it was needed.
    fn is_gone(&self) -> bool {
        matches!(self, Self::Io { error, .. } if error.kind() == ErrorKind::NotFound)
    }
}

/// Checkpoints that cannot be used, each on its line.
fn list(damaged: &[(PathBuf, CheckpointError)]) -> String {
    damaged.iter().fold(String::new(), |mut text, (path, error)| {
        let _ = write!(text, "\n  {}: {error}", path.display());
        text
    })
}

/// A run's folder, locked for as long as this lives.
#[derive(Debug)]
pub struct RunFolder {
    directory: Directory,
    /// Where the run is: the newest checkpoint, or the one that it went on from.
    last: Option<u64>,
    /// Open, and so locked.
    _lock: File,
}

/// The newest checkpoint of a run that can be used.
#[derive(Debug)]
pub struct Loaded<H> {
    /// The number it was saved with.
    pub number: u64,
    /// Its head.
    pub head: H,
    /// Its arrays.
    pub arrays: Arrays,
    /// Newer checkpoints that cannot be used, newest first, and why not.
    pub damaged: Vec<(PathBuf, CheckpointError)>,
}

/// The arrays of a checkpoint that was found good. They stay in its file, which stays open, so
/// that no other can take its place.
#[derive(Debug)]
pub struct Arrays {
    path: PathBuf,
    file: File,
    seal: Seal,
}

impl Arrays {
    /// How many numbers each array has.
    pub fn lengths(&self) -> &[u64] {
        self.seal.lengths()
    }

    /// Reads the arrays, one after the other, and passes them on piece by piece, each piece with
    /// the number of its array. What was passed on is worth nothing if there is an error in the
    /// end, but was never more than [`Self::lengths`] say.
    ///
    /// # Errors
    /// [`FolderError::Changed`] if the file is not what it was, and what the system reports.
    pub fn read(&mut self, sink: &mut ArraySink<'_>) -> Result<(), FolderError> {
        let Self { path, file, seal } = self;
        file.rewind().map_err(FolderError::io("read", path))?;
        checkpoint::read_again(file, seal, sink)
            .map_err(|error| FolderError::Changed { path: path.clone(), error })
    }
}

impl RunFolder {
    /// Takes a folder for a new run: one that is new, empty, or left behind by a run. The folder
    /// around it must exist.
    ///
    /// If it may be replaced, an unfinished run that is there is removed at once.
    ///
    /// # Errors
    /// [`FolderError::Unfinished`] if there is one that may not; otherwise whatever of
    /// [`FolderError`] makes the folder unfit.
    pub fn create(path: &Path, existing: Existing) -> Result<Self, FolderError> {
        let mut folder = Self::take(path, true)?;
        folder.check(existing)?;
        folder.clear(|_| true)?;
        folder.last = None;
        Ok(folder)
    }

    /// Checks that [`Self::create`] would take a folder now, and leaves no trace.
    ///
    /// # Errors
    /// As for [`Self::create`].
    pub fn probe(path: &Path, existing: Existing) -> Result<(), FolderError> {
        let path = path.components().as_path();
        let is_there = |path: &Path| path.symlink_metadata().is_ok();
        let (was_there, was_locked) = (is_there(path), is_there(&path.join(LOCK)));
        let folder = Self::take(path, true);
        if let Ok(folder) = &folder
            && !was_locked
        {
            folder.remove_file(LOCK)?;
        }
        if !was_there {
            if matches!(folder, Err(FolderError::Io { .. })) {
                // It was made, and could not be looked at.
                let _ = fs::remove_file(path.join(LOCK));
            }
            // Somebody else may be in it by now.
            let _ = fs::remove_dir(path);
        }
        folder?.check(existing)
    }

    /// Takes the folder of a run that is to go on; see [`Self::newest`].
    ///
    /// # Errors
    /// [`FolderError::NoRun`] if the folder is missing or empty; otherwise whatever of
    /// [`FolderError`] makes it unfit.
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        Self::take(path, false)
    }

    /// Where the folder is, without a slash at the end.
    pub fn path(&self) -> &Path {
        self.directory.path()
    }

    /// Reads the newest checkpoint that can be used, all of it, but keeps no array: the numbers
    /// are shown to `look` piece by piece, with those of the checkpoint and of the array. Also
    /// numbers of checkpoints that turn out to be damaged are shown.
    ///
    /// The run is then at its number: what is newer goes when the next one is saved.
    ///
    /// # Errors
    /// [`FolderError::NoRun`] if there is no checkpoint, [`FolderError::Damaged`] if none can be
    /// used, and what is no file of ours under the name of a checkpoint.
    pub fn newest<H: DeserializeOwned>(
        &mut self,
        look: &mut dyn FnMut(u64, usize, &[f32]),
    ) -> Result<Loaded<H>, FolderError> {
        let mut damaged = Vec::new();
        for number in self.numbers()? {
            let name = RunFile::Checkpoint(number).name();
            let path = self.path().join(&name);
            let show = &mut |array, piece: &[f32]| look(number, array, piece);
            let result = match self.directory.open_file(&name) {
                Ok(mut file) => file
                    .metadata()
                    .map_err(CheckpointError::Io)
                    .and_then(|it| checkpoint::read_with(&mut file, it.len(), show))
                    .map(|(head, seal)| (head, file, seal)),
                Err(FolderError::Io { error, .. }) => Err(CheckpointError::Io(error)),
                Err(error) => return Err(error),
            };
            match result {
                Ok((head, file, seal)) => {
                    self.last = Some(number);
                    let arrays = Arrays { path, file, seal };
                    return Ok(Loaded { number, head, arrays, damaged });
                }
                Err(error) => damaged.push((path, error)),
            }
        }
        let path = self.path().to_owned();
        match damaged.is_empty() {
            true => Err(FolderError::NoRun(path)),
            false => Err(FolderError::Damaged { path, damaged }),
        }
    }

    /// Saves a checkpoint, and then removes all but the last two. See
    /// [`checkpoint::write`].
    ///
    /// Numbers rise: each must exceed those before, and after [`Self::newest`] the one that was
    /// read.
    ///
    /// # Errors
    /// Another number, and what the system or `arrays` reports. If the checkpoint cannot be made,
    /// the older ones stay.
    pub fn save<H: Serialize>(
        &mut self,
        number: u64,
        head: &H,
        lengths: &[u64],
        arrays: &dyn ArraySource,
    ) -> Result<(), FolderError> {
        if let Some(last) = self.last.filter(|last| number <= *last) {
            return Err(FolderError::Number { path: self.path().to_owned(), number, last });
        }
        // Those of an earlier run only take space.
        self.clear(|entry| matches!(entry, RunFile::Partial(_)))?;
        let name = RunFile::Checkpoint(number).name();
        let partial = RunFile::Partial(number).name();
        let written = self.directory.create(&partial).and_then(|file| {
            let mut buffer = BufWriter::new(file);
            checkpoint::write(&mut buffer, head, lengths, arrays)?;
            buffer.into_inner()?.sync_all()?;
            self.directory.rename(&partial, &name)
        });
        if let Err(error) = written {
            // Should even that fail, its name still says that it is not whole.
            let _ = self.directory.remove(&partial);
            return Err(FolderError::io("write", &self.path().join(name))(error));
        }
        self.last = Some(number);
        match self.directory.sync() {
            // Not every file system can do it.
            Err(error)
                if !matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) =>
            {
                return Err(FolderError::io("flush", self.path())(error));
            }
            _ => (),
        }
        // Higher numbers are those of damaged ones that the run did not go on from.
        let kept: Vec<u64> =
            self.numbers()?.into_iter().filter(|kept| *kept <= number).take(KEPT).collect();
        self.clear(|entry| matches!(entry, RunFile::Checkpoint(number) if !kept.contains(&number)))
    }

    /// Removes what the run has made, and the folder if that leaves it empty and the system lets
    /// it go. Files of others stay.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn remove(self) -> Result<(), FolderError> {
        self.clear(|_| true)?;
        self.remove_file(LOCK)?;
        // It may hold other files, be a mount or stand where we may not remove it: no harm.
        let _ = fs::remove_dir(self.path());
        Ok(())
    }

    /// An error if an unfinished run is there and is to be kept.
    fn check(&self, existing: Existing) -> Result<(), FolderError> {
        match (self.last, existing) {
            (Some(number), Existing::Keep) => {
                Err(FolderError::Unfinished { path: self.path().to_owned(), number })
            }
            _ => Ok(()),
        }
    }

    /// Locks a folder, `new` to be made if it is not there.
    fn take(path: &Path, new: bool) -> Result<Self, FolderError> {
        // Without a slash at the end, behind which a link would be followed.
        let path = path.components().as_path();
        if path == Path::new("") {
            return Err(FolderError::NoName);
        }
        for _ in 0..ATTEMPTS {
            if new {
                make(path)?;
            }
            match Self::lock(path, new) {
                // The run that had the folder removed it under our hands.
                Err(error) if new && error.is_gone() => (),
                Err(error) if error.is_gone() => return Err(FolderError::NoRun(path.to_owned())),
                Ok(None) => (),
                Ok(Some(folder)) => return Ok(folder),
                Err(error) => return Err(error),
            }
        }
        Err(FolderError::InUse(path.to_owned()))
    }

    /// Locks a folder that is there; nothing if its lock was removed meanwhile.
    fn lock(path: &Path, new: bool) -> Result<Option<Self>, FolderError> {
        let directory = Directory::open(path)?;
        let names = directory.names().map_err(FolderError::io("list", path))?;
        if names.is_empty() && !new {
            return Err(FolderError::NoRun(path.to_owned()));
        }
        // Checkpoints alone are a run's, too: it may have been copied, or is just being removed.
        let foreign = names.iter().find(|name| RunFile::of(name.to_str()).is_none());
        if let (Some(found), false) = (foreign, names.iter().any(|name| name == LOCK)) {
            let found = found.to_string_lossy().into_owned();
            return Err(FolderError::Foreign { path: path.to_owned(), found });
        }
        let lock = directory.open_lock(LOCK)?;
        let at = path.join(LOCK);
        match lock.try_lock() {
            Ok(()) => (),
            Err(TryLockError::WouldBlock) => return Err(FolderError::InUse(path.to_owned())),
            Err(TryLockError::Error(error)) => return Err(FolderError::io("lock", &at)(error)),
        }
        // A lock on a file that was removed would keep nobody out.
        if !directory.holds(LOCK, &lock).map_err(FolderError::io("lock", &at))? {
            return Ok(None);
        }
        // Somebody else's file of that name is not ours to remove.
        if lock.metadata().map_err(FolderError::io("lock", &at))?.len() > 0 {
            return Err(FolderError::Foreign { path: path.to_owned(), found: LOCK.to_owned() });
        }
        let mut folder = Self { directory, last: None, _lock: lock };
        // Only now does nobody else change it.
        for entry in folder.entries()? {
            folder.directory.open_file(&entry.name())?;
        }
        folder.last = folder.numbers()?.first().copied();
        Ok(Some(folder))
    }

    /// The run's files but for the lock.
    fn entries(&self) -> Result<Vec<RunFile>, FolderError> {
        let names = self.directory.names().map_err(FolderError::io("list", self.path()))?;
        Ok(names.iter().filter_map(|name| RunFile::of(name.to_str())).collect())
    }

    /// The numbers of all checkpoints, newest first.
    fn numbers(&self) -> Result<Vec<u64>, FolderError> {
        let number = |entry| match entry {
            RunFile::Checkpoint(number) => Some(number),
            RunFile::Partial(_) => None,
        };
        let mut numbers: Vec<u64> = self.entries()?.into_iter().filter_map(number).collect();
        numbers.sort_unstable_by(|a, b| b.cmp(a));
        Ok(numbers)
    }

    /// Removes those of the run's files that `which` chooses.
    fn clear(&self, which: impl Fn(RunFile) -> bool) -> Result<(), FolderError> {
        for entry in self.entries()?.into_iter().filter(|entry| which(*entry)) {
            self.remove_file(&entry.name())?;
        }
        Ok(())
    }

    /// Removes a file, unless somebody else did.
    fn remove_file(&self, name: &str) -> Result<(), FolderError> {
        match self.directory.remove(name) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(FolderError::io("remove", &self.path().join(name))(error))
            }
            _ => Ok(()),
        }
    }
}

/// Makes a folder unless something has its name.
fn make(path: &Path) -> Result<(), FolderError> {
    match Directory::make(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(()),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Err(FolderError::NoFolder { path: path.to_owned(), folder: folder_of(path).to_owned() })
        }
        result => result.map_err(FolderError::io("make", path)),
    }
}

/// A file of a run, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum RunFile {
    /// `checkpoint-12`
    Checkpoint(u64),
    /// `checkpoint-12.partial`
    Partial(u64),
}

impl RunFile {
    fn of(name: Option<&str>) -> Option<Self> {
        let number = name?.strip_prefix(CHECKPOINT)?;
        let entry = match number.strip_suffix(PARTIAL) {
            Some(number) => Self::Partial(number.parse().ok()?),
            None => Self::Checkpoint(number.parse().ok()?),
        };
        // Numbers have one spelling: `checkpoint-007` is somebody else's.
        (Some(entry.name().as_str()) == name).then_some(entry)
    }

    fn name(self) -> String {
        match self {
            Self::Checkpoint(number) => format!("{CHECKPOINT}{number}"),
            Self::Partial(number) => format!("{CHECKPOINT}{number}{PARTIAL}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;
    use crate::format::numbers::NumberSink;

    /// A place for a run, and the folder around it.
    fn place() -> (TempDir, PathBuf) {
        let around = tempfile::tempdir().unwrap();
        let path = around.path().join("run");
        (around, path)
    }

    fn create(path: &Path) -> Result<RunFolder, FolderError> {
        RunFolder::create(path, Existing::Keep)
    }

    /// A folder that a run left behind with these checkpoints, however many they are.
    fn left(path: &Path, numbers: &[u64]) {
        drop(create(path).unwrap());
        for number in numbers {
            let mut file = File::create(path.join(format!("checkpoint-{number}"))).unwrap();
            let array = &|_: usize, sink: &mut dyn NumberSink| sink.put(&[*number as f32]);
            checkpoint::write(&mut file, &number.to_string(), &[1], array).unwrap();
        }
    }

    fn save(folder: &mut RunFolder, number: u64) -> Result<(), FolderError> {
        let array = |_: usize, sink: &mut dyn NumberSink| sink.put(&[number as f32]);
        folder.save(number, &number.to_string(), &[1], &array)
    }

    fn newest(path: &Path) -> Result<Loaded<String>, FolderError> {
        read_newest(&mut RunFolder::open(path)?)
    }

    /// The newest checkpoint, which must have what [`save`] puts there, both times it is read.
    fn read_newest(folder: &mut RunFolder) -> Result<Loaded<String>, FolderError> {
        let mut seen = Vec::new();
        let mut loaded = folder.newest::<String>(&mut |number, array, piece| {
            seen.push((number, array, piece.to_vec()));
        })?;
        assert_eq!(loaded.head, loaded.number.to_string());
        let number = loaded.number;
        let expected = (number, 0, vec![number as f32]);
        assert_eq!(seen.last(), Some(&expected));
        assert_eq!(loaded.arrays.lengths(), [1]);
        for _ in 0..2 {
            let mut again = Vec::new();
            loaded.arrays.read(&mut |array, piece| again.push((number, array, piece.to_vec())))?;
            assert_eq!(again, std::slice::from_ref(&expected));
        }
        Ok(loaded)
    }

    fn damage(path: &Path) {
        let mut bytes = fs::read(path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(path, bytes).unwrap();
    }

    fn names(path: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(path)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_run_goes_on_from_where_it_was_and_leaves_nothing() {
        let (around, path) = place();
        let mut folder = create(&path).unwrap();
        assert_eq!(names(&path), [LOCK]);
        for number in [0, 7, 9, 10, 100] {
            save(&mut folder, number).unwrap();
        }
        // By number, not by name; and only the last two.
        assert_eq!(names(&path), ["checkpoint-10", "checkpoint-100", LOCK]);
        drop(folder);
        let mut folder = RunFolder::open(&path).unwrap();
        let loaded = read_newest(&mut folder).unwrap();
        assert_eq!((loaded.number, loaded.head.as_str()), (100, "100"));
        assert!(loaded.damaged.is_empty());
        save(&mut folder, 101).unwrap();
        assert_eq!(names(&path), ["checkpoint-100", "checkpoint-101", LOCK]);
        folder.remove().unwrap();
        assert!(names(around.path()).is_empty());
    }

    #[test]
    fn a_folder_has_one_run() {
        let (_around, path) = place();
        let folder = create(&path).unwrap();
        for existing in [Existing::Keep, Existing::Replace] {
            let error = RunFolder::create(&path, existing).unwrap_err();
            assert!(matches!(&error, FolderError::InUse { .. }), "{error}");
            assert!(error.to_string().contains(&path.display().to_string()));
        }
        assert!(matches!(RunFolder::open(&path), Err(FolderError::InUse { .. })));
        drop(folder);
        drop(create(&path).unwrap());
        drop(RunFolder::open(&path).unwrap());
    }

    #[test]
    fn a_folder_is_checked_without_a_trace() {
        let (around, path) = place();
        let probe = |path: &Path| RunFolder::probe(path, Existing::Keep);
        for spelling in ["run", "run/", "run/.", "./run"] {
            probe(&around.path().join(spelling)).unwrap();
            assert!(names(around.path()).is_empty());
        }
        fs::create_dir(&path).unwrap();
        probe(&path).unwrap();
        assert!(names(&path).is_empty());
        // The lock of a run that is over was there before, and so were files of others.
        left(&path, &[]);
        fs::write(path.join("notes"), "mine").unwrap();
        probe(&path).unwrap();
        assert_eq!(names(&path), [LOCK, "notes"]);
        fs::remove_file(path.join(LOCK)).unwrap();
        assert!(matches!(probe(&path), Err(FolderError::Foreign { .. })));
        assert_eq!(names(&path), ["notes"]);
        fs::remove_file(path.join("notes")).unwrap();

        left(&path, &[5]);
        for lock in [true, false] {
            if !lock {
                fs::remove_file(path.join(LOCK)).unwrap();
            }
            let before = names(&path);
            let error = probe(&path).unwrap_err();
            assert!(matches!(error, FolderError::Unfinished { number: 5, .. }), "{error}");
            RunFolder::probe(&path, Existing::Replace).unwrap();
            assert_eq!(names(&path), before);
        }
        let mut folder = RunFolder::open(&path).unwrap();
        assert!(matches!(probe(&path), Err(FolderError::InUse { .. })));
        save(&mut folder, 6).unwrap();
        assert_eq!(names(&path), ["checkpoint-5", "checkpoint-6", LOCK]);
        assert!(matches!(probe(&around.path().join("no/run")), Err(FolderError::NoFolder { .. })));
        assert!(matches!(probe(Path::new("")), Err(FolderError::NoName)));
        assert_eq!(names(around.path()), ["run"]);
    }

    #[cfg(unix)]
    #[test]
    fn racing_runs_never_share_a_folder() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let (_around, path) = place();
        let (holders, taken) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for turn in 0..1000 {
                        match RunFolder::create(&path, Existing::Replace) {
                            Ok(folder) => {
                                assert_eq!(holders.fetch_add(1, Ordering::SeqCst), 0);
                                taken.fetch_add(1, Ordering::SeqCst);
                                // Long enough for somebody to come by.
                                std::thread::sleep(std::time::Duration::from_micros(20));
                                holders.fetch_sub(1, Ordering::SeqCst);
                                if turn % 3 > 0 {
                                    folder.remove().unwrap();
                                }
                            }
                            Err(FolderError::InUse { .. }) => std::thread::yield_now(),
                            Err(error) => panic!("{error}"),
                        }
                    }
                });
            }
        });
        assert!(taken.into_inner() > 0);
    }

    #[cfg(unix)]
    #[test]
    fn a_lock_that_was_removed_keeps_nobody_out() {
        let (_around, path) = place();
        left(&path, &[]);
        let directory = Directory::open(&path).unwrap();
        let lock = directory.open_lock(LOCK).unwrap();
        assert!(directory.holds(LOCK, &lock).unwrap());
        fs::remove_file(path.join(LOCK)).unwrap();
        assert!(!directory.holds(LOCK, &lock).unwrap());
        let other = directory.open_lock(LOCK).unwrap();
        assert!(!directory.holds(LOCK, &lock).unwrap());
        assert!(directory.holds(LOCK, &other).unwrap());
    }

    #[test]
    fn an_unfinished_run_is_given_up_only_on_request() {
        let (_around, path) = place();
        left(&path, &[5, 6]);
        fs::write(path.join("checkpoint-7.partial"), "half").unwrap();
        fs::write(path.join("notes"), "mine").unwrap();
        let error = create(&path).unwrap_err();
        assert!(matches!(error, FolderError::Unfinished { number: 6, .. }), "{error}");
        assert!(error.to_string().contains("--force"));
        assert_eq!(newest(&path).unwrap().number, 6);
        let mut folder = RunFolder::create(&path, Existing::Replace).unwrap();
        assert_eq!(names(&path), [LOCK, "notes"]);
        save(&mut folder, 1).unwrap();
        folder.remove().unwrap();
        assert_eq!(names(&path), ["notes"]);
    }

    #[test]
    fn folders_of_other_things_are_left_alone() {
        let (around, path) = place();
        let at = |name: &str| around.path().join(name);
        fs::create_dir(&path).unwrap();
        for name in ["tile.npy", "checkpoint-", "checkpoint-007", "checkpoint-+1", "checkpoint-1.x"]
        {
            fs::write(path.join(name), "").unwrap();
            for result in [RunFolder::create(&path, Existing::Replace), RunFolder::open(&path)] {
                let error = result.unwrap_err();
                assert!(matches!(&error, FolderError::Foreign { .. }), "{error}");
                assert!(error.to_string().contains(name));
            }
            assert_eq!(names(&path), [name]);
            fs::remove_file(path.join(name)).unwrap();
        }
        // Somebody's own lock.
        fs::write(path.join(LOCK), "1234").unwrap();
        assert!(matches!(create(&path), Err(FolderError::Foreign { .. })));
        fs::remove_file(path.join(LOCK)).unwrap();

        fs::write(at("file"), "").unwrap();
        assert!(matches!(create(&at("file")), Err(FolderError::NotFolder { .. })));
        assert!(matches!(create(&at("file/run")), Err(FolderError::NoFolder { .. })));
        assert!(matches!(create(&at("no/run")), Err(FolderError::NoFolder { .. })));
        assert!(matches!(create(Path::new("")), Err(FolderError::NoName)));
        assert!(matches!(create(Path::new("a\0b")), Err(FolderError::Io { .. })));
        assert!(matches!(RunFolder::open(&at("no")), Err(FolderError::NoRun { .. })));
        assert!(matches!(RunFolder::open(&path), Err(FolderError::NoRun { .. })));
        assert!(names(&path).is_empty());
        // An empty one is as good as a new one.
        create(&path).unwrap().remove().unwrap();
        assert_eq!(names(around.path()), ["file"]);
    }

    #[test]
    fn checkpoints_that_were_copied_without_their_lock_are_a_run() {
        let (_around, path) = place();
        left(&path, &[3]);
        fs::remove_file(path.join(LOCK)).unwrap();
        assert_eq!(newest(&path).unwrap().number, 3);
    }

    #[test]
    fn what_is_damaged_is_named_and_the_one_before_is_used() {
        let (_around, path) = place();
        left(&path, &[8, 9, 10, 11]);
        damage(&path.join("checkpoint-11"));
        fs::write(path.join("checkpoint-10"), "").unwrap();
        let mut folder = RunFolder::open(&path).unwrap();
        let loaded = read_newest(&mut folder).unwrap();
        assert_eq!(loaded.number, 9);
        let paths: Vec<_> = loaded.damaged.iter().map(|(path, _)| path.clone()).collect();
        assert_eq!(paths, [path.join("checkpoint-11"), path.join("checkpoint-10")]);
        assert!(matches!(loaded.damaged[0].1, CheckpointError::Checksum { .. }));
        assert!(matches!(loaded.damaged[1].1, CheckpointError::CutShort { found: 0, .. }));
        // The damaged ones neither stand in the way nor count as kept.
        let refused = save(&mut folder, 9).unwrap_err();
        assert!(matches!(refused, FolderError::Number { number: 9, last: 9, .. }));
        save(&mut folder, 10).unwrap();
        assert_eq!(names(&path), ["checkpoint-10", "checkpoint-9", LOCK]);
        drop(folder);
        assert_eq!(newest(&path).unwrap().number, 10);
    }

    #[test]
    fn a_checkpoint_that_changed_since_it_was_looked_at_is_not_gone_on_from() {
        let (_around, path) = place();
        left(&path, &[4, 5]);
        let name = path.join("checkpoint-5");
        let mut folder = RunFolder::open(&path).unwrap();
        let mut loaded = read_newest(&mut folder).unwrap();
        let mut read = || {
            let mut last = None;
            let result = loaded.arrays.read(&mut |_, piece| last = piece.last().copied());
            result.map(|()| last)
        };
        // One that is as good, but another.
        let good = fs::read(&name).unwrap();
        fs::write(&name, fs::read(path.join("checkpoint-4")).unwrap()).unwrap();
        let error = read().unwrap_err();
        assert!(matches!(error, FolderError::Changed { .. }));
        assert!(error.to_string().contains(&name.display().to_string()), "{error}");
        fs::write(&name, &good[..good.len() - 1]).unwrap();
        let error = read().unwrap_err();
        assert!(error.to_string().contains("cut short"), "{error}");
        fs::write(&name, &good).unwrap();
        assert_eq!(read().unwrap(), Some(5.0));
        // Another under its name is not the one that was looked at.
        #[cfg(unix)]
        {
            fs::rename(path.join("checkpoint-4"), &name).unwrap();
            assert_eq!(read().unwrap(), Some(5.0));
        }
    }

    #[test]
    fn if_all_are_damaged_each_is_named() {
        let (_around, path) = place();
        left(&path, &[1, 2]);
        damage(&path.join("checkpoint-1"));
        File::options()
            .append(true)
            .open(path.join("checkpoint-2"))
            .unwrap()
            .write_all(b"x")
            .unwrap();
        let error = newest(&path).unwrap_err();
        assert!(matches!(&error, FolderError::Damaged { damaged, .. } if damaged.len() == 2));
        let text = error.to_string();
        for part in ["checkpoint-2: too long", "checkpoint-1: the checksum", "that can be used"] {
            assert!(text.contains(part), "{text}");
        }
        // It is still a run that nobody gave up.
        assert!(matches!(create(&path), Err(FolderError::Unfinished { .. })));
    }

    #[test]
    fn what_is_partial_is_no_checkpoint() {
        let (_around, path) = place();
        left(&path, &[3]);
        fs::rename(path.join("checkpoint-3"), path.join("checkpoint-3.partial")).unwrap();
        assert!(matches!(newest(&path), Err(FolderError::NoRun { .. })));
        let mut folder = create(&path).unwrap();
        fs::write(path.join("checkpoint-4.partial"), "half").unwrap();
        fs::write(path.join("checkpoint-9.partial"), "half").unwrap();
        save(&mut folder, 4).unwrap();
        assert_eq!(names(&path), ["checkpoint-4", LOCK]);
    }

    #[test]
    fn a_failure_leaves_the_older_checkpoints_and_no_other_file() {
        let (_around, path) = place();
        let mut folder = create(&path).unwrap();
        for number in [1, 2] {
            save(&mut folder, number).unwrap();
        }
        let before = names(&path);
        let full = &|_: usize, sink: &mut dyn NumberSink| {
            sink.put(&[0.0; 25_000])?;
            Err(ErrorKind::StorageFull.into())
        };
        let error = folder.save(3, &"3", &[25_000], full).unwrap_err();
        let path_of_it = path.join("checkpoint-3").display().to_string();
        assert!(error.to_string().contains(&path_of_it), "{error}");
        assert!(matches!(error, FolderError::Io { action: "write", .. }));
        assert_eq!(names(&path), before);
        // A head that cannot be encoded.
        let none = &|_: usize, _: &mut dyn NumberSink| Ok(());
        let endless = folder.save(3, &Endless, &[], none).unwrap_err();
        assert!(endless.to_string().contains("cannot be encoded"), "{endless}");
        // Arrays that are shorter than they should be, and one that cannot be had.
        let three = &|_: usize, sink: &mut dyn NumberSink| sink.put(&[3.0]);
        let short = folder.save(3, &"3", &[2], three).unwrap_err();
        assert!(short.to_string().contains("1 numbers instead of 2"), "{short}");
        let gone = &|_: usize, _: &mut dyn NumberSink| Err(io::Error::other("nobody has it"));
        let gone = folder.save(3, &"3", &[2], gone).unwrap_err();
        assert!(gone.to_string().contains("nobody has it"), "{gone}");
        for number in [0, 1, 2] {
            let error = save(&mut folder, number).unwrap_err();
            assert!(matches!(error, FolderError::Number { last: 2, .. }), "{error}");
        }
        assert_eq!(names(&path), before);
        save(&mut folder, 3).unwrap();
        assert_eq!(names(&path), ["checkpoint-2", "checkpoint-3", LOCK]);
    }

    /// A value that cannot be written.
    struct Endless;

    impl Serialize for Endless {
        fn serialize<S: serde::Serializer>(&self, _: S) -> Result<S::Ok, S::Error> {
            Err(serde::ser::Error::custom("it has no end"))
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_vanished_is_an_error_with_its_path() {
        let (_around, path) = place();
        let mut folder = create(&path).unwrap();
        save(&mut folder, 1).unwrap();
        fs::remove_dir_all(&path).unwrap();
        let error = save(&mut folder, 2).unwrap_err();
        assert!(matches!(error, FolderError::Io { .. }));
        assert!(error.to_string().contains(&path.display().to_string()), "{error}");
        assert!(!path.exists());
    }

    #[cfg(unix)]
    #[test]
    fn links_are_refused_wherever_they_are() {
        use std::os::unix::fs::symlink;
        let (around, path) = place();
        let at = |name: &str| around.path().join(name);
        left(&path, &[1]);
        symlink(&path, at("link")).unwrap();
        symlink(at("nowhere"), at("dangling")).unwrap();
        for name in ["link", "link/", "link/.", "link//", "dangling"] {
            for result in [create(&at(name)), RunFolder::open(&at(name))] {
                let error = result.unwrap_err();
                assert!(matches!(&error, FolderError::NotFolder { .. }), "{name}: {error}");
            }
        }
        assert!(!at("nowhere").exists());
        fs::rename(path.join("checkpoint-1"), at("real")).unwrap();
        fs::rename(path.join(LOCK), at("other")).unwrap();
        for (name, target) in [
            ("checkpoint-1", "real"),
            ("checkpoint-2", "nowhere"),
            ("lock", "other"),
            ("lock", "new"),
        ] {
            symlink(at(target), path.join(name)).unwrap();
            for result in [RunFolder::create(&path, Existing::Replace), RunFolder::open(&path)] {
                let error = result.unwrap_err();
                assert!(matches!(&error, FolderError::NotFile { .. }), "{name}: {error}");
                assert!(error.to_string().contains(&path.join(name).display().to_string()));
            }
            fs::remove_file(path.join(name)).unwrap();
            // Made on the way to the checkpoint.
            let _ = fs::remove_file(path.join(LOCK));
        }
        assert!(!at("nowhere").exists() && !at("new").exists());
        // One that comes later.
        left(&path, &[]);
        let mut folder = RunFolder::open(&path).unwrap();
        symlink(at("real"), path.join("checkpoint-1")).unwrap();
        assert!(matches!(read_newest(&mut folder), Err(FolderError::NotFile { .. })));
        symlink(at("real"), path.join("checkpoint-2.partial")).unwrap();
        save(&mut folder, 2).unwrap();
        assert!(fs::symlink_metadata(path.join("checkpoint-2")).unwrap().is_file());
        let mut real = File::open(at("real")).unwrap();
        let len = real.metadata().unwrap().len();
        let (untouched, _) = checkpoint::read_head::<String>(&mut real, len).unwrap();
        assert_eq!(untouched, "1");
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_refused_and_not_waited_for() {
        use std::os::unix::net::UnixListener;
        for name in ["checkpoint-1", "checkpoint-1.partial", LOCK] {
            let (_around, path) = place();
            let refused = || {
                let error = RunFolder::create(&path, Existing::Replace).unwrap_err();
                assert!(matches!(&error, FolderError::NotFile { .. }), "{name}: {error}");
            };
            fs::create_dir(&path).unwrap();
            fs::create_dir(path.join(name)).unwrap();
            refused();
            fs::remove_dir(path.join(name)).unwrap();
            let _socket = UnixListener::bind(path.join(name)).unwrap();
            refused();
            fs::remove_file(path.join(name)).unwrap();
            #[cfg(target_os = "linux")]
            {
                use rustix::fs::{CWD, FileType, Mode, mknodat};
                mknodat(CWD, path.join(name), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
                refused();
            }
        }
    }

    #[cfg(unix)]
    #[test]
    fn nobody_else_reads_it_or_may_write_in_it() {
        use std::os::unix::fs::PermissionsExt;
        let (_around, path) = place();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o7777;
        let mut folder = create(&path).unwrap();
        save(&mut folder, 1).unwrap();
        assert_eq!(mode(&path), 0o700);
        assert_eq!(mode(&path.join(LOCK)), 0o600);
        assert_eq!(mode(&path.join("checkpoint-1")), 0o600);
        drop(folder);
        for (bits, fit) in [(0o755, true), (0o775, false), (0o702, false), (0o1777, false)] {
            fs::set_permissions(&path, fs::Permissions::from_mode(bits)).unwrap();
            match RunFolder::open(&path) {
                Ok(_) => assert!(fit, "{bits:o}"),
                Err(error) => {
                    assert!(matches!(&error, FolderError::Writable { .. }), "{error}");
                    assert!(error.to_string().contains(&format!("{bits:04o}")), "{error}");
                    assert!(!fit, "{bits:o}");
                }
            }
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_belongs_to_others_is_refused() {
        use std::os::unix::fs::chown;
        let (_around, path) = place();
        left(&path, &[1]);
        for name in [".", LOCK, "checkpoint-1"] {
            // Only root can give files away.
            if chown(path.join(name), Some(12_345), None).is_err() {
                return;
            }
            let error = RunFolder::open(&path).unwrap_err();
            assert!(matches!(error, FolderError::Owner { owner: 12_345, .. }), "{name}: {error}");
            chown(path.join(name), Some(rustix::process::geteuid().as_raw()), None).unwrap();
        }
        assert_eq!(newest(&path).unwrap().number, 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn names_say_what_they_are(number in any::<u64>(), noise in "(checkpoint-)?[0-9+.]{0,21}(.partial)?") {
            for entry in [RunFile::Checkpoint(number), RunFile::Partial(number)] {
                prop_assert_eq!(RunFile::of(Some(&entry.name())), Some(entry));
            }
            if let Some(entry) = RunFile::of(Some(&noise)) {
                prop_assert_eq!(entry.name(), noise);
            }
        }

        /// Whatever happens to the files, a run goes on from the newest good one, and after the
        /// next checkpoint all is well again.
        #[test]
        fn a_run_goes_on_from_the_newest_good_one(
            files in prop::collection::btree_map(0_u64..50, (any::<bool>(), any::<bool>()), 0..5),
            step in 1_u64..5,
        ) {
            let (_around, path) = place();
            let numbers: Vec<u64> = files.keys().copied().collect();
            left(&path, &numbers);
            for (number, (damaged, partial)) in &files {
                if *damaged {
                    damage(&path.join(format!("checkpoint-{number}")));
                }
                if *partial {
                    fs::write(path.join(format!("checkpoint-{}.partial", number + 1)), "").unwrap();
                }
            }
            let good: Vec<u64> =
                files.iter().filter(|(_, (damaged, _))| !damaged).map(|(n, _)| *n).collect();
            let mut folder = RunFolder::open(&path).unwrap();
            match (good.last(), read_newest(&mut folder)) {
                (Some(expected), Ok(loaded)) => {
                    prop_assert_eq!(loaded.number, *expected);
                    let newer = numbers.iter().filter(|number| *number > expected).count();
                    prop_assert_eq!(loaded.damaged.len(), newer);
                    save(&mut folder, expected + step).unwrap();
                    drop(folder);
                    let loaded = newest(&path).unwrap();
                    prop_assert_eq!(loaded.number, expected + step);
                    prop_assert!(loaded.damaged.is_empty());
                    prop_assert!(names(&path).len() <= KEPT + 1);
                }
                (None, Err(FolderError::Damaged { damaged, .. })) => {
                    prop_assert_eq!(damaged.len(), numbers.len());
                }
                (None, Err(FolderError::NoRun { .. })) => prop_assert!(numbers.is_empty()),
                (expected, found) => prop_assert!(false, "{:?} {:?}", expected, found),
            }
        }
    }
}
