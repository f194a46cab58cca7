//! What stands on the plane of a receiver around it.

use pbgi_math::{Frame, Vec3, larger};

/// Sectors of a plane.
const OCTANTS: usize = 8;

/// Inverse distances along a receiver's plane to the nearest of what stands on it, by eighths of the circle: 0 where the way is free.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Obstacles {
    octants: [f32; OCTANTS],
    largest: f32,
}

impl Obstacles {
    /// Slopes over the plane, from the receiver, of what stands in the way: what is lower may be the receiver's own surface, which need not be flat, and what
    /// is higher may hang over the way.
    pub const SLOPES: [f32; 2] = [0.1, 0.4];

    /// Adds what is in a cone of a `direction` and half-angle, whose tangent is given, at an inverse distance along the plane.
    #[inline(always)]
    pub(crate) fn add(&mut self, plane: &Frame, direction: Vec3, tangent: f32, inverse: f32) {
        let aside = plane.normal.cross(direction) * tangent;
        for side in [direction - aside, direction + aside] {
            let nearest = &mut self.octants[octant(plane, side)];
            *nearest = larger(*nearest, inverse);
        }
        self.largest = larger(self.largest, inverse);
    }

    /// Whether a way along the plane with this normal leads beyond a share of the distance to what stands in its octant.
    #[must_use]
    #[inline]
    pub fn are_reached(&self, plane: Vec3, way: Vec3, share: f32) -> bool {
        let length = way.length();
        // Most are nowhere near.
        length * self.largest > share
            && length * self.octants[octant(&Frame::from_normal(plane), way)] > share
    }
}

/// In which eighth of a plane a direction lies.
#[inline(always)]
fn octant(plane: &Frame, direction: Vec3) -> usize {
    let (x, y) = (direction.dot(plane.tangent), direction.dot(plane.bitangent));
    usize::from(x < 0.0) | usize::from(y < 0.0) << 1 | usize::from(x.abs() < y.abs()) << 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_end_at_what_stands_in_their_octant() {
        let plane = Frame::from_normal(Vec3::Z);
        let mut obstacles = Obstacles::default();
        obstacles.add(&plane, Vec3::new(1.0, 0.2, 0.1), 0.01, 0.5);
        let are_reached =
            |x: f32, y: f32| obstacles.are_reached(Vec3::Z, Vec3::new(x, y, 0.0), 0.8);
        assert!(!are_reached(1.5, 0.3) && are_reached(1.7, 0.3));
        // Beside it and behind it the way is free.
        assert!(!are_reached(1.0, 3.0) && !are_reached(-4.0, 0.3) && !are_reached(3.0, -1.0));
        // What lies across the border of two octants is in both.
        obstacles.add(&plane, Vec3::new(-1.0, -1.0, 0.3), 0.1, 1.0);
        for (x, y) in [(-1.0, -0.5), (-0.5, -1.0)] {
            let way = Vec3::new(x, y, 0.0);
            assert!(obstacles.are_reached(Vec3::Z, way, 0.8), "{way}");
        }
    }
}
