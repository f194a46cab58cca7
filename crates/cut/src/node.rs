//! Nodes by their places in the file, and how they are seen from a receiver.

use crate::stats::{CutStats, LEVELS};
use pbgi_format::{CHILDREN_MAX, Channels, FormatError, GroupView, NodePage, PageId};
use pbgi_math::{Vec3, larger};
use pbgi_store::{PageRef, Reader, StoreError};

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

/// From where nodes are looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Viewpoint {
    pub position: Vec3,
    /// The normal it is shaded with, and that of its surface.
    pub normal: Vec3,
    pub plane: Vec3,
}

impl Viewpoint {
    /// Largest heights of eight boxes, relative to the position, over the lower of the two horizons: what is below either is not seen.
    #[inline(always)]
    pub fn tops(
        &self,
        low: &[[f32; CHILDREN_MAX]; 3],
        high: &[[f32; CHILDREN_MAX]; 3],
    ) -> [f32; CHILDREN_MAX] {
        let over = |normal: Vec3| {
            let mut tops = [0.0; CHILDREN_MAX];
            for axis in 0..3 {
                for lane in 0..CHILDREN_MAX {
                    let (low, high) = (low[axis][lane], high[axis][lane]);
                    tops[lane] += larger(normal[axis] * low, normal[axis] * high);
                }
            }
            tops
        };
        let mut tops = over(self.normal);
        if self.plane != self.normal {
            let others = over(self.plane);
            for lane in 0..CHILDREN_MAX {
                tops[lane] = -larger(-tops[lane], -others[lane]);
            }
        }
        tops
    }
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
