//! A lobe of a node: what of it does not depend on the receiver.

use pbgi_format::{LOBES_MAX, Lobe};
use pbgi_math::{Aabb, STENCIL_EDGE, Stencil, Vec3, central_section_area, stencil_axis};

/// A lobe of a node: what of it does not depend on the receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KnownLobe {
    pub lobe: Lobe,
    pub is_flat: bool,
    /// Of a flat one, which share of it lies where another flat one of its node does, by its number: in cells of both stencils, or where these are seen
    /// along different axes, in the box around the other.
    pub shares: [f32; LOBES_MAX],
    /// The normal of its plane and a point of it, relative to the file's origin.
    pub normal: Vec3,
    pub point: Vec3,
    pub axis: u8,
    /// Variances of the points it stands for along the axes, and their sum in its plane.
    pub variance: Vec3,
    pub spread2: f32,
    /// Of a flat loose one, the area of its outline in its plane, and its optical depth along its normal over the area that it shows so.
    pub outline: f32,
    pub depth_per_area: f32,
    /// Share of its area that a flat sheet covers: leaves above each other cover less than they have.
    pub covered: f32,
}

/// Largest `h/(|V| + h)` of a lobe of a solid thing that is drawn in its plane, where its stencil says; rounder ones are drawn facing the receiver.
/// A half sphere has 0.55. At 0.3 sr, the street has an error of 8.0 % with 0.25, of 2.9 % with 0.7 and the same with 1.
const SOLID_FLAT_WIDTH: f32 = 0.7;

/// The same for sheets, whose parts lie in no plane where their normals differ: leaves. 0.05 and 0.25 change errors by a tenth of themselves.
const SHEET_FLAT_WIDTH: f32 = 0.1;

/// Largest fill of loose surfels, whose optical depth is finite: the middle of the last step of a fill.
const LOOSE_FILL_MAX: f32 = 1.0 - 0.5 / 127.0;

/// Fill from which on a sheet is one layer: with less, its parts lie above each other.
const SHEET_WHOLE: f32 = 0.95;

/// Thickness of a flat box, as a share of its largest edge; known to the builder.
const THICKNESS: f32 = 1e-3;

/// Half the extents of a box, thick enough to be cut by planes.
#[inline(always)]
pub(crate) fn thick_half(low: Vec3, high: Vec3) -> Vec3 {
    let half = (high - low) * 0.5;
    half.max(Vec3::splat(THICKNESS * half.max_element()))
}

/// Box around what a stencil of a box leaves of a plane.
fn outline_bounds(normal: Vec3, point: Vec3, stencil: Stencil, around: &Aabb) -> Aabb {
    let axis = stencil_axis(normal);
    let mut found = *around;
    let (mut height, mut reach) = (point[axis], 0.0);
    for ([first, end], across) in stencil.bounds().into_iter().zip([(axis + 1) % 3, (axis + 2) % 3])
    {
        let cell = (around.max[across] - around.min[across]) * (1.0 / STENCIL_EDGE as f32);
        let [low, high] = [first, end].map(|i| around.min[across] + cell * i as f32);
        (found.min[across], found.max[across]) = (low, high);
        let slope = normal[across] / normal[axis];
        height -= slope * (0.5 * (low + high) - point[across]);
        reach += 0.5 * slope.abs() * (high - low);
    }
    found.min[axis] = found.min[axis].max(height - reach);
    found.max[axis] = found.max[axis].min(height + reach);
    found
}

/// Share of a box that lies in another, 0..=1; of what is thin along an axis as of what is thick.
fn share_of_box(own: &Aabb, other: &Aabb) -> f32 {
    let common = own.max.min(other.max) - own.min.max(other.min);
    let least = THICKNESS * own.extent().max_element();
    let share = (common + least) / (own.extent() + least);
    share.clamp(Vec3::ZERO, Vec3::ONE).element_product()
}

/// Finds [`KnownLobe::shares`] of the lobes of the node with this box.
pub(crate) fn find_shares(lobes: &mut [KnownLobe], bounds: &Aabb) {
    if lobes.len() < 2 {
        return;
    }
    let boxes: Vec<Aabb> = lobes
        .iter()
        .map(|known| outline_bounds(known.normal, known.point, known.lobe.stencil, bounds))
        .collect();
    let is_flat = |index: &usize| lobes[*index].is_flat;
    let flat: Vec<usize> = (0..lobes.len()).filter(is_flat).collect();
    for &own in &flat {
        for &other in &flat {
            lobes[own].shares[other] = match lobes[own].axis == lobes[other].axis {
                true => lobes[own].lobe.stencil.share_in(lobes[other].lobe.stencil),
                false => share_of_box(&boxes[own], &boxes[other]),
            };
        }
    }
}

impl KnownLobe {
    /// Whether all of its surfels lie one way, a board or a pane: nothing in it is behind anything else of it.
    #[inline(always)]
    pub fn is_board(&self) -> bool {
        self.is_flat && self.lobe.width == 0.0
    }

    /// A lobe of the node with this box.
    #[must_use]
    #[inline(always)]
    pub fn new(lobe: &Lobe, bounds: &Aabb) -> Self {
        let half = thick_half(bounds.min, bounds.max);
        let length = lobe.vector.length();
        let is_solid = lobe.blocks_back && !lobe.is_loose;
        let flat_width = if is_solid { SOLID_FLAT_WIDTH } else { SHEET_FLAT_WIDTH };
        let is_flat = lobe.width <= flat_width * (length + lobe.width);
        let mut known = Self {
            lobe: *lobe,
            is_flat,
            covered: 1.0,
            shares: [1.0; LOBES_MAX],
            ..Self::default()
        };
        if !is_flat {
            known.lobe.stencil = Stencil::FULL;
            return known;
        }
        let normal = lobe.vector * (1.0 / length);
        let share = lobe.fill * lobe.stencil.share();
        known.normal = normal;
        known.axis = stencil_axis(normal) as u8;
        known.point = bounds.center() + normal * (lobe.height * normal.abs().dot(half));
        // Points spread evenly over the box's section with the plane: those over the box, laid into it.
        known.variance = half * half * (share * (1.0 / 3.0));
        known.spread2 = known.variance.dot(Vec3::ONE - normal * normal);
        if lobe.is_loose {
            let (axis, edges) = (usize::from(known.axis), half * 2.0);
            let face = edges[(axis + 1) % 3] * edges[(axis + 2) % 3];
            known.outline = face * lobe.stencil.share() / normal[axis].abs();
            let shown = lobe.front_area(normal) + lobe.back_area(normal);
            known.depth_per_area = -(1.0 - lobe.fill.min(LOOSE_FILL_MAX)).ln() / shown;
        } else if !lobe.blocks_back && lobe.fill < SHEET_WHOLE && !known.is_board() {
            known.covered = (share * central_section_area(half, normal) / length).min(1.0);
        }
        known
    }
}
