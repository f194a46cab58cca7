//! The octree grown along its open path from a stream in Morton order.
//!
//! Leaves come from [`crate::leaves`]; looking `leaf_surfels_max` surfels ahead decides where they end (Kontkanen et al. 2011). A
//! cell with a single occupied octant hands that octant up instead of becoming a node. Surfels that share a Morton code
//! beyond the leaf size become a balanced tree over the list of them.

use crate::aggregate::NodeAggregate;
use crate::error::BuildError;
use crate::leaves::{Leaf, Leaves, Totals, with_leaves};
use crate::pack::{Group, PendingContent, PendingNode};
use crate::writer::FileWriter;
use crate::{BuildOptions, BuildReport, ChannelChoice, SortedStream, StreamSummary};
use pbgi_format::{CHILDREN_MAX, Channels, Header, HeaderFlags, MiniFloat, PageId, SurfelLayout};
use pbgi_math::{Aabb, MORTON_AXIS_BITS, SharedExponent, Vec3};
use std::path::Path;

/// Builds the octree file `target` from a sorted stream, in one pass. The result depends on the
/// surfels and on `page_bytes`, `leaf_surfels_max`, `compress` and `channels` only.
///
/// Memory: at most 21 levels times seven waiting treelets, in practice a few megabytes.
///
/// # Errors
///
/// If the stream fails or is not in order, if writing fails, or if cancelled; `target` is then as
/// it was before.
///
/// # Panics
///
/// If an option is out of its range.
pub fn build_octree(
    stream: &mut dyn SortedStream,
    summary: &StreamSummary,
    options: &BuildOptions<'_>,
    target: &Path,
) -> Result<BuildReport, BuildError> {
    assert!((1..=255).contains(&options.leaf_surfels_max), "1 to 255 surfels per leaf");
    assert!(crate::PAGE_BYTES_RANGE.contains(&options.page_bytes), "page bytes in range");
    if summary.surfel_count == 0 {
        return Err(BuildError::Empty);
    }
    let layout = choose_layout(summary, options);
    let mut builder = Builder {
        writer: FileWriter::create(target, options.compress)?,
        root: summary.root,
        layout,
        options,
        counts: Counts::default(),
    };
    let build = |leaves: &mut Leaves<'_>| builder.build_cell(leaves, 0, 0);
    let (node, totals) = with_leaves(stream, options, build)?;
    builder.finish(node.ok_or(BuildError::Empty)?, summary, &totals)
}

/// Codecs that hold every surfel, and sums of all of them, whatever their order.
fn choose_layout(summary: &StreamSummary, options: &BuildOptions<'_>) -> SurfelLayout {
    let shines = summary.radiance_max > 0.0 && options.channels == ChannelChoice::AsNeeded;
    let mut radiance_scale = 1.0;
    if shines {
        while summary.radiance_max / radiance_scale > SharedExponent::MAX {
            radiance_scale *= 2.0;
        }
        while summary.radiance_max / radiance_scale < SharedExponent::MAX / 2.0
            && radiance_scale > 1e-30
        {
            radiance_scale *= 0.5;
        }
    }
    SurfelLayout {
        channels: if shines { Channels::Rgb } else { Channels::Occlusion },
        albedo: options.albedo && summary.any_albedo,
        radius: MiniFloat::covering(summary.radius_max),
        area: MiniFloat::covering(2.0 * summary.area_max * summary.surfel_count as f32),
        radiance_scale,
    }
}

#[derive(Default)]
struct Counts {
    nodes: u64,
    leaves: u64,
    hot_bytes: u64,
    lobe_bytes: u64,
}

struct Builder<'a> {
    writer: FileWriter,
    root: pbgi_math::RootCube,
    layout: SurfelLayout,
    options: &'a BuildOptions<'a>,
    counts: Counts,
}

impl Builder<'_> {
    /// The node of the cell with leading octants `cell` at `level`, or none if the stream has left it.
    fn build_cell(
        &mut self,
        leaves: &mut Leaves<'_>,
        level: u32,
        cell: u64,
    ) -> Result<Option<PendingNode>, BuildError> {
        match leaves.peek()? {
            Some(leaf) if leaf.code.cell_at(level) == cell => {
                if leaf.level == level {
                    return take_leaf(leaves);
                }
            }
            _ => return Ok(None),
        }
        if level == MORTON_AXIS_BITS {
            return self.build_list(leaves, cell).map(Some);
        }
        let mut children: Vec<(u32, PendingNode)> = Vec::with_capacity(CHILDREN_MAX);
        while let Some(leaf) = leaves.peek()? {
            let code = leaf.code;
            if code.cell_at(level) != cell {
                break;
            }
            let child = self.build_cell(leaves, level + 1, code.cell_at(level + 1))?;
            children.push((code.octant(level), child.expect("the cell holds the next surfel")));
        }
        if children.len() == 1 {
            return Ok(children.pop().map(|(_, child)| child));
        }
        let split = self.root.cell_box(cell, level).center();
        self.close_group(split, children).map(Some)
    }

    /// A balanced tree over all surfels of one Morton code: full leaves, joined eight by eight.
    fn build_list(
        &mut self,
        leaves: &mut Leaves<'_>,
        code: u64,
    ) -> Result<PendingNode, BuildError> {
        let split = self.root.cell_box(code, MORTON_AXIS_BITS).center();
        // levels[k] holds up to eight finished subtrees of height k.
        let mut levels: Vec<Vec<PendingNode>> = Vec::new();
        loop {
            if leaves.peek()?.is_none_or(|leaf| leaf.code.0 != code) {
                break;
            }
            let Some(mut node) = take_leaf(leaves)? else { break };
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
        let mut rest: Vec<PendingNode> = Vec::new();
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

    fn close_list(
        &mut self,
        split: Vec3,
        nodes: Vec<PendingNode>,
    ) -> Result<PendingNode, BuildError> {
        let children = nodes.into_iter().enumerate().map(|(i, n)| (i as u32, n)).collect();
        self.close_group(split, children)
    }

    /// Turns closed children into a group; where its treelet outgrows a page, moves the children's
    /// treelets into pages.
    fn close_group(
        &mut self,
        split: Vec3,
        children: Vec<(u32, PendingNode)>,
    ) -> Result<PendingNode, BuildError> {
        let aggregate = NodeAggregate::from_children(children.iter().map(|(_, c)| &c.aggregate));
        let mut group = Group::new(split, &aggregate, children, &self.layout);
        let (leaves, nodes) = group.counts();
        let (hot, lobes) = group.own_bytes(&self.layout);
        self.counts.leaves += leaves;
        self.counts.nodes += nodes;
        self.counts.hot_bytes += hot;
        self.counts.lobe_bytes += lobes;
        if group.exceeds(self.options.page_bytes) {
            let (writer, layout) = (&mut self.writer, &self.layout);
            group.flush_children(self.options.page_bytes, layout, |roots| {
                writer.write_treelets(roots, layout)
            })?;
        }
        Ok(PendingNode { aggregate, content: PendingContent::Group(Box::new(group)) })
    }

    fn finish(
        mut self,
        node: PendingNode,
        summary: &StreamSummary,
        totals: &Totals,
    ) -> Result<BuildReport, BuildError> {
        let bounds = node.aggregate.bounds;
        let root = match node.content {
            PendingContent::Group(group) => group,
            // A cloud that fits one leaf still gets a root group.
            PendingContent::Leaf(_) => match self.close_group(bounds.center(), vec![(0, node)])? {
                PendingNode { content: PendingContent::Group(group), .. } => group,
                PendingNode { .. } => unreachable!("closing a group gives a group"),
            },
        };
        let link = self.writer.write_treelets(&[&root], &self.layout)?[0];
        let counts = &self.counts;
        let spacing = (totals.area / totals.surfels as f64).sqrt() as f32;
        let header = Header {
            channels: self.layout.channels,
            flags: HeaderFlags {
                albedo: self.layout.albedo,
                compressed: self.options.compress,
                isotropic: summary.any_isotropic,
                z_up: summary.z_up,
            },
            surfel_count: totals.surfels,
            node_count: counts.nodes,
            leaf_count: counts.leaves,
            page_count: 0,
            page_table_offset: 0,
            page_table_checksum: 0,
            root_page: PageId(link.page.0),
            root_offset: link.offset,
            page_bytes_max: 0,
            leaf_surfels_max: self.options.leaf_surfels_max as u32,
            depth: root.depth,
            origin: summary.origin,
            root: summary.root,
            bounds: Aabb { min: bounds.min, max: bounds.max },
            radius_codec: self.layout.radius,
            area_codec: self.layout.area,
            radiance_scale: self.layout.radiance_scale,
            spacing,
            area_total: totals.area,
            flux_total: totals.flux,
        };
        let surfel_bytes = self.writer.surfel_bytes();
        let (file_bytes, pages) = self.writer.finish(header)?;
        let known = surfel_bytes + counts.hot_bytes + counts.lobe_bytes;
        Ok(BuildReport {
            surfels: totals.surfels,
            nodes: counts.nodes,
            leaves: counts.leaves,
            pages,
            file_bytes,
            surfel_bytes,
            node_hot_bytes: counts.hot_bytes,
            lobe_bytes: counts.lobe_bytes,
            overhead_bytes: file_bytes as i64 - known as i64,
        })
    }
}

/// The next leaf as a node.
fn take_leaf(leaves: &mut Leaves<'_>) -> Result<Option<PendingNode>, BuildError> {
    let node = |leaf: Leaf| PendingNode {
        aggregate: leaf.aggregate,
        content: PendingContent::Leaf(leaf.surfels),
    };
    Ok(leaves.take()?.map(node))
}
