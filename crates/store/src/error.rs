//! Why an octree file cannot be used.

use pbgi_format::{FormatError, PageId};
use std::path::PathBuf;

/// Why an octree file cannot be opened or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The operating system refused.
    #[error("{}: {action} failed: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is no octree file, or one of another version, or its header or page table is damaged.
    #[error("{} is not a readable octree file: {source}; bake it again", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: FormatError,
    },
    /// A page's bytes changed since they were written.
    #[error(
        "page {page} of {} is damaged (checksum {found:#018x}, expected {expected:#018x}); bake it again",
        path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The page.
        page: PageId,
        /// Checksum of its bytes.
        found: u64,
        /// Checksum in the page table.
        expected: u64,
    },
    /// A page contradicts itself although its checksum is right.
    #[error("page {page} of {} is invalid: {source}; bake it again", path.display())]
    InvalidPage {
        /// The file.
        path: PathBuf,
        /// The page.
        page: PageId,
        /// What is wrong.
        source: FormatError,
    },
    /// The budget is below what the readers need at once.
    #[error(
        "{} needs a cache of at least {needed} bytes for {readers} threads, but only {granted} are \
         granted; raise --memory-limit or lower --threads",
        path.display()
    )]
    Budget {
        /// The file.
        path: PathBuf,
        /// Bytes needed.
        needed: u64,
        /// Bytes granted.
        granted: u64,
        /// Concurrent readers.
        readers: usize,
    },
}
