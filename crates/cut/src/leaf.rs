//! Surfels of a leaf, nearest first.

use crate::node::{Limits, bad_link, node_seed, pin_sound_page};
use crate::own_surface::is_own_surface;
use crate::stats::CutStats;
use crate::walk::{CutReceiver, CutVisitor, SurfelSeen};
use pbgi_format::{PageId, SurfelLayout, SurfelPage};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{Reader, StoreError};

/// A leaf to be opened.
pub(crate) struct Leaf<'b> {
    pub page: Option<PageId>,
    /// First byte, and surfels.
    pub place: (u32, u32),
    /// Box of its positions.
    pub frame: Aabb,
    /// The page that links to it.
    pub owner: PageId,
    /// Its level.
    pub level: usize,
    /// Which of its surfels count, if not all.
    pub limits: Option<(&'b Limits, [&'b Aabb; 2])>,
}

/// Gives the visitor the surfels of a leaf that the receiver may see.
#[inline(always)]
pub(crate) fn take_leaf<V: CutVisitor>(
    reader: &mut Reader<'_>,
    leaf: &Leaf<'_>,
    receiver: &CutReceiver,
    visitor: &mut V,
    order: &mut Vec<(f32, u32)>,
    layout: &SurfelLayout,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    let Some(id) = leaf.page else {
        return Err(reader.invalid_page(leaf.owner, bad_link("leaf: surfel page", u32::MAX)));
    };
    let Some(page) = pin_sound_page(reader, id, leaf.level, stats)? else { return Ok(()) };
    let surfels =
        SurfelPage::new(page.bytes()).and_then(|page| page.leaf(leaf.place, &leaf.frame, layout));
    let surfels = match surfels {
        Ok(surfels) => surfels,
        Err(error) => return Err(reader.invalid_page(id, error)),
    };
    let position = receiver.view.position;
    order.clear();
    for index in 0..surfels.count() {
        let center = surfels.center(index);
        if leaf.limits.is_none_or(|(limits, boxes)| limits.hold(center, boxes)) {
            order.push(((center - position).length_squared(), index));
        }
    }
    // Ties by place in the file, so that the order is total.
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for &(distance2, index) in order.iter() {
        let mut surfel = surfels.surfel(index);
        surfel.center -= position;
        let is_hidden = if receiver.is_one {
            is_own_surface(&surfel, receiver)
        } else {
            // Far from all receivers there is no own surface, but what lies below the horizon.
            let reach = Vec3::splat(surfel.radius);
            receiver.view.top(surfel.center - reach, surfel.center + reach) <= 0.0
        };
        if distance2 == 0.0 || is_hidden {
            continue;
        }
        let seed = node_seed(id, leaf.place.0 + (index << 24), 0);
        visitor.take_surfel(&SurfelSeen { surfel, seed, distance2 });
        stats.surfels += 1;
    }
    Ok(())
}
