//! Why a scene could not be read.

use pbgi_cloud::CloudError;
use std::path::{Path, PathBuf};

/// Why a scene could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The operating system refused.
    #[error("{}: {action} failed: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried: "open", "read" …
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not what it claims to be.
    #[error("{}: {message}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Place, what was found, what was expected.
        message: String,
    },
    /// The file is sound, but uses something the engine cannot read.
    #[error("{}: {what} is not supported; {cure}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not supported.
        what: String,
        /// What to do instead.
        cure: String,
    },
}

impl SceneError {
    /// An [`SceneError::Io`] for `path`.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), action, source }
    }

    /// A [`SceneError::Malformed`] for `path`.
    pub fn malformed(path: &Path, message: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), message: message.into() }
    }

    /// A [`SceneError::Unsupported`] for `path`.
    pub fn unsupported(path: &Path, what: impl Into<String>, cure: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_owned(), what: what.into(), cure: cure.into() }
    }
}

/// `path` serves errors that name none.
pub(crate) fn from_cloud_error(path: &Path, error: CloudError) -> SceneError {
    match error {
        CloudError::Io { path, action, source } => SceneError::Io { path, action, source },
        CloudError::Malformed { path, message } => SceneError::Malformed { path, message },
        other => SceneError::malformed(path, other.to_string()),
    }
}
