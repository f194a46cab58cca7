//! Reads every page and checks every invariant a reader relies on.

use crate::error::StoreError;
use crate::octree::Octree;
use pbgi_format::{
    ChildLink, FormatError, GroupView, LOBES_MAX, Lobe, NodePage, PageId, PageKind, SurfelPage,
};

/// Nodes and surfels at one depth of the tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LevelCounts {
    /// Groups.
    pub groups: u64,
    /// Leaves below groups of this depth.
    pub leaves: u64,
    /// Surfels in those leaves.
    pub surfels: u64,
}

/// What a file holds, counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VerifyReport {
    /// By depth: number of groups between a group and the root.
    pub levels: Vec<LevelCounts>,
    /// Leaves by number of surfels.
    pub leaf_sizes: Vec<u64>,
    /// Children by number of lobes.
    pub lobe_counts: [u64; LOBES_MAX + 1],
    /// Pages by decoded size in steps of 4 KiB.
    pub page_sizes: Vec<u64>,
    /// Bytes read.
    pub bytes_read: u64,
}

impl Octree {
    /// Reads the whole file and checks every page's checksum, every link from the root on (that it leads to a whole group or leaf,
    /// and never back), every box (a child's inside its parent's), that every surfel has a place and a size, and the header's totals.
    ///
    /// # Errors
    ///
    /// Names the first damage.
    pub fn verify(&self, mut progress: impl FnMut(u64)) -> Result<VerifyReport, StoreError> {
        let mut report = VerifyReport { leaf_sizes: vec![0; 256], ..VerifyReport::default() };
        let mut surfels = 0;
        for (index, entry) in self.pages().iter().enumerate() {
            let id = PageId(index as u32);
            let page = self.read_page(id, entry)?;
            if entry.kind == PageKind::Surfels {
                let wrap = |source| self.reader().invalid_page(id, source);
                surfels += u64::from(SurfelPage::new(&page).map_err(wrap)?.surfel_count());
            }
            report.bytes_read += u64::from(entry.stored_bytes);
            let class = entry.decoded_bytes as usize / 4096;
            if report.page_sizes.len() <= class {
                report.page_sizes.resize(class + 1, 0);
            }
            report.page_sizes[class] += 1;
            progress(report.bytes_read);
        }
        Walk::run(self, &mut report, surfels)?;
        Ok(report)
    }
}

/// A group still to be visited, with the box its parent stored for it.
struct Visit {
    page: PageId,
    offset: u32,
    depth: usize,
    stored: Option<(pbgi_math::Aabb, f32)>,
}

struct Walk<'a> {
    octree: &'a Octree,
    report: &'a mut VerifyReport,
    /// Pages that were entered from outside, and surfels accounted for.
    surfels: u64,
    nodes: u64,
    leaves: u64,
    groups: u64,
}

impl<'a> Walk<'a> {
    /// `page_surfels` is the sum of what the surfel pages say they hold.
    fn run(
        octree: &'a Octree,
        report: &'a mut VerifyReport,
        page_surfels: u64,
    ) -> Result<(), StoreError> {
        let header = *octree.header();
        let mut walk = Self { octree, report, surfels: 0, nodes: 0, leaves: 0, groups: 0 };
        let mut reader = octree.reader();
        let mut stack = vec![Visit {
            page: header.root_page,
            offset: header.root_offset,
            depth: 0,
            stored: None,
        }];
        while let Some(visit) = stack.pop() {
            if visit.depth >= header.depth as usize || walk.nodes > header.node_count {
                // A cycle, or a tree that is not the header's.
                return Err(walk.invalid(visit.page, "tree: depth", visit.depth, header.depth));
            }
            let page = reader.pin_page(visit.page)?;
            walk.visit_group(&visit, page.bytes(), &mut reader, &mut stack)?;
        }
        walk.check_totals(page_surfels)
    }

    fn invalid(
        &self,
        page: PageId,
        place: &'static str,
        found: impl ToString,
        expected: impl ToString,
    ) -> StoreError {
        let (found, expected) = (found.to_string(), expected.to_string());
        StoreError::InvalidPage {
            path: self.octree.path().to_owned(),
            page,
            source: FormatError { place, found, expected },
        }
    }

    fn visit_group(
        &mut self,
        visit: &Visit,
        bytes: &[u8],
        reader: &mut crate::Reader<'_>,
        stack: &mut Vec<Visit>,
    ) -> Result<(), StoreError> {
        let header = *self.octree.header();
        let page = visit.page;
        if self.octree.pages()[page.0 as usize].kind != PageKind::Nodes {
            return Err(self.invalid(page, "link: page kind", "surfels", "nodes"));
        }
        let wrap = |source| reader.invalid_page(page, source);
        let view = NodePage::new(bytes, page).map_err(wrap)?;
        let wrap = |source| reader.invalid_page(page, source);
        let group = GroupView::new(bytes, view.groups_end(), visit.offset, header.channels)
            .map_err(wrap)?;
        let fields = group.fields();
        if fields.bounds.is_empty()
            || !fields.bounds.min.is_finite()
            || !fields.bounds.max.is_finite()
        {
            return Err(self.invalid(page, "group: box", "not finite or empty", "a box"));
        }
        if let Some((stored, fields_extent)) = visit.stored {
            // Stored boxes are rounded to the nearest step of their group's box.
            let slack = 0.51 / 255.0 * fields_extent;
            if !stored.inflated(slack).contains_box(&fields.bounds) {
                return Err(self.invalid(page, "group: box", "outside its parent's", "inside"));
            }
        }
        if !(fields.cover_margin >= 0.0) || fields.leaves & !fields.octants != 0 {
            return Err(self.invalid(page, "group: margin or leaves", "out of range", "valid"));
        }
        self.groups += 1;
        if self.report.levels.len() <= visit.depth {
            self.report.levels.resize(visit.depth + 1, LevelCounts::default());
        }
        self.report.levels[visit.depth].groups += 1;
        let mut index = 0;
        for octant in 0..8 {
            if fields.octants & (1 << octant) == 0 {
                continue;
            }
            self.nodes += 1;
            self.check_lobes(page, &group, index)?;
            let (mut next_page, mut next_offset) = (page, 0);
            match group.link(index, fields.leaves & (1 << octant) != 0) {
                ChildLink::Leaf { offset, count } => {
                    let frame = group.leaf_frame(index);
                    self.visit_leaf(visit, &view, reader, (offset, count), &frame)?;
                }
                ChildLink::Group(offset) => next_offset = offset,
                ChildLink::External(link) => {
                    let Some(link) = view.external_link(link) else {
                        let expected = "a link to an earlier page";
                        return Err(self.invalid(page, "link: index", link, expected));
                    };
                    (next_page, next_offset) = (link.page, link.offset);
                }
            }
            if next_offset != 0 {
                if next_page == page && next_offset <= visit.offset {
                    return Err(self.invalid(page, "link: offset", next_offset, "a later group"));
                }
                stack.push(Visit {
                    page: next_page,
                    offset: next_offset,
                    depth: visit.depth + 1,
                    stored: Some((group.child_bounds(index), fields.bounds.extent().max_element())),
                });
            }
            index += 1;
        }
        Ok(())
    }

    fn check_lobes(
        &mut self,
        page: PageId,
        group: &GroupView<'_>,
        index: usize,
    ) -> Result<(), StoreError> {
        let channels = self.octree.header().channels;
        let count = group.lobe_bytes(index, channels).len() / Lobe::stored_bytes(channels);
        if count == 0 || count > LOBES_MAX {
            return Err(self.invalid(page, "group: lobes", count, "1 to 4"));
        }
        self.report.lobe_counts[count] += 1;
        Ok(())
    }

    fn visit_leaf(
        &mut self,
        visit: &Visit,
        view: &NodePage<'_>,
        reader: &mut crate::Reader<'_>,
        place: (u32, u32),
        frame: &pbgi_math::Aabb,
    ) -> Result<(), StoreError> {
        let layout = self.octree.layout();
        let Some(id) = view.fields().surfel_page else {
            return Err(self.invalid(visit.page, "leaf: surfel page", "none", "a surfel page"));
        };
        let page = reader.pin_page(id)?;
        let leaf = SurfelPage::new(page.bytes())
            .and_then(|surfels| surfels.leaf(place, frame, &layout))
            .map_err(|source| reader.invalid_page(id, source))?;
        for index in 0..leaf.count() {
            let surfel = leaf.surfel(index);
            let sound = surfel.radius > 0.0 && surfel.radius.is_finite() && surfel.area > 0.0;
            if !(sound && surfel.center.is_finite()) {
                return Err(self.invalid(id, "surfel", "radius or area 0", "above 0"));
            }
        }
        let count = u64::from(leaf.count());
        self.leaves += 1;
        self.surfels += count;
        self.report.leaf_sizes[count as usize] += 1;
        let level = &mut self.report.levels[visit.depth];
        level.leaves += 1;
        level.surfels += count;
        Ok(())
    }

    fn check_totals(&self, page_surfels: u64) -> Result<(), StoreError> {
        let header = self.octree.header();
        for (place, found, expected) in [
            ("header: surfels", self.surfels, header.surfel_count),
            ("surfel pages: surfels", page_surfels, header.surfel_count),
            ("header: nodes", self.nodes, header.node_count),
            ("header: leaves", self.leaves, header.leaf_count),
            ("header: depth", self.report.levels.len() as u64, u64::from(header.depth)),
        ] {
            if found != expected {
                return Err(self.invalid(header.root_page, place, expected, found));
            }
        }
        Ok(())
    }
}
