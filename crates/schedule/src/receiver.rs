//! What is shaded, and what comes out.

use pbgi_math::Vec3;

/// A place to gather light for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Receiver {
    /// Position relative to the octree's origin.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
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
