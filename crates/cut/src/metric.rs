//! When a node is small enough to stand for its surfels, and what it then shows.

use pbgi_format::{LOBES_MAX, Lobe, SurfelLayout};
use pbgi_math::{Vec3, box_silhouette, luminance, sphere_sin2_for_solid_angle};

/// How large a node may be to be taken as one.
pub trait Threshold {
    /// Largest `r²/d²` (squared sine of the half-angle) of the bounding sphere of a node that is taken as one, below 1.
    /// `to_center` leads from the receiver to the sphere's center, `distance2` is its squared
    /// length, `radius2` the sphere's squared radius.
    fn sin2_max(&self, to_center: Vec3, distance2: f32, radius2: f32) -> f32;
}

/// The same largest solid angle in every direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UniformThreshold {
    sin2_max: f32,
}

impl UniformThreshold {
    /// Nodes whose bounding sphere subtends at most `solid_angle_sr` are taken as one; 0 goes down
    /// to the surfels.
    #[must_use]
    pub fn new(solid_angle_sr: f32) -> Self {
        // At 1, receivers inside the bounding sphere would be let through.
        Self { sin2_max: sphere_sin2_for_solid_angle(solid_angle_sr).min(0.9) }
    }
}

impl Threshold for UniformThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: Vec3, _: f32, _: f32) -> f32 {
        self.sin2_max
    }
}

/// What a node shows to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cluster {
    /// Smallest corner of the node's box, relative to the receiver.
    pub low: Vec3,
    /// Largest corner.
    pub high: Vec3,
    /// Area of the box's silhouette, seen in parallel from the receiver's direction.
    pub silhouette: f32,
    /// Share of the silhouette that surfaces facing the receiver cover.
    pub front: f32,
    /// Share that surfaces turned away cover, where they block.
    pub back: f32,
    /// Whether most of what it shows is the surface of solid things rather than sheets.
    pub solid: bool,
    /// Mean radiance of the facing surfaces: `I(d)/A(d)`.
    pub radiance: [f32; 3],
    /// Distance of the bounding sphere's nearest point.
    pub near: f32,
    /// Distance of its farthest point.
    pub far: f32,
}

/// Largest `h/|V|` of a lobe that counts as flat.
const FLAT_WIDTH: f32 = 0.2;

impl Cluster {
    /// Evaluates a node's lobes toward the receiver.
    ///
    /// Opaque surfaces enclose things: the areas their fronts show do not overlap, and add up. Sheets (front-only surfels back to
    /// back: leaves, cloth) do overlap, unless they are one flat piece: only the largest flat lobe is
    /// taken as it is and the rest hides itself as a cloud of random pieces does, covering `1 − e^−τ`
    /// where its area is `τ` times the box's silhouette.
    #[inline(always)]
    pub(crate) fn from_lobes(low: Vec3, high: Vec3, lobes: &[u8], layout: &SurfelLayout) -> Self {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let distance = center.length();
        let toward_receiver = center * (-1.0 / distance);
        let mut sum = LobeSums::default();
        for stored in lobes.chunks_exact(Lobe::stored_bytes(layout.channels)) {
            let lobe = Lobe::read(stored, layout.channels, layout.area, layout.radiance_scale);
            sum.add(&lobe, toward_receiver);
        }
        let shown = sum.solid + sum.sheets;
        let silhouette = box_silhouette(half, toward_receiver);
        let radius = half.length();
        let mut cluster = Self {
            low,
            high,
            silhouette,
            solid: sum.solid + sum.back >= sum.sheets,
            radiance: sum.visible_radiance(silhouette),
            near: distance - radius,
            far: distance + radius,
            ..Self::default()
        };
        let silhouette = cluster.silhouette.max(1e-30);
        let mut front = shown;
        if sum.sheets > sum.flat_sheet {
            let first = (sum.solid + sum.flat_sheet).min(silhouette);
            let hidden = (-(sum.sheets - sum.flat_sheet) / silhouette).exp();
            front = first + (silhouette - first) * (1.0 - hidden);
        }
        cluster.front = (front / silhouette).min(1.0);
        cluster.back = (sum.back / silhouette).min(1.0);
        cluster
    }
}

/// Sums over a node's lobes, seen from one direction.
#[derive(Default)]
struct LobeSums {
    /// Front area of lobes that block both sides, and of sheets.
    solid: f32,
    sheets: f32,
    back: f32,
    /// Front area and radiance of each lobe.
    fronts: [(f32, [f32; 3]); LOBES_MAX],
    count: usize,
    /// Largest front area of a flat sheet.
    flat_sheet: f32,
}

impl LobeSums {
    #[inline(always)]
    fn add(&mut self, lobe: &Lobe, toward_receiver: Vec3) {
        let front = lobe.front_area(toward_receiver);
        let back = lobe.back_area(toward_receiver);
        if lobe.blocks_back {
            self.solid += front;
        } else {
            self.sheets += front;
            if lobe.width * lobe.width < FLAT_WIDTH * FLAT_WIDTH * lobe.vector.length_squared() {
                self.flat_sheet = self.flat_sheet.max(front);
            }
        }
        self.back += back;
        if self.count < LOBES_MAX {
            self.fronts[self.count] = (front, lobe.radiance);
            self.count += 1;
        }
    }

    /// Mean radiance of what can be seen of the lobes: where their areas exceed the silhouette some hide others, and
    /// what shines is taken to be in front. A lamp before a wall keeps its flux.
    #[inline(always)]
    fn visible_radiance(&mut self, silhouette: f32) -> [f32; 3] {
        let fronts = &mut self.fronts[..self.count];
        if fronts.len() > 1 && self.solid + self.sheets > silhouette {
            fronts.sort_unstable_by(|a, b| luminance(b.1).total_cmp(&luminance(a.1)));
        }
        let (mut rest, mut seen, mut intensity) = (silhouette, 0.0, [0.0; 3]);
        for (area, radiance) in fronts.iter() {
            let area = area.min(rest);
            rest -= area;
            seen += area;
            for (sum, l) in intensity.iter_mut().zip(radiance) {
                *sum += area * l;
            }
        }
        let inverse = if seen > 0.0 { 1.0 / seen } else { 0.0 };
        intensity.map(|i| i * inverse)
    }
}
