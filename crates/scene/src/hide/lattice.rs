//! Which micropolygon of a triangle a sample falls into.

use super::project::Projector;
use pbgi_math::DVec3;

/// How many levels an axis may be coarsened where both axes fall together on the screen: cells get
/// up to 4 times as long as the shading rate asks for.
const STRETCH_LEVELS_MAX: i32 = 2;

/// Finest level: cells are 2⁻³⁰ of the triangle.
const LEVEL_MAX: i32 = 30;

/// A cell of the lattice a triangle is divided into: along each of its two axes
/// `2^level` steps, chosen per sample so that the cell covers about one shading rate on the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Cell {
    pub level: [u8; 2],
    pub index: [u32; 2],
}

impl Cell {
    /// All of it in 76 bits.
    pub fn code(&self) -> u128 {
        let [i, j] = self.index.map(u128::from);
        (u128::from(self.level[0]) << 71) | (u128::from(self.level[1]) << 66) | (i << 33) | j
    }
}

/// The axes of a triangle's lattice in camera space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    /// Vertex at the origin: the one whose angle is nearest to 90°.
    pub corner: usize,
    axes: [DVec3; 2],
    /// See [`Projector::pixels_per_unit`].
    pixels_per_unit: [f64; 2],
}

impl Lattice {
    /// Lattice of a triangle with the given camera-space vertices.
    pub fn new(projector: &Projector, vertices: &[DVec3; 3]) -> Self {
        let cosine = |corner: usize| {
            let a = vertices[(corner + 1) % 3] - vertices[corner];
            let b = vertices[(corner + 2) % 3] - vertices[corner];
            a.dot(b).abs() / (a.length() * b.length()).max(f64::MIN_POSITIVE)
        };
        let cosines = [cosine(0), cosine(1), cosine(2)];
        let corner = (0..3).fold(0, |best, i| if cosines[i] < cosines[best] { i } else { best });
        let axis = |step: usize| vertices[(corner + step) % 3] - vertices[corner];
        Self { corner, axes: [axis(1), axis(2)], pixels_per_unit: projector.pixels_per_unit() }
    }

    /// Cell of the point with lattice coordinates `at`, seen along `direction` (of depth 1) at
    /// `inverse_depth`; `cell_pixels` is the wanted edge in pixels.
    pub fn cell(
        &self,
        at: [f64; 2],
        direction: DVec3,
        inverse_depth: f64,
        cell_pixels: f64,
    ) -> Cell {
        // Screen velocity of each lattice coordinate, in pixels.
        let [fx, fy] = self.pixels_per_unit;
        let velocity = self.axes.map(|axis| {
            [
                (axis.x - direction.x * axis.z) * inverse_depth * fx,
                (axis.y - direction.y * axis.z) * inverse_depth * fy,
            ]
        });
        let mut level =
            velocity.map(|[x, y]| nearest_exponent((x * x + y * y).sqrt() / cell_pixels));
        // Axes that fall almost together on the screen make slivers: lengthen them.
        let area = (velocity[0][0] * velocity[1][1] - velocity[0][1] * velocity[1][0]).abs();
        let wanted = nearest_exponent(area / (cell_pixels * cell_pixels));
        let excess = (level[0] + level[1] - wanted).clamp(0, 2 * STRETCH_LEVELS_MAX);
        level[0] -= (excess + 1) / 2;
        level[1] -= excess / 2;
        let mut cell = Cell { level: [0; 2], index: [0; 2] };
        for axis in 0..2 {
            let level = level[axis].clamp(0, LEVEL_MAX) as u32;
            cell.level[axis] = level as u8;
            let steps = 1u32 << level;
            cell.index[axis] = ((at[axis] * f64::from(steps)).max(0.0) as u32).min(steps - 1);
        }
        cell
    }
}

/// The integer nearest to log₂ of a non-negative number; very low for 0.
fn nearest_exponent(x: f64) -> i32 {
    let bits = (x * std::f64::consts::SQRT_2).to_bits();
    ((bits >> 52) & 0x7ff) as i32 - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_round_to_nearest() {
        for (x, expected) in [(1.0, 0), (1.41, 0), (1.42, 1), (0.70, -1), (0.71, 0), (1024.0, 10)] {
            assert_eq!(nearest_exponent(x), expected, "{x}");
        }
        assert!(nearest_exponent(0.0) < -1000);
    }

    #[test]
    fn cell_codes_are_unique() {
        let mut codes = std::collections::HashSet::new();
        for level in [[0u8, 30], [30, 0], [30, 30], [3, 4]] {
            for index in [[0u32, 0], [1, 0], [0, 1], [(1 << 30) - 1, (1 << 30) - 1]] {
                assert!(codes.insert(Cell { level, index }.code()));
            }
        }
    }
}
