//! The octree over sorted surfels in memory.
//!
//! A leaf is the largest cell that holds no more than `leaf_surfels_max` surfels. A cell with a single occupied octant hands that octant up instead of
//! becoming a node. Surfels that share a Morton code beyond the leaf size become a balanced tree over the list of them.

use crate::aggregate::NodeAggregate;
use crate::error::BuildError;
use crate::pack::{Group, PendingContent, PendingNode};
use crate::pages::PageSink;
use crate::reduce::LobeReducer;
use pbgi_cloud::Surfel;
use pbgi_format::{CHILDREN_MAX, LeafRounding, LeafWriter, SurfelLayout};
use pbgi_math::{MORTON_AXIS_BITS, MortonCode, RootCube, Vec3};
use std::borrow::Cow;
use std::vec::Drain;

/// What every part of a build knows.
#[derive(Clone, Copy)]
pub(crate) struct TreeSettings {
    pub root: RootCube,
    pub layout: SurfelLayout,
    pub page_bytes: usize,
    pub leaf_surfels_max: usize,
    pub rounding: LeafRounding,
    pub compress: bool,
}

/// What was counted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Counts {
    pub nodes: u64,
    pub leaves: u64,
    pub hot_bytes: u64,
    pub lobe_bytes: u64,
    /// Surfels whose light lobes cannot hold beside the brightest.
    pub dim_surfels: u64,
}

impl Counts {
    pub fn add(&mut self, other: &Self) {
        self.nodes += other.nodes;
        self.leaves += other.leaves;
        self.hot_bytes += other.hot_bytes;
        self.lobe_bytes += other.lobe_bytes;
        self.dim_surfels += other.dim_surfels;
    }
}

/// Builds nodes bottom-up; their pages go to `sink`.
pub(crate) struct TreeBuilder<S> {
    pub settings: TreeSettings,
    pub sink: S,
    pub counts: Counts,
    reducer: LobeReducer,
    leaf_writer: LeafWriter,
}

/// Gives the next leaf of a list.
pub(crate) type NextLeaf<'f, 's> =
    dyn FnMut(&mut LobeReducer) -> Result<Option<PendingNode<'s>>, BuildError> + 'f;

impl<S: PageSink> TreeBuilder<S> {
    pub fn new(settings: TreeSettings, sink: S) -> Self {
        Self {
            settings,
            sink,
            counts: Counts::default(),
            reducer: LobeReducer::default(),
            leaf_writer: LeafWriter::new(settings.rounding),
        }
    }

    /// Memory to reduce lobes in.
    pub fn reducer(&mut self) -> &mut LobeReducer {
        &mut self.reducer
    }

    /// The node of sorted surfels, at least one, that are all there are of some cell.
    pub fn build<'s>(
        &mut self,
        codes: &[MortonCode],
        surfels: &'s [Surfel],
    ) -> Result<PendingNode<'s>, BuildError> {
        self.build_cell(codes, surfels, &mut Vec::new())
    }

    /// The same; `open` holds the closed children of open cells, and does so again afterwards.
    fn build_cell<'s>(
        &mut self,
        codes: &[MortonCode],
        surfels: &'s [Surfel],
        open: &mut Vec<(u32, PendingNode<'s>)>,
    ) -> Result<PendingNode<'s>, BuildError> {
        if surfels.len() <= self.settings.leaf_surfels_max {
            return Ok(PendingNode::leaf(&mut self.reducer, Cow::Borrowed(surfels)));
        }
        // The smallest cell that holds them all: cells around it have one occupied octant.
        let (first, last) = (codes[0], codes[codes.len() - 1]);
        let level = first.common_level(last);
        let split = self.settings.root.cell_box(first.cell_at(level), level).center();
        if level == MORTON_AXIS_BITS {
            let mut leaves = surfels.chunks(self.settings.leaf_surfels_max);
            let mut next = |reducer: &mut LobeReducer| {
                let leaf = leaves.next();
                Ok(leaf.map(|surfels| PendingNode::leaf(reducer, Cow::Borrowed(surfels))))
            };
            return self.build_list(split, &mut next);
        }
        let first_child = open.len();
        let mut start = 0;
        while start < codes.len() {
            let octant = codes[start].octant(level);
            let end = start + octant_len(&codes[start..], level);
            let child = self.build_cell(&codes[start..end], &surfels[start..end], open)?;
            open.push((octant, child));
            start = end;
        }
        self.close_group(split, open.drain(first_child..))
    }

    /// A balanced tree over leaves of one Morton code, joined eight by eight; there is at least one.
    pub fn build_list<'s>(
        &mut self,
        split: Vec3,
        next_leaf: &mut NextLeaf<'_, 's>,
    ) -> Result<PendingNode<'s>, BuildError> {
        // levels[k] holds up to eight finished subtrees of height k.
        let mut levels: Vec<Vec<PendingNode<'s>>> = Vec::new();
        while let Some(mut node) = next_leaf(&mut self.reducer)? {
            for height in 0.. {
                if levels.len() == height {
                    levels.push(Vec::new());
                }
                levels[height].push(node);
                if levels[height].len() < CHILDREN_MAX {
                    break;
                }
                node = self.close_list(split, std::mem::take(&mut levels[height]))?;
            }
        }
        // Join what remains, from the lowest level up.
        let mut rest: Vec<PendingNode<'s>> = Vec::new();
        for level in levels {
            let mut joined = level;
            joined.append(&mut rest);
            rest = match joined.len() {
                0 | 1 => joined,
                _ if joined.len() <= CHILDREN_MAX => vec![self.close_list(split, joined)?],
                _ => {
                    let tail = joined.split_off(CHILDREN_MAX);
                    let mut pair = vec![self.close_list(split, joined)?];
                    pair.extend(tail);
                    vec![self.close_list(split, pair)?]
                }
            };
        }
        Ok(rest.pop().expect("the list holds at least one surfel"))
    }

    fn close_list<'s>(
        &mut self,
        split: Vec3,
        nodes: Vec<PendingNode<'s>>,
    ) -> Result<PendingNode<'s>, BuildError> {
        let mut children: Vec<_> = (0..).zip(nodes).collect();
        self.close_group(split, children.drain(..))
    }

    /// Turns closed children into a group; where its treelet has grown enough, closes those of the children.
    pub fn close_group<'s>(
        &mut self,
        split: Vec3,
        children: Drain<'_, (u32, PendingNode<'s>)>,
    ) -> Result<PendingNode<'s>, BuildError> {
        let Self { settings, sink, counts, reducer, leaf_writer } = self;
        let layout = &settings.layout;
        let parts = children.as_slice().iter().map(|(_, child)| &child.aggregate);
        let aggregate = NodeAggregate::from_children_with(reducer, parts);
        let dim_surfels =
            children.as_slice().iter().map(|(_, child)| child.count_dim(layout)).sum();
        let mut group = Group::new(split, &aggregate, children, layout, leaf_writer);
        let (leaves, nodes) = group.counts();
        let (hot_bytes, lobe_bytes) = group.own_bytes(layout);
        counts.add(&Counts { nodes, leaves, hot_bytes, lobe_bytes, dim_surfels });
        if group.is_grown(settings.page_bytes) {
            group.close_children(settings.page_bytes, layout, &mut |treelets| {
                sink.write_treelets(treelets, layout)
            })?;
        }
        Ok(PendingNode { aggregate, content: PendingContent::Group(Box::new(group)) })
    }
}

/// How many of sorted codes in one cell of `level` lie in the octant of it in which the first does.
pub(crate) fn octant_len(codes: &[MortonCode], level: u32) -> usize {
    const FEW: usize = 16;
    let octant = codes[0].octant(level);
    let is_inside = |code: &MortonCode| code.octant(level) == octant;
    match codes.iter().take(FEW).position(|code| !is_inside(code)) {
        Some(len) => len,
        None => FEW.min(codes.len()) + codes[FEW.min(codes.len())..].partition_point(is_inside),
    }
}
