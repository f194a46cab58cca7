//! What a band of a picture shows.

use pbgi_gather::Material;
use pbgi_math::Vec3;
use pbgi_scene::{Coverage, Micropolygon};

/// A visible piece of surface: a micropolygon or a surfel. Positions are relative to the frame's
/// origin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    pub position: Vec3,
    /// Unit normal to shade with, toward the camera.
    pub normal: Vec3,
    /// Unit normal of its plane.
    pub plane: Vec3,
    pub radius: f32,
    pub albedo: [f32; 3],
    pub material: Material,
    pub emission: [f32; 3],
    /// Whether it is the back of a single-sided surface.
    pub is_back: bool,
}

impl From<&Micropolygon> for Piece {
    fn from(m: &Micropolygon) -> Self {
        Self {
            position: m.position,
            normal: m.normal,
            plane: m.geometric_normal,
            radius: m.radius,
            albedo: m.albedo,
            material: Material {
                base_color: m.base_color,
                metalness: m.metalness,
                roughness: m.roughness,
                specular: m.specular,
            },
            emission: m.emission,
            is_back: m.back,
        }
    }
}

/// What a band of the image shows.
pub(crate) struct Band {
    pub pieces: Vec<Piece>,
    /// Of surfels, their numbers in the file; empty for micropolygons, which no two bands share.
    pub ids: Vec<u64>,
    pub coverage: Coverage,
}
