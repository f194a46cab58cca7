//! What walks count.

use pbgi_store::ReaderStats;

/// Levels that are told apart; what lies deeper counts to the last.
pub const LEVELS: usize = 24;

/// Requests for pages from groups of one level of the tree, 0 the root's; those for a leaf's surfels count to the level below its group.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LevelStats {
    /// Pages asked for.
    pub requests: u64,
    /// Pages that had to be read for it.
    pub misses: u64,
    /// Stored bytes of those.
    pub bytes_read: u64,
    /// Nanoseconds in the shared cache.
    pub wait_ns: u64,
}

impl LevelStats {
    /// Counts a request between two states of a reader.
    #[inline(always)]
    pub(crate) fn note(&mut self, before: &ReaderStats, after: &ReaderStats) {
        self.requests += 1;
        self.misses += after.pages_read - before.pages_read;
        self.bytes_read += after.bytes_read - before.bytes_read;
        self.wait_ns += after.wait_ns - before.wait_ns;
    }

    fn add(&mut self, other: &Self) {
        self.requests += other.requests;
        self.misses += other.misses;
        self.bytes_read += other.bytes_read;
        self.wait_ns += other.wait_ns;
    }
}

/// What picking cuts did; sums over receivers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CutStats {
    /// Nodes whose bounds were tested.
    pub nodes_visited: u64,
    /// Groups and leaves whose children or surfels were looked at: each was decoded before, or its page asked for.
    pub opened: u64,
    /// Nodes taken as one.
    pub clusters: u64,
    /// Surfels taken singly.
    pub surfels: u64,
    /// Nodes dropped because they are below the horizon.
    pub culled_horizon: u64,
    /// Nodes dropped because all they could touch was opaque.
    pub culled_opaque: u64,
    /// Pages asked for, by level of the tree.
    pub levels: [LevelStats; LEVELS],
}

impl CutStats {
    /// Entries of the cut.
    #[must_use]
    pub fn cut_size(&self) -> u64 {
        self.clusters + self.surfels
    }

    /// Adds another's counts.
    pub fn add(&mut self, other: &Self) {
        self.nodes_visited += other.nodes_visited;
        self.opened += other.opened;
        self.clusters += other.clusters;
        self.surfels += other.surfels;
        self.culled_horizon += other.culled_horizon;
        self.culled_opaque += other.culled_opaque;
        for (level, other) in self.levels.iter_mut().zip(&other.levels) {
            level.add(other);
        }
    }
}
