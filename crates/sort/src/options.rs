//! What the caller grants and wants to know, and how a budget is divided.

use crate::SortError;
use crate::buckets::SURFEL_BYTES;
use crate::checkpoint::Checkpoint;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Bytes for everything but surfels: chunks of the source, the write buffer, the window of estimation.
const FIXED_BYTES: u64 = 5 << 20;
/// Smallest budget.
pub const BUDGET_BYTES_MIN: u64 = 8 << 20;
/// Bytes a surfel of a piece takes until it is built: itself twice, its code and rank, what is built of it.
const PIECE_SURFEL_BYTES: u64 = 160;
/// Surfels of a piece: larger ones leave the processor's caches.
const PIECE_SURFELS_MAX: u64 = 1 << 15;
/// Smaller pieces would be all seams; only budgets of less than half a megabyte for each thread have so small ones.
const PIECE_SURFELS_MIN: u64 = 64;
/// Bytes of memory for each cell that may be divided early: most cells hold surfels, and waste half a block.
const BYTES_PER_CELL: u64 = 16 << 10;
/// Surfels of a run where memory would hold more of them, 128 MiB, and most runs so small.
const RUN_SURFELS: u64 = 3 << 20;
const RUNS_MAX: u64 = 256;
/// Larger read buffers read no faster.
const READ_BUFFER_BYTES_MAX: u64 = 1 << 20;

/// How to sort.
#[derive(Clone)]
pub struct SortOptions<'a> {
    /// Bytes the sort may hold at once, its result and the pieces it hands out included, at least
    /// [`BUDGET_BYTES_MIN`]. Of the budget *B*, 5 MiB and *B*/32 are set aside, and up to *B*/4 for pieces; the rest
    /// takes surfels at 44 bytes each, and what fits there never touches the disk. What the source holds is its own.
    pub budget_bytes: u64,
    /// Folder for temporary files. They have no name there, so that nothing stays behind, and take at most
    /// 44 bytes per surfel: less where light, albedo or flags are all the same, twice that where the source does not know its bounds.
    pub temp_dir: PathBuf,
    /// Where what is sorted is kept, and taken up from if an earlier run has kept it. The caller removes it.
    pub checkpoint: Option<Checkpoint>,
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
            checkpoint: None,
            threads: 0,
            cancel: None,
            progress: None,
        }
    }
}

impl SortOptions<'_> {
    /// Whether so many surfels are sorted in memory, and none goes to disk.
    #[must_use]
    pub fn holds(&self, surfels: u64) -> bool {
        let plan = Plan::new(self.budget_bytes, self.thread_count());
        self.checkpoint.is_none() && plan.is_ok_and(|plan| surfels <= plan.held_surfels as u64)
    }

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

    /// Threads to sort with, resolved.
    pub(crate) fn thread_count(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
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
    /// Reading the source once only to find its bounds.
    Bounds,
    /// Reading the source and dividing it by place.
    Read,
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
    /// Surfels held in memory.
    pub held_surfels: usize,
    /// Most surfels of a piece.
    pub piece_surfels: usize,
    /// Cells up to which cells are divided before they are full.
    pub early_cells: usize,
    /// Bytes to read runs with, all together.
    pub read_bytes: u64,
}

impl Plan {
    /// The plan of a budget.
    pub fn new(budget_bytes: u64, threads: usize) -> Result<Self, SortError> {
        if budget_bytes < BUDGET_BYTES_MIN {
            return Err(SortError::BudgetTooSmall {
                found: budget_bytes,
                expected: BUDGET_BYTES_MIN,
            });
        }
        let free = budget_bytes - FIXED_BYTES - budget_bytes / 32;
        // Pieces that are sorted, built, or wait for their turn.
        let pieces_at_once = pieces_in_flight(threads) as u64 + 1;
        let surfel_bytes = PIECE_SURFEL_BYTES * pieces_at_once;
        let piece_surfels = (free / 4 / surfel_bytes).clamp(PIECE_SURFELS_MIN, PIECE_SURFELS_MAX);
        let held_bytes = free.saturating_sub(piece_surfels * surfel_bytes).max(free / 4);
        Ok(Self {
            held_surfels: (held_bytes as f64 / SURFEL_BYTES) as usize,
            piece_surfels: piece_surfels as usize,
            early_cells: (held_bytes / BYTES_PER_CELL) as usize,
            read_bytes: held_bytes / 2,
        })
    }

    /// The plan for a cloud of `total` surfels: what goes to disk anyway goes there by smaller runs, which touch less memory.
    pub fn for_total(self, total: Option<u64>) -> Self {
        let held = self.held_surfels as u64;
        match total {
            Some(total) if total > held => {
                let run = (total / RUNS_MAX).max(RUN_SURFELS).min(held);
                Self { held_surfels: run as usize, ..self }
            }
            _ => self,
        }
    }

    /// Bytes of the read buffer of each run.
    pub fn read_buffer_bytes(&self, runs: usize) -> usize {
        (self.read_bytes / runs.max(1) as u64).min(READ_BUFFER_BYTES_MAX) as usize
    }
}

/// Pieces that may be worked on or wait at once when `threads` work on them.
#[must_use]
pub fn pieces_in_flight(threads: usize) -> usize {
    2 * threads.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_stay_within_their_budget() {
        for budget in [BUDGET_BYTES_MIN, 16 << 20, 100 << 20, 64 << 30, 1 << 45] {
            for threads in [1, 2, 16] {
                let plan = Plan::new(budget, threads).unwrap();
                let pieces = (pieces_in_flight(threads) as u64 + 1)
                    * plan.piece_surfels as u64
                    * PIECE_SURFEL_BYTES;
                let held = (plan.held_surfels as f64 * SURFEL_BYTES) as u64;
                assert!(held + pieces + FIXED_BYTES <= budget, "{budget} {threads}");
                // A node of the trie and its list take 24 bytes.
                assert!(plan.early_cells as u64 * 24 <= budget / 32);
                for runs in [2, 7] {
                    let buffers = plan.read_buffer_bytes(runs) as u64 * runs as u64;
                    assert!(buffers <= plan.read_bytes);
                }
            }
        }
        let plan = Plan::new(4 << 30, 2).unwrap();
        let held = plan.held_surfels as u64;
        for total in [None, Some(1), Some(held)] {
            assert_eq!(plan.for_total(total), plan);
        }
        assert_eq!(plan.for_total(Some(held + 1)).held_surfels as u64, RUN_SURFELS);
        assert_eq!(plan.for_total(Some(1 << 40)).held_surfels as u64, held);
        assert!(matches!(Plan::new(1000, 1), Err(SortError::BudgetTooSmall { found: 1000, .. })));
    }
}
