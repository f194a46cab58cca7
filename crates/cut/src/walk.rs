//! The walk: depth first, children front to back.

use crate::cluster::Cluster;
use crate::known::{Boxes, CutSurfel, GroupIndex, NodeReader, open_margin};
use crate::leaf::take_leaf;
use crate::metric::Threshold;
use crate::node::{Limits, NodePlace, NodeRef, Normals, Viewpoint, judge};
use crate::stats::CutStats;
use pbgi_format::CHILDREN_MAX;
use pbgi_math::{Aabb, Vec3};
use pbgi_store::StoreError;

/// The place a cut is picked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutReceiver {
    pub(crate) view: Viewpoint,
    /// Unit normal of the surface it lies on.
    pub(crate) plane: Vec3,
    /// Surfels that rise no more than this above the receiver's plane, in units of their radius, are its own surface.
    pub(crate) surfel_bias: f32,
    /// Whether it stands for itself alone.
    pub(crate) is_one: bool,
}

impl CutReceiver {
    /// A receiver with a unit `normal` on a surface whose own is `plane`; disks that rise no more than `surfel_bias` of their radius above it
    /// are its own surface. The position is relative to the file's origin.
    #[must_use]
    #[inline(always)]
    pub fn new(position: Vec3, normal: Vec3, plane: Vec3, surfel_bias: f32) -> Self {
        let view = Viewpoint {
            position,
            reach: Aabb { min: Vec3::ZERO, max: Vec3::ZERO },
            normals: Normals::one(normal),
            planes: Normals::one(plane),
        };
        Self { view, plane, surfel_bias, is_one: true }
    }

    /// A place that stands for receivers in a box `around` it, with these normals.
    #[must_use]
    pub fn standing_for(position: Vec3, around: &Aabb, normals: Normals) -> Self {
        let reach = Aabb { min: around.min - position, max: around.max - position };
        let view = Viewpoint { position, reach, normals, planes: normals };
        Self { view, plane: Vec3::ZERO, surfel_bias: 0.0, is_one: false }
    }

    /// Unit normal of the surface it lies on; 0 for a place that stands for many.
    #[must_use]
    #[inline(always)]
    pub fn plane(&self) -> Vec3 {
        self.plane
    }

    /// Unit normal it is shaded with, of a receiver that stands for itself alone.
    #[must_use]
    #[inline(always)]
    pub fn normal(&self) -> Vec3 {
        self.view.normals.first()
    }

    /// Its position.
    #[must_use]
    #[inline(always)]
    pub fn position(&self) -> Vec3 {
        self.view.position
    }
}

/// A surfel of the cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfelSeen<'s> {
    /// The surfel.
    pub surfel: &'s CutSurfel,
    /// Its center, relative to the receiver.
    pub center: Vec3,
    /// Tells surfels apart.
    pub seed: u32,
    /// Squared distance of its center.
    pub distance2: f32,
    /// What the visitor has kept of its box.
    pub kept: Kept,
}

impl SurfelSeen<'_> {
    /// Corners of its box, relative to the receiver.
    #[must_use]
    #[inline(always)]
    pub fn bounds(&self) -> [Vec3; 2] {
        self.surfel.reach.map(|reach| self.center + reach)
    }
}

/// What a visitor keeps of a box from when it sees it among others to when it is asked about it.
pub type Kept = u64;

/// Nothing is kept of a box.
pub const NOTHING_KEPT: Kept = u64::MAX;

/// Receives a cut, nearest first.
pub trait CutVisitor {
    /// Looks at eight boxes at a time, relative to the receiver, that it will be asked about.
    #[inline(always)]
    fn look_at(&self, _: &Boxes) -> [Kept; CHILDREN_MAX] {
        [NOTHING_KEPT; CHILDREN_MAX]
    }
    /// Whether anything in the box `low..=high` (relative to the receiver), of which this was kept, could still be seen.
    fn is_open(&mut self, low: Vec3, high: Vec3, kept: Kept) -> bool;
    /// Takes a node as one, just after `is_open` was asked about its box.
    fn take_cluster(&mut self, cluster: &Cluster);
    /// Takes a surfel.
    fn take_surfel(&mut self, surfel: &SurfelSeen<'_>);
    /// Whether it makes a difference which of a leaf's surfels comes first.
    fn minds_order(&self) -> bool;
}

/// A group on the way from where the walk began to where it is.
struct Frame {
    place: NodePlace,
    group: GroupIndex,
    step: u8,
    /// Octants with a child that is looked at, and those whose child is too large to be taken as one.
    wanted: u8,
    large: u8,
    /// Octant order, front to back, is `step ^ flip`.
    flip: u8,
    /// Boxes around what is drawn of the children, by index, relative to the receiver, and what the visitor keeps of them.
    boxes: Boxes,
    kept: [Kept; CHILDREN_MAX],
}

/// Memory of a walk, reused from receiver to receiver.
#[derive(Default)]
pub struct CutScratch {
    frames: Vec<Frame>,
    order: Vec<u64>,
    nodes: Vec<(f32, u32)>,
}

/// Where a walk begins.
#[derive(Clone, Copy, Debug)]
pub enum WalkFrom<'n> {
    /// At the root of the file.
    Root,
    /// At these nodes, none of which is in another, for a block with this box in a block with the other.
    Nodes(&'n [NodeRef], [&'n Aabb; 2]),
}

/// Walks the octree, octants front to back, and gives the visitor every node or surfel of the cut.
///
/// In order, for each node: wholly below the receiver's horizon, it is dropped; all it could touch opaque, it is dropped with everything
/// below it, whose pages are never read; small enough for `threshold`, it is taken as one; a leaf
/// gives its surfels, nearest first; else the walk descends. Seen from any point, an octant whose
/// index differs from the receiver's own octant in fewer planes is never behind one that differs in
/// those and more: visiting `step XOR own` in ascending `step` is front to back. Nodes to begin at are taken by the distance of their boxes. What
/// lies in damaged pages that are skipped counts as nothing; the root's page is never skipped.
///
/// # Errors
///
/// If a page cannot be read or contradicts itself.
#[inline(always)]
pub fn pick_cut<V: CutVisitor, T: Threshold>(
    nodes: &mut NodeReader<'_>,
    from: WalkFrom<'_>,
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    let mut walk = Walk { nodes, receiver, threshold, visitor, scratch, stats };
    walk.scratch.frames.clear();
    match from {
        WalkFrom::Root => {
            let root = walk.nodes.root(walk.stats)?;
            walk.enter(root);
            walk.go()
        }
        WalkFrom::Nodes(nodes, boxes) => walk.go_from(nodes, boxes),
    }
}

/// What nodes are ordered by, nearest first: the distance of the nearest point of their box, and a little of that of its middle.
#[inline(always)]
fn nearness(low: Vec3, high: Vec3) -> f32 {
    let nearest = low.max(-high).max(Vec3::ZERO).length();
    nearest + 0.25 * ((low + high) * 0.5).length()
}

/// The state of a walk.
struct Walk<'w, 'a, V, T> {
    nodes: &'w mut NodeReader<'a>,
    receiver: &'w CutReceiver,
    threshold: &'w T,
    visitor: &'w mut V,
    scratch: &'w mut CutScratch,
    stats: &'w mut CutStats,
}

/// A child of a group that is not below the horizon.
struct Child<'n> {
    group: GroupIndex,
    place: NodePlace,
    octant: u8,
    is_large: bool,
    /// Which of its surfels count, if not all.
    limits: Option<(&'n Limits, [&'n Aabb; 2])>,
}

impl<V: CutVisitor, T: Threshold> Walk<'_, '_, V, T> {
    /// Goes on with the children of a group.
    #[inline(always)]
    fn enter(&mut self, at: GroupIndex) {
        let group = self.nodes.group(at);
        let view = &self.receiver.view;
        let seen = group.see(view, self.threshold, self.stats);
        let flip = view.position.cmpgt(group.split).bitmask() as u8;
        let (place, wanted) = (group.place, group.octants & !seen.below);
        let (large, boxes, kept) = (seen.large, seen.boxes, self.visitor.look_at(&seen.boxes));
        let frame = Frame { place, group: at, step: 0, wanted, large, flip, boxes, kept };
        self.scratch.frames.push(frame);
    }

    /// Walks until all groups on the way are done.
    #[inline(always)]
    fn go(&mut self) -> Result<(), StoreError> {
        loop {
            self.nodes.trim();
            let Some(frame) = self.scratch.frames.last_mut() else { return Ok(()) };
            if frame.step == CHILDREN_MAX as u8 {
                self.scratch.frames.pop();
                continue;
            }
            let octant = frame.step ^ frame.flip;
            frame.step += 1;
            let bit = 1u8 << octant;
            if frame.wanted & bit == 0 {
                continue;
            }
            if !self.nodes.refresh(&mut frame.group, frame.place, self.stats)? {
                // Its page has become unreadable since.
                self.scratch.frames.pop();
                continue;
            }
            let (group, place, is_large) = (frame.group, frame.place, frame.large & bit != 0);
            let index = self.nodes.group(group).index(octant);
            let ([low, high], kept) = (frame.boxes.get(index), frame.kept[index]);
            if !self.visitor.is_open(low, high, kept) {
                self.stats.culled_opaque += 1;
                continue;
            }
            self.take(&Child { group, place, octant, is_large, limits: None })?;
        }
    }

    /// Walks from nodes on, the nearest first.
    #[inline(always)]
    fn go_from(&mut self, nodes: &[NodeRef], boxes: [&Aabb; 2]) -> Result<(), StoreError> {
        // What is dropped is dropped before its page is asked for.
        let view = &self.receiver.view;
        let mut order = std::mem::take(&mut self.scratch.nodes);
        order.clear();
        for (index, node) in nodes.iter().enumerate() {
            let (low, high) = (node.bounds.min - view.position, node.bounds.max - view.position);
            if view.top(low, high) > 0.0 {
                order.push((nearness(low, high), index as u32));
            }
        }
        self.stats.culled_horizon += (nodes.len() - order.len()) as u64;
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let walked = order
            .iter()
            .try_for_each(|(_, index)| self.go_from_node(&nodes[*index as usize], boxes));
        self.scratch.nodes = order;
        walked
    }

    /// Walks from one node on.
    #[inline(always)]
    fn go_from_node(&mut self, node: &NodeRef, boxes: [&Aabb; 2]) -> Result<(), StoreError> {
        let view = &self.receiver.view;
        let (low, high) = (node.bounds.min - view.position, node.bounds.max - view.position);
        let seen = view.see(low, high, node.is_plane, node.brightness);
        let (is_dropped, is_large) = judge(&seen, self.threshold);
        self.stats.nodes_visited += 1;
        if is_dropped {
            return Ok(());
        }
        let edge = (high - low).max_element();
        let margin = match is_large {
            true => open_margin(node.cover_margin, edge),
            false => Cluster::REACH * edge,
        };
        if !self.visitor.is_open(low - margin, high + margin, NOTHING_KEPT) {
            self.stats.culled_opaque += 1;
            return Ok(());
        }
        let (place, octant) = (node.group, node.octant);
        let Some(group) = self.nodes.group_at(place, self.stats)? else { return Ok(()) };
        let limits = (node.limits != Limits::NONE).then_some((&node.limits, boxes));
        self.take(&Child { group, place, octant, is_large, limits })?;
        self.go()
    }

    /// Takes a node as one, or the surfels of a leaf, or goes on with its children.
    #[inline(always)]
    fn take(&mut self, child: &Child<'_>) -> Result<(), StoreError> {
        let &Child { group, place, octant, limits, .. } = child;
        let known = self.nodes.group(group);
        let (index, is_leaf) = (known.index(octant), known.leaves >> octant & 1 != 0);
        if !child.is_large {
            let (bounds, position) = (known.bounds(index), self.receiver.view.position);
            let lobes = self.nodes.lobes(group, index, self.stats)?;
            let seed = place.seed(octant);
            let (low, high) = (bounds.min - position, bounds.max - position);
            let cluster = Cluster::from_lobes(low, high, lobes, seed, position);
            self.visitor.take_cluster(&cluster);
            self.stats.clusters += 1;
        } else if is_leaf {
            if let Some(leaf) = self.nodes.leaf(group, index, self.stats)? {
                let Self { nodes, receiver, visitor, scratch, stats, .. } = self;
                take_leaf(nodes, leaf, limits, receiver, *visitor, &mut scratch.order, stats);
            }
        } else if let Some(child) = self.nodes.child(group, index, self.stats)? {
            self.enter(child);
        }
        Ok(())
    }
}
