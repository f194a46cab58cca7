//! Sums over the surfels of a node: its bounds and its directional form.

use pbgi_cloud::Surfel;
use pbgi_format::{LOBES_MAX, Lobe};
use pbgi_math::{Aabb, DVec3, luminance, section_area};

/// Surfels of similar normals and radiance, summed in f64. See [`Lobe`] for the function it stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeSum {
    /// `Σ aᵢ nᵢ`.
    pub vector: DVec3,
    /// `Σ aᵢ`; twice the area for isotropic surfels, which show half of it to *every* direction.
    pub area: f64,
    /// `Σ aᵢ xᵢ`, area counted as in `area`.
    pub moment: DVec3,
    /// `Σ aᵢ Lᵢ`, area counted as in `area`.
    pub flux: [f64; 3],
    /// Whether backs block.
    pub blocks_back: bool,
}

impl LobeSum {
    /// The lobe of one surfel.
    #[must_use]
    pub fn from_surfel(surfel: &Surfel) -> Self {
        let isotropic = surfel.is_isotropic();
        let area = f64::from(surfel.area) * if isotropic { 2.0 } else { 1.0 };
        Self {
            vector: if isotropic { DVec3::ZERO } else { surfel.normal().as_dvec3() * area },
            area,
            moment: surfel.center().as_dvec3() * area,
            flux: surfel.radiance.map(|c| f64::from(c) * area),
            blocks_back: !isotropic && !surfel.is_front_only(),
        }
    }

    fn add(&mut self, other: &Self) {
        self.vector += other.vector;
        self.area += other.area;
        self.moment += other.moment;
        for (sum, part) in self.flux.iter_mut().zip(other.flux) {
            *sum += part;
        }
    }

    fn radiance(&self) -> [f32; 3] {
        self.flux.map(|f| (f / self.area) as f32)
    }

    /// What is lost by summing two lobes, in units of area; infinite where they must stay apart.
    ///
    /// Parallel lobes of similar radiance sum without loss; else the loss is the part of the vector areas that cancels,
    /// weighted up by the contrast of their radiance, plus a term for a flat lobe meeting a round one, and one
    /// that keeps lamps apart from the walls they hang on: what shines must not be averaged with what it hides.
    fn merge_cost(&self, other: &Self) -> f64 {
        if self.blocks_back != other.blocks_back {
            return f64::INFINITY;
        }
        let (v, w) = (self.vector.length(), other.vector.length());
        let cancelled = v + w - (self.vector + other.vector).length();
        let (l, m) = (luminance(self.radiance()), luminance(other.radiance()));
        let contrast = if l + m > 0.0 { f64::from((l - m).abs() / (l + m)) } else { 0.0 };
        let roundness = (v / self.area - w / other.area).abs() * self.area.min(other.area);
        let glare = ((contrast - LAMP_CONTRAST) / (1.0 - LAMP_CONTRAST)).max(0.0);
        cancelled * (1.0 + 2.0 * contrast)
            + 0.25 * contrast * roundness
            + glare * self.area.min(other.area)
    }

    /// The stored form, in a node whose stored box is `bounds`.
    #[must_use]
    pub fn to_lobe(self, bounds: &Aabb) -> Lobe {
        let length = self.vector.length();
        let (mut height, mut fill) = (0.0, 1.0);
        if length > 0.0 {
            let normal = self.vector / length;
            let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
            let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
            // A flat box has some thickness: normals scatter, and its corners are rounded.
            let half = half.max(DVec3::splat(1e-3 * half.max_element()));
            let reach = normal.abs().dot(half).max(f64::MIN_POSITIVE);
            height = (normal.dot(self.moment / self.area - center) / reach).clamp(-1.0, 1.0);
            let section = section_area(half, normal, height * reach);
            fill = (length / section.max(f64::MIN_POSITIVE)).min(1.0);
        }
        Lobe {
            vector: self.vector.as_vec3(),
            width: solve_width(length, self.area) as f32,
            blocks_back: self.blocks_back,
            radiance: self.radiance(),
            height: height as f32,
            fill: fill as f32,
        }
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

/// Contrast `(L − M)/(L + M)` above which one surface is a lamp beside the other: eight to one.
const LAMP_CONTRAST: f64 = 7.0 / 9.0;

/// Lobes that sum with less loss than this share of their node's area do so even where there is
/// room for more.
const MERGE_TOLERANCE: f64 = 0.01;

/// Sums lobes until at most [`LOBES_MAX`] remain and no two of them are nearly alike. Greedy: the
/// pair with the least loss first, ties to the lowest indices.
fn reduce_lobes(lobes: &mut Vec<LobeSum>) {
    let total: f64 = lobes.iter().map(|l| l.area).sum();
    // Most lobes of a flat piece are parallel; they need no search.
    let mut kept: Vec<LobeSum> = Vec::with_capacity(lobes.len());
    for lobe in lobes.iter() {
        let near = |k: &&mut LobeSum| k.merge_cost(lobe) <= 1e-4 * total;
        match kept.iter_mut().find(near) {
            Some(same) => same.add(lobe),
            None => kept.push(*lobe),
        }
    }
    while kept.len() > 1 {
        let mut best = (f64::INFINITY, 0, 0);
        for i in 0..kept.len() {
            for j in i + 1..kept.len() {
                let cost = kept[i].merge_cost(&kept[j]);
                if cost < best.0 {
                    best = (cost, i, j);
                }
            }
        }
        let (cost, i, j) = best;
        if !cost.is_finite() || (kept.len() <= LOBES_MAX && cost > MERGE_TOLERANCE * total) {
            break;
        }
        let other = kept.remove(j);
        kept[i].add(&other);
    }
    *lobes = kept;
}

/// What a node knows of its surfels.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeAggregate {
    /// Tight box of the surfels' rectangles, or where those are not known, of the area-true squares: of edge `√area`, so
    /// that pieces of a wall tile.
    pub bounds: Aabb,
    /// How far covering disks reach out of `bounds` at most.
    pub cover_margin: f32,
    /// Surfels below the node.
    pub surfel_count: u64,
    /// `Σ aᵢ`, each area counted once.
    pub area: f64,
    /// `Σ aᵢ Lᵢ`, each area counted once.
    pub flux: [f64; 3],
    /// Directional form, 1 to [`LOBES_MAX`] lobes.
    pub lobes: Vec<LobeSum>,
}

impl NodeAggregate {
    /// Aggregate of the surfels of a leaf.
    ///
    /// # Panics
    ///
    /// If there are none.
    #[must_use]
    pub fn from_surfels(surfels: &[Surfel]) -> Self {
        assert!(!surfels.is_empty(), "a node holds at least one surfel");
        let mut bounds = Aabb::EMPTY;
        let mut cover_margin = 0f32;
        let (mut area, mut flux) = (0.0, [0.0; 3]);
        for surfel in surfels {
            area += f64::from(surfel.area);
            for (sum, l) in flux.iter_mut().zip(surfel.radiance) {
                *sum += f64::from(surfel.area) * f64::from(l);
            }
            let (own, inner) = area_true_box(surfel);
            bounds = bounds.union(own);
            cover_margin = cover_margin.max(surfel.radius - inner);
        }
        let mut lobes = surfels.iter().map(LobeSum::from_surfel).collect();
        reduce_lobes(&mut lobes);
        Self { bounds, cover_margin, surfel_count: surfels.len() as u64, area, flux, lobes }
    }

    /// Aggregate of an inner node.
    ///
    /// # Panics
    ///
    /// If there are no children.
    #[must_use]
    pub fn from_children<'a>(children: impl Iterator<Item = &'a Self>) -> Self {
        let mut sum = Self {
            bounds: Aabb::EMPTY,
            cover_margin: 0.0,
            surfel_count: 0,
            area: 0.0,
            flux: [0.0; 3],
            lobes: Vec::with_capacity(16),
        };
        for child in children {
            sum.bounds = sum.bounds.union(child.bounds);
            sum.cover_margin = sum.cover_margin.max(child.cover_margin);
            sum.surfel_count += child.surfel_count;
            sum.area += child.area;
            for (sum, part) in sum.flux.iter_mut().zip(child.flux) {
                *sum += part;
            }
            sum.lobes.extend_from_slice(&child.lobes);
        }
        assert!(sum.surfel_count > 0, "an inner node has children");
        reduce_lobes(&mut sum.lobes);
        sum
    }
}

/// Half the edge of the square whose area is the surfel's: `√a / 2`; of half the area for an isotropic one,
/// which shows that much to every direction.
///
/// Boxes are made of squares, not disks, since squares tile: the box of a piece of axis-aligned wall
/// has exactly that piece's area, so its footprint is opaque and meets its neighbors'.
fn area_true_half_edge(surfel: &Surfel) -> f32 {
    let shown = if surfel.is_isotropic() { 0.5 * surfel.area } else { surfel.area };
    0.5 * shown.sqrt()
}

/// Box of a surfel's rectangle, or where that is not known, of its area-true square; and how far from the center the nearest
/// edge is.
fn area_true_box(surfel: &Surfel) -> (Aabb, f32) {
    let (center, half_edge) = (surfel.center(), area_true_half_edge(surfel));
    if surfel.is_isotropic() {
        (Aabb { min: center, max: center }.inflated(half_edge), half_edge)
    } else if let Some([long, short]) = surfel.half_edges() {
        let reach = long.abs() + short.abs();
        (Aabb { min: center - reach, max: center + reach }, short.length())
    } else {
        (Aabb::from_disk(center, surfel.normal(), half_edge), half_edge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::SurfelFlags;
    use pbgi_math::Vec3;

    fn directions(count: u32) -> impl Iterator<Item = Vec3> {
        (0..count).map(move |i| {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / count as f32;
            let phi = i as f32 * 2.399_963_2;
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize()
        })
    }

    fn exact_areas(surfels: &[Surfel], d: Vec3) -> (f32, f32) {
        surfels.iter().fold((0.0, 0.0), |(front, back), s| {
            let c = s.normal().dot(d) * s.area;
            (front + c.max(0.0), back + (-c).max(0.0))
        })
    }

    /// Largest error of the shown front area over all directions, as a share of the node's area.
    fn worst_error(surfels: &[Surfel]) -> f32 {
        let node = NodeAggregate::from_surfels(surfels);
        let total: f32 = surfels.iter().map(|s| s.area).sum();
        let lobes: Vec<_> = node.lobes.iter().map(|l| l.to_lobe(&node.bounds)).collect();
        directions(500)
            .map(|d| {
                let shown: f32 = lobes.iter().map(|l| l.front_area(d)).sum();
                (shown - exact_areas(surfels, d).0).abs() / total
            })
            .fold(0.0, f32::max)
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

    #[test]
    fn flat_and_box_like_clusters_are_exact() {
        let flat: Vec<_> = (0..10)
            .map(|i| Surfel::new(Vec3::X * i as f32, Vec3::new(0.6, 0.8, 0.0), 1.0, 1.0 + i as f32))
            .collect();
        assert_eq!(NodeAggregate::from_surfels(&flat).lobes.len(), 1);
        assert!(worst_error(&flat) < 1e-4);
        let corner: Vec<_> = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X]
            .into_iter()
            .cycle()
            .take(12)
            .map(|n| Surfel::new(n, n, 1.0, 1.0))
            .collect();
        assert_eq!(NodeAggregate::from_surfels(&corner).lobes.len(), 4);
        assert!(worst_error(&corner) < 1e-4);
    }

    #[test]
    fn closed_sphere_shows_a_quarter_of_its_area() {
        let sphere: Vec<_> = directions(400).map(|n| Surfel::new(n, n, 0.1, 0.1)).collect();
        // Four lobes of opposite caps: 6 % at worst, exact on average.
        assert!(worst_error(&sphere) < 0.06, "{}", worst_error(&sphere));
    }

    #[test]
    fn mean_shown_area_and_flux_are_exact_for_any_cluster() {
        let mut surfels = Vec::new();
        for (i, n) in directions(60).enumerate() {
            let tilted = (n + Vec3::new(0.3, 0.9, -0.2) * (i % 5) as f32).normalize();
            surfels.push(
                Surfel::new(n, tilted, 0.1, 0.05 + 0.01 * (i % 7) as f32)
                    .with_radiance([1.0 + i as f32, 2.0, 0.5])
                    .with_flags(SurfelFlags::FRONT_ONLY),
            );
        }
        let node = NodeAggregate::from_surfels(&surfels);
        let lobes: Vec<_> = node.lobes.iter().map(|l| l.to_lobe(&node.bounds)).collect();
        let (mut shown, mut flux) = (0f64, 0f64);
        for d in directions(4000) {
            for lobe in &lobes {
                assert_eq!(lobe.back_area(d), 0.0);
                shown += f64::from(lobe.front_area(d)) / 4000.0;
                flux += f64::from(lobe.front_area(d) * lobe.radiance[0]) / 4000.0;
            }
        }
        let area: f64 = surfels.iter().map(|s| f64::from(s.area)).sum();
        let emitted: f64 = surfels.iter().map(|s| f64::from(s.area * s.radiance[0])).sum();
        assert!((shown / (area / 4.0) - 1.0).abs() < 1e-3);
        assert!((flux / (emitted / 4.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn isotropic_surfels_show_half_their_area_everywhere() {
        let surfel = Surfel::new(Vec3::ZERO, Vec3::Z, 1.0, 3.0).with_flags(SurfelFlags::ISOTROPIC);
        let node = NodeAggregate::from_surfels(&[surfel]);
        let lobe = node.lobes[0].to_lobe(&node.bounds);
        for d in directions(20) {
            assert!((lobe.front_area(d) - 1.5).abs() < 1e-5);
            assert_eq!(lobe.back_area(d), 0.0);
        }
    }

    #[test]
    fn boxes_of_rectangles_are_exact() {
        // A ledge of 16 oblong pieces of 0.5 × 0.125, turned in its plane.
        let normal = Vec3::new(0.3, 0.9, -0.4).normalize();
        let along = normal.cross(Vec3::X).normalize();
        let across = normal.cross(along);
        let surfels: Vec<_> = (0..16)
            .map(|i| {
                Surfel::new(along * (0.5 * i as f32), normal, 1.0, 0.0625).with_tile(along, 4.0)
            })
            .collect();
        let node = NodeAggregate::from_surfels(&surfels);
        let corners = [(-0.25, -1.0), (-0.25, 1.0), (7.75, -1.0), (7.75, 1.0)]
            .map(|(x, y)| along * x + across * (0.0625 * y));
        let exact = Aabb::from_points(corners);
        // The stored direction is off by 0.5° at most, of half a long edge of 0.25, the normal by 0.1°.
        let error = (node.bounds.min - exact.min).abs().max((node.bounds.max - exact.max).abs());
        assert!(error.max_element() < 0.003, "{error}");
        for surfel in &surfels {
            let disk = Aabb::from_disk(surfel.center(), surfel.normal(), surfel.radius);
            assert!(node.bounds.inflated(node.cover_margin + 1e-6).contains_box(&disk));
        }
    }

    #[test]
    fn aggregates_of_children_are_those_of_all_their_surfels() {
        let surfels: Vec<_> = directions(64)
            .map(|n| Surfel::new(n * 2.0, n, 0.1, 0.1).with_radiance([n.x + 1.0; 3]))
            .collect();
        let whole = NodeAggregate::from_surfels(&surfels);
        let parts: Vec<_> = surfels.chunks(8).map(NodeAggregate::from_surfels).collect();
        let sum = NodeAggregate::from_children(parts.iter());
        assert_eq!(sum.bounds, whole.bounds);
        assert_eq!(sum.surfel_count, 64);
        let totals = |node: &NodeAggregate| {
            node.lobes.iter().fold((DVec3::ZERO, 0.0, 0.0), |t, l| {
                (t.0 + l.vector, t.1 + l.area, t.2 + l.flux[0])
            })
        };
        let (a, b) = (totals(&sum), totals(&whole));
        assert!(
            (a.0 - b.0).length() < 1e-9 && (a.1 - b.1).abs() < 1e-9 && (a.2 - b.2).abs() < 1e-9
        );
        for surfel in &surfels {
            let disk = Aabb::from_disk(surfel.center(), surfel.normal(), surfel.radius);
            assert!(sum.bounds.inflated(sum.cover_margin + 1e-6).contains_box(&disk));
        }
    }
}
