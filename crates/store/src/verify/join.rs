//! Treelets of all pages joined to one tree.

use super::batch::{Facts, Link, Root};
use super::page::holds;
use super::{LevelCounts, VerifyReport};
use crate::error::StoreError;
use crate::octree::Octree;
use pbgi_format::PageId;

/// Treelets between two rounds of joining, besides twice those that the last round left.
const UNJOINED: usize = 4096;

/// What was found in runs of pages, in their order, joined to one tree as far as it goes.
#[derive(Default)]
pub(super) struct Join {
    report: VerifyReport,
    nodes: u64,
    leaves: u64,
    page_surfels: u64,
    roots: Vec<Root>,
    links: Vec<Link>,
    /// Treelets that the last round left.
    left: usize,
}

impl Join {
    /// The next run.
    pub fn push(&mut self, octree: &Octree, part: Facts) -> Result<(), StoreError> {
        let report = &mut self.report;
        report.bytes_read += part.bytes_read;
        add(&mut report.leaf_sizes, &part.leaf_sizes);
        add(&mut report.page_sizes, &part.page_sizes);
        report.lobe_counts.iter_mut().zip(part.lobe_counts).for_each(|(sum, n)| *sum += n);
        self.nodes += part.nodes;
        self.leaves += part.leaves;
        self.page_surfels += part.page_surfels;
        let before = self.roots.len();
        let links = part.links.into_iter();
        self.links.extend(links.map(|link| Link { from: link.from + before, ..link }));
        self.roots.extend(part.roots);
        if self.roots.len() > 2 * self.left + UNJOINED {
            self.fold(octree)?;
        }
        Ok(())
    }

    fn fold(&mut self, octree: &Octree) -> Result<(), StoreError> {
        let (roots, links) = (std::mem::take(&mut self.roots), std::mem::take(&mut self.links));
        (self.roots, self.links) = fold(octree, roots, links)?;
        self.left = self.roots.len();
        Ok(())
    }

    /// Checks that it is one tree, and the header's.
    pub fn finish(mut self, octree: &Octree) -> Result<VerifyReport, StoreError> {
        self.fold(octree)?;
        let mut report = self.report;
        report.levels = levels_of_one(octree, self.roots, &self.links)?;
        report.leaf_sizes.resize(report.leaf_sizes.len().max(256), 0);
        check_totals(octree, &report, [self.nodes, self.leaves, self.page_surfels])?;
        Ok(report)
    }
}

fn add(sums: &mut Vec<u64>, counts: &[u64]) {
    sums.resize(sums.len().max(counts.len()), 0);
    sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
}

/// Joins each treelet to the one that links to it, where both are there, and checks that its box is inside what its parent stored. Given are
/// treelets in the order of the file; left are those that nothing here links to, and links to what is not here.
pub(super) fn fold(
    octree: &Octree,
    mut roots: Vec<Root>,
    mut links: Vec<Link>,
) -> Result<(Vec<Root>, Vec<Link>), StoreError> {
    let header = octree.header();
    links.sort_by_key(|link| (link.page, link.offset));
    // The treelet that each is joined to, and how far below its root.
    let mut parents: Vec<Option<(usize, usize)>> = vec![None; roots.len()];
    let mut next = 0;
    let mut rest = Vec::new();
    for link in links {
        let target = (link.page, link.offset);
        while roots.get(next).is_some_and(|root| (root.page, root.offset) < target) {
            next += 1;
        }
        match roots.get(next) {
            Some(root) if (root.page, root.offset) == target && parents[next].is_none() => {
                if target == (header.root_page, header.root_offset) {
                    return Err(octree.invalid(root.page, "root: links to it", 1, 0));
                }
                if !holds(&link.stored, link.extent, &root.bounds) {
                    let found = "outside its parent's";
                    return Err(octree.invalid(root.page, "group: box", found, "inside"));
                }
                parents[next] = Some((link.from, link.depth + 1));
            }
            _ => rest.push(link),
        }
    }
    // Parents' pages are behind their children's.
    for index in 0..roots.len() {
        let Some((parent, depth)) = parents[index] else { continue };
        let below = std::mem::take(&mut roots[index].levels);
        let found = depth + below.len();
        if found > header.depth as usize {
            return Err(octree.invalid(roots[index].page, "tree: depth", found, header.depth));
        }
        let levels = &mut roots[parent].levels;
        levels.resize(levels.len().max(found), LevelCounts::default());
        for (sum, level) in levels[depth..].iter_mut().zip(below) {
            sum.groups += level.groups;
            sum.leaves += level.leaves;
            sum.surfels += level.surfels;
        }
    }
    let mut tops: Vec<(usize, usize)> = (0..roots.len()).map(|index| (index, 0)).collect();
    for index in (0..roots.len()).rev() {
        if let Some((parent, depth)) = parents[index] {
            let (top, above) = tops[parent];
            tops[index] = (top, above + depth);
        }
    }
    let mut numbers = vec![0; roots.len()];
    let mut left = Vec::new();
    for (index, mut root) in roots.into_iter().enumerate() {
        if parents[index].is_none() {
            numbers[index] = left.len();
            root.levels.shrink_to_fit();
            left.push(root);
        }
    }
    for link in &mut rest {
        let (top, depth) = tops[link.from];
        (link.from, link.depth) = (numbers[top], link.depth + depth);
    }
    rest.shrink_to_fit();
    Ok((left, rest))
}

/// The levels of the whole tree: one treelet is left, that of the root, and no link.
fn levels_of_one(
    octree: &Octree,
    roots: Vec<Root>,
    links: &[Link],
) -> Result<Vec<LevelCounts>, StoreError> {
    let header = octree.header();
    let (mut levels, mut unlinked) = (Vec::new(), None);
    for root in roots {
        if (root.page, root.offset) == (header.root_page, header.root_offset) {
            levels = root.levels;
        } else {
            unlinked.get_or_insert(root);
        }
    }
    match (unlinked, links.first()) {
        (Some(root), link)
            if link.is_none_or(|l| (l.page, l.offset) > (root.page, root.offset)) =>
        {
            Err(octree.invalid(root.page, "group: links to it", 0, 1))
        }
        (_, Some(link)) => Err(astray(octree, link)),
        _ => Ok(levels),
    }
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
