//! Geometry of an equirectangular image on the sphere.

use pbgi_math::{Vec2, Vec3};
use std::f64::consts::{PI, TAU};

/// Pixel grid of an equirectangular image, placed in the world.
///
/// Column coordinate `u` in 0..width and row coordinate `v` in 0..height are continuous; pixel
/// (i, j) covers i..i+1 × j..j+1. With φ = 2π u/width and θ = π v/height the direction in the
/// image's own axes is (sin φ sin θ, cos θ, −cos φ sin θ): the top row looks up, the middle of the
/// image along +Z, a quarter of the width along +X.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LatLong {
    pub width: usize,
    pub height: usize,
    /// World directions of the image's x, y and z axes; right-handed and orthonormal.
    axes: [Vec3; 3],
}

impl LatLong {
    pub fn new(width: usize, height: usize, axes: [Vec3; 3]) -> Self {
        Self { width, height, axes }
    }

    /// Angle between rows, in radians.
    pub fn row_angle(&self) -> f32 {
        (PI / self.height as f64) as f32
    }

    /// World direction on the equator at column coordinate `u`.
    pub fn horizontal(&self, u: f64) -> Vec3 {
        let (sin, cos) = (u * TAU / self.width as f64).sin_cos();
        self.axes[0] * sin as f32 - self.axes[2] * cos as f32
    }

    /// Sine and cosine of the polar angle at row coordinate `v`.
    pub fn polar(&self, v: f64) -> (f32, f32) {
        let (sin, cos) = (v * PI / self.height as f64).sin_cos();
        (sin as f32, cos as f32)
    }

    /// World direction to the image's zenith.
    pub fn zenith(&self) -> Vec3 {
        self.axes[1]
    }

    /// Unit world direction at continuous coordinates.
    pub fn direction(&self, u: f64, v: f64) -> Vec3 {
        let (sin, cos) = self.polar(v);
        self.horizontal(u) * sin + self.axes[1] * cos
    }

    /// Unit world direction of a pixel's center.
    pub fn center(&self, index: usize) -> Vec3 {
        let (column, row) = (index % self.width, index / self.width);
        self.direction(column as f64 + 0.5, row as f64 + 0.5)
    }

    /// Unit world directions of a pixel's corners.
    pub fn corners(&self, index: usize) -> [Vec3; 4] {
        let (u, v) = ((index % self.width) as f64, (index / self.width) as f64);
        [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
            .map(|(du, dv)| self.direction(u + du, v + dv))
    }

    /// Continuous coordinates (column, row) of a unit world direction.
    pub fn coordinates(&self, direction: Vec3) -> Vec2 {
        let [x, y, z] = self.axes.map(|axis| axis.dot(direction));
        let phi = x.atan2(-z).rem_euclid(std::f32::consts::TAU);
        // Near the poles atan2 keeps the digits that acos loses.
        let theta = x.hypot(z).atan2(y);
        let (width, height) = (self.width as f32, self.height as f32);
        Vec2::new(phi / std::f32::consts::TAU * width, theta / std::f32::consts::PI * height)
    }

    /// Exact solid angle of each pixel of row `row`, in steradians.
    pub fn solid_angle(&self, row: usize) -> f64 {
        self.slice_solid_angle(row as f64, (row + 1) as f64) * TAU / self.width as f64
    }

    /// Solid angle per radian of azimuth between two row coordinates: `cos θ₀ − cos θ₁`, written as
    /// a product so that narrow slices at the poles lose no digits.
    pub fn slice_solid_angle(&self, v0: f64, v1: f64) -> f64 {
        let half = 0.5 * PI / self.height as f64;
        2.0 * ((v0 + v1) * half).sin() * ((v1 - v0) * half).sin()
    }

    /// Calls `visit` with the index of each pixel whose center is within `radius` (radians, below
    /// π/4) of the unit direction `direction`, in increasing order.
    pub fn visit_near(&self, direction: Vec3, radius: f32, mut visit: impl FnMut(usize)) {
        let at = self.coordinates(direction);
        let reach = f64::from(radius / self.row_angle());
        let first = (f64::from(at.y) - reach - 1.0).max(0.0) as usize;
        let last = ((f64::from(at.y) + reach + 1.0) as usize).min(self.height - 1);
        // Angle by chord: the cosine of a narrow angle has too few digits.
        let chord = 2.0 * (radius * 0.5).sin();
        let mut columns = Vec::new();
        for row in first..=last {
            self.columns_near(f64::from(at.x), row, f64::from(radius), &mut columns);
            for &column in &columns {
                let index = row * self.width + column;
                if (self.center(index) - direction).length_squared() <= chord * chord {
                    visit(index);
                }
            }
        }
    }

    /// Columns of `row` that can lie within `radius` of a direction at column coordinate `u`, in
    /// increasing order.
    fn columns_near(&self, u: f64, row: usize, radius: f64, columns: &mut Vec<usize>) {
        columns.clear();
        let theta = (row as f64 + 0.5) * PI / self.height as f64;
        let sin = theta.sin();
        // A circle of radius r at polar angle θ spans asin(sin r / sin θ) to each side; twice that
        // covers the circle's being centered on another row.
        let ratio = 2.0 * radius.sin() / sin;
        let reach = ratio * self.width as f64 / TAU + 1.0;
        if ratio >= 1.0 || 2.0 * reach + 2.0 >= self.width as f64 {
            columns.extend(0..self.width);
            return;
        }
        let range = (u - reach).floor() as i64..=(u + reach).ceil() as i64;
        columns.extend(range.map(|c| c.rem_euclid(self.width as i64) as usize));
        columns.sort_unstable();
        columns.dedup();
    }

    /// Calls `visit` with the pixels that touch pixel `index` at an edge or corner, across the seam
    /// and the poles.
    pub fn visit_neighbors(&self, index: usize, mut visit: impl FnMut(usize)) {
        let (column, row) = (index % self.width, index / self.width);
        let wrap = |c: usize| c % self.width;
        for dr in [-1i64, 0, 1] {
            let r = row as i64 + dr;
            if r < 0 || r >= self.height as i64 {
                continue;
            }
            for dc in [self.width - 1, 0, 1] {
                if (dr, dc) != (0, 0) {
                    visit(r as usize * self.width + wrap(column + dc));
                }
            }
        }
        if row == 0 || row + 1 == self.height {
            // All pixels around a pole touch there.
            (0..self.width).filter(|c| *c != column).for_each(|c| visit(row * self.width + c));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [Vec3; 3] = [Vec3::X, Vec3::Y, Vec3::Z];

    #[test]
    fn image_landmarks_point_where_the_convention_says() {
        let grid = LatLong::new(8, 4, AXES);
        for (u, v, expected) in [
            (0.0, 2.0, Vec3::NEG_Z),
            (2.0, 2.0, Vec3::X),
            (4.0, 2.0, Vec3::Z),
            (6.0, 2.0, Vec3::NEG_X),
            (3.0, 0.0, Vec3::Y),
            (3.0, 4.0, Vec3::NEG_Y),
        ] {
            assert!((grid.direction(u, v) - expected).length() < 1e-6, "{u} {v}");
        }
    }

    #[test]
    fn coordinates_invert_directions() {
        let grid = LatLong::new(100, 50, AXES);
        for (u, v) in [(0.1, 0.01), (99.9, 49.99), (37.3, 20.5), (50.0, 25.0), (75.2, 3.0)] {
            let back = grid.coordinates(grid.direction(u, v));
            assert!((f64::from(back.x) - u).abs() < 1e-3, "{u} {back}");
            assert!((f64::from(back.y) - v).abs() < 1e-4, "{v} {back}");
        }
    }

    #[test]
    fn pixels_tile_the_sphere() {
        let grid = LatLong::new(64, 32, AXES);
        let total: f64 = (0..32).map(|row| grid.solid_angle(row) * 64.0).sum();
        assert!((total - 4.0 * PI).abs() < 1e-12);
    }

    #[test]
    fn pixels_near_a_direction_are_those_a_full_search_finds() {
        let grid = LatLong::new(200, 100, AXES);
        for (u, v) in [(0.2, 50.0), (199.8, 40.2), (77.0, 0.3), (120.0, 98.0), (60.0, 6.0)] {
            let direction = grid.direction(u, v);
            for radius in [0.01f32, 0.06, 0.2] {
                let mut found = Vec::new();
                grid.visit_near(direction, radius, |i| found.push(i));
                let chord = 2.0 * (radius * 0.5).sin();
                let expected: Vec<usize> = (0..20_000)
                    .filter(|i| (grid.center(*i) - direction).length_squared() <= chord * chord)
                    .collect();
                assert_eq!(found, expected, "{u} {v} {radius}");
            }
        }
    }
}
