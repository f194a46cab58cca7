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
    /// A page cannot be read.
    #[error("page {page} of {} cannot be read: {source}; check the disk, bake it again, or shade without it (--skip-damaged)", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The page.
        page: PageId,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is no longer the one that was opened.
    #[error(
        "{} was written to while it was open (page {page} is not what it was: the file has {found} bytes, had {expected}); \
         leave it alone until the run ends, and run again",
        path.display()
    )]
    Changed {
        /// The file.
        path: PathBuf,
        /// The page that showed it.
        page: PageId,
        /// Bytes of the file now.
        found: u64,
        /// Bytes of the file when it was opened.
        expected: u64,
    },
    /// A page's bytes changed since they were written.
    #[error(
        "page {page} of {} is damaged (checksum {found:#018x}, expected {expected:#018x}); \
         bake it again, or shade without it (--skip-damaged)",
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

impl StoreError {
    /// Whether this is damage to a single page, which can be left out.
    pub(crate) fn is_damaged_page(&self) -> bool {
        matches!(self, Self::Unreadable { .. } | Self::Damaged { .. } | Self::InvalidPage { .. })
    }
}
