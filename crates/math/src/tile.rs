//! The rectangle a surfel stands for: its long edge's direction in eight bits, its edges from two sizes.

use crate::Frame;
use glam::Vec3;

/// Direction of the long edge of a rectangle in its plane, in 8 bits; 0 where no rectangle is known.
///
/// Codes 1 to 255 are `t = (code − 128) / 127`, the tangent of half the angle from the first tangent of
/// [`Frame::from_normal`], −90° to 90°: the direction is `((1 − t²) tangent + 2 t bitangent) / (1 + t²)`. It is off by
/// less than 0.46° (`tests::directions_come_back`), and exact at −90°, 0° and 90°.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileCode(pub u8);

impl TileCode {
    /// No rectangle.
    pub const NONE: Self = Self(0);

    /// Code of the direction, of any length, that `long_edge` has in the plane with this unit normal. The code means
    /// the same only with the very same normal: take the one that is stored.
    #[must_use]
    pub fn from_direction(normal: Vec3, long_edge: Vec3) -> Self {
        let local = Frame::from_normal(normal).to_local(long_edge);
        let length = local.x.hypot(local.y);
        if !(length > 0.0 && length.is_finite()) {
            return Self::NONE;
        }
        // An edge has no sense: the half with x ≥ 0 will do.
        let t = local.y * 1f32.copysign(local.x) / (length + local.x.abs());
        Self((128.0 + (t * 127.0).round()) as u8)
    }

    /// Whether a rectangle is known.
    #[must_use]
    #[inline(always)]
    pub fn is_known(self) -> bool {
        self.0 != 0
    }

    /// Unit vectors along the long and the short edge of a known rectangle with this unit normal.
    #[must_use]
    #[inline(always)]
    pub fn edges(self, normal: Vec3) -> [Vec3; 2] {
        let frame = Frame::from_normal(normal);
        let t = (f32::from(self.0) - 128.0) * (1.0 / 127.0);
        let scale = 1.0 / (1.0 + t * t);
        let (cos, sin) = ((1.0 - t * t) * scale, 2.0 * t * scale);
        [frame.tangent * cos + frame.bitangent * sin, frame.bitangent * cos - frame.tangent * sin]
    }
}

/// Half the long and half the short edge of the rectangle with this area and this radius of its circumscribed circle:
/// `(l ± s)² = 4 r² ± 2 a`. A radius too small for the area gives the square.
#[must_use]
#[inline]
pub fn rectangle_half_edges(radius: f32, area: f32) -> [f32; 2] {
    let (squares, product) = (4.0 * radius * radius, 2.0 * area);
    let sum = squares.max(product) + product;
    let difference = (squares - product).max(0.0);
    // The short edge from the area: nothing cancels, and the area is exact.
    let long = 0.25 * (sum.sqrt() + difference.sqrt());
    [long, 0.25 * area / long]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{decode_octahedral24, encode_octahedral24};

    #[test]
    fn directions_come_back() {
        let mut worst = 0f32;
        for i in 0..20_000u32 {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 20_000.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let normal = Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize();
            let frame = Frame::from_normal(normal);
            let (sin, cos) = (i as f32 * 0.37).sin_cos();
            let direction = frame.tangent * cos + frame.bitangent * sin;
            let code = TileCode::from_direction(normal, direction * 0.01);
            assert!(code.is_known());
            let [long, short] = code.edges(normal);
            assert!((long.length() - 1.0).abs() < 1e-5 && (short.length() - 1.0).abs() < 1e-5);
            assert!(long.dot(normal).abs() < 1e-5 && long.dot(short).abs() < 1e-5);
            assert!((long.cross(short) - normal).length() < 1e-4);
            worst = worst.max(long.cross(direction).length());
        }
        assert!(worst.to_degrees() < 0.46, "{}°", worst.to_degrees());
    }

    #[test]
    fn edges_along_axes_are_exact() {
        for (normal, edge) in
            [(Vec3::Y, Vec3::X), (Vec3::Y, Vec3::NEG_Z), (Vec3::X, Vec3::Y), (Vec3::NEG_Z, Vec3::Y)]
        {
            let [long, _] = TileCode::from_direction(normal, edge).edges(normal);
            assert!((long.dot(edge).abs() - 1.0).abs() < 1e-7, "{normal} {edge}");
        }
        assert_eq!(TileCode::from_direction(Vec3::Y, Vec3::Y), TileCode::NONE);
        assert_eq!(TileCode::from_direction(Vec3::Y, Vec3::NAN), TileCode::NONE);
    }

    #[test]
    fn rectangles_follow_from_their_area_and_radius() {
        for aspect in [1.0f32, 1.001, 1.3, 4.0, 100.0] {
            for area in [1e-12f32, 0.3, 1e9] {
                let (long, short) = (0.5 * (area * aspect).sqrt(), 0.5 * (area / aspect).sqrt());
                let [l, s] = rectangle_half_edges(long.hypot(short), area);
                assert!((l / long - 1.0).abs() < 1e-3 && (s / short - 1.0).abs() < 1e-3);
                assert!((4.0 * l * s / area - 1.0).abs() < 1e-6);
            }
        }
        assert_eq!(rectangle_half_edges(0.1, 4.0), [1.0, 1.0]);
    }

    #[test]
    fn stored_normals_are_stored_again_without_change() {
        // Else a copied code would turn the rectangle: frames jump where z changes its sign.
        for code in 0..1 << 24 {
            let normal = decode_octahedral24(code);
            let again = decode_octahedral24(encode_octahedral24(normal));
            assert!((normal - again).length() < 1e-6, "{code:#x}: {normal} {again}");
            assert_eq!(normal.z.is_sign_negative(), again.z.is_sign_negative(), "{code:#x}");
        }
    }
}
