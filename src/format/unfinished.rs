//! What must not outlive the process: temporary files and folders, and locks.
//!
//! Usually whoever makes one removes it, or gives it its lasting name. Where the process ends at
//! once, as after a second Ctrl-C, nobody gets to that, so all are known here and [`remove_all`]
//! removes them.

use std::collections::BTreeMap;
use std::fs;
use std::mem;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// All of this process.
static ALL: Registry = Registry(Mutex::new(Paths { next: 0, paths: BTreeMap::new() }));

/// Paths that must not outlive the process. It is locked while a file is made, takes its lasting
/// name or is removed for good, so that none is removed that is already another's.
#[derive(Debug)]
struct Registry(Mutex<Paths>);

#[derive(Debug)]
struct Paths {
    next: u64,
    paths: BTreeMap<u64, PathBuf>,
}

impl Registry {
    fn lock(&self) -> MutexGuard<'_, Paths> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn make<T, E>(
        &'static self,
        make: impl FnOnce() -> Result<(T, PathBuf), E>,
    ) -> Result<(T, Unfinished), E> {
        let mut known = self.lock();
        let (made, path) = make()?;
        let key = known.next;
        known.next += 1;
        known.paths.insert(key, path);
        Ok((made, Unfinished { registry: self, key }))
    }

    fn remove_all(&self) {
        let known = self.lock();
        for path in known.paths.values() {
            // A folder, if it is no file. Of a link only the link goes.
            let _ = fs::remove_file(path).or_else(|_| fs::remove_dir_all(path));
        }
        // It stays locked, so that nothing more is made or finished.
        mem::forget(known);
    }
}

/// A file or folder that must not outlive the process, until this is dropped or completed.
#[derive(Debug)]
pub struct Unfinished {
    registry: &'static Registry,
    key: u64,
}

impl Unfinished {
    /// Makes a file or folder that is to be removed should the process end at once. `make` also
    /// returns its path. It must not make or complete another.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn make<T, E>(make: impl FnOnce() -> Result<(T, PathBuf), E>) -> Result<(T, Self), E> {
        ALL.make(make)
    }

    /// Does the last thing to the file or folder under its path, such as giving it its lasting
    /// name; then the path is free. [`remove_all`] comes before all of that or after it. `last`
    /// must not make or complete another.
    ///
    /// # Errors
    /// Those of `last`. Then it stays unfinished.
    pub fn complete<T, E>(&mut self, last: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let mut known = self.registry.lock();
        let done = last()?;
        known.paths.remove(&self.key);
        Ok(done)
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        self.registry.lock().paths.remove(&self.key);
    }
}

/// Removes all that is unfinished, because the process is about to end. Whoever makes or finishes
/// something afterwards waits for that end.
pub fn remove_all() {
    ALL.remove_all();
}

/// Whether a path is registered.
#[cfg(test)]
pub(crate) fn is_registered(path: &std::path::Path) -> bool {
    ALL.lock().paths.values().any(|known| known == path)
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::fs::File;
    use std::io;
    use std::path::Path;
    use std::sync::mpsc;
    use std::thread;
    use std::time::Duration;

    use super::*;

    /// A registry of its own: other tests have unfinished files, too.
    fn registry() -> &'static Registry {
        Box::leak(Box::new(Registry(Mutex::new(Paths { next: 0, paths: BTreeMap::new() }))))
    }

    fn file(registry: &'static Registry, path: &Path) -> Unfinished {
        let make = || File::create_new(path).map(|_| ((), path.to_owned()));
        registry.make(make).unwrap().1
    }

    #[test]
    fn what_is_unfinished_goes_and_the_rest_stays() {
        let room = tempfile::tempdir().unwrap();
        let at = |name: &str| room.path().join(name);
        let registry = registry();
        let _one = file(registry, &at("one"));
        let make = || fs::create_dir_all(at("deep/er")).map(|()| ((), at("deep")));
        let (_, _deep) = registry.make(make).unwrap();
        fs::write(at("deep/er/file"), "").unwrap();
        // This one gets its name.
        let mut named = file(registry, &at("temporary"));
        named.complete(|| fs::rename(at("temporary"), at("named"))).unwrap();
        // The path is somebody else's then, as that of one that is dropped.
        fs::write(at("temporary"), "theirs").unwrap();
        drop(file(registry, &at("dropped")));
        // What cannot be completed is still unfinished, and what was not made never was.
        let mut failed = file(registry, &at("failed"));
        assert!(failed.complete(|| fs::rename(at("failed"), at("no/failed"))).is_err());
        fs::write(at("kept"), "").unwrap();
        let none = registry.make(|| Err::<((), PathBuf), _>(io::Error::other("none")));
        assert!(none.is_err());
        // It need not be there any more.
        let _gone = file(registry, &at("gone"));
        fs::remove_file(at("gone")).unwrap();
        #[cfg(unix)]
        {
            let link = || std::os::unix::fs::symlink(at("kept"), at("link"));
            let (_, link) = registry.make(|| link().map(|()| ((), at("link")))).unwrap();
            mem::forget(link);
        }
        // Dropping any would wait for the end of the process.
        mem::forget((_one, _deep, named, failed, _gone));
        registry.remove_all();
        let names = fs::read_dir(room.path()).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = names.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        assert_eq!(names, ["dropped", "kept", "named", "temporary"]);
    }

    #[test]
    fn a_path_that_two_have_is_known_until_the_last_is_dropped() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("file");
        let registry = registry();
        let first = file(registry, &path);
        fs::remove_file(&path).unwrap();
        mem::forget(file(registry, &path));
        drop(first);
        registry.remove_all();
        assert!(!path.exists());
    }

    #[test]
    fn nothing_is_made_or_finished_once_all_is_removed() {
        let registry = registry();
        let make = || Ok::<_, Infallible>(((), PathBuf::from("nowhere/at-all")));
        let (_, mut earlier) = registry.make(make).unwrap();
        registry.remove_all();
        let (sender, receiver) = mpsc::channel();
        let made = sender.clone();
        thread::spawn(move || {
            let _ = registry.make(|| {
                made.send("made").unwrap();
                make()
            });
        });
        thread::spawn(move || {
            let _ = earlier.complete(|| {
                sender.send("finished").unwrap();
                Ok::<_, Infallible>(())
            });
        });
        // Both would be quick.
        assert!(receiver.recv_timeout(Duration::from_millis(200)).is_err());
    }
}
