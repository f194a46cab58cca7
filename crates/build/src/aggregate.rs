//! Sums over the surfels of a node: its bounds and its directional form.

use crate::clumping::SheetCover;
use crate::crowd::Crowd;
use crate::lobe_sum::{LobeSum, lobe_area};
use crate::outline::{InnerOutlines, LeafOutlines, Outlines};
use crate::reduce::{LobeReducer, LobeSums};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_format::LOBES_MAX;
use pbgi_math::{Aabb, Vec3, rectangle_half_edges, triangle_base, triangle_corners};

/// What a node knows of its surfels.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeAggregate {
    /// Tight box of the surfels' rectangles and triangles, or where those are not known, of the area-true squares: of edge `√area`, so
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
    /// Directional form, at least one lobe.
    pub lobes: LobeSums,
    /// What its sheets cover, if it has any.
    sheets: Option<Box<SheetCover>>,
    /// What its loose surfels hide of each other, if it has any.
    crowd: Option<Crowd>,
}

impl NodeAggregate {
    /// Aggregate of the surfels of a leaf.
    ///
    /// # Panics
    ///
    /// If there are none.
    #[must_use]
    pub fn from_surfels(surfels: &[Surfel]) -> Self {
        Self::from_surfels_with(&mut LobeReducer::default(), surfels)
    }

    pub(crate) fn from_surfels_with(reducer: &mut LobeReducer, surfels: &[Surfel]) -> Self {
        assert!(!surfels.is_empty(), "a node holds at least one surfel");
        let mut node = Self::empty();
        node.surfel_count = surfels.len() as u64;
        let lobe_total: f64 = surfels.iter().map(lobe_area).sum();
        reducer.clear();
        let mut shape = Shape::of(&surfels[0]);
        let mut place: Option<(usize, &Surfel)> = None;
        reducer.find_loose(surfels);
        for (number, surfel) in surfels.iter().enumerate() {
            if (surfel.orientation, surfel.flags) != shape.key {
                shape = Shape::of(surfel);
            }
            let (own, inner) = shape.area_true_box(surfel);
            node.bounds = node.bounds.union(own);
            node.cover_margin = node.cover_margin.max(surfel.radius - inner);
            let area = f64::from(surfel.area);
            node.area += area;
            for (sum, l) in node.flux.iter_mut().zip(surfel.radiance) {
                *sum += area * f64::from(l);
            }
            let mut lobe = LobeSum::from_surfel(surfel, shape.normal);
            if reducer.loose[number] {
                lobe.loose = lobe.area;
            }
            match place {
                Some((place, before)) if is_alike(before, surfel) => reducer.add_to(place, &lobe),
                _ => place = Some((reducer.add(&lobe, lobe_total), surfel)),
            }
        }
        node.lobes = reducer.reduce(lobe_total);
        let mut outlines = node.outline_sums(LeafOutlines::new);
        let mut shape = Shape::of(&surfels[0]);
        for (surfel, owner) in surfels.iter().zip(&reducer.owners) {
            if (surfel.orientation, surfel.flags) != shape.key {
                shape = Shape::of(surfel);
            }
            let Some(Some(sum)) = outlines.get_mut(*owner as usize) else { continue };
            let (own, _) = shape.area_true_box(surfel);
            sum.add(surfel, shape.normal, &own);
        }
        let bounds = node.bounds;
        node.set_outlines(outlines, |sum, lobe| sum.finish(lobe, &bounds));
        let is_sheet = |&(_, owner): &(&Surfel, &u32)| {
            node.lobes.get(*owner as usize).is_some_and(LobeSum::is_sheet)
        };
        let sheets = surfels.iter().zip(&reducer.owners).filter(is_sheet);
        let sheets = SheetCover::of_surfels(sheets.map(|(surfel, _)| surfel));
        node.set_sheets(sheets);
        node.set_crowd(Crowd::of_surfels(surfels, &reducer.loose));
        node
    }

    /// Empty outlines of its lobes.
    fn outline_sums<S>(&self, new: impl Fn(&LobeSum, &Aabb) -> S) -> [Option<S>; LOBES_MAX] {
        std::array::from_fn(|i| self.lobes.get(i).map(|lobe| new(lobe, &self.bounds)))
    }

    fn set_outlines<S>(
        &mut self,
        sums: [Option<S>; LOBES_MAX],
        finish: impl Fn(S, &LobeSum) -> Outlines,
    ) {
        for (lobe, sum) in self.lobes.iter_mut().zip(sums) {
            if let Some(sum) = sum {
                lobe.outlines = finish(sum, lobe);
            }
        }
    }

    fn set_sheets(&mut self, sheets: Option<SheetCover>) {
        let Some(sheets) = sheets else { return };
        let clumping = sheets.clumping(&self.lobes, &self.bounds);
        let of_sheets = self.lobes.iter_mut().filter(|lobe| lobe.is_sheet());
        of_sheets.for_each(|lobe| lobe.clumping = clumping);
        self.sheets = Some(Box::new(sheets));
    }

    fn set_crowd(&mut self, crowd: Option<Crowd>) {
        let Some(crowd) = crowd else { return };
        let clumping = crowd.clumping(&self.bounds);
        let of_loose = self.lobes.iter_mut().filter(|lobe| lobe.is_loose());
        of_loose.for_each(|lobe| lobe.clumping = clumping);
        self.crowd = Some(crowd);
    }

    /// Aggregate of an inner node.
    ///
    /// # Panics
    ///
    /// If there are no children.
    #[must_use]
    pub fn from_children<'a>(children: impl Iterator<Item = &'a Self> + Clone) -> Self {
        Self::from_children_with(&mut LobeReducer::default(), children)
    }

    pub(crate) fn from_children_with<'a>(
        reducer: &mut LobeReducer,
        children: impl Iterator<Item = &'a Self> + Clone,
    ) -> Self {
        let mut sum = Self::empty();
        let lobes = || children.clone().flat_map(|child| child.lobes.iter());
        let lobe_total = lobes().map(|l| l.area).sum();
        reducer.clear();
        for lobe in lobes() {
            reducer.add(lobe, lobe_total);
        }
        for child in children.clone() {
            sum.bounds = sum.bounds.union(child.bounds);
            sum.cover_margin = sum.cover_margin.max(child.cover_margin);
            sum.surfel_count += child.surfel_count;
            sum.area += child.area;
            for (sum, part) in sum.flux.iter_mut().zip(child.flux) {
                *sum += part;
            }
        }
        assert!(sum.surfel_count > 0, "an inner node has children");
        sum.lobes = reducer.reduce(lobe_total);
        let mut outlines = sum.outline_sums(InnerOutlines::new);
        let mut owners = reducer.owners.iter();
        for child in children.clone() {
            for (lobe, owner) in child.lobes.iter().zip(&mut owners) {
                if let Some(Some(sum)) = outlines.get_mut(*owner as usize) {
                    sum.add(lobe, &child.bounds);
                }
            }
        }
        sum.set_outlines(outlines, InnerOutlines::finish);
        let sheets = children.clone().filter_map(|child| child.sheets.as_deref());
        sum.set_sheets(SheetCover::of_parts(sheets));
        sum.set_crowd(Crowd::of_parts(children.filter_map(|child| child.crowd.as_ref())));
        sum
    }

    fn empty() -> Self {
        Self {
            bounds: Aabb::EMPTY,
            cover_margin: 0.0,
            surfel_count: 0,
            area: 0.0,
            flux: [0.0; 3],
            lobes: LobeSums::default(),
            sheets: None,
            crowd: None,
        }
    }
}

/// Whether the lobes of two surfels differ in area and place only.
fn is_alike(a: &Surfel, b: &Surfel) -> bool {
    (a.orientation, a.flags) == (b.orientation, b.flags) && a.radiance == b.radiance
}

/// What a surfel stands for.
enum Outline {
    Disk,
    /// Unit vectors along the edges, by axis without their signs.
    Rectangle([Vec3; 2]),
    /// Unit vectors along the longest edge and across, and where the height stands on that.
    Triangle([Vec3; 2], f32),
}

/// What follows from a surfel's orientation, which neighbors often share.
struct Shape {
    key: (u32, SurfelFlags),
    normal: Vec3,
    outline: Outline,
}

impl Shape {
    fn of(surfel: &Surfel) -> Self {
        let (normal, tile, foot) = (surfel.normal(), surfel.tile(), surfel.foot());
        let outline = match (tile.is_known(), foot.is_known()) {
            (false, _) => Outline::Disk,
            (true, false) => Outline::Rectangle(tile.edges(normal).map(Vec3::abs)),
            (true, true) => Outline::Triangle(tile.axes(normal), foot.share()),
        };
        Self { key: (surfel.orientation, surfel.flags), normal, outline }
    }

    /// Box of a surfel's rectangle or triangle, or where that is not known, of its area-true square; and how far from the center the nearest
    /// edge is.
    ///
    /// Boxes are made of squares, not disks, since squares tile: the box of a piece of axis-aligned wall
    /// has exactly that piece's area, so its footprint is opaque and meets its neighbors'. An isotropic surfel shows half its area to every
    /// direction.
    fn area_true_box(&self, surfel: &Surfel) -> (Aabb, f32) {
        let center = surfel.center();
        if surfel.is_isotropic() {
            let half_edge = 0.5 * (0.5 * surfel.area).sqrt();
            return (Aabb { min: center, max: center }.inflated(half_edge), half_edge);
        }
        match &self.outline {
            Outline::Disk => {
                let half_edge = 0.5 * surfel.area.sqrt();
                (Aabb::from_disk(center, self.normal, half_edge), half_edge)
            }
            Outline::Rectangle([along, across]) => {
                let [long, short] = rectangle_half_edges(surfel.radius, surfel.area);
                let reach = *along * long + *across * short;
                (Aabb { min: center - reach, max: center + reach }, short)
            }
            Outline::Triangle([along, left], foot) => {
                let base = triangle_base(surfel.radius, surfel.area, *foot);
                let height = 2.0 * surfel.area / base;
                let corners = triangle_corners(base, height, *foot)
                    .map(|[x, y]| center + *along * x + *left * y);
                // The longest edge is the nearest.
                (Aabb::from_points(corners), height * (1.0 / 3.0))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::DVec3;

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

    /// A lamp below a ceiling, whose tiles above it are buried, shines as it does alone.
    #[test]
    fn what_is_buried_neither_dims_nor_adds_to_what_shines() {
        let tile = |height: f32, radiance: f32| {
            let at = Vec3::new(0.0, height, 0.0);
            Surfel::new(at, Vec3::NEG_Y, 0.707, 1.0).with_radiance([radiance; 3])
        };
        let lamp = tile(-0.01, 3.0);
        let ceiling = tile(0.0, 0.0).with_flags(SurfelFlags::BURIED);
        let node = NodeAggregate::from_surfels(&[lamp, ceiling]);
        assert_eq!(node.lobes.len(), 1);
        let lobe = node.lobes[0].to_lobe(&node.bounds);
        let flux = lobe.front_area(Vec3::NEG_Y) * lobe.radiance[0];
        assert!((flux - 3.0).abs() < 1e-5 && lobe.radiance[0] == 3.0, "{lobe:?}");
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
