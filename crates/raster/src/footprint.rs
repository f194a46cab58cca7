//! The footprint of an axis-aligned box on the faces of a world-aligned cube.

use pbgi_math::{CubeFace, Vec3, larger, smaller};

/// A vector in the coordinates (depth, u, v) of a face.
#[inline(always)]
pub(crate) fn turn(p: Vec3, face: CubeFace) -> Vec3 {
    // Read from a ring: which axis it is cannot be predicted, a branch would cost more.
    let ring = [p.x, p.y, p.z, p.x, p.y, 0.0];
    let axis = face.axis() & 3;
    Vec3::new(ring[axis] * face.sign(), ring[axis + 1], ring[axis + 2])
}

/// Coordinates below this are inside a face: 1 but for what a product with a reciprocal may be rounded by. A flat box that stands on the border
/// of two faces must not be taken for one inside a face.
const INSIDE: f32 = 1.0 - 4.0 * f32::EPSILON;

/// Rectangles around the projections of eight boxes: smallest and largest u, smallest and largest v, inside −1..=1.
pub(crate) type Rectangles = [[f32; BOXES]; 4];

/// Rectangle around the projection of a box on a face, from the ends of the box along the face's axis, u and v; and whether there is any.
#[inline(always)]
fn project([first, far]: [f32; 2], [ul, uh]: [f32; 2], [vl, vh]: [f32; 2]) -> ([f32; 4], bool) {
    // Inside the face's pyramid the depth exceeds |u| and |v| of every point.
    let near = larger(larger(first, 0.0), larger(larger(ul, -uh), larger(vl, -vh)));
    let inverse_near = 1.0 / larger(near, far * 1e-6);
    let inverse_far = 1.0 / far;
    let u0 = larger(ul * if ul < 0.0 { inverse_near } else { inverse_far }, -1.0);
    let u1 = smaller(uh * if uh > 0.0 { inverse_near } else { inverse_far }, 1.0);
    let v0 = larger(vl * if vl < 0.0 { inverse_near } else { inverse_far }, -1.0);
    let v1 = smaller(vh * if vh > 0.0 { inverse_near } else { inverse_far }, 1.0);
    let is_there = (near <= far) & (far > 0.0) & (u0 <= u1) & (v0 <= v1);
    ([u0, u1, v0, v1], is_there)
}

/// The rectangles of the box `low..=high` on all faces, and bits that tell on which there is one, by the face's number. The box is given relative to the cube's
/// center, which it must not contain.
#[inline(always)]
pub(crate) fn project_box(low: Vec3, high: Vec3) -> (u8, Rectangles) {
    // Faces side by side; the last two lanes are none.
    let ([lx, ly, lz], [hx, hy, hz]) = (low.to_array(), high.to_array());
    let first = [lx, -hx, ly, -hy, lz, -hz, 0.0, 0.0];
    let far = [hx, -lx, hy, -ly, hz, -lz, 0.0, 0.0];
    let (ul, uh) = ([ly, ly, lz, lz, lx, lx, 0.0, 0.0], [hy, hy, hz, hz, hx, hx, 0.0, 0.0]);
    let (vl, vh) = ([lz, lz, lx, lx, ly, ly, 0.0, 0.0], [hz, hz, hx, hx, hy, hy, 0.0, 0.0]);
    let (mut found, mut is_there) = ([[0.0; BOXES]; 4], [0; BOXES]);
    for i in 0..BOXES {
        let ([u0, u1, v0, v1], there) = project([first[i], far[i]], [ul[i], uh[i]], [vl[i], vh[i]]);
        (found[0][i], found[1][i], found[2][i], found[3][i]) = (u0, u1, v0, v1);
        is_there[i] = u8::from(there) << i;
    }
    let faces = is_there.into_iter().fold(0, |faces, there| faces | there);
    (faces, found)
}

/// Boxes that are looked at together.
pub const BOXES: usize = 8;

/// The face and, in its coordinates, the rectangle around the projection of each of eight boxes that lie strictly inside of one face's pyramid; a
/// face of 255 where one does not. As [`project_box`] finds it.
#[inline(always)]
pub(crate) fn project_inside(
    low: &[[f32; BOXES]; 3],
    high: &[[f32; BOXES]; 3],
) -> ([i32; BOXES], Rectangles) {
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
        let ([u0, u1, v0, v1], is_there) = project([first, far], [ul, uh], [vl, vh]);
        let reach = larger(larger(-u0, u1), larger(-v0, v1));
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

    /// A rectangle on a face: the face, and smallest and largest u and v.
    type OnFace = (u8, [f32; 4]);

    fn rectangles(low: Vec3, high: Vec3) -> Vec<OnFace> {
        let (faces, planes) = project_box(low, high);
        let faces = (0..BOXES).filter(|face| faces >> face & 1 != 0);
        faces.map(|face| (face as u8, planes.each_ref().map(|plane| plane[face]))).collect()
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
                    let on_border = |(_, [u0, u1, v0, v1]): &OnFace| {
                        larger(larger(-u0, *u1), larger(-v0, *v1)) >= INSIDE
                    };
                    assert!(expected.len() != 1 || expected.iter().all(on_border), "{expected:?}");
                    continue;
                }
                inside_count += 1;
                let face = faces[lane] as u8;
                assert_eq!(expected, [(face, planes.each_ref().map(|plane| plane[lane]))]);
            }
        }
        assert!(inside_count > 10_000, "{inside_count}");
    }

    #[test]
    fn every_point_of_a_box_falls_into_its_rectangles() {
        let mut boxes = vec![
            (Vec3::new(1.0, -0.2, -0.3), Vec3::new(1.5, 0.4, 0.1)),
            (Vec3::new(0.8, 0.7, -0.3), Vec3::new(1.2, 1.3, 0.2)),
            (Vec3::new(-2.0, -1.1, -1.3), Vec3::new(2.0, -1.0, 1.9)),
            (Vec3::new(-1.1, -1.2, -1.3), Vec3::new(-0.9, -0.8, -0.7)),
            (Vec3::new(0.1, -5.0, -5.0), Vec3::new(0.2, 5.0, 5.0)),
        ];
        let mut seed = 7;
        for _ in 0..300 {
            let mut vector = || {
                let mut random = || crate::random(&mut seed);
                Vec3::new(random(), random(), random())
            };
            let low = vector();
            let high = low + vector().abs();
            if low.cmpgt(Vec3::ZERO).any() || high.cmplt(Vec3::ZERO).any() {
                boxes.push((low, high));
            }
        }
        let mut several = 0;
        for (low, high) in boxes {
            let rectangles = rectangles(low, high);
            several += usize::from(rectangles.len() > 1);
            for p in points(low, high) {
                let (face, u, v) = CubeFace::from_direction(p);
                let inside = rectangles.iter().any(|(on, [u0, u1, v0, v1])| {
                    let e = 1e-5;
                    *on == face.0
                        && (u0 - e..=u1 + e).contains(&u)
                        && (v0 - e..=v1 + e).contains(&v)
                });
                assert!(inside, "{low} {high}: {p}");
            }
        }
        assert!(several > 100, "{several}");
    }

    #[test]
    fn rectangles_reach_no_farther_than_their_box() {
        // Each end of a rectangle is that of a corner, or the face's border.
        let (low, high) = (Vec3::new(-0.5, -0.5, -2.0), Vec3::new(0.5, 0.5, -2.0));
        assert_eq!(rectangles(low, high), [(5, [-0.25, 0.25, -0.25, 0.25])]);
        let (low, high) = (Vec3::new(2.0, 1.0, -0.5), Vec3::new(4.0, 8.0, 0.5));
        let found = rectangles(low, high);
        assert_eq!(found, [(0, [0.25, 1.0, -0.25, 0.25]), (2, [-0.25, 0.25, 0.25, 1.0])]);
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
}
