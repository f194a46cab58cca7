//! Geometry and arithmetic that every other crate of the engine rests on.
//!
//! Arithmetic only. This crate must never open a file, start a thread, read a clock or hold a global.
#![forbid(unsafe_code)]

mod bounds;
mod cube;
mod frame;
mod morton;
mod octahedral;
mod rgbe;
mod section;
mod sh;
mod silhouette;
mod solid_angle;
mod stencil;
mod tile;

pub use bounds::{Aabb, Cone};
pub use cube::{CubeFace, CubeMap, CubeTexel};
pub use frame::Frame;
pub use glam::{Affine3A, DMat3, DMat4, DVec2, DVec3, DVec4, Mat3, Mat4, Quat, Vec2, Vec3, Vec4};
pub use morton::{MORTON_AXIS_BITS, MortonCode, RootCube};
pub use octahedral::{
    OCTAHEDRAL20_ERROR, OCTAHEDRAL24_ERROR, decode_octahedral, decode_octahedral20,
    decode_octahedral24, encode_octahedral, encode_octahedral24, narrow_octahedral24,
};
pub use rgbe::SharedExponent;
pub use section::{central_section_area, section_area, thick_half};
pub use sh::{SH_COUNT, Sh9, clamped_cosine_sh, evaluate_sh_basis};
pub use silhouette::box_silhouette;
pub use solid_angle::{patch_solid_angle_factor, sphere_sin2_for_solid_angle, sphere_solid_angle};
pub use stencil::{STENCIL_EDGE, Stencil, StencilSum, stencil_axis};
pub use tile::{
    FootCode, TileCode, rectangle_half_edges, triangle_base, triangle_corners, triangle_radius,
};

/// The larger of two numbers; one instruction where `f32::max` takes three, for inputs that are never NaN.
#[must_use]
#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers; see [`larger`].
#[must_use]
#[inline(always)]
pub fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Scrambles all bits of a number: a bijection whose every output bit depends on every input bit.
#[must_use]
#[inline(always)]
pub fn scramble(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Relative luminance of linear Rec. 709 RGB.
#[must_use]
#[inline]
pub fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}
