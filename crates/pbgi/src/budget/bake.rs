//! How a bake divides its memory limit.

use crate::PbgiError;
use crate::budget::split::{limit_beside_nodes, node_bytes_held, worker_bytes};
use crate::figures::format_bytes;
use crate::shade::CHUNK_RECEIVERS;
use pbgi_build::BuildOptions;
use pbgi_file::platform::resident_bytes;
use pbgi_gather::GatherSettings;
use pbgi_sort::BUDGET_BYTES_MIN;
use pbgi_store::PIN_BYTES_PER_READER_MIN;

/// What a program holds before it does anything, where the system does not tell.
const PROGRAM_BYTES: u64 = 16 << 20;
/// The open path of the octree, pages being packed, the page table.
const BUILD_BYTES: u64 = 16 << 20;
/// Stack and tables of a worker that lights nothing.
const THREAD_BYTES: u64 = 1 << 20;
/// What the allocator keeps for itself, and small things.
const MARGIN_BYTES: u64 = 4 << 20;
/// A surfel being shaded: itself and its code, receiver, order, result twice.
const SHADED_SURFEL_BYTES: u64 = 256;

/// Bytes of the page cache of a program that only reads an octree.
pub(crate) fn reader_cache_bytes(limit: u64) -> u64 {
    let held = resident_bytes().unwrap_or(PROGRAM_BYTES) + MARGIN_BYTES + THREAD_BYTES;
    limit.saturating_sub(held).max(BUDGET_BYTES_MIN)
}

/// Bytes that a worker holds, which lights surfels by such a raster.
fn thread_bytes(raster_edge: Option<usize>) -> u64 {
    let lobe_level = GatherSettings::default().lobe_level;
    raster_edge.map_or(THREAD_BYTES, |edge| worker_bytes(edge, lobe_level))
}

/// The parts of a bake's memory limit. None of them changes the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BakeMemory {
    limit: u64,
    /// Texels along a face of the rasters that surfels are lit by, if they are.
    raster_edge: Option<usize>,
    /// Threads the limit affords, at most those asked for.
    pub threads: usize,
}

impl BakeMemory {
    pub fn new(limit: u64, threads: usize, raster_edge: Option<usize>) -> Self {
        let affordable = (limit / 8 / thread_bytes(raster_edge)) as usize;
        Self { limit, raster_edge, threads: threads.clamp(1, affordable.max(1)) }
    }

    /// Whether surfels are lit.
    fn lights(&self) -> bool {
        self.raster_edge.is_some()
    }

    /// Bytes set aside for building and shading.
    pub fn reserve(&self) -> u64 {
        let workers = self.threads as u64 * thread_bytes(self.raster_edge);
        let mut bytes = BUILD_BYTES + MARGIN_BYTES + workers;
        if self.lights() {
            bytes += CHUNK_RECEIVERS as u64 * SHADED_SURFEL_BYTES;
        }
        bytes + self.node_bytes()
    }

    /// Bytes of decoded nodes that gathers keep.
    fn node_bytes(&self) -> u64 {
        if self.lights() { node_bytes_held(self.limit, self.threads) } else { 0 }
    }

    /// The least limit that holds so many bytes besides these.
    fn limit_for(&self, beside: u64) -> u64 {
        if self.lights() { limit_beside_nodes(beside, self.threads) } else { beside }
    }

    /// Bytes for the sort, now that all inputs are open: what they and the reserve leave, or half of it
    /// where a page cache is needed later.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Budget`], naming the limit that would do.
    pub fn sort_bytes(&self) -> Result<u64, PbgiError> {
        self.sort_bytes_beside(resident_bytes().unwrap_or(PROGRAM_BYTES))
    }

    fn sort_bytes_beside(&self, held: u64) -> Result<u64, PbgiError> {
        let parts = if self.lights() { 2 } else { 1 };
        let least = held + self.reserve() + parts * BUDGET_BYTES_MIN;
        if least > self.limit {
            let beside = least + MARGIN_BYTES - self.node_bytes();
            let needed = self.limit_for(beside).div_ceil(1 << 20);
            return Err(PbgiError::budget(format!(
                "a memory limit of {} does not hold the program, its inputs ({} by now) and the \
                 sort; at least {needed} MiB are needed (--memory-limit {needed}MiB)",
                format_bytes(self.limit),
                format_bytes(held),
            )));
        }
        Ok((self.limit - held - self.reserve()) / parts)
    }

    /// Bytes of the page cache and number of its readers, now that the surfels are sorted. Fewer
    /// threads than asked for where each would have too little.
    pub fn cache(&self) -> (u64, usize) {
        self.cache_beside(resident_bytes().unwrap_or(self.limit / 2))
    }

    fn cache_beside(&self, held: u64) -> (u64, usize) {
        let bytes = self.limit.saturating_sub(held + self.reserve()).max(BUDGET_BYTES_MIN);
        let page_bytes = BuildOptions::default().page_bytes as u64;
        let readers = bytes / 2 / (PIN_BYTES_PER_READER_MIN * page_bytes);
        (bytes, self.threads.min(readers.max(1) as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MEMORY_LIMIT_MIN;

    #[test]
    fn parts_never_exceed_the_limit() {
        for limit in [MEMORY_LIMIT_MIN, 300 << 20, 8 << 30] {
            for (threads, raster_edge) in [(1, None), (2, Some(6)), (1000, Some(6))] {
                let memory = BakeMemory::new(limit, threads, raster_edge);
                let held = 12 << 20;
                let sort = memory.sort_bytes_beside(held).unwrap();
                let (cache, readers) = memory.cache_beside(held + sort);
                assert!(sort >= BUDGET_BYTES_MIN);
                if raster_edge.is_some() {
                    assert!(held + sort + cache + memory.reserve() <= limit, "{limit} {threads}");
                }
                let pins = readers as u64 * PIN_BYTES_PER_READER_MIN * (64 << 10);
                assert!(readers >= 1 && pins <= cache);
            }
        }
    }

    #[test]
    fn limits_that_are_too_small_name_one_that_is_not() {
        let memory = BakeMemory::new(MEMORY_LIMIT_MIN, 2, Some(6));
        let error = memory.sort_bytes_beside(100 << 20).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        let text = error.to_string();
        let needed = text.split("--memory-limit ").nth(1).unwrap();
        let needed: u64 = needed.strip_suffix("MiB)").unwrap().parse().unwrap();
        let memory = BakeMemory::new(needed << 20, 2, Some(6));
        assert!(memory.sort_bytes_beside(100 << 20).is_ok(), "{text}");
    }
}
