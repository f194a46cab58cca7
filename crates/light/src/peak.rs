//! A small bright light of the environment, in a window of its own.

use pbgi_math::{Cone, Frame, Vec3};

/// The excess radiance of a small bright region (the sun, a lamp) over the base map.
///
/// The window is a square on the plane at distance 1 around `frame.normal`: texel (row, column)
/// covers `(−1 + 2 column/n) .. (−1 + 2 (column + 1)/n)` times `half_width` along `frame.tangent`
/// and likewise rows along `frame.bitangent`. Invariants: `n > 0`, `n·n` texels, finite and not
/// negative; `half_width` is below 0.05, so the window is less than 5° across.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentPeak {
    /// Center of the window (`normal`) and the axes of its columns (`tangent`) and rows
    /// (`bitangent`).
    pub frame: Frame,
    /// Half the window's edge on the plane at distance 1.
    pub half_width: f32,
    /// Texels along an edge.
    pub n: usize,
    /// Radiance above the base, W·m⁻²·sr⁻¹, row-major.
    pub texels: Vec<[f32; 3]>,
}

impl EnvironmentPeak {
    /// Position of the center of texel (row, column) on the plane at distance 1.
    fn texel_position(&self, row: usize, column: usize) -> (f32, f32) {
        let place = |i: usize| ((2 * i + 1) as f32 / self.n as f32 - 1.0) * self.half_width;
        (place(column), place(row))
    }

    /// Unit direction of the center of texel (row, column).
    #[must_use]
    pub fn texel_direction(&self, row: usize, column: usize) -> Vec3 {
        let (x, y) = self.texel_position(row, column);
        self.frame.to_world(Vec3::new(x, y, 1.0)).normalize()
    }

    /// Solid angle of texel (row, column) in steradians: the mixed second difference of
    /// `atan(x y / √(1 + x² + y²))` over its corners.
    #[must_use]
    pub fn texel_solid_angle(&self, row: usize, column: usize) -> f32 {
        let boundary =
            |i: usize| f64::from(self.half_width) * (2.0 * i as f64 / self.n as f64 - 1.0);
        let corner = |x: f64, y: f64| (x * y).atan2((1.0 + x * x + y * y).sqrt());
        let (x0, x1) = (boundary(column), boundary(column + 1));
        let (y0, y1) = (boundary(row), boundary(row + 1));
        (corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)) as f32
    }

    /// Texels with their direction and solid angle, row by row.
    fn lights(&self) -> impl Iterator<Item = ([f32; 3], Vec3, f32)> + '_ {
        self.texels.iter().enumerate().map(|(i, radiance)| {
            let (row, column) = (i / self.n, i % self.n);
            (*radiance, self.texel_direction(row, column), self.texel_solid_angle(row, column))
        })
    }

    /// Irradiance in W·m⁻² on a surface that faces the window: the integral of the radiance over it.
    #[must_use]
    pub fn flux(&self) -> [f32; 3] {
        let mut sum = [0f64; 3];
        for (radiance, _, solid_angle) in self.lights() {
            (0..3).for_each(|k| sum[k] += f64::from(radiance[k]) * f64::from(solid_angle));
        }
        sum.map(|s| s as f32)
    }

    /// Unoccluded irradiance in W·m⁻² on a surface with the unit normal `normal`.
    #[must_use]
    pub fn irradiance(&self, normal: Vec3) -> [f32; 3] {
        let mut sum = [0f64; 3];
        for (radiance, direction, solid_angle) in self.lights() {
            let weight = f64::from(direction.dot(normal).max(0.0) * solid_angle);
            (0..3).for_each(|k| sum[k] += f64::from(radiance[k]) * weight);
        }
        sum.map(|s| s as f32)
    }

    /// The cone around the window's center that holds the whole window.
    #[must_use]
    pub fn cone(&self) -> Cone {
        let square = 2.0 * self.half_width * self.half_width;
        Cone { axis: self.frame.normal, cos_half_angle: 1.0 / (1.0 + square).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peak() -> EnvironmentPeak {
        let frame = Frame::from_normal(Vec3::new(0.48, 0.6, 0.64));
        EnvironmentPeak { frame, half_width: 0.03, n: 8, texels: vec![[2.0, 1.0, 0.5]; 64] }
    }

    #[test]
    fn texels_tile_the_window() {
        let peak = peak();
        let sum: f32 = (0..64).map(|i| peak.texel_solid_angle(i / 8, i % 8)).sum();
        let h = f64::from(peak.half_width);
        let exact = 4.0 * (h * h).atan2((1.0 + 2.0 * h * h).sqrt());
        assert!((f64::from(sum) / exact - 1.0).abs() < 1e-6, "{sum} {exact}");
        assert!((peak.flux()[0] / (2.0 * sum) - 1.0).abs() < 1e-6);
        let facing = peak.irradiance(peak.frame.normal)[1];
        assert!(facing < peak.flux()[1] && facing > 0.999 * peak.flux()[1]);
    }

    #[test]
    fn rows_run_along_the_bitangent_and_the_cone_holds_all() {
        let peak = peak();
        let step = peak.texel_direction(3, 4) - peak.texel_direction(3, 3);
        assert!(step.normalize().dot(peak.frame.tangent) > 0.999);
        let step = peak.texel_direction(4, 3) - peak.texel_direction(3, 3);
        assert!(step.normalize().dot(peak.frame.bitangent) > 0.999);
        let cone = peak.cone();
        for i in 0..64 {
            assert!(peak.texel_direction(i / 8, i % 8).dot(cone.axis) >= cone.cos_half_angle);
        }
    }
}
