//! Hiding triangle meshes: depth buffer per tile, then micropolygons from what is left.

use super::coverage::{Coverage, Fragment, RectFragments};
use super::lattice::{Cell, Lattice};
use super::pattern::{SAMPLES_MAX, SamplePattern};
use super::project::{Projector, ScreenTriangle, screen_box};
use super::surface::{SceneTriangle, Triangles};
use super::tiles::{Bins, PixelRect, TileGrid};
use super::{HideError, HideOptions, prepare};
use crate::{CameraView, Scene};
use pbgi_math::{DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// A piece of visible surface, shaded once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Micropolygon {
    /// Mean of the points where samples see it, in world space: a visible point of the surface.
    pub position: Vec3,
    /// Unit shading normal, on the side of `geometric_normal`.
    pub normal: Vec3,
    /// Unit normal of the triangle, turned toward the camera.
    pub geometric_normal: Vec3,
    /// Linear diffuse albedo, 0..=1: what the base color leaves where it is no metal.
    pub albedo: [f32; 3],
    /// Linear color, 0..=1.
    pub base_color: [f32; 3],
    /// 0 for dielectrics, 1 for metals.
    pub metalness: f32,
    /// Perceptual roughness, 0..=1.
    pub roughness: f32,
    /// Strength of a dielectric's gloss, 0..=1.
    pub specular: f32,
    /// Emitted radiance toward the camera, W·m⁻²·sr⁻¹.
    pub emission: [f32; 3],
    /// Depth of `position` along the view axis, in scene units.
    pub depth: f32,
    /// Half its longer diagonal, in scene units.
    pub radius: f32,
    /// Whether the camera sees the back of a single-sided surface, which is dark.
    pub back: bool,
}

/// What a camera sees of a scene: micropolygons, and which of them each pixel shows.
#[derive(Clone, Debug)]
pub struct VisibleSet {
    /// Micropolygons, by tiles of the image.
    pub micropolygons: Vec<Micropolygon>,
    /// Fragments of pixels; their indices count `micropolygons`.
    pub coverage: Coverage,
}

impl VisibleSet {
    /// [`Coverage::resolve`] for values indexed like the micropolygons.
    #[must_use]
    pub fn resolve<const K: usize>(
        &self,
        value: impl Fn(usize) -> [f32; K] + Sync,
        background: impl Fn(Vec3) -> [f32; K] + Sync,
    ) -> Vec<[f32; K]> {
        self.coverage.resolve(value, background)
    }

    /// [`Coverage::resolve_nearest`] for values indexed like the micropolygons.
    #[must_use]
    pub fn resolve_nearest<const K: usize>(
        &self,
        value: impl Fn(usize) -> [f32; K] + Sync,
        empty: [f32; K],
    ) -> Vec<[f32; K]> {
        self.coverage.resolve_nearest(value, empty)
    }
}

/// Triangles a unit of parallel work bins.
const PIECE_TRIANGLES: u64 = 4096;

/// Finds the micropolygons of `scene` that `view` sees.
///
/// Nothing is clipped or culled: the camera may stand inside geometry, triangles may reach behind
/// it, and backs are seen. Of surfaces at equal depth the first in scene order shows. Triangles
/// with indices out of range or positions that are not finite are not drawn. The result does not
/// depend on the number of threads; a window gives the same micropolygons, to the last bit, as that
/// part of the whole image.
///
/// Memory: a depth buffer per thread of 64 × 64 pixels, 8 bytes per triangle in view, 80 bytes per
/// micropolygon and about 16 bytes per pixel.
///
/// # Errors
///
/// [`HideError`] for options, cameras or images out of range.
pub fn hide(
    scene: &Scene,
    view: &CameraView,
    options: &HideOptions,
) -> Result<VisibleSet, HideError> {
    let (pattern, grid) = prepare(view, options)?;
    let triangles = Triangles::new(scene);
    let count = triangles.count();
    if count >= u64::from(u32::MAX) {
        return Err(HideError::Triangles { count });
    }
    let projector = Projector::new(view);
    let covered = grid.covered();
    let pieces = count.div_ceil(PIECE_TRIANGLES) as usize;
    let bins = Bins::gather(grid.tile_count(), pieces, |piece, pairs| {
        let first = piece as u64 * PIECE_TRIANGLES;
        for number in first as u32..(first + PIECE_TRIANGLES).min(count) as u32 {
            let Some(triangle) = triangles.get(number) else { continue };
            let vertices = triangle.local(&projector);
            let Some(rect) = screen_box(&projector, &vertices, &covered) else { continue };
            pairs.extend(grid.tiles_of(rect).map(|tile| (tile, number)));
        }
    });
    let painter = Painter {
        triangles: &triangles,
        projector: &projector,
        pattern: &pattern,
        cell_pixels: f64::from(options.shading_rate).sqrt(),
    };
    let tiles: Vec<(Vec<Micropolygon>, RectFragments)> = (0..grid.tile_count())
        .into_par_iter()
        .map_init(DepthTile::default, |buffer, tile| {
            painter.paint_tile(buffer, bins.of(tile), &grid, tile)
        })
        .collect();
    drop(bins);
    Ok(join_tiles(view, &grid, options.samples, tiles))
}

/// Concatenates the micropolygons of all tiles.
fn join_tiles(
    view: &CameraView,
    grid: &TileGrid,
    samples: u32,
    tiles: Vec<(Vec<Micropolygon>, RectFragments)>,
) -> VisibleSet {
    let total = tiles.iter().map(|(list, _)| list.len()).sum();
    let mut micropolygons = Vec::with_capacity(total);
    let mut parts = Vec::with_capacity(tiles.len());
    for (list, mut part) in tiles {
        let first = micropolygons.len() as u32;
        part.fragments.iter_mut().for_each(|fragment| fragment.index += first);
        micropolygons.extend(list);
        parts.push(part);
    }
    let coverage = Coverage::join(view, grid.window, samples, &parts);
    VisibleSet { micropolygons, coverage }
}

/// Depth buffer of a tile.
#[derive(Default)]
struct DepthTile {
    /// 1/depth of what each sample sees, 0 for nothing; sample after sample, pixels in rows.
    inverse_depth: Vec<f32>,
    /// Index into `drawn`.
    owner: Vec<u32>,
    /// Triangles that own or once owned a sample.
    drawn: Vec<(u32, ScreenTriangle)>,
}

struct Painter<'a> {
    triangles: &'a Triangles<'a>,
    projector: &'a Projector,
    pattern: &'a SamplePattern,
    cell_pixels: f64,
}

impl Painter<'_> {
    fn paint_tile(
        &self,
        buffer: &mut DepthTile,
        bin: &[u32],
        grid: &TileGrid,
        tile: usize,
    ) -> (Vec<Micropolygon>, RectFragments) {
        let rect = grid.tile(tile);
        let samples = self.pattern.offsets.len();
        let length = (rect.x1 - rect.x0) as usize * (rect.y1 - rect.y0) as usize * samples;
        buffer.inverse_depth.clear();
        buffer.inverse_depth.resize(length, 0.0);
        buffer.owner.resize(length, 0);
        buffer.drawn.clear();
        for number in bin {
            let Some(triangle) = self.triangles.get(*number) else { continue };
            let vertices = triangle.local(self.projector);
            let Some(part) = screen_box(self.projector, &vertices, &rect) else { continue };
            let Some(screen) = ScreenTriangle::new(self.projector, vertices) else { continue };
            if self.draw(buffer, &rect, part, &triangle, &screen) {
                buffer.drawn.push((*number, screen));
            }
        }
        self.collect(buffer, &rect, &rect.intersection(&grid.window))
    }

    /// Draws a triangle into the depth buffer; whether any sample saw it.
    fn draw(
        &self,
        buffer: &mut DepthTile,
        tile: &PixelRect,
        part: PixelRect,
        triangle: &SceneTriangle,
        screen: &ScreenTriangle,
    ) -> bool {
        let samples = self.pattern.offsets.len();
        let owner = buffer.drawn.len() as u32;
        let may_have_holes = triangle.material.alpha_cutoff.is_some();
        // What each sample of a pixel adds to the edge functions at the pixel's corner.
        let mut added = [[0f64; SAMPLES_MAX]; 3];
        for (edge, row) in screen.edges.iter().zip(&mut added) {
            for (value, offset) in row.iter_mut().zip(&self.pattern.offsets) {
                *value = edge.at_offset(*offset);
            }
        }
        let reach = added.map(|row| row[..samples].iter().copied().fold(f64::MIN, f64::max));
        let mut seen = false;
        for y in part.y0..part.y1 {
            let (first, last) = row_span(screen, &reach, y, part.x0, part.x1);
            for x in first..last {
                let corner = screen.edges.map(|edge| edge.at_pixel(x, y));
                let pixel =
                    (y - tile.y0) as usize * (tile.x1 - tile.x0) as usize + (x - tile.x0) as usize;
                let depths = &mut buffer.inverse_depth[pixel * samples..(pixel + 1) * samples];
                let owners = &mut buffer.owner[pixel * samples..(pixel + 1) * samples];
                for sample in 0..samples {
                    let e: [f64; 3] = std::array::from_fn(|i| corner[i] + added[i][sample]);
                    let inverse = (e[0] + e[1] + e[2]) * screen.inverse_determinant;
                    let inside = e[0] >= 0.0 && e[1] >= 0.0 && e[2] >= 0.0;
                    let nearer = inverse as f32 > depths[sample] && inverse < f64::from(f32::MAX);
                    if !(inside && nearer) {
                        continue;
                    }
                    if may_have_holes && triangle.is_hole(barycentric(e)) {
                        continue;
                    }
                    depths[sample] = inverse as f32;
                    owners[sample] = owner;
                    seen = true;
                }
            }
        }
        seen
    }

    /// Groups the samples of a tile into micropolygons; keeps what the pixels of `wanted` show.
    fn collect(
        &self,
        buffer: &DepthTile,
        tile: &PixelRect,
        wanted: &PixelRect,
    ) -> (Vec<Micropolygon>, RectFragments) {
        let samples = self.pattern.offsets.len();
        let mut cells = CellList::new(self, buffer);
        let mut part = RectFragments { rect: *wanted, counts: Vec::new(), fragments: Vec::new() };
        let mut pixel_cells: Vec<(u32, f32)> = Vec::with_capacity(samples);
        let mut pixel = 0;
        for y in tile.y0..tile.y1 {
            for x in tile.x0..tile.x1 {
                pixel_cells.clear();
                for sample in 0..samples {
                    let place = pixel * samples + sample;
                    let inverse = buffer.inverse_depth[place];
                    if inverse > 0.0 {
                        let offset = self.pattern.offsets[sample];
                        let cell = cells.add(buffer.owner[place], x, y, offset);
                        pixel_cells.push((cell, inverse));
                    }
                }
                pixel += 1;
                if x >= wanted.x0 && x < wanted.x1 && y >= wanted.y0 && y < wanted.y1 {
                    part.push_pixel(&mut pixel_cells);
                }
            }
        }
        let micropolygons = cells.finish(&mut part.fragments);
        (micropolygons, part)
    }
}

impl RectFragments {
    /// Adds a pixel whose samples show `seen`: (index, 1/depth).
    pub(super) fn push_pixel(&mut self, seen: &mut [(u32, f32)]) {
        seen.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        let mut groups = [(Fragment { index: 0, samples: 0 }, 0f32); SAMPLES_MAX];
        let mut count = 0;
        for group in seen.chunk_by(|a, b| a.0 == b.0) {
            groups[count] =
                (Fragment { index: group[0].0, samples: group.len() as u32 }, group[0].1);
            count += 1;
        }
        groups[..count].sort_by(|a, b| b.0.samples.cmp(&a.0.samples).then(b.1.total_cmp(&a.1)));
        self.counts.push(count as u32);
        self.fragments.extend(groups[..count].iter().map(|(fragment, _)| *fragment));
    }
}

/// Columns within `first..last` where no edge function is surely negative: `reach` is the largest
/// value a sample offset adds. One pixel of margin on both sides absorbs rounding.
fn row_span(
    screen: &ScreenTriangle,
    reach: &[f64; 3],
    y: u32,
    mut first: u32,
    mut last: u32,
) -> (u32, u32) {
    for (edge, reach) in screen.edges.iter().zip(reach) {
        let at_zero = edge.at_pixel(0, y) + reach;
        let root = -at_zero / edge.u;
        if edge.u > 0.0 {
            first = first.max((root - 1.0).max(0.0).min(f64::from(last)) as u32);
        } else if edge.u < 0.0 {
            last = last.min((root + 2.0).max(0.0).min(f64::from(last)) as u32);
        }
    }
    (first, last.max(first))
}

/// Barycentric coordinates from edge functions.
fn barycentric(edges: [f64; 3]) -> [f32; 3] {
    let sum = edges[0] + edges[1] + edges[2];
    edges.map(|edge| (edge / sum) as f32)
}

/// A micropolygon while its samples are gathered.
struct GatheredCell {
    owner: u32,
    cell: Cell,
    /// Sums over its samples of the second and third barycentric coordinate and of the depth.
    sums: [f64; 3],
    samples: u32,
}

/// The micropolygons of a tile in order of first sight.
struct CellList<'a> {
    painter: &'a Painter<'a>,
    drawn: &'a [(u32, ScreenTriangle)],
    lattices: Vec<Option<Lattice>>,
    cells: Vec<GatheredCell>,
    index: HashMap<u128, u32, BuildHasherDefault<CellHasher>>,
}

impl<'a> CellList<'a> {
    fn new(painter: &'a Painter<'a>, buffer: &'a DepthTile) -> Self {
        Self {
            painter,
            drawn: &buffer.drawn,
            lattices: vec![None; buffer.drawn.len()],
            cells: Vec::new(),
            index: HashMap::default(),
        }
    }

    /// Adds a sample that sees the triangle `drawn[owner]`; the index of its micropolygon.
    fn add(&mut self, owner: u32, x: u32, y: u32, offset: [f64; 2]) -> u32 {
        let painter = self.painter;
        let (number, screen) = &self.drawn[owner as usize];
        let weights = screen.weights(x, y, offset);
        let inverse_depth = weights[0] + weights[1] + weights[2];
        let depth = 1.0 / inverse_depth;
        let weights = weights.map(|weight| weight * depth);
        let lattice = self.lattices[owner as usize].get_or_insert_with(|| {
            let triangle = painter.triangles.get(*number).map(|t| t.local(painter.projector));
            Lattice::new(painter.projector, &triangle.unwrap_or([DVec3::ZERO; 3]))
        });
        let at = [weights[(lattice.corner + 1) % 3], weights[(lattice.corner + 2) % 3]];
        let raster = [f64::from(x) + offset[0], f64::from(y) + offset[1]];
        let direction = painter.projector.direction(raster);
        let cell = lattice.cell(at, direction, inverse_depth, painter.cell_pixels);
        let next = self.cells.len() as u32;
        let index = *self.index.entry((u128::from(owner) << 76) | cell.code()).or_insert(next);
        if index == next {
            self.cells.push(GatheredCell { owner, cell, sums: [0.0; 3], samples: 0 });
        }
        let gathered = &mut self.cells[index as usize];
        for (sum, value) in gathered.sums.iter_mut().zip([weights[1], weights[2], depth]) {
            *sum += value;
        }
        gathered.samples += 1;
        index
    }

    /// Micropolygons that `fragments` refer to, whose indices are renumbered to match.
    fn finish(&self, fragments: &mut [Fragment]) -> Vec<Micropolygon> {
        let mut number = vec![u32::MAX; self.cells.len()];
        let mut micropolygons = Vec::new();
        for fragment in fragments {
            let place = &mut number[fragment.index as usize];
            if *place == u32::MAX {
                *place = micropolygons.len() as u32;
                micropolygons.push(self.micropolygon(&self.cells[fragment.index as usize]));
            }
            fragment.index = *place;
        }
        micropolygons
    }

    fn micropolygon(&self, gathered: &GatheredCell) -> Micropolygon {
        let (number, screen) = &self.drawn[gathered.owner as usize];
        let triangle = self.painter.triangles.get(*number).expect("was found when it was drawn");
        let [second, third, depth] = gathered.sums.map(|sum| sum / f64::from(gathered.samples));
        let weights64 = [1.0 - second - third, second, third];
        let weights = weights64.map(|weight| weight as f32);
        let world = triangle.world().map(Vec3::as_dvec3);
        let position = world[0] * weights64[0] + world[1] * weights64[1] + world[2] * weights64[2];
        let is_front = screen.front != triangle.is_mirrored();
        let toward_camera = |normal: Vec3| if is_front { normal } else { -normal };
        let geometric = triangle.geometric_normal().unwrap_or(Vec3::Y);
        let normal = triangle.shading_normal(weights, geometric);
        let steps = gathered.cell.level.map(|level| 0.5f64.powi(i32::from(level)));
        let corner = self.lattices[gathered.owner as usize].map_or(0, |lattice| lattice.corner);
        let side = |step: usize| (world[(corner + step) % 3] - world[corner]) * steps[step - 1];
        let (a, b) = (side(1), side(2));
        // A cell as large as the triangle is half a parallelogram.
        let fraction = (2.0 * steps[0] * steps[1]).min(1.0);
        let color = triangle.color(weights, fraction as f32);
        let material = triangle.material;
        let back = !is_front && !material.double_sided;
        let metalness = material.metallic.clamp(0.0, 1.0);
        Micropolygon {
            position: position.as_vec3(),
            normal: toward_camera(normal),
            geometric_normal: toward_camera(geometric),
            albedo: color.base_color.map(|c| c * (1.0 - metalness)),
            base_color: color.base_color,
            metalness,
            roughness: material.roughness.clamp(0.0, 1.0),
            specular: material.specular.clamp(0.0, 1.0),
            emission: if back { [0.0; 3] } else { color.emission },
            depth: depth as f32,
            radius: (0.5 * (a + b).length().max((a - b).length())) as f32,
            back,
        }
    }
}

/// Multiplies and folds a cell code: codes differ in few, scattered bits.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        }
    }

    fn write_u128(&mut self, code: u128) {
        let folded = (code as u64) ^ ((code >> 64) as u64).wrapping_mul(0xff51_afd7_ed55_8ccd);
        let mixed = (folded ^ (folded >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 32);
    }
}
