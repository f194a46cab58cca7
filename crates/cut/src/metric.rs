//! When a node is small enough to stand for its surfels.

use pbgi_math::{Vec3, sphere_sin2_for_solid_angle};

/// How large a node may be to be taken as one.
pub trait Threshold {
    /// Largest `r²/d²` (squared sine of the half-angle) of the bounding sphere of a node that is taken as one, below 1.
    /// `to_center` leads from the receiver to the sphere's center, `distance2` is its squared
    /// length, `radius2` the sphere's squared radius.
    fn sin2_max(&self, to_center: Vec3, distance2: f32, radius2: f32) -> f32;
}

/// The same largest solid angle in every direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UniformThreshold {
    sin2_max: f32,
}

impl UniformThreshold {
    /// Nodes whose bounding sphere subtends at most `solid_angle_sr` are taken as one; 0 goes down
    /// to the surfels.
    #[must_use]
    pub fn new(solid_angle_sr: f32) -> Self {
        Self::from_sine(sphere_sin2_for_solid_angle(solid_angle_sr).sqrt())
    }

    /// Nodes whose bounding sphere has a half-angle with at most this sine.
    #[must_use]
    pub fn from_sine(sine: f32) -> Self {
        // At 1, receivers inside the bounding sphere would be let through.
        Self { sin2_max: (sine * sine).min(0.9) }
    }
}

impl Threshold for UniformThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: Vec3, _: f32, _: f32) -> f32 {
        self.sin2_max
    }
}
