//! What of the surfels next to a receiver is its own surface, which it does not see.

use crate::surfel::{CutSurfel, SurfelShape};
use crate::walk::CutReceiver;
use pbgi_math::Vec3;

/// Share of its radius by which a rectangle or triangle that looks the same way as the receiver's surface must rise above the plane of that to hide
/// anything: so far do neighbors on a curved surface.
const ALIKE_BIAS: f32 = 0.05;

/// Cosine of the angle between normals above which a near disk may be a piece of the receiver's own curved surface.
pub const OWN_SURFACE_COSINE: f32 = 0.7;

/// Cosine of the angle by which neighboring pieces of one sheet may be folded.
const FOLD_COSINE: f32 = 0.5;

/// Share of its radius by which a disk that faces the receiver must rise above its plane.
const FACING_BIAS: f32 = 0.05;

/// How far a surfel reaches over its center along a unit vector; no farther than its radius.
#[inline(always)]
fn reach_along(surfel: &CutSurfel, direction: Vec3) -> f32 {
    if surfel.isotropic {
        return surfel.radius;
    }
    match &surfel.shape {
        SurfelShape::Triangle { corners: [a, b, c] } => {
            a.dot(direction).max(b.dot(direction)).max(c.dot(direction))
        }
        SurfelShape::Rectangle { edges: [u, v], half: [a, b] } => {
            a * u.dot(direction).abs() + b * v.dot(direction).abs()
        }
        SurfelShape::Disk { .. } => {
            // r sin(angle between the normals).
            let tilt = surfel.normal.dot(direction);
            surfel.radius * (1.0 - tilt * tilt).max(0.0).sqrt()
        }
    }
}

/// Whether a surfel, with its center relative to the receiver, is below the horizon or belongs to the surface the receiver lies on.
///
/// A rectangle or triangle is where it is: it is seen if any of it rises above the plane of the receiver's surface, which is that of its geometric
/// normal, by more than codes are off by, and above the horizon of its shading normal. Disks reach over what they stand for, and keep a distance.
#[inline(always)]
pub(crate) fn is_own_surface(surfel: &CutSurfel, center: Vec3, receiver: &CutReceiver) -> bool {
    let plane = receiver.view.plane;
    let height = center.dot(plane);
    // Most are well above.
    if height > surfel.radius + 2.0 * surfel.rounding
        && height > receiver.surfel_bias * surfel.radius
    {
        return false;
    }
    if !matches!(surfel.shape, SurfelShape::Disk { .. }) {
        // What looks another way is no neighbor on a curved surface: it hides if it rises by more than rounding explains, its own and that of a
        // receiver that was such a surfel itself.
        let is_alike = surfel.normal.dot(plane) > 0.0;
        let rounding = 2.0 * surfel.rounding + surfel.outline_error(plane);
        let bound = if is_alike { rounding.max(ALIKE_BIAS * surfel.radius) } else { rounding };
        return height + reach_along(surfel, plane) <= bound;
    }
    let tilt = surfel.normal.dot(plane);
    // A surface does not face its own front: what does hangs over the receiver, however low.
    let is_facing = !surfel.isotropic && tilt < 0.0;
    let share =
        if is_facing { FACING_BIAS.min(receiver.surfel_bias) } else { receiver.surfel_bias };
    let least = share * surfel.radius;
    if height <= least && height + reach_along(surfel, plane) <= least {
        return true;
    }
    // Disks reach over the edges of their surface. Where one of a solid thing is seen from behind and has
    // its middle below the tangent plane, the receiver's own surface lies before it.
    // Where one of a sheet's other side is seen from its front, a fold of the receiver's own sheet does.
    let depth = center.dot(surfel.normal);
    let is_fold = surfel.front_only && tilt < -FOLD_COSINE;
    let is_behind = !surfel.front_only && depth > 0.0;
    height <= 0.0 && !surfel.isotropic && (is_fold || is_behind)
}
