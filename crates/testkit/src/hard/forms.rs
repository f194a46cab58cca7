//! What is right, in closed form and double precision.

use pbgi_math::DVec3;
use std::f64::consts::{PI, TAU};

/// Share of the hemisphere, weighted by the cosine, that a disk of radius `r` hides at distance `h` before its middle.
pub fn disk_share(r: f64, h: f64) -> f64 {
    r * r / (r * r + h * h)
}

/// The same of a polygon, as far as it is above the horizon (Lambert 1760).
pub fn polygon_share(corners: &[DVec3], position: DVec3, normal: DVec3) -> f64 {
    let corners = above_horizon(corners, position, normal);
    let edge = |i: usize| {
        let (a, b) = (corners[i].normalize(), corners[(i + 1) % corners.len()].normalize());
        let cross = a.cross(b);
        let sine = cross.length();
        if sine == 0.0 { 0.0 } else { sine.atan2(a.dot(b)) * cross.dot(normal) / sine }
    };
    (0..corners.len()).map(edge).sum::<f64>().abs() / TAU
}

/// What of a polygon is above the horizon of a place, relative to it (Sutherland and Hodgman 1974).
pub fn above_horizon(corners: &[DVec3], position: DVec3, normal: DVec3) -> Vec<DVec3> {
    let mut out = Vec::with_capacity(corners.len() + 2);
    for (i, corner) in corners.iter().enumerate() {
        let (a, b) = (*corner - position, corners[(i + 1) % corners.len()] - position);
        let (ha, hb) = (a.dot(normal), b.dot(normal));
        if ha >= 0.0 {
            out.push(a);
        }
        if ha * hb < 0.0 {
            out.push(a + (b - a) * (ha / (ha - hb)));
        }
    }
    out
}

/// Corners of a rectangle by its middle and half edges.
pub fn rectangle(middle: DVec3, u: DVec3, v: DVec3) -> [DVec3; 4] {
    [middle - u - v, middle + u - v, middle + u + v, middle - u + v]
}

/// Irradiance of a small lamp of an area and of radiance 1: `A cos cos / d²`.
pub fn small_lamp(
    lamp: DVec3,
    lamp_normal: DVec3,
    area: f64,
    position: DVec3,
    normal: DVec3,
) -> f64 {
    let to = lamp - position;
    let d2 = to.length_squared();
    area * to.dot(normal).max(0.0) * (-to.dot(lamp_normal)).max(0.0) / (d2 * d2)
}

/// Directions of a texel of a sky of `width` × `width`/2, and the solid angle of each, by a grid of `steps` within it.
pub fn sky_texel(
    width: usize,
    column: usize,
    row: usize,
    steps: usize,
) -> impl Iterator<Item = (DVec3, f64)> {
    let height = width / 2;
    let at = move |index: usize, i: usize, count: usize| {
        (index as f64 + (i as f64 + 0.5) / steps as f64) / count as f64
    };
    let solid_angle = TAU / width as f64 / steps as f64 * PI / height as f64 / steps as f64;
    (0..steps * steps).map(move |i| {
        let (u, v) = (at(column, i % steps, width), at(row, i / steps, height));
        let (sin, cos) = (TAU * (0.5 - u)).sin_cos();
        let (ring, up) = (PI * v).sin_cos();
        (DVec3::new(sin * ring, up, cos * ring), solid_angle * ring)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_agree_with_disks_and_with_what_is_known() {
        // A disk as a polygon of many corners.
        let corner = |i: i32| {
            let (sin, cos) = (TAU * f64::from(i) / 1000.0).sin_cos();
            DVec3::new(cos, 0.7, sin)
        };
        let corners: Vec<DVec3> = (0..1000).map(corner).collect();
        let found = polygon_share(&corners, DVec3::ZERO, DVec3::Y);
        assert!((found - disk_share(1.0, 0.7)).abs() < 1e-4, "{found}");
        // A wall without end beside a receiver hides half of what is open.
        let wall = rectangle(DVec3::X, DVec3::Y * 1e6, DVec3::Z * 1e6);
        assert!((polygon_share(&wall, DVec3::ZERO, DVec3::Y) - 0.5).abs() < 1e-5);
        // A cube's lid seen from the middle of its floor, from tables of form factors.
        let lid = rectangle(DVec3::Y * 2.0, DVec3::X, DVec3::Z);
        assert!((polygon_share(&lid, DVec3::ZERO, DVec3::Y) - 0.2395).abs() < 2e-4);
        // What is behind hides nothing.
        assert_eq!(polygon_share(&lid, DVec3::ZERO, DVec3::NEG_Y), 0.0);
    }

    #[test]
    fn small_lamps_are_as_bright_as_small_polygons() {
        let (at, n) = (DVec3::new(0.2, 2.0, -0.4), DVec3::new(0.1, -1.0, 0.2).normalize());
        let u = n.any_orthonormal_vector() * 0.005;
        let lamp = rectangle(at, u, u.cross(n));
        let exact = PI * polygon_share(&lamp, DVec3::ZERO, DVec3::Y);
        assert!((small_lamp(at, n, 1e-4, DVec3::ZERO, DVec3::Y) / exact - 1.0).abs() < 1e-4);
    }

    #[test]
    fn texels_of_the_sky_cover_it() {
        let sum: f64 = (0..8 * 4)
            .flat_map(|i| sky_texel(8, i % 8, i / 8, 32))
            .map(|(d, solid_angle)| d.y.max(0.0) * solid_angle)
            .sum();
        assert!((sum / PI - 1.0).abs() < 1e-3, "{sum}");
        // The middle of the picture is along +Z, a quarter from its left edge +X.
        let mean = |column| sky_texel(64, column, 16, 1).next().unwrap().0;
        assert!(mean(32).z > 0.99 && mean(16).x > 0.99);
    }
}
