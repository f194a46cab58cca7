//! Eigenvalues of symmetric 3×3 matrices.

use pbgi_math::DVec3;

/// A symmetric matrix: diagonal `xx yy zz`, and `yz xz xy` beside it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Symmetric3 {
    pub diagonal: DVec3,
    pub off_diagonal: DVec3,
}

impl Symmetric3 {
    /// Adds the outer product `v vᵀ`.
    pub fn add_outer(&mut self, v: DVec3) {
        self.diagonal += v * v;
        self.off_diagonal += DVec3::new(v.y * v.z, v.x * v.z, v.x * v.y);
    }

    /// Eigenvalues in ascending order: the roots of the characteristic polynomial in their
    /// trigonometric form (Smith, "Eigenvalues of a symmetric 3 × 3 matrix", CACM 4(4), 1961).
    pub fn eigenvalues(&self) -> [f64; 3] {
        let mean = self.diagonal.element_sum() / 3.0;
        let d = self.diagonal - mean;
        let o = self.off_diagonal;
        let p2 = (d.length_squared() + 2.0 * o.length_squared()) / 6.0;
        if p2 <= 0.0 {
            return [mean; 3];
        }
        let p = p2.sqrt();
        let (d, o) = (d / p, o / p);
        let half_determinant = 0.5
            * (d.x * (d.y * d.z - o.x * o.x) - o.z * (o.z * d.z - o.x * o.y)
                + o.y * (o.z * o.x - d.y * o.y));
        let angle = half_determinant.clamp(-1.0, 1.0).acos() / 3.0;
        let largest = mean + 2.0 * p * angle.cos();
        let smallest = mean + 2.0 * p * (angle + std::f64::consts::TAU / 3.0).cos();
        [smallest, 3.0 * mean - smallest - largest, largest]
    }

    /// Unit eigenvector of the simple eigenvalue `value`; `None` where it is not simple. The rows
    /// of `A − λ` span the plane across it: the longest of their cross products.
    pub fn eigenvector(&self, value: f64) -> Option<DVec3> {
        let d = self.diagonal - value;
        let o = self.off_diagonal;
        let rows =
            [DVec3::new(d.x, o.z, o.y), DVec3::new(o.z, d.y, o.x), DVec3::new(o.y, o.x, d.z)];
        let products = [rows[0].cross(rows[1]), rows[1].cross(rows[2]), rows[2].cross(rows[0])];
        let longest = products
            .into_iter()
            .reduce(|a, b| if b.length_squared() > a.length_squared() { b } else { a })?;
        // Rows that are parallel up to rounding give no direction.
        let scale = d.length_squared() + 2.0 * o.length_squared();
        (longest.length() > 1e-9 * scale).then(|| longest.normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_satisfy_their_equation() {
        let mut seed = 1u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        for flatness in [1.0, 1e-2, 1e-4] {
            for _ in 0..1000 {
                let mut matrix = Symmetric3::default();
                let axis = DVec3::new(random(), random(), random()).normalize();
                for _ in 0..12 {
                    let v = DVec3::new(random(), random(), random());
                    matrix.add_outer(v - axis * axis.dot(v) * (1.0 - flatness));
                }
                let [a, b, c] = matrix.eigenvalues();
                assert!(a <= b + 1e-12 && b <= c + 1e-12 && a > -1e-12);
                let v = matrix.eigenvector(a).unwrap();
                let (d, o) = (matrix.diagonal, matrix.off_diagonal);
                let product = DVec3::new(
                    d.x * v.x + o.z * v.y + o.y * v.z,
                    o.z * v.x + d.y * v.y + o.x * v.z,
                    o.y * v.x + o.x * v.y + d.z * v.z,
                );
                assert!((product - v * a).length() < 1e-6 * c, "{a} {b} {c}");
            }
        }
    }

    #[test]
    fn repeated_eigenvalues_have_no_vector() {
        let mut line = Symmetric3::default();
        line.add_outer(DVec3::new(1.0, 2.0, 3.0));
        assert!(line.eigenvector(line.eigenvalues()[0]).is_none());
        assert!(Symmetric3::default().eigenvector(0.0).is_none());
    }
}
