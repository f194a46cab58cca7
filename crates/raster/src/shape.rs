//! What is drawn: pieces of planes, cut out by boxes, circles, rectangles or triangles, and which directions meet them.

use crate::lanes::Lanes;
use pbgi_math::{Aabb, CubeFace, Vec3};

/// A part of a plane that does not contain the receiver.
///
/// Along the direction `D` the plane is hit at the distance `|D| / w` with `w = inverse·D`, linear in `D`: on a
/// cube face, where `D = (1, u, v)`, inverse depth is linear in u and v.
pub trait Shape: Copy {
    /// The plane: its unit normal over its signed distance from the receiver.
    fn inverse(&self) -> Vec3;
    /// The same shape in the coordinates (depth, u, v) of a cube face.
    #[must_use]
    fn turned(&self, face: CubeFace) -> Self;
    /// Which of sixteen directions, with their `w`, meet the shape.
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> u16;
}

/// A vector in the coordinates (depth, u, v) of a face.
#[inline(always)]
pub(crate) fn turn(p: Vec3, face: CubeFace) -> Vec3 {
    // Read from a ring: which axis it is cannot be predicted, a branch would cost more.
    let ring = [p.x, p.y, p.z, p.x, p.y, 0.0];
    let axis = face.axis() & 3;
    Vec3::new(ring[axis] * face.sign(), ring[axis + 1], ring[axis + 2])
}

// Functions and not closures, which are not always inlined: code that is not is compiled without the instructions of the lanes.

/// Lanes of `d` from `low` to `high` times `w`.
#[inline(always)]
fn slab<L: Lanes>(d: L, w: L, low: f32, high: f32) -> L::Mask {
    L::and(w.mul(L::splat(low)).le(d), d.le(w.mul(L::splat(high))))
}

/// Products with a vector.
#[inline(always)]
fn along<L: Lanes>([x, y, z]: [L; 3], t: Vec3) -> L {
    x.mul(L::splat(t.x)).add(y.mul(L::splat(t.y))).add(z.mul(L::splat(t.z)))
}

/// Squared lengths.
#[inline(always)]
fn length2<L: Lanes>(x: L, y: L, z: L) -> L {
    x.mul(x).add(y.mul(y)).add(z.mul(z))
}

/// Whether the points `D/w` are so far away: `|D|² ≥ d² w²`.
#[inline(always)]
fn is_far<L: Lanes>([x, y, z]: [L; 3], w: L, distance_min: f32) -> L::Mask {
    w.mul(w).mul(L::splat(distance_min * distance_min)).le(length2(x, y, z))
}

/// The part of a plane inside a box, relative to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Section {
    /// See [`Shape::inverse`].
    pub inverse: Vec3,
    /// Smallest corner of the box.
    pub low: Vec3,
    /// Largest corner, larger along every axis.
    pub high: Vec3,
}

impl Shape for Section {
    #[inline(always)]
    fn inverse(&self) -> Vec3 {
        self.inverse
    }

    #[inline(always)]
    fn turned(&self, face: CubeFace) -> Self {
        let (a, b) = (turn(self.low, face), turn(self.high, face));
        Self { inverse: turn(self.inverse, face), low: a.min(b), high: a.max(b) }
    }

    /// The point `D/w` is inside where `low·w ≤ D ≤ high·w` along every axis. No negative `w` satisfies both.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> u16 {
        let [x, y, z] = direction;
        let (low, high) = (self.low, self.high);
        let xy = L::and(slab(x, w, low.x, high.x), slab(y, w, low.y, high.y));
        L::bits(L::and(xy, slab(z, w, low.z, high.z)))
    }
}

/// An oriented disk, relative to the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    /// See [`Shape::inverse`].
    pub inverse: Vec3,
    /// Center.
    pub center: Vec3,
    /// Radius.
    pub radius: f32,
    /// Points of it nearer than this are not there.
    pub distance_min: f32,
}

impl Shape for Disk {
    #[inline(always)]
    fn inverse(&self) -> Vec3 {
        self.inverse
    }

    #[inline(always)]
    fn turned(&self, face: CubeFace) -> Self {
        Self { inverse: turn(self.inverse, face), center: turn(self.center, face), ..*self }
    }

    /// The point `D/w` is on the disk where `|D − c w|² ≤ r² w²`, and far enough where `|D|² ≥ d² w²`.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> u16 {
        let [x, y, z] = direction;
        let cx = x.sub(w.mul(L::splat(self.center.x)));
        let cy = y.sub(w.mul(L::splat(self.center.y)));
        let cz = z.sub(w.mul(L::splat(self.center.z)));
        let w2 = w.mul(w);
        let on_disk = length2(cx, cy, cz).le(w2.mul(L::splat(self.radius * self.radius)));
        let in_front = L::splat(0.0).le(w);
        L::bits(L::and(L::and(on_disk, is_far(direction, w, self.distance_min)), in_front))
    }
}

/// A rectangle, relative to the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tile {
    /// See [`Shape::inverse`].
    pub inverse: Vec3,
    /// Center.
    pub center: Vec3,
    /// Unit vectors along its edges, perpendicular to each other and to the plane's normal.
    pub edges: [Vec3; 2],
    /// Half the lengths of its edges, above 0.
    pub half: [f32; 2],
    /// Points of it nearer than this are not there.
    pub distance_min: f32,
}

impl Tile {
    /// Its box.
    #[must_use]
    #[inline(always)]
    pub fn bounds(&self) -> Aabb {
        let reach = self.edges[0].abs() * self.half[0] + self.edges[1].abs() * self.half[1];
        Aabb { min: self.center - reach, max: self.center + reach }
    }
}

impl Shape for Tile {
    #[inline(always)]
    fn inverse(&self) -> Vec3 {
        self.inverse
    }

    #[inline(always)]
    fn turned(&self, face: CubeFace) -> Self {
        Self {
            inverse: turn(self.inverse, face),
            center: turn(self.center, face),
            edges: [turn(self.edges[0], face), turn(self.edges[1], face)],
            ..*self
        }
    }

    /// With `t` along an edge and `h` its half length, the point `D/w` is on the tile where
    /// `(t·c − h) w ≤ t·D ≤ (t·c + h) w` for both edges, which no negative `w` satisfies, and far enough where
    /// `|D|² ≥ d² w²`.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> u16 {
        let ([a, b], [half_a, half_b]) = (self.edges, self.half);
        let (at_a, at_b) = (a.dot(self.center), b.dot(self.center));
        let (along_a, along_b) = (along(direction, a), along(direction, b));
        let on_tile = L::and(
            slab(along_a, w, at_a - half_a, at_a + half_a),
            slab(along_b, w, at_b - half_b, at_b + half_b),
        );
        L::bits(L::and(on_tile, is_far(direction, w, self.distance_min)))
    }
}

/// A triangle, relative to the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// See [`Shape::inverse`].
    pub inverse: Vec3,
    /// Normals, toward its inside, of the planes through its edges and the receiver.
    pub sides: [Vec3; 3],
    /// Points of it nearer than this are not there.
    pub distance_min: f32,
}

impl Triangle {
    /// The triangle with these corners, in either order.
    #[must_use]
    #[inline(always)]
    pub fn new(inverse: Vec3, [a, b, c]: [Vec3; 3], distance_min: f32) -> Self {
        let sides = [a.cross(b), b.cross(c), c.cross(a)];
        let sign = 1f32.copysign(sides[0].dot(c));
        Self { inverse, sides: sides.map(|side| side * sign), distance_min }
    }
}

impl Shape for Triangle {
    #[inline(always)]
    fn inverse(&self) -> Vec3 {
        self.inverse
    }

    #[inline(always)]
    fn turned(&self, face: CubeFace) -> Self {
        let [a, b, c] = self.sides;
        Self {
            inverse: turn(self.inverse, face),
            sides: [turn(a, face), turn(b, face), turn(c, face)],
            ..*self
        }
    }

    /// The ray along `D` passes inside of all three planes, and where it is hit, it is far enough: `|D|² ≥ d² w²`.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> u16 {
        let zero = L::splat(0.0);
        let [a, b, c] = self.sides;
        let within = L::and(zero.le(along(direction, a)), zero.le(along(direction, b)));
        let in_front = L::and(zero.le(along(direction, c)), zero.le(w));
        L::bits(L::and(L::and(within, in_front), is_far(direction, w, self.distance_min)))
    }
}
