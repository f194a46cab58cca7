//! How a memory limit is shared between the page cache and everything else.

use crate::PbgiError;
use crate::figures::format_bytes;
use crate::shade::ShadeSettings;
use pbgi_file::platform::resident_bytes;
use pbgi_gather::{KNOWN_BYTES, gatherer_bytes};
use serde::Serialize;
use std::fmt;

/// What a program holds before it does anything, where the system does not tell.
const PROGRAM_BYTES: u64 = 24 << 20;

/// Room for small things to come, and for each worker's stack.
const MARGIN_BYTES: u64 = 8 << 20;
const STACK_BYTES: u64 = 512 << 10;

/// Least page cache worth opening a file with.
const CACHE_BYTES_MIN: u64 = 4 << 20;

/// Least bytes of decoded nodes that a worker keeps.
const NODE_BYTES_MIN: u64 = 128 << 10;

/// What a limit has beyond what every program takes, over the decoded nodes of all workers. Within 96 MiB two workers keep 2 MiB each; a street of a
/// million surfels takes a seventh longer with 1.5 MiB, and a seventh less with 3, but then little is left for pictures and pages.
const NODES_PART: u64 = 16;
const PROGRAM_BYTES_LEAST: u64 = 32 << 20;

/// Bytes of decoded nodes that each of so many workers keeps: all of them together no more than their part of the limit, if that is enough for the least.
pub(crate) fn node_bytes(limit_bytes: u64, threads: usize) -> usize {
    let room = limit_bytes.saturating_sub(PROGRAM_BYTES_LEAST) / NODES_PART;
    let each = room / threads.max(1) as u64;
    each.clamp(NODE_BYTES_MIN, KNOWN_BYTES as u64) as usize
}

/// Bytes that a worker holds besides decoded nodes, with so many texels along a face of its raster and so many directions of a reflection.
pub(crate) fn worker_bytes(raster_edge: usize, lobe_level: u32) -> u64 {
    STACK_BYTES + gatherer_bytes(raster_edge, lobe_level) as u64
}

/// Bytes that all workers hold for that: what is kept grows by doubling.
pub(crate) fn node_bytes_held(limit_bytes: u64, threads: usize) -> u64 {
    2 * node_bytes(limit_bytes, threads) as u64 * threads as u64
}

/// The least limit that holds so many bytes besides the decoded nodes of all workers.
pub(crate) fn limit_beside_nodes(bytes: u64, threads: usize) -> u64 {
    // Nodes hold twice their part of a limit, or what is least.
    let beyond = bytes.saturating_sub(PROGRAM_BYTES_LEAST);
    let with_share = bytes.saturating_add(beyond.div_ceil(NODES_PART / 2 - 1));
    with_share.max(bytes.saturating_add(2 * NODE_BYTES_MIN * threads as u64))
}

/// The parts of a memory limit, in bytes. Their sum is the limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MemorySplit {
    /// The limit.
    pub limit_bytes: u64,
    /// What is held before shading starts: program, scene, environment; with a margin for workers.
    pub held_bytes: u64,
    /// Receivers, their results, and the image.
    pub frame_bytes: u64,
    /// Page cache: all the rest.
    pub cache_bytes: u64,
    #[serde(skip)]
    threads: usize,
}

impl fmt::Display for MemorySplit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [held, frame, cache] =
            [self.held_bytes, self.frame_bytes, self.cache_bytes].map(format_bytes);
        write!(f, "{cache} page cache, {frame} receivers and image, {held} the rest")
    }
}

impl MemorySplit {
    /// A split for what the process holds now, before frame and cache have their shares.
    pub(crate) fn measure(settings: &ShadeSettings) -> Self {
        let resident = resident_bytes().unwrap_or(PROGRAM_BYTES);
        let workers = settings.worker_bytes() * settings.threads as u64;
        Self::new(settings.memory_bytes, resident + MARGIN_BYTES + workers, settings.threads)
    }

    /// With so many bytes held besides the workers' nodes.
    fn new(limit_bytes: u64, held_bytes: u64, threads: usize) -> Self {
        let held_bytes = held_bytes + node_bytes_held(limit_bytes, threads);
        Self { limit_bytes, held_bytes, threads, ..Self::default() }
    }

    /// Grants the frame between `least` and `most` bytes, at most half of what is left above the
    /// least of both, and the cache the rest.
    ///
    /// # Errors
    ///
    /// If the limit does not hold the least of both; the error names the limit that would.
    pub(crate) fn grant(mut self, least: u64, most: u64) -> Result<Self, PbgiError> {
        let needed = least.saturating_add(CACHE_BYTES_MIN);
        let rest = self.limit_bytes.saturating_sub(self.held_bytes);
        if rest < needed {
            let nodes = node_bytes_held(self.limit_bytes, self.threads);
            let beside = (self.held_bytes - nodes).saturating_add(needed);
            let total = limit_beside_nodes(beside, self.threads);
            return Err(PbgiError::budget(format!(
                "a memory limit of {} does not hold program, scene and image; at least {} are \
                 needed (--memory-limit {}MiB)",
                format_bytes(self.limit_bytes),
                format_bytes(total),
                total.div_ceil(1 << 20)
            )));
        }
        self.frame_bytes = most.clamp(least, least + (rest - needed) / 2);
        self.cache_bytes = rest - self.frame_bytes;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_to_the_limit() {
        let split = MemorySplit::new(256 << 20, 60 << 20, 2);
        for (least, most) in [(0, 0), (1 << 20, 10 << 20), (50 << 20, 500 << 20)] {
            let s = split.grant(least, most).unwrap();
            assert_eq!(s.held_bytes + s.frame_bytes + s.cache_bytes, s.limit_bytes);
            assert!((least..=most).contains(&s.frame_bytes) && s.cache_bytes >= CACHE_BYTES_MIN);
        }
    }

    #[test]
    fn limits_that_are_too_small_name_one_that_is_not() {
        // What nodes take grows with the limit, from a least size on.
        for (threads, named) in [(1, 116), (2, 116), (100, 130)] {
            let grant = |limit_mib: u64| {
                MemorySplit::new(limit_mib << 20, 100 << 20, threads).grant(1 << 20, 1 << 20)
            };
            let error = grant(32).unwrap_err();
            let cure = format!("--memory-limit {named}MiB");
            assert!(error.to_string().contains(&cure), "{error}");
            assert_eq!(error.exit_code(), 4);
            assert!(grant(named).is_ok() && grant(named - 1).is_err(), "{threads}");
        }
    }
}
