//! Morton codes: the order of surfels on disk and of receivers in a frame.

use crate::Aabb;
use glam::Vec3;

/// Bits per axis of a [`MortonCode`]; also the deepest level of the octree.
pub const MORTON_AXIS_BITS: u32 = 21;

/// Interleaved cell coordinates in a [`RootCube`], 21 bits per axis, x in the lowest bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MortonCode(pub u64);

impl MortonCode {
    /// Code of integer cell coordinates below 2²¹.
    #[must_use]
    #[inline]
    pub fn from_cell(x: u32, y: u32, z: u32) -> Self {
        Self(spread_bits(x) | (spread_bits(y) << 1) | (spread_bits(z) << 2))
    }

    /// Integer cell coordinates, the inverse of [`MortonCode::from_cell`].
    #[must_use]
    pub fn to_cell(self) -> [u32; 3] {
        [gather_bits(self.0), gather_bits(self.0 >> 1), gather_bits(self.0 >> 2)]
    }

    /// Octant (0..8, bit 0 = upper half in x) this code falls into among the children of its cell
    /// at `level`; the root cell is level 0.
    #[must_use]
    #[inline]
    pub fn octant(self, level: u32) -> u32 {
        debug_assert!(level < MORTON_AXIS_BITS);
        ((self.0 >> (3 * (MORTON_AXIS_BITS - 1 - level))) & 7) as u32
    }

    /// The code's leading `level` octants: the identity of its cell at `level`.
    #[must_use]
    #[inline]
    pub fn cell_at(self, level: u32) -> u64 {
        if level == 0 { 0 } else { self.0 >> (3 * (MORTON_AXIS_BITS - level)) }
    }

    /// Deepest level at which both codes lie in one cell.
    #[must_use]
    #[inline]
    pub fn common_level(self, other: Self) -> u32 {
        match self.0 ^ other.0 {
            0 => MORTON_AXIS_BITS,
            difference => MORTON_AXIS_BITS - 1 - difference.ilog2() / 3,
        }
    }
}

/// Puts two zero bits before each of the low 21 bits.
#[inline]
fn spread_bits(value: u32) -> u64 {
    let mut v = u64::from(value) & 0x1f_ffff;
    v = (v | (v << 32)) & 0x001f_0000_0000_ffff;
    v = (v | (v << 16)) & 0x001f_0000_ff00_00ff;
    v = (v | (v << 8)) & 0x100f_00f0_0f00_f00f;
    v = (v | (v << 4)) & 0x10c3_0c30_c30c_30c3;
    (v | (v << 2)) & 0x1249_2492_4924_9249
}

/// Inverse of [`spread_bits`].
fn gather_bits(value: u64) -> u32 {
    let mut v = value & 0x1249_2492_4924_9249;
    v = (v | (v >> 2)) & 0x10c3_0c30_c30c_30c3;
    v = (v | (v >> 4)) & 0x100f_00f0_0f00_f00f;
    v = (v | (v >> 8)) & 0x001f_0000_ff00_00ff;
    v = (v | (v >> 16)) & 0x001f_0000_0000_ffff;
    ((v | (v >> 32)) & 0x1f_ffff) as u32
}

/// The cube whose dyadic cells are the octree's cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootCube {
    /// Smallest corner.
    pub min: Vec3,
    /// Edge length, above 0.
    pub edge: f32,
}

impl RootCube {
    /// Smallest cube around `bounds` of positions, grown by one part in 2²⁰ so that the largest
    /// position still falls inside. A single point gets a cube of edge 1.
    #[must_use]
    pub fn from_bounds(bounds: &Aabb) -> Self {
        let extent = bounds.extent().max_element();
        let scale = bounds.min.abs().max(bounds.max.abs()).max_element();
        // A cube thinner than the spacing of floats at its place could not be divided.
        let edge = (extent * (1.0 + 1.0 / 1_048_576.0)).max(scale * f32::EPSILON * 4.0);
        let edge = if edge > 0.0 && edge.is_finite() { edge } else { 1.0 };
        Self { min: bounds.min, edge }
    }

    /// Morton code of a position; positions outside the cube go to its nearest cell.
    #[must_use]
    #[inline]
    pub fn code(&self, position: Vec3) -> MortonCode {
        // In f64, so that 21 bits are exact for every f32 position.
        let cells = f64::from(1u32 << MORTON_AXIS_BITS) / f64::from(self.edge);
        let last = (1u32 << MORTON_AXIS_BITS) - 1;
        let cell = |p: f32, min: f32| (((f64::from(p) - f64::from(min)) * cells) as u32).min(last);
        MortonCode::from_cell(
            cell(position.x, self.min.x),
            cell(position.y, self.min.y),
            cell(position.z, self.min.z),
        )
    }

    /// Box of the cell with the leading octants `cell` (see [`MortonCode::cell_at`]) at `level`.
    #[must_use]
    pub fn cell_box(&self, cell: u64, level: u32) -> Aabb {
        let edge = f64::from(self.edge) / f64::from(1u32 << level);
        let [x, y, z] = MortonCode(cell).to_cell().map(f64::from);
        let corner = |i: f64, min: f32| (f64::from(min) + i * edge) as f32;
        Aabb {
            min: Vec3::new(corner(x, self.min.x), corner(y, self.min.y), corner(z, self.min.z)),
            max: Vec3::new(
                corner(x + 1.0, self.min.x),
                corner(y + 1.0, self.min.y),
                corner(z + 1.0, self.min.z),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_levels_are_those_of_cells() {
        for a in [MortonCode(0x1234_5678_9abc_def0), MortonCode(0o123_456_701_234_567_012_345)] {
            for level in 0..MORTON_AXIS_BITS {
                // Another octant at `level`, the same above.
                let b = MortonCode(a.0 ^ (1 << (3 * (MORTON_AXIS_BITS - 1 - level))));
                assert_eq!(a.common_level(b), level);
                assert_eq!(a.cell_at(level), b.cell_at(level));
                assert_ne!(a.cell_at(level + 1), b.cell_at(level + 1));
            }
            assert_eq!(a.common_level(a), MORTON_AXIS_BITS);
        }
    }

    #[test]
    fn codes_round_trip() {
        for cell in
            [[0, 0, 0], [1, 2, 3], [0x1f_ffff, 0, 0x10_0001], [0x1f_ffff; 3], [12345, 999_999, 77]]
        {
            assert_eq!(MortonCode::from_cell(cell[0], cell[1], cell[2]).to_cell(), cell);
        }
        assert_eq!(MortonCode::from_cell(1, 0, 0).0, 1);
        assert_eq!(MortonCode::from_cell(0, 1, 0).0, 2);
        assert_eq!(MortonCode::from_cell(0, 0, 1).0, 4);
    }

    #[test]
    fn octants_are_the_digits_of_the_cell() {
        let code = MortonCode::from_cell(0x15_5555, 0x0f_0f0f, 0x12_3456);
        let mut cell = 0;
        for level in 0..MORTON_AXIS_BITS {
            assert_eq!(code.cell_at(level), cell);
            cell = cell * 8 + u64::from(code.octant(level));
        }
        assert_eq!(cell, code.0);
    }

    #[test]
    fn positions_lie_in_their_cells() {
        let cube = RootCube { min: Vec3::new(-3.0, 2.0, 10.0), edge: 7.0 };
        for i in 0..500 {
            let f = i as f32 / 500.0;
            let p = cube.min + Vec3::new(f, (f * 17.0).fract(), (f * 91.0).fract()) * 7.0;
            for level in [0, 1, 5, 12] {
                let cell = cube.code(p).cell_at(level);
                assert!(cube.cell_box(cell, level).inflated(1e-5).contains(p));
            }
        }
    }

    #[test]
    fn degenerate_bounds_give_a_cube() {
        for p in [Vec3::ZERO, Vec3::splat(1e6)] {
            let cube = RootCube::from_bounds(&Aabb { min: p, max: p });
            assert!(cube.edge > 0.0);
            assert_eq!(cube.code(p), MortonCode(0));
        }
    }
}
