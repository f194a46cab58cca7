//! A surfel as a leaf stores it, and the codes of its colors.

use crate::{Channels, MiniFloat};
use pbgi_math::{TileCode, Vec3};

/// A decoded surfel of a leaf.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeafSurfel {
    /// Center relative to the file's origin.
    pub center: Vec3,
    /// Unit normal; meaningless when isotropic.
    pub normal: Vec3,
    /// Radius of the covering disk; half the diagonal of a rectangle.
    pub radius: f32,
    /// True area.
    pub area: f32,
    /// Direction of the long edge of the rectangle the surfel stands for, if one is known.
    pub tile: TileCode,
    /// Half the long edge; 0 where no rectangle is known.
    pub half_long: f32,
    /// Radiance of the front, W·m⁻²·sr⁻¹.
    pub radiance: [f32; 3],
    /// Diffuse albedo, 0 where the file stores none.
    pub albedo: [f32; 3],
    /// Shows half its area to every direction.
    pub isotropic: bool,
    /// Blocks and shines on its front only.
    pub front_only: bool,
}

impl LeafSurfel {
    /// Half the long and half the short edge of a known rectangle.
    #[must_use]
    #[inline(always)]
    pub fn half_edges(&self) -> [f32; 2] {
        [self.half_long, 0.25 * self.area / self.half_long]
    }
}

/// How the surfels of one file are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfelLayout {
    /// Light channels.
    pub channels: Channels,
    /// Whether albedo is stored.
    pub albedo: bool,
    /// Codec of radii.
    pub radius: MiniFloat,
    /// Codec of areas, of surfels and lobes alike.
    pub area: MiniFloat,
    /// Stored radiance is a multiple of this.
    pub radiance_scale: f32,
}

/// Codec of a channel's radiance over the file's radiance scale.
pub(crate) const RADIANCE: MiniFloat = MiniFloat { exponent_max: 16 };

/// Codec of the square of a surfel's size over its area.
pub(crate) const SIZE_RATIO: MiniFloat = MiniFloat { exponent_max: 32 };

/// Code of a channel's albedo, 0..=1: 255 times its square root.
#[inline(always)]
pub(crate) fn encode_albedo(albedo: f32) -> u8 {
    (albedo.clamp(0.0, 1.0).sqrt() * 255.0 + 0.5) as u8
}

/// Albedo of a code.
#[inline(always)]
pub(crate) fn decode_albedo(code: u32) -> f32 {
    let root = code.min(255) as f32 * (1.0 / 255.0);
    root * root
}
