//! Reads every page and checks every invariant a reader relies on.

mod batch;
mod join;
mod page;

use crate::error::StoreError;
use crate::octree::Octree;
use batch::Facts;
use join::Join;
use pbgi_format::{FormatError, LOBES_MAX, PageEntry, PageId, PageKind};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

/// Nodes and surfels at one depth of the tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LevelCounts {
    /// Groups.
    pub groups: u64,
    /// Leaves below groups of this depth.
    pub leaves: u64,
    /// Surfels in those leaves.
    pub surfels: u64,
}

/// What a file holds, counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VerifyReport {
    /// By depth: number of groups between a group and the root.
    pub levels: Vec<LevelCounts>,
    /// Leaves by number of surfels.
    pub leaf_sizes: Vec<u64>,
    /// Children by number of lobes.
    pub lobe_counts: [u64; LOBES_MAX + 1],
    /// Pages by decoded size in steps of 4 KiB.
    pub page_sizes: Vec<u64>,
    /// Bytes read.
    pub bytes_read: u64,
}

/// Stored bytes read at once, unless a single page has more.
const BATCH_BYTES: u64 = 1 << 20;

impl Octree {
    /// Reads the whole file once, on so many threads, and checks every page's checksum, every link (that it leads to a whole group or
    /// leaf, that each group is linked once, and never back), every box (a child's inside its parent's), that every surfel has a
    /// place and a size, and the header's totals.
    ///
    /// Each thread holds a mebibyte of stored bytes (two, or three pages, at most), and what they decode to. Beside these about two
    /// hundred bytes are kept for each treelet until a page that links to it was checked. `progress` is told the bytes read.
    ///
    /// # Errors
    ///
    /// Names the first damaged page of the file, or where the tree contradicts itself.
    pub fn verify(
        &self,
        threads: usize,
        mut progress: impl FnMut(u64),
    ) -> Result<VerifyReport, StoreError> {
        let batches = self.batches();
        let next = AtomicUsize::new(0);
        let (sender, results) = mpsc::channel();
        std::thread::scope(|scope| {
            for _ in 0..threads.max(1) {
                let (sender, next, batches) = (sender.clone(), &next, &batches);
                scope.spawn(move || self.check_batches(batches, next, &sender));
            }
            drop(sender);
            let (mut join, mut waiting) = (Join::default(), BTreeMap::new());
            let (mut joined, mut bytes_read) = (0, 0);
            // The first failure in the order of the file counts; there the joining ends.
            for (index, result) in results {
                if let Ok(found) = &result {
                    bytes_read += found.bytes_read;
                    progress(bytes_read);
                }
                waiting.insert(index, result);
                while let Some(result) = waiting.remove(&joined) {
                    join.push(self, result?)?;
                    joined += 1;
                }
            }
            join.finish(self)
        })
    }

    /// Checks runs of pages that no other thread has taken, until there are none or one of them is damaged.
    fn check_batches(
        &self,
        batches: &[Range<usize>],
        next: &AtomicUsize,
        results: &mpsc::Sender<(usize, Result<Facts, StoreError>)>,
    ) {
        let mut buffer = Vec::new();
        while let index = next.fetch_add(1, Ordering::Relaxed)
            && let Some(pages) = batches.get(index)
        {
            let result = batch::check(self, pages.clone(), &mut buffer);
            if result.is_err() {
                // Batches before this one are on their way; none after it counts.
                next.store(batches.len(), Ordering::Relaxed);
            }
            if results.send((index, result)).is_err() {
                break;
            }
        }
    }

    /// Runs of pages that are read at once. Surfels are in the run of their nodes, which follow them.
    fn batches(&self) -> Vec<Range<usize>> {
        let pages = self.pages();
        let mut batches = Vec::new();
        let mut first = 0;
        let end_of = |page: &PageEntry| page.offset + u64::from(page.stored_bytes);
        for (index, page) in pages.iter().enumerate() {
            let next = pages.get(index + 1);
            // A page of surfels and that of their nodes may come next.
            let after = pages.get(index + 2).or(next).map_or(u64::MAX, end_of);
            let bytes = after - pages[first].offset;
            let ends_pair = page.kind == PageKind::Nodes || bytes > 2 * BATCH_BYTES;
            if next.is_none() || bytes > BATCH_BYTES && ends_pair {
                batches.push(first..index + 1);
                first = index + 1;
            }
        }
        batches
    }

    fn invalid(
        &self,
        page: PageId,
        place: &'static str,
        found: impl ToString,
        expected: impl ToString,
    ) -> StoreError {
        let (found, expected) = (found.to_string(), expected.to_string());
        self.invalid_page(page, FormatError { place, found, expected })
    }
}
