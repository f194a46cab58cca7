//! Which file a name means, and whether it is as it was.

use std::fs::Metadata;
use std::io;
use std::os::unix::fs::MetadataExt;
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
        Ok(Self::from(&std::fs::metadata(path)?))
    }
}

impl From<&Metadata> for FileId {
    fn from(metadata: &Metadata) -> Self {
        Self { device: metadata.dev(), inode: metadata.ino() }
    }
}

/// What changes whenever the content of a file does: its inode and length, and when content and inode were last written. Nobody can set
/// the last of these.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FileState {
    inode: u64,
    bytes: u64,
    modified_ns: [i64; 2],
    changed_ns: [i64; 2],
}

impl FileState {
    /// The state of the file that `path` leads to; none where there is none.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = std::fs::metadata(path).ok()?;
        Some(Self {
            inode: metadata.ino(),
            bytes: metadata.len(),
            modified_ns: [metadata.mtime(), metadata.mtime_nsec()],
            changed_ns: [metadata.ctime(), metadata.ctime_nsec()],
        })
    }
}

#[cfg(test)]
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
