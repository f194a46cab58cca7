//! When a node is small enough to stand for its surfels, and what it then shows.

use pbgi_format::{Lobe, SurfelLayout};
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
        // At 1, receivers inside the bounding sphere would be let through.
        Self { sin2_max: sphere_sin2_for_solid_angle(solid_angle_sr).min(0.9) }
    }
}

impl Threshold for UniformThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: Vec3, _: f32, _: f32) -> f32 {
        self.sin2_max
    }
}

/// What a node shows to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cluster {
    /// Smallest corner of the node's box, relative to the receiver.
    pub low: Vec3,
    /// Largest corner.
    pub high: Vec3,
    /// Solid angle of surfaces facing the receiver: `A(d)/d²`.
    pub front_sr: f32,
    /// Solid angle of surfaces turned away that block.
    pub back_sr: f32,
    /// Mean radiance of the facing surfaces: `I(d)/A(d)`.
    pub radiance: [f32; 3],
}

impl Cluster {
    /// Evaluates a node's lobes toward the receiver.
    #[inline(always)]
    pub(crate) fn from_lobes(low: Vec3, high: Vec3, lobes: &[u8], layout: &SurfelLayout) -> Self {
        let center = (low + high) * 0.5;
        let distance2 = center.length_squared();
        let toward_receiver = center * (-1.0 / distance2.sqrt());
        let (mut front, mut back, mut intensity) = (0.0, 0.0, [0.0; 3]);
        for stored in lobes.chunks_exact(Lobe::stored_bytes(layout.channels)) {
            let lobe = Lobe::read(stored, layout.channels, layout.area, layout.radiance_scale);
            let area = lobe.front_area(toward_receiver);
            front += area;
            back += lobe.back_area(toward_receiver);
            for (sum, radiance) in intensity.iter_mut().zip(lobe.radiance) {
                *sum += area * radiance;
            }
        }
        let inverse = if front > 0.0 { 1.0 / front } else { 0.0 };
        Self {
            low,
            high,
            front_sr: front / distance2,
            back_sr: back / distance2,
            radiance: intensity.map(|i| i * inverse),
        }
    }
}
