//! A surfel as a leaf stores it, and the codes of its colors.

use crate::{Channels, MiniFloat};
use pbgi_math::{FootCode, TileCode, Vec3, triangle_corners};

/// A decoded surfel of a leaf.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeafSurfel {
    /// Center relative to the file's origin.
    pub center: Vec3,
    /// Unit normal; meaningless when isotropic.
    pub normal: Vec3,
    /// Radius of the covering disk: the distance of the farthest corner of a rectangle or triangle.
    pub radius: f32,
    /// True area.
    pub area: f32,
    /// Direction of the longest edge of the rectangle or triangle the surfel stands for, if one is known.
    pub tile: TileCode,
    /// Where the foot of a triangle's height is; none of a rectangle.
    pub foot: FootCode,
    /// Half the longest edge; 0 where none is known.
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
    /// Whether it stands for a rectangle.
    #[must_use]
    #[inline(always)]
    pub fn is_rectangle(&self) -> bool {
        self.tile.is_known() && !self.foot.is_known()
    }

    /// Whether it stands for a triangle.
    #[must_use]
    #[inline(always)]
    pub fn is_triangle(&self) -> bool {
        self.foot.is_known()
    }

    /// Corners of a known triangle from its center, counterclockwise seen against the normal.
    #[must_use]
    #[inline(always)]
    pub fn corners(&self) -> [Vec3; 3] {
        let [along, left] = self.tile.axes(self.normal);
        triangle_corners(2.0 * self.half_long, self.area / self.half_long, self.foot.share())
            .map(|[x, y]| along * x + left * y)
    }

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
