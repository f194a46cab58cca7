//! One pass from sorted surfels to the octree file.
//!
//! Receives a stream in Morton order and must never know how it was sorted; holds the open path of the octree and the
//! page being packed, whatever the number of surfels.
#![forbid(unsafe_code)]

mod aggregate;
mod error;
mod leaves;
mod open_path;
mod pack;
mod writer;

pub use aggregate::{LobeSum, NodeAggregate};
pub use error::BuildError;
pub use open_path::build_octree;

use pbgi_cloud::Surfel;
use pbgi_math::{DVec3, MortonCode, RootCube};
use std::sync::atomic::AtomicBool;

/// Why a sorted stream failed, whatever it is.
pub type StreamError = Box<dyn std::error::Error + Send + Sync>;

/// Surfels in the order of their Morton codes, ties in input order.
pub trait SortedStream: Send {
    /// Appends the next surfels with their codes to `out`; `false` when there are no more.
    ///
    /// # Errors
    ///
    /// If the stream cannot be read on.
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError>;
}

/// What the whole stream will hold, known before its first surfel. None of the fields depends on the order of
/// summation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamSummary {
    /// Cube the codes refer to.
    pub root: RootCube,
    /// World position of the coordinate origin.
    pub origin: DVec3,
    /// Surfels, at least 1.
    pub surfel_count: u64,
    /// Largest covering radius.
    pub radius_max: f32,
    /// Largest area.
    pub area_max: f32,
    /// Largest radiance of any channel; 0 where nothing shines.
    pub radiance_max: f32,
    /// Whether any albedo is above 0.
    pub any_albedo: bool,
    /// Whether any surfel is isotropic.
    pub any_isotropic: bool,
    /// +Z is up; +Y otherwise.
    pub z_up: bool,
}

/// Which light channels to store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChannelChoice {
    /// RGB where any surfel shines, none otherwise.
    #[default]
    AsNeeded,
    /// None, even where surfels shine.
    Occlusion,
}

/// How to build.
#[derive(Clone, Copy)]
pub struct BuildOptions<'a> {
    /// Bytes a page aims at, before compression; 4 KiB to 1 MiB.
    pub page_bytes: usize,
    /// Most surfels of a leaf, 1 to 255.
    pub leaf_surfels_max: usize,
    /// Compress pages with LZ4 where that makes them smaller.
    pub compress: bool,
    /// Which light to store.
    pub channels: ChannelChoice,
    /// Store albedo where any is given.
    pub albedo: bool,
    /// Threads: with two or more, one cuts leaves while another builds on them.
    pub threads: usize,
    /// Set from outside to stop.
    pub cancel: &'a AtomicBool,
    /// Told the number of surfels done, now and then.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

/// Smallest and largest [`BuildOptions::page_bytes`].
pub const PAGE_BYTES_RANGE: std::ops::RangeInclusive<usize> = 4096..=(1 << 20);

static NEVER: AtomicBool = AtomicBool::new(false);

impl Default for BuildOptions<'_> {
    fn default() -> Self {
        Self {
            page_bytes: 64 << 10,
            leaf_surfels_max: 16,
            compress: false,
            channels: ChannelChoice::AsNeeded,
            albedo: true,
            threads: 1,
            cancel: &NEVER,
            progress: &|_| {},
        }
    }
}

/// What was built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BuildReport {
    /// Surfels.
    pub surfels: u64,
    /// Nodes, leaves included.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Pages.
    pub pages: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes of stored surfels.
    pub surfel_bytes: u64,
    /// Bytes of groups without their lobes.
    pub node_hot_bytes: u64,
    /// Bytes of lobes.
    pub lobe_bytes: u64,
    /// Everything else: headers, links, alignment, page table (negative where LZ4 saves more).
    pub overhead_bytes: i64,
}
