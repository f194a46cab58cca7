//! World-aligned cube maps: faces, texels, exact texel integrals.

use glam::Vec3;

/// One of the six faces of a world-aligned cube.
///
/// On face `2a + s` the major axis is `a` (x, y, z) with sign + for `s = 0` and − for `s = 1`; the
/// face coordinates are `u = d[(a+1)%3] / |d[a]|` and `v = d[(a+2)%3] / |d[a]|`, both in −1..=1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CubeFace(pub u8);

impl CubeFace {
    /// All faces in index order: +x, −x, +y, −y, +z, −z.
    pub const ALL: [Self; 6] = [Self(0), Self(1), Self(2), Self(3), Self(4), Self(5)];

    /// Index of the major axis.
    #[must_use]
    #[inline]
    pub fn axis(self) -> usize {
        usize::from(self.0 >> 1)
    }

    /// Sign of the major axis: 1 or −1.
    #[must_use]
    #[inline]
    pub fn sign(self) -> f32 {
        f32::from_bits(1f32.to_bits() | u32::from(self.0 & 1) << 31)
    }

    /// Axes of the face coordinates u and v.
    #[must_use]
    #[inline]
    pub fn uv_axes(self) -> [usize; 2] {
        [(self.axis() + 1) % 3, (self.axis() + 2) % 3]
    }

    /// Face and face coordinates of a direction of any length but 0.
    #[must_use]
    #[inline(always)]
    pub fn from_direction(d: Vec3) -> (Self, f32, f32) {
        let a = d.abs();
        let axis = if a.x >= a.y && a.x >= a.z {
            0
        } else if a.y >= a.z {
            1
        } else {
            2
        };
        let face = Self((2 * axis + usize::from(d[axis] < 0.0)) as u8);
        let inverse = 1.0 / a[axis];
        let [ua, va] = face.uv_axes();
        (face, d[ua] * inverse, d[va] * inverse)
    }

    /// Direction of face coordinates, not normalized: its major component is ±1.
    #[must_use]
    #[inline]
    pub fn direction(self, u: f32, v: f32) -> Vec3 {
        let mut d = Vec3::ZERO;
        d[self.axis()] = self.sign();
        let [ua, va] = self.uv_axes();
        d[ua] = u;
        d[va] = v;
        d
    }
}

/// One texel of a [`CubeMap`] grid and its exact integrals over the sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubeTexel {
    /// Unit direction of the texel's center.
    pub direction: Vec3,
    /// Solid angle in steradians.
    pub solid_angle_sr: f32,
    /// `∫ d dω` over the texel: its dot product with a normal is the texel's projected solid angle
    /// where the whole texel is above the horizon.
    pub vector: Vec3,
}

/// Geometry of a cube map with `n × n` texels on each face, in gnomonic (linear) spacing. Texel
/// `(face, row, column)` has index `(face·n + row)·n + column`; columns run along u, rows along v.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CubeMap {
    n: usize,
}

impl CubeMap {
    /// A map with `n` texels along each edge.
    ///
    /// # Panics
    ///
    /// If `n` is 0.
    #[must_use]
    pub fn new(n: usize) -> Self {
        assert!(n > 0, "a cube map needs at least one texel per face");
        Self { n }
    }

    /// Texels along an edge.
    #[must_use]
    pub fn edge(&self) -> usize {
        self.n
    }

    /// Texels of all six faces.
    #[must_use]
    pub fn texel_count(&self) -> usize {
        6 * self.n * self.n
    }

    /// Index of the texel a direction falls into.
    #[must_use]
    #[inline(always)]
    pub fn texel_index(&self, direction: Vec3) -> usize {
        let (face, u, v) = CubeFace::from_direction(direction);
        let cell = |x: f32| (((x + 1.0) * 0.5 * self.n as f32) as usize).min(self.n - 1);
        (usize::from(face.0) * self.n + cell(v)) * self.n + cell(u)
    }

    /// A texel and the eight around it, on whichever face they lie; some are the same at corners of the cube.
    #[must_use]
    pub fn around(&self, index: usize) -> [usize; 9] {
        let n = self.n;
        let step = 2.0 / n as f32;
        let face = CubeFace((index / (n * n)) as u8);
        let middle = |i: usize| (i as f32 + 0.5) * step - 1.0;
        let (u, v) = (middle(index % n), middle(index / n % n));
        std::array::from_fn(|i| {
            let shift = |i: usize| (i as f32 - 1.0) * step;
            // Beyond its edge, the plane of a face shows what lies on the next.
            self.texel_index(face.direction(u + shift(i % 3), v + shift(i / 3)))
        })
    }

    /// Face coordinates of texel boundary `i` in 0..=n.
    #[must_use]
    pub fn boundary(&self, i: usize) -> f32 {
        -1.0 + 2.0 * i as f32 / self.n as f32
    }

    /// Integrals of texel `index`.
    #[must_use]
    pub fn texel(&self, index: usize) -> CubeTexel {
        let (column, row, face) =
            (index % self.n, index / self.n % self.n, index / (self.n * self.n));
        let face = CubeFace(face as u8);
        let coordinate = |i: usize| -1.0 + 2.0 * i as f64 / self.n as f64;
        let (u0, u1) = (coordinate(column), coordinate(column + 1));
        let (v0, v1) = (coordinate(row), coordinate(row + 1));
        let [ua, va] = face.uv_axes();
        let (along, u_sum, v_sum) = rectangle_vector(u0, u1, v0, v1);
        let mut vector = Vec3::ZERO;
        vector[face.axis()] = along as f32 * face.sign();
        vector[ua] = u_sum as f32;
        vector[va] = v_sum as f32;
        CubeTexel {
            direction: face
                .direction(((u0 + u1) * 0.5) as f32, ((v0 + v1) * 0.5) as f32)
                .normalize(),
            solid_angle_sr: rectangle_solid_angle(u0, u1, v0, v1) as f32,
            vector,
        }
    }

    /// All texels in index order.
    #[must_use]
    pub fn texels(&self) -> Vec<CubeTexel> {
        (0..self.texel_count()).map(|i| self.texel(i)).collect()
    }
}

/// Solid angle of the rectangle `u0..u1 × v0..v1` on the plane at distance 1: the mixed second
/// difference of `atan(u v / √(1 + u² + v²))`.
fn rectangle_solid_angle(u0: f64, u1: f64, v0: f64, v1: f64) -> f64 {
    let corner = |u: f64, v: f64| (u * v).atan2((1.0 + u * u + v * v).sqrt());
    corner(u1, v1) - corner(u0, v1) - corner(u1, v0) + corner(u0, v0)
}

/// `∫ d dω` over the same rectangle as (component along the plane's normal, along u, along v).
/// With `dω = du dv / ρ³`, `ρ² = 1 + u² + v²`, the integrands are `(1, u, v) / ρ⁴`; one
/// integration is closed, giving edge terms `atan(t/√(1+s²)) / √(1+s²)` (Lambert's formula).
fn rectangle_vector(u0: f64, u1: f64, v0: f64, v1: f64) -> (f64, f64, f64) {
    // ∫∫ s-component: for the edge at coordinate s spanned by t, half of atan(t/√(1+s²))/√(1+s²).
    let edge = |s: f64, t0: f64, t1: f64| {
        let k = (1.0 + s * s).sqrt();
        ((t1 / k).atan() - (t0 / k).atan()) / (2.0 * k)
    };
    let along_u = edge(u0, v0, v1) - edge(u1, v0, v1);
    let along_v = edge(v0, u0, u1) - edge(v1, u0, u1);
    let along_w = u1 * edge(u1, v0, v1) - u0 * edge(u0, v0, v1) + v1 * edge(v1, u0, u1)
        - v0 * edge(v0, u0, u1);
    (along_w, along_u, along_v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn directions_round_trip_on_every_face() {
        for face in CubeFace::ALL {
            for (u, v) in [(0.0, 0.0), (0.9, -0.3), (-0.5, 0.99)] {
                let (f, fu, fv) = CubeFace::from_direction(face.direction(u, v) * 3.0);
                assert_eq!(f, face);
                assert!((fu - u).abs() < 1e-6 && (fv - v).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn texels_tile_the_sphere() {
        for n in [1, 2, 8, 13] {
            let map = CubeMap::new(n);
            let texels = map.texels();
            let total: f32 = texels.iter().map(|t| t.solid_angle_sr).sum();
            assert!((total / (4.0 * PI) - 1.0).abs() < 1e-5);
            let sum: Vec3 = texels.iter().map(|t| t.vector).sum();
            assert!(sum.length() < 1e-4);
            for (i, texel) in texels.iter().enumerate() {
                assert_eq!(map.texel_index(texel.direction), i);
            }
            // One face: ∫ cos dω, by the form factor of a square seen from its axis at distance
            // equal to half its edge.
            let face: f32 = texels[..n * n].iter().map(|t| t.vector.x).sum();
            let expected = 4.0 * (1.0 / 2f32.sqrt()) * (1.0 / 2f32.sqrt()).atan();
            assert!((face - expected).abs() < 1e-5, "{face} {expected}");
        }
    }

    #[test]
    fn texel_vectors_match_quadrature() {
        let map = CubeMap::new(3);
        for index in [0, 5, 22, 40, 53] {
            let texel = map.texel(index);
            let (column, row, face) = (index % 3, index / 3 % 3, CubeFace((index / 9) as u8));
            let steps = 100;
            let (mut vector, mut omega) = ([0f64; 3], 0f64);
            for i in 0..steps {
                for j in 0..steps {
                    let at = |cell: usize, k: usize| {
                        -1.0 + 2.0 * (cell as f32 + (k as f32 + 0.5) / steps as f32) / 3.0
                    };
                    let d = face.direction(at(column, i), at(row, j));
                    let weight = f64::from((2.0 / 3.0 / steps as f32).powi(2) / d.length().powi(3));
                    let unit = d.normalize();
                    omega += weight;
                    for k in 0..3 {
                        vector[k] += f64::from(unit[k]) * weight;
                    }
                }
            }
            assert!((omega - f64::from(texel.solid_angle_sr)).abs() < 1e-4);
            for k in 0..3 {
                assert!((vector[k] - f64::from(texel.vector[k])).abs() < 1e-4, "{index} {k}");
            }
        }
    }
}
