//! Orthonormal frames.

use glam::Vec3;

/// A right-handed orthonormal frame whose third axis is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// First tangent.
    pub tangent: Vec3,
    /// Second tangent.
    pub bitangent: Vec3,
    /// The unit vector the frame was built around.
    pub normal: Vec3,
}

impl Frame {
    /// Frame around the unit vector `normal`, continuous everywhere but at `normal.z = 0`
    /// changing sign. Duff et al., "Building an Orthonormal Basis, Revisited" (2017).
    #[must_use]
    #[inline]
    pub fn from_normal(normal: Vec3) -> Self {
        let sign = 1f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    /// World direction of local coordinates (tangent, bitangent, normal).
    #[must_use]
    #[inline]
    pub fn to_world(&self, local: Vec3) -> Vec3 {
        self.tangent * local.x + self.bitangent * local.y + self.normal * local.z
    }

    /// Local coordinates (tangent, bitangent, normal) of a world direction.
    #[must_use]
    #[inline]
    pub fn to_local(&self, world: Vec3) -> Vec3 {
        Vec3::new(world.dot(self.tangent), world.dot(self.bitangent), world.dot(self.normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        for i in 0..1000u32 {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 1000.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let n = Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize();
            let f = Frame::from_normal(n);
            assert!(f.tangent.dot(f.bitangent).abs() < 1e-6);
            assert!(f.tangent.dot(n).abs() < 1e-6);
            assert!((f.tangent.cross(f.bitangent) - n).length() < 1e-5);
            let v = Vec3::new(0.2, -0.7, 0.4);
            assert!((f.to_local(f.to_world(v)) - v).length() < 1e-5);
        }
    }
}
