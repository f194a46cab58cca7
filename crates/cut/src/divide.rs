//! Which nodes are far from a block of receivers, and which are near: what is far looks alike to all of them.

use crate::known::{KnownGroup, NodeReader};
use crate::metric::NodeSeen;
use crate::node::{Limits, NodeRef, Viewpoint, distance};
use crate::stats::CutStats;
use crate::walk::{CutReceiver, WalkFrom};
use pbgi_format::CHILDREN_MAX;
use pbgi_math::{Aabb, Vec3};
use pbgi_store::StoreError;

/// How far from a block a node must be to be far.
pub trait Separation {
    /// Least distance between the boxes of block and node, for a node as seen from the middle of the block.
    fn distance_min(&self, node: &NodeSeen) -> f32;
}

/// Share of the separating distance that the radius of a near node may have: larger ones are opened, so that little that is far counts as near.
const NEAR_RADIUS: f32 = 0.2;

/// Near leaves up to which receivers have little left to draw.
const NEAR_FEW: usize = 4;

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
        nodes: &mut NodeReader<'_>,
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
        match from {
            WalkFrom::Root => {
                let root = nodes.root(stats)?;
                self.push_children(nodes.group(root), view, stats);
            }
            WalkFrom::Nodes(nodes, _) => {
                let is_seen = |node: &&NodeRef| is_above(view, node);
                self.stack.extend(nodes.iter().filter(is_seen));
            }
        }
        while let Some(node) = self.stack.pop() {
            nodes.trim();
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
            let Some(group) = nodes.group_at(node.group, stats)? else { continue };
            let index = nodes.group(group).index(node.octant);
            if let Some(child) = nodes.child(group, index, stats)? {
                self.push_children(nodes.group(child), view, stats);
            }
        }
        Ok(())
    }

    /// Whether so little is near that dividing again gains nothing.
    #[must_use]
    pub fn has_few_near(&self) -> bool {
        self.near.len() <= NEAR_FEW && self.near.iter().all(|node| node.is_leaf)
    }

    /// Puts what of a group is not below all horizons on the stack.
    fn push_children(&mut self, group: &KnownGroup, view: &Viewpoint, stats: &mut CutStats) {
        let before = self.stack.len();
        for octant in (0..CHILDREN_MAX as u8).filter(|octant| group.octants >> octant & 1 != 0) {
            let node = group.node(octant);
            if is_above(view, &node) {
                self.stack.push(node);
            }
        }
        stats.nodes_visited += group.count() as u64;
        stats.culled_horizon += (group.count() + before - self.stack.len()) as u64;
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
