//! What is drawn: pieces of planes, cut out by boxes, circles, rectangles or triangles, and which directions meet them.

use crate::footprint::turn;
use crate::lanes::Lanes;
use pbgi_math::{CubeFace, STENCIL_EDGE, Stencil, Vec3, larger, smaller};

/// A part of a plane that does not contain the receiver.
///
/// Along the direction `D` the plane is hit at the distance `|D| / w` with `w = inverse·D`, linear in `D`: on a
/// cube face, where `D = (1, u, v)`, inverse depth is linear in u and v.
pub trait Shape: Copy {
    /// The plane: its unit normal over its signed distance from the receiver.
    fn inverse(&self) -> Vec3;
    /// Which of its sides it turns to the receiver: 0 for its front, 1 for its back; either without a rim.
    fn side(&self) -> usize {
        0
    }
    /// Where it is, to tell it from its neighbors and these from what is not on its surface.
    fn place(&self) -> Place {
        Place::ANY
    }
    /// The same shape in the coordinates (depth, u, v) of a cube face.
    #[must_use]
    fn turned(&self, face: CubeFace) -> Self;
    /// Which of sixteen directions, with their `w`, meet the shape.
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> Met;
}

/// Where a shape is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Tells places apart; those of shapes that are alone where they are need not be told apart, and have 0.
    pub number: u32,
    /// From the receiver.
    pub distance: f32,
    /// How much nearer or farther its neighbors may be.
    pub apart: f32,
}

impl Place {
    /// That of what is alone where it is, and whose rim is too narrow for others than its neighbors to be in.
    pub const ANY: Self = Self { number: 0, distance: 0.0, apart: f32::INFINITY };
}

impl Default for Place {
    fn default() -> Self {
        Self::ANY
    }
}

/// Which of sixteen directions meet a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Met {
    /// Those inside of its outline.
    pub inside: u16,
    /// Those that pass its outline no farther than its rim, in which neighbors lie whose outlines are rounded.
    pub rim: u16,
}

/// Directions in the rims of what was drawn so far on one side, front or back.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SideRims {
    /// Those of all but the last place at which something was drawn.
    others: u16,
    /// Those of what was drawn at the last place.
    last: u16,
    /// See [`Place`]: of the last one.
    number: u32,
    distance: f32,
}

/// The same by the side that shapes turn to the receiver: front and back.
pub(crate) type Rims = [SideRims; 2];

impl Met {
    /// Without a rim.
    #[inline(always)]
    fn inside(inside: u16) -> Self {
        Self { inside, rim: 0 }
    }

    /// With all that is within its rim, of the directions whose `w` are given. What of the rim lies on the ground is inside.
    #[inline(always)]
    fn within<L: Lanes>([inside, within]: [u16; 2], direction: [L; 3], w: L, ground: Vec3) -> Self {
        let rim = within & !inside;
        if rim == 0 {
            return Self { inside, rim };
        }
        let grounded = rim & L::bits(along(direction, ground).le(w));
        Self { inside: inside | grounded, rim: rim & !grounded }
    }

    /// What the shape covers: the inside of its outline, and of its rim what another's rim has, too. Between neighbors on a surface there is no gap,
    /// and over the end of a surface, where no neighbor is, nothing reaches. The faces of a solid at its outline, of which one is seen from
    /// behind, are no neighbors; nor is what lies at the shape's own place.
    #[inline(always)]
    pub(crate) fn close<S: Shape>(self, shape: &S, rims: &mut Rims) -> u16 {
        if self.rim == 0 {
            return self.inside;
        }
        let (rims, place) = (&mut rims[shape.side()], shape.place());
        if (place.distance - rims.distance).abs() > place.apart {
            // Another surface, before it or behind.
            (rims.others, rims.last) = (0, 0);
        } else if place.number == Place::ANY.number || place.number != rims.number {
            rims.others |= rims.last;
            rims.last = 0;
        }
        (rims.number, rims.distance) = (place.number, place.distance);
        rims.last |= self.rim;
        self.inside | (self.rim & rims.others)
    }
}

// Functions and not closures, which are not always inlined: code that is not is compiled without the instructions of the lanes.

/// Lanes of `d` from `low` to `high` times `w`.
#[inline(always)]
fn slab<L: Lanes>(d: L, w: L, low: f32, high: f32) -> L::Mask {
    L::and(w.mul(L::splat(low)).le(d), d.le(w.mul(L::splat(high))))
}

/// Lanes of `a` and `b` up to these lengths times `w`.
#[inline(always)]
fn nearer<L: Lanes>([a, b]: [L; 2], w: L, [half_a, half_b]: [f32; 2]) -> u16 {
    L::bits(L::and(a.le(w.mul(L::splat(half_a))), b.le(w.mul(L::splat(half_b)))))
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

/// The part of a plane inside a box, relative to the receiver, or of that what lies in the cells of a stencil.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Section {
    inverse: Vec3,
    /// Corners of the box; with a stencil, what times a direction is `w` times the column of its cell, and the same of its row.
    bounds: [Vec3; 2],
    stencil: Stencil,
}

impl Section {
    /// The part of the plane of [`Shape::inverse`] in a box, of which the corner `high` is larger along every axis.
    #[must_use]
    #[inline(always)]
    pub fn new(inverse: Vec3, low: Vec3, high: Vec3) -> Self {
        Self { inverse, bounds: [low, high], stencil: Stencil::FULL }
    }

    /// What of the plane lies in the cells of a stencil of the box, seen along `axis`; all of the section where the stencil is full.
    #[must_use]
    #[inline(always)]
    pub fn stenciled(
        inverse: Vec3,
        [low, high]: [Vec3; 2],
        (stencil, axis): (Stencil, usize),
    ) -> Self {
        if stencil == Stencil::FULL {
            return Self::new(inverse, low, high);
        }
        let (lows, scales) = (low.to_array(), (STENCIL_EDGE as f32 / (high - low)).to_array());
        let cell = |across: usize| (Vec3::AXES[across] - inverse * lows[across]) * scales[across];
        Self { inverse, bounds: [cell((axis + 1) % 3), cell((axis + 2) % 3)], stencil }
    }
}

impl Shape for Section {
    #[inline(always)]
    fn inverse(&self) -> Vec3 {
        self.inverse
    }

    #[inline(always)]
    fn turned(&self, face: CubeFace) -> Self {
        let [mut low, mut high] = self.bounds.map(|corner| turn(corner, face));
        if self.stencil == Stencil::FULL {
            // Along the face's axis the low corner may be the larger one now.
            (low.x, high.x) = (smaller(low.x, high.x), larger(low.x, high.x));
        }
        Self { inverse: turn(self.inverse, face), bounds: [low, high], stencil: self.stencil }
    }

    /// The point `D/w` is inside where `low·w ≤ D ≤ high·w` along every axis. No negative `w` satisfies both.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> Met {
        let [low, high] = self.bounds;
        if self.stencil != Stencil::FULL {
            let far = L::splat(1.0).div(w);
            let (column, row) = (along(direction, low).mul(far), along(direction, high).mul(far));
            return Met::inside(column.in_cells(row, far, self.stencil.0));
        }
        let [x, y, z] = direction;
        let xy = L::and(slab(x, w, low.x, high.x), slab(y, w, low.y, high.y));
        Met::inside(L::bits(L::and(xy, slab(z, w, low.z, high.z))))
    }
}

/// An oriented disk, relative to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Disk {
    /// See [`Shape::inverse`].
    pub inverse: Vec3,
    /// Center.
    pub center: Vec3,
    /// Radius.
    pub radius: f32,
    /// The same of its rim.
    pub reach: f32,
    /// Points of it nearer than this are not there.
    pub distance_min: f32,
    /// See [`Tile::ground`].
    pub ground: Vec3,
    /// See [`Shape::side`].
    pub side: u8,
    /// See [`Shape::place`].
    pub place: Place,
}

impl Shape for Disk {
    #[inline(always)]
    fn inverse(&self) -> Vec3 {
        self.inverse
    }

    #[inline(always)]
    fn turned(&self, face: CubeFace) -> Self {
        Self {
            inverse: turn(self.inverse, face),
            center: turn(self.center, face),
            ground: turn(self.ground, face),
            ..*self
        }
    }

    #[inline(always)]
    fn side(&self) -> usize {
        usize::from(self.side)
    }

    #[inline(always)]
    fn place(&self) -> Place {
        self.place
    }

    /// The point `D/w` is on the disk where `|D − c w|² ≤ r² w²`, and far enough where `|D|² ≥ d² w²`.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> Met {
        let [x, y, z] = direction;
        let cx = x.sub(w.mul(L::splat(self.center.x)));
        let cy = y.sub(w.mul(L::splat(self.center.y)));
        let cz = z.sub(w.mul(L::splat(self.center.z)));
        let (off2, w2) = (length2(cx, cy, cz), w.mul(w));
        let on_disk = L::bits(off2.le(w2.mul(L::splat(self.radius * self.radius))));
        let in_reach = L::bits(off2.le(w2.mul(L::splat(self.reach * self.reach))));
        let in_front = L::splat(0.0).le(w);
        let is_there = L::bits(L::and(is_far(direction, w, self.distance_min), in_front));
        Met::within([on_disk & is_there, in_reach & is_there], direction, w, self.ground)
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
    /// The same of its rim.
    pub reach: [f32; 2],
    /// Normal of the receiver's own surface, the ground, which is not drawn, over the height up to which a rim over it lies on it: the ground is the
    /// neighbor of what stands on it.
    pub ground: Vec3,
    /// See [`Shape::side`].
    pub side: u8,
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
            ground: turn(self.ground, face),
            ..*self
        }
    }

    #[inline(always)]
    fn side(&self) -> usize {
        usize::from(self.side)
    }

    /// With `t` along an edge and `h` its half length, the point `D/w` is on the tile where `|t·D − t·c w| ≤ h w` for both edges, which no
    /// negative `w` satisfies.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> Met {
        let ([a, b], center) = (self.edges, self.center);
        let off_a = along(direction, a).sub(w.mul(L::splat(a.dot(center)))).abs();
        let off_b = along(direction, b).sub(w.mul(L::splat(b.dot(center)))).abs();
        let inside = nearer([off_a, off_b], w, self.half);
        let within = nearer([off_a, off_b], w, self.reach);
        Met::within([inside, within], direction, w, self.ground)
    }
}

/// A triangle, relative to the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// See [`Shape::inverse`].
    pub inverse: Vec3,
    /// Normals, toward its inside, of the planes through its edges and the receiver.
    pub sides: [Vec3; 3],
    /// How far its rim lies outside of each of them: by so much times `w`, as a product with the side.
    pub reach: f32,
    /// See [`Tile::ground`].
    pub ground: Vec3,
    /// See [`Shape::side`].
    pub side: u8,
}

impl Triangle {
    /// The triangle with these corners, in either order, and a rim that is larger by the share `rim`.
    #[must_use]
    #[inline(always)]
    pub fn new(inverse: Vec3, [a, b, c]: [Vec3; 3], rim: f32, ground: Vec3, side: u8) -> Self {
        let sides = [a.cross(b), b.cross(c), c.cross(a)];
        // Three times the product of each side with the middle.
        let volume = sides[0].dot(c);
        let reach = volume.abs() * (rim * (1.0 / 3.0));
        let sign = 1f32.copysign(volume);
        Self { inverse, sides: sides.map(|side| side * sign), reach, ground, side }
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
            ground: turn(self.ground, face),
            ..*self
        }
    }

    #[inline(always)]
    fn side(&self) -> usize {
        usize::from(self.side)
    }

    /// The ray along `D` passes inside of all three planes, before the receiver.
    #[inline(always)]
    fn meets<L: Lanes>(&self, direction: [L; 3], w: L) -> Met {
        let zero = L::splat(0.0);
        let [a, b, c] = self.sides;
        let (a, b, c) = (along(direction, a), along(direction, b), along(direction, c));
        let inside = L::and(L::and(zero.le(a), zero.le(b)), L::and(zero.le(c), zero.le(w)));
        let beyond = w.mul(L::splat(-self.reach));
        let within = L::and(L::and(beyond.le(a), beyond.le(b)), L::and(beyond.le(c), zero.le(w)));
        Met::within([L::bits(inside), L::bits(within)], direction, w, self.ground)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Plain, SAMPLES};
    use crate::random;
    use crate::{SimdLevel, WideKernel, run_wide};

    /// Which of sixteen directions meet a section.
    struct Meets {
        section: Section,
        directions: [Vec3; SAMPLES],
    }

    impl WideKernel for Meets {
        type Output = u16;

        #[inline(always)]
        fn run<L: Lanes>(self) -> u16 {
            let lane = |axis: usize| {
                let along: [f32; SAMPLES] = std::array::from_fn(|i| self.directions[i][axis]);
                L::load(&along)
            };
            let direction = [lane(0), lane(1), lane(2)];
            self.section.meets(direction, along(direction, self.section.inverse)).inside
        }
    }

    #[test]
    fn stencils_are_met_in_their_covered_cells_at_every_level() {
        let mut seed = 3;
        let mut met_count = 0;
        for round in 0..2000 {
            let mut vector = || Vec3::new(random(&mut seed), random(&mut seed), random(&mut seed));
            let normal = vector().normalize();
            let (center, half) = (vector() * 2.0, vector().abs() + 0.05);
            let axis = pbgi_math::stencil_axis(normal);
            let bits = u64::from(vector().x.to_bits()) << 32 | u64::from(vector().y.to_bits());
            let (low, stencil) = (center - half, Stencil(bits));
            let inverse = normal / normal.dot(center);
            let section = Section::stenciled(inverse, [low, center + half], (stencil, axis));
            let directions = std::array::from_fn(|_| center + vector() * 1.2);
            let mut expected = 0u16;
            for (lane, d) in directions.iter().enumerate() {
                let w = section.inverse.dot(*d);
                let cell = (*d / w - low) / (2.0 * half) * STENCIL_EDGE as f32;
                let [a, b] = [cell[(axis + 1) % 3], cell[(axis + 2) % 3]];
                let inside = w > 0.0 && (0.0..8.0).contains(&a) && (0.0..8.0).contains(&b);
                let is_met = inside && bits >> (8 * b as u32 + a as u32) & 1 != 0;
                expected |= u16::from(is_met) << lane;
            }
            met_count += expected.count_ones();
            for level in SimdLevel::available() {
                let met = run_wide(level, Meets { section, directions });
                // Rounding may move a direction over the border of a cell.
                assert!((met ^ expected).count_ones() <= 1, "{round} {level:?}: {section:?}");
                let same = Meets { section, directions }.run::<Plain>();
                assert_eq!(met, same, "{round} {level:?}");
            }
            // In the coordinates of a face it is the same section.
            for face in CubeFace::ALL {
                let turned = directions.map(|d| turn(d, face));
                let meets = Meets { section: section.turned(face), directions: turned };
                let met = run_wide(SimdLevel::Baseline, meets);
                assert!((met ^ expected).count_ones() <= 1, "{round} {face:?}");
            }
        }
        assert!(met_count > 2000, "{met_count}");
    }
}
