//! The area a box shows.

use glam::Vec3;

/// Area of the silhouette of a box with these half-edges, seen in parallel along the unit direction `d`.
#[must_use]
#[inline(always)]
pub fn box_silhouette(half: Vec3, d: Vec3) -> f32 {
    let d = d.abs();
    4.0 * (d.x * half.y * half.z + d.y * half.x * half.z + d.z * half.x * half.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silhouettes_of_a_cube() {
        let half = Vec3::splat(0.5);
        assert_eq!(box_silhouette(half, Vec3::Y), 1.0);
        let diagonal = box_silhouette(half, Vec3::ONE.normalize());
        assert!((diagonal - 3f32.sqrt()).abs() < 1e-6);
    }
}
