//! Files that appear whole or not at all.

use crate::CloudError;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A file being written beside its target; [`AtomicFile::commit`] syncs it and renames it over the
/// target. Dropped before that, it leaves no trace.
pub struct AtomicFile {
    writer: BufWriter<NamedTempFile>,
    path: PathBuf,
}

impl AtomicFile {
    /// Starts a file that is to become `path`.
    ///
    /// # Errors
    ///
    /// If the target's folder cannot be written.
    pub fn create(path: &Path) -> Result<Self, CloudError> {
        let io = |e| CloudError::io(path, "create", e);
        let file = builder().tempfile_in(folder_of(path)).map_err(io)?;
        Ok(Self { writer: BufWriter::with_capacity(1 << 18, file), path: path.to_owned() })
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
    /// If writing, syncing or renaming fails; the target is then as it was.
    pub fn commit(self) -> Result<(), CloudError> {
        let Self { writer, path } = self;
        let file =
            writer.into_inner().map_err(|e| CloudError::io(&path, "write", e.into_error()))?;
        file.as_file().sync_all().map_err(|e| CloudError::io(&path, "sync", e))?;
        file.persist(&path).map_err(|e| CloudError::io(&path, "rename", e.error))?;
        // The rename itself lasts once the folder is synced.
        File::open(folder_of(&path))
            .and_then(|folder| folder.sync_all())
            .map_err(|e| CloudError::io(&path, "sync", e))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.writer.seek(position)
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Temporary files get the permissions of ordinary ones, as they stay under their new name.
fn builder() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".pbgi-");
    #[cfg(unix)]
    {
        use std::fs::Permissions;
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(Permissions::from_mode(0o666));
    }
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_file_leaves_the_target_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        std::fs::write(&path, "old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        drop(file);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_committed_file_replaces_the_target() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        std::fs::write(&path, "old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        file.commit().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_an_error() {
        assert!(AtomicFile::create(Path::new("no/such/folder/a.bin")).is_err());
    }
}
