//! From closed nodes to pages: treelets grow bottom-up to a few levels, and neighbors among those that hang on one treelet share a page.
//!
//! A walk opens about as many groups of each level, those around the receiver. Of a treelet as large as a page it opens the root and little else;
//! of neighbors that are a few levels high it opens more, and fewer bytes are read for the same groups.

use crate::aggregate::NodeAggregate;
use crate::reduce::LobeReducer;
use pbgi_cloud::Surfel;
use pbgi_format::{
    Channels, ChildBox, ChildLink, ExternalLink, GroupFields, LeafWriter, Lobe,
    NODE_PAGE_HEADER_BYTES, SURFEL_PAGE_FIXED_BYTES, SURFEL_PAGE_HEADER_BYTES, SurfelFields,
    SurfelLayout, group_bytes, write_group,
};
use std::borrow::Cow;
use std::vec::Drain;

/// A closed node that waits for its parent.
pub(crate) struct PendingNode<'s> {
    pub aggregate: NodeAggregate,
    pub content: PendingContent<'s>,
}

/// Radiance over that of the layout's scale below which a [`pbgi_math::SharedExponent`] has no more than five bits left.
const DIM: f32 = 1.0 / (1 << 19) as f32;

pub(crate) enum PendingContent<'s> {
    Leaf(Cow<'s, [Surfel]>),
    Group(Box<Group>),
}

impl<'s> PendingNode<'s> {
    /// A leaf of at least one surfel.
    pub fn leaf(reducer: &mut LobeReducer, surfels: Cow<'s, [Surfel]>) -> Self {
        let aggregate = NodeAggregate::from_surfels_with(reducer, &surfels);
        Self { aggregate, content: PendingContent::Leaf(surfels) }
    }

    /// Surfels of a leaf that shine, but so little beside the brightest of the file that lobes of their kind lose more than 1.6 % of their
    /// light, or all of it.
    pub fn count_dim(&self, layout: &SurfelLayout) -> u64 {
        let PendingContent::Leaf(surfels) = &self.content else { return 0 };
        if layout.channels == Channels::Occlusion {
            return 0;
        }
        let least = layout.radiance_scale * DIM;
        let brightness = |s: &Surfel| s.radiance.into_iter().fold(0.0, f32::max);
        let is_dim = |s: &&Surfel| brightness(s) > 0.0 && brightness(s) < least;
        surfels.iter().filter(is_dim).count() as u64
    }

    /// Numbers the pages below anew: each gets `by` more.
    pub fn move_pages(&mut self, by: u32) {
        if let PendingContent::Group(group) = &mut self.content {
            group.move_pages(by);
        }
    }
}

/// Where the contents of a group's child are.
enum ChildContent {
    /// So many surfels, encoded; `end` is one past the last byte among those of the group's leaves.
    Leaf { end: usize, count: u32 },
    /// A group of the same treelet.
    Group(Box<Group>),
    /// The root of another treelet, which waits for its neighbors.
    Waiting(Box<Group>),
    /// A group in a finished page.
    External(ExternalLink),
}

struct Child {
    stored_box: ChildBox,
    /// One past its last lobe among those of the group.
    lobes_end: usize,
    content: ChildContent,
}

impl ChildContent {
    /// A leaf without surfels.
    const NONE: Self = Self::Leaf { end: 0, count: 0 };
}

/// Turns treelets into a page and says where their roots lie.
pub(crate) type WriteTreelets<'w, E> = dyn FnMut(&[&Group]) -> Result<Vec<ExternalLink>, E> + 'w;

/// A treelet closes when it is larger than this part of a page; it then has two or three levels. With a cache of 2.3 % of the file, bytes are read
/// 3.3, 2.6 and 2.1 times at 4, 8 and 16; at 16 there are twice as many pages as at 8, and the page table is twice as large.
const TREELETS_PER_PAGE: usize = 8;

/// Bytes of a link to another page.
const EXTERNAL_LINK_BYTES: usize = 8;

/// A group of a treelet that is not yet in a page.
pub(crate) struct Group {
    fields: GroupFields,
    children: Vec<Child>,
    /// Lobes of all children.
    lobes: Vec<Lobe>,
    /// Encoded surfels of the children that are leaves.
    leaf_bytes: Vec<u8>,
    /// Bytes of the whole treelet's groups.
    groups_bytes: usize,
    /// Bytes of the whole treelet's links to other pages.
    link_bytes: usize,
    /// Bytes of the whole treelet's surfels.
    surfel_bytes: usize,
    /// Groups on the longest way down.
    pub depth: u32,
}

impl Group {
    /// Group over closed nodes, given with their octants in ascending order.
    pub fn new(
        split: pbgi_math::Vec3,
        aggregate: &NodeAggregate,
        nodes: Drain<'_, (u32, PendingNode<'_>)>,
        layout: &SurfelLayout,
        writer: &mut LeafWriter,
    ) -> Self {
        let bounds = aggregate.bounds;
        let mut fields = GroupFields {
            bounds,
            split,
            // Half a step of the boxes' rounding.
            cover_margin: aggregate.cover_margin + bounds.extent().max_element() / 510.0,
            octants: 0,
            leaves: 0,
        };
        let mut children = Vec::with_capacity(nodes.len());
        let lobe_count = nodes.as_slice().iter().map(|(_, node)| node.aggregate.lobes.len()).sum();
        let mut lobes = Vec::with_capacity(lobe_count);
        let mut leaf_bytes = Vec::with_capacity(leaf_bytes_guess(nodes.as_slice()));
        let mut depth = 0;
        for (octant, node) in nodes {
            fields.octants |= 1 << octant;
            let stored_box = ChildBox::around(&node.aggregate.bounds, &bounds);
            let content = match node.content {
                PendingContent::Leaf(surfels) => {
                    fields.leaves |= 1 << octant;
                    push_surfels(&surfels, layout, writer);
                    writer.finish(&stored_box.leaf_frame(&bounds), layout, &mut leaf_bytes);
                    ChildContent::Leaf { end: leaf_bytes.len(), count: surfels.len() as u32 }
                }
                PendingContent::Group(group) => {
                    depth = depth.max(group.depth);
                    ChildContent::Group(group)
                }
            };
            let decoded = stored_box.decode(&bounds);
            lobes.extend(node.aggregate.lobes.iter().map(|l| l.to_lobe(&decoded)));
            children.push(Child { stored_box, lobes_end: lobes.len(), content });
        }
        let mut group = Self {
            fields,
            children,
            lobes,
            leaf_bytes,
            groups_bytes: 0,
            link_bytes: 0,
            surfel_bytes: 0,
            depth: depth + 1,
        };
        group.measure(layout);
        group
    }

    fn move_pages(&mut self, by: u32) {
        for child in &mut self.children {
            match &mut child.content {
                ChildContent::External(link) => link.page.0 += by,
                ChildContent::Group(group) | ChildContent::Waiting(group) => group.move_pages(by),
                ChildContent::Leaf { .. } => {}
            }
        }
    }

    /// Children that are leaves, and all children.
    pub fn counts(&self) -> (u64, u64) {
        (u64::from(self.fields.leaves.count_ones()), self.children.len() as u64)
    }

    /// Bytes of this group alone: (without lobes, of lobes).
    pub fn own_bytes(&self, layout: &SurfelLayout) -> (u64, u64) {
        let (children, channels) = (self.children.len(), layout.channels);
        let all = group_bytes(children, &self.lobes, channels);
        let hot = group_bytes(children, &[], channels);
        (hot as u64, (all - hot) as u64)
    }

    fn measure(&mut self, layout: &SurfelLayout) {
        let (hot, lobes) = self.own_bytes(layout);
        self.groups_bytes = (hot + lobes) as usize;
        (self.link_bytes, self.surfel_bytes) = (0, self.leaf_bytes.len());
        for child in &self.children {
            match &child.content {
                ChildContent::Leaf { .. } => {}
                ChildContent::Group(group) => {
                    self.groups_bytes += group.groups_bytes;
                    self.link_bytes += group.link_bytes;
                    self.surfel_bytes += group.surfel_bytes;
                }
                ChildContent::Waiting(_) | ChildContent::External(_) => {
                    self.link_bytes += EXTERNAL_LINK_BYTES;
                }
            }
        }
    }

    /// Bytes of the whole treelet in a node page.
    fn node_bytes(&self) -> usize {
        self.groups_bytes + self.link_bytes
    }

    /// Whether the treelet has grown enough to begin new ones below its root.
    pub fn is_grown(&self, page_bytes: usize) -> bool {
        self.node_bytes().max(self.surfel_bytes) > page_bytes / TREELETS_PER_PAGE
    }

    /// Makes the children's treelets wait for their neighbors; those that waited for one of them go to pages.
    pub fn close_children<E>(
        &mut self,
        page_bytes: usize,
        layout: &SurfelLayout,
        write: &mut WriteTreelets<'_, E>,
    ) -> Result<(), E> {
        for child in &mut self.children {
            // What stands there meanwhile goes with an error.
            let content = std::mem::replace(&mut child.content, ChildContent::NONE);
            child.content = match content {
                ChildContent::Group(mut group) => {
                    group.flush_waiting(page_bytes, write)?;
                    ChildContent::Waiting(group)
                }
                other => other,
            };
        }
        self.measure(layout);
        Ok(())
    }

    /// Moves all treelets that hang on this one into pages: neighbors share a page as long as they fit.
    pub fn flush_waiting<E>(
        &mut self,
        page_bytes: usize,
        write: &mut WriteTreelets<'_, E>,
    ) -> Result<(), E> {
        let mut waiting = Vec::new();
        self.push_waiting(&mut waiting);
        let mut links = Vec::with_capacity(waiting.len());
        let mut rest = &waiting[..];
        while !rest.is_empty() {
            let (page, after) = rest.split_at(neighbors_that_fit(rest, page_bytes));
            links.extend(write(page)?);
            rest = after;
        }
        self.link_waiting(&mut links.into_iter());
        Ok(())
    }

    fn push_waiting<'g>(&'g self, waiting: &mut Vec<&'g Self>) {
        for child in &self.children {
            match &child.content {
                ChildContent::Group(group) => group.push_waiting(waiting),
                ChildContent::Waiting(group) => waiting.push(group),
                ChildContent::Leaf { .. } | ChildContent::External(_) => {}
            }
        }
    }

    /// Puts links in the places of what waited, in the order of [`Self::push_waiting`].
    fn link_waiting(&mut self, links: &mut impl Iterator<Item = ExternalLink>) {
        for child in &mut self.children {
            match &mut child.content {
                ChildContent::Group(group) => group.link_waiting(links),
                ChildContent::Waiting(_) => {
                    let link = links.next().expect("each treelet has a place");
                    child.content = ChildContent::External(link);
                }
                ChildContent::Leaf { .. } | ChildContent::External(_) => {}
            }
        }
    }
}

/// How many of the first treelets, at least one, go into one pair of pages.
fn neighbors_that_fit(treelets: &[&Group], page_bytes: usize) -> usize {
    let (mut nodes, mut surfels) = (NODE_PAGE_HEADER_BYTES, SURFEL_PAGE_FIXED_BYTES);
    let fits = |group: &&&Group| {
        nodes += group.node_bytes();
        surfels += group.surfel_bytes;
        nodes <= page_bytes && surfels <= page_bytes
    };
    treelets.iter().take_while(fits).count().max(1)
}

/// Room for the surfels of those nodes that are leaves: most take less, and a leaf's own fields as much as a few.
fn leaf_bytes_guess(nodes: &[(u32, PendingNode<'_>)]) -> usize {
    let bytes = |(_, node): &(u32, PendingNode<'_>)| match &node.content {
        PendingContent::Leaf(surfels) => 32 + 8 * surfels.len(),
        PendingContent::Group(_) => 0,
    };
    nodes.iter().map(bytes).sum()
}

fn push_surfels(surfels: &[Surfel], layout: &SurfelLayout, writer: &mut LeafWriter) {
    for surfel in surfels {
        let is_tile = surfel.tile().is_known();
        let size = if is_tile { surfel.half_long() } else { surfel.radius };
        let fields = SurfelFields {
            center: surfel.center(),
            orientation: surfel.orientation,
            foot: surfel.foot(),
            size,
            area: surfel.area,
            radiance: surfel.radiance,
            albedo: surfel.albedo_rgb(),
            isotropic: surfel.is_isotropic(),
            front_only: surfel.is_front_only(),
        };
        writer.push(&fields, layout);
    }
}

/// The bytes of a page pair made of treelets.
pub(crate) struct PackedTreelets {
    /// Node page, header still zero, without links.
    pub nodes: Vec<u8>,
    /// Links to other pages, in the order of their indices.
    pub links: Vec<ExternalLink>,
    /// Surfel page, header still zero.
    pub surfels: Vec<u8>,
    /// Surfels in it.
    pub surfel_count: u32,
    /// Groups in the page.
    pub group_count: u32,
    /// Offsets of the treelets' roots.
    pub root_offsets: Vec<u32>,
}

/// Lays treelets out one after the other, each in depth-first order: a group precedes its children,
/// octants ascending.
pub(crate) fn pack_treelets(roots: &[&Group], layout: &SurfelLayout) -> PackedTreelets {
    let mut packed = PackedTreelets {
        nodes: vec![0; NODE_PAGE_HEADER_BYTES],
        links: Vec::new(),
        surfels: vec![0; SURFEL_PAGE_HEADER_BYTES],
        surfel_count: 0,
        group_count: 0,
        root_offsets: Vec::new(),
    };
    for root in roots {
        packed.root_offsets.push(packed.nodes.len() as u32);
        pack_group(root, layout, &mut packed);
    }
    packed
}

fn pack_group(group: &Group, layout: &SurfelLayout, packed: &mut PackedTreelets) {
    packed.group_count += 1;
    let (hot, lobes) = group.own_bytes(layout);
    // Offsets of child groups follow from the sizes of the treelets before them.
    let mut next_offset = packed.nodes.len() + (hot + lobes) as usize;
    let mut children: Vec<(ChildLink, ChildBox, &[Lobe])> = Vec::with_capacity(8);
    let (mut lobes_start, mut leaf_start) = (0, 0);
    let leaves_offset = packed.surfels.len();
    packed.surfels.extend_from_slice(&group.leaf_bytes);
    for child in &group.children {
        let link = match &child.content {
            ChildContent::Leaf { end, count } => {
                let offset = (leaves_offset + leaf_start) as u32;
                leaf_start = *end;
                packed.surfel_count += count;
                ChildLink::Leaf { offset, count: *count }
            }
            ChildContent::Group(inner) => {
                let link = ChildLink::Group(next_offset as u32);
                next_offset += inner.groups_bytes;
                link
            }
            ChildContent::External(link) => {
                packed.links.push(*link);
                ChildLink::External(packed.links.len() as u32 - 1)
            }
            ChildContent::Waiting(_) => unreachable!("what hangs on a treelet is written first"),
        };
        let lobes = &group.lobes[lobes_start..child.lobes_end];
        lobes_start = child.lobes_end;
        children.push((link, child.stored_box, lobes));
    }
    let codecs = (layout.channels, layout.area, layout.radiance_scale);
    write_group(&group.fields, &children, codecs, &mut packed.nodes);
    for child in &group.children {
        if let ChildContent::Group(inner) = &child.content {
            pack_group(inner, layout, packed);
        }
    }
    debug_assert_eq!(packed.nodes.len(), next_offset);
}
