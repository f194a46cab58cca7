//! Pages in memory, as they will lie in the file.

use crate::error::BuildError;
use crate::pack::{Group, pack_treelets};
use pbgi_format::{
    ExternalLink, NodePageFields, PAGE_ALIGNMENT, PageEntry, PageId, PageKind, SurfelLayout,
    finish_node_page, finish_surfel_page, page_checksum,
};

/// Where treelets become pages.
pub(crate) trait PageSink {
    /// Writes treelets as a node page, after the page of their surfels if they have any, and says where their roots lie.
    fn write_treelets(
        &mut self,
        roots: &[&Group],
        layout: &SurfelLayout,
    ) -> Result<Vec<ExternalLink>, BuildError>;
}

/// Pages that follow one another in the file. As links are relative, they are the same wherever that will be.
pub(crate) struct PageBatch {
    /// Number of its first page.
    first: u32,
    compress: bool,
    /// Pages as stored, each aligned.
    pub bytes: Vec<u8>,
    /// Their entries, with offsets in `bytes`.
    pub entries: Vec<PageEntry>,
    /// Bytes of stored surfels.
    pub surfel_bytes: u64,
}

impl PageBatch {
    /// No pages yet; the first will have the number `first`.
    pub fn new(first: u32, compress: bool) -> Self {
        Self { first, compress, bytes: Vec::new(), entries: Vec::new(), surfel_bytes: 0 }
    }

    fn next_page(&self) -> Result<PageId, BuildError> {
        let next = u32::try_from(self.entries.len()).ok().and_then(|n| self.first.checked_add(n));
        let next = next.filter(|&next| next < u32::MAX);
        next.map(PageId).ok_or(BuildError::TooManyPages { limit: u64::from(u32::MAX) })
    }

    fn add_page(&mut self, kind: PageKind, decoded: &[u8]) {
        let packed = self.compress.then(|| lz4_flex::block::compress(decoded));
        let stored = match &packed {
            Some(smaller) if smaller.len() < decoded.len() => smaller,
            _ => decoded,
        };
        self.bytes.resize(self.bytes.len().next_multiple_of(PAGE_ALIGNMENT as usize), 0);
        self.entries.push(PageEntry {
            offset: self.bytes.len() as u64,
            stored_bytes: stored.len() as u32,
            decoded_bytes: decoded.len() as u32,
            checksum: page_checksum(stored),
            kind,
        });
        self.bytes.extend_from_slice(stored);
    }
}

impl PageSink for PageBatch {
    fn write_treelets(
        &mut self,
        roots: &[&Group],
        layout: &SurfelLayout,
    ) -> Result<Vec<ExternalLink>, BuildError> {
        let mut packed = pack_treelets(roots, layout);
        let mut surfel_page = None;
        if packed.surfel_count > 0 {
            self.surfel_bytes += packed.surfels.len() as u64;
            finish_surfel_page(&mut packed.surfels, packed.surfel_count);
            surfel_page = Some(self.next_page()?);
            self.add_page(PageKind::Surfels, &packed.surfels);
        }
        let page = self.next_page()?;
        let fields = NodePageFields { group_count: packed.group_count, surfel_page };
        finish_node_page(&mut packed.nodes, page, fields, &packed.links);
        self.add_page(PageKind::Nodes, &packed.nodes);
        Ok(packed.root_offsets.iter().map(|&offset| ExternalLink { page, offset }).collect())
    }
}
