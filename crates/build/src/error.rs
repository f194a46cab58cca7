//! Why a file could not be built.

use crate::StreamError;
use std::path::PathBuf;

/// Why a file could not be built. The target is then as it was before.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// The sorted stream failed.
    #[error("reading the sorted surfels failed: {0}")]
    Stream(#[source] StreamError),
    /// The sorted stream is not in Morton order.
    #[error(
        "surfel {index} is out of Morton order; this is a defect of the sort, please report it"
    )]
    Unsorted {
        /// Its place in the stream.
        index: u64,
    },
    /// No surfels.
    #[error("the cloud holds no surfels; an octree needs at least one")]
    Empty,
    /// Writing failed.
    #[error("{}: {action} failed: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// Too many pages for the file format.
    #[error("the octree would need more than {limit} pages; use larger pages (--page-bytes)")]
    TooManyPages {
        /// The format's limit.
        limit: u64,
    },
    /// No threads could be started.
    #[error("cannot start threads: {0}; use fewer (--threads)")]
    Threads(#[source] std::io::Error),
    /// Stopped from outside.
    #[error("interrupted")]
    Cancelled,
}
