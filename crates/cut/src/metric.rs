//! When a node is small enough to stand for its surfels.

use pbgi_math::Vec3;

/// How large a node may be to be taken as one.
pub trait Threshold {
    /// Largest `r²/d²` (squared sine of the half-angle) of the bounding sphere of a node that is taken as one, below 1.
    fn sin2_max(&self, node: &NodeSeen) -> f32;

    /// Whether a node, with all that is in it, is looked at.
    #[inline(always)]
    fn is_wanted(&self, _: &NodeSeen) -> bool {
        true
    }
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
    /// Largest height of its box over the receiver's horizon.
    pub top: f32,
    /// Whether the node's surfels are one piece of a plane, which as one look as they do singly.
    pub is_plane: bool,
    /// Largest radiance of its lobes, of the brightest channel; W·m⁻²·sr⁻¹.
    pub brightness: f32,
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
