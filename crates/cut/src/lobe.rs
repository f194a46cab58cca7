//! A lobe of a node: what of it does not depend on the receiver.

use pbgi_format::Lobe;
use pbgi_math::{Aabb, Stencil, Vec3, central_section_area, larger, stencil_axis, thick_half};

/// A lobe of a node: what of it does not depend on the receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KnownLobe {
    pub lobe: Lobe,
    pub is_flat: bool,
    /// See [`crate::Piece::bend`].
    pub bend: f32,
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

/// Largest fill of loose surfels, whose optical depth is finite: the middle of the last step of a fill.
const LOOSE_FILL_MAX: f32 = 1.0 - 0.5 / 127.0;

/// Fill from which on a sheet is one layer: with less, its parts lie above each other.
const SHEET_WHOLE: f32 = 0.95;

impl KnownLobe {
    /// A lobe of the node with this box.
    #[must_use]
    #[inline(always)]
    pub fn new(lobe: &Lobe, bounds: &Aabb) -> Self {
        let half = thick_half(bounds.min, bounds.max);
        let length = lobe.vector.length();
        let is_flat = lobe.is_flat();
        let bend = lobe.width / larger(length + lobe.width, f32::MIN_POSITIVE);
        let mut known = Self { lobe: *lobe, is_flat, bend, covered: 1.0, ..Self::default() };
        if !is_flat {
            // What is round lies anywhere in the box, unless it is a sheet.
            if !lobe.is_sheet() {
                known.lobe.stencil = Stencil::FULL;
            }
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
        } else if lobe.is_sheet() && lobe.fill < SHEET_WHOLE && lobe.width > 0.0 {
            known.covered = (share * central_section_area(half, normal) / length).min(1.0);
        }
        known
    }
}
