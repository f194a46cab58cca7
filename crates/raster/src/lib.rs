//! Small rasters around a receiver that resolve occlusion: a cube of texels, and windows into it.
//!
//! Fills texels with what it is given, nearest first. It must never hear of an octree, open a file or start a thread.
#![deny(unsafe_code)]

mod cube;
mod disk;
mod footprint;
mod simd;
mod window;

pub use cube::{CubeRaster, CubeRasterTable, LANES, Splat, TexelChunk};
pub use disk::{Disk, DiskInk};
pub use footprint::{FaceRectangle, project_box};
pub use simd::{SimdLevel, run_wide};
pub use window::{Window, WindowRaster};

/// The larger of two numbers; one instruction where `f32::max` takes three, for inputs that are never NaN.
#[inline(always)]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers; see [`larger`].
#[inline(always)]
pub(crate) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
