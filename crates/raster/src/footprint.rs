//! The footprint of an axis-aligned box on the faces of a world-aligned cube.

use pbgi_math::{CubeFace, Vec3};

use crate::shape::turn;
use crate::{larger, smaller};

/// A rectangle in the coordinates of a cube face, inside −1..=1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FaceRectangle {
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

/// A box in the coordinates (depth, u, v) of a face.
#[inline(always)]
fn turn_box(low: Vec3, high: Vec3, face: CubeFace) -> (Vec3, Vec3) {
    let (a, b) = (turn(low, face), turn(high, face));
    // The depth may have changed its sign, and its ends their order.
    (Vec3::new(smaller(a.x, b.x), a.y, a.z), Vec3::new(larger(a.x, b.x), b.y, b.z))
}

/// Rectangle around the projection of the box `low..=high` (relative to the cube's center) on
/// `face`, or none where the box does not reach into that face's pyramid.
#[inline(always)]
fn project_on_face(low: Vec3, high: Vec3, face: CubeFace) -> Option<FaceRectangle> {
    let (low, high) = turn_box(low, high, face);
    let far = high.x;
    // Inside the pyramid the depth exceeds |u| and |v| of every point.
    let reach = |low: f32, high: f32| larger(low, -high);
    let near = larger(larger(low.x, 0.0), larger(reach(low.y, high.y), reach(low.z, high.z)));
    if far < near || far <= 0.0 {
        return None;
    }
    let inverse_near = 1.0 / larger(near, far * 1e-6);
    let inverse_far = 1.0 / far;
    let project_low = |x: f32| x * if x < 0.0 { inverse_near } else { inverse_far };
    let project_high = |x: f32| x * if x > 0.0 { inverse_near } else { inverse_far };
    let (u0, u1) = (larger(project_low(low.y), -1.0), smaller(project_high(high.y), 1.0));
    let (v0, v1) = (larger(project_low(low.z), -1.0), smaller(project_high(high.z), 1.0));
    (u0 <= u1 && v0 <= v1).then_some(FaceRectangle { face: face.0, u0, u1, v0, v1 })
}

/// The face a direction falls on.
#[inline(always)]
fn main_face(d: Vec3) -> CubeFace {
    let a = d.abs();
    let yz = if a.y >= a.z { (2, d.y, a.y) } else { (4, d.z, a.z) };
    let (base, along, _) = if a.x >= yz.2 { (0, d.x, a.x) } else { yz };
    CubeFace(base + u8::from(along < 0.0))
}

/// Coordinates below this are inside a face: 1 but for what a product with a reciprocal may be rounded by. A flat box that stands on the border
/// of two faces must not be taken for one inside a face.
const INSIDE: f32 = 1.0 - 4.0 * f32::EPSILON;

/// Visits the rectangles of the box `low..=high` on all faces it reaches, at most six. The box is given
/// relative to the cube's center, which it must not contain.
#[inline(always)]
pub(crate) fn project_box(low: Vec3, high: Vec3, mut visit: impl FnMut(&FaceRectangle)) {
    if let Some(main) = project_on_face(low, high, main_face(low + high)) {
        // Strictly inside one face: the common case by far.
        if larger(larger(-main.u0, main.u1), larger(-main.v0, main.v1)) < INSIDE {
            visit(&main);
            return;
        }
    }
    for face in CubeFace::ALL {
        if let Some(rectangle) = project_on_face(low, high, face) {
            visit(&rectangle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rectangles(low: Vec3, high: Vec3) -> Vec<FaceRectangle> {
        let mut rectangles = Vec::new();
        project_box(low, high, |r| rectangles.push(*r));
        rectangles
    }

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
            let rectangles = rectangles(low, high);
            for p in points(low, high) {
                let (face, u, v) = CubeFace::from_direction(p);
                let inside = rectangles.iter().any(|r| {
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
    fn flat_boxes_over_the_border_of_faces_fall_on_both() {
        for i in 1..2000 {
            let depth = i as f32 * 0.000_713;
            let (low, high) = (
                Vec3::new(-0.1 * depth, 0.7 * depth, -depth),
                Vec3::new(0.2 * depth, 1.5 * depth, -depth),
            );
            let rectangles = rectangles(low, high);
            assert_eq!(rectangles.len(), 2, "{depth}: {rectangles:?}");
        }
    }

    #[test]
    fn flat_boxes_facing_the_center_are_their_rectangles() {
        let (low, high) = (Vec3::new(-0.5, -0.5, -2.0), Vec3::new(0.5, 0.5, -2.0));
        let rectangles = rectangles(low, high);
        assert_eq!(rectangles.len(), 1);
        let r = rectangles[0];
        assert_eq!((r.u0, r.u1, r.v0, r.v1), (-0.25, 0.25, -0.25, 0.25));
    }
}
