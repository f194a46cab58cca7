//! Why sorting fails.

use pbgi_cloud::CloudError;
use std::path::PathBuf;

/// Why surfels could not be sorted or estimated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SortError {
    /// The source failed.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// The budget holds not even one small run.
    #[error("a budget of {found} bytes is too small to sort in, expected at least {expected}")]
    BudgetTooSmall {
        /// Bytes granted.
        found: u64,
        /// Bytes needed, whatever the cloud.
        expected: u64,
    },
    /// A temporary file failed.
    #[error(
        "temporary file in {}: {action} failed: {source}; choose another folder (--temp-dir)",
        dir.display()
    )]
    Temp {
        /// The folder.
        dir: PathBuf,
        /// What was tried: "create", "read", "write" …
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// The folder for temporary files has too little room.
    #[error(
        "{} has {free} bytes free, {needed} more are needed for temporary files; make room, choose \
         another folder (--temp-dir) or raise the budget (--memory-limit)",
        dir.display()
    )]
    DiskFull {
        /// The folder.
        dir: PathBuf,
        /// Bytes still to be written.
        needed: u64,
        /// Bytes free.
        free: u64,
    },
    /// The source broke its promise about the bounds or validity of its surfels.
    #[error("surfel {index} of the input {what}; this is a bug in its reader")]
    BadSource {
        /// Index in input order.
        index: u64,
        /// What is wrong with it.
        what: &'static str,
    },
    /// No threads could be started.
    #[error("cannot start {threads} threads: {message}")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// The cause.
        message: String,
    },
    /// The caller asked to stop.
    #[error("canceled")]
    Canceled,
}
