//! Surfels of a leaf, nearest first.

use crate::group::Boxes;
use crate::known::{KnownLeaf, NodeReader};
use crate::own_surface::{is_own_surface, least_distance};
use crate::stats::CutStats;
use crate::walk::{CutReceiver, CutScratch, CutVisitor, SurfelSeen};
use pbgi_format::CHILDREN_MAX;

/// Gives the visitor the surfels of a leaf that the receiver may see.
#[inline(always)]
pub(crate) fn take_leaf<V: CutVisitor>(
    nodes: &NodeReader<'_>,
    leaf: KnownLeaf,
    receiver: &CutReceiver,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) {
    stats.opened += 1;
    let (centers, surfels) = nodes.surfels(leaf);
    let CutScratch { order, doubts_own_surface, .. } = scratch;
    let position = receiver.view.position;
    order.clear();
    for (index, center) in centers.iter().enumerate() {
        let distance2 = (*center - position).length_squared();
        // Numbers above 0 are ordered as their bits are; ties by place in the file, so that the order is total.
        order.push(u64::from(distance2.to_bits()) << 32 | index as u64);
    }
    if visitor.minds_order() {
        order.sort_unstable();
    }
    for eight in order.chunks(CHILDREN_MAX) {
        let mut boxes = Boxes::default();
        for (lane, key) in eight.iter().enumerate() {
            let index = *key as u32 as usize;
            let ([low, high], center) = (surfels[index].reach, centers[index] - position);
            boxes.set(lane, center + low, center + high);
        }
        let kept = visitor.look_at(&boxes);
        for (key, kept) in eight.iter().zip(kept) {
            let (distance2, index) = (f32::from_bits((key >> 32) as u32), *key as u32);
            let surfel = &surfels[index as usize];
            let center = centers[index as usize] - position;
            if distance2 == 0.0 || is_own_surface(surfel, center, receiver, doubts_own_surface) {
                continue;
            }
            let (seed, distance_min) = (leaf.seed(index), least_distance(surfel, center, receiver));
            let seen = SurfelSeen { surfel, center, seed, distance2, distance_min, kept };
            visitor.take_surfel(&seen);
            stats.surfels += 1;
        }
    }
}
