//! One node page with the surfels of its leaves.

use super::LevelCounts;
use super::batch::{Facts, Link, Root, count, take_surfels};
use crate::error::StoreError;
use crate::octree::Octree;
use pbgi_format::{
    ChildLink, GroupFields, GroupView, LOBES_MAX, Lobe, NODE_PAGE_HEADER_BYTES, NodePage, PageId,
    SurfelPage,
};
use pbgi_math::Aabb;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// What a group's parent in the page says of it.
struct Parent {
    stored: Aabb,
    extent: f32,
    root: usize,
    depth: usize,
}

/// A node page under way.
pub(super) struct NodeCheck<'a> {
    octree: &'a Octree,
    id: PageId,
    view: NodePage<'a>,
    surfels: Option<(PageId, Cow<'a, [u8]>)>,
    /// Surfels of the leaves so far.
    surfel_count: u64,
    /// Groups further on that were linked to.
    linked: BTreeMap<u32, Parent>,
    facts: &'a mut Facts,
}

/// Where a group is in the tree of its page.
#[derive(Clone, Copy)]
struct Place {
    root: usize,
    depth: usize,
}

impl<'a> NodeCheck<'a> {
    /// Checks a page; its surfels are among `surfels`, and are taken from there.
    pub fn run<'b: 'a>(
        octree: &'a Octree,
        id: PageId,
        bytes: &'a [u8],
        surfels: &mut Vec<(PageId, Cow<'b, [u8]>)>,
        facts: &'a mut Facts,
    ) -> Result<(), StoreError> {
        let view = NodePage::new(bytes, id).map_err(|source| octree.invalid_page(id, source))?;
        let take = |page| Ok((page, take_surfels(octree, id, page, surfels)?));
        let surfels = view.fields().surfel_page.map(take).transpose()?;
        let linked = BTreeMap::new();
        Self { octree, id, view, surfels, surfel_count: 0, linked, facts }.check_groups()
    }

    fn invalid(
        &self,
        place: &'static str,
        found: impl ToString,
        expected: impl ToString,
    ) -> StoreError {
        self.octree.invalid(self.id, place, found, expected)
    }

    /// Checks all groups in their order: what links to a group in its page stands before it.
    fn check_groups(mut self) -> Result<(), StoreError> {
        let channels = self.octree.header().channels;
        let (mut offset, mut groups) = (NODE_PAGE_HEADER_BYTES as u32, 0u32);
        while (offset as usize) < self.view.groups_end() {
            let bytes = self.view.bytes();
            let group = GroupView::new(bytes, self.view.groups_end(), offset, channels)
                .map_err(|source| self.octree.invalid_page(self.id, source))?;
            self.check_group(offset, &group)?;
            offset += group.stored_bytes() as u32;
            groups += 1;
        }
        if let Some((&offset, _)) = self.linked.first_key_value() {
            return Err(self.invalid("link: offset", offset, "a group of the page"));
        }
        let expected = self.view.fields().group_count;
        if groups != expected {
            return Err(self.invalid("node page: groups", expected, groups));
        }
        if let Some((id, bytes)) = &self.surfels {
            let said = SurfelPage::new(bytes).map_or(0, |page| page.surfel_count());
            if u64::from(said) != self.surfel_count {
                let (place, found) = ("surfel page: surfels", said);
                return Err(self.octree.invalid(*id, place, found, self.surfel_count));
            }
        }
        Ok(())
    }

    fn check_group(&mut self, offset: u32, group: &GroupView<'_>) -> Result<(), StoreError> {
        let fields = group.fields();
        let place = match self.linked.remove(&offset) {
            Some(parent) => {
                if !holds(&parent.stored, parent.extent, &fields.bounds) {
                    return Err(self.invalid("group: box", "outside its parent's", "inside"));
                }
                Place { root: parent.root, depth: parent.depth + 1 }
            }
            None => {
                let (page, bounds, levels) = (self.id, fields.bounds, Vec::new());
                self.facts.roots.push(Root { page, offset, bounds, levels });
                Place { root: self.facts.roots.len() - 1, depth: 0 }
            }
        };
        self.check_fields(&fields)?;
        if place.depth >= self.octree.header().depth as usize {
            let found = place.depth + 1;
            return Err(self.invalid("tree: depth", found, self.octree.header().depth));
        }
        self.level(place).groups += 1;
        let octants = (0..8).filter(|octant| fields.octants & (1 << octant) != 0);
        for (index, octant) in octants.enumerate() {
            self.facts.nodes += 1;
            self.check_lobes(group, index)?;
            let link = group.link(index, fields.leaves & (1 << octant) != 0);
            self.check_child(offset, group, (index, link), place)?;
        }
        Ok(())
    }

    fn check_fields(&self, fields: &GroupFields) -> Result<(), StoreError> {
        let Aabb { min, max } = fields.bounds;
        if fields.bounds.is_empty() || !min.is_finite() || !max.is_finite() {
            return Err(self.invalid("group: box", "not finite or empty", "a box"));
        }
        if !(fields.cover_margin >= 0.0) || fields.leaves & !fields.octants != 0 {
            return Err(self.invalid("group: margin or leaves", "out of range", "valid"));
        }
        Ok(())
    }

    fn level(&mut self, place: Place) -> &mut LevelCounts {
        let levels = &mut self.facts.roots[place.root].levels;
        if levels.len() <= place.depth {
            levels.resize(place.depth + 1, LevelCounts::default());
        }
        &mut levels[place.depth]
    }

    fn check_lobes(&mut self, group: &GroupView<'_>, index: usize) -> Result<(), StoreError> {
        let channels = self.octree.header().channels;
        let lobes = group.lobe_bytes(index, channels).len() / Lobe::stored_bytes(channels);
        if lobes == 0 || lobes > LOBES_MAX {
            return Err(self.invalid("group: lobes", lobes, "1 to 4"));
        }
        self.facts.lobe_counts[lobes] += 1;
        Ok(())
    }

    /// Checks the link of child `index` of the group at `offset`.
    fn check_child(
        &mut self,
        offset: u32,
        group: &GroupView<'_>,
        (index, link): (usize, ChildLink),
        place: Place,
    ) -> Result<(), StoreError> {
        let stored = group.child_bounds(index);
        let extent = group.fields().bounds.extent().max_element();
        let Place { root, depth } = place;
        match link {
            ChildLink::Leaf { offset, count } => {
                self.check_leaf((offset, count), &group.leaf_frame(index), place)?;
            }
            ChildLink::Group(next) if next <= offset => {
                return Err(self.invalid("link: offset", next, "a later group"));
            }
            ChildLink::Group(next) => {
                let parent = Parent { stored, extent, root, depth };
                if self.linked.insert(next, parent).is_some() {
                    return Err(self.invalid("link: offset", next, "a group that is linked once"));
                }
            }
            ChildLink::External(link) => {
                let Some(link) = self.view.external_link(link) else {
                    return Err(self.invalid("link: index", link, "a link to an earlier page"));
                };
                let (page, offset) = (link.page, link.offset);
                self.facts.links.push(Link { page, offset, stored, extent, from: root, depth });
            }
        }
        Ok(())
    }

    fn check_leaf(
        &mut self,
        range: (u32, u32),
        frame: &Aabb,
        place: Place,
    ) -> Result<(), StoreError> {
        let Some((id, bytes)) = &self.surfels else {
            return Err(self.invalid("leaf: surfel page", "none", "a surfel page"));
        };
        let layout = self.octree.layout();
        let leaf = SurfelPage::new(bytes)
            .and_then(|page| page.leaf(range, frame, &layout))
            .map_err(|source| self.octree.invalid_page(*id, source))?;
        for index in 0..leaf.count() {
            let (radius, area) = leaf.size(index);
            let sound = radius > 0.0 && radius.is_finite() && area > 0.0;
            if !(sound && leaf.center(index).is_finite()) {
                return Err(self.octree.invalid(*id, "surfel", "radius or area 0", "above 0"));
            }
        }
        let surfels = u64::from(leaf.count());
        self.surfel_count += surfels;
        self.facts.leaves += 1;
        count(&mut self.facts.leaf_sizes, surfels as usize);
        let level = self.level(place);
        level.leaves += 1;
        level.surfels += surfels;
        Ok(())
    }
}

/// Whether a child's box lies in the one its parent stored for it, which is rounded to the nearest step of the parent's.
pub(super) fn holds(stored: &Aabb, extent: f32, bounds: &Aabb) -> bool {
    stored.inflated(0.51 / 255.0 * extent).contains_box(bounds)
}
