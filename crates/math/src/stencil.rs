//! Which cells of a rectangle something covers.

use crate::{Aabb, Vec3};

/// Cells along an edge of a [`Stencil`].
pub const STENCIL_EDGE: usize = 8;

/// Which of 8 × 8 cells are covered: bit 8 · row + column. Columns run along the axis after [`stencil_axis`] (x, y, z, x …), rows along the one after
/// that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stencil(pub u64);

impl Default for Stencil {
    fn default() -> Self {
        Self::FULL
    }
}

impl Stencil {
    /// Every cell.
    pub const FULL: Self = Self(u64::MAX);

    /// The same in 16 bits, one for each square of four cells, rows first as in the whole, if in each of them all cells are covered or none.
    #[must_use]
    #[inline]
    pub fn to_narrow(self) -> Option<u16> {
        let mut narrow = 0;
        for square in 0..16 {
            narrow |= u16::from(self.0 & Self::square(square) != 0) << square;
        }
        (Self::from_narrow(narrow) == self).then_some(narrow)
    }

    /// The stencil of which [`Self::to_narrow`] gives this.
    #[must_use]
    #[inline(always)]
    pub fn from_narrow(narrow: u16) -> Self {
        let mut cells = u64::from(narrow);
        // A byte for two rows, of four bits; each bit twice, and each row twice.
        cells = (cells | cells << 24) & 0x0000_00ff_0000_00ff;
        cells = (cells | cells << 12) & 0x000f_000f_000f_000f;
        cells = (cells | cells << 2) & 0x0033_0033_0033_0033;
        cells = (cells | cells << 1) & 0x0055_0055_0055_0055;
        cells |= cells << 1;
        Self(cells | cells << 8)
    }

    /// Narrow stencils of what is seen along each axis, in 16 bits each; the others are set.
    #[must_use]
    pub fn of_views(narrow: [u16; 3]) -> Self {
        let [x, y, z] = narrow.map(u64::from);
        Self(x | y << 16 | z << 32 | u64::from(u16::MAX) << 48)
    }

    /// Of [`Self::of_views`], the one along this axis.
    #[must_use]
    #[inline(always)]
    pub fn view(self, axis: usize) -> Self {
        Self::from_narrow((self.0 >> (16 * axis)) as u16)
    }

    #[inline]
    fn square(index: usize) -> u64 {
        0x0303 << (16 * (index / 4) + 2 * (index % 4))
    }

    /// Share of the cells that are covered.
    #[must_use]
    #[inline]
    pub fn share(self) -> f32 {
        self.0.count_ones() as f32 * (1.0 / 64.0)
    }
}

/// The axis along which a plane with this normal is looked at for its stencil: that of the largest component, the first of equal ones.
#[must_use]
#[inline(always)]
pub fn stencil_axis(normal: Vec3) -> usize {
    let a = normal.abs();
    if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    }
}

/// Where the cells of a box lie, seen along an axis.
#[derive(Clone, Copy, Debug)]
struct Cells {
    low: [f32; 2],
    /// Cells per length.
    scale: [f32; 2],
}

impl Cells {
    fn new(bounds: &Aabb, axis: usize) -> Self {
        let extent = bounds.extent();
        let least = (THICKNESS * extent.max_element()).max(f32::MIN_POSITIVE);
        let axes = [(axis + 1) % 3, (axis + 2) % 3];
        let edge = axes.map(|i| extent[i].max(least));
        let center = bounds.center();
        Self {
            low: [0, 1].map(|i| center[axes[i]] - 0.5 * edge[i]),
            scale: edge.map(|edge| STENCIL_EDGE as f32 / edge),
        }
    }

    /// Shares of the cells along an axis that an interval covers.
    fn shares(&self, axis: usize, low: f32, high: f32) -> [f32; STENCIL_EDGE] {
        let [low, high] = [low, high].map(|x| (x - self.low[axis]) * self.scale[axis]);
        std::array::from_fn(|i| (high.min(i as f32 + 1.0) - low.max(i as f32)).max(0.0))
    }
}

/// How much of each cell of a stencil is covered, while it is summed.
#[derive(Clone, Debug)]
pub struct StencilSum {
    axis: usize,
    cells: Cells,
    /// Covered share of each cell.
    covered: [[f32; STENCIL_EDGE]; STENCIL_EDGE],
    /// What is open of each cell if the things that were added lie in it at random.
    open: [[f32; STENCIL_EDGE]; STENCIL_EDGE],
}

/// Least extent of a stencil, as a share of its box's largest edge.
const THICKNESS: f32 = 2e-3;

impl StencilSum {
    /// An empty one of a box, seen along an axis.
    #[must_use]
    pub fn new(bounds: &Aabb, axis: usize) -> Self {
        let covered = [[0.0; STENCIL_EDGE]; STENCIL_EDGE];
        let open = [[1.0; STENCIL_EDGE]; STENCIL_EDGE];
        Self { axis, cells: Cells::new(bounds, axis), covered, open }
    }

    /// The axis along which it is seen.
    #[must_use]
    pub fn axis(&self) -> usize {
        self.axis
    }

    /// Adds something of this area, seen along the axis, that is spread evenly over a box.
    pub fn add(&mut self, bounds: &Aabb, area: f32) {
        let (a, b) = ((self.axis + 1) % 3, (self.axis + 2) % 3);
        let grow = |i: usize, axis: usize| {
            // A line is no less than a hundredth of a cell wide.
            let least = 0.01 / self.cells.scale[i];
            let (low, high) = (bounds.min[axis], bounds.max[axis]);
            let more = 0.5 * (least - (high - low)).max(0.0);
            (low - more, high + more)
        };
        let ((a0, a1), (b0, b1)) = (grow(0, a), grow(1, b));
        let (columns, rows) = (self.cells.shares(0, a0, a1), self.cells.shares(1, b0, b1));
        let [per_a, per_b] = self.cells.scale;
        let cells = (a1 - a0) * per_a * ((b1 - b0) * per_b);
        let share = area * per_a * per_b / cells;
        for ((row, covered), open) in rows.into_iter().zip(&mut self.covered).zip(&mut self.open) {
            if row > 0.0 {
                for ((covered, open), column) in covered.iter_mut().zip(open).zip(columns) {
                    let part = share * row * column;
                    *covered += part;
                    *open *= 1.0 - part.min(1.0);
                }
            }
        }
    }

    /// Adds what a stencil of another box holds, each covered cell to this share.
    pub fn add_stencil(&mut self, stencil: Stencil, axis: usize, bounds: &Aabb, share: f32) {
        if axis == self.axis {
            let source = Cells::new(bounds, axis);
            let edges = |i: usize, k: usize| source.low[i] + k as f32 / source.scale[i];
            let spread = |i: usize| -> [[f32; STENCIL_EDGE]; STENCIL_EDGE] {
                std::array::from_fn(|k| self.cells.shares(i, edges(i, k), edges(i, k + 1)))
            };
            let (columns, rows) = (spread(0), spread(1));
            let before = self.covered;
            for (row, weights) in rows.iter().enumerate() {
                let bits = stencil.0 >> (8 * row) & 0xff;
                if bits == 0 {
                    continue;
                }
                let mut line = [0.0; STENCIL_EDGE];
                for (column, parts) in columns.iter().enumerate() {
                    if bits >> column & 1 != 0 {
                        for (sum, part) in line.iter_mut().zip(parts) {
                            *sum += part;
                        }
                    }
                }
                for (covered, weight) in self.covered.iter_mut().zip(weights) {
                    if *weight > 0.0 {
                        for (covered, part) in covered.iter_mut().zip(line) {
                            *covered += share * weight * part;
                        }
                    }
                }
            }
            let (open, covered) = (self.open.iter_mut(), self.covered.iter());
            for ((open, covered), before) in
                open.flatten().zip(covered.flatten()).zip(before.iter().flatten())
            {
                *open *= 1.0 - (covered - before).min(1.0);
            }
            return;
        }
        // Seen along another axis, all that is known of a cell is where it lies in the box.
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let area = share * stencil.share() * bounds.extent()[a] * bounds.extent()[b];
        self.add(bounds, area);
    }

    /// Cells that are covered in sum if the things that were added lie at random in them.
    #[must_use]
    pub fn covered_at_random(&self) -> f32 {
        self.open.iter().flatten().map(|open| 1.0 - open).sum()
    }

    /// The same as [`Self::finish`] for squares of four cells, so that the stencil is narrow.
    #[must_use]
    pub fn finish_narrow(mut self, least: f32) -> (Stencil, f32) {
        for rows in self.covered.chunks_exact_mut(2) {
            for column in (0..STENCIL_EDGE).step_by(2) {
                let four =
                    [rows[0][column], rows[0][column + 1], rows[1][column], rows[1][column + 1]];
                let mean = 0.25 * four.map(|share| share.min(1.0)).iter().sum::<f32>();
                for row in rows.iter_mut() {
                    row[column..column + 2].fill(mean);
                }
            }
        }
        self.finish(least)
    }

    /// The cells that are covered to at least this share of what those that are covered at all are on the mean, Σ c²/Σ c; and the sum of all shares in
    /// cells.
    #[must_use]
    pub fn finish(&self, least: f32) -> (Stencil, f32) {
        let all = || self.covered.iter().flatten().copied();
        let (mut sum, mut squares) = (0.0, 0.0);
        for share in all() {
            let share = share.min(1.0);
            sum += share;
            squares += share * share;
        }
        if !(sum > 0.0) {
            return (Stencil::FULL, 0.0);
        }
        let least = least * squares / sum;
        let mut bits = 0;
        for (cell, share) in all().enumerate() {
            bits |= u64::from(share.min(1.0) >= least) << cell;
        }
        (Stencil(bits), sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: Aabb = Aabb { min: Vec3::ZERO, max: Vec3::ONE };

    #[test]
    fn narrow_stencils_come_back() {
        for narrow in 0..=u16::MAX {
            assert_eq!(Stencil::from_narrow(narrow).to_narrow(), Some(narrow));
        }
        assert_eq!(Stencil::from_narrow(u16::MAX), Stencil::FULL);
        assert_eq!(Stencil::from_narrow(0b10), Stencil(0x0c0c));
        assert_eq!(Stencil(0x0c04).to_narrow(), None);
    }

    #[test]
    fn views_come_back() {
        let narrow = [0x8421, 0, u16::MAX];
        let views = Stencil::of_views(narrow);
        for (axis, narrow) in narrow.into_iter().enumerate() {
            assert_eq!(views.view(axis), Stencil::from_narrow(narrow));
        }
        // What has none is seen whole along each.
        assert_eq!(Stencil::of_views([u16::MAX; 3]), Stencil::FULL);
        assert_eq!(Stencil::FULL.view(1), Stencil::FULL);
    }

    #[test]
    fn cells_are_where_things_lie() {
        let bounds = Aabb { min: Vec3::new(-3.0, 1.0, 5.0), max: Vec3::new(1.0, 2.0, 7.0) };
        for axis in 0..3 {
            let mut sum = StencilSum::new(&bounds, axis);
            // The low eighth along the columns, the upper half along the rows.
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let (mut thing, extent) = (bounds, bounds.extent());
            thing.max[a] = thing.min[a] + 0.125 * extent[a];
            thing.min[b] = thing.max[b] - 0.5 * extent[b];
            sum.add(&thing, 0.0625 * extent[a] * extent[b]);
            let (stencil, covered) = sum.finish(0.5);
            assert_eq!(stencil, Stencil(0x0101_0101_0000_0000), "{axis}");
            assert!((covered - 4.0).abs() < 1e-4, "{covered}");
            assert_eq!(sum.finish_narrow(0.5).0.to_narrow(), Some(0x1100));
        }
    }

    #[test]
    fn what_lies_at_random_multiplies_what_it_leaves_open() {
        let mut sum = StencilSum::new(&UNIT, 2);
        // A third of all cells, a half of the left ones again; and all cells of a half by a stencil, each to a quarter.
        sum.add(&UNIT, 1.0 / 3.0);
        let left = Aabb { min: Vec3::ZERO, max: Vec3::new(0.5, 1.0, 1.0) };
        sum.add(&left, 0.25);
        let expected = 32.0 * (1.0 - 2.0 / 3.0 * 0.5) + 32.0 / 3.0;
        assert!((sum.covered_at_random() - expected).abs() < 1e-3);
        sum.add_stencil(Stencil::FULL, 2, &left, 0.25);
        let expected = 32.0 * (1.0 - 2.0 / 3.0 * 0.5 * 0.75) + 32.0 / 3.0;
        assert!((sum.covered_at_random() - expected).abs() < 1e-3);
        assert!((sum.finish(0.5).1 - 32.0 * (1.0 + 1.0 / 3.0)).abs() < 1e-3);
    }

    #[test]
    fn stencils_of_parts_are_those_of_the_whole() {
        // A disk, and the disks' parts in each eighth of the box.
        let is_in = |p: Vec3| (p - Vec3::splat(0.5)).truncate().length() < 0.4;
        let cells = |low: Vec3, edge: f32| {
            let mut bits = 0;
            for cell in 0..64 {
                let at = Vec3::new(cell as f32 % 8.0 + 0.5, (cell / 8) as f32 + 0.5, 4.0);
                bits |= u64::from(is_in(low + at * (edge / 8.0))) << cell;
            }
            Stencil(bits)
        };
        let mut sum = StencilSum::new(&UNIT, 2);
        for octant in 0..4 {
            let low = Vec3::new((octant % 2) as f32, (octant / 2) as f32, 0.0) * 0.5;
            let part = Aabb { min: low, max: low + 0.5 };
            sum.add_stencil(cells(low, 0.5), 2, &part, 1.0);
        }
        let (stencil, covered) = sum.finish(0.5);
        let apart = (stencil.0 ^ cells(Vec3::ZERO, 1.0).0).count_ones();
        assert!(apart <= 4, "{:016x}", stencil.0);
        let disk = 0.16 * std::f32::consts::PI;
        assert!((covered / 64.0 - disk).abs() < 0.02, "{covered}");
        // Less than half a cell is none, so that areas stay; a lower bound adds the rim.
        assert!((stencil.share() - disk).abs() < 0.04, "{:016x}", stencil.0);
        assert!(sum.finish(0.05).0.share() > disk + 0.04);
    }
}
