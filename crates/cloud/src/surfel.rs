//! The surfel: an oriented, lit disk standing for a piece of surface.

use bytemuck::{Pod, Zeroable};
use half::f16;
use pbgi_math::{Vec3, decode_octahedral, encode_octahedral};

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
/// no holes; `area` is the true area, so that energy is exact however much disks overlap.
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
    /// Octahedral code of the unit normal ([`pbgi_math::encode_octahedral`]).
    pub normal_code: u32,
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
            normal_code: encode_octahedral(normal),
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
        decode_octahedral(self.normal_code)
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

const _: () = assert!(size_of::<Surfel>() == 44 && align_of::<Surfel>() == 4);
