//! From a piece of the sorted stream to what is left to join.

use crate::Piece;
use crate::error::BuildError;
use crate::pack::{PendingContent, PendingNode};
use crate::pages::PageBatch;
use crate::tree::{Counts, TreeBuilder, TreeSettings, octant_len};
use pbgi_cloud::Surfel;
use pbgi_math::{MORTON_AXIS_BITS, MortonCode};
use std::ops::Range;

/// A part of the sorted stream.
pub(crate) enum Item {
    /// A surfel whose cell is not known to be complete.
    Surfel(MortonCode, Surfel),
    /// The finished octree of a whole cell.
    Subtree(Box<Subtree>),
}

impl Item {
    /// Code of its first surfel.
    pub fn code(&self) -> MortonCode {
        match self {
            Self::Surfel(code, _) => *code,
            Self::Subtree(subtree) => subtree.code,
        }
    }
}

/// The octree of all surfels of a cell, more than a leaf holds: as it is in the octree of everything.
pub(crate) struct Subtree {
    /// Code of its first surfel.
    pub code: MortonCode,
    /// Level of the cell.
    pub level: u32,
    pub node: PendingNode<'static>,
    pub pages: PageBatch,
    pub counts: Counts,
}

/// Builds what a piece holds of whole cells, the largest there are. What is built depends on the surfels only: a cell that holds more surfels
/// than a leaf has the same octree whatever lies around it.
pub(crate) fn build_piece(piece: &Piece, settings: &TreeSettings) -> Result<Vec<Item>, BuildError> {
    assert_eq!(piece.codes.len(), piece.surfels.len(), "one code for each surfel");
    if let Some(before) = piece.codes.windows(2).position(|pair| pair[1] < pair[0]) {
        return Err(BuildError::Unsorted { index: before as u64 + 1 });
    }
    let mut items = Vec::new();
    add_cell(piece, settings, 0..piece.codes.len(), 0, &mut items)?;
    Ok(items)
}

/// Adds the surfels of `range`, which are those the piece holds of their cell at `level`.
fn add_cell(
    piece: &Piece,
    settings: &TreeSettings,
    range: Range<usize>,
    level: u32,
    items: &mut Vec<Item>,
) -> Result<(), BuildError> {
    let Some(&code) = piece.codes[range.clone()].first() else { return Ok(()) };
    let shift = 3 * (MORTON_AXIS_BITS - level);
    let first = code.cell_at(level) << shift;
    let is_whole = piece.whole.start <= first && first + (1 << shift) <= piece.whole.end;
    if is_whole && range.len() > settings.leaf_surfels_max {
        let subtree = build_subtree(piece, settings, range, level)?;
        items.push(Item::Subtree(Box::new(subtree)));
        return Ok(());
    }
    if is_whole || level == MORTON_AXIS_BITS {
        let parts = piece.codes[range.clone()].iter().zip(&piece.surfels[range]);
        items.extend(parts.map(|(code, surfel)| Item::Surfel(*code, *surfel)));
        return Ok(());
    }
    let mut start = range.start;
    while start < range.end {
        let end = start + octant_len(&piece.codes[start..range.end], level);
        add_cell(piece, settings, start..end, level + 1, items)?;
        start = end;
    }
    Ok(())
}

fn build_subtree(
    piece: &Piece,
    settings: &TreeSettings,
    range: Range<usize>,
    level: u32,
) -> Result<Subtree, BuildError> {
    let (codes, surfels) = (&piece.codes[range.clone()], &piece.surfels[range]);
    let sink = PageBatch::new(0, settings.compress);
    let mut tree = TreeBuilder::new(*settings, sink);
    let node = tree.build(codes, surfels)?;
    let node = match node.content {
        PendingContent::Group(group) => {
            PendingNode { aggregate: node.aggregate, content: PendingContent::Group(group) }
        }
        PendingContent::Leaf(_) => unreachable!("more surfels than a leaf holds make a group"),
    };
    Ok(Subtree { code: codes[0], level, node, pages: tree.sink, counts: tree.counts })
}
