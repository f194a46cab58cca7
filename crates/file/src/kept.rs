//! Files that a run keeps for the next one, should it be killed.
//!
//! Their names must be found again, and yet nobody may put a link there beforehand: they have a random part, are made new, and are
//! taken up only if they are regular files of this user with one name.

use crate::platform::{create_private, is_ours_alone, open_unfollowed};
use crate::temporary::is_temporary_name;
use std::ffi::OsString;
use std::fs::File;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};

/// Hexadecimal digits of the random part.
const RANDOM_DIGITS: usize = 16;

/// Where files of one output are kept: `PREFIX-RANDOM.EXTENSION` in a folder.
#[derive(Clone, Debug)]
pub struct KeptFiles {
    folder: PathBuf,
    prefix: OsString,
}

impl KeptFiles {
    /// In `folder`, with names that start with `prefix`, which tells outputs apart.
    #[must_use]
    pub fn new(folder: &Path, prefix: OsString) -> Self {
        Self { folder: folder.to_owned(), prefix }
    }

    /// Path without extension of files that an earlier run has kept; the first in the order of names, should there be several.
    #[must_use]
    pub fn find(&self) -> Option<PathBuf> {
        let complete = self.entries().filter(|e| !e.is_temporary && open_kept(&e.path).is_ok());
        complete.map(|entry| entry.stem).min()
    }

    /// Path without extension for new files, which nobody can foretell.
    #[must_use]
    pub fn new_path(&self) -> PathBuf {
        // Its keys come from the system.
        let random = RandomState::new().build_hasher().finish();
        let mut name = self.prefix.clone();
        name.push(format!("-{random:016x}"));
        self.folder.join(name)
    }

    /// Removes what earlier runs have kept, but not the complete files of `but`. No other run may be working on them.
    ///
    /// # Errors
    ///
    /// If a file of this user is there and cannot be removed.
    pub fn remove(&self, but: Option<&Path>) -> io::Result<()> {
        for Entry { path, stem, is_temporary } in self.entries() {
            let is_ours = std::fs::symlink_metadata(&path).is_ok_and(|found| is_ours_alone(&found));
            if is_ours && (is_temporary || but != Some(stem.as_path())) {
                std::fs::remove_file(&path)?;
            }
        }
        Ok(())
    }

    /// What is called like a kept file, or like one on its way to become one.
    fn entries(&self) -> impl Iterator<Item = Entry> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| {
            let name = entry.file_name();
            let path = self.folder.join(&name);
            let temporary =
                name.as_encoded_bytes().strip_prefix(b".").filter(|_| is_temporary_name(&name));
            let (name, is_temporary) = match temporary.and_then(|name| self.stem_of(name)) {
                Some(stem) => (stem, true),
                None => (self.stem_of(name.as_encoded_bytes())?, false),
            };
            Some(Entry { path, stem: self.folder.join(name), is_temporary })
        })
    }

    /// The part of a kept file's name before its extension.
    fn stem_of(&self, name: &[u8]) -> Option<OsString> {
        let rest = name.strip_prefix(self.prefix.as_encoded_bytes())?.strip_prefix(b"-")?;
        let (digits, rest) = rest.split_at_checked(RANDOM_DIGITS)?;
        let is_kept = digits.iter().all(u8::is_ascii_hexdigit) && rest.starts_with(b".");
        is_kept.then(|| {
            let mut stem = self.prefix.clone();
            stem.push(format!("-{}", digits.escape_ascii()));
            stem
        })
    }
}

/// A file in the folder.
struct Entry {
    path: PathBuf,
    /// Its path without extension.
    stem: PathBuf,
    /// Whether it is not complete.
    is_temporary: bool,
}

/// Makes a new file that can be read and written, in place of one of the same name, which is not followed if it is a link.
///
/// # Errors
///
/// If it cannot be made.
pub fn create_new(path: &Path) -> io::Result<File> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    create_private(path)
}

/// Opens a kept file to be read and written.
///
/// # Errors
///
/// If it is a link, no regular file, has another name, or belongs to another user.
pub fn open_kept(path: &Path) -> io::Result<File> {
    let file = open_unfollowed(path, true)?;
    if is_ours_alone(&file.metadata()?) {
        return Ok(file);
    }
    Err(io::Error::new(io::ErrorKind::PermissionDenied, "it was made by somebody else"))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::temporary::create_beside;

    #[test]
    fn kept_files_are_found_again_and_links_under_their_names_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("victim"), "mine").unwrap();
        std::os::unix::fs::symlink("victim", path(".a-0000000000000000.runs")).unwrap();
        std::fs::hard_link(path("victim"), path(".a-0000000000000001.runs")).unwrap();
        std::fs::write(path(".ab-0000000000000001.runs"), "another's").unwrap();
        let kept = KeptFiles::new(folder.path(), ".a".into());
        assert_eq!(kept.find(), None);
        let stem = kept.new_path();
        assert_ne!(stem, kept.new_path());
        create_new(&stem.with_added_extension("runs")).unwrap();
        create_new(&stem.with_added_extension("state.part")).unwrap();
        let octree = stem.with_added_extension("odd.pbgi");
        create_beside(&octree).unwrap().into_temp_path().keep().unwrap();
        assert_eq!(kept.find(), Some(stem.clone()));
        kept.remove(Some(&stem)).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 6);
        assert_eq!(kept.find(), Some(stem));
        kept.remove(None).unwrap();
        assert_eq!(kept.find(), None);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4);
        assert_eq!(std::fs::read(path("victim")).unwrap(), b"mine");
    }

    #[test]
    fn new_files_are_never_made_through_links() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("victim"), "mine").unwrap();
        std::os::unix::fs::symlink("victim", path("link")).unwrap();
        assert!(open_kept(&path("link")).is_err());
        create_new(&path("link")).unwrap().set_len(0).unwrap();
        assert!(!path("link").is_symlink());
        assert_eq!(std::fs::read(path("victim")).unwrap(), b"mine");
    }
}
