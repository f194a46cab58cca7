//! Files that are read.

use crate::platform::{is_pipe, is_socket, open_without_waiting};
use std::fs::{File, FileType};
use std::io::{self, Read};
use std::path::Path;

/// Opens a regular file for reading.
///
/// What a stranger's scene refers to may be a device without end or a pipe that nobody writes to; neither is opened.
///
/// # Errors
///
/// If it is anything else, or cannot be opened.
pub fn open_input(path: &Path) -> io::Result<File> {
    check_regular(std::fs::metadata(path)?.file_type())?;
    // Should it have become a pipe since, it is not waited for.
    let file = open_without_waiting(path)?;
    check_regular(file.metadata()?.file_type())?;
    Ok(file)
}

/// Reads all of a regular file of at most `bytes_max` bytes.
///
/// # Errors
///
/// If it is longer ([`io::ErrorKind::FileTooLarge`]), is no regular file, or cannot be read.
pub fn read_input(path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
    let file = open_input(path)?;
    let length = file.metadata()?.len();
    let too_large = |found: u64| {
        let text = format!("{found} bytes, expected at most {bytes_max}");
        Err(io::Error::new(io::ErrorKind::FileTooLarge, text))
    };
    if length > bytes_max {
        return too_large(length);
    }
    let mut bytes = Vec::with_capacity(length as usize);
    // Files of the system tell no length, and others may grow.
    file.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > bytes_max { too_large(bytes.len() as u64) } else { Ok(bytes) }
}

fn check_regular(found: FileType) -> io::Result<()> {
    if found.is_file() {
        return Ok(());
    }
    let text = format!("it is {}, expected a regular file", kind_name(found));
    Err(io::Error::new(io::ErrorKind::InvalidInput, text))
}

/// What a file is, in words.
#[must_use]
pub fn kind_name(kind: FileType) -> &'static str {
    if kind.is_file() {
        "a regular file"
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_symlink() {
        "a link"
    } else if is_pipe(kind) {
        "a pipe"
    } else if is_socket(kind) {
        "a socket"
    } else {
        "a device"
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use rustix::fs::{CWD, Mode};

    #[test]
    fn only_regular_files_are_opened_and_nothing_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        rustix::fs::mkfifoat(CWD, path("pipe"), Mode::RUSR | Mode::WUSR).unwrap();
        std::fs::write(path("file"), "text").unwrap();
        std::os::unix::fs::symlink("file", path("link")).unwrap();
        for good in ["file", "link"] {
            open_input(&path(good)).unwrap();
        }
        for (bad, kind) in [
            (path("pipe"), "a pipe"),
            (folder.path().into(), "a folder"),
            ("/dev/zero".into(), "a device"),
        ] {
            let error = open_input(&bad).unwrap_err().to_string();
            assert_eq!(error, format!("it is {kind}, expected a regular file"));
        }
    }

    #[test]
    fn longer_files_than_asked_for_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "1234").unwrap();
        assert_eq!(read_input(&path, 4).unwrap(), b"1234");
        let error = read_input(&path, 3).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        // A file without end that states no length.
        assert!(read_input(Path::new("/proc/self/status"), 10).is_err());
    }
}
