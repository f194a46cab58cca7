//! Solid angles of spheres and far disks.

use glam::Vec3;
use std::f32::consts::PI;

/// Solid angle of a far disk seen from the origin, in steradians.
///
/// `center` and `radius` are in scene units; `normal` has unit length. Small-disk formula
/// `ω ≈ π r² |n·c| / d³`: relative error is below 1 % for `d ≥ 11 r` at every tilt
/// (`tests::disk_solid_angle_matches_quadrature`).
///
/// # Panics
///
/// In debug builds, if `normal` is not of unit length or `center` is the origin.
///
/// ```
/// # use pbgi_math::{Vec3, disk_solid_angle};
/// let facing = disk_solid_angle(Vec3::new(0.0, 0.0, 100.0), Vec3::new(0.0, 0.0, -1.0), 1.0);
/// assert!((facing - std::f32::consts::PI * 1e-4).abs() < 1e-9);
/// ```
#[must_use]
#[inline]
pub fn disk_solid_angle(center: Vec3, normal: Vec3, radius: f32) -> f32 {
    debug_assert!((normal.length_squared() - 1.0).abs() < 1e-3);
    let d2 = center.length_squared();
    debug_assert!(d2 > 0.0);
    PI * radius * radius * normal.dot(center).abs() / (d2 * d2.sqrt())
}

/// Solid angle of a sphere seen from a point outside it, `2π (1 − √(1 − r²/d²))`, in steradians;
/// 4π when the point is inside. Written so that small spheres lose no digits.
#[must_use]
#[inline]
pub fn sphere_solid_angle(radius2_over_distance2: f32) -> f32 {
    let s = radius2_over_distance2;
    if s >= 1.0 {
        return 4.0 * PI;
    }
    2.0 * PI * s / (1.0 + (1.0 - s).sqrt())
}

/// The `r²/d²` at which a sphere subtends `solid_angle_sr`: the inverse of [`sphere_solid_angle`]
/// up to a half-space (2π), constant above.
#[must_use]
#[inline]
pub fn sphere_sin2_for_solid_angle(solid_angle_sr: f32) -> f32 {
    let x = (solid_angle_sr / (2.0 * PI)).clamp(0.0, 1.0);
    x * (2.0 - x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_solid_angle_matches_quadrature() {
        let normal = Vec3::Z;
        for tilt in [0.0f32, 0.4, 0.8, 1.2, 1.5] {
            let center = Vec3::new(tilt.sin(), 0.0, tilt.cos()) * 11.0;
            let frame = crate::Frame::from_normal(normal);
            let (rings, spokes) = (200, 400);
            let mut exact = 0f64;
            for i in 0..rings {
                let r = (i as f32 + 0.5) / rings as f32;
                for j in 0..spokes {
                    let (sin, cos) = ((j as f32 + 0.5) * 2.0 * PI / spokes as f32).sin_cos();
                    let p = center + (frame.tangent * cos + frame.bitangent * sin) * r;
                    let d2 = p.length_squared();
                    let area = r / rings as f32 * 2.0 * PI / spokes as f32;
                    exact += f64::from(area * normal.dot(p).abs() / (d2 * d2.sqrt()));
                }
            }
            let formula = f64::from(disk_solid_angle(center, normal, 1.0));
            assert!((formula / exact - 1.0).abs() < 0.01, "{tilt}: {formula} {exact}");
        }
    }

    #[test]
    fn sphere_solid_angle_inverts() {
        for s in [1e-8f32, 1e-4, 0.01, 0.3, 0.9, 0.999] {
            let back = sphere_sin2_for_solid_angle(sphere_solid_angle(s));
            assert!((back / s - 1.0).abs() < 1e-3, "{s} {back}");
        }
        assert_eq!(sphere_solid_angle(2.0), 4.0 * PI);
        assert!((sphere_solid_angle(1e-8) / (PI * 1e-8) - 1.0).abs() < 1e-6);
    }
}
