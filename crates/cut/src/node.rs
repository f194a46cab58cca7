//! Nodes by their places in the file, and how they are seen from a place.

use crate::known::KnownGroup;
use crate::metric::{NodeSeen, Threshold};
use crate::stats::{CutStats, LEVELS};
use pbgi_format::{CHILDREN_MAX, Channels, FormatError, GroupView, NodePage, PageId};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{PageRef, Reader, StoreError};

/// A node, by its place in its group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeRef {
    /// Box of its surfels, relative to the file's origin.
    pub bounds: Aabb,
    /// Its group.
    pub(crate) group: NodePlace,
    /// Which of its group's octants it is.
    pub(crate) octant: u8,
    pub(crate) is_leaf: bool,
    pub(crate) is_plane: bool,
    pub(crate) brightness: f32,
    /// How far covering disks reach out of the boxes of its group's children at most.
    pub(crate) cover_margin: f32,
    pub(crate) limits: Limits,
}

/// Where a group lies in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NodePlace {
    pub page: PageId,
    /// Its first byte in the page.
    pub offset: u32,
    /// The root's is 1.
    pub level: u8,
}

impl NodePlace {
    /// The number of a child.
    #[inline(always)]
    pub fn seed(&self, octant: u8) -> u32 {
        node_seed(self.page, self.offset, octant)
    }
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

    /// [`Self::top`] of eight boxes at a time.
    #[inline(always)]
    pub fn tops(
        &self,
        low: &[[f32; CHILDREN_MAX]; 3],
        high: &[[f32; CHILDREN_MAX]; 3],
    ) -> [f32; CHILDREN_MAX] {
        let over = |normals: &Normals| {
            let mut tops = [0.0; CHILDREN_MAX];
            for axis in 0..3 {
                let (a, b) = (normals.low[axis], normals.high[axis]);
                let (far, near) = (self.reach.max[axis], self.reach.min[axis]);
                for lane in 0..CHILDREN_MAX {
                    let (low, high) = (low[axis][lane] - far, high[axis][lane] - near);
                    let of_a = larger(a * low, a * high);
                    let of_b = larger(b * low, b * high);
                    tops[lane] += larger(of_a, of_b);
                }
            }
            tops
        };
        let mut tops = over(&self.normals);
        if self.planes != self.normals {
            let others = over(&self.planes);
            for lane in 0..CHILDREN_MAX {
                tops[lane] = -larger(-tops[lane], -others[lane]);
            }
        }
        tops
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

impl KnownGroup {
    /// A child that is not below the horizon, to walk from later.
    #[inline(always)]
    pub fn node(&self, octant: u8) -> NodeRef {
        let index = self.index(octant);
        NodeRef {
            bounds: self.bounds(index),
            group: self.place,
            octant,
            is_leaf: self.leaves >> octant & 1 != 0,
            is_plane: self.planes >> index & 1 != 0,
            brightness: self.brightness[index],
            cover_margin: self.cover_margin,
            limits: Limits::NONE,
        }
    }
}

/// The larger of two numbers, in one instruction: neither is none.
#[inline(always)]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
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
