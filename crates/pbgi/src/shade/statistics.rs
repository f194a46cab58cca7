//! What shading did, in numbers: batches and cuts, requests by level of the tree, the page cache.

use crate::figures::{format_bytes, format_count};
use pbgi_gather::LevelStats;
use pbgi_schedule::ShadeReport;
use pbgi_store::CacheStats;
use serde::Serialize;

/// Batches of receivers and their cuts. Counts that are means are per receiver gathered.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CutReport {
    /// Batches handed to workers.
    pub batches: u64,
    /// Receivers gathered; the others were interpolated.
    pub gathers: u64,
    /// Entries of a cut: mean, standard deviation, smallest and largest.
    pub size_mean: f64,
    /// Standard deviation of the entries of a cut.
    pub size_deviation: f64,
    /// Fewest entries of a cut.
    pub size_min: u64,
    /// Most entries of a cut.
    pub size_max: u64,
    /// Mean nodes whose bounds were tested.
    pub nodes_visited_mean: f64,
    /// Mean nodes dropped with all below them because they were under the horizon.
    pub culled_horizon_mean: f64,
    /// Mean nodes dropped with all below them because all they could touch was opaque.
    pub culled_opaque_mean: f64,
    /// Seconds workers spent reading pages or waiting for them, summed over workers.
    pub wait_seconds: f64,
    /// Seconds workers waited for receivers, summed over workers.
    pub idle_seconds: f64,
}

impl CutReport {
    pub(crate) fn new(report: &ShadeReport) -> Self {
        let sizes = &report.cut_sizes;
        let mean = |sum: u64| sum as f64 / sizes.count.max(1) as f64;
        Self {
            batches: report.batches,
            gathers: sizes.count,
            size_mean: sizes.mean(),
            size_deviation: sizes.standard_deviation(),
            size_min: sizes.min(),
            size_max: sizes.max,
            nodes_visited_mean: mean(report.cut.nodes_visited),
            culled_horizon_mean: mean(report.cut.culled_horizon),
            culled_opaque_mean: mean(report.cut.culled_opaque),
            wait_seconds: report.wait_seconds(),
            idle_seconds: report.idle_seconds,
        }
    }

    /// As rows of a table: label and value.
    pub(crate) fn rows(&self) -> Vec<(String, String)> {
        let Self { size_mean, size_deviation, size_min, size_max, .. } = self;
        let sizes = format!("{size_mean:.1} ± {size_deviation:.1}, {size_min} to {size_max}");
        [
            ("batches", format_count(self.batches as f64)),
            ("cut size", sizes),
            ("nodes visited", format!("{:.1}", self.nodes_visited_mean)),
            ("culled below the horizon", format!("{:.1}", self.culled_horizon_mean)),
            ("culled as hidden", format!("{:.1}", self.culled_opaque_mean)),
            ("waiting for pages", format!("{:.2} s", self.wait_seconds)),
            ("waiting for receivers", format!("{:.2} s", self.idle_seconds)),
        ]
        .map(|(label, value)| (label.to_owned(), value))
        .into()
    }
}

/// Requests for pages from one level of the tree while shading. Pages of a leaf's surfels count to the level below its group; the last
/// level holds whatever is deeper.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LevelReport {
    /// The level; 0 is the root's.
    pub level: usize,
    /// Pages asked for.
    pub requests: u64,
    /// Pages that were read for it.
    pub misses: u64,
    /// Bytes of those.
    pub bytes_read: u64,
    /// Seconds spent reading them or waiting for others that did, summed over workers.
    pub wait_seconds: f64,
}

impl LevelReport {
    /// All levels down to the deepest that asked for a page.
    pub(crate) fn all(levels: &[LevelStats]) -> Vec<Self> {
        let used = levels.iter().rposition(|level| level.requests > 0).map_or(0, |last| last + 1);
        let report = |(level, stats): (usize, &LevelStats)| Self {
            level,
            requests: stats.requests,
            misses: stats.misses,
            bytes_read: stats.bytes_read,
            wait_seconds: stats.wait_ns as f64 * 1e-9,
        };
        levels[..used].iter().enumerate().map(report).collect()
    }

    /// As a row of a table: label and value.
    pub(crate) fn row(&self) -> (String, String) {
        let value = format!(
            "{} requests, {} misses, {} read, {:.3} s waiting",
            format_count(self.requests as f64),
            format_count(self.misses as f64),
            format_bytes(self.bytes_read),
            self.wait_seconds
        );
        (format!("level {}", self.level), value)
    }
}

/// What the page cache did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CacheReport {
    /// Pages asked for.
    pub requests: u64,
    /// Requests answered without reading the file.
    pub hits: u64,
    /// The others.
    pub misses: u64,
    /// Share of requests that did not read the file.
    pub hit_rate: f64,
    /// Pages read.
    pub pages_read: u64,
    /// Bytes read.
    pub bytes_read: u64,
    /// Different pages read at least once.
    pub distinct_pages: u64,
    /// Pages of the file that were never read: hidden from all receivers, below their horizons, or coarser nodes stood for them.
    pub untouched_pages: u64,
    /// Bytes of distinct pages read.
    pub distinct_bytes: u64,
    /// Bytes read ÷ bytes of distinct pages.
    pub read_amplification: f64,
    /// Pages dropped to make room.
    pub evictions: u64,
    /// Pages read again after they were dropped.
    pub rereads: u64,
    /// Requests that waited for another worker to read the page.
    pub waits: u64,
    /// Seconds workers waited for pages, whoever read them, summed over workers.
    pub wait_seconds: f64,
    /// Seconds of those spent reading, checking and decoding.
    pub read_seconds: f64,
    /// Most bytes of pages held at once.
    pub held_bytes_max: u64,
}

impl CacheReport {
    pub(crate) fn new(stats: &CacheStats, file_pages: u64) -> Self {
        Self {
            requests: stats.requests,
            hits: stats.hits,
            misses: stats.requests.saturating_sub(stats.hits),
            hit_rate: stats.hit_rate(),
            pages_read: stats.pages_read,
            bytes_read: stats.bytes_read,
            distinct_pages: stats.distinct_pages,
            untouched_pages: file_pages.saturating_sub(stats.distinct_pages),
            distinct_bytes: stats.distinct_bytes,
            read_amplification: stats.read_amplification(),
            evictions: stats.evictions,
            rereads: stats.rereads,
            waits: stats.waits,
            wait_seconds: stats.wait_ns as f64 * 1e-9,
            read_seconds: stats.read_ns as f64 * 1e-9,
            held_bytes_max: stats.held_bytes_max,
        }
    }

    /// As rows of a table: label and value.
    pub(crate) fn rows(&self) -> Vec<(String, String)> {
        let count = |count: u64| format_count(count as f64);
        let pages = self.distinct_pages + self.untouched_pages;
        [
            ("page requests", format!("{}, {} misses", count(self.requests), count(self.misses))),
            (
                "pages read",
                format!("{}, {} of them again", count(self.pages_read), count(self.rereads)),
            ),
            ("pages never read", format!("{} of {}", count(self.untouched_pages), count(pages))),
            ("pages dropped", count(self.evictions)),
            ("most held", format_bytes(self.held_bytes_max)),
        ]
        .map(|(label, value)| (label.to_owned(), value))
        .into()
    }
}
