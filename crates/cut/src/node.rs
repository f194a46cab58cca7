//! Nodes by their places in the file, and how they are seen from a place.

use crate::metric::{NodeSeen, Threshold};
use crate::stats::{CutStats, LEVELS};
use pbgi_format::{
    CHILDREN_MAX, Channels, ChildLink, FormatError, GroupView, Lobe, NodePage, PageId, SurfelLayout,
};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{PageRef, Reader, StoreError};

/// A node, by its place in its group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeRef {
    /// Box of its surfels, relative to the file's origin.
    pub bounds: Aabb,
    /// The page of its group, and the group's first byte there.
    pub(crate) page: PageId,
    pub(crate) offset: u32,
    /// Which of its group's octants it is.
    pub(crate) octant: u8,
    pub(crate) is_leaf: bool,
    pub(crate) is_plane: bool,
    /// Level of its group, the root's is 1.
    pub(crate) level: u8,
    pub(crate) brightness: f32,
    /// How far covering disks reach out of the boxes of its group's children at most.
    pub(crate) cover_margin: f32,
    pub(crate) limits: Limits,
}

/// Which surfels of a leaf count, by their distance from the box of a block and from that of the block around it: of a leaf that is near and far at
/// once, some are drawn by one block and some by the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Limits {
    /// Least distance from the inner box.
    pub beyond: f32,
    /// Distance from the inner box, and from the outer one, from which on they do not count.
    pub within: f32,
    pub outer_within: f32,
}

impl Limits {
    pub const NONE: Self = Self { beyond: 0.0, within: f32::INFINITY, outer_within: f32::INFINITY };

    /// Whether a surfel with this center counts.
    #[inline(always)]
    pub fn hold(&self, center: Vec3, [inner, outer]: [&Aabb; 2]) -> bool {
        let point = Aabb { min: center, max: center };
        let apart = distance(&point, inner);
        apart >= self.beyond && apart < self.within && distance(&point, outer) < self.outer_within
    }
}

/// Distance between two boxes.
#[inline(always)]
pub(crate) fn distance(a: &Aabb, b: &Aabb) -> f32 {
    (a.min - b.max).max(b.min - a.max).max(Vec3::ZERO).length()
}

/// A box around unit vectors: the normals of one receiver or of many.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normals {
    low: Vec3,
    high: Vec3,
}

impl Normals {
    /// Of one receiver.
    #[must_use]
    #[inline(always)]
    pub fn one(normal: Vec3) -> Self {
        Self { low: normal, high: normal }
    }

    #[inline(always)]
    pub(crate) fn first(&self) -> Vec3 {
        self.low
    }

    /// Of many; everything, where there are none.
    #[must_use]
    pub fn around(normals: impl Iterator<Item = Vec3>) -> Self {
        let empty = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };
        let all = normals.fold(empty, |b, n| Self { low: b.low.min(n), high: b.high.max(n) });
        if all.low.x <= all.high.x { all } else { Self { low: Vec3::NEG_ONE, high: Vec3::ONE } }
    }

    /// No less than the largest n·p of all normals and points of a box.
    #[must_use]
    #[inline(always)]
    pub fn top(&self, low: Vec3, high: Vec3) -> f32 {
        let (a, b) = (self.low, self.high);
        (a * low).max(a * high).max((b * low).max(b * high)).element_sum()
    }
}

/// A group of nodes, decoded as seen from a place.
pub(crate) struct Group {
    pub page: PageRef,
    pub page_id: PageId,
    pub offset: u32,
    /// Octants with a child, and those whose child is a leaf.
    pub octants: u8,
    pub leaves: u8,
    /// Children (bit = octant) below the horizon or not wanted, and those too large to be taken as one.
    pub below: u8,
    pub large: u8,
    /// Octant order, front to back, is `step ^ flip`.
    pub flip: u8,
    pub cover_margin: f32,
    /// Whether a child is one piece of a plane, by index.
    planes: u8,
    /// Boxes of the children, by index, and their brightness.
    low: [[f32; CHILDREN_MAX]; 3],
    high: [[f32; CHILDREN_MAX]; 3],
    brightness: [f32; CHILDREN_MAX],
}

/// From where groups are looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Viewpoint {
    pub position: Vec3,
    /// Where receivers lie that `position` stands for, relative to it.
    pub reach: Aabb,
    pub normals: Normals,
    pub planes: Normals,
}

impl Viewpoint {
    /// Largest height of a box, relative to the position, over the horizon of any receiver.
    #[inline(always)]
    pub fn top(&self, low: Vec3, high: Vec3) -> f32 {
        let (low, high) = (low - self.reach.max, high - self.reach.min);
        let top = self.normals.top(low, high);
        if self.planes == self.normals { top } else { top.min(self.planes.top(low, high)) }
    }

    /// A node as a threshold sees it.
    #[inline(always)]
    pub fn see(&self, low: Vec3, high: Vec3, is_plane: bool, brightness: f32) -> NodeSeen {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        NodeSeen {
            to_center: center,
            distance2: center.length_squared(),
            radius2: half.length_squared(),
            top: self.top(low, high),
            is_plane,
            brightness,
        }
    }
}

/// What becomes of a node that is seen: dropped, or too large to be taken as one.
#[inline(always)]
pub(crate) fn judge<T: Threshold>(seen: &NodeSeen, threshold: &T) -> (bool, bool) {
    let limit = threshold.sin2_max(seen) * seen.distance2;
    (seen.top <= 0.0 || !threshold.is_wanted(seen), seen.radius2 > limit)
}

/// The group at a place of a page.
#[inline(always)]
pub(crate) fn view_group<'p>(
    reader: &Reader<'_>,
    page: &'p PageRef,
    page_id: PageId,
    offset: u32,
    channels: Channels,
) -> Result<(NodePage<'p>, GroupView<'p>), StoreError> {
    let view = NodePage::new(page.bytes(), page_id);
    let group = view.and_then(|view| {
        let group = GroupView::new(view.bytes(), view.groups_end(), offset, channels)?;
        Ok((view, group))
    });
    group.map_err(|error| reader.invalid_page(page_id, error))
}

impl Group {
    /// Decodes a group's children and tests them all against horizon and threshold.
    #[inline(always)]
    pub fn open<T: Threshold>(
        reader: &Reader<'_>,
        (page, page_id, offset): GroupPlace,
        viewpoint: &Viewpoint,
        threshold: &T,
        layout: &SurfelLayout,
        stats: &mut CutStats,
    ) -> Result<Self, StoreError> {
        let (_, view) = view_group(reader, &page, page_id, offset, layout.channels)?;
        let fields = view.fields();
        let step = fields.bounds.extent() * (1.0 / 255.0);
        let base = fields.bounds.min - viewpoint.position;
        let corners = view.corners();
        let mut low = [[0.0; CHILDREN_MAX]; 3];
        let mut high = [[0.0; CHILDREN_MAX]; 3];
        for axis in 0..3 {
            for lane in 0..CHILDREN_MAX {
                low[axis][lane] = base[axis] + step[axis] * f32::from(corners[axis][lane]);
                high[axis][lane] = base[axis] + step[axis] * f32::from(corners[axis + 3][lane]);
            }
        }
        let (mut planes, mut brightness) = (0u8, [0f32; CHILDREN_MAX]);
        let stride = Lobe::stored_bytes(layout.channels);
        let asks_brightness = T::ASKS_BRIGHTNESS && layout.channels == Channels::Rgb;
        if T::ASKS_PLANES || asks_brightness {
            for index in 0..view.child_count() {
                let lobes = view.lobe_bytes(index, layout.channels);
                planes |= u8::from(lobes.len() == stride && Lobe::is_filled_plane(lobes)) << index;
                if asks_brightness {
                    for lobe in lobes.chunks_exact(stride) {
                        brightness[index] = brightness[index].max(Lobe::stored_brightness(lobe));
                    }
                    brightness[index] *= layout.radiance_scale;
                }
            }
        }
        let side = viewpoint.position.cmpgt(fields.split);
        let (octants, leaves, cover_margin) = (fields.octants, fields.leaves, fields.cover_margin);
        let (children, flip) = (view.child_count(), side.bitmask() as u8);
        let mut group = Self {
            page,
            page_id,
            offset,
            octants,
            leaves,
            below: 0,
            large: 0,
            flip,
            cover_margin,
            planes,
            low,
            high,
            brightness,
        };
        let mut rest = octants;
        for index in 0..children {
            let bit = rest & rest.wrapping_neg();
            rest &= rest - 1;
            let (low, high) = group.bounds(index);
            let seen = viewpoint.see(low, high, planes >> index & 1 != 0, brightness[index]);
            let (is_dropped, is_large) = judge(&seen, threshold);
            group.below |= if is_dropped { bit } else { 0 };
            group.large |= if is_large { bit } else { 0 };
        }
        stats.nodes_visited += children as u64;
        stats.culled_horizon += u64::from(group.below.count_ones());
        Ok(group)
    }

    /// Index of the child of an octant.
    #[inline(always)]
    pub fn index(&self, octant: u8) -> usize {
        child_index(self.octants, octant)
    }

    /// Box of a child, relative to the viewpoint.
    #[inline(always)]
    pub fn bounds(&self, index: usize) -> (Vec3, Vec3) {
        let corner =
            |of: &[[f32; CHILDREN_MAX]; 3]| Vec3::new(of[0][index], of[1][index], of[2][index]);
        (corner(&self.low), corner(&self.high))
    }

    /// A child that is not below the horizon, to walk from later.
    #[inline(always)]
    pub fn node(&self, octant: u8, level: usize, position: Vec3) -> NodeRef {
        let index = self.index(octant);
        let (low, high) = self.bounds(index);
        NodeRef {
            bounds: Aabb { min: low + position, max: high + position },
            page: self.page_id,
            offset: self.offset,
            octant,
            is_leaf: self.leaves >> octant & 1 != 0,
            is_plane: self.planes >> index & 1 != 0,
            level: level.min(LEVELS) as u8,
            brightness: self.brightness[index],
            cover_margin: self.cover_margin,
            limits: Limits::NONE,
        }
    }
}

/// Index of an octant's child in its group.
#[inline(always)]
pub(crate) fn child_index(octants: u8, octant: u8) -> usize {
    (octants & ((1 << octant) - 1)).count_ones() as usize
}

/// A group's page, pinned, its number, and the group's first byte in it.
pub(crate) type GroupPlace = (PageRef, PageId, u32);

/// The group that `link` leads to, from a group of this level in the page `from`; none behind the link of a leaf, and where the page is damaged and left
/// out.
#[inline(always)]
pub(crate) fn follow_link(
    reader: &mut Reader<'_>,
    from: (&PageRef, PageId, &NodePage<'_>),
    link: ChildLink,
    level: usize,
    stats: &mut CutStats,
) -> Result<Option<GroupPlace>, StoreError> {
    let (page, page_id, view) = from;
    let place = match link {
        ChildLink::Leaf { .. } => return Ok(None),
        ChildLink::Group(offset) => (page.clone(), page_id, offset),
        ChildLink::External(link) => {
            let Some(link) = view.external_link(link) else {
                return Err(reader.invalid_page(page_id, bad_link("link: index", link)));
            };
            let Some(page) = pin_sound_page(reader, link.page, level, stats)? else {
                return Ok(None);
            };
            (page, link.page, link.offset)
        }
    };
    let depth = reader.octree().header().depth;
    if level >= depth as usize {
        return Err(reader.invalid_page(place.1, bad_link("tree: depth", depth)));
    }
    Ok(Some(place))
}

/// A number that tells nodes apart.
#[inline(always)]
pub(crate) fn node_seed(page: PageId, offset: u32, octant: u8) -> u32 {
    page.0.wrapping_mul(0x9e37_79b9) ^ offset.wrapping_mul(0x85eb_ca6b) ^ u32::from(octant) << 28
}

#[cold]
pub(crate) fn bad_link(place: &'static str, found: u32) -> FormatError {
    FormatError { place, found: found.to_string(), expected: "a link within the file".to_owned() }
}

/// Pins a page that a group of this level needs; none where it is damaged and left out.
#[inline(always)]
pub(crate) fn pin_sound_page(
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
