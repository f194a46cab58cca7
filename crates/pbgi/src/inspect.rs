//! What an octree file holds: its header, its pages counted.

use crate::PbgiError;
use crate::budget::bake::reader_cache_bytes;
use crate::figures::format_bytes;
use crate::figures::format_table;
use pbgi_format::{Channels, FORMAT_VERSION, Lobe, PageKind};
use pbgi_store::{Backend, Octree, OpenOptions, VerifyReport};
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// What header and page table of an octree file say.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OctreeInfo {
    /// The file.
    pub path: String,
    /// Version of the file format.
    pub format_version: u32,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Surfels.
    pub surfels: u64,
    /// Nodes, leaves included.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Pages.
    pub pages: u64,
    /// Most groups on a way from the root to a leaf.
    pub depth: u32,
    /// Most surfels of a leaf.
    pub leaf_surfels_max: u32,
    /// Largest decoded page in bytes.
    pub page_bytes_max: u32,
    /// Light channels: `rgb` or `none`.
    pub channels: &'static str,
    /// Whether surfels have an albedo.
    pub albedo: bool,
    /// Whether pages are compressed.
    pub compressed: bool,
    /// Whether some surfels have no normal.
    pub isotropic: bool,
    /// The upward axis: `+y` or `+z`.
    pub up: &'static str,
    /// Typical distance of surfels in scene units: √(area / count).
    pub spacing: f32,
    /// World position of the coordinate origin.
    pub origin: [f64; 3],
    /// Smallest corner of the box of all disks, in the world.
    pub bounds_min: [f64; 3],
    /// Largest corner of that box.
    pub bounds_max: [f64; 3],
    /// Edge of the root cube in scene units.
    pub cube_edge: f32,
    /// Area of all surfels, in scene units squared.
    pub area_total: f64,
    /// Σ area × radiance of all surfels, per channel.
    pub flux_total: [f64; 3],
    /// Bytes per surfel in pages of surfels.
    pub surfel_page_bytes_per_surfel: f64,
    /// Bytes per surfel in pages of nodes.
    pub node_page_bytes_per_surfel: f64,
    /// Bytes per surfel for header, page table and alignment.
    pub other_bytes_per_surfel: f64,
}

impl OctreeInfo {
    /// Reads header and page table.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or its header or page table is damaged.
    pub fn read(path: &Path, memory_limit: u64) -> Result<Self, PbgiError> {
        let octree = open(path, reader_cache_bytes(memory_limit))?;
        let header = octree.header();
        let world = |p: pbgi_math::Vec3| (p.as_dvec3() + header.origin).to_array();
        let table_bytes = header.page_count * pbgi_format::PAGE_ENTRY_BYTES as u64;
        // The header was checked against the file's size.
        let file_bytes = header.page_table_offset + table_bytes;
        let per_surfel = |bytes: u64| bytes as f64 / header.surfel_count as f64;
        let pages_of = |kind: PageKind| -> u64 {
            let of_kind = octree.pages().iter().filter(|page| page.kind == kind);
            of_kind.map(|page| u64::from(page.stored_bytes)).sum()
        };
        let (surfel_bytes, node_bytes) = (pages_of(PageKind::Surfels), pages_of(PageKind::Nodes));
        Ok(Self {
            path: path.display().to_string(),
            format_version: FORMAT_VERSION,
            file_bytes,
            surfels: header.surfel_count,
            nodes: header.node_count,
            leaves: header.leaf_count,
            pages: header.page_count,
            depth: header.depth,
            leaf_surfels_max: header.leaf_surfels_max,
            page_bytes_max: header.page_bytes_max,
            channels: if header.channels == Channels::Rgb { "rgb" } else { "none" },
            albedo: header.flags.albedo,
            compressed: header.flags.compressed,
            isotropic: header.flags.isotropic,
            up: if header.flags.z_up { "+z" } else { "+y" },
            spacing: header.spacing,
            origin: header.origin.to_array(),
            bounds_min: world(header.bounds.min),
            bounds_max: world(header.bounds.max),
            cube_edge: header.root.edge,
            area_total: header.area_total,
            flux_total: header.flux_total,
            surfel_page_bytes_per_surfel: per_surfel(surfel_bytes),
            node_page_bytes_per_surfel: per_surfel(node_bytes),
            other_bytes_per_surfel: per_surfel(
                file_bytes.saturating_sub(surfel_bytes + node_bytes),
            ),
        })
    }

    /// Labels and values, for [`format_table`].
    #[must_use]
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let triple = |v: [f64; 3]| format!("{} {} {}", v[0], v[1], v[2]);
        let yes = |b: bool| if b { "yes" } else { "no" }.to_owned();
        let (surfels, nodes, other) = (
            self.surfel_page_bytes_per_surfel,
            self.node_page_bytes_per_surfel,
            self.other_bytes_per_surfel,
        );
        let total = surfels + nodes + other;
        vec![
            ("file", format!("{}, {}", self.path, format_bytes(self.file_bytes))),
            ("format", format!("version {}", self.format_version)),
            ("surfels", self.surfels.to_string()),
            ("nodes", format!("{}, {} of them leaves", self.nodes, self.leaves)),
            (
                "pages",
                format!("{}, at most {}", self.pages, format_bytes(self.page_bytes_max.into())),
            ),
            ("depth", self.depth.to_string()),
            ("surfels per leaf", format!("at most {}", self.leaf_surfels_max)),
            (
                "bytes/surfel",
                format!(
                    "{total:.2} = surfel pages {surfels:.2} + node pages {nodes:.2} + other \
                     {other:.2}"
                ),
            ),
            ("light", self.channels.to_owned()),
            ("albedo", yes(self.albedo)),
            ("compressed", yes(self.compressed)),
            ("isotropic surfels", yes(self.isotropic)),
            ("up", self.up.to_owned()),
            ("spacing", self.spacing.to_string()),
            ("origin", triple(self.origin)),
            ("bounds min", triple(self.bounds_min)),
            ("bounds max", triple(self.bounds_max)),
            ("cube edge", self.cube_edge.to_string()),
            ("area", self.area_total.to_string()),
            ("area x radiance", triple(self.flux_total)),
        ]
    }
}

/// What reading the whole file found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OctreeCheck {
    /// By depth, from the root.
    pub levels: Vec<LevelInfo>,
    /// Leaves by number of surfels, from 0.
    pub leaf_sizes: Vec<u64>,
    /// Nodes by number of lobes, from 0.
    pub lobe_counts: Vec<u64>,
    /// Pages by decoded size in steps of 4 KiB.
    pub page_sizes: Vec<u64>,
    /// Bytes per surfel of the lobes: the nodes' directional part.
    pub directional_bytes_per_surfel: f64,
    /// Bytes read.
    pub bytes_read: u64,
    /// Seconds it took.
    pub seconds: f64,
}

/// What lies at one depth of the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LevelInfo {
    /// Groups.
    pub groups: u64,
    /// Leaves.
    pub leaves: u64,
    /// Surfels in those leaves.
    pub surfels: u64,
}

impl OctreeCheck {
    /// Reads every page once, on so many threads, and checks every invariant readers rely on. `tick` is told the bytes read.
    ///
    /// # Errors
    ///
    /// Names the first damage.
    pub fn read(
        path: &Path,
        backend: Backend,
        threads: usize,
        memory_limit: u64,
        tick: impl FnMut(u64),
    ) -> Result<Self, PbgiError> {
        let start = Instant::now();
        // Pages go past the cache, but they take as much.
        let cache_bytes = reader_cache_bytes(memory_limit);
        let options = OpenOptions { backend, cache_bytes, ..OpenOptions::default() };
        let octree = Octree::open(path, &options)?;
        let report = octree.verify(threads, tick)?;
        Ok(Self::new(&octree, &report, start.elapsed().as_secs_f64()))
    }

    fn new(octree: &Octree, report: &VerifyReport, seconds: f64) -> Self {
        let header = octree.header();
        let lobe_bytes = Lobe::stored_bytes(header.channels) as u64;
        let lobes: u64 = (0u64..).zip(report.lobe_counts).map(|(k, count)| k * count).sum();
        Self {
            levels: report
                .levels
                .iter()
                .map(|level| LevelInfo {
                    groups: level.groups,
                    leaves: level.leaves,
                    surfels: level.surfels,
                })
                .collect(),
            leaf_sizes: without_trailing_zeros(&report.leaf_sizes),
            lobe_counts: report.lobe_counts.to_vec(),
            page_sizes: without_trailing_zeros(&report.page_sizes),
            directional_bytes_per_surfel: (lobes * lobe_bytes) as f64 / header.surfel_count as f64,
            bytes_read: report.bytes_read,
            seconds,
        }
    }

    /// Bytes read per second.
    #[must_use]
    pub fn bytes_per_second(&self) -> f64 {
        self.bytes_read as f64 / self.seconds.max(1e-9)
    }

    /// Tables of levels, leaf sizes, lobes and page sizes, as text.
    #[must_use]
    pub fn histograms(&self) -> String {
        let mut text = String::from("level      groups      leaves     surfels\n");
        for (depth, level) in self.levels.iter().enumerate() {
            let LevelInfo { groups, leaves, surfels } = level;
            text += &format!("{depth:>5}  {groups:>10}  {leaves:>10}  {surfels:>10}\n");
        }
        text += "\nleaves by surfels\n";
        text += &histogram(&self.leaf_sizes, |i| i.to_string());
        text += "\nnodes by lobes\n";
        text += &histogram(&self.lobe_counts, |i| i.to_string());
        text += "\npages by size\n";
        text += &histogram(&self.page_sizes, |i| format!("{} to {} KiB", 4 * i, 4 * (i + 1)));
        text + &format!("\ndirectional bytes/surfel  {:.2}\n", self.directional_bytes_per_surfel)
    }
}

/// A line per class that is not empty: label, count, bar.
fn histogram(counts: &[u64], label: impl Fn(usize) -> String) -> String {
    const BAR_MAX: u64 = 40;
    let most = counts.iter().copied().max().unwrap_or(0).max(1);
    let bar = |count: u64| "#".repeat((count * BAR_MAX).div_ceil(most) as usize);
    let rows: Vec<(String, String)> = counts
        .iter()
        .enumerate()
        .filter(|(_, count)| **count > 0)
        .map(|(i, count)| (format!("  {}", label(i)), format!("{count:>10}  {}", bar(*count))))
        .collect();
    format_table(&rows)
}

fn without_trailing_zeros(counts: &[u64]) -> Vec<u64> {
    let len = counts.iter().rposition(|count| *count > 0).map_or(0, |last| last + 1);
    counts[..len].to_vec()
}

pub(crate) fn open(path: &Path, cache_bytes: u64) -> Result<Octree, PbgiError> {
    Ok(Octree::open(path, &OpenOptions { cache_bytes, ..OpenOptions::default() })?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_show_what_is_there() {
        let text = histogram(&[0, 1, 0, 80], |i| i.to_string());
        assert_eq!(text, format!("  1           1  #\n  3          80  {}\n", "#".repeat(40)));
        assert_eq!(without_trailing_zeros(&[0, 3, 0, 0]), [0, 3]);
        assert!(histogram(&[], |i| i.to_string()).is_empty());
    }
}
