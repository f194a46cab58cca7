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

/// Radius of a light over the diagonal of the scene's box: small against all that it lights, and yet wide enough that its
/// radiance is not too many octaves above that of the walls.
const RADIUS_SHARE: f32 = 1e-3;

/// Radius where the scene has no extent.
const RADIUS_ALONE: f32 = 1e-3;

/// Surfels of a light that shines into all directions, as many as an icosahedron has faces.
const BULB_SURFELS: usize = 20;

impl Scene {
    /// The lights as surfels of the same intensity *I*, times `scale`; those that are dark are left out.
    ///
    /// Their size *r* is a thousandth of the diagonal of [`Scene::bounds`], their radiance *I*/(π*r*²), their albedo 0. A light along an axis
    /// is a disk of radius *r* that faces it, blocks nothing behind it, and lies *r* ahead, so that no surface
    /// it is mounted on hides it. One into all directions is an icosahedron of the area 4π*r*², a surfel per face: it shows π*r*² on
    /// average, and within 5 % of that to every direction (`tests::bulbs_shine_alike_into_all_directions`).
    #[must_use]
    pub fn light_surfels(&self, scale: f32) -> Vec<Surfel> {
        let radius = self.light_radius();
        let shown_area = PI * radius * radius;
        let mut surfels = Vec::new();
        for light in &self.lights {
            let radiance = light.intensity.map(|i| (i * scale / shown_area).min(f32::MAX));
            if radiance == [0.0; 3] {
                continue;
            }
            let lit = |surfel: Surfel| surfel.with_radiance(radiance);
            match light.axis {
                Some(axis) => {
                    let center = light.position + axis * radius;
                    let disk = Surfel::new(center, axis, radius, shown_area);
                    surfels.push(lit(disk.with_flags(SurfelFlags::FRONT_ONLY)));
                }
                None => surfels.extend(icosahedron(light.position, radius).map(lit)),
            }
        }
        surfels
    }

    /// Size of the lights, in scene units.
    fn light_radius(&self) -> f32 {
        let bounds = self.bounds();
        let diagonal = if bounds.is_empty() { 0.0 } else { bounds.extent().length() };
        if diagonal > 0.0 { RADIUS_SHARE * diagonal } else { RADIUS_ALONE }
    }
}

/// The faces of an icosahedron of the area 4π`radius`² as disks.
fn icosahedron(center: Vec3, radius: f32) -> impl Iterator<Item = Surfel> {
    let area = 4.0 * PI * radius * radius / BULB_SURFELS as f32;
    let edge = (area * 4.0 / 3f32.sqrt()).sqrt();
    // Of the inscribed sphere, and around a face.
    let inner = edge * (3.0 + 5f32.sqrt()) / (4.0 * 3f32.sqrt());
    let covering = edge / 3f32.sqrt();
    face_normals().map(move |normal| Surfel::new(center + normal * inner, normal, covering, area))
}

/// Outward normals of an icosahedron: toward the vertices of a dodecahedron.
fn face_normals() -> impl Iterator<Item = Vec3> {
    let golden = 0.5 * (1.0 + 5f32.sqrt());
    let signs = |bits: usize| {
        let sign = |axis: usize| if bits >> axis & 1 == 0 { 1.0 } else { -1.0 };
        Vec3::new(sign(0), sign(1), sign(2))
    };
    let cube = (0..8).map(signs);
    let rectangles = (0..12).map(move |i| {
        let corner = Vec3::new(0.0, 1.0 / golden, golden) * signs(i % 4 * 2);
        match i / 4 {
            0 => corner,
            1 => Vec3::new(corner.z, corner.x, corner.y),
            _ => Vec3::new(corner.y, corner.z, corner.x),
        }
    });
    cube.chain(rectangles).map(Vec3::normalize)
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
        let (spot, bulb) = surfels.split_last().unwrap();
        assert_eq!(bulb.len(), BULB_SURFELS);
        // Of a convex shape a quarter of the area is shown, on average.
        for (surfels, shown) in [(bulb, 0.25), (std::slice::from_ref(spot), 1.0)] {
            for (channel, expected) in [2.0, 1.0, 0.5].into_iter().enumerate() {
                let intensity: f32 =
                    surfels.iter().map(|s| shown * s.area * s.radiance[channel]).sum();
                assert!((intensity / expected - 1.0).abs() < 1e-5, "{intensity}");
            }
        }
        let center = bulb.iter().map(Surfel::center).sum::<Vec3>() / bulb.len() as f32;
        assert!((center - position).length() < 1e-5, "{center}");
        assert!(bulb.iter().all(|s| (s.center() - position).length() < 0.005));
        assert!((spot.radius - 0.005).abs() < 1e-6);
        assert!(spot.is_front_only() && spot.normal().dot(axis) > 0.999_99);
        assert!((spot.center() - position - 0.005 * axis).length() < 1e-6);
        assert!(scene.light_surfels(0.0).is_empty());
    }

    #[test]
    fn bulbs_shine_alike_into_all_directions() {
        let surfels: Vec<Surfel> = icosahedron(Vec3::ZERO, 1.0).collect();
        let shown = |d: Vec3| -> f32 {
            surfels.iter().map(|s| s.area * s.normal().dot(d).max(0.0)).sum::<f32>() / PI
        };
        let around = (0..1000).map(|i| {
            let z = (i as f32 + 0.5) / 500.0 - 1.0;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            shown(Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z))
        });
        let faces = surfels.iter().map(|s| shown(s.normal()));
        for share in around.chain(faces) {
            assert!((share - 1.0).abs() < 0.05, "{share}");
        }
        // Five faces meet at a corner, and the disk of each reaches it.
        let edge = (surfels[0].area * 4.0 / 3f32.sqrt()).sqrt();
        let corner = Vec3::new(1.0, 0.0, 1.618_034).normalize() * 0.951_056_5 * edge;
        let reaches = |s: &&Surfel| (s.center() - corner).length() < 1.0001 * s.radius;
        assert_eq!(surfels.iter().filter(reaches).count(), 5);
    }

    #[test]
    fn lights_without_a_scene_have_a_size() {
        let light = PunctualLight { position: Vec3::X, axis: None, intensity: [f32::MAX; 3] };
        let scene = Scene { lights: vec![light], ..Scene::default() };
        let surfel = scene.light_surfels(2.0)[0];
        assert!(surfel.radius > 0.0 && surfel.radiance.iter().all(|r| r.is_finite()));
    }
}
