//! The surfel: an oriented, lit disk standing for a piece of surface.

use bytemuck::{Pod, Zeroable};
use half::f16;
use pbgi_math::{TileCode, Vec3, decode_octahedral24, encode_octahedral24, rectangle_half_edges};

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
    /// All bits that have a meaning.
    pub const KNOWN: Self = Self(Self::ISOTROPIC.0 | Self::FRONT_ONLY.0);

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
/// no holes; `area` is the true area, so that energy is exact however much disks overlap. A surfel may know the rectangle it
/// stands for ([`Surfel::with_tile`]): its edges follow from its area and from `radius`, half its diagonal.
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
    /// Bits 0–23: the unit normal ([`pbgi_math::encode_octahedral24`]). Bits 24–31: direction of the long edge of the
    /// rectangle the surfel stands for ([`TileCode`]), 0 where none is known.
    pub orientation: u32,
    /// Radiance leaving the front, W·m⁻²·sr⁻¹, linear Rec. 709.
    pub radiance: [f32; 3],
    /// Diffuse albedo, 0..=1, linear Rec. 709.
    pub albedo: [f16; 3],
    /// See [`SurfelFlags`].
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
        self.radius = 0.5 * (self.area * (aspect + 1.0 / aspect)).sqrt();
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

    /// Direction of the long edge of the surfel's rectangle, if one is known.
    #[must_use]
    #[inline]
    pub fn tile(&self) -> TileCode {
        let code = TileCode((self.orientation >> TILE_SHIFT) as u8);
        if self.is_isotropic() { TileCode::NONE } else { code }
    }

    /// Half the long and half the short edge of the rectangle, as vectors, if one is known.
    #[must_use]
    pub fn half_edges(&self) -> Option<[Vec3; 2]> {
        let tile = self.tile();
        tile.is_known().then(|| {
            let [long, short] = rectangle_half_edges(self.radius, self.area);
            let [tangent, bitangent] = tile.edges(self.normal());
            [tangent * long, bitangent * short]
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
        let round = plain.with_tile(direction, 2.0).with_flags(SurfelFlags::ISOTROPIC);
        assert_eq!(round.half_edges(), None);
    }
}
