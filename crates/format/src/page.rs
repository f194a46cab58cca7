//! Pages: node pages hold groups, surfel pages the surfels of their leaves.

use crate::bits::SLACK_BYTES;
use crate::{
    COORDINATE_MAX, Channels, ChildLink, FormatError, GroupFields, GroupView, LeafView, PageId,
    SurfelLayout, read_u32,
};
use pbgi_math::Aabb;

/// What a page holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum PageKind {
    /// A treelet of groups.
    Nodes = 1,
    /// Surfels.
    Surfels = 2,
}

impl PageKind {
    pub(crate) fn from_code(code: u32) -> Result<Self, FormatError> {
        match code {
            1 => Ok(Self::Nodes),
            2 => Ok(Self::Surfels),
            _ => Err(FormatError::new("page kind", code, "1 (nodes) or 2 (surfels)")),
        }
    }
}

/// Bytes before the first group of a node page.
pub const NODE_PAGE_HEADER_BYTES: usize = 32;

/// Bytes before the first leaf of a surfel page.
pub const SURFEL_PAGE_HEADER_BYTES: usize = 16;

/// Bytes of a surfel page besides its leaves.
pub const SURFEL_PAGE_FIXED_BYTES: usize = SURFEL_PAGE_HEADER_BYTES + SLACK_BYTES;

/// A link to a group in another page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExternalLink {
    /// The page.
    pub page: PageId,
    /// Byte offset of the group in it.
    pub offset: u32,
}

/// Header fields of a node page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodePageFields {
    /// Groups in the page.
    pub group_count: u32,
    /// Page of the leaves' surfels, if there are leaves.
    pub surfel_page: Option<PageId>,
}

/// Completes a node page: `page` starts with [`NODE_PAGE_HEADER_BYTES`] zero bytes and the groups;
/// the header is filled in and the external links are appended. Links lead to pages of smaller numbers than `own`, the
/// page's, and are stored as the difference, so that a subtree's pages are the same wherever they lie in the file.
pub fn finish_node_page(
    page: &mut Vec<u8>,
    own: PageId,
    fields: NodePageFields,
    links: &[ExternalLink],
) {
    let links_offset = page.len() as u32;
    for link in links {
        page.extend_from_slice(&(own.0 - link.page.0).to_le_bytes());
        page.extend_from_slice(&link.offset.to_le_bytes());
    }
    let surfel_page = fields.surfel_page.map_or(0, |p| own.0 - p.0);
    for (i, value) in
        [PageKind::Nodes as u32, fields.group_count, surfel_page, links_offset, links.len() as u32]
            .into_iter()
            .enumerate()
    {
        page[4 * i..4 * i + 4].copy_from_slice(&value.to_le_bytes());
    }
}

/// Completes a surfel page: `page` starts with [`SURFEL_PAGE_HEADER_BYTES`] zero bytes and the leaves; the header is
/// filled in, and bytes that a reader may load past the last surfel are appended.
pub fn finish_surfel_page(page: &mut Vec<u8>, surfel_count: u32) {
    page[..4].copy_from_slice(&(PageKind::Surfels as u32).to_le_bytes());
    page[4..8].copy_from_slice(&surfel_count.to_le_bytes());
    page.extend_from_slice(&[0; SLACK_BYTES]);
}

/// A decoded node page.
#[derive(Clone, Copy, Debug)]
pub struct NodePage<'a> {
    bytes: &'a [u8],
    own: PageId,
    links_offset: u32,
    link_count: u32,
}

impl<'a> NodePage<'a> {
    /// Views page `own`, whose checksum is already verified.
    ///
    /// # Errors
    ///
    /// If the header contradicts the page's size.
    pub fn new(bytes: &'a [u8], own: PageId) -> Result<Self, FormatError> {
        if bytes.len() < NODE_PAGE_HEADER_BYTES {
            return Err(FormatError::new("node page: bytes", bytes.len(), "at least 32"));
        }
        if read_u32(bytes, 0) != PageKind::Nodes as u32 {
            return Err(FormatError::new("node page: kind", read_u32(bytes, 0), 1));
        }
        let (links_offset, link_count) = (read_u32(bytes, 12), read_u32(bytes, 16));
        let end = u64::from(links_offset) + 8 * u64::from(link_count);
        if (links_offset as usize) < NODE_PAGE_HEADER_BYTES || end != bytes.len() as u64 {
            return Err(FormatError::new("node page: end of links", end, bytes.len()));
        }
        if bytes[20..32].iter().any(|&b| b != 0) {
            return Err(FormatError::new("node page: reserved", "non-zero bytes", 0));
        }
        Ok(Self { bytes, own, links_offset, link_count })
    }

    /// Checks what keeps a walk from going on for ever: that the groups lie without gaps, and that each link within the page leads to a
    /// later group, and no two links to one. Also that boxes are numbers that can be reckoned with. One pass over the page.
    ///
    /// # Errors
    ///
    /// Names the first place where it is otherwise.
    pub fn check_links(&self, channels: Channels) -> Result<(), FormatError> {
        let end = self.groups_end();
        let (mut offset, mut count) = (NODE_PAGE_HEADER_BYTES, 0u32);
        let mut links_used = vec![false; self.link_count as usize];
        // A bit for each place where a group may start, set where a link leads to it.
        let mut linked = vec![0u64; end.div_ceil(4 * 64)];
        let mut linked_count = 0u32;
        while offset < end {
            let group = GroupView::new(self.bytes, end, offset as u32, channels)?;
            let bit = |at: usize| (at / 256, 1u64 << (at / 4 % 64));
            let (word, mask) = bit(offset);
            if linked[word] & mask != 0 {
                linked[word] &= !mask;
                linked_count -= 1;
            }
            let fields = group.fields();
            check_box(&fields)?;
            let octants = (0..8).filter(|octant| fields.octants & (1 << octant) != 0);
            for (index, octant) in octants.enumerate() {
                match group.link(index, fields.leaves & (1 << octant) != 0) {
                    ChildLink::Leaf { .. } => {}
                    ChildLink::External(link) => match links_used.get_mut(link as usize) {
                        Some(used) if !*used => *used = true,
                        _ => {
                            let expected = "an external link that is used once";
                            return Err(FormatError::new("link: index", link, expected));
                        }
                    },
                    ChildLink::Group(next) => {
                        let at = next as usize;
                        if at <= offset || at >= end || !at.is_multiple_of(4) {
                            return Err(FormatError::new("link: offset", next, "a later group"));
                        }
                        let (word, mask) = bit(at);
                        if linked[word] & mask != 0 {
                            let expected = "a group that is linked once";
                            return Err(FormatError::new("link: offset", next, expected));
                        }
                        linked[word] |= mask;
                        linked_count += 1;
                    }
                }
            }
            offset += group.stored_bytes();
            count += 1;
        }
        if linked_count > 0 {
            return Err(FormatError::new("link: offset", linked_count, "only links to groups"));
        }
        let stated = read_u32(self.bytes, 4);
        if count != stated {
            return Err(FormatError::new("node page: groups", stated, count));
        }
        self.check_external_links()
    }

    /// No two external links lead to one group.
    fn check_external_links(&self) -> Result<(), FormatError> {
        let place = |index: u32| {
            let at = self.links_offset as usize + 8 * index as usize;
            (read_u32(self.bytes, at), read_u32(self.bytes, at + 4))
        };
        let mut places: Vec<(u32, u32)> = (0..self.link_count).map(place).collect();
        places.sort_unstable();
        match places.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => {
                let expected = "a group that is linked once";
                Err(FormatError::new("link: offset", pair[0].1, expected))
            }
            None => Ok(()),
        }
    }

    /// The whole page.
    #[must_use]
    #[inline(always)]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// First byte after the groups.
    #[must_use]
    #[inline(always)]
    pub fn groups_end(&self) -> usize {
        self.links_offset as usize
    }

    /// Header fields.
    #[must_use]
    #[inline(always)]
    pub fn fields(&self) -> NodePageFields {
        NodePageFields {
            group_count: read_u32(self.bytes, 4),
            surfel_page: self.pages_back(read_u32(self.bytes, 8)),
        }
    }

    /// The page so many before this one, if there is one.
    #[inline(always)]
    fn pages_back(&self, distance: u32) -> Option<PageId> {
        (1..=self.own.0).contains(&distance).then(|| PageId(self.own.0 - distance))
    }

    /// External link `index`, if there is one and it leads to a page before this one.
    #[must_use]
    #[inline(always)]
    pub fn external_link(&self, index: u32) -> Option<ExternalLink> {
        if index >= self.link_count {
            return None;
        }
        let at = self.links_offset as usize + 8 * index as usize;
        let page = self.pages_back(read_u32(self.bytes, at))?;
        Some(ExternalLink { page, offset: read_u32(self.bytes, at + 4) })
    }
}

/// Refuses boxes that are none, or whose sizes cannot be squared.
fn check_box(fields: &GroupFields) -> Result<(), FormatError> {
    let Aabb { min, max } = fields.bounds;
    let largest = min.abs().max(max.abs()).max_element();
    if !(largest <= COORDINATE_MAX && fields.cover_margin <= 4.0 * COORDINATE_MAX) {
        let expected = format_args!("within {COORDINATE_MAX}");
        return Err(FormatError::new("group: box", "a number out of range", expected));
    }
    Ok(())
}

/// A decoded surfel page.
#[derive(Clone, Copy, Debug)]
pub struct SurfelPage<'a> {
    bytes: &'a [u8],
}

impl<'a> SurfelPage<'a> {
    /// Views a page whose checksum is already verified.
    ///
    /// # Errors
    ///
    /// If the header is not that of a surfel page.
    pub fn new(bytes: &'a [u8]) -> Result<Self, FormatError> {
        if bytes.len() < SURFEL_PAGE_FIXED_BYTES {
            return Err(FormatError::new("surfel page: bytes", bytes.len(), "at least 24"));
        }
        if read_u32(bytes, 0) != PageKind::Surfels as u32 {
            return Err(FormatError::new("surfel page: kind", read_u32(bytes, 0), 2));
        }
        let padding = &bytes[bytes.len() - SLACK_BYTES..];
        if bytes[8..SURFEL_PAGE_HEADER_BYTES].iter().chain(padding).any(|&b| b != 0) {
            return Err(FormatError::new("surfel page: reserved", "non-zero bytes", 0));
        }
        Ok(Self { bytes })
    }

    /// Surfels in the page.
    #[must_use]
    pub fn surfel_count(&self) -> u32 {
        read_u32(self.bytes, 4)
    }

    /// The leaf of `count` surfels at byte `offset`; positions refer to `frame` ([`crate::GroupView::leaf_frame`]).
    ///
    /// # Errors
    ///
    /// If the leaf is not wholly inside the page.
    #[inline(always)]
    pub fn leaf(
        &self,
        (offset, count): (u32, u32),
        frame: &Aabb,
        layout: &SurfelLayout,
    ) -> Result<LeafView<'a>, FormatError> {
        LeafView::new(self.bytes, (offset, count), frame, layout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ChildBox, Lobe, MiniFloat};
    use pbgi_math::Vec3;

    #[test]
    fn node_pages_round_trip_and_refuse_bad_links() {
        let mut page = vec![0; NODE_PAGE_HEADER_BYTES + 8];
        let fields = NodePageFields { group_count: 1, surfel_page: Some(PageId(3)) };
        let link = ExternalLink { page: PageId(9), offset: 96 };
        finish_node_page(&mut page, PageId(12), fields, &[link]);
        // The distances are stored.
        assert_eq!((page[8], page[40]), (9, 3));
        let view = NodePage::new(&page, PageId(12)).unwrap();
        assert_eq!(view.fields(), fields);
        assert_eq!(view.external_link(0), Some(link));
        assert_eq!(view.external_link(1), None);
        assert_eq!(view.groups_end(), 40);
        for length in 0..page.len() {
            assert!(NodePage::new(&page[..length], PageId(12)).is_err());
        }
        // Pages before the first are none.
        assert_eq!(NodePage::new(&page, PageId(2)).unwrap().external_link(0), None);
        let moved = NodePage::new(&page, PageId(9)).unwrap();
        assert_eq!(moved.fields().surfel_page, Some(PageId(0)));
    }

    /// A page of groups whose two children are as given, offsets counted in groups.
    fn page_of(groups: &[[ChildLink; 2]], links: &[ExternalLink]) -> Vec<u8> {
        let size = crate::group_bytes(2, &[Lobe::default(); 2], Channels::Occlusion) as u32;
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let mut page = vec![0; NODE_PAGE_HEADER_BYTES];
        for children in groups {
            let is_leaf = |link: &ChildLink| u8::from(matches!(link, ChildLink::Leaf { .. }));
            let leaves = is_leaf(&children[0]) | is_leaf(&children[1]) << 1;
            let (split, cover_margin) = (Vec3::splat(0.5), 0.0);
            let fields = GroupFields { bounds, split, cover_margin, octants: 3, leaves };
            let place = |link: ChildLink| match link {
                ChildLink::Group(n) => ChildLink::Group(NODE_PAGE_HEADER_BYTES as u32 + n * size),
                link => link,
            };
            let lobe = [Lobe::default()];
            let child_box = ChildBox { min: [0; 3], max: [255; 3] };
            let children = children.map(|link| (place(link), child_box, &lobe[..]));
            let codecs = (Channels::Occlusion, MiniFloat { exponent_max: 0 }, 1.0);
            crate::write_group(&fields, &children, codecs, &mut page);
        }
        let group_count = groups.len() as u32;
        let fields = NodePageFields { group_count, surfel_page: Some(PageId(0)) };
        finish_node_page(&mut page, PageId(9), fields, links);
        page
    }

    #[test]
    fn links_that_form_no_tree_are_refused() {
        use ChildLink::{External, Group};
        let leaf = ChildLink::Leaf { offset: 16, count: 1 };
        let check = |groups: &[[ChildLink; 2]], links: &[ExternalLink]| {
            let page = page_of(groups, links);
            NodePage::new(&page, PageId(9)).unwrap().check_links(Channels::Occlusion)
        };
        let far = |page| ExternalLink { page: PageId(page), offset: 32 };
        check(&[[Group(1), Group(2)], [leaf, leaf], [leaf, External(0)]], &[far(3)]).unwrap();
        check(&[[leaf, External(1)], [leaf, External(0)]], &[far(3), far(4)]).unwrap();
        for (bad, links) in [
            (vec![[Group(1), Group(1)], [leaf, leaf]], vec![]),
            (vec![[Group(1), Group(2)], [Group(2), leaf], [leaf, leaf]], vec![]),
            (vec![[Group(1), leaf], [Group(0), leaf]], vec![]),
            (vec![[Group(0), leaf]], vec![]),
            (vec![[Group(1), leaf]], vec![]),
            (vec![[External(0), External(0)]], vec![far(3), far(4)]),
            (vec![[External(1), leaf]], vec![far(3)]),
            (vec![[External(0), External(1)]], vec![far(3), far(3)]),
        ] {
            assert!(check(&bad, &links).is_err(), "{bad:?} {links:?}");
        }
    }

    #[test]
    fn surfel_pages_refuse_what_is_none() {
        let mut page = vec![0; SURFEL_PAGE_HEADER_BYTES + 3];
        finish_surfel_page(&mut page, 7);
        assert_eq!(SurfelPage::new(&page).unwrap().surfel_count(), 7);
        assert!(SurfelPage::new(&page[..page.len() - 4]).is_err());
        for at in [0, 8, 15, page.len() - 1] {
            let mut bad = page.clone();
            bad[at] ^= 1;
            assert!(SurfelPage::new(&bad).is_err(), "{at}");
        }
    }
}
