//! Hiding surfels: clouds without a mesh, streamed past a depth buffer.

use super::coverage::{Coverage, RectFragments};
use super::pattern::SamplePattern;
use super::project::Projector;
use super::tiles::{Bins, PixelRect, TileGrid};
use super::{HideError, HideOptions, prepare};
use crate::CameraView;
use pbgi_math::{DVec3, Vec3};
use rayon::prelude::*;

/// A surfel as far as hiding needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    /// What tells it from others; of disks at equal depth the one with the lower id shows.
    pub id: u64,
    /// Center in world space.
    pub center: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Radius in scene units, above 0.
    pub radius: f32,
    /// Whether it has no normal and faces every camera.
    pub isotropic: bool,
    /// Whether it is seen from its front only.
    pub front_only: bool,
}

/// The surfels a camera sees, each once.
#[derive(Clone, Debug)]
pub struct VisibleSurfels {
    /// Ids of visible disks, rising.
    pub ids: Vec<u64>,
    /// Fragments of pixels; their indices count `ids`.
    pub coverage: Coverage,
}

/// Disks a unit of parallel work bins.
const PIECE_DISKS: usize = 4096;

/// Finds the disks that `view` sees, drawn as ellipses in exact perspective.
///
/// Chunks may come in any order and size, up to 2³² disks each; the result depends neither on them
/// nor on the number of threads. Disks that are not finite or have no radius are not drawn.
/// `options.shading_rate` plays no part.
///
/// Memory: 12 bytes per sample of the window's tiles, and per chunk 8 bytes per disk and tile it
/// touches.
///
/// # Errors
///
/// [`HideError`] for options, cameras or images out of range.
pub fn hide_disks<C: AsRef<[Disk]>>(
    view: &CameraView,
    options: &HideOptions,
    chunks: impl IntoIterator<Item = C>,
) -> Result<VisibleSurfels, HideError> {
    let (pattern, grid) = prepare(view, options)?;
    let projector = Projector::new(view);
    let mut tiles: Vec<DiskTile> = (0..grid.tile_count())
        .map(|tile| DiskTile::new(grid.tile(tile), pattern.offsets.len()))
        .collect();
    let covered = grid.covered();
    for chunk in chunks {
        let disks = chunk.as_ref();
        let pieces = disks.len().div_ceil(PIECE_DISKS);
        let bins = Bins::gather(grid.tile_count(), pieces, |piece, pairs| {
            let first = piece * PIECE_DISKS;
            let last = (first + PIECE_DISKS).min(disks.len());
            for (i, disk) in disks[first..last].iter().enumerate() {
                let Some(local) = LocalDisk::new(&projector, disk) else { continue };
                let Some(rect) = local.screen_box(&projector, &covered) else { continue };
                pairs.extend(grid.tiles_of(rect).map(|tile| (tile, (first + i) as u32)));
            }
        });
        tiles.par_iter_mut().enumerate().for_each(|(tile, buffer)| {
            for item in bins.of(tile) {
                let disk = &disks[*item as usize];
                if let Some(local) = LocalDisk::new(&projector, disk) {
                    buffer.draw(&projector, &pattern, disk.id, &local);
                }
            }
        });
    }
    Ok(collect(view, &grid, options.samples, &tiles))
}

/// A disk in camera space.
struct LocalDisk {
    center: DVec3,
    normal: DVec3,
    radius: f64,
    /// `normal · center`.
    plane: f64,
}

impl LocalDisk {
    /// `None` for what cannot be seen.
    fn new(projector: &Projector, disk: &Disk) -> Option<Self> {
        let center = projector.point(disk.center);
        let radius = f64::from(disk.radius);
        let usable = center.is_finite() && disk.normal.is_finite() && radius > 0.0;
        if !usable || !radius.is_finite() || center.z <= -radius {
            return None;
        }
        let normal = if disk.isotropic {
            -center.try_normalize()?
        } else {
            projector.turn(disk.normal.as_dvec3())
        };
        let plane = normal.dot(center);
        let away = disk.front_only && !disk.isotropic && plane >= 0.0;
        (plane != 0.0 && !away).then_some(Self { center, normal, radius, plane })
    }

    /// Pixels within `within` that the box around the disk may touch.
    fn screen_box(&self, projector: &Projector, within: &PixelRect) -> Option<PixelRect> {
        let reach = (DVec3::ONE - self.normal * self.normal).max(DVec3::ZERO);
        let reach = DVec3::new(reach.x.sqrt(), reach.y.sqrt(), reach.z.sqrt()) * self.radius;
        let (near, far) = (self.center.z - reach.z, self.center.z + reach.z);
        if far <= 0.0 {
            return None;
        }
        if near <= far * 1e-6 {
            return Some(*within);
        }
        let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in 0..8u32 {
            let side = |axis: u32| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let offset = reach * DVec3::new(side(0), side(1), side(2));
            let raster = projector.raster(self.center + offset);
            for axis in 0..2 {
                min[axis] = min[axis].min(raster[axis]);
                max[axis] = max[axis].max(raster[axis]);
            }
        }
        let rect = within.clamp_box(min, max);
        (!rect.is_empty()).then_some(rect)
    }

    /// 1/depth where a direction of depth 1 meets the disk.
    #[inline]
    fn inverse_depth(&self, direction: DVec3) -> Option<f32> {
        let inverse = self.normal.dot(direction) / self.plane;
        let usable = inverse > 0.0 && inverse < f64::from(f32::MAX);
        let meets = usable
            && (direction / inverse - self.center).length_squared() <= self.radius * self.radius;
        meets.then_some(inverse as f32)
    }
}

/// Depth buffer of a tile.
struct DiskTile {
    rect: PixelRect,
    inverse_depth: Vec<f32>,
    ids: Vec<u64>,
}

impl DiskTile {
    fn new(rect: PixelRect, samples: usize) -> Self {
        let length = (rect.x1 - rect.x0) as usize * (rect.y1 - rect.y0) as usize * samples;
        Self { rect, inverse_depth: vec![0.0; length], ids: vec![0; length] }
    }

    fn draw(&mut self, projector: &Projector, pattern: &SamplePattern, id: u64, disk: &LocalDisk) {
        let Some(part) = disk.screen_box(projector, &self.rect) else { return };
        let samples = pattern.offsets.len();
        let row_length = (self.rect.x1 - self.rect.x0) as usize;
        for y in part.y0..part.y1 {
            for x in part.x0..part.x1 {
                let pixel = (y - self.rect.y0) as usize * row_length + (x - self.rect.x0) as usize;
                for (sample, offset) in pattern.offsets.iter().enumerate() {
                    let raster = [f64::from(x) + offset[0], f64::from(y) + offset[1]];
                    let Some(inverse) = disk.inverse_depth(projector.direction(raster)) else {
                        continue;
                    };
                    let place = pixel * samples + sample;
                    let best = self.inverse_depth[place];
                    if inverse > best || (inverse == best && id < self.ids[place]) {
                        self.inverse_depth[place] = inverse;
                        self.ids[place] = id;
                    }
                }
            }
        }
    }
}

/// Visible ids and the fragments of all tiles.
fn collect(view: &CameraView, grid: &TileGrid, samples: u32, tiles: &[DiskTile]) -> VisibleSurfels {
    let wanted: Vec<PixelRect> =
        tiles.iter().map(|tile| tile.rect.intersection(&grid.window)).collect();
    let visible = |tile: &DiskTile, rect: &PixelRect| {
        let mut ids = Vec::new();
        for_each_sample(tile, rect, samples, |_, id, _| ids.push(id));
        ids.sort_unstable();
        ids.dedup();
        ids
    };
    let per_tile: Vec<Vec<u64>> =
        tiles.par_iter().zip(&wanted).map(|(tile, rect)| visible(tile, rect)).collect();
    let mut ids: Vec<u64> = per_tile.into_iter().flatten().collect();
    ids.par_sort_unstable();
    ids.dedup();
    let parts: Vec<RectFragments> = tiles
        .par_iter()
        .zip(&wanted)
        .map(|(tile, rect)| tile_fragments(tile, rect, samples, &ids))
        .collect();
    VisibleSurfels { coverage: Coverage::join(view, grid.window, samples, &parts), ids }
}

/// Calls `visit` with pixel (counted in `wanted`), id and 1/depth of each covered sample.
fn for_each_sample(
    tile: &DiskTile,
    wanted: &PixelRect,
    samples: u32,
    mut visit: impl FnMut(usize, u64, f32),
) {
    let row_length = (tile.rect.x1 - tile.rect.x0) as usize;
    let mut pixel = 0;
    for y in wanted.y0..wanted.y1 {
        for x in wanted.x0..wanted.x1 {
            let first = ((y - tile.rect.y0) as usize * row_length + (x - tile.rect.x0) as usize)
                * samples as usize;
            for place in first..first + samples as usize {
                if tile.inverse_depth[place] > 0.0 {
                    visit(pixel, tile.ids[place], tile.inverse_depth[place]);
                }
            }
            pixel += 1;
        }
    }
}

fn tile_fragments(tile: &DiskTile, wanted: &PixelRect, samples: u32, ids: &[u64]) -> RectFragments {
    let mut part = RectFragments { rect: *wanted, counts: Vec::new(), fragments: Vec::new() };
    if wanted.is_empty() {
        return part;
    }
    let mut seen: Vec<(u32, f32)> = Vec::new();
    let mut current = 0;
    for_each_sample(tile, wanted, samples, |pixel, id, inverse| {
        while current < pixel {
            part.push_pixel(&mut seen);
            seen.clear();
            current += 1;
        }
        let index = ids.binary_search(&id).unwrap_or_default() as u32;
        seen.push((index, inverse));
    });
    let pixel_count = (wanted.x1 - wanted.x0) as usize * (wanted.y1 - wanted.y0) as usize;
    while current < pixel_count {
        part.push_pixel(&mut seen);
        seen.clear();
        current += 1;
    }
    part
}
