//! Files that appear whole or not at all.

use crate::ImageError;
use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Writes a file so that `path` holds the old content or all of the new, never a part of it.
///
/// `write` fills a temporary file in the same directory (suffix `.pbgi.tmp`), which is synced to
/// disk and then renamed to `path`. On any error the temporary file is removed and `path` is left
/// as it was. A `path` that exists and is no regular file (a device, a pipe) is written in place.
///
/// # Errors
///
/// [`ImageError::Io`] with the step that failed, among them any error `write` returns.
pub fn write_atomically<T>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>,
) -> Result<T, ImageError> {
    if std::fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        return write_in_place(path, write);
    }
    let (file, temporary) =
        create_beside(path).map_err(|e| ImageError::io(path, "create a file beside", e))?;
    let result =
        fill(file, write).map_err(|e| ImageError::io(path, "write", e)).and_then(|value| {
            std::fs::rename(&temporary, path)
                .map_err(|e| ImageError::io(path, "rename to", e))
                .map(|()| value)
        });
    if result.is_err() {
        // The first error is the one to report; a temporary file that stays is only litter.
        let _ = std::fs::remove_file(&temporary);
    } else {
        sync_directory(path);
    }
    result
}

fn write_in_place<T>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>,
) -> Result<T, ImageError> {
    let file = OpenOptions::new()
        .write(true)
        .open(path)
        .map_err(|e| ImageError::io(path, "open for writing", e))?;
    let mut writer = BufWriter::new(file);
    write(&mut writer)
        .and_then(|value| writer.flush().map(|()| value))
        .map_err(|e| ImageError::io(path, "write", e))
}

/// Runs `write` on the file, then flushes and syncs it; the file is closed on return.
fn fill<T>(file: File, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> io::Result<T> {
    let mut writer = BufWriter::with_capacity(1 << 18, file);
    let value = write(&mut writer)?;
    writer.flush()?;
    writer.get_ref().sync_all()?;
    Ok(value)
}

/// A new file in the directory of `path` under a name nobody else uses.
fn create_beside(path: &Path) -> io::Result<(File, PathBuf)> {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidInput, "the path does not end in a file name")
    })?;
    loop {
        let mut temporary = OsString::from(".");
        temporary.push(name);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        temporary.push(format!(".{}-{number}.pbgi.tmp", std::process::id()));
        let temporary = path.with_file_name(temporary);
        match OpenOptions::new().write(true).create_new(true).open(&temporary) {
            Ok(file) => return Ok((file, temporary)),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
    }
}

/// Makes the rename itself durable where the system allows it; the content already is.
fn sync_directory(path: &Path) {
    let directory = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    if let Ok(directory) = File::open(directory) {
        let _ = directory.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::tempdir;

    fn entries(directory: &Path) -> usize {
        std::fs::read_dir(directory).unwrap().count()
    }

    #[test]
    fn target_appears_whole() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.txt");
        let value = write_atomically(&path, |w| {
            w.write_all(b"whole")?;
            assert!(!path.exists());
            Ok(3)
        });
        assert_eq!(value.unwrap(), 3);
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
        assert_eq!(entries(directory.path()), 1);
    }

    #[test]
    fn failure_keeps_the_old_file_and_leaves_no_litter() {
        let directory = tempdir().unwrap();
        let path = directory.path().join("a.txt");
        std::fs::write(&path, "old").unwrap();
        let result: Result<(), _> = write_atomically(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(result.unwrap_err().to_string().ends_with("a.txt: write failed: disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(entries(directory.path()), 1);
    }

    #[test]
    fn directories_and_missing_parents_are_errors() {
        let directory = tempdir().unwrap();
        assert!(write_atomically(directory.path(), |w| w.write_all(b"x")).is_err());
        assert!(write_atomically(&directory.path().join("no/a"), |w| w.write_all(b"x")).is_err());
        assert!(write_atomically(Path::new("/"), |w| w.write_all(b"x")).is_err());
        assert_eq!(entries(directory.path()), 0);
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_written_in_place() {
        let null = Path::new("/dev/null");
        write_atomically(null, |w| w.write_all(b"x")).unwrap();
        assert!(!std::fs::metadata(null).unwrap().is_file());
    }
}
