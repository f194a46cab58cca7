//! Opens octree files and pages them in within a budget.
//!
//! The only crate that maps files and accounts for cached bytes. It must never know what the pages are used for.
#![deny(unsafe_code)]

mod cache;
mod error;
mod octree;
pub mod policy;
mod region;
mod source;
mod stats;
mod sync;
mod trace;
mod verify;
mod walk;

pub use cache::{Page, PageRef};
pub use error::StoreError;
pub use octree::{Octree, OpenOptions, PIN_BYTES_PER_READER_MIN, Reader};
pub use source::{Backend, FileState, PageSource};
pub use stats::{CacheStats, ReaderStats};
pub use trace::{PageTrace, TRACE_MAGIC, TraceChunk};
pub use verify::{LevelCounts, VerifyReport};
pub use walk::{LeafWalk, for_each_leaf, try_for_each_leaf};
