//! The walk: depth first, children front to back.

use crate::cluster::Cluster;
use crate::metric::{NodeSeen, Threshold};
use pbgi_format::{
    CHILDREN_MAX, Channels, ChildLink, FormatError, GroupView, LeafSurfel, Lobe, NodePage, PageId,
    SurfelLayout, SurfelPage,
};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{PageRef, Reader, ReaderStats, StoreError};

/// The place a cut is picked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutReceiver {
    /// Position relative to the file's origin.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Nodes and surfels that rise no more than this above the receiver's tangent plane are below
    /// its horizon; scene units.
    pub bias: f32,
    /// The same for single surfels, in units of their radius, on top of `bias`.
    pub surfel_bias: f32,
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

/// Levels that are told apart; what lies deeper counts to the last.
pub const LEVELS: usize = 24;

/// Requests for pages from groups of one level of the tree, 0 the root's; those for a leaf's surfels count to the level below its group.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LevelStats {
    /// Pages asked for.
    pub requests: u64,
    /// Pages that had to be read for it.
    pub misses: u64,
    /// Stored bytes of those.
    pub bytes_read: u64,
    /// Nanoseconds in the shared cache.
    pub wait_ns: u64,
}

impl LevelStats {
    /// Counts a request between two states of a reader.
    #[inline(always)]
    fn note(&mut self, before: &ReaderStats, after: &ReaderStats) {
        self.requests += 1;
        self.misses += after.pages_read - before.pages_read;
        self.bytes_read += after.bytes_read - before.bytes_read;
        self.wait_ns += after.wait_ns - before.wait_ns;
    }

    fn add(&mut self, other: &Self) {
        self.requests += other.requests;
        self.misses += other.misses;
        self.bytes_read += other.bytes_read;
        self.wait_ns += other.wait_ns;
    }
}

/// What picking cuts did; sums over receivers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CutStats {
    /// Nodes whose bounds were tested.
    pub nodes_visited: u64,
    /// Nodes taken as one.
    pub clusters: u64,
    /// Surfels taken singly.
    pub surfels: u64,
    /// Nodes dropped because they are below the horizon.
    pub culled_horizon: u64,
    /// Nodes dropped because all they could touch was opaque.
    pub culled_opaque: u64,
    /// Pages asked for, by level of the tree.
    pub levels: [LevelStats; LEVELS],
}

impl CutStats {
    /// Entries of the cut.
    #[must_use]
    pub fn cut_size(&self) -> u64 {
        self.clusters + self.surfels
    }

    /// Adds another's counts.
    pub fn add(&mut self, other: &Self) {
        self.nodes_visited += other.nodes_visited;
        self.clusters += other.clusters;
        self.surfels += other.surfels;
        self.culled_horizon += other.culled_horizon;
        self.culled_opaque += other.culled_opaque;
        for (level, other) in self.levels.iter_mut().zip(&other.levels) {
            level.add(other);
        }
    }
}

/// How far near disks reach out of the box of their node at most, as a share of the box's largest edge.
const OVERHANG: f32 = 0.125;

/// A group on the way from the root to where the walk is.
struct Frame {
    page: PageRef,
    page_id: PageId,
    offset: u32,
    /// Octants with a child, and those whose child is a leaf.
    octants: u8,
    leaves: u8,
    /// Children (bit = octant) below the horizon or not wanted, and those too large to be taken as one.
    below: u8,
    large: u8,
    /// Octant order is `step ^ flip`.
    flip: u8,
    step: u8,
    cover_margin: f32,
    low: [[f32; CHILDREN_MAX]; 3],
    high: [[f32; CHILDREN_MAX]; 3],
}

/// Memory of a walk, reused from receiver to receiver.
#[derive(Default)]
pub struct CutScratch {
    frames: Vec<Frame>,
    order: Vec<(f32, u32)>,
}

/// Walks the octree from its root, octants front to back, and gives the visitor every node or surfel of the cut.
///
/// In order, for each node: wholly below the receiver's horizon, it is dropped; all it could touch opaque, it is dropped with everything
/// below it, whose pages are never read; small enough for `threshold`, it is taken as one; a leaf
/// gives its surfels, nearest first; else the walk descends. Seen from any point, an octant whose
/// index differs from the receiver's own octant in fewer planes is never behind one that differs in
/// those and more: visiting `step XOR own` in ascending `step` is front to back. What lies in damaged pages that are skipped counts as
/// nothing; the root's page is never skipped.
///
/// # Errors
///
/// If a page cannot be read or contradicts itself.
#[inline(always)]
pub fn pick_cut<V: CutVisitor, T: Threshold>(
    reader: &mut Reader<'_>,
    receiver: &CutReceiver,
    threshold: &T,
    visitor: &mut V,
    scratch: &mut CutScratch,
    stats: &mut CutStats,
) -> Result<(), StoreError> {
    let octree = reader.octree();
    let header = octree.header();
    let layout = octree.layout();
    let CutScratch { frames, order } = scratch;
    frames.clear();
    let before = reader.stats();
    let root = reader.pin_page(header.root_page)?;
    stats.levels[0].note(&before, &reader.stats());
    let start = (root, header.root_page, header.root_offset);
    frames.push(open_frame(reader, start, receiver, threshold, &layout, stats)?);
    loop {
        let level = frames.len();
        let Some(frame) = frames.last_mut() else { return Ok(()) };
        if frame.step == CHILDREN_MAX as u8 {
            frames.pop();
            continue;
        }
        let octant = frame.step ^ frame.flip;
        frame.step += 1;
        let bit = 1u8 << octant;
        if frame.octants & !frame.below & bit == 0 {
            continue;
        }
        let index = (frame.octants & (bit - 1)).count_ones() as usize;
        let low = Vec3::new(frame.low[0][index], frame.low[1][index], frame.low[2][index]);
        let high = Vec3::new(frame.high[0][index], frame.high[1][index], frame.high[2][index]);
        let large = frame.large & bit != 0;
        // Disks reach out of their boxes by an eighth of a box's edge, needles farther but transparent; the group's
        // margin may come from one giant among its surfels.
        let margin = if large {
            frame.cover_margin.min(OVERHANG * (high - low).max_element())
        } else {
            Cluster::REACH * (high - low).max_element()
        };
        if !visitor.is_open(low - margin, high + margin) {
            stats.culled_opaque += 1;
            continue;
        }
        let invalid = |reader: &Reader<'_>, page, source| reader.invalid_page(page, source);
        let view = match NodePage::new(frame.page.bytes(), frame.page_id) {
            Ok(view) => view,
            Err(error) => return Err(invalid(reader, frame.page_id, error)),
        };
        let group = GroupView::new(view.bytes(), view.groups_end(), frame.offset, layout.channels);
        let group = match group {
            Ok(group) => group,
            Err(error) => return Err(invalid(reader, frame.page_id, error)),
        };
        if !large {
            let lobes = group.lobe_bytes(index, layout.channels);
            let seed = node_seed(frame.page_id, frame.offset, octant);
            let cluster = Cluster::from_lobes(low, high, margin, lobes, seed, &layout);
            visitor.take_cluster(&cluster);
            stats.clusters += 1;
            continue;
        }
        let start = match group.link(index, frame.leaves & bit != 0) {
            ChildLink::Leaf { offset, count } => {
                let page = view.fields().surfel_page;
                let place = (offset, count);
                let leaf = Leaf {
                    page,
                    place,
                    frame: group.leaf_frame(index),
                    owner: frame.page_id,
                    level,
                };
                take_leaf(reader, &leaf, receiver, visitor, order, &layout, stats)?;
                continue;
            }
            ChildLink::Group(offset) => (frame.page.clone(), frame.page_id, offset),
            ChildLink::External(link) => {
                let Some(link) = view.external_link(link) else {
                    let error = bad_link("link: index", link);
                    return Err(invalid(reader, frame.page_id, error));
                };
                let Some(page) = pin_sound_page(reader, link.page, level, stats)? else { continue };
                (page, link.page, link.offset)
            }
        };
        if level >= header.depth as usize {
            return Err(reader.invalid_page(start.1, bad_link("tree: depth", header.depth)));
        }
        frames.push(open_frame(reader, start, receiver, threshold, &layout, stats)?);
    }
}

/// Pins a page that a group of this level needs; none where it is damaged and left out.
#[inline(always)]
fn pin_sound_page(
    reader: &mut Reader<'_>,
    id: PageId,
    level: usize,
    stats: &mut CutStats,
) -> Result<Option<PageRef>, StoreError> {
    let before = reader.stats();
    let page = reader.pin_sound_page(id)?;
    stats.levels[level.min(LEVELS - 1)].note(&before, &reader.stats());
    Ok(page)
}

/// Mean radiance of all surfaces of a file, of the brightest channel, weighted by area; W·m⁻²·sr⁻¹. 0 for files without light.
///
/// # Errors
///
/// If the root's page cannot be read or contradicts itself.
pub fn mean_brightness(reader: &mut Reader<'_>) -> Result<f32, StoreError> {
    let octree = reader.octree();
    let (header, layout) = (octree.header(), octree.layout());
    if layout.channels != Channels::Rgb {
        return Ok(0.0);
    }
    let page = reader.pin_page(header.root_page)?;
    let invalid = |error| reader.invalid_page(header.root_page, error);
    let view = NodePage::new(page.bytes(), header.root_page).map_err(invalid)?;
    let root = header.root_offset;
    let group = GroupView::new(view.bytes(), view.groups_end(), root, layout.channels);
    let group = group.map_err(invalid)?;
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

/// A number that tells nodes apart.
#[inline(always)]
fn node_seed(page: PageId, offset: u32, octant: u8) -> u32 {
    page.0.wrapping_mul(0x9e37_79b9) ^ offset.wrapping_mul(0x85eb_ca6b) ^ u32::from(octant) << 28
}

#[cold]
fn bad_link(place: &'static str, found: u32) -> FormatError {
    FormatError { place, found: found.to_string(), expected: "a link within the file".to_owned() }
}

/// Decodes a group's children and tests them all against horizon and threshold.
#[inline(always)]
fn open_frame<T: Threshold>(
    reader: &Reader<'_>,
    (page, page_id, offset): (PageRef, PageId, u32),
    receiver: &CutReceiver,
    threshold: &T,
    layout: &SurfelLayout,
    stats: &mut CutStats,
) -> Result<Frame, StoreError> {
    let view = match NodePage::new(page.bytes(), page_id) {
        Ok(view) => view,
        Err(error) => return Err(reader.invalid_page(page_id, error)),
    };
    let group = match GroupView::new(view.bytes(), view.groups_end(), offset, layout.channels) {
        Ok(group) => group,
        Err(error) => return Err(reader.invalid_page(page_id, error)),
    };
    let fields = group.fields();
    let step = fields.bounds.extent() * (1.0 / 255.0);
    let base = fields.bounds.min - receiver.position;
    let corners = group.corners();
    let mut low = [[0.0; CHILDREN_MAX]; 3];
    let mut high = [[0.0; CHILDREN_MAX]; 3];
    let mut distance2 = [0.0; CHILDREN_MAX];
    let mut radius2 = [0.0; CHILDREN_MAX];
    let mut top = [0.0; CHILDREN_MAX];
    for axis in 0..3 {
        let n = receiver.normal[axis];
        for lane in 0..CHILDREN_MAX {
            let a = base[axis] + step[axis] * f32::from(corners[axis][lane]);
            let b = base[axis] + step[axis] * f32::from(corners[axis + 3][lane]);
            low[axis][lane] = a;
            high[axis][lane] = b;
            let (center, half) = (0.5 * (a + b), 0.5 * (b - a));
            distance2[lane] += center * center;
            radius2[lane] += half * half;
            top[lane] += n * center + n.abs() * half;
        }
    }
    let mut planes = 0u32;
    let mut brightness = [0f32; CHILDREN_MAX];
    let asks_brightness = T::ASKS_BRIGHTNESS && layout.channels == Channels::Rgb;
    if T::ASKS_PLANES || asks_brightness {
        let stride = Lobe::stored_bytes(layout.channels);
        for index in 0..group.child_count() {
            let lobes = group.lobe_bytes(index, layout.channels);
            planes |= u32::from(lobes.len() == stride && Lobe::is_filled_plane(lobes)) << index;
            if asks_brightness {
                for lobe in lobes.chunks_exact(stride) {
                    brightness[index] = brightness[index].max(Lobe::stored_brightness(lobe));
                }
                brightness[index] *= layout.radiance_scale;
            }
        }
    }
    let (mut below, mut large) = (0u32, 0u32);
    for lane in 0..CHILDREN_MAX {
        let center = Vec3::new(
            0.5 * (low[0][lane] + high[0][lane]),
            0.5 * (low[1][lane] + high[1][lane]),
            0.5 * (low[2][lane] + high[2][lane]),
        );
        let seen = NodeSeen {
            to_center: center,
            distance2: distance2[lane],
            radius2: radius2[lane],
            is_plane: planes >> lane & 1 != 0,
            brightness: brightness[lane],
        };
        let limit = threshold.sin2_max(&seen) * distance2[lane];
        let is_dropped = top[lane] <= receiver.bias || !threshold.is_wanted(&seen);
        below |= u32::from(is_dropped) << lane;
        large |= u32::from(radius2[lane] > limit) << lane;
    }
    // From child order to octants.
    let (mut below_octants, mut large_octants) = (0u8, 0u8);
    let mut rest = fields.octants;
    for index in 0..group.child_count() {
        let bit = rest & rest.wrapping_neg();
        rest &= rest - 1;
        below_octants |= if below >> index & 1 != 0 { bit } else { 0 };
        large_octants |= if large >> index & 1 != 0 { bit } else { 0 };
    }
    stats.nodes_visited += group.child_count() as u64;
    stats.culled_horizon += u64::from(below_octants.count_ones());
    let side = receiver.position.cmpgt(fields.split);
    Ok(Frame {
        page,
        page_id,
        offset,
        octants: fields.octants,
        leaves: fields.leaves,
        below: below_octants,
        large: large_octants,
        flip: side.bitmask() as u8,
        step: 0,
        cover_margin: fields.cover_margin,
        low,
        high,
    })
}

/// A leaf to be opened.
struct Leaf {
    page: Option<PageId>,
    /// First byte, and surfels.
    place: (u32, u32),
    /// Box of its positions.
    frame: Aabb,
    /// The page that links to it.
    owner: PageId,
    /// Its level.
    level: usize,
}

/// Share of its radius by which a surfel that cannot be the receiver's own surface must rise above the tangent plane: more than codes are off by.
pub const OTHER_BIAS: f32 = 0.05;

/// Cosine of the angle between normals up to which surfaces count as parallel: codes of normals are off by a tenth of a degree.
const PARALLEL_COSINE: f32 = 0.9998;

/// Cosine of the angle between normals above which a near surfel may be a piece of the receiver's own curved surface.
pub const OWN_SURFACE_COSINE: f32 = 0.7;

/// How far a surfel reaches over its center along a unit vector whose cosine to its normal is `tilt`.
#[inline(always)]
fn reach_along(surfel: &LeafSurfel, direction: Vec3, tilt: f32) -> f32 {
    if surfel.isotropic {
        return surfel.radius;
    }
    if surfel.is_triangle() {
        let [a, b, c] = surfel.corners();
        return a.dot(direction).max(b.dot(direction)).max(c.dot(direction));
    }
    if surfel.is_rectangle() {
        let [u, v] = surfel.tile.edges(surfel.normal);
        let [a, b] = surfel.half_edges();
        return a * u.dot(direction).abs() + b * v.dot(direction).abs();
    }
    // Of a disk: r sin(angle between the normals).
    surfel.radius * (1.0 - tilt * tilt).max(0.0).sqrt()
}

/// Whether a surfel is a rectangle or triangle parallel to a receiver with this normal, and faces the same way.
#[must_use]
#[inline(always)]
pub fn is_parallel_tile(surfel: &LeafSurfel, normal: Vec3) -> bool {
    surfel.tile.is_known() && surfel.normal.dot(normal) > PARALLEL_COSINE
}

/// Cosine of the angle by which neighboring pieces of one sheet may be folded.
const FOLD_COSINE: f32 = 0.5;

/// Whether a surfel, relative to the receiver, belongs to the surface the receiver lies on, as far as that can hide anything: it does not
/// rise above the tangent plane, or is the other side of a convex edge.
#[inline(always)]
fn is_own_surface(surfel: &LeafSurfel, receiver: &CutReceiver) -> bool {
    let tilt = surfel.normal.dot(receiver.normal);
    let height = surfel.center.dot(receiver.normal);
    let depth = surfel.center.dot(surfel.normal);
    // A surface does not face its own front: what does hangs over the receiver, however low.
    let is_facing = !surfel.isotropic && tilt < 0.0;
    let share = if is_facing || is_other_tile(surfel, tilt, depth) {
        OTHER_BIAS.min(receiver.surfel_bias)
    } else {
        receiver.surfel_bias
    };
    let least = receiver.bias + share * surfel.radius;
    if height <= least && height + reach_along(surfel, receiver.normal, tilt) <= least {
        return true;
    }
    // Disks reach over the edges of their surface. Where one of a solid thing is seen from behind and has
    // its middle below the tangent plane, the receiver's own surface lies before it.
    // Where one of a sheet's other side is seen from its front, a fold of the receiver's own sheet does.
    let is_fold = surfel.front_only && tilt < -FOLD_COSINE;
    let is_behind = !surfel.front_only && depth > 0.0;
    let is_disk = !surfel.isotropic && !surfel.tile.is_known();
    height <= 0.0 && is_disk && (is_fold || is_behind)
}

/// Whether a surfel is a rectangle or triangle of another surface than the receiver's. It is drawn as it is, so that what stands over the
/// receiver hides it, but for its own piece of surface under a normal that is interpolated, and for neighbors that bulge away from it.
#[inline(always)]
fn is_other_tile(surfel: &LeafSurfel, tilt: f32, depth: f32) -> bool {
    let is_alike = (OWN_SURFACE_COSINE..PARALLEL_COSINE).contains(&tilt);
    surfel.tile.is_known() && !(is_alike && depth > -OTHER_BIAS * surfel.radius)
}

#[inline(always)]
fn take_leaf<V: CutVisitor>(
    reader: &mut Reader<'_>,
    leaf: &Leaf,
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
    order.clear();
    for index in 0..surfels.count() {
        let distance2 = (surfels.center(index) - receiver.position).length_squared();
        order.push((distance2, index));
    }
    // Ties by place in the file, so that the order is total.
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for &(distance2, index) in order.iter() {
        let mut surfel = surfels.surfel(index);
        surfel.center -= receiver.position;
        if distance2 == 0.0 || is_own_surface(&surfel, receiver) {
            continue;
        }
        let seed = node_seed(id, leaf.place.0 + (index << 24), 0);
        visitor.take_surfel(&SurfelSeen { surfel, seed, distance2 });
        stats.surfels += 1;
    }
    Ok(())
}
