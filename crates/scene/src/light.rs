//! Lights without extent, and the small surfels that shine in their stead.

use crate::Scene;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::Vec3;
use std::f32::consts::PI;

/// A light without extent somewhere in the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct PunctualLight {
    /// Where it is, in world space.
    pub position: Vec3,
    /// Unit direction it shines along: intensity falls with the cosine of the angle to it, to 0 at a right angle. `None` shines
    /// alike into all directions.
    pub axis: Option<Vec3>,
    /// Radiant intensity, W·sr⁻¹, linear Rec. 709, 0 or more: into all directions, or along the axis.
    pub intensity: [f32; 3],
}

/// Radius of a light's disk over the diagonal of the scene's box: small against all that it lights, and yet wide enough that its
/// radiance is not too many octaves above that of the walls.
const RADIUS_SHARE: f32 = 1e-3;

/// Radius where the scene has no extent.
const RADIUS_ALONE: f32 = 1e-3;

impl Scene {
    /// The lights as surfels of the same intensity, times `scale`; those that are dark are left out.
    ///
    /// A light into all directions is an isotropic surfel: it shows the same disk from everywhere, so its intensity is exact. One
    /// along an axis is a disk that faces it, blocks nothing behind it, and lies one radius ahead, so that no surface
    /// it is mounted on hides it. Disks have a thousandth of the diagonal of [`Scene::bounds`] as radius *r* and the
    /// radiance *I*/(π*r*²); their albedo is 0.
    #[must_use]
    pub fn light_surfels(&self, scale: f32) -> Vec<Surfel> {
        let radius = self.light_radius();
        let shown_area = PI * radius * radius;
        let shining = self.lights.iter().filter(|light| light.intensity != [0.0; 3] && scale > 0.0);
        shining
            .map(|light| {
                let radiance = light.intensity.map(|i| (i * scale / shown_area).min(f32::MAX));
                let surfel = match light.axis {
                    Some(axis) => {
                        let center = light.position + axis * radius;
                        Surfel::new(center, axis, radius, shown_area)
                            .with_flags(SurfelFlags::FRONT_ONLY)
                    }
                    None => Surfel::new(light.position, Vec3::Y, radius, 2.0 * shown_area)
                        .with_flags(SurfelFlags::ISOTROPIC),
                };
                surfel.with_radiance(radiance)
            })
            .collect()
    }

    /// Radius of the lights' disks, in scene units.
    fn light_radius(&self) -> f32 {
        let bounds = self.bounds();
        let diagonal = if bounds.is_empty() { 0.0 } else { bounds.extent().length() };
        if diagonal > 0.0 { RADIUS_SHARE * diagonal } else { RADIUS_ALONE }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Instance, Mesh};
    use pbgi_math::Affine3A;

    fn scene_with(lights: Vec<PunctualLight>) -> Scene {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::new(3.0, 0.0, 0.0), Vec3::new(0.0, 0.0, 4.0)],
            triangles: vec![[0, 2, 1]],
            ..Mesh::default()
        };
        let instance = Instance { mesh: 0, transform: Affine3A::IDENTITY };
        Scene { meshes: vec![mesh], instances: vec![instance], lights, ..Scene::default() }
    }

    #[test]
    fn surfels_have_the_lights_intensity() {
        let position = Vec3::new(1.0, 2.0, 3.0);
        let intensity = [4.0, 2.0, 1.0];
        let axis = Vec3::new(0.6, -0.8, 0.0);
        let dark = PunctualLight { position, axis: None, intensity: [0.0; 3] };
        let bulb = PunctualLight { intensity, ..dark.clone() };
        let spot = PunctualLight { axis: Some(axis), ..bulb.clone() };
        let scene = scene_with(vec![bulb, dark, spot]);
        let surfels = scene.light_surfels(0.5);
        let [bulb, spot] = &surfels[..] else { panic!("{surfels:?}") };
        // An isotropic surfel shows half its area.
        for (surfel, shown) in [(bulb, 0.5 * bulb.area), (spot, spot.area)] {
            assert!((surfel.radius - 0.005).abs() < 1e-6);
            for (radiance, expected) in surfel.radiance.iter().zip([2.0, 1.0, 0.5]) {
                assert!((radiance * shown / expected - 1.0).abs() < 1e-5, "{surfel:?}");
            }
        }
        assert!(bulb.is_isotropic() && bulb.center() == position);
        assert!(spot.is_front_only() && spot.normal().dot(axis) > 0.999_99);
        assert!((spot.center() - position - 0.005 * axis).length() < 1e-6);
        assert!(scene.light_surfels(0.0).is_empty());
    }

    #[test]
    fn lights_without_a_scene_have_a_size() {
        let light = PunctualLight { position: Vec3::X, axis: None, intensity: [f32::MAX; 3] };
        let scene = Scene { lights: vec![light], ..Scene::default() };
        let surfel = scene.light_surfels(2.0)[0];
        assert!(surfel.radius > 0.0 && surfel.radiance.iter().all(|r| r.is_finite()));
    }
}
