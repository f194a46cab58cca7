//! When a node is small enough to stand for its surfels.

use pbgi_math::{Vec3, sphere_sin2_for_solid_angle};

/// How large a node may be to be taken as one.
pub trait Threshold {
    /// Largest `r²/d²` (squared sine of the half-angle) of the bounding sphere of a node that is taken as one, below 1.
    fn sin2_max(&self, node: &NodeSeen) -> f32;
}

/// What a threshold may know of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeSeen {
    /// From the receiver to the center of the node's bounding sphere.
    pub to_center: Vec3,
    /// Its squared length.
    pub distance2: f32,
    /// The sphere's squared radius.
    pub radius2: f32,
    /// Whether the node's surfels are one piece of a plane, which as one look as they do singly.
    pub is_plane: bool,
}

/// The same largest half-angle in every direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UniformThreshold {
    sin2_max: f32,
}

impl UniformThreshold {
    /// Nodes whose bounding sphere has a half-angle with at most this sine.
    #[must_use]
    pub fn from_sine(sine: f32) -> Self {
        // At 1, receivers inside the bounding sphere would be let through.
        Self { sin2_max: (sine * sine).min(0.9) }
    }
}

impl Threshold for UniformThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: &NodeSeen) -> f32 {
        self.sin2_max
    }
}

/// A threshold for diffuse receivers: what a node sends counts by the cosine at the receiver, so toward the horizon nodes may be
/// larger; and planes may be larger than what is not one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CosineThreshold {
    sin2_max: f32,
    normal: Vec3,
}

/// Cosine below which the threshold rises no further.
const COSINE_MIN: f32 = 0.3;

/// Largest solid angle of a plane over that of other nodes: its outline is exact, its light a mean.
const PLANE_GAIN: f32 = 4.0;

/// Largest squared sine, whatever the gains.
const SIN2_MAX: f32 = 0.7;

impl CosineThreshold {
    /// Nodes above the receiver, along `normal`, are taken as one up to `solid_angle_sr`; others up to that over the largest
    /// cosine in their bounding sphere.
    #[must_use]
    pub fn new(solid_angle_sr: f32, normal: Vec3) -> Self {
        Self { sin2_max: sphere_sin2_for_solid_angle(solid_angle_sr), normal }
    }
}

impl Threshold for CosineThreshold {
    #[inline(always)]
    fn sin2_max(&self, node: &NodeSeen) -> f32 {
        let height = self.normal.dot(node.to_center) + node.radius2.sqrt();
        let cosine = (height / node.distance2.sqrt()).clamp(COSINE_MIN, 1.0);
        let gain = if node.is_plane { PLANE_GAIN } else { 1.0 };
        (self.sin2_max * gain / cosine).min(SIN2_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_rise_toward_the_horizon_and_for_planes() {
        let threshold = CosineThreshold::new(0.1, Vec3::Y);
        let node = |to_center: Vec3, is_plane| NodeSeen {
            to_center,
            distance2: to_center.length_squared(),
            radius2: 1e-6,
            is_plane,
        };
        let above = threshold.sin2_max(&node(Vec3::Y * 4.0, false));
        let uniform = UniformThreshold::from_sine(sphere_sin2_for_solid_angle(0.1).sqrt())
            .sin2_max(&node(Vec3::Y, false));
        assert!((above / uniform - 1.0).abs() < 1e-3, "{above} {uniform}");
        for (x, expected) in [(1.0, 2f32.sqrt()), (1e3, 1.0 / COSINE_MIN)] {
            let tilted = threshold.sin2_max(&node(Vec3::new(x, 1.0, 0.0), false));
            assert!((tilted / above - expected).abs() < 2e-3, "{x}: {}", tilted / above);
        }
        assert!((threshold.sin2_max(&node(Vec3::Y, true)) / above - PLANE_GAIN).abs() < 1e-4);
        // Never so large that a receiver inside the sphere would take it.
        let wide = CosineThreshold::new(6.0, Vec3::Y);
        assert_eq!(wide.sin2_max(&node(Vec3::X, true)), SIN2_MAX);
        assert_eq!(CosineThreshold::new(0.0, Vec3::Y).sin2_max(&node(Vec3::X, true)), 0.0);
    }
}
