//! Sums over surfels of similar normals and radiance.

use crate::outline::{Outline, Outlines};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_format::Lobe;
use pbgi_math::{Aabb, DVec3, Frame, Stencil, Vec3, section_area, stencil_axis};

/// Surfels of similar normals and radiance, summed in f64. See [`Lobe`] for the function it stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeSum {
    /// `Σ aᵢ nᵢ`.
    pub vector: DVec3,
    /// `Σ aᵢ`; twice the area for isotropic surfels, which show half of it to *every* direction.
    pub area: f64,
    /// `Σ aᵢ xᵢ`, area counted as in `area`.
    pub moment: DVec3,
    /// `Σ aᵢ Lᵢ`, area counted as in `area`, of the surfels that are not buried.
    pub flux: [f64; 3],
    /// `Σ aᵢ` of these: what lies inside of walls does not darken them.
    pub seen: f64,
    /// `Σ aᵢ xᵢ` of these: nor does it move their plane.
    pub seen_moment: DVec3,
    /// Whether backs block.
    pub blocks_back: bool,
    /// Area that sheets cover, seen along `vector`: what lies behind other parts of the lobe does not count. `area` where backs block.
    pub covered: f64,
    /// Area of the surfels that are no part of a surface, counted as in `area`.
    pub loose: f64,
    /// Where sheets are; empty where backs block.
    pub bounds: Aabb,
    /// Where in the node's box the surfels lie, once that box is known.
    pub outlines: Outlines,
    /// Of a sheet that is not flat, and of loose surfels that are not, the clumping index of its node.
    pub clumping: f32,
}

/// Share of their area by which normals of parallel sheets may cancel.
const PARALLEL: f64 = 1e-4;

/// Distance of two sheets' planes, as a share of the smaller one's width, up to which they are pieces of one sheet.
const SAME_SHEET: f64 = 0.25;

/// Area over length of the vector area at which the width *h* of a lobe is a tenth of |**V**| + *h*: with *k* = 1/9 that is √(1 + *k*²) + *k*² asinh(1/*k*).
const FLAT_SHEET_AREA: f64 = 1.041_876_7;

/// Area of a surfel as lobes count it: see [`LobeSum::area`].
pub(crate) fn lobe_area(surfel: &Surfel) -> f64 {
    f64::from(surfel.area) * if surfel.is_isotropic() { 2.0 } else { 1.0 }
}

impl LobeSum {
    /// The lobe of one surfel, whose normal was decoded before.
    #[must_use]
    pub fn from_surfel(surfel: &Surfel, normal: Vec3) -> Self {
        let (isotropic, area) = (surfel.is_isotropic(), lobe_area(surfel));
        let seen = if surfel.flags.contains(SurfelFlags::BURIED) { 0.0 } else { area };
        let blocks_back = !isotropic && !surfel.is_front_only();
        let center = Aabb { min: surfel.center(), max: surfel.center() };
        Self {
            vector: if isotropic { DVec3::ZERO } else { normal.as_dvec3() * area },
            area,
            moment: surfel.center().as_dvec3() * area,
            flux: surfel.radiance.map(|c| f64::from(c) * seen),
            seen,
            seen_moment: surfel.center().as_dvec3() * seen,
            blocks_back,
            covered: area,
            loose: 0.0,
            bounds: if blocks_back {
                Aabb::EMPTY
            } else {
                center.inflated(0.5 * surfel.area.sqrt())
            },
            outlines: Outlines::default(),
            clumping: 1.0,
        }
    }

    /// Adds another lobe.
    pub fn add(&mut self, other: &Self) {
        if !self.blocks_back {
            self.covered -= self.covered_twice(other);
            self.bounds = self.bounds.union(other.bounds);
        }
        self.covered += other.covered;
        self.vector += other.vector;
        self.area += other.area;
        self.loose += other.loose;
        self.seen += other.seen;
        self.seen_moment += other.seen_moment;
        self.moment += other.moment;
        for (sum, part) in self.flux.iter_mut().zip(other.flux) {
            *sum += part;
        }
    }

    /// Area that two sheets, in planes apart from each other, both cover along their common normal: each is taken to be spread evenly and
    /// at random over the rectangle of its box in that view.
    fn covered_twice(&self, other: &Self) -> f64 {
        let normal = (self.vector + other.vector).normalize_or_zero();
        if normal == DVec3::ZERO {
            return 0.0;
        }
        let apart = normal.dot(self.place() - other.place()).abs();
        let frame = Frame::from_normal(normal.as_vec3());
        let side = |bounds: &Aabb, axis: Vec3| {
            let (center, half) = (bounds.center().dot(axis), 0.5 * bounds.extent().dot(axis.abs()));
            (center - half, center + half)
        };
        let (mut both, mut own, mut others) = (1.0, 1.0, 1.0);
        for axis in [frame.tangent, frame.bitangent] {
            let ((a, b), (c, d)) = (side(&self.bounds, axis), side(&other.bounds, axis));
            both *= f64::from((b.min(d) - a.max(c)).max(0.0));
            own *= f64::from(b - a);
            others *= f64::from(d - c);
        }
        // Pieces of one sheet lie side by side.
        if both == 0.0 || apart * apart < SAME_SHEET * SAME_SHEET * own.min(others) {
            return 0.0;
        }
        let (own_part, other_part) =
            ((self.covered / own).min(1.0), (other.covered / others).min(1.0));
        own_part * other_part * both
    }

    /// Whether most of it is no surface, but surfels that lie anywhere.
    pub(crate) fn is_loose(&self) -> bool {
        self.loose > 0.5 * self.area
    }

    /// Whether it has one side only, and is a surface.
    pub(crate) fn is_sheet(&self) -> bool {
        !self.blocks_back && !self.is_loose()
    }

    /// Whether a sheet is drawn as a piece of its plane: [`Lobe::is_flat`] but for rounding.
    pub(crate) fn is_flat_sheet(&self) -> bool {
        self.area <= FLAT_SHEET_AREA * self.vector.length()
    }

    /// Axis along which its stencil is looked at, which is that of the direction as it is stored.
    pub(crate) fn stencil_axis(&self) -> usize {
        stencil_axis(Lobe::decoded_direction(self.vector.as_vec3()))
    }

    /// Mean place of what is seen, or of all if nothing is.
    fn place(&self) -> DVec3 {
        if self.seen > 0.0 { self.seen_moment / self.seen } else { self.moment / self.area }
    }

    /// Mean radiance of what is seen.
    pub(crate) fn radiance(&self) -> [f32; 3] {
        if self.seen > 0.0 { self.flux.map(|f| (f / self.seen) as f32) } else { [0.0; 3] }
    }

    /// The stored form, in a node whose stored box is `bounds`.
    #[must_use]
    pub fn to_lobe(self, bounds: &Aabb) -> Lobe {
        let length = self.vector.length();
        let (mut height, mut fill) = (0.0, 1.0);
        let outline = match self.outlines {
            Outlines::Plane(outline) => outline,
            Outlines::Views(_) => Outline::default(),
        };
        if length > 0.0 {
            let normal = self.vector / length;
            let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
            let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
            // A flat box has some thickness: normals scatter, and its corners are rounded.
            let half = half.max(DVec3::splat(1e-3 * half.max_element()));
            let reach = normal.abs().dot(half).max(f64::MIN_POSITIVE);
            height = (normal.dot(self.place() - center) / reach).clamp(-1.0, 1.0);
            let axis = self.stencil_axis();
            // The covered cells, laid into the plane.
            let edges = half * 2.0;
            let face = edges[(axis + 1) % 3] * edges[(axis + 2) % 3];
            let section = if outline.stencil == Stencil::FULL {
                section_area(half, normal, height * reach)
            } else {
                face * f64::from(outline.stencil.share()) / normal[axis].abs()
            };
            // Parallel sheets are boards and panes, and closed; leaves are never parallel.
            let is_board = length >= self.area * (1.0 - PARALLEL);
            let covered = if is_board { length } else { length * (self.covered / self.area) };
            fill = (covered / section.max(f64::MIN_POSITIVE)).min(1.0);
            if self.is_loose() {
                fill = f64::from(outline.share());
            }
        }
        // Outlines are of all surfels, as what is buried lies within others'; what is shown is of those that are seen, so that light is kept.
        let shown = if self.seen > 0.0 { self.seen / self.area } else { 1.0 };
        let mut lobe = Lobe {
            vector: (self.vector * shown).as_vec3(),
            width: (solve_width(length, self.area) * shown) as f32,
            blocks_back: self.blocks_back,
            radiance: self.radiance(),
            height: height as f32,
            fill: fill as f32,
            is_loose: self.is_loose(),
            stencil: outline.stencil,
        };
        if !lobe.is_flat() {
            lobe.stencil = match self.outlines {
                Outlines::Plane(_) => Stencil::FULL,
                Outlines::Views(views) => Stencil::of_views(views.map(|view| view.stencil)),
            };
            if !lobe.is_solid() {
                lobe.set_clumping(self.clumping);
            }
        }
        lobe
    }
}

/// The width `h` with which a lobe of vector area `length` shows the mean area of its surfels.
///
/// The mean of `A` over the sphere is `½ ∫₀¹ √(length² c² + h²) dc` and must be `area/4`. The integral is
/// `½ (√(l² + h²) + (h²/l) asinh(l/h))`; it rises with `h`, from `l/2` at 0, with the slope `(h/l) asinh(l/h)`, and is convex: Newton's
/// steps from above the root stay above it. `½ √(area² − l²)` is above.
fn solve_width(length: f64, area: f64) -> f64 {
    let target = area / 2.0;
    if length >= area * (1.0 - 1e-6) {
        return 0.0;
    }
    if length <= area * 1e-6 {
        return target;
    }
    let mut width = 0.5 * (area * area - length * length).sqrt();
    for _ in 0..NEWTON_STEPS_MAX {
        let slope = width / length * (length / width).asinh();
        let mean = 0.5 * ((length * length + width * width).sqrt() + width * slope);
        let step = (mean - target) / slope;
        width -= step;
        if step <= NEWTON_ACCURACY * area {
            break;
        }
    }
    width.max(0.0)
}

/// Most steps; four suffice.
const NEWTON_STEPS_MAX: usize = 8;

/// Step, as a share of the area, after which the width is accurate to the square of that.
const NEWTON_ACCURACY: f64 = 1e-7;

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::SurfelFlags;

    fn sum(lobes: impl Iterator<Item = LobeSum>) -> LobeSum {
        let add = |mut sum: LobeSum, lobe: LobeSum| {
            sum.add(&lobe);
            sum
        };
        lobes.reduce(add).unwrap()
    }

    /// The lobe of those of 8 × 8 squares, by column and row, in a plane at this height that is tilted by this angle.
    fn sheet(height: f32, angle: f32, holds: impl Fn(i32, i32) -> bool) -> LobeSum {
        let normal = Vec3::new(angle.sin(), 0.0, angle.cos());
        let squares = (0..64).map(|i| (i % 8, i / 8)).filter(|&(i, j)| holds(i, j));
        sum(squares.map(|(i, j)| {
            let [x, y] = [i, j].map(|k| (k as f32 - 3.5) * 0.25);
            let center = Vec3::new(x, y, height - x * angle.tan());
            let surfel =
                Surfel::new(center, normal, 0.2, 0.0625).with_flags(SurfelFlags::FRONT_ONLY);
            LobeSum::from_surfel(&surfel, normal)
        }))
    }

    /// Fill of the box from −1 to 1 by sheets at these heights, tilted by this angle to either side, in turn.
    fn fill_of_sheets(heights: &[f32], tilt: f32) -> f32 {
        let tilts = [tilt, -tilt].into_iter().cycle();
        let sheets =
            heights.iter().zip(tilts).map(|(&height, tilt)| sheet(height, tilt, |_, _| true));
        let bounds = Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE };
        sum(sheets).to_lobe(&bounds).fill
    }

    #[test]
    fn sheets_above_each_other_cover_once() {
        // One sheet, and a board of two.
        assert!(fill_of_sheets(&[0.3], 0.0) > 0.99);
        assert!(fill_of_sheets(&[-0.5, 0.5], 0.0) > 0.99);
        // Two that are tilted apart cover each other, and no more.
        let two = fill_of_sheets(&[-0.5, 0.5], 0.1);
        assert!(two > 0.85, "{two}");
    }

    #[test]
    fn leaves_spread_at_random_cover_what_they_leave_open() {
        // Sparse sheets: every other square, so each covers half of its rectangle.
        let odd = |i: i32, j: i32| (i + j) % 2 == 1;
        let (mut low, high) = (sheet(-0.5, 0.2, |i, j| !odd(i, j)), sheet(0.5, -0.2, odd));
        assert!((low.covered - 2.0).abs() < 1e-6);
        low.add(&high);
        // 1 − (1 − ½)² of the four.
        assert!((low.covered - 3.0).abs() < 0.1, "{low:?} {high:?}");
        assert!(low.area == 4.0);
    }

    #[test]
    fn sheets_are_flat_for_their_builder_as_for_their_reader() {
        let bounds = Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE };
        for (share, is_flat) in [(1.0, true), (0.9601, true), (0.9597, false), (0.3, false)] {
            let mut lobe = sheet(0.0, 0.0, |_, _| true);
            lobe.vector *= share;
            assert_eq!((lobe.is_flat_sheet(), lobe.to_lobe(&bounds).is_flat()), (is_flat, is_flat));
        }
    }

    #[test]
    fn widths_show_the_mean_area() {
        let ratios = (1..1000).map(|i| f64::from(i) / 1000.0);
        for ratio in ratios.chain([1e-9, 1e-5, 0.9999, 0.999_99, 0.999_998]) {
            let (area, length) = (3.0, 3.0 * ratio);
            let h = solve_width(length, area);
            // The mean over the sphere, by the midpoint rule.
            let steps = 4000;
            let shown = |i: u32| {
                let along = length * (f64::from(i) + 0.5) / f64::from(steps);
                (along * along + h * h).sqrt()
            };
            let mean = 0.5 * (0..steps).map(shown).sum::<f64>() / f64::from(steps);
            assert!((mean / (area / 4.0) - 1.0).abs() < 1e-7, "{ratio}: {h}, {mean}");
        }
    }
}
