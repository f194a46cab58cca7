//! From the sorted stream to the finished file.

use crate::error::BuildError;
use crate::pack::{PendingContent, PendingNode};
use crate::pages::PageSink;
use crate::pieces::{StreamPieces, with_items};
use crate::stitch::Stitcher;
use crate::tree::{TreeBuilder, TreeSettings};
use crate::writer::FileWriter;
use crate::{BuildOptions, BuildReport, ChannelChoice, PieceSource, SortedStream, StreamSummary};
use pbgi_format::{Channels, Header, HeaderFlags, MiniFloat, PageId, SurfelLayout};
use pbgi_math::{Aabb, SharedExponent};
use std::path::Path;

/// Builds the octree file `target` from a sorted stream, as [`build_octree_from_pieces`] does.
///
/// # Errors
///
/// As there.
///
/// # Panics
///
/// As there.
pub fn build_octree(
    stream: &mut dyn SortedStream,
    summary: &StreamSummary,
    options: &BuildOptions<'_>,
    target: &Path,
) -> Result<BuildReport, BuildError> {
    build_octree_from_pieces(&mut StreamPieces::new(stream), summary, options, target)
}

/// Builds the octree file `target` from pieces of a sorted stream, in one pass. The result depends on the
/// surfels and on `page_bytes`, `leaf_surfels_max`, `rounding`, `compress`, `channels` and `albedo` only.
///
/// Memory: the pieces in flight and what was built of them; 32 bytes for each page, for the page table; at most 21 levels times seven
/// closed nodes, with the treelets that wait below them, in practice a few megabytes.
///
/// # Errors
///
/// If the stream fails or is not in order, if writing fails, or if cancelled; `target` is then as
/// it was before.
///
/// # Panics
///
/// If an option is out of its range, or a piece has not as many codes as surfels.
pub fn build_octree_from_pieces(
    pieces: &mut dyn PieceSource,
    summary: &StreamSummary,
    options: &BuildOptions<'_>,
    target: &Path,
) -> Result<BuildReport, BuildError> {
    assert!((1..=255).contains(&options.leaf_surfels_max), "1 to 255 surfels per leaf");
    assert!(crate::PAGE_BYTES_RANGE.contains(&options.page_bytes), "page bytes in range");
    if summary.surfel_count == 0 {
        return Err(BuildError::Empty);
    }
    let settings = TreeSettings {
        root: summary.root,
        layout: choose_layout(summary, options),
        page_bytes: options.page_bytes,
        leaf_surfels_max: options.leaf_surfels_max,
        rounding: options.rounding,
        compress: options.compress,
    };
    let sink = FileWriter::create(target, options.compress)?;
    let tree = TreeBuilder::new(settings, sink);
    let ((node, tree), surfels) = with_items(pieces, &settings, options, |next_items| {
        let mut stitcher = Stitcher::new(tree, next_items);
        Ok((stitcher.build()?, stitcher.tree))
    })?;
    finish(tree, node.ok_or(BuildError::Empty)?, summary, surfels)
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

fn finish(
    mut tree: TreeBuilder<FileWriter>,
    node: PendingNode<'static>,
    summary: &StreamSummary,
    surfels: u64,
) -> Result<BuildReport, BuildError> {
    let layout = tree.settings.layout;
    let (bounds, area, flux) = (node.aggregate.bounds, node.aggregate.area, node.aggregate.flux);
    let mut root = match node.content {
        PendingContent::Group(group) => group,
        // A cloud that fits one leaf still gets a root group.
        PendingContent::Leaf(_) => {
            match tree.close_group(bounds.center(), vec![(0, node)].drain(..))? {
                PendingNode { content: PendingContent::Group(group), .. } => group,
                PendingNode { .. } => unreachable!("closing a group gives a group"),
            }
        }
    };
    root.flush_waiting(tree.settings.page_bytes, &mut |treelets| {
        tree.sink.write_treelets(treelets, &layout)
    })?;
    let link = tree.sink.write_treelets(&[&root], &layout)?[0];
    let counts = tree.counts;
    let spacing = (area / surfels as f64).sqrt() as f32;
    let header = Header {
        channels: layout.channels,
        flags: HeaderFlags {
            albedo: layout.albedo,
            compressed: tree.settings.compress,
            isotropic: summary.any_isotropic,
            z_up: summary.z_up,
        },
        surfel_count: surfels,
        node_count: counts.nodes,
        leaf_count: counts.leaves,
        page_count: 0,
        page_table_offset: 0,
        page_table_checksum: 0,
        root_page: PageId(link.page.0),
        root_offset: link.offset,
        page_bytes_max: 0,
        leaf_surfels_max: tree.settings.leaf_surfels_max as u32,
        depth: root.depth,
        origin: summary.origin,
        root: summary.root,
        bounds: Aabb { min: bounds.min, max: bounds.max },
        radius_codec: layout.radius,
        area_codec: layout.area,
        radiance_scale: layout.radiance_scale,
        spacing,
        area_total: area,
        flux_total: flux,
    };
    let surfel_bytes = tree.sink.surfel_bytes();
    let (file_bytes, pages) = tree.sink.finish(header)?;
    let known = surfel_bytes + counts.hot_bytes + counts.lobe_bytes;
    Ok(BuildReport {
        surfels,
        nodes: counts.nodes,
        leaves: counts.leaves,
        pages,
        file_bytes,
        surfel_bytes,
        node_hot_bytes: counts.hot_bytes,
        lobe_bytes: counts.lobe_bytes,
        overhead_bytes: file_bytes as i64 - known as i64,
        dim_surfels: counts.dim_surfels,
    })
}
