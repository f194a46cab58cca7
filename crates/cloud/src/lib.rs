//! The surfel, and reading and writing of point clouds as streams of surfels.
//!
//! Readers yield bounded chunks; none holds a whole cloud. This crate must never know how surfels are sorted, stored or lit.
#![forbid(unsafe_code)]

mod ply;
mod source;
mod surfel;

pub use ply::{PlyElement, PlyFormat, PlyHeader, PlyKind, PlyProperty, PlyReader, PlyRow, PlyType};
pub use source::{CloudError, SliceSource, SurfelSource};
pub use surfel::{Surfel, SurfelFlags};
