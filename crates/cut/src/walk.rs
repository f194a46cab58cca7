//! The walk: depth first, children front to back.

use crate::cluster::Cluster;
use crate::leaf::{Leaf, take_leaf};
use crate::metric::Threshold;
use crate::node::{
    Group, GroupPlace, Limits, NodeRef, Normals, Viewpoint, child_index, follow_link, judge,
    node_seed, pin_sound_page, view_group,
};
use crate::stats::CutStats;
use pbgi_format::{CHILDREN_MAX, Channels, ChildLink, LeafSurfel, Lobe, PageId};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{PageRef, Reader, StoreError};

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

/// A surfel of the cut, relative to the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfelSeen {
    /// The surfel; its center is relative to the receiver.
    pub surfel: LeafSurfel,
    /// Tells surfels apart.
    pub seed: u32,
    /// Squared distance of its center.
    pub distance2: f32,
}

/// Receives a cut, nearest first.
pub trait CutVisitor {
    /// Whether anything in the box `low..=high` (relative to the receiver) could still be seen.
    fn is_open(&mut self, low: Vec3, high: Vec3) -> bool;
    /// Takes a node as one, just after `is_open` was asked about its box.
    fn take_cluster(&mut self, cluster: &Cluster);
    /// Takes a surfel.
    fn take_surfel(&mut self, surfel: &SurfelSeen);
}

/// How far near disks reach out of the box of their node at most, as a share of the box's largest edge.
const OVERHANG: f32 = 0.125;

/// A group on the way from where the walk began to where it is.
struct Frame {
    group: Group,
    step: u8,
    /// Its level, the root's is 1.
    level: usize,
}

/// Memory of a walk, reused from receiver to receiver.
#[derive(Default)]
pub struct CutScratch {
    frames: Vec<Frame>,
    order: Vec<(f32, u32)>,
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
    reader: &mut Reader<'_>,
    from: WalkFrom<'_>,
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    scratch.frames.clear();
    let (nodes, boxes) = match from {
        WalkFrom::Root => {
            let place = root_place(reader, stats)?;
            let layout = reader.octree().layout();
            let group = Group::open(reader, place, &receiver.view, threshold, &layout, stats)?;
            scratch.frames.push(Frame { group, step: 0, level: 1 });
            return walk(reader, receiver, threshold, visitor, scratch, stats);
        }
        WalkFrom::Nodes(nodes, boxes) => (nodes, boxes),
    };
    // What is dropped is dropped before its page is asked for.
    let position = receiver.view.position;
    let mut order = std::mem::take(&mut scratch.nodes);
    order.clear();
    for (index, node) in nodes.iter().enumerate() {
        let (low, high) = (node.bounds.min - position, node.bounds.max - position);
        if receiver.view.top(low, high) > 0.0 {
            order.push((nearness(low, high), index as u32));
        }
    }
    stats.culled_horizon += (nodes.len() - order.len()) as u64;
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut walked = Ok(());
    for &(_, index) in &order {
        walked = walk_node(
            reader,
            (&nodes[index as usize], boxes),
            receiver,
            threshold,
            visitor,
            scratch,
            stats,
        );
        if walked.is_err() {
            break;
        }
    }
    scratch.nodes = order;
    walked
}

/// What nodes are ordered by, nearest first: the distance of the nearest point of their box, and a little of that of its middle.
#[inline(always)]
fn nearness(low: Vec3, high: Vec3) -> f32 {
    let nearest = low.max(-high).max(Vec3::ZERO).length();
    nearest + 0.25 * ((low + high) * 0.5).length()
}

/// Page, number and offset of the root's group.
#[inline(always)]
pub(crate) fn root_place(
    reader: &mut Reader<'_>,
    stats: &mut CutStats,
) -> Result<GroupPlace, StoreError> {
    let header = *reader.octree().header();
    let before = reader.stats();
    let page = reader.pin_page(header.root_page)?;
    stats.levels[0].note(&before, &reader.stats());
    Ok((page, header.root_page, header.root_offset))
}

/// Walks from one node on.
#[inline(always)]
fn walk_node<V: CutVisitor, T: Threshold>(
    reader: &mut Reader<'_>,
    (node, boxes): (&NodeRef, [&Aabb; 2]),
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    let position = receiver.view.position;
    let (low, high) = (node.bounds.min - position, node.bounds.max - position);
    let seen = receiver.view.see(low, high, node.is_plane, node.brightness);
    let (is_dropped, is_large) = judge(&seen, threshold);
    stats.nodes_visited += 1;
    if is_dropped {
        return Ok(());
    }
    let margin = outer_margin(is_large, node.cover_margin, low, high);
    if !visitor.is_open(low - margin, high + margin) {
        stats.culled_opaque += 1;
        return Ok(());
    }
    let level = usize::from(node.level);
    let Some(page) = pin_sound_page(reader, node.page, level - 1, stats)? else { return Ok(()) };
    let child = Child {
        page: &page,
        page_id: node.page,
        offset: node.offset,
        octant: node.octant,
        is_leaf: node.is_leaf,
        is_large,
        low,
        high,
        level,
        limits: (node.limits != Limits::NONE).then_some((&node.limits, boxes)),
    };
    take_child(reader, &child, margin, receiver, threshold, visitor, scratch, stats)?;
    walk(reader, receiver, threshold, visitor, scratch, stats)
}

/// Walks until all groups on the way are done.
#[inline(always)]
fn walk<V: CutVisitor, T: Threshold>(
    reader: &mut Reader<'_>,
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    while let Some(frame) = scratch.frames.last_mut() {
        if frame.step == CHILDREN_MAX as u8 {
            scratch.frames.pop();
            continue;
        }
        let octant = frame.step ^ frame.group.flip;
        frame.step += 1;
        let bit = 1u8 << octant;
        if frame.group.octants & !frame.group.below & bit == 0 {
            continue;
        }
        let group = &frame.group;
        let (low, high) = group.bounds(group.index(octant));
        let margin = outer_margin(group.large & bit != 0, group.cover_margin, low, high);
        if !visitor.is_open(low - margin, high + margin) {
            stats.culled_opaque += 1;
            continue;
        }
        let page = group.page.clone();
        let child = Child {
            page: &page,
            page_id: group.page_id,
            offset: group.offset,
            octant,
            is_leaf: group.leaves & bit != 0,
            is_large: group.large & bit != 0,
            low,
            high,
            level: frame.level,
            limits: None,
        };
        take_child(reader, &child, margin, receiver, threshold, visitor, scratch, stats)?;
    }
    Ok(())
}

/// How far what is in a node's box reaches out of it: disks by an eighth of a box's edge, needles farther but transparent; the group's margin may
/// come from one giant among its surfels.
#[inline(always)]
fn outer_margin(is_large: bool, cover_margin: f32, low: Vec3, high: Vec3) -> f32 {
    let edge = (high - low).max_element();
    if is_large { cover_margin.min(OVERHANG * edge) } else { Cluster::REACH * edge }
}

/// A node that is not below the horizon.
struct Child<'p> {
    page: &'p PageRef,
    page_id: PageId,
    offset: u32,
    octant: u8,
    is_leaf: bool,
    is_large: bool,
    low: Vec3,
    high: Vec3,
    level: usize,
    /// Which of its surfels count, if not all.
    limits: Option<(&'p Limits, [&'p Aabb; 2])>,
}

/// Takes a node as one, or the surfels of a leaf, or goes on with its children.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the state of one walk")]
fn take_child<V: CutVisitor, T: Threshold>(
    reader: &mut Reader<'_>,
    child: &Child<'_>,
    margin: f32,
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    let layout = reader.octree().layout();
    let &Child { page, page_id, offset, octant, low, high, level, .. } = child;
    let (view, group) = view_group(reader, page, page_id, offset, layout.channels)?;
    let index = child_index(group.fields().octants, octant);
    if !child.is_large {
        let lobes = (group.lobe_bytes(index, layout.channels), &group.stencils(index));
        let seed = node_seed(page_id, offset, octant);
        visitor.take_cluster(&Cluster::from_lobes(low, high, margin, lobes, seed, &layout));
        stats.clusters += 1;
        return Ok(());
    }
    let link = group.link(index, child.is_leaf);
    if let ChildLink::Leaf { offset, count } = link {
        let leaf = Leaf {
            page: view.fields().surfel_page,
            place: (offset, count),
            frame: group.leaf_frame(index),
            owner: page_id,
            level,
            limits: child.limits,
        };
        let order = &mut scratch.order;
        return take_leaf(reader, &leaf, receiver, visitor, order, &layout, stats);
    }
    let Some(place) = follow_link(reader, (page, page_id, &view), link, level, stats)? else {
        return Ok(());
    };
    let group = Group::open(reader, place, &receiver.view, threshold, &layout, stats)?;
    scratch.frames.push(Frame { group, step: 0, level: level + 1 });
    Ok(())
}

/// Mean radiance of all surfaces of a file, of the brightest channel, weighted by area; W·m⁻²·sr⁻¹. 0 for files without light.
///
/// # Errors
///
/// If the root's page cannot be read or contradicts itself.
pub fn mean_brightness(reader: &mut Reader<'_>) -> Result<f32, StoreError> {
    let (header, layout) = (*reader.octree().header(), reader.octree().layout());
    if layout.channels != Channels::Rgb {
        return Ok(0.0);
    }
    let page = reader.pin_page(header.root_page)?;
    let (id, root) = (header.root_page, header.root_offset);
    let (_, group) = view_group(reader, &page, id, root, layout.channels)?;
    let (mut light, mut area) = (0.0, 0.0);
    for index in 0..group.child_count() {
        let lobes = group.lobe_bytes(index, layout.channels);
        for stored in lobes.chunks_exact(Lobe::stored_bytes(layout.channels)) {
            let lobe = Lobe::read(stored, layout.channels, layout.area, layout.radiance_scale);
            let size = lobe.vector.length() + lobe.width;
            light += size * lobe.radiance.into_iter().fold(0.0, f32::max);
            area += size;
        }
    }
    Ok(if area > 0.0 { light / area } else { 0.0 })
}
