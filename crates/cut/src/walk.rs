//! The walk: depth first, children front to back.

use crate::cluster::Cluster;
use crate::group::Boxes;
use crate::known::{Below, GroupIndex, NodeReader};
use crate::leaf::take_leaf;
use crate::metric::Threshold;
use crate::node::{NodePlace, Viewpoint};
use crate::stats::CutStats;
use crate::surfel::CutSurfel;
use pbgi_format::CHILDREN_MAX;
use pbgi_math::Vec3;
use pbgi_store::StoreError;

/// The place a cut is picked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutReceiver {
    pub(crate) view: Viewpoint,
    /// Surfels that rise no more than this above the receiver's plane, in units of their radius, are its own surface.
    pub(crate) surfel_bias: f32,
}

impl CutReceiver {
    /// A receiver with a unit `normal` on a surface whose own is `plane`; disks that rise no more than `surfel_bias` of their radius above it
    /// are its own surface. The position is relative to the file's origin.
    #[must_use]
    #[inline(always)]
    pub fn new(position: Vec3, normal: Vec3, plane: Vec3, surfel_bias: f32) -> Self {
        Self { view: Viewpoint { position, normal, plane }, surfel_bias }
    }

    /// The same receiver, if it lies on no disks.
    #[must_use]
    pub fn on_no_disks(self) -> Self {
        Self { surfel_bias: 0.0, ..self }
    }

    /// Unit normal of the surface it lies on.
    #[must_use]
    #[inline(always)]
    pub fn plane(&self) -> Vec3 {
        self.view.plane
    }

    /// Unit normal it is shaded with.
    #[must_use]
    #[inline(always)]
    pub fn normal(&self) -> Vec3 {
        self.view.normal
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
    /// Points of it nearer than this are not there.
    pub distance_min: f32,
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
pub type Kept = u32;

/// Nothing is kept of a box.
pub const NOTHING_KEPT: Kept = u32::MAX;

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
    /// Where its octants meet, and whether a group beside or above it has them meet there, too: its surfels share a Morton code, and its
    /// children are parts of a list, not of space.
    split: Vec3,
    is_list: bool,
    /// Of a list, the first child that was descended into.
    first: Option<u8>,
    /// Boxes around what is drawn of the children, by index, relative to the receiver, and what the visitor keeps of them.
    boxes: Boxes,
    kept: [Kept; CHILDREN_MAX],
}

/// Memory of a walk, reused from receiver to receiver.
#[derive(Default)]
pub struct CutScratch {
    frames: Vec<Frame>,
    pub(crate) order: Vec<u64>,
    cluster: Cluster,
    /// Whether a disk was left out that belongs to the receiver's surface only if [`crate::lies_on_disks`] says so; who asks sets it back.
    pub doubts_own_surface: bool,
}

/// Walks the octree, octants front to back, and gives the visitor every node or surfel of the cut.
///
/// In order, for each node: wholly below the receiver's horizon, it is dropped; all it could touch opaque, it is dropped with everything
/// below it, whose pages are never read; small enough for `threshold`, it is taken as one; a leaf
/// gives its surfels, nearest first; else the walk descends. Of surfels that share a Morton code, more than a leaf holds, those that look
/// like others of them are behind these, and dropped with everything below. Seen from any point, an octant whose
/// index differs from the receiver's own octant in fewer planes is never behind one that differs in
/// those and more: visiting `step XOR own` in ascending `step` is front to back. What
/// lies in damaged pages that are skipped counts as nothing; the root's page is never skipped.
///
/// # Errors
///
/// If a page cannot be read or contradicts itself.
#[inline(always)]
pub fn pick_cut<V: CutVisitor, T: Threshold>(
    nodes: &mut NodeReader<'_>,
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    let mut walk = Walk { nodes, receiver, threshold, visitor, scratch, stats };
    walk.scratch.frames.clear();
    let root = walk.nodes.root(walk.stats)?;
    walk.enter(root);
    walk.go()
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

impl<V: CutVisitor, T: Threshold> Walk<'_, '_, V, T> {
    /// Goes on with the children of a group.
    #[inline(always)]
    fn enter(&mut self, at: GroupIndex) {
        self.stats.opened += 1;
        let group = self.nodes.group(at);
        let view = &self.receiver.view;
        let seen = group.see(view, self.threshold, self.stats);
        let flip = view.position.cmpgt(group.split).bitmask() as u8;
        let (place, wanted) = (group.place, group.octants & !seen.below);
        let (large, boxes, kept) = (seen.large, seen.boxes, self.visitor.look_at(&seen.boxes));
        let split = group.split;
        let mut is_list = false;
        if let Some(above) = self.scratch.frames.last_mut() {
            is_list = above.split == split;
            above.is_list |= is_list;
        }
        let first = None;
        let frame = Frame {
            place,
            group: at,
            step: 0,
            wanted,
            large,
            flip,
            split,
            is_list,
            first,
            boxes,
            kept,
        };
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
            let (group, is_large) = (frame.group, frame.large & bit != 0);
            let index = self.nodes.group(group).index(octant);
            let ([low, high], kept) = (frame.boxes.get(index), frame.kept[index]);
            if !self.visitor.is_open(low, high, kept) {
                self.stats.culled_opaque += 1;
            } else if is_large {
                if frame.is_list
                    && let Some(first) = frame.first
                    && self.nodes.look_alike(group, [first, octant], self.stats)?
                {
                    self.stats.culled_opaque += 1;
                    continue;
                }
                frame.first.get_or_insert(octant);
                self.descend(group, octant)?;
            } else {
                self.take_as_one(group, octant)?;
            }
        }
    }

    /// Takes the node of an octant as one.
    #[inline(always)]
    fn take_as_one(&mut self, group: GroupIndex, octant: u8) -> Result<(), StoreError> {
        let known = self.nodes.group(group);
        let (index, seed) = (known.index(octant), known.place.seed(octant));
        let (bounds, position) = (known.bounds(index), self.receiver.view.position);
        let lobes = self.nodes.lobes(group, index, self.stats)?;
        let (low, high) = (bounds.min - position, bounds.max - position);
        let cluster = &mut self.scratch.cluster;
        cluster.see([low, high], lobes, seed, position);
        self.visitor.take_cluster(cluster);
        self.stats.clusters += 1;
        Ok(())
    }

    /// Takes the surfels of a leaf in an octant, or goes on with the children of its node.
    #[inline(always)]
    fn descend(&mut self, group: GroupIndex, octant: u8) -> Result<(), StoreError> {
        match self.nodes.below(group, octant, self.stats)? {
            Some(Below::Group(child)) => self.enter(child),
            Some(Below::Leaf(leaf)) => {
                let Self { nodes, receiver, visitor, scratch, stats, .. } = self;
                take_leaf(nodes, leaf, receiver, *visitor, scratch, stats);
            }
            // Nothing is behind what is missing.
            None => {
                if let Some(frame) = self.scratch.frames.last_mut() {
                    frame.first = frame.first.filter(|first| *first != octant);
                }
            }
        }
        Ok(())
    }
}
