//! Where the memory that workers share lies: a file without a name.

use std::fs::File;
use std::path::Path;

use super::error::ProcessError;

/// Where shared memory is fastest.
const FASTEST: &str = "/dev/shm";

/// A file without a name for so many bytes of shared memory, and its folder: where it is fastest, or
/// else `folder`.
///
/// # Errors
/// A folder in which no file can be made.
pub fn memory_file(bytes: u64, folder: &Path) -> Result<(File, &Path), ProcessError> {
    let room = |path: &str| {
        let system = rustix::fs::statvfs(path).ok()?;
        system.f_bavail.checked_mul(system.f_frsize)
    };
    let fits = room(FASTEST).is_some_and(|free| free > bytes.saturating_add(1 << 20));
    let folder = if fits { Path::new(FASTEST) } else { folder };
    match tempfile::tempfile_in(folder) {
        Ok(file) => Ok((file, folder)),
        Err(error) => Err(ProcessError::Memory { folder: folder.to_owned(), error }),
    }
}
