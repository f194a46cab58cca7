//! Areas of plane sections of boxes.
//!
//! A point spread evenly over the box with half extents `h` has the height `S = Σ aᵢ Uᵢ` along the unit normal `n`, with
//! `aᵢ = |nᵢ| hᵢ` and `Uᵢ` even on −1..=1. The area of the section at height `s` is the box's volume times
//! the density of `S` at `s`.

use glam::{DVec3, Vec3};

/// Thickness of a flat box, as a share of its largest edge.
const THICKNESS: f32 = 1e-3;

/// Half the extents of a box, thick enough to be cut by planes.
#[must_use]
#[inline(always)]
pub fn thick_half(low: Vec3, high: Vec3) -> Vec3 {
    let half = (high - low) * 0.5;
    half.max(Vec3::splat(THICKNESS * half.max_element()))
}

/// Area of the section of the box `−half..=half` by the plane `normal·x = height`.
///
/// Extents below a millionth of the largest count as that.
#[must_use]
pub fn section_area(half: DVec3, normal: DVec3, height: f64) -> f64 {
    let half = half.max(DVec3::splat(1e-6 * half.max_element()));
    let a = normal.abs() * half;
    let a = a.max(DVec3::splat(1e-5 * a.max_element()));
    let product = a.x * a.y * a.z;
    if !(product > 0.0) {
        return 0.0;
    }
    // Density of a sum of three even distributions: a quadratic spline with knots at ±a ± b ± c.
    let mut density = 0.0;
    for signs in 0..8u32 {
        let sign = |bit: u32| if signs >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let knot = height.abs() + sign(0) * a.x + sign(1) * a.y + sign(2) * a.z;
        density += sign(0) * sign(1) * sign(2) * knot.max(0.0).powi(2);
    }
    (density / (16.0 * product) * 8.0 * half.x * half.y * half.z).max(0.0)
}

/// Area of the section of the box `−half..=half` through its center, perpendicular to the unit vector `normal`. Extents are
/// above 0.
#[must_use]
#[inline(always)]
pub fn central_section_area(half: Vec3, normal: Vec3) -> f32 {
    let a = normal.abs() * half;
    let volume = half.x * half.y * half.z;
    let largest = a.max_element();
    let sum = a.x + a.y + a.z;
    if 2.0 * largest >= sum {
        // Through four parallel edges: a parallelogram.
        return 4.0 * volume / largest;
    }
    let pairs = a.x * a.y + a.y * a.z + a.z * a.x;
    (2.0 * pairs - a.dot(a)) * volume / (a.x * a.y * a.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;

    /// Area by counting points of a grid on the plane.
    fn counted(half: Vec3, normal: Vec3, height: f32) -> f32 {
        let frame = Frame::from_normal(normal);
        let (steps, reach) = (600, half.length());
        let step = 2.0 * reach / steps as f32;
        let at = |i: usize| -reach + (i as f32 + 0.5) * step;
        let inside = (0..steps * steps).filter(|i| {
            let (u, v) = (at(i % steps), at(i / steps));
            let p = normal * height + frame.tangent * u + frame.bitangent * v;
            p.abs().cmple(half).all()
        });
        inside.count() as f32 * step * step
    }

    #[test]
    #[cfg_attr(miri, ignore = "counts for an hour")]
    fn areas_match_counting() {
        let half = Vec3::new(0.7, 0.4, 1.1);
        for normal in [
            Vec3::new(0.2, 0.9, 0.1),
            Vec3::new(0.5, 0.6, 0.7),
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(-0.6, 0.0, 0.8),
            Vec3::new(-0.3, 0.5, -0.4),
        ] {
            let normal = normal.normalize();
            for share in [0.0, 0.3, -0.8] {
                let height = share * normal.abs().dot(half);
                let exact = counted(half, normal, height);
                let found = section_area(half.as_dvec3(), normal.as_dvec3(), f64::from(height));
                assert!((found as f32 - exact).abs() < 0.02, "{normal} {share}: {found} {exact}");
            }
            let central = central_section_area(half, normal);
            assert!((central - counted(half, normal, 0.0)).abs() < 0.02, "{normal}");
        }
    }

    #[test]
    fn flat_boxes_have_the_area_of_their_side() {
        let half = DVec3::new(1.0, 0.0, 2.0);
        assert!((section_area(half, DVec3::Y, 0.0) - 8.0).abs() < 1e-3);
        assert_eq!(section_area(DVec3::ZERO, DVec3::Y, 0.0), 0.0);
    }
}
