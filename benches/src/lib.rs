//! What measurements share: baking in a temporary folder, and time that other programs do not disturb.
#![forbid(unsafe_code)]

use anyhow::Result;
use pbgi_build::{
    BuildOptions, BuildReport, SortedStream, StreamError, StreamSummary, build_octree,
};
use pbgi_cloud::{SliceSource, Surfel, SurfelSource};
use pbgi_math::MortonCode;
use pbgi_scene::{DiceOptions, DicedScene, Scene, Spacing, TwoSided};
use pbgi_sort::{SortOptions, SortedSurfels, sort_surfels};
use pbgi_store::{Octree, OpenOptions};
use std::path::Path;
use std::time::Instant;

/// Columns of PLY files that state all of a surfel, in the order of [`surfel_row`].
pub const SURFEL_COLUMNS: [&str; 14] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "radius",
    "area",
    "radiance_r",
    "radiance_g",
    "radiance_b",
    "albedo_r",
    "albedo_g",
    "albedo_b",
];

/// The values of a surfel's [`SURFEL_COLUMNS`].
#[must_use]
pub fn surfel_row(surfel: &Surfel) -> [f32; SURFEL_COLUMNS.len()] {
    let [[x, y, z], [nx, ny, nz]] = [surfel.position, surfel.normal().to_array()];
    let [[r, g, b], [ar, ag, ab]] = [surfel.radiance, surfel.albedo_rgb()];
    [x, y, z, nx, ny, nz, surfel.radius, surfel.area, r, g, b, ar, ag, ab]
}

struct Stream(SortedSurfels);

impl SortedStream for Stream {
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError> {
        Ok(self.0.read_chunk(out)?)
    }
}

/// Bakes surfels to `path` and opens the file with a gibibyte of cache.
///
/// # Errors
///
/// If a step fails.
pub fn bake(surfels: &[Surfel], path: &Path) -> Result<Octree> {
    Ok(bake_with(surfels, &BuildOptions::default(), path)?.0)
}

/// The same, built as told; with what was built.
///
/// # Errors
///
/// If a step fails.
pub fn bake_with(
    surfels: &[Surfel],
    options: &BuildOptions<'_>,
    path: &Path,
) -> Result<(Octree, BuildReport)> {
    let sorted = sort_surfels(&mut SliceSource::new(surfels), &SortOptions::default())?;
    let facts = *sorted.summary();
    let summary = StreamSummary {
        root: facts.root,
        origin: facts.origin,
        surfel_count: facts.count,
        radius_max: facts.radius_max,
        area_max: facts.area_max,
        radiance_max: facts.radiance_max,
        any_albedo: facts.any_albedo,
        any_isotropic: facts.any_isotropic,
        z_up: false,
    };
    let report = build_octree(&mut Stream(sorted), &summary, options, path)?;
    let octree =
        Octree::open(path, &OpenOptions { cache_bytes: 1 << 30, ..OpenOptions::default() })?;
    Ok((octree, report))
}

/// Dices a scene into about `count` surfels.
///
/// # Errors
///
/// If the scene cannot be diced.
pub fn dice(scene: &Scene, count: u64) -> Result<Vec<Surfel>> {
    let options = DiceOptions { spacing: Spacing::Count(count), two_sided: TwoSided::Material };
    let (mut surfels, mut source) = (Vec::new(), DicedScene::new(scene, options)?);
    while source.read_chunk(&mut surfels)? {}
    Ok(surfels)
}

/// Time of the calling thread: on a processor, where the system tells, else on the wall.
#[derive(Clone, Copy, Debug)]
pub struct ThreadTimer {
    start: Instant,
    processor_ns: Option<u64>,
}

impl ThreadTimer {
    /// Starts.
    #[must_use]
    pub fn start() -> Self {
        Self { start: Instant::now(), processor_ns: processor_ns() }
    }

    /// Seconds since then.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        match (self.processor_ns, processor_ns()) {
            (Some(before), Some(now)) => (now - before) as f64 * 1e-9,
            _ => self.start.elapsed().as_secs_f64(),
        }
    }
}

/// Nanoseconds the calling thread has run, as Linux counts them.
fn processor_ns() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok()
}

mod caster;
mod light_sampler;
mod lit;
mod svg;

pub use caster::{BOUNCES_MAX, Caster, Gathered, Hit, PATHS_MAX, first_bounce};
pub use light_sampler::{SkyImage, SkySample};
pub use lit::{bake_settings, light_up, lit_surfels, read_sorted, scene_surfels};
pub use svg::{Line, plot};
