//! Byte layout of the octree file, over slices only. `docs/format.md` is the normative text.
//!
//! This crate must never open a file, start a thread or hold a global; it cannot tell where its bytes come from.
#![forbid(unsafe_code)]

mod bits;
mod group;
mod header;
mod leaf;
mod leaf_writer;
mod lobe;
mod mini_float;
mod page;
mod page_table;
mod surfel;

pub use group::{
    CHILDREN_MAX, ChildBox, ChildLink, GROUP_FIXED_BYTES, GroupFields, GroupView, group_bytes,
    write_group,
};
pub use header::{
    COORDINATE_MAX, Channels, FORMAT_VERSION, HEADER_BYTES, Header, HeaderFlags, MAGIC,
};
pub use leaf::LeafView;
pub use leaf_writer::{LeafRounding, LeafWriter, SurfelFields};
pub use lobe::{LOBES_MAX, Lobe};
pub use mini_float::MiniFloat;
pub use page::{
    ExternalLink, NODE_PAGE_HEADER_BYTES, NodePage, NodePageFields, PageKind,
    SURFEL_PAGE_FIXED_BYTES, SURFEL_PAGE_HEADER_BYTES, SurfelPage, finish_node_page,
    finish_surfel_page,
};
pub use page_table::{
    PAGE_ALIGNMENT, PAGE_ENTRY_BYTES, PageChecksum, PageEntry, PageId, page_checksum,
};
pub use surfel::{LeafSurfel, SurfelLayout};

/// Why bytes are not a valid octree file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: found {found}, expected {expected}")]
pub struct FormatError {
    /// The structure and field.
    pub place: &'static str,
    /// What the bytes say.
    pub found: String,
    /// What they should say.
    pub expected: String,
}

impl FormatError {
    pub(crate) fn new(
        place: &'static str,
        found: impl std::fmt::Display,
        expected: impl std::fmt::Display,
    ) -> Self {
        Self { place, found: found.to_string(), expected: expected.to_string() }
    }
}

#[inline(always)]
pub(crate) fn read_u32(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(bytes[offset..offset + 4].try_into().expect("four bytes"))
}

#[inline(always)]
pub(crate) fn read_u64(bytes: &[u8], offset: usize) -> u64 {
    u64::from_le_bytes(bytes[offset..offset + 8].try_into().expect("eight bytes"))
}

#[inline(always)]
pub(crate) fn read_f32(bytes: &[u8], offset: usize) -> f32 {
    f32::from_bits(read_u32(bytes, offset))
}

#[inline(always)]
pub(crate) fn read_u16(bytes: &[u8], offset: usize) -> u16 {
    u16::from_le_bytes([bytes[offset], bytes[offset + 1]])
}
