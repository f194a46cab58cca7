//! How much sheets hide each other: what leaves cover, and the clumping index that follows.

use crate::lobe_sum::LobeSum;
use pbgi_cloud::Surfel;
use pbgi_math::{Aabb, Mat3, Vec3, box_silhouette, thick_half};

/// Directions along which is looked what sheets cover: at right angles to each other, and along no axis, as what people build is.
const VIEWS: Mat3 = Mat3::from_cols_array(&[
    2.0 / 3.0,
    -2.0 / 3.0,
    1.0 / 3.0,
    2.0 / 3.0,
    1.0 / 3.0,
    -2.0 / 3.0,
    1.0 / 3.0,
    2.0 / 3.0,
    2.0 / 3.0,
]);

/// Number of them.
const COUNT: usize = 3;

/// Lines of sight along a view: rows of so many at most.
const LINES: usize = 32;

/// Largest share of a silhouette that a finite optical depth covers.
const COVERED_MAX: f32 = 0.98;

/// Least spacing of lines over the largest coordinate.
const LATTICE_MIN: f64 = f32::EPSILON as f64 / 64.0;

/// Lines of sight that meet sheets, in rows of a bit each.
type Met = [u32; LINES];

/// What the sheets of a node cover, seen along each of [`VIEWS`].
///
/// Lines of sight lie on a square lattice whose spacing is a power of two; those of a wider spacing are some of those of a narrower one. So what the parts of a node
/// meet tells what the node meets, line by line, and nothing is assumed of how its parts lie before each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetCover {
    /// Box around them, in a frame whose axes are the views.
    bounds: Aabb,
    /// The lines' spacing.
    spacing: f64,
    /// Which lines along each view meet a front.
    met: [Met; COUNT],
}

impl SheetCover {
    /// The two axes across a view: along rows, and from row to row.
    fn across(view: usize) -> [usize; 2] {
        [(view + 1) % COUNT, (view + 2) % COUNT]
    }

    /// With no line in a box met; nothing where there is no box.
    fn around(bounds: Aabb) -> Option<Self> {
        let farthest = f64::from(bounds.min.abs().max(bounds.max.abs()).max_element());
        if !farthest.is_finite() {
            return None;
        }
        let widest = f64::from(bounds.extent().max_element()) / (LINES - 1) as f64;
        // A lattice that is much finer than coordinates tells nothing.
        let least = widest.max(farthest * LATTICE_MIN).max(f64::from(f32::MIN_POSITIVE));
        Some(Self { bounds, spacing: power_of_two(least), met: [[0; LINES]; COUNT] })
    }

    /// Number of the first line along an axis that its box meets.
    fn first(&self, axis: usize) -> i64 {
        (f64::from(self.bounds.min[axis]) / self.spacing).ceil() as i64
    }

    /// Area that fronts cover, seen along a view.
    fn covered(&self, view: usize) -> f32 {
        let lines: u32 = self.met[view].iter().map(|row| row.count_ones()).sum();
        lines as f32 * (self.spacing * self.spacing) as f32
    }

    /// What surfels of a leaf cover together, if there are any.
    pub fn of_surfels<'s>(sheets: impl Iterator<Item = &'s Surfel>) -> Option<Self> {
        let outlines: Vec<TurnedOutline> = sheets.map(TurnedOutline::of).collect();
        let corners = outlines.iter().flat_map(|outline| outline.corners());
        let mut found = Self::around(Aabb::from_points(corners.copied()))?;
        let (first, scale) = ([0, 1, 2].map(|axis| found.first(axis) as f64), 1.0 / found.spacing);
        for outline in &outlines {
            for view in (0..COUNT).filter(|view| outline.facing[*view] > 0.0) {
                let at = |corner: Vec3| {
                    let place = |axis: usize| f64::from(corner[axis]) * scale - first[axis];
                    Self::across(view).map(|axis| place(axis) as f32)
                };
                set_met(&mut found.met[view], &outline.corners.map(at)[..outline.count]);
            }
        }
        Some(found)
    }

    /// What parts of a node cover together, if there are any.
    pub fn of_parts<'s>(parts: impl Iterator<Item = &'s Self> + Clone) -> Option<Self> {
        let bounds = parts.clone().fold(Aabb::EMPTY, |sum, part| sum.union(part.bounds));
        let mut found = Self::around(bounds)?;
        parts.for_each(|part| found.add(part));
        Some(found)
    }

    /// Adds what a part meets of the lines.
    fn add(&mut self, part: &Self) {
        let halvings = exponent(self.spacing) - exponent(part.spacing);
        for view in 0..COUNT {
            let [u, v] = Self::across(view);
            let (mut column, mut first_row) = (part.first(u), part.first(v));
            let mut rows = part.met[view];
            for _ in 0..halvings {
                let [odd_column, odd_row] = [column, first_row].map(|i| i.rem_euclid(2));
                for row in 0..LINES {
                    let from = 2 * row + odd_row as usize;
                    let bits = rows.get(from).copied().unwrap_or(0);
                    rows[row] = every_second(bits >> odd_column);
                }
                (column, first_row) = ((column + odd_column) / 2, (first_row + odd_row) / 2);
            }
            // Its box lies in this one.
            let (shift, down) = (column - self.first(u), first_row - self.first(v));
            for (row, bits) in rows.into_iter().enumerate().filter(|(_, bits)| *bits != 0) {
                if let Some(met) = self.met[view].get_mut(row + down as usize) {
                    *met |= bits.checked_shl(shift as u32).unwrap_or(0);
                }
            }
        }
    }

    /// The clumping index of the sheets of a node with these lobes and this box: which share of the optical depth of those that are not flat would, in a turbid
    /// medium that fills the box, cover as much as is covered (Nilson 1971); 1 if all are flat.
    ///
    /// Where the silhouette has the area *S*, the flat ones leave Π (1 − *F*ᵢ/*S*) of it open, and the others, which show the area *R*, e^(−Ω *R*/*S*) of that. Ω is such
    /// that the sum of Ω *R* over all views is right.
    pub fn clumping(&self, lobes: &[LobeSum], bounds: &Aabb) -> f32 {
        let half = thick_half(bounds.min, bounds.max);
        let (mut round, mut flat) = (Vec::new(), Vec::new());
        for lobe in lobes.iter().filter(|lobe| lobe.is_sheet()) {
            let shown = lobe.to_lobe(bounds);
            match shown.is_flat() {
                true => flat.push((shown, (lobe.covered / lobe.area) as f32)),
                false => round.push(shown),
            }
        }
        if round.is_empty() {
            return 1.0;
        }
        let (mut area, mut spread) = (0.0, 0.0);
        for view in 0..COUNT {
            let direction = VIEWS.transpose().col(view);
            let silhouette = box_silhouette(half, direction);
            let share = |area: f32| (area / silhouette).min(COVERED_MAX);
            let flat = flat.iter().map(|(lobe, single)| lobe.front_area(direction) * single);
            let open: f32 = flat.map(|area| 1.0 - share(area)).product();
            let left = (1.0 - self.covered(view) / silhouette) / open;
            spread -= silhouette * left.clamp(1.0 - COVERED_MAX, 1.0).ln();
            area += round.iter().map(|lobe| lobe.front_area(direction)).sum::<f32>();
        }
        if area > 0.0 { spread / area } else { 1.0 }
    }
}

/// Exponent of a power of two as it is stored.
fn exponent(power: f64) -> u64 {
    power.to_bits() >> (f64::MANTISSA_DIGITS - 1)
}

/// The least power of two that is no less than this, which is above 0.
fn power_of_two(least: f64) -> f64 {
    let low = f64::from_bits(exponent(least) << (f64::MANTISSA_DIGITS - 1));
    if low < least { 2.0 * low } else { low }
}

/// A surfel's outline in the frame of the views; of a disk, that of a square of its area.
struct TurnedOutline {
    corners: [Vec3; 4],
    count: usize,
    /// Cosines between its normal and the views.
    facing: Vec3,
}

impl TurnedOutline {
    fn of(surfel: &Surfel) -> Self {
        let turned = |corner: Vec3| VIEWS * (surfel.center() + corner);
        let facing = VIEWS * surfel.normal();
        if let Some([a, b, c]) = surfel.corners() {
            return Self { corners: [a, b, c, c].map(turned), count: 3, facing };
        }
        let [along, across] = surfel.half_edges().unwrap_or_else(|| {
            let (tangent, bitangent) = surfel.normal().any_orthonormal_pair();
            [tangent, bitangent].map(|edge| edge * (0.5 * surfel.area.sqrt()))
        });
        let corners = [along + across, across - along, -along - across, along - across];
        Self { corners: corners.map(turned), count: 4, facing }
    }

    fn corners(&self) -> &[Vec3] {
        &self.corners[..self.count]
    }
}

/// The even bits, side by side.
fn every_second(bits: u32) -> u32 {
    let mut found = bits & 0x5555_5555;
    for (shift, mask) in [(1, 0x3333_3333), (2, 0x0f0f_0f0f), (4, 0x00ff_00ff), (8, 0xffff)] {
        found = (found | found >> shift) & mask;
    }
    found
}

/// Sets the lines that meet a convex polygon; they lie where coordinates are whole.
fn set_met(rows: &mut Met, corners: &[[f32; 2]]) {
    let ends = corners.iter().fold([f32::MAX, f32::MIN], |[low, high], corner| {
        [low.min(corner[1]), high.max(corner[1])]
    });
    // The next whole number, which rounding toward 0 finds faster than `ceil` does.
    let line = |x: f32| {
        let x = x.min(LINES as f32);
        let whole = x as usize;
        whole + usize::from((whole as f32) < x)
    };
    let (first, end) = (line(ends[0]), line(ends[1]));
    for (row, bits) in rows.iter_mut().enumerate().take(end).skip(first) {
        let height = row as f32;
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        for (i, a) in corners.iter().enumerate() {
            let b = corners[(i + 1) % corners.len()];
            if (a[1] <= height) != (b[1] <= height) {
                let at = a[0] + (b[0] - a[0]) * (height - a[1]) / (b[1] - a[1]);
                (low, high) = (low.min(at), high.max(at));
            }
        }
        let (low, high) = (line(low), line(high));
        if low < high {
            *bits |= (u32::MAX >> (LINES - (high - low))) << low;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeAggregate;
    use pbgi_cloud::SurfelFlags;

    /// Numbers from 0 to 1 that look random.
    fn random() -> impl FnMut() -> f32 {
        let mut seed = 5u64;
        move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 40) as f32 / (1u64 << 24) as f32
        }
    }

    /// A leaf of this area, of four squares: both its sides.
    fn leaf(center: Vec3, normal: Vec3, area: f32) -> Vec<Surfel> {
        let (along, across) = normal.any_orthonormal_pair();
        let quarter = 0.25 * area.sqrt();
        let square = |(a, b): (f32, f32)| {
            let at = center + (along * a + across * b) * quarter;
            [normal, -normal].map(|normal| {
                let surfel = Surfel::new(at, normal, quarter * 2f32.sqrt(), 0.25 * area);
                surfel.with_flags(SurfelFlags::FRONT_ONLY).with_tile(along, 1.0)
            })
        };
        let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
        corners.into_iter().flat_map(square).collect()
    }

    /// Leaves all over a cube of edge 4.
    fn leaves(count: usize, area: f32) -> Vec<Surfel> {
        let mut random = random();
        let mut at = || Vec3::new(random(), random(), random());
        let mut places = (0..count).map(|_| (at() * 4.0, (at() - 0.5).normalize()));
        places.by_ref().flat_map(|(center, normal)| leaf(center, normal, area)).collect()
    }

    fn covered(cover: &SheetCover) -> [f32; COUNT] {
        std::array::from_fn(|view| cover.covered(view))
    }

    #[test]
    fn what_parts_meet_is_what_their_surfels_meet() {
        let surfels = leaves(256, 0.08);
        let whole = SheetCover::of_surfels(surfels.iter()).unwrap();
        assert!(whole.met.iter().flatten().any(|row| *row != 0));
        for size in [1, 8, 40] {
            let parts: Vec<SheetCover> =
                surfels.chunks(size).filter_map(|s| SheetCover::of_surfels(s.iter())).collect();
            let halves: Vec<SheetCover> =
                parts.chunks(5).filter_map(|p| SheetCover::of_parts(p.iter())).collect();
            assert_eq!(SheetCover::of_parts(halves.iter()).unwrap(), whole, "{size}");
        }
        assert_eq!(SheetCover::of_surfels([].iter()), None);
        assert_eq!(SheetCover::of_parts([].iter()), None);
    }

    #[test]
    fn surfels_cover_their_area_once() {
        let normal = Vec3::new(0.5, 0.2, 0.7).normalize();
        let center = Vec3::new(30.0, -7.0, 2.0);
        let one = leaf(center, normal, 0.3);
        let two = [one.clone(), leaf(center + normal * 0.01, normal, 0.3)].concat();
        for surfels in [one, two] {
            let found = covered(&SheetCover::of_surfels(surfels.iter()).unwrap());
            for (view, found) in found.into_iter().enumerate() {
                let expected = 0.3 * (VIEWS * normal)[view].abs();
                // 16 to 31 lines across the longest side.
                assert!((found / expected - 1.0).abs() < 0.15, "{view}: {found}, {expected}");
            }
        }
        // On the mean, lines tell areas as they are.
        let surfels = leaves(300, 0.08);
        let single = surfels.iter().filter_map(|s| SheetCover::of_surfels(std::iter::once(s)));
        let sums = single.fold([0.0; COUNT], |sums, cover| {
            std::array::from_fn(|view| sums[view] + cover.covered(view))
        });
        for (view, found) in sums.into_iter().enumerate() {
            let shown = |s: &Surfel| s.area * (VIEWS * s.normal())[view].max(0.0);
            let expected: f32 = surfels.iter().map(shown).sum();
            assert!((found / expected - 1.0).abs() < 0.01, "{view}: {found}, {expected}");
        }
    }

    /// The clumping index of a node of such surfels.
    fn clumping(surfels: &[Surfel]) -> f32 {
        let node = NodeAggregate::from_surfels(surfels);
        let round = node.lobes.iter().map(|lobe| lobe.to_lobe(&node.bounds));
        let found = round.filter(|lobe| lobe.is_sheet() && !lobe.is_flat()).map(|l| l.clumping());
        found.reduce(f32::max).expect("a round sheet")
    }

    #[test]
    fn clumping_tells_how_much_leaves_hide_each_other() {
        // All over a cube: from the side of its edges, lines of sight through it are of all lengths.
        let even = clumping(&leaves(400, 0.04));
        assert!(even > 0.7 && even < 1.0, "{even}");
        // Each in front of another: half as much covers, and more is hidden by chance.
        let mut pairs = leaves(200, 0.04);
        let behind: Vec<Surfel> = pairs
            .iter()
            .map(|surfel| {
                let flags = SurfelFlags::FRONT_ONLY;
                let center = surfel.center() + 1e-3;
                Surfel::new(center, surfel.normal(), surfel.radius, surfel.area).with_flags(flags)
            })
            .collect();
        pairs.extend(behind);
        let paired = clumping(&pairs);
        assert!((paired / even - 0.5).abs() < 0.1, "{paired}, {even}");
        // All in an eighth of the cube but a few.
        let mut bunch = leaves(400, 0.04);
        for surfel in &mut bunch[8..] {
            surfel.position = (surfel.center() * 0.4).to_array();
        }
        let bunched = clumping(&bunch);
        assert!(bunched < 0.5 * even, "{bunched}, {even}");
    }

    #[test]
    fn sheets_of_any_size_and_place_are_summed() {
        let mut sum: Option<SheetCover> = None;
        for (place, size) in [(0.0, 1e-20), (1e-12, 1e-18), (3.0, 1e-9), (2e9, 1e-3), (-2e9, 2e9)] {
            let surfels = leaf(Vec3::new(place, 0.5 * place, -place), Vec3::Y, size * size);
            let part = SheetCover::of_surfels(surfels.iter()).unwrap();
            let parts: Vec<SheetCover> = sum.into_iter().chain([part]).collect();
            let both = SheetCover::of_parts(parts.iter()).unwrap();
            assert!(covered(&both).iter().all(|area| area.is_finite()), "{place} {size}");
            assert!(parts.iter().all(|part| part.spacing <= both.spacing));
            sum = Some(both);
        }
    }

    #[test]
    fn only_lines_inside_are_met() {
        let met = |corners: &[[f32; 2]]| {
            let mut rows = [0; LINES];
            set_met(&mut rows, corners);
            rows
        };
        let square = |low: f32, high: f32| [[low, low], [high, low], [high, high], [low, high]];
        let mut expected = [0; LINES];
        expected[2..5].fill(0b1_1100);
        assert_eq!(met(&square(1.5, 4.5)), expected);
        assert_eq!(met(&square(2.0, 5.0)), expected);
        // Between two lines, outside, without an area, and all of them.
        for nothing in [square(1.2, 1.8), square(-9.0, -1.0), square(40.0, 1e30), square(3.0, 3.0)]
        {
            assert_eq!(met(&nothing), [0; LINES], "{nothing:?}");
        }
        assert_eq!(met(&square(-1e30, 1e30)), [u32::MAX; LINES]);
        assert_eq!(met(&square(f32::NAN, f32::NAN)), [0; LINES]);
    }

    #[test]
    fn even_bits_come_side_by_side() {
        for bits in [0u32, 1, 2, 0x5555_5555, 0xdead_beef, u32::MAX] {
            let expected = (0..16).map(|i| (bits >> (2 * i) & 1) << i).sum::<u32>();
            assert_eq!(every_second(bits), expected);
        }
    }
}
