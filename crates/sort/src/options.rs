//! What the caller grants and wants to know, and how a budget is divided.

use crate::SortError;
use pbgi_cloud::Surfel;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Bytes for everything but runs and merge buffers: a chunk of the source, the write buffer, the
/// window of estimation, the state of the merge.
const FIXED_BYTES: u64 = 6 << 20;
/// Smallest budget.
pub const BUDGET_BYTES_MIN: u64 = 8 << 20;
/// Bytes a surfel takes while its run is sorted: itself, and its Morton code and index.
pub(crate) const SORT_BYTES: u64 = (size_of::<Surfel>() + size_of::<(u64, u32)>()) as u64;
/// Merge buffers below this size would make the disk seek more than it reads.
const MERGE_BUFFER_BYTES_MIN: u64 = 64 << 10;
/// Larger merge buffers read no faster.
const MERGE_BUFFER_BYTES_MAX: u64 = 2 << 20;

/// How to sort.
#[derive(Clone)]
pub struct SortOptions<'a> {
    /// Bytes the sort may hold at once, its result in memory included, at least
    /// [`BUDGET_BYTES_MIN`]. Of the budget *B*, 6 MiB are set aside; a run is as many surfels as
    /// fit into the rest at 60 bytes each (44 for the surfel, 16 for its key), so up to
    /// (*B* − 6 MiB) / 60 surfels never touch the disk. Merging *n* runs takes *n* buffers of
    /// (*B* − 6 MiB) / *n* bytes, within 64 KiB to 2 MiB; more than (*B* − 6 MiB) / 64 KiB runs are
    /// merged in several passes. What the source holds is its own.
    pub budget_bytes: u64,
    /// Folder for temporary files. They have no name there, so that nothing stays behind, and take
    /// 44 bytes per surfel, twice that when merging takes several passes.
    pub temp_dir: PathBuf,
    /// Threads to sort with; 0 for one per core.
    pub threads: usize,
    /// Set to stop; looked at every few thousand surfels.
    pub cancel: Option<&'a AtomicBool>,
    /// Told how far the sort is, from the calling thread.
    pub progress: Option<&'a (dyn Fn(SortProgress) + Sync)>,
}

impl Default for SortOptions<'_> {
    fn default() -> Self {
        Self {
            budget_bytes: 512 << 20,
            temp_dir: std::env::temp_dir(),
            threads: 0,
            cancel: None,
            progress: None,
        }
    }
}

impl SortOptions<'_> {
    /// Reports progress and returns an error if the caller asked to stop.
    pub(crate) fn check(
        &self,
        phase: SortPhase,
        done: u64,
        total: Option<u64>,
    ) -> Result<(), SortError> {
        if let Some(progress) = self.progress {
            progress(SortProgress { phase, done, total });
        }
        match self.cancel {
            Some(cancel) if cancel.load(Ordering::Relaxed) => Err(SortError::Canceled),
            _ => Ok(()),
        }
    }

    pub(crate) fn thread_pool(&self) -> Result<rayon::ThreadPool, SortError> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .thread_name(|i| format!("sort-{i}"))
            .build()
            .map_err(|e| SortError::Threads { threads: self.threads, message: e.to_string() })
    }
}

/// What the sort is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SortPhase {
    /// Reading the source, and sorting and writing runs as they fill.
    Read,
    /// Sorting runs that were written before the bounds were known.
    SortRuns,
    /// Merging runs, because there are too many to merge while reading.
    Merge,
    /// Estimating normals and sizes.
    Estimate,
}

/// How far the sort is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SortProgress {
    /// What is being done.
    pub phase: SortPhase,
    /// Surfels done in this phase.
    pub done: u64,
    /// Surfels of this phase, where known.
    pub total: Option<u64>,
}

/// Sizes derived from the budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    /// Surfels of a run.
    pub run_surfels: usize,
    /// Most runs merged at once, at least 2.
    pub fan_in: usize,
    /// Bytes of all merge buffers together.
    pub merge_bytes: u64,
}

impl Plan {
    /// The plan of a budget.
    pub fn new(budget_bytes: u64) -> Result<Self, SortError> {
        if budget_bytes < BUDGET_BYTES_MIN {
            return Err(SortError::BudgetTooSmall {
                found: budget_bytes,
                expected: BUDGET_BYTES_MIN,
            });
        }
        let free = budget_bytes - FIXED_BYTES;
        Ok(Self {
            // Indices within a run are u32.
            run_surfels: (free / SORT_BYTES).min(u64::from(u32::MAX)) as usize,
            fan_in: (free / MERGE_BUFFER_BYTES_MIN).min(1 << 16) as usize,
            merge_bytes: free,
        })
    }

    /// Surfels of each buffer when `runs` are merged.
    pub fn merge_buffer_surfels(&self, runs: usize) -> usize {
        let bytes = (self.merge_bytes / runs.max(1) as u64).min(MERGE_BUFFER_BYTES_MAX);
        (bytes as usize / size_of::<Surfel>()).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_stay_within_their_budget() {
        for budget in [BUDGET_BYTES_MIN, 16 << 20, 100 << 20, 64 << 30, 1 << 45] {
            let plan = Plan::new(budget).unwrap();
            assert!(plan.run_surfels as u64 * SORT_BYTES + FIXED_BYTES <= budget);
            for runs in [2, 7, plan.fan_in] {
                let buffers = plan.merge_buffer_surfels(runs) as u64 * 44 * runs as u64;
                assert!(buffers + FIXED_BYTES <= budget);
            }
            assert!(plan.fan_in >= 2);
        }
        assert!(matches!(Plan::new(1000), Err(SortError::BudgetTooSmall { found: 1000, .. })));
    }
}
