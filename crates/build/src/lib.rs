//! One pass from sorted surfels to the octree file.
//!
//! Receives a stream in Morton order, or pieces of one, and must never know how it was sorted. Whole cells of a piece become subtrees, on
//! any thread; they are joined along the open path of the octree. The file is the same for any division into pieces.
#![forbid(unsafe_code)]

mod aggregate;
mod clumping;
mod crowd;
mod error;
mod items;
mod lobe_sum;
mod loose;
mod octree;
mod outline;
mod pack;
mod pages;
mod pieces;
mod reduce;
mod stitch;
mod tree;
mod writer;

pub use aggregate::NodeAggregate;
pub use error::BuildError;
pub use lobe_sum::LobeSum;
pub use octree::{build_octree, build_octree_from_pieces};
pub use outline::{NarrowOutline, Outline, Outlines};
pub use reduce::LobeSums;

use pbgi_cloud::Surfel;
pub use pbgi_format::LeafRounding;
use pbgi_math::{DVec3, MortonCode, RootCube};
use std::ops::Range;
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

/// Surfels next to each other in the sorted stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Piece {
    /// Codes in ascending order.
    pub codes: Vec<MortonCode>,
    /// Surfels of these codes, equal codes in input order.
    pub surfels: Vec<Surfel>,
    /// Codes of which no other piece holds a surfel; this one may hold others.
    pub whole: Range<u64>,
}

/// Makes a piece, where there is a thread for it.
pub type PieceTask = Box<dyn FnOnce() -> Piece + Send>;

/// Pieces of the sorted stream in their order.
pub trait PieceSource: Send {
    /// The next piece; `None` at the end.
    ///
    /// # Errors
    ///
    /// If the stream cannot be read on.
    fn next_piece(&mut self) -> Result<Option<PieceTask>, StreamError>;
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
    /// How much leaves round what they store.
    pub rounding: LeafRounding,
    /// Compress pages with LZ4 where that makes them smaller.
    pub compress: bool,
    /// Which light to store.
    pub channels: ChannelChoice,
    /// Store albedo where any is given.
    pub albedo: bool,
    /// Threads that build pieces; with one, everything is done by the caller's.
    pub threads: usize,
    /// Pieces that may be prepared, built or wait at once, where there are several threads.
    pub pieces_in_flight: usize,
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
            leaf_surfels_max: 32,
            rounding: LeafRounding::Compact,
            compress: false,
            channels: ChannelChoice::AsNeeded,
            albedo: true,
            threads: 1,
            pieces_in_flight: 4,
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
    /// Surfels that shine, but about 10¹⁰ times less than the brightest: clusters of them lose light.
    pub dim_surfels: u64,
}
