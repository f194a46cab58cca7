//! Scenes whose surfels are lit, in memory and not rounded by any file.

use crate::{bake, dice};
use anyhow::{Result, bail};
use pbgi::LightRequest;
use pbgi_bounce::light_on_surfels;
use pbgi_cloud::{CloudOptions, SliceSource, Surfel, open_cloud};
use pbgi_gather::{GatherSettings, PreparedLight};
use pbgi_image::read_environment;
use pbgi_light::{Environment, EnvironmentOptions, SkyParameters, synthetic_sky};
use pbgi_math::Vec3;
use pbgi_mesh::read_scene;
use pbgi_procedural::procedural_scene;
use pbgi_schedule::ShadeOptions;
use pbgi_sort::{EstimateOptions, SortOptions, SortedSurfels, estimate_surfels, sort_surfels};
use pbgi_store::Octree;
use std::path::Path;

/// What lights the scenes, where the folder of data has it.
const SKY: &str = "kloppenheim_05_1k.hdr";

/// Surfels of the scene `name` as they are: street, foliage, or where the folder `data` has the files, sponza, scan. None where it has
/// not. Their count is about `count`; of the scan, points spread evenly over the file are taken.
///
/// # Errors
///
/// If there is no such scene, or a step fails.
pub fn scene_surfels(name: &str, count: u64, data: &Path) -> Result<Option<Vec<Surfel>>> {
    let (mesh, scan) = (data.join("sponza_crytek.glb"), data.join("autzen_stadium.laz"));
    Ok(Some(match name {
        "street" | "foliage" => dice(&procedural_scene(&format!("demo:{name}"))?.scene, count)?,
        "sponza" if mesh.is_file() => dice(&read_scene(&mesh)?, count)?,
        "scan" if scan.is_file() => read_scan(&scan, count)?,
        "sponza" | "scan" => return Ok(None),
        _ => bail!("there is no scene {name}; see --help"),
    }))
}

/// [`scene_surfels`], lit by a sky.
///
/// # Errors
///
/// As there.
pub fn lit_surfels(name: &str, count: u64, data: &Path) -> Result<Option<Vec<Surfel>>> {
    let Some(surfels) = scene_surfels(name, count, data)? else { return Ok(None) };
    let up = if name == "scan" { Vec3::Z } else { Vec3::Y };
    let folder = tempfile::tempdir()?;
    let octree = bake(&surfels, &folder.path().join("dark.pbgi"))?;
    let sky = data.join(SKY);
    let image = match sky.is_file() {
        true => read_environment(&sky)?,
        false => synthetic_sky(1024, 512, &SkyParameters::default()),
    };
    let environment = Environment::from_image(image, EnvironmentOptions::default())?;
    let settings = GatherSettings { up, ..bake_settings() };
    let light = PreparedLight::new(&environment, settings.raster_edge);
    Ok(Some(light_up(&octree, Some(&light), &surfels, &settings)?))
}

/// How `pbgi bake` gathers light for surfels unless told otherwise.
#[must_use]
pub fn bake_settings() -> GatherSettings {
    let LightRequest { solid_angle_sr, raster_edge, .. } = LightRequest::default();
    GatherSettings { solid_angle_sr, raster_edge, ..GatherSettings::default() }
}

/// About `count` points with sizes and normals estimated, as `pbgi-bake` does it.
fn read_scan(path: &Path, count: u64) -> Result<Vec<Surfel>> {
    let (mut points, mut source) = (Vec::new(), open_cloud(path, &CloudOptions::default())?);
    while source.read_chunk(&mut points)? {}
    let step = points.len().div_ceil(count.max(1) as usize).max(1);
    let points: Vec<Surfel> = points.into_iter().step_by(step).collect();
    let options = SortOptions::default();
    let sorted = sort_surfels(&mut SliceSource::new(&points), &options)?;
    let (mut sorted, _) = estimate_surfels(sorted, &EstimateOptions::default(), &options)?;
    Ok(read_sorted(&mut sorted)?.1)
}

/// Codes and surfels of a sorted stream.
///
/// # Errors
///
/// If a temporary file cannot be read.
pub fn read_sorted(sorted: &mut SortedSurfels) -> Result<(Vec<u64>, Vec<Surfel>)> {
    let mut all = Vec::new();
    while sorted.read_chunk(&mut all)? {}
    Ok(all.into_iter().map(|(code, surfel)| (code.0, surfel)).unzip())
}

/// Surfels with what they reflect, besides what they emit, of the light they get from `octree` and `light`.
///
/// # Errors
///
/// If the octree cannot be read.
pub fn light_up(
    octree: &Octree,
    light: Option<&PreparedLight>,
    surfels: &[Surfel],
    settings: &GatherSettings,
) -> Result<Vec<Surfel>> {
    let places: Vec<&Surfel> = surfels.iter().collect();
    let options = ShadeOptions { gather: *settings, threads: 2, ..ShadeOptions::default() };
    let found = light_on_surfels(octree, light, &places, &options)?;
    Ok(surfels.iter().zip(found).map(|(s, light)| light.shine_on(s, f32::MAX)).collect())
}
