//! The surfel: an oriented, lit disk standing for a piece of surface.

use bytemuck::{Pod, Zeroable};
use half::f16;
use pbgi_math::{
    FootCode, TileCode, Vec3, decode_octahedral24, encode_octahedral24, rectangle_half_edges,
    triangle_base, triangle_corners, triangle_radius,
};

/// Bits of [`Surfel::flags`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub struct SurfelFlags(pub u16);

impl SurfelFlags {
    /// No normal is known: the surfel shows the same area and radiance to every direction.
    pub const ISOTROPIC: Self = Self(1);
    /// Blocks and shines on its front side only. A double-sided sheet is two such surfels back to
    /// back, so that each side has its own light and the sheet blocks once. Without this flag a
    /// surfel blocks light from both sides and its back is black.
    pub const FRONT_ONLY: Self = Self(2);
    /// It lies inside of something solid, where nobody sees its light. What finds out while it lights surfels says so to what sums them; no file has it.
    pub const BURIED: Self = Self(4);
    /// Bits of the [`FootCode`] of the triangle a surfel stands for.
    const FOOT: Self = Self((FootCode::MAX as u16) << FOOT_SHIFT);
    /// All bits that have a meaning in files.
    pub const KNOWN: Self = Self(Self::ISOTROPIC.0 | Self::FRONT_ONLY.0 | Self::FOOT.0);

    /// Whether all bits of `other` are set.
    #[must_use]
    #[inline]
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Both sets of bits.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// An oriented disk: position, normal, radius, area, outgoing radiance and albedo. 44 bytes, plain
/// data, the record of sorting and of streams.
///
/// Two radii do their work: `radius` covers the piece of surface the surfel stands for, so that near disks leave
/// no holes; `area` is the true area, so that energy is exact however much disks overlap. A surfel may know the rectangle or triangle it
/// stands for ([`Surfel::with_tile`], [`Surfel::with_triangle`]): its edges follow from its area and from `radius`, the distance of its
/// farthest corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Surfel {
    /// Center relative to the cloud's origin, in scene units.
    pub position: [f32; 3],
    /// Radius of the covering disk, in scene units, above 0.
    pub radius: f32,
    /// Area of the surface the surfel stands for, in scene units squared, above 0. An isotropic surfel shows half of it
    /// to every direction (the mean over orientations of a two-sided disk).
    pub area: f32,
    /// Bits 0–23: the unit normal ([`pbgi_math::encode_octahedral24`]). Bits 24–31: direction of the longest edge of the
    /// rectangle or triangle the surfel stands for ([`TileCode`]), 0 where none is known.
    pub orientation: u32,
    /// Radiance leaving the front, W·m⁻²·sr⁻¹, linear Rec. 709.
    pub radiance: [f32; 3],
    /// Diffuse albedo, 0..=1, linear Rec. 709.
    pub albedo: [f16; 3],
    /// See [`SurfelFlags`]; bits 8–14 tell of triangles ([`FootCode`]).
    pub flags: SurfelFlags,
}

impl Surfel {
    /// A surfel of an opaque surface: blocks both sides, shines from the front, albedo 0.
    #[must_use]
    pub fn new(position: Vec3, normal: Vec3, radius: f32, area: f32) -> Self {
        Self {
            position: position.to_array(),
            radius,
            area,
            orientation: encode_octahedral24(normal),
            ..Self::default()
        }
    }

    /// The same with another radiance.
    #[must_use]
    pub fn with_radiance(mut self, radiance: [f32; 3]) -> Self {
        self.radiance = radiance;
        self
    }

    /// The same with another albedo.
    #[must_use]
    pub fn with_albedo(mut self, albedo: [f32; 3]) -> Self {
        self.albedo = albedo.map(f16::from_f32);
        self
    }

    /// The same with more flags.
    #[must_use]
    pub fn with_flags(mut self, flags: SurfelFlags) -> Self {
        self.flags = self.flags.with(flags);
        self
    }

    /// The same, standing for a rectangle of the surfel's area whose long edge, `aspect` ≥ 1 times the short one, has the
    /// direction `long_edge` in the surfel's plane. The radius becomes half the diagonal.
    #[must_use]
    pub fn with_tile(mut self, long_edge: Vec3, aspect: f32) -> Self {
        let code = TileCode::from_direction(self.normal(), long_edge);
        self.orientation = self.orientation & NORMAL_BITS | u32::from(code.0) << TILE_SHIFT;
        self.flags.0 &= !SurfelFlags::FOOT.0;
        self.radius = 0.5 * (self.area * (aspect + 1.0 / aspect)).sqrt();
        self
    }

    /// The same, standing for a triangle of the surfel's area around its center, whose longest edge is `base`; its third corner lies to the left of
    /// that, seen against the normal, over the share `foot` of it. The radius becomes the distance of the farthest corner.
    #[must_use]
    pub fn with_triangle(mut self, base: Vec3, foot: f32) -> Self {
        let code = TileCode::from_sense(self.normal(), base);
        let foot = FootCode::from_share(foot);
        self.orientation = self.orientation & NORMAL_BITS | u32::from(code.0) << TILE_SHIFT;
        let foot_bits = u16::from(foot.0) << FOOT_SHIFT;
        self.flags.0 = self.flags.0 & !SurfelFlags::FOOT.0 | foot_bits;
        self.radius = triangle_radius(base.length(), self.area, foot.share());
        self
    }

    /// Center.
    #[must_use]
    #[inline]
    pub fn center(&self) -> Vec3 {
        Vec3::from_array(self.position)
    }

    /// Unit normal; meaningless for an isotropic surfel.
    #[must_use]
    #[inline]
    pub fn normal(&self) -> Vec3 {
        decode_octahedral24(self.orientation)
    }

    /// Direction of the longest edge of the surfel's rectangle or triangle, if one is known.
    #[must_use]
    #[inline]
    pub fn tile(&self) -> TileCode {
        let code = TileCode((self.orientation >> TILE_SHIFT) as u8);
        if self.is_isotropic() { TileCode::NONE } else { code }
    }

    /// Where the foot of the height of the surfel's triangle is, if it stands for one.
    #[must_use]
    #[inline]
    pub fn foot(&self) -> FootCode {
        let code = FootCode((self.flags.0 >> FOOT_SHIFT) as u8 & FootCode::MAX);
        if self.tile().is_known() { code } else { FootCode::NONE }
    }

    /// Half the long edge of the surfel's rectangle, or half the longest of its triangle; 0 if neither is known.
    #[must_use]
    pub fn half_long(&self) -> f32 {
        match (self.tile().is_known(), self.foot()) {
            (false, _) => 0.0,
            (true, FootCode::NONE) => rectangle_half_edges(self.radius, self.area)[0],
            (true, foot) => 0.5 * triangle_base(self.radius, self.area, foot.share()),
        }
    }

    /// Half the long and half the short edge of the rectangle, as vectors, if one is known.
    #[must_use]
    pub fn half_edges(&self) -> Option<[Vec3; 2]> {
        let tile = self.tile();
        (tile.is_known() && !self.foot().is_known()).then(|| {
            let [long, short] = rectangle_half_edges(self.radius, self.area);
            let [tangent, bitangent] = tile.edges(self.normal());
            [tangent * long, bitangent * short]
        })
    }

    /// Corners of the triangle from its center, if one is known, counterclockwise seen against the normal.
    #[must_use]
    pub fn corners(&self) -> Option<[Vec3; 3]> {
        let foot = self.foot();
        foot.is_known().then(|| {
            let base = 2.0 * self.half_long();
            let [along, left] = self.tile().axes(self.normal());
            triangle_corners(base, 2.0 * self.area / base, foot.share())
                .map(|[x, y]| along * x + left * y)
        })
    }

    /// Albedo in f32.
    #[must_use]
    pub fn albedo_rgb(&self) -> [f32; 3] {
        self.albedo.map(f16::to_f32)
    }

    /// Whether the surfel has no normal.
    #[must_use]
    #[inline]
    pub fn is_isotropic(&self) -> bool {
        self.flags.contains(SurfelFlags::ISOTROPIC)
    }

    /// Whether the surfel blocks and shines on its front only.
    #[must_use]
    #[inline]
    pub fn is_front_only(&self) -> bool {
        self.flags.contains(SurfelFlags::FRONT_ONLY)
    }
}

/// Bits of [`Surfel::orientation`] that hold the normal.
const NORMAL_BITS: u32 = 0xff_ffff;

/// Place of the tile's code in [`Surfel::orientation`].
const TILE_SHIFT: u32 = 24;

/// Place of the foot's code in [`Surfel::flags`].
const FOOT_SHIFT: u32 = 8;

const _: () = assert!(size_of::<Surfel>() == 44 && align_of::<Surfel>() == 4);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_keep_normal_area_and_shape() {
        let normal = Vec3::new(0.3, -0.8, 0.2).normalize();
        let plain = Surfel::new(Vec3::ONE, normal, 9.0, 0.02);
        assert_eq!(plain.half_edges(), None);
        let direction = normal.cross(Vec3::X);
        for aspect in [1.0, 1.2, 4.0] {
            let surfel = plain.with_tile(direction, aspect);
            assert_eq!(surfel.normal(), plain.normal());
            assert_eq!(surfel.area, plain.area);
            let [long, short] = surfel.half_edges().unwrap();
            assert!((4.0 * long.length() * short.length() / 0.02 - 1.0).abs() < 1e-5);
            assert!((long.length() / short.length() / aspect - 1.0).abs() < 2e-3);
            assert!((long + short).length() <= surfel.radius * 1.00001);
            assert!(long.normalize().dot(direction.normalize()).abs() > 0.9999);
        }
        for (height, foot) in [(0.8, 0.5), (0.1, 0.0), (0.3, 0.75)] {
            let base = direction.normalize() * (2.0f32 * 0.02 / height).sqrt();
            let surfel = plain.with_tile(direction, 2.0).with_triangle(base, foot);
            assert_eq!((surfel.normal(), surfel.area), (plain.normal(), plain.area));
            assert_eq!(surfel.half_edges(), None);
            let [a, b, c] = surfel.corners().unwrap();
            assert!((2.0 * surfel.half_long() / base.length() - 1.0).abs() < 1e-3);
            assert!((b - a - base).length() < 0.014 * base.length());
            let left = normal.cross(base);
            let apex = base * foot + left * height;
            assert!((c - a - apex).length() < 0.02 * base.length(), "{} {apex}", c - a);
            assert!((a + b + c).length() < 1e-4);
            let reach = [a, b, c].map(Vec3::length).into_iter().fold(0.0, f32::max);
            assert!((reach / surfel.radius - 1.0).abs() < 1e-4);
            assert!(surfel.with_tile(direction, 2.0).corners().is_none());
        }
        let round = plain.with_triangle(direction, 0.5).with_flags(SurfelFlags::ISOTROPIC);
        assert_eq!((round.half_edges(), round.corners(), round.half_long()), (None, None, 0.0));
    }
}
