//! Files that appear whole or not at all.

use crate::platform::{self, sync_folder};
use crate::temporary::create_beside;
use crate::{folder_of, kind_name};
use std::fs::{File, FileType};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// A file being written beside its target; [`AtomicFile::commit`] syncs it and renames it over the target. Dropped before that, it
/// leaves no trace; what a killed run leaves, the next one to the same target removes.
///
/// A link is seen through: the file it leads to is replaced, the link stays. A pipe or a device of characters is written in place.
pub struct AtomicFile {
    writer: BufWriter<File>,
    /// As it was named.
    path: PathBuf,
    /// Name until it is complete, and name then; none for what is written in place.
    names: Option<(TempPath, PathBuf)>,
}

/// A step of writing a file that failed.
#[derive(Debug)]
pub struct StepError {
    /// What was tried: "create", "write" …
    pub action: &'static str,
    /// The cause.
    pub source: io::Error,
}

/// What has happened when only the folder could not be synced.
const WRITTEN: &str = "written, not synced: the sync of its folder";

impl AtomicFile {
    /// Starts a file that is to become `path`.
    ///
    /// # Errors
    ///
    /// If the target's folder cannot be written; if the target is a folder, a socket or a disk, or a link to nothing; if nobody reads a
    /// pipe.
    pub fn create(path: &Path) -> io::Result<Self> {
        let target = see_through(path)?;
        let (file, names) = match std::fs::metadata(&target) {
            Ok(found) if !found.is_file() => (open_in_place(&target, found.file_type())?, None),
            _ => {
                let (file, name) = create_beside(&target)?.into_parts();
                (file, Some((name, target)))
            }
        };
        let writer = BufWriter::with_capacity(1 << 18, file);
        Ok(Self { writer, path: path.to_owned(), names })
    }

    /// Path of the target.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the file appear under its name, synced to disk.
    ///
    /// # Errors
    ///
    /// If writing, syncing or renaming fails; the target is then as it was. If the file is there and only the sync of its folder has
    /// failed, the action says so.
    pub fn commit(self) -> Result<(), StepError> {
        let step = |action| move |source| StepError { action, source };
        let Self { writer, names, .. } = self;
        let file = writer.into_inner().map_err(|e| step("write")(e.into_error()))?;
        let Some((name, target)) = names else { return Ok(()) };
        file.sync_all().map_err(step("sync"))?;
        platform::rename_over(name, &target).map_err(step("rename"))?;
        // The rename itself lasts once the folder is synced.
        sync_folder(folder_of(&target)).map_err(step(WRITTEN))
    }
}

/// Where `path` leads to.
fn see_through(path: &Path) -> io::Result<PathBuf> {
    match std::fs::symlink_metadata(path) {
        Ok(found) if found.is_symlink() => std::fs::canonicalize(path)
            .map_err(|e| io::Error::new(e.kind(), format!("it is a link that leads nowhere: {e}"))),
        _ => Ok(path.to_owned()),
    }
}

fn open_in_place(path: &Path, kind: FileType) -> io::Result<File> {
    if !(platform::is_character_device(kind) || platform::is_pipe(kind)) {
        let text = format!("it is {}, expected a regular file", kind_name(kind));
        return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
    }
    platform::open_in_place(path)
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.writer.seek(position)
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use rustix::fs::OFlags;
    use rustix::fs::{CWD, Mode};
    use std::io::Read;
    use std::os::unix::fs::OpenOptionsExt;

    fn write(path: &Path, text: &str) -> Result<(), StepError> {
        let step = |source| StepError { action: "create", source };
        let mut file = AtomicFile::create(path).map_err(step)?;
        file.write_all(text.as_bytes()).map_err(step)?;
        file.commit()
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_committed_file_replaces_the_target_and_a_dropped_one_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        std::fs::write(&path, "old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        write(&path, "new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn what_was_left_is_removed_and_what_is_being_written_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        let alive = AtomicFile::create(&path).unwrap();
        // As after a kill: the name stays, the lock does not.
        let left = create_beside(&path).unwrap().into_temp_path().keep().unwrap();
        let others =
            [".a.bin.notes", ".a.bin.0123456789.b.pbgi-tmp", ".b.bin.0123456789ab.pbgi-tmp"];
        others.iter().for_each(|name| std::fs::write(folder.path().join(name), "mine").unwrap());
        std::fs::write(folder.path().join("victim"), "mine").unwrap();
        let link = folder.path().join(".a.bin.abcdefghijkl.pbgi-tmp");
        std::os::unix::fs::symlink("victim", &link).unwrap();
        write(&path, "new").unwrap();
        assert!(!left.exists() && link.is_symlink());
        assert_eq!(std::fs::read(folder.path().join("victim")).unwrap(), b"mine");
        assert_eq!(names(folder.path()).len(), others.len() + 4);
        alive.commit().unwrap();
        assert_eq!(names(folder.path()).len(), others.len() + 3);
    }

    #[test]
    fn links_stay_and_the_file_they_lead_to_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("deep")).unwrap();
        std::fs::write(path("deep/a"), "old").unwrap();
        std::os::unix::fs::symlink("deep/a", path("link")).unwrap();
        write(&path("link"), "new").unwrap();
        assert!(path("link").is_symlink());
        assert_eq!(std::fs::read(path("deep/a")).unwrap(), b"new");
        std::os::unix::fs::symlink("none", path("lost")).unwrap();
        let error = write(&path("lost"), "new").unwrap_err();
        assert!(error.source.to_string().contains("leads nowhere"), "{}", error.source);
        assert!(path("lost").is_symlink() && !path("none").exists());
    }

    #[test]
    fn pipes_and_devices_are_written_in_place() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(CWD, &pipe, Mode::RUSR | Mode::WUSR).unwrap();
        assert!(write(&pipe, "x").unwrap_err().source.to_string().contains("nobody reads"));
        let flags = OFlags::NONBLOCK.bits() as i32;
        let mut reader = File::options().read(true).custom_flags(flags).open(&pipe).unwrap();
        write(&pipe, "text").unwrap();
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        assert_eq!(text, "text");
        write(Path::new("/dev/null"), "x").unwrap();
        assert!(!std::fs::metadata("/dev/null").unwrap().is_file());
        assert_eq!(names(folder.path()), ["pipe"]);
    }

    #[test]
    fn folders_and_missing_folders_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        for bad in [folder.path(), &folder.path().join("no/a"), Path::new("/"), Path::new("")] {
            assert!(AtomicFile::create(bad).is_err(), "{}", bad.display());
        }
        assert!(names(folder.path()).is_empty());
    }
}
