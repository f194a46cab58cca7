//! A run of neighboring pages, read at once and checked by itself.

use super::LevelCounts;
use super::join::fold;
use super::page::NodeCheck;
use crate::error::StoreError;
use crate::octree::Octree;
use pbgi_format::{LOBES_MAX, PageId, PageKind, SurfelPage};
use pbgi_math::Aabb;
use std::borrow::Cow;
use std::ops::Range;

/// What a run of pages holds.
#[derive(Default)]
pub(super) struct Facts {
    pub bytes_read: u64,
    pub nodes: u64,
    pub leaves: u64,
    /// Surfels that the surfel pages say they hold.
    pub page_surfels: u64,
    /// Leaves by number of surfels, from 0 on as far as there are any.
    pub leaf_sizes: Vec<u64>,
    pub lobe_counts: [u64; LOBES_MAX + 1],
    /// Pages by decoded size in steps of 4 KiB, as far as there are any.
    pub page_sizes: Vec<u64>,
    /// Treelets that nothing in the run links to, in the order of the file.
    pub roots: Vec<Root>,
    /// Links to treelets of other runs.
    pub links: Vec<Link>,
}

/// A group that nothing links to so far, with what is below it in its page and in those joined to it.
pub(super) struct Root {
    pub page: PageId,
    pub offset: u32,
    pub bounds: Aabb,
    /// By depth below the root.
    pub levels: Vec<LevelCounts>,
}

/// A link to a group of another page.
pub(super) struct Link {
    pub page: PageId,
    pub offset: u32,
    /// The box the parent stored for it, and the parent's longest edge.
    pub stored: Aabb,
    pub extent: f32,
    /// The root the parent is below, by number, and by how much.
    pub from: usize,
    pub depth: usize,
}

/// Adds one to a count, which may be the first of its class.
pub(super) fn count(counts: &mut Vec<u64>, class: usize) {
    if counts.len() <= class {
        counts.resize(class + 1, 0);
    }
    counts[class] += 1;
}

/// Reads and checks pages. `buffer` is reused from run to run.
pub(super) fn check(
    octree: &Octree,
    pages: Range<usize>,
    buffer: &mut Vec<u8>,
) -> Result<Facts, StoreError> {
    let entries = &octree.pages()[pages.clone()];
    let (first, last) = (&entries[0], &entries[entries.len() - 1]);
    let length = last.offset + u64::from(last.stored_bytes) - first.offset;
    buffer.resize(length as usize, 0);
    // Where they cannot be read together, single reads tell which page it is.
    let is_read = octree.read_stored(first.offset, buffer).is_ok();
    let mut facts = Facts::default();
    let mut surfels: Vec<(PageId, Cow<'_, [u8]>)> = Vec::new();
    for (index, entry) in pages.zip(entries) {
        let id = PageId(index as u32);
        let bytes = match is_read {
            true => {
                let start = (entry.offset - first.offset) as usize;
                let stored = &buffer[start..start + entry.stored_bytes as usize];
                if entry.is_compressed() {
                    let mut decoded = vec![0; entry.decoded_bytes as usize];
                    octree.decode_page(id, entry, stored, &mut decoded)?;
                    Cow::Owned(decoded)
                } else {
                    octree.check_page(id, entry, stored)?;
                    Cow::Borrowed(stored)
                }
            }
            false => Cow::Owned(octree.read_page(id, entry)?),
        };
        facts.bytes_read += u64::from(entry.stored_bytes);
        count(&mut facts.page_sizes, entry.decoded_bytes as usize / 4096);
        if entry.kind == PageKind::Surfels {
            let page = SurfelPage::new(&bytes).map_err(|e| octree.invalid_page(id, e))?;
            facts.page_surfels += u64::from(page.surfel_count());
            surfels.push((id, bytes));
            continue;
        }
        NodeCheck::run(octree, id, &bytes, &mut surfels, &mut facts)?;
    }
    (facts.roots, facts.links) = fold(octree, facts.roots, facts.links)?;
    Ok(facts)
}

/// The surfel page of a node page: one of those before it, or, where it is not in the run, read again.
pub(super) fn take_surfels<'b>(
    octree: &Octree,
    owner: PageId,
    id: PageId,
    surfels: &mut Vec<(PageId, Cow<'b, [u8]>)>,
) -> Result<Cow<'b, [u8]>, StoreError> {
    if let Some(found) = surfels.iter().position(|(page, _)| *page == id) {
        return Ok(surfels.remove(found).1);
    }
    let entry = octree.entry(id)?;
    if entry.kind != PageKind::Surfels {
        return Err(octree.invalid(owner, "surfel page: kind", "nodes", "surfels"));
    }
    Ok(Cow::Owned(octree.read_page(id, entry)?))
}
