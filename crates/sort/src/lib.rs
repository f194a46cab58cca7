//! External Morton sort: any number of surfels, in a stated budget of memory, always in the same order.
//!
//! What fits the budget is sorted in memory. What does not goes to one unlinked temporary file as
//! sorted runs, which are merged while they are read. The order is that of (Morton code, input
//! index) and depends on nothing else: not on the budget, the threads, or how the source chunks.
//!
//! This crate must never know octrees, pages or light; of surfels it changes only the normals and
//! sizes it is asked to estimate.
#![forbid(unsafe_code)]

mod eigen;
mod error;
mod estimate;
mod merge;
mod neighbors;
mod options;
mod run_buffer;
mod sort;
mod sorted;
mod summary;
mod temp_file;

pub use error::SortError;
pub use estimate::{EstimateOptions, EstimateReport, estimate_surfels};
pub use options::{BUDGET_BYTES_MIN, SortOptions, SortPhase, SortProgress};
pub use sort::sort_surfels;
pub use sorted::SortedSurfels;
pub use summary::SurfelSummary;
