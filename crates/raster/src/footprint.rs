//! The footprint of an axis-aligned box on the faces of a world-aligned cube.

use pbgi_math::{CubeFace, Vec3};

use crate::{larger, smaller};

/// A rectangle in the coordinates of a cube face, inside −1..=1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaceRectangle {
    /// Face index, see [`CubeFace`].
    pub face: u8,
    /// Smallest u.
    pub u0: f32,
    /// Largest u.
    pub u1: f32,
    /// Smallest v.
    pub v0: f32,
    /// Largest v.
    pub v1: f32,
}

impl FaceRectangle {
    /// Solid angle in steradians. A face element of area `du dv` at `(u, v)` subtends
    /// `du dv / (1 + u² + v²)^(3/2)`: five times less in a corner than in the middle. Midpoint
    /// rule where the rectangle is small (error below 1 %), exact corner formula elsewhere.
    #[must_use]
    #[inline(always)]
    pub fn solid_angle_sr(&self) -> f32 {
        let (du, dv) = (self.u1 - self.u0, self.v1 - self.v0);
        if larger(du, dv) <= 0.25 {
            let (u, v) = (0.5 * (self.u0 + self.u1), 0.5 * (self.v0 + self.v1));
            let s = 1.0 + u * u + v * v;
            return du * dv / (s * s.sqrt());
        }
        self.solid_angle_exact()
    }

    #[inline(never)]
    fn solid_angle_exact(&self) -> f32 {
        let corner = |u: f32, v: f32| (u * v).atan2((1.0 + u * u + v * v).sqrt());
        corner(self.u1, self.v1) - corner(self.u0, self.v1) - corner(self.u1, self.v0)
            + corner(self.u0, self.v0)
    }
}

/// Rectangle around the projection of the box `low..=high` (relative to the cube's center) on
/// `face`, or none where the box does not reach into that face's pyramid.
///
/// Exact for a box that is flat along the face's axis; else the smallest rectangle around its
/// silhouette.
#[inline(always)]
fn project_on_face(low: Vec3, high: Vec3, face: CubeFace) -> Option<FaceRectangle> {
    let axis = face.axis();
    let [ua, va] = face.uv_axes();
    let (near, far) =
        if face.sign() > 0.0 { (low[axis], high[axis]) } else { (-high[axis], -low[axis]) };
    // Inside the pyramid the depth exceeds |u| and |v| of every point.
    let reach = |low: f32, high: f32| larger(larger(low, -high), 0.0);
    let near = larger(near, larger(reach(low[ua], high[ua]), reach(low[va], high[va])));
    if far < near || far <= 0.0 {
        return None;
    }
    let inverse_near = 1.0 / larger(near, far * 1e-6);
    let inverse_far = 1.0 / far;
    let project = |low: f32, high: f32| {
        let a = low * if low >= 0.0 { inverse_far } else { inverse_near };
        let b = high * if high >= 0.0 { inverse_near } else { inverse_far };
        (larger(a, -1.0), smaller(b, 1.0))
    };
    let (u0, u1) = project(low[ua], high[ua]);
    let (v0, v1) = project(low[va], high[va]);
    (u0 <= u1 && v0 <= v1).then_some(FaceRectangle { face: face.0, u0, u1, v0, v1 })
}

/// Rectangles of the box `low..=high` on all faces it reaches, and their number. The box is given relative to the
/// cube's center, which it must not contain.
#[inline(always)]
#[must_use]
pub fn project_box(low: Vec3, high: Vec3) -> ([FaceRectangle; 6], usize) {
    let mut rectangles = [FaceRectangle::default(); 6];
    let center = low + high;
    let (face, ..) = CubeFace::from_direction(center);
    if let Some(main) = project_on_face(low, high, face) {
        rectangles[0] = main;
        // Strictly inside one face: the common case by far.
        if main.u0 > -1.0 && main.u1 < 1.0 && main.v0 > -1.0 && main.v1 < 1.0 {
            return (rectangles, 1);
        }
    }
    project_on_all(low, high)
}

#[inline(never)]
fn project_on_all(low: Vec3, high: Vec3) -> ([FaceRectangle; 6], usize) {
    let mut rectangles = [FaceRectangle::default(); 6];
    let mut count = 0;
    for face in CubeFace::ALL {
        if let Some(rectangle) = project_on_face(low, high, face) {
            rectangles[count] = rectangle;
            count += 1;
        }
    }
    (rectangles, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directions toward random points of the box.
    fn points(low: Vec3, high: Vec3) -> impl Iterator<Item = Vec3> {
        (0..2000u32).map(move |i| {
            let f = |k: u32| (i.wrapping_mul(k) >> 7) as f32 % 1009.0 / 1008.0;
            low + (high - low) * Vec3::new(f(2_654_435_761), f(40_503_227), f(1_442_695_041))
        })
    }

    #[test]
    fn every_point_of_a_box_falls_into_its_rectangles() {
        let boxes = [
            (Vec3::new(1.0, -0.2, -0.3), Vec3::new(1.5, 0.4, 0.1)),
            (Vec3::new(0.8, 0.7, -0.3), Vec3::new(1.2, 1.3, 0.2)),
            (Vec3::new(-2.0, -1.1, -1.3), Vec3::new(2.0, -1.0, 1.9)),
            (Vec3::new(-1.1, -1.2, -1.3), Vec3::new(-0.9, -0.8, -0.7)),
            (Vec3::new(0.1, -5.0, -5.0), Vec3::new(0.2, 5.0, 5.0)),
        ];
        for (low, high) in boxes {
            let (rectangles, count) = project_box(low, high);
            for p in points(low, high) {
                let (face, u, v) = CubeFace::from_direction(p);
                let inside = rectangles[..count].iter().any(|r| {
                    let e = 1e-5;
                    r.face == face.0
                        && (r.u0 - e..=r.u1 + e).contains(&u)
                        && (r.v0 - e..=r.v1 + e).contains(&v)
                });
                assert!(inside, "{low} {high}: {p}");
            }
        }
    }

    #[test]
    fn flat_boxes_project_exactly() {
        // A square facing the center: its solid angle has a closed form.
        let (low, high) = (Vec3::new(-0.5, -0.5, -2.0), Vec3::new(0.5, 0.5, -2.0));
        let (rectangles, count) = project_box(low, high);
        assert_eq!(count, 1);
        let exact = 4.0 * (0.25f32 * 0.25).atan2((1.0f32 + 2.0 * 0.0625).sqrt());
        assert!((rectangles[0].solid_angle_sr() / exact - 1.0).abs() < 1e-4);
    }

    #[test]
    fn rectangle_solid_angle_is_within_one_percent() {
        for i in 0..200 {
            let (u, v) = (-0.99 + 0.0085 * i as f32, 0.87 - 0.0093 * i as f32);
            let side = 0.01 + 0.0012 * i as f32;
            let r = FaceRectangle { face: 0, u0: u, u1: u + side, v0: v, v1: v + side };
            assert!((r.solid_angle_sr() / r.solid_angle_exact() - 1.0).abs() < 0.01, "{r:?}");
        }
    }
}
