//! Files that appear whole or not at all.

use crate::ImageError;
use pbgi_file::AtomicFile;
use std::io;
use std::path::Path;

/// Writes a file so that `path` holds the old content or all of the new, never a part of it.
///
/// `write` fills a temporary file in the same directory, which is synced to disk and then renamed to `path`. On any error it is removed
/// and `path` is left as it was. A `path` that exists and is no regular file (a device, a pipe) is written in place.
///
/// # Errors
///
/// [`ImageError::Io`] with the step that failed, among them any error `write` returns.
pub fn write_atomically<T>(
    path: &Path,
    write: impl FnOnce(&mut AtomicFile) -> io::Result<T>,
) -> Result<T, ImageError> {
    let mut file = AtomicFile::create(path).map_err(|e| ImageError::io(path, "create", e))?;
    let value = write(&mut file).map_err(|e| ImageError::io(path, "write", e))?;
    file.commit().map_err(|e| ImageError::io(path, e.action, e.source))?;
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn failure_keeps_the_old_file_and_leaves_no_litter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        std::fs::write(&path, "old").unwrap();
        let result: Result<(), _> = write_atomically(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(result.unwrap_err().to_string().ends_with("a.txt: write failed: disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(write_atomically(&path, |w| w.write_all(b"new").map(|()| 3)).unwrap(), 3);
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }
}
