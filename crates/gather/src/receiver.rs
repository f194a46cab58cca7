//! What is shaded, and what comes out.

use pbgi_brdf::Material;
use pbgi_math::Vec3;

/// A place to gather light for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Receiver {
    /// Position relative to the octree's origin.
    pub position: Vec3,
    /// Unit normal it is shaded with.
    pub normal: Vec3,
    /// Unit normal of the surface it lies on, which hides what is below.
    pub plane: Vec3,
    /// What it reflects glossily and toward whom; nothing for a receiver of diffuse light alone.
    pub gloss: Option<Gloss>,
}

impl Receiver {
    /// A receiver of diffuse light alone, on a surface whose normal is that it is shaded with.
    #[must_use]
    pub fn diffuse(position: Vec3, normal: Vec3) -> Self {
        Self { position, normal, plane: normal, gloss: None }
    }
}

/// What a receiver reflects glossily, and toward whom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gloss {
    /// The surface.
    pub material: Material,
    /// Unit direction to the eye. Below the receiver's horizon nothing is seen of it.
    pub toward_eye: Vec3,
}

/// What a receiver gathers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shading {
    /// Irradiance from surfaces (emitted and reflected by surfels), W·m⁻².
    pub surface_irradiance: [f32; 3],
    /// Irradiance from the environment, W·m⁻².
    pub environment_irradiance: [f32; 3],
    /// Cosine-weighted share of the hemisphere that is open.
    pub ambient_occlusion: f32,
    /// Share of the sky's hemisphere that is open.
    pub sky_visibility: f32,
    /// Mean open direction.
    pub bent_normal: Vec3,
    /// Radiance reflected glossily toward the eye, W·m⁻²·sr⁻¹; 0 for a receiver without gloss.
    pub reflected: [f32; 3],
    /// What the gloss would reflect of uniform light, 0..=1: what a diffuse base below it does not get.
    pub gloss_albedo: [f32; 3],
    /// Share of the raster's samples over the horizon in which a black back is seen first: 1 inside of something solid; 0 unless
    /// [`crate::GatherSettings::finds_backs`] asks for it.
    pub backs: f32,
    /// Entries of the cut.
    pub cut_size: u32,
}

impl Shading {
    /// Irradiance from everything, W·m⁻².
    #[must_use]
    pub fn irradiance(&self) -> [f32; 3] {
        std::array::from_fn(|c| self.surface_irradiance[c] + self.environment_irradiance[c])
    }
}
