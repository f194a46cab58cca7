//! Small rasters around a receiver that resolve occlusion: a cube of texels, and windows into it.
//!
//! Fills texels with what it is given, nearest first. It must never hear of an octree, open a file or start a thread.
#![deny(unsafe_code)]

mod cube;
mod footprint;
mod lamp;
mod lanes;
mod lobe;
mod samples;
mod shape;
mod simd;
mod table;
mod texel_bits;
mod texel_light;
mod tilt;
mod window;

pub use cube::{CubeRaster, FootprintCode, Ink, NO_FOOTPRINT_CODE, TexelChunk};
pub use lamp::{LAMPS, LampSeen, NO_LAMP};
pub use lanes::{Lanes, SAMPLES};
pub use lobe::{LobeInk, LobeRaster};
pub use samples::{SAMPLE_CELLS, SAMPLE_OF_CELL, Veil};
pub use shape::{Disk, Met, Place, Section, Shape, Tile, Triangle};
pub use simd::{SimdLevel, WideKernel, run_wide};
pub use table::{CubeRasterTable, LANES, row_stride};
pub use window::{Window, WindowRaster};

/// Numbers in −1..=1.
#[cfg(test)]
fn random(seed: &mut u32) -> f32 {
    *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*seed >> 8) as f32 / (1 << 23) as f32 - 1.0
}
