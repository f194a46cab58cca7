//! External Morton sort: any number of surfels, in a stated budget of memory, always in the same order.
//!
//! Surfels are divided by place while they are read: into the cells of a trie that grows finer where there are more of them. What fits
//! the budget stays in memory. When memory is full all of it goes to one unlinked temporary file, cell by cell; these runs are
//! then read side by side, a cell at a time. Neighboring cells make *pieces*, which are sorted by themselves, on any thread. The order
//! is that of (Morton code, input index) and depends on nothing else: not on the budget, the threads, or how the source chunks.
//!
//! This crate must never know octrees, pages or light; of surfels it changes only the normals and
//! sizes it is asked to estimate.
#![forbid(unsafe_code)]

mod aligned;
mod buckets;
mod checkpoint;
mod eigen;
mod error;
mod estimate;
mod form;
mod neighbors;
mod options;
mod pieces;
mod reader;
mod runs;
mod sort;
mod sorted;
mod summary;
mod temp_file;
mod trie;

pub use checkpoint::Checkpoint;
pub use error::SortError;
pub use estimate::{EstimateOptions, EstimateReport, estimate_surfels};
pub use options::{BUDGET_BYTES_MIN, SortOptions, SortPhase, SortProgress, pieces_in_flight};
pub use pieces::{SortedPiece, UnsortedPiece};
pub use sort::sort_surfels;
pub use sorted::SortedSurfels;
pub use summary::SurfelSummary;
