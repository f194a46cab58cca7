//! Solid angles of spheres and of flat patches.

use std::f32::consts::PI;

/// Solid angle of a flat patch near the receiver over that of the same area in its middle, to second order.
///
/// With the patch in the plane n·**p** = H, its solid angle is ∫ H/|**p**|³ da. `distance2` is the squared distance |**c**|² of its middle, `spread2`
/// the trace of the covariance C of its points, and `along2` is **c**ᵀC**c**. Large patches that are seen along their plane have
/// more, those that are faced less. Within half and twice, where second order says nothing any more.
///
/// ```
/// # use pbgi_math::patch_solid_angle_factor;
/// // A square of two by two, faced from a distance of 5: each edge's half length has the variance 1/3.
/// let exact = 4.0 * (1.0f32 / (25.0 * 27.0f32).sqrt()).atan() / 4.0 * 25.0;
/// let factor = patch_solid_angle_factor(25.0, 2.0 / 3.0, 0.0);
/// assert!((factor / exact - 1.0).abs() < 0.005);
/// ```
#[must_use]
#[inline(always)]
pub fn patch_solid_angle_factor(distance2: f32, spread2: f32, along2: f32) -> f32 {
    let inverse = 1.0 / distance2;
    let factor = 1.0 + (7.5 * along2 * inverse - 1.5 * spread2) * inverse;
    factor.clamp(0.5, 2.0)
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
    use glam::Vec3;

    /// Squares against sums over their parts, at every tilt: an order of magnitude nearer than their middle.
    #[test]
    fn near_patches_have_the_solid_angle_of_their_parts() {
        const PARTS: i32 = 40;
        let half = 1.0 / 12f32.sqrt();
        for (distance, tolerance) in [(3.0f32, 0.012), (2.0, 0.05)] {
            for tilt in [0.0f32, 0.4, 0.8, 1.2, 1.45] {
                let center = Vec3::new(tilt.sin(), 0.0, tilt.cos()) * distance;
                let place = |i: i32| (i as f32 + 0.5) / PARTS as f32 - 0.5;
                let part = |i: i32| {
                    let p = center + Vec3::new(place(i % PARTS), place(i / PARTS), 0.0);
                    center.z / p.length().powi(3)
                };
                let exact = (0..PARTS * PARTS).map(part).sum::<f32>() / (PARTS * PARTS) as f32;
                let point = center.z / distance.powi(3);
                let (spread2, along2) = (2.0 * half * half, (center.x * half).powi(2));
                let found = point * patch_solid_angle_factor(distance * distance, spread2, along2);
                assert!((found / exact - 1.0).abs() < tolerance, "{distance} {tilt}");
                assert!((found - exact).abs() < 0.4 * (point - exact).abs() + 1e-3 * exact);
            }
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
