//! Which nodes are far from a block of receivers, and which are near: what is far looks alike to all of them.

use crate::metric::{NodeSeen, Threshold};
use crate::node::{
    Group, Limits, NodeRef, Viewpoint, child_index, distance, follow_link, pin_sound_page,
    view_group,
};
use crate::stats::CutStats;
use crate::walk::{CutReceiver, WalkFrom, root_place};
use pbgi_format::CHILDREN_MAX;
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{Reader, StoreError};

/// How far from a block a node must be to be far.
pub trait Separation {
    /// Least distance between the boxes of block and node, for a node as seen from the middle of the block.
    fn distance_min(&self, node: &NodeSeen) -> f32;
}

/// Share of the separating distance that the radius of a near node may have: larger ones are opened, so that little that is far counts as near.
const NEAR_RADIUS: f32 = 0.2;

/// Near leaves up to which receivers have little left to draw.
const NEAR_FEW: usize = 4;

/// A threshold for groups that are opened to be divided: nothing is dropped but what is below the horizon.
struct Undecided;

impl Threshold for Undecided {
    const ASKS_PLANES: bool = true;
    const ASKS_BRIGHTNESS: bool = true;

    #[inline(always)]
    fn sin2_max(&self, _: &NodeSeen) -> f32 {
        0.0
    }
}

/// Nodes of a block, by distance; memory is reused.
#[derive(Clone, Debug, Default)]
pub struct Division {
    /// Nodes that are far for all receivers of the block.
    pub far: Vec<NodeRef>,
    /// All others, and of the far ones those nearer than the `overlap` on top of their separation: seen from receivers and from the places that
    /// stand for them, edges differ by so much, and no gap must open between near and far.
    pub near: Vec<NodeRef>,
    stack: Vec<NodeRef>,
}

impl Division {
    /// Divides what is below `from` for a block: `middle` stands for its receivers, which lie in `around`. What is below all their horizons is left
    /// out.
    ///
    /// # Errors
    ///
    /// If a page cannot be read or contradicts itself.
    #[expect(clippy::too_many_arguments, reason = "the state of one walk")]
    pub fn divide<S: Separation>(
        &mut self,
        reader: &mut Reader<'_>,
        from: WalkFrom<'_>,
        middle: &CutReceiver,
        around: &Aabb,
        overlap: f32,
        separation: &S,
        stats: &mut CutStats,
    ) -> Result<(), StoreError> {
        self.far.clear();
        self.near.clear();
        self.stack.clear();
        let view = &middle.view;
        let layout = reader.octree().layout();
        match from {
            WalkFrom::Root => {
                let place = root_place(reader, stats)?;
                let group = Group::open(reader, place, view, &Undecided, &layout, stats)?;
                self.push_children(&group, 1, view);
            }
            WalkFrom::Nodes(nodes, _) => {
                let is_seen = |node: &&NodeRef| is_above(view, node);
                self.stack.extend(nodes.iter().filter(is_seen));
            }
        }
        while let Some(node) = self.stack.pop() {
            let position = view.position;
            let (low, high) = (node.bounds.min - position, node.bounds.max - position);
            let seen = view.see(low, high, node.is_plane, node.brightness);
            let least = separation.distance_min(&seen);
            let apart = distance(&node.bounds, around);
            let outer_within = node.limits.within;
            if apart >= least + overlap {
                self.far.push(NodeRef { limits: Limits { outer_within, ..Limits::NONE }, ..node });
                continue;
            }
            let is_small = seen.radius2 <= (NEAR_RADIUS * least).powi(2);
            if node.is_leaf || is_small {
                let near = Limits { within: least + overlap, ..Limits::NONE };
                self.near.push(NodeRef { limits: near, ..node });
                // Of a leaf, those surfels are far that are so by themselves.
                let beyond = if node.is_leaf { least } else { 0.0 };
                if apart >= least || (node.is_leaf && farthest(&node.bounds, around) > least) {
                    let far = Limits { beyond, outer_within, ..Limits::NONE };
                    self.far.push(NodeRef { limits: far, ..node });
                }
                continue;
            }
            let level = usize::from(node.level);
            let Some(page) = pin_sound_page(reader, node.page, level - 1, stats)? else { continue };
            let (view_page, group) =
                view_group(reader, &page, node.page, node.offset, layout.channels)?;
            let index = child_index(group.fields().octants, node.octant);
            let (from, link) = ((&page, node.page, &view_page), group.link(index, false));
            let Some(place) = follow_link(reader, from, link, level, stats)? else { continue };
            let group = Group::open(reader, place, view, &Undecided, &layout, stats)?;
            self.push_children(&group, level + 1, view);
        }
        Ok(())
    }

    /// Whether so little is near that dividing again gains nothing.
    #[must_use]
    pub fn has_few_near(&self) -> bool {
        self.near.len() <= NEAR_FEW && self.near.iter().all(|node| node.is_leaf)
    }

    fn push_children(&mut self, group: &Group, level: usize, view: &Viewpoint) {
        for octant in 0..CHILDREN_MAX as u8 {
            if group.octants & !group.below & (1 << octant) != 0 {
                self.stack.push(group.node(octant, level, view.position));
            }
        }
    }
}

#[inline(always)]
fn is_above(view: &Viewpoint, node: &NodeRef) -> bool {
    let (low, high) = (node.bounds.min - view.position, node.bounds.max - view.position);
    view.top(low, high) > 0.0
}

/// Largest distance of a point of a box from another box.
#[inline(always)]
fn farthest(a: &Aabb, b: &Aabb) -> f32 {
    (a.max - b.max).max(b.min - a.min).max(Vec3::ZERO).length()
}
