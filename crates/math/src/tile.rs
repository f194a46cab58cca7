//! The rectangle or triangle a surfel stands for: the direction of an edge in eight bits, the edges from two sizes.

use crate::Frame;
use glam::Vec3;

/// Steps of a [`TileCode`] in a right angle, where it means a direction and not a line.
const STEPS_PER_QUARTER: u8 = 63;

/// Tangent of 22.5°: half of the angle by which a quarter's directions are off its middle at most.
const QUARTER_TANGENT: f32 = 0.414_213_56;

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
        let Some(([x, y], length)) = in_plane(normal, long_edge) else { return Self::NONE };
        // An edge has no sense: the half with x ≥ 0 will do.
        let t = y * 1f32.copysign(x) / (length + x.abs());
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
        turned(normal, double_angle((f32::from(self.0) - 128.0) * (1.0 / 127.0)))
    }

    /// Code of a direction in the plane with this unit normal, of any length, whose sense matters: an edge of a triangle. Codes 1 to 252
    /// are quarters of 63 steps around −180°, −90°, 0° and 90° from the first tangent of [`Frame::from_normal`], each by the tangent of half the angle
    /// from there; off by less than 0.76° (`tests::senses_come_back`), and exact in the middle of the quarters.
    #[must_use]
    pub fn from_sense(normal: Vec3, direction: Vec3) -> Self {
        let Some(([x, y], length)) = in_plane(normal, direction) else { return Self::NONE };
        // Turned by so many right angles it lies in −45°..=45°.
        let (quarter, x, y) = match (x.abs() >= y.abs(), x >= 0.0, y >= 0.0) {
            (true, true, _) => (2, x, y),
            (true, false, _) => (0, -x, -y),
            (false, _, true) => (3, y, -x),
            (false, _, false) => (1, -y, x),
        };
        let half = f32::from(STEPS_PER_QUARTER / 2);
        let step = (y / (length + x) * ((half + 0.5) / QUARTER_TANGENT)).round().clamp(-half, half);
        Self(1 + quarter * STEPS_PER_QUARTER + (half + step) as u8)
    }

    /// Unit vectors along the direction of [`Self::from_sense`], and a right angle to its left, seen against the normal.
    #[must_use]
    #[inline(always)]
    pub fn axes(self, normal: Vec3) -> [Vec3; 2] {
        let code = self.0.saturating_sub(1);
        let (quarter, step) = (code / STEPS_PER_QUARTER, code % STEPS_PER_QUARTER);
        let half = f32::from(STEPS_PER_QUARTER / 2);
        let [x, y] = double_angle((f32::from(step) - half) * (QUARTER_TANGENT / (half + 0.5)));
        let cos_sin = match quarter {
            0 => [-x, -y],
            1 => [y, -x],
            2 => [x, y],
            _ => [-y, x],
        };
        turned(normal, cos_sin)
    }
}

/// The part of a direction that lies in the plane with this unit normal, along the tangents of [`Frame::from_normal`], and its length; none where
/// that is 0 or no number.
fn in_plane(normal: Vec3, direction: Vec3) -> Option<([f32; 2], f32)> {
    let local = Frame::from_normal(normal).to_local(direction);
    let length = local.x.hypot(local.y);
    (length > 0.0 && length.is_finite()).then_some(([local.x, local.y], length))
}

/// Cosine and sine of an angle by the tangent of its half.
#[inline(always)]
fn double_angle(t: f32) -> [f32; 2] {
    let scale = 1.0 / (1.0 + t * t);
    [(1.0 - t * t) * scale, 2.0 * t * scale]
}

/// The tangents of [`Frame::from_normal`], turned by an angle with this cosine and sine.
#[inline(always)]
fn turned(normal: Vec3, [cos, sin]: [f32; 2]) -> [Vec3; 2] {
    let Frame { tangent, bitangent, .. } = Frame::from_normal(normal);
    [tangent * cos + bitangent * sin, bitangent * cos - tangent * sin]
}

/// Where the foot of a triangle's height lies on its longest edge, in 7 bits; 0 where the shape is no triangle.
///
/// Codes 1 to 127 are `(code − 1) / 126` of the edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FootCode(pub u8);

impl FootCode {
    /// No triangle.
    pub const NONE: Self = Self(0);

    /// Largest code.
    pub const MAX: u8 = 127;

    /// Code of a share of the longest edge, 0..=1.
    #[must_use]
    pub fn from_share(share: f32) -> Self {
        Self(1 + (share.clamp(0.0, 1.0) * f32::from(Self::MAX - 1)).round() as u8)
    }

    /// Whether the shape is a triangle.
    #[must_use]
    #[inline(always)]
    pub fn is_known(self) -> bool {
        self.0 != 0
    }

    /// The share.
    #[must_use]
    #[inline(always)]
    pub fn share(self) -> f32 {
        f32::from(self.0.saturating_sub(1)) * (1.0 / (Self::MAX - 1) as f32)
    }
}

/// Corners of a triangle in the plane, from its centroid, along its longest edge and at a right angle to it: start and end of
/// that edge, of this length, and the corner at this height over this share of it.
#[must_use]
#[inline(always)]
pub fn triangle_corners(base: f32, height: f32, foot: f32) -> [[f32; 2]; 3] {
    let third = 1.0 / 3.0;
    let (start, low) = (-(1.0 + foot) * third * base, -third * height);
    [[start, low], [start + base, low], [start + foot * base, low + height]]
}

/// Distance of the farthest corner of a triangle from its centroid, by its longest edge, area, and foot.
#[must_use]
pub fn triangle_radius(base: f32, area: f32, foot: f32) -> f32 {
    triangle_corners(base, 2.0 * area / base, foot)
        .into_iter()
        .map(|[x, y]| x.hypot(y))
        .fold(0.0, f32::max)
}

/// The longest edge of a triangle by that distance, its area, and foot: with `m` = max(1 + foot, 2 − foot) / 3 of the
/// edge `l` along it and a third of the height across, `r² = m² l² + (2 a / 3 l)²`. A radius too small for the area gives the least `l` of all.
#[must_use]
pub fn triangle_base(radius: f32, area: f32, foot: f32) -> f32 {
    let m2 = (1.0 + foot).max(2.0 - foot).powi(2) * (1.0 / 9.0);
    // By squares of the scale of the radius, which neither vanish nor overflow.
    let share = area / (radius * radius);
    let root = (1.0 - 16.0 / 9.0 * m2 * share * share).max(0.0).sqrt();
    radius * ((1.0 + root) / (2.0 * m2)).sqrt()
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

    /// Normals all over the sphere, and a direction at right angles to each.
    fn directions_in_planes() -> impl Iterator<Item = (Vec3, Vec3)> {
        (0..20_000u32).map(|i| {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 20_000.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let normal = Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize();
            let frame = Frame::from_normal(normal);
            let (sin, cos) = (i as f32 * 0.37).sin_cos();
            (normal, frame.tangent * cos + frame.bitangent * sin)
        })
    }

    #[test]
    fn directions_come_back() {
        let mut worst = 0f32;
        for (normal, direction) in directions_in_planes() {
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
    fn senses_come_back() {
        let mut worst = 0f32;
        for (normal, direction) in directions_in_planes() {
            let code = TileCode::from_sense(normal, direction * 0.01);
            let [along, left] = code.axes(normal);
            assert!((along.length() - 1.0).abs() < 1e-5 && along.dot(normal).abs() < 1e-5);
            assert!((along.cross(left) - normal).length() < 1e-4);
            assert!(along.dot(direction) > 0.9);
            worst = worst.max(along.cross(direction).length());
            // A code means itself.
            assert_eq!(TileCode::from_sense(normal, along), code);
        }
        assert!(worst.to_degrees() < 0.76, "{}°", worst.to_degrees());
        for axis in [Vec3::X, Vec3::NEG_X, Vec3::Z, Vec3::NEG_Z] {
            let [along, _] = TileCode::from_sense(Vec3::Y, axis).axes(Vec3::Y);
            assert!((along - axis).length() < 1e-6, "{axis} {along}");
        }
        assert_eq!(TileCode::from_sense(Vec3::Y, Vec3::Y), TileCode::NONE);
    }

    #[test]
    fn triangles_follow_from_their_area_radius_and_foot() {
        for foot in [0.0f32, 0.1, 0.5, 0.7, 1.0] {
            let foot = FootCode::from_share(foot).share();
            for height in [0.001f32, 0.1, 0.5, 0.86] {
                for base in [1e-4f32, 1.0, 1e4] {
                    let area = 0.5 * base * base * height;
                    let corners = triangle_corners(base, base * height, foot);
                    let [x, y]: [f32; 2] =
                        std::array::from_fn(|k| corners.iter().map(|corner| corner[k]).sum());
                    assert!(x.hypot(y) < 1e-5 * base);
                    // Where the other edges are no longer than the base.
                    if height.hypot(foot.max(1.0 - foot)) <= 1.0 {
                        let radius = triangle_radius(base, area, foot);
                        let found = triangle_base(radius, area, foot);
                        assert!(
                            (found / base - 1.0).abs() < 2e-3,
                            "{foot} {height} {found} {base}"
                        );
                    }
                }
            }
        }
        assert!(triangle_base(0.1, 4.0, 0.5).is_finite());
        assert_eq!(FootCode::NONE.share(), 0.0);
        assert_eq!(FootCode::from_share(f32::NAN).share(), 0.0);
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
        for code in (0..1 << 24).step_by(if cfg!(miri) { 9973 } else { 1 }) {
            let normal = decode_octahedral24(code);
            let again = decode_octahedral24(encode_octahedral24(normal));
            assert!((normal - again).length() < 1e-6, "{code:#x}: {normal} {again}");
            assert_eq!(normal.z.is_sign_negative(), again.z.is_sign_negative(), "{code:#x}");
        }
    }
}
