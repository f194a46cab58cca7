//! Which file a name means, and whether it is as it was.

use crate::platform::{identity_of, stamps_of};
use std::io;
use std::path::Path;

/// What tells a file from all others, whatever names lead to it: device and inode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FileId {
    device: u64,
    inode: u64,
}

impl FileId {
    /// The file that `path` leads to, through links.
    ///
    /// # Errors
    ///
    /// If there is none, or the system does not tell.
    pub fn of(path: &Path) -> io::Result<Self> {
        let [device, inode] = identity_of(path)?;
        Ok(Self { device, inode })
    }

    /// Whether two files or folders lie in one file system.
    #[must_use]
    pub fn is_on_disk_of(&self, other: &Self) -> bool {
        self.device == other.device
    }
}

/// What changes whenever the content of a file does: its length, and what the system stamps on it ([`stamps_of`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FileState {
    bytes: u64,
    stamps: [i64; 5],
}

impl FileState {
    /// The state of the file that `path` leads to; none where there is none.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = std::fs::metadata(path).ok()?;
        Some(Self { bytes: metadata.len(), stamps: stamps_of(&metadata) })
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn links_and_other_spellings_are_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("a"), "a").unwrap();
        std::fs::write(path("b"), "a").unwrap();
        std::fs::hard_link(path("a"), path("hard")).unwrap();
        std::os::unix::fs::symlink("a", path("soft")).unwrap();
        let id = |name: &str| FileId::of(&path(name)).unwrap();
        for same in ["hard", "soft", "./a"] {
            assert_eq!(id(same), id("a"), "{same}");
        }
        assert_ne!(id("b"), id("a"));
        assert!(FileId::of(&path("none")).is_err());
    }

    #[test]
    fn a_file_that_was_written_has_another_state() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "red").unwrap();
        let before = FileState::of(&path).unwrap();
        assert_eq!(FileState::of(&path), Some(before));
        let modified = std::fs::metadata(&path).unwrap().modified().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20));
        std::fs::write(&path, "tan").unwrap();
        // The length is the same, and the time of writing is set back.
        std::fs::File::options().write(true).open(&path).unwrap().set_modified(modified).unwrap();
        assert_ne!(FileState::of(&path), Some(before));
    }
}
