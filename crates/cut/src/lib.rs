//! Picks the nodes of the octree that light a receiver: the cut.
//!
//! Walks the tree nearest first and tells a visitor what it takes. It asks a threshold how fine to go and must never know
//! what a raster, a BRDF or an image is.
#![forbid(unsafe_code)]

mod cluster;
mod metric;
mod pick;

pub use cluster::{Cluster, Piece};
pub use metric::{NodeSeen, Threshold, UniformThreshold};
pub use pick::{
    CutReceiver, CutScratch, CutStats, CutVisitor, LEVELS, LevelStats, OTHER_BIAS,
    OWN_SURFACE_COSINE, SurfelSeen, is_parallel_tile, mean_brightness, pick_cut,
};
