//! The truth about a cloud of disks: rays.

use crate::scenes::sphere_directions;
use pbgi_cloud::Surfel;
use pbgi_math::Vec3;
use std::f32::consts::PI;

/// What rays find.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OracleResult {
    /// Irradiance from the disks.
    pub surface_irradiance: [f32; 3],
    /// Cosine-weighted share of the hemisphere that is open.
    pub ambient_occlusion: f32,
}

/// Casts `ray_count` rays over the hemisphere around `normal` against every disk: the nearest hit
/// counts, facing disks shine, backs are black (front-only disks are passed from behind). Disks have the radius
/// `radius_of` gives.
#[must_use]
pub fn ray_cast_gather(
    surfels: &[Surfel],
    position: Vec3,
    normal: Vec3,
    ray_count: u32,
    radius_of: impl Fn(&Surfel) -> f32,
) -> OracleResult {
    let weight = 4.0 * PI / ray_count as f32;
    let mut result = OracleResult::default();
    for d in sphere_directions(ray_count).filter(|d| d.dot(normal) > 0.0) {
        let mut nearest = (f32::INFINITY, [0.0; 3]);
        for surfel in surfels {
            let n = surfel.normal();
            let to_center = surfel.center() - position;
            let cosine = n.dot(d);
            let t = n.dot(to_center) / cosine;
            if !(t > 1e-5 && t < nearest.0) || (surfel.is_front_only() && cosine > 0.0) {
                continue;
            }
            if (d * t - to_center).length() <= radius_of(surfel) {
                nearest = (t, if cosine < 0.0 { surfel.radiance } else { [0.0; 3] });
            }
        }
        let projected = weight * d.dot(normal);
        if nearest.0 == f32::INFINITY {
            result.ambient_occlusion += projected / PI;
        }
        for (sum, l) in result.surface_irradiance.iter_mut().zip(nearest.1) {
            *sum += projected * l;
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_find_the_form_factor_of_a_parallel_disk() {
        let disk = Surfel::new(Vec3::Y, Vec3::NEG_Y, 1.0, PI).with_radiance([1.0; 3]);
        let found = ray_cast_gather(&[disk], Vec3::ZERO, Vec3::Y, 20_000, |s| s.radius);
        assert!((found.surface_irradiance[0] / (PI / 2.0) - 1.0).abs() < 0.01);
        assert!((found.ambient_occlusion - 0.5).abs() < 0.005);
    }
}
