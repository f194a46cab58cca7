//! Nearest neighbors among surfels in Morton order.

use pbgi_cloud::Surfel;
use pbgi_math::{MORTON_AXIS_BITS, MortonCode, RootCube};
use std::ops::Range;

/// Neighbors looked for.
pub(crate) const NEIGHBORS: usize = 12;
/// The cell searched around holds at least this many surfels.
const CELL_SURFELS: usize = 6;
/// Surfels looked at in one cell; of fuller ones, evenly spread.
const CELL_SURFELS_MAX: usize = 128;
/// Times the search is repeated in cells twice as large.
const RETRIES: u32 = 4;

/// The nearest neighbors of a surfel, by distance, then by rank.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nearest {
    len: usize,
    entries: [(f32, u32); NEIGHBORS],
    is_sampled: bool,
}

impl Nearest {
    const NONE: Self =
        Self { len: 0, entries: [(f32::INFINITY, u32::MAX); NEIGHBORS], is_sampled: false };

    /// Neighbors found, at most [`NEIGHBORS`].
    pub fn len(&self) -> usize {
        self.len
    }

    /// Indices in the window.
    pub fn indices(&self) -> impl Iterator<Item = usize> + '_ {
        self.entries[..self.len].iter().map(|e| e.1 as usize)
    }

    /// Distance to the farthest one found; 0 if there is none.
    pub fn reach(&self) -> f32 {
        self.reach_of(NEIGHBORS)
    }

    /// Distance to the `count`-th nearest one found, or to the farthest if there are fewer.
    pub fn reach_of(&self, count: usize) -> f32 {
        self.entries[..self.len.min(count)].last().map_or(0.0, |e| e.0.sqrt())
    }

    /// Whether not all surfels around were looked at, because they are many: a sign of a surfel far from a dense clump.
    pub fn is_sampled(&self) -> bool {
        self.is_sampled
    }

    #[inline]
    fn insert(&mut self, distance2: f32, index: u32) {
        let entry = (distance2, index);
        if self.len == NEIGHBORS && entry >= self.entries[NEIGHBORS - 1] {
            return;
        }
        let mut at = self.len.min(NEIGHBORS - 1);
        while at > 0 && self.entries[at - 1] > entry {
            self.entries[at] = self.entries[at - 1];
            at -= 1;
        }
        self.entries[at] = entry;
        self.len = (self.len + 1).min(NEIGHBORS);
    }
}

/// Finds neighbors in a window of the sorted stream.
///
/// Around the cell of a surfel, at the deepest level where it holds [`CELL_SURFELS`], lie 26 cells
/// of its size; in Morton order each is one range of the window, found by bisection. If the twelve
/// nearest reach beyond the cells next door, larger cells are searched.
pub(crate) struct NeighborSearch<'a> {
    root: RootCube,
    codes: &'a [u64],
    surfels: &'a [Surfel],
    /// Ranges around the cell searched last: its neighbors in the stream are often in it too.
    cell: Option<(u64, u32)>,
    ranges: Vec<Range<usize>>,
}

impl<'a> NeighborSearch<'a> {
    /// A search among `surfels`, which have the ascending `codes`.
    pub fn new(root: RootCube, codes: &'a [u64], surfels: &'a [Surfel]) -> Self {
        Self { root, codes, surfels, cell: None, ranges: Vec::new() }
    }

    /// The nearest neighbors of the surfel at `index`, itself left out.
    pub fn nearest(&mut self, index: usize) -> Nearest {
        let code = MortonCode(self.codes[index]);
        let mut level = self.level_at(index);
        let mut retries = 0;
        loop {
            self.find_ranges(code.cell_at(level), level);
            let nearest = self.nearest_in_ranges(index);
            let cell_edge = f64::from(self.root.edge) / f64::from(1u32 << level);
            let enough = nearest.len == NEIGHBORS && f64::from(nearest.reach()) <= cell_edge;
            if enough || level == 0 || retries == RETRIES {
                return nearest;
            }
            level -= 1;
            retries += 1;
        }
    }

    /// Deepest level where the cell of surfel `index` holds [`CELL_SURFELS`] surfels.
    fn level_at(&self, index: usize) -> u32 {
        let span = CELL_SURFELS - 1;
        let last = index.min(self.codes.len().saturating_sub(CELL_SURFELS));
        (index.saturating_sub(span)..=last)
            .filter_map(|first| self.codes.get(first + span).map(|b| (self.codes[first], *b)))
            .map(|(a, b)| MortonCode(a).common_level(MortonCode(b)))
            .max()
            .unwrap_or(0)
    }

    fn find_ranges(&mut self, cell: u64, level: u32) {
        if self.cell == Some((cell, level)) {
            return;
        }
        self.cell = Some((cell, level));
        self.ranges.clear();
        let shift = 3 * (MORTON_AXIS_BITS - level);
        let cells = 1u32 << level;
        let center = MortonCode(cell).to_cell();
        for step in 0..27u32 {
            let steps = [step % 3, step / 3 % 3, step / 9];
            // One below, the same, one above; wrapping sends those outside beyond `cells`.
            let at: [u32; 3] = std::array::from_fn(|i| (center[i] + steps[i]).wrapping_sub(1));
            if at.iter().any(|&x| x >= cells) {
                continue;
            }
            let first = MortonCode::from_cell(at[0], at[1], at[2]).0 << shift;
            let last = first + ((1u64 << shift) - 1);
            let start = self.codes.partition_point(|&code| code < first);
            let end = start + self.codes[start..].partition_point(|&code| code <= last);
            if start < end {
                self.ranges.push(start..end);
            }
        }
    }

    fn nearest_in_ranges(&self, index: usize) -> Nearest {
        let center = self.surfels[index].center();
        let mut nearest = Nearest::NONE;
        for range in &self.ranges {
            let stride = range.len().div_ceil(CELL_SURFELS_MAX);
            nearest.is_sampled |= stride > 1;
            for other in range.clone().step_by(stride) {
                if other != index {
                    let distance2 = self.surfels[other].center().distance_squared(center);
                    nearest.insert(distance2, other as u32);
                }
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::Vec3;

    #[test]
    fn neighbors_are_those_of_exhaustive_search() {
        let root = RootCube { min: Vec3::ZERO, edge: 1.0 };
        let mut surfels: Vec<Surfel> = (1..3000u32)
            .map(|i| {
                let x = (i as f32 * 0.618_034).fract();
                let y = (i as f32 * 0.754_878).fract();
                Surfel::new(Vec3::new(x, y, 0.3 + 0.1 * (x * 5.0).sin()), Vec3::Z, 1.0, 1.0)
            })
            .collect();
        surfels.sort_by_key(|s| root.code(s.center()));
        let codes: Vec<u64> = surfels.iter().map(|s| root.code(s.center()).0).collect();
        let mut search = NeighborSearch::new(root, &codes, &surfels);
        for (index, surfel) in surfels.iter().enumerate() {
            let mut distances: Vec<f32> =
                surfels.iter().map(|s| s.center().distance(surfel.center())).collect();
            distances.sort_by(f32::total_cmp);
            let nearest = search.nearest(index);
            assert_eq!(nearest.len(), NEIGHBORS);
            assert!((nearest.reach() - distances[NEIGHBORS]).abs() < 1e-6, "{index}");
        }
    }
}
