//! Picks the nodes of the octree that light a receiver: the cut.
//!
//! Walks the tree nearest first and tells a visitor what it takes. It asks a threshold how fine to go and must never know
//! what a raster, a BRDF or an image is.
#![forbid(unsafe_code)]

mod cluster;
mod group;
mod known;
mod leaf;
mod lobe;
mod metric;
mod node;
mod own_surface;
mod stats;
mod surfel;
mod walk;

pub use cluster::{Cluster, Piece};
pub use group::Boxes;
pub use known::{KNOWN_BYTES, NodeReader};
pub use metric::{NodeSeen, Threshold, UniformThreshold};
pub use own_surface::lies_on_disks;
pub use stats::{CutStats, LEVELS, LevelStats};
pub use surfel::{CutSurfel, RECTANGLE_RIM, SurfelShape, TRIANGLE_RIM};
pub use walk::{CutReceiver, CutScratch, CutVisitor, Kept, NOTHING_KEPT, SurfelSeen, pick_cut};
