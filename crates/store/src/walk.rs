//! All surfels of a file in the order of the Morton curve.

use crate::error::StoreError;
use crate::octree::{Octree, Reader};
use pbgi_format::{ChildLink, FormatError, GroupView, LeafSurfel, NodePage, PageId, SurfelPage};
use pbgi_math::{Aabb, Vec3};

/// What is still to be visited.
enum Visit {
    Group { page: PageId, offset: u32, depth: u32 },
    Leaf { node_page: PageId, page: Option<PageId>, place: (u32, u32), frame: Aabb },
}

/// Calls `visit` for every leaf, in the order of the Morton curve: with the number of surfels
/// before it and its surfels, decoded, relative to the file's origin.
///
/// Holds one path of the tree; reads each page once where the cache holds a path's pages. Surfels in damaged pages that are skipped
/// are left out, and not counted among those before a leaf; the root's page is never skipped.
///
/// # Errors
///
/// If a page cannot be read or contradicts itself. Leaves visited before that stay visited.
pub fn for_each_leaf(
    reader: &mut Reader<'_>,
    mut visit: impl FnMut(u64, &[LeafSurfel]),
) -> Result<(), StoreError> {
    try_for_each_leaf(reader, |first, surfels| {
        visit(first, surfels);
        Ok(())
    })
}

/// [`for_each_leaf`] that `visit` can end with an error of its own.
///
/// # Errors
///
/// That of `visit`, or if a page cannot be read or contradicts itself.
pub fn try_for_each_leaf<E: From<StoreError>>(
    reader: &mut Reader<'_>,
    mut visit: impl FnMut(u64, &[LeafSurfel]) -> Result<(), E>,
) -> Result<(), E> {
    let mut walk = LeafWalk::new(reader.octree());
    while let Some((first, surfels)) = walk.next_leaf(reader)? {
        visit(first, surfels)?;
    }
    Ok(())
}

/// A walk over all leaves that rests between them.
pub struct LeafWalk {
    stack: Vec<Visit>,
    /// Groups and surfels so far.
    groups: u64,
    groups_max: u64,
    done: u64,
    surfels: Vec<LeafSurfel>,
    /// Nodes whose boxes are farther from a place are passed over.
    within: Option<(Vec3, f32)>,
}

impl LeafWalk {
    /// At the first leaf of `octree`.
    #[must_use]
    pub fn new(octree: &Octree) -> Self {
        let header = octree.header();
        let root = Visit::Group { page: header.root_page, offset: header.root_offset, depth: 0 };
        let groups_max = octree.group_count_max();
        Self {
            stack: vec![root],
            groups: 0,
            groups_max,
            done: 0,
            surfels: Vec::new(),
            within: None,
        }
    }

    /// At the first of the leaves that can have the center of a surfel within `reach` of `position`, which is relative to the octree's
    /// origin. The numbers that [`Self::next_leaf`] gives count the surfels of such leaves only.
    #[must_use]
    pub fn near(octree: &Octree, position: Vec3, reach: f32) -> Self {
        Self { within: Some((position, reach)), ..Self::new(octree) }
    }

    /// The next leaf, as [`for_each_leaf`] gives it, through a reader of the octree the walk began in; `None` after the last.
    ///
    /// # Errors
    ///
    /// If a page cannot be read or contradicts itself.
    pub fn next_leaf(
        &mut self,
        reader: &mut Reader<'_>,
    ) -> Result<Option<(u64, &[LeafSurfel])>, StoreError> {
        let header = *reader.octree().header();
        while let Some(next) = self.stack.pop() {
            match next {
                Visit::Group { page, offset, depth } => {
                    // Links of a damaged file may form a cycle.
                    if depth >= header.depth || self.groups > self.groups_max {
                        return Err(invalid(reader, page, "tree: depth", depth, header.depth));
                    }
                    self.groups += 1;
                    push_children(reader, page, offset, depth, self.within, &mut self.stack)?;
                }
                Visit::Leaf { node_page, page, place, frame } => {
                    let Some(page) = page else {
                        let place = "leaf: surfel page";
                        return Err(invalid(reader, node_page, place, "none", "a page"));
                    };
                    if read_leaf(reader, page, place, &frame, &mut self.surfels)? {
                        let first = self.done;
                        self.done += self.surfels.len() as u64;
                        return Ok(Some((first, &self.surfels)));
                    }
                }
            }
        }
        Ok(None)
    }
}

/// Puts the children of a group on the stack, the first octant on top; those `within` reach of a place only.
fn push_children(
    reader: &mut Reader<'_>,
    page: PageId,
    offset: u32,
    depth: u32,
    within: Option<(Vec3, f32)>,
    stack: &mut Vec<Visit>,
) -> Result<(), StoreError> {
    let channels = reader.octree().header().channels;
    let pinned = match depth {
        0 => reader.pin_page(page)?,
        _ => match reader.pin_sound_page(page)? {
            Some(pinned) => pinned,
            None => return Ok(()),
        },
    };
    let view = NodePage::new(pinned.bytes(), page).map_err(|e| reader.invalid_page(page, e))?;
    let group = GroupView::new(pinned.bytes(), view.groups_end(), offset, channels)
        .map_err(|e| reader.invalid_page(page, e))?;
    let fields = group.fields();
    let octants = (0..8).filter(|octant| fields.octants & (1 << octant) != 0);
    let start = stack.len();
    for (index, octant) in octants.enumerate() {
        if let Some((position, reach)) = within {
            let Aabb { min, max } = group.child_box(index).decode(&fields.bounds);
            if !(position.clamp(min, max).distance(position) <= reach) {
                continue;
            }
        }
        let child = match group.link(index, fields.leaves & (1 << octant) != 0) {
            ChildLink::Leaf { offset, count } => Visit::Leaf {
                node_page: page,
                page: view.fields().surfel_page,
                place: (offset, count),
                frame: group.leaf_frame(index),
            },
            ChildLink::Group(offset) => Visit::Group { page, offset, depth: depth + 1 },
            ChildLink::External(link) => {
                let Some(link) = view.external_link(link) else {
                    return Err(invalid(reader, page, "link: index", link, "an external link"));
                };
                Visit::Group { page: link.page, offset: link.offset, depth: depth + 1 }
            }
        };
        stack.push(child);
    }
    stack[start..].reverse();
    Ok(())
}

/// Decodes the leaf of so many surfels at a byte of a page; false where that page is skipped.
fn read_leaf(
    reader: &mut Reader<'_>,
    page: PageId,
    place: (u32, u32),
    frame: &Aabb,
    out: &mut Vec<LeafSurfel>,
) -> Result<bool, StoreError> {
    let layout = reader.octree().layout();
    let Some(pinned) = reader.pin_sound_page(page)? else { return Ok(false) };
    let leaf = SurfelPage::new(pinned.bytes())
        .and_then(|view| view.leaf(place, frame, &layout))
        .map_err(|e| reader.invalid_page(page, e))?;
    out.clear();
    out.extend((0..leaf.count()).map(|index| leaf.surfel(index)));
    Ok(true)
}

fn invalid(
    reader: &Reader<'_>,
    page: PageId,
    place: &'static str,
    found: impl ToString,
    expected: impl ToString,
) -> StoreError {
    let (found, expected) = (found.to_string(), expected.to_string());
    reader.invalid_page(page, FormatError { place, found, expected })
}
