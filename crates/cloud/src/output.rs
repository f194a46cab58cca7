//! Files that are written, with errors that name them.

use crate::CloudError;
use pbgi_file::AtomicFile;
use std::path::Path;

/// Starts a file that is to become `path`.
pub(crate) fn create_output(path: &Path) -> Result<AtomicFile, CloudError> {
    AtomicFile::create(path).map_err(|e| CloudError::io(path, "create", e))
}

/// Makes the file appear under its name.
pub(crate) fn commit_output(file: AtomicFile) -> Result<(), CloudError> {
    let path = file.path().to_owned();
    file.commit().map_err(|e| CloudError::io(&path, e.action, e.source))
}
