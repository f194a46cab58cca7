//! Treelets of all pages joined to one tree.

use super::batch::{Facts, Link, Root};
use super::page::holds;
use super::{LevelCounts, VerifyReport};
use crate::error::StoreError;
use crate::octree::Octree;
use pbgi_format::PageId;

/// Joins what was found in runs of pages, in their order, and checks that it is one tree, and the header's.
pub(super) fn join(octree: &Octree, facts: Vec<Facts>) -> Result<VerifyReport, StoreError> {
    let mut report = VerifyReport { leaf_sizes: vec![0; 256], ..VerifyReport::default() };
    let (mut roots, mut links) = (Vec::new(), Vec::new());
    let (mut nodes, mut leaves, mut page_surfels) = (0, 0, 0);
    for part in facts {
        report.bytes_read += part.bytes_read;
        nodes += part.nodes;
        leaves += part.leaves;
        page_surfels += part.page_surfels;
        add(&mut report.leaf_sizes, &part.leaf_sizes);
        add(&mut report.page_sizes, &part.page_sizes);
        report.lobe_counts.iter_mut().zip(part.lobe_counts).for_each(|(sum, n)| *sum += n);
        let before = roots.len();
        links.extend(part.links.into_iter().map(|link| Link { from: link.from + before, ..link }));
        roots.extend(part.roots);
    }
    report.levels = count_levels(octree, &roots, links)?;
    check_totals(octree, &report, [nodes, leaves, page_surfels])?;
    Ok(report)
}

fn add(sums: &mut Vec<u64>, counts: &[u64]) {
    sums.resize(sums.len().max(counts.len()), 0);
    sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
}

/// Checks that one link leads to each treelet, from a box that holds it, and none to that of the root; counts levels.
fn count_levels(
    octree: &Octree,
    roots: &[Root],
    mut links: Vec<Link>,
) -> Result<Vec<LevelCounts>, StoreError> {
    let header = octree.header();
    links.sort_by_key(|link| (link.page, link.offset));
    let mut links = links.into_iter().peekable();
    let mut parents: Vec<Option<Link>> = Vec::with_capacity(roots.len());
    for root in roots {
        let own = (root.page, root.offset);
        let link = links.next_if(|link| (link.page, link.offset) <= own);
        match &link {
            Some(link) if (link.page, link.offset) < own => return Err(astray(octree, link)),
            Some(_) if own == (header.root_page, header.root_offset) => {
                return Err(octree.invalid(root.page, "root: links to it", 1, 0));
            }
            Some(link) if !holds(&link.stored, link.extent, &root.bounds) => {
                let found = "outside its parent's";
                return Err(octree.invalid(root.page, "group: box", found, "inside"));
            }
            None if own != (header.root_page, header.root_offset) => {
                return Err(octree.invalid(root.page, "group: links to it", 0, 1));
            }
            _ => {}
        }
        parents.push(link);
    }
    if let Some(link) = links.next() {
        return Err(astray(octree, &link));
    }
    let mut levels = vec![LevelCounts::default(); header.depth as usize];
    let mut depths = vec![0; roots.len()];
    // Parents' pages are behind their children's.
    for (index, (root, parent)) in roots.iter().zip(&parents).enumerate().rev() {
        let depth = parent.as_ref().map_or(0, |link| depths[link.from] + link.depth + 1);
        depths[index] = depth;
        let Some(own) = levels.get_mut(depth..depth + root.levels.len()) else {
            let found = depth + root.levels.len();
            return Err(octree.invalid(root.page, "tree: depth", found, header.depth));
        };
        for (sum, level) in own.iter_mut().zip(&root.levels) {
            sum.groups += level.groups;
            sum.leaves += level.leaves;
            sum.surfels += level.surfels;
        }
    }
    let used = levels.iter().rposition(|level| level.groups > 0).map_or(0, |last| last + 1);
    levels.truncate(used);
    Ok(levels)
}

fn astray(octree: &Octree, link: &Link) -> StoreError {
    octree.invalid(link.page, "link: offset", link.offset, "a group that is linked once")
}

fn check_totals(
    octree: &Octree,
    report: &VerifyReport,
    [nodes, leaves, page_surfels]: [u64; 3],
) -> Result<(), StoreError> {
    let header = octree.header();
    let surfels = report.levels.iter().map(|level| level.surfels).sum();
    let root: PageId = header.root_page;
    for (place, found, expected) in [
        ("header: surfels", header.surfel_count, surfels),
        ("surfel pages: surfels", page_surfels, header.surfel_count),
        ("header: nodes", header.node_count, nodes),
        ("header: leaves", header.leaf_count, leaves),
        ("header: depth", u64::from(header.depth), report.levels.len() as u64),
    ] {
        if found != expected {
            return Err(octree.invalid(root, place, found, expected));
        }
    }
    Ok(())
}
