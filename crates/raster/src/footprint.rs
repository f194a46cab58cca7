//! The footprint of an axis-aligned box on the faces of a world-aligned cube.

use pbgi_math::{CubeFace, Vec3, larger, smaller};

use crate::shape::turn;

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
    let face = main_face(low + high);
    if let Some(main) = project_on_face(low, high, face) {
        // Strictly inside one face: the common case by far.
        if larger(larger(-main.u0, main.u1), larger(-main.v0, main.v1)) < INSIDE {
            visit(&main);
            return;
        }
        // All of it before the face: what reaches over the face's borders falls on the faces beside it, and nothing on the one behind.
        if turn_box(low, high, face).0.x > 0.0 {
            visit(&main);
            let axis = face.axis() as u8;
            for (axis, low_end, high_end) in
                [((axis + 1) % 3, main.u0, main.u1), ((axis + 2) % 3, main.v0, main.v1)]
            {
                for (side, end) in [(0, high_end), (1, -low_end)] {
                    if end >= INSIDE
                        && let Some(beside) = project_on_face(low, high, CubeFace(2 * axis + side))
                    {
                        visit(&beside);
                    }
                }
            }
            return;
        }
    }
    for face in CubeFace::ALL {
        if let Some(rectangle) = project_on_face(low, high, face) {
            visit(&rectangle);
        }
    }
}

/// Boxes that are looked at together.
pub const BOXES: usize = 8;

/// The face and, in its coordinates, the rectangle around the projection of each of eight boxes that lie strictly inside of one face's pyramid; a
/// face of 255 where one does not. As [`project_box`] finds it.
#[inline(always)]
pub(crate) fn project_inside(
    low: &[[f32; BOXES]; 3],
    high: &[[f32; BOXES]; 3],
) -> ([i32; BOXES], [[f32; BOXES]; 4]) {
    let (mut faces, mut rectangles) = ([0; BOXES], [[0.0; BOXES]; 4]);
    for i in 0..BOXES {
        let (lx, ly, lz) = (low[0][i], low[1][i], low[2][i]);
        let (hx, hy, hz) = (high[0][i], high[1][i], high[2][i]);
        let (ax, ay, az) = ((lx + hx).abs(), (ly + hy).abs(), (lz + hz).abs());
        let is_x = ax >= larger(ay, az);
        let is_y = !is_x & (ay >= az);
        // Along the face's axis, u and v.
        let pick = |x: f32, y: f32, z: f32| {
            let yz = if is_y { y } else { z };
            if is_x { x } else { yz }
        };
        let (dl, dh) = (pick(lx, ly, lz), pick(hx, hy, hz));
        let (ul, uh) = (pick(ly, lz, lx), pick(hy, hz, hx));
        let (vl, vh) = (pick(lz, lx, ly), pick(hz, hx, hy));
        let is_negative = dl + dh < 0.0;
        let (first, far) = if is_negative { (-dh, -dl) } else { (dl, dh) };
        let near = larger(larger(first, 0.0), larger(larger(ul, -uh), larger(vl, -vh)));
        let inverse_near = 1.0 / larger(near, far * 1e-6);
        let inverse_far = 1.0 / far;
        let project_low = |x: f32| x * if x < 0.0 { inverse_near } else { inverse_far };
        let project_high = |x: f32| x * if x > 0.0 { inverse_near } else { inverse_far };
        let (u0, u1) = (larger(project_low(ul), -1.0), smaller(project_high(uh), 1.0));
        let (v0, v1) = (larger(project_low(vl), -1.0), smaller(project_high(vh), 1.0));
        let reach = larger(larger(-u0, u1), larger(-v0, v1));
        let is_there = (near <= far) & (far > 0.0) & (u0 <= u1) & (v0 <= v1);
        let axis = if is_x { 0 } else { 4 - 2 * i32::from(is_y) };
        let is_inside = is_there & (reach < INSIDE);
        faces[i] = if is_inside { axis + i32::from(is_negative) } else { 255 };
        let kept = |x: f32| if is_inside { x } else { 0.0 };
        for (plane, x) in rectangles.iter_mut().zip([u0, u1, v0, v1]) {
            plane[i] = kept(x);
        }
    }
    (faces, rectangles)
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
    fn eight_boxes_at_a_time_have_the_same_rectangles() {
        let mut seed = 1;
        let mut random = || crate::random(&mut seed);
        let mut inside_count = 0;
        for _ in 0..4000 {
            let (mut low, mut high) = ([[0.0; BOXES]; 3], [[0.0; BOXES]; 3]);
            for lane in 0..BOXES {
                let size = 0.3 * random().abs();
                for axis in 0..3 {
                    low[axis][lane] = random();
                    high[axis][lane] = low[axis][lane] + size * random().abs();
                }
            }
            let (faces, planes) = project_inside(&low, &high);
            for lane in 0..BOXES {
                let corner =
                    |of: &[[f32; BOXES]; 3]| Vec3::from_array([0, 1, 2].map(|i| of[i][lane]));
                let expected = rectangles(corner(&low), corner(&high));
                if faces[lane] == 255 {
                    let on_border = expected
                        .iter()
                        .all(|r| larger(larger(-r.u0, r.u1), larger(-r.v0, r.v1)) >= INSIDE);
                    assert!(expected.len() != 1 || on_border, "{expected:?}");
                    continue;
                }
                inside_count += 1;
                let [u0, u1, v0, v1] = planes.each_ref().map(|plane| plane[lane]);
                let face = faces[lane] as u8;
                assert_eq!(expected, [FaceRectangle { face, u0, u1, v0, v1 }]);
            }
        }
        assert!(inside_count > 10_000, "{inside_count}");
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
    fn no_face_that_a_box_reaches_is_left_out() {
        let mut seed = 7;
        let mut random = || crate::random(&mut seed);
        let mut several = 0;
        for _ in 0..20_000 {
            let mut vector = || Vec3::new(random(), random(), random());
            let (low, size) = (vector(), vector().abs());
            let high = low + size;
            if low.cmple(Vec3::ZERO).all() && high.cmpge(Vec3::ZERO).all() {
                continue;
            }
            let on_all = CubeFace::ALL.into_iter().filter_map(|f| project_on_face(low, high, f));
            let expected: Vec<_> = on_all.collect();
            let mut found = rectangles(low, high);
            found.sort_by_key(|r| r.face);
            let is_area = |r: &&FaceRectangle| r.u0 < r.u1 && r.v0 < r.v1;
            let found: Vec<_> = found.iter().filter(is_area).collect();
            let expected: Vec<_> = expected.iter().filter(is_area).collect();
            // Inside of one face, what touches another by its border alone is left out.
            if found.len() > 1 {
                several += 1;
                assert_eq!(found, expected, "{low} {high}");
            }
        }
        assert!(several > 5_000, "{several}");
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
