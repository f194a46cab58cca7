//! What can go wrong with an image file.

use pbgi_file::catch_decoder_panic;
use std::path::{Path, PathBuf};

/// Why an image could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The operating system refused.
    #[error("{}: {action} failed: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried: "open", "read", "write" …
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not what it claims to be.
    #[error("{}: {message}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Place, what was found, what was expected, and the cure if there is one.
        message: String,
    },
    /// The file is valid, yet of a kind that is not read here.
    #[error("{}: {found} is not supported; {cure}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The feature.
        found: String,
        /// What to do, often a command that converts the file.
        cure: String,
    },
    /// A pixel holds a value that no environment can have.
    #[error(
        "{}: pixel (column {column}, row {row}) is ({}, {}, {}), expected finite values of at least 0; {cure}",
        path.display(), value[0], value[1], value[2]
    )]
    BadPixel {
        /// The file.
        path: PathBuf,
        /// Column of the first bad pixel, from 0 at the left.
        column: usize,
        /// Row of the first bad pixel, from 0 at the top.
        row: usize,
        /// Its red, green and blue.
        value: [f32; 3],
        /// A command that repairs the file.
        cure: String,
    },
    /// The image in memory cannot be written as asked.
    #[error("{}: cannot write the image: {message}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Which channel or attribute, what was found, what was expected.
        message: String,
    },
}

impl ImageError {
    /// An [`ImageError::Io`] for `path`.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), action, source }
    }

    /// An [`ImageError::Malformed`] for `path`.
    pub fn malformed(path: &Path, message: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), message: message.into() }
    }

    /// The image error that a closure has passed on as the cause of an [`ImageError::Io`], or else that error itself.
    pub(crate) fn or_cause(self) -> Self {
        match self {
            Self::Io { path, action, source } => match source.downcast() {
                Ok(cause) => cause,
                Err(source) => Self::Io { path, action, source },
            },
            other => other,
        }
    }

    pub(crate) fn unsupported(
        path: &Path,
        found: impl Into<String>,
        cure: impl Into<String>,
    ) -> Self {
        Self::Unsupported { path: path.to_owned(), found: found.into(), cure: cure.into() }
    }

    pub(crate) fn unwritable(path: &Path, message: impl Into<String>) -> Self {
        Self::Unwritable { path: path.to_owned(), message: message.into() }
    }
}

/// Decodes with code of another crate, whose panics become errors.
pub(crate) fn decode_foreign<T>(
    path: &Path,
    decode: impl FnOnce() -> Result<T, ImageError>,
) -> Result<T, ImageError> {
    catch_decoder_panic(decode).unwrap_or_else(|| {
        Err(ImageError::malformed(path, "the decoder failed on damaged data; get the file again"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoder_panics_become_errors() {
        let path = Path::new("x.exr");
        let result: Result<(), _> = decode_foreign(path, || panic!("odd file"));
        assert!(result.unwrap_err().to_string().starts_with("x.exr: the decoder failed"));
        assert_eq!(decode_foreign(path, || Ok(7)).unwrap(), 7);
    }
}
