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

/// Rectangle around the projection of the box `low..=high` (relative to the cube's center) on
/// `face`, or none where the box does not reach into that face's pyramid.
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
    let (nu0, nu1) = (low[ua] * inverse_near, high[ua] * inverse_near);
    let (nv0, nv1) = (low[va] * inverse_near, high[va] * inverse_near);
    let (fu0, fu1) = (low[ua] * inverse_far, high[ua] * inverse_far);
    let (fv0, fv1) = (low[va] * inverse_far, high[va] * inverse_far);
    let (u0, u1) = (smaller(nu0, fu0), larger(nu1, fu1));
    let (v0, v1) = (smaller(nv0, fv0), larger(nv1, fv1));
    let (u0, u1) = (larger(u0, -1.0), smaller(u1, 1.0));
    let (v0, v1) = (larger(v0, -1.0), smaller(v1, 1.0));
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
    fn flat_boxes_facing_the_center_are_their_rectangles() {
        let (low, high) = (Vec3::new(-0.5, -0.5, -2.0), Vec3::new(0.5, 0.5, -2.0));
        let (rectangles, count) = project_box(low, high);
        assert_eq!(count, 1);
        let r = rectangles[0];
        assert_eq!((r.u0, r.u1, r.v0, r.v1), (-0.25, 0.25, -0.25, 0.25));
    }
}
