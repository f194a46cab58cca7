//! Real spherical harmonics of bands 0..=2: the reference for the directional form of a node.

use glam::Vec3;

/// Coefficients of bands 0..=2.
pub const SH_COUNT: usize = 9;

/// Nine coefficients, index `l(l+1)+m`.
pub type Sh9 = [f32; SH_COUNT];

/// The nine real basis functions in the direction `d` (unit length), orthonormal over the sphere.
#[must_use]
pub fn evaluate_sh_basis(d: Vec3) -> Sh9 {
    [
        0.282_094_8,
        0.488_602_52 * d.y,
        0.488_602_52 * d.z,
        0.488_602_52 * d.x,
        1.092_548_5 * d.x * d.y,
        1.092_548_5 * d.y * d.z,
        0.315_391_57 * (3.0 * d.z * d.z - 1.0),
        1.092_548_5 * d.x * d.z,
        0.546_274_24 * (d.x * d.x - d.y * d.y),
    ]
}

/// Coefficients of `max(0, n·d)` as a function of `d`, for the unit vector `normal`. The bands of
/// the clamped cosine are π, 2π/3 and π/4 (Ramamoorthi and Hanrahan 2001).
#[must_use]
pub fn clamped_cosine_sh(normal: Vec3) -> Sh9 {
    use std::f32::consts::PI;
    let mut coefficients = evaluate_sh_basis(normal);
    for (i, c) in coefficients.iter_mut().enumerate() {
        *c *= match i {
            0 => PI,
            1..=3 => 2.0 * PI / 3.0,
            _ => PI / 4.0,
        };
    }
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    fn sphere(count: u32) -> impl Iterator<Item = Vec3> {
        (0..count).map(move |i| {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / count as f32;
            let phi = i as f32 * 2.399_963_2;
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        })
    }

    #[test]
    fn basis_is_orthonormal() {
        let count = 20_000;
        let mut gram = [[0f64; SH_COUNT]; SH_COUNT];
        for d in sphere(count) {
            let y = evaluate_sh_basis(d);
            for i in 0..SH_COUNT {
                for j in 0..SH_COUNT {
                    gram[i][j] += f64::from(y[i] * y[j]) * f64::from(4.0 * PI) / f64::from(count);
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((value - expected).abs() < 2e-3, "{i} {j} {value}");
            }
        }
    }

    #[test]
    fn clamped_cosine_matches_quadrature() {
        let normal = Vec3::new(0.4, -0.3, 0.7).normalize();
        let mut projected = [0f64; SH_COUNT];
        let count = 20_000;
        for d in sphere(count) {
            let y = evaluate_sh_basis(d);
            let f = d.dot(normal).max(0.0);
            for i in 0..SH_COUNT {
                projected[i] += f64::from(f * y[i]) * f64::from(4.0 * PI) / f64::from(count);
            }
        }
        let closed = clamped_cosine_sh(normal);
        for i in 0..SH_COUNT {
            assert!((projected[i] as f32 - closed[i]).abs() < 2e-3, "{i}");
        }
    }
}
