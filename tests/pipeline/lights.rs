//! Point and spot lights of glTF files, from the file to the irradiance they give.

use pbgi::{BakeRequest, LightRequest, Progress, ProgressMode, Sampling, Verbosity, bake};
use pbgi_gather::{GatherSettings, Gatherer, Receiver};
use pbgi_math::Vec3;
use pbgi_store::{Octree, OpenOptions};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A square ground of 8 × 8 at y = 0. A bulb of intensity 40, 20, 10 hangs at (−1, 2, 1) and, under a node that turns, stretches
/// and moves it, at (2, 1.5, −1); a spot of intensity 60 at (−2, 3, −2) shines along (0, −0.8, −0.6).
const SCENE: &str = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":72,"uri":"ground.bin"}],
    "bufferViews":[{"buffer":0,"byteLength":72}],
    "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":6,"min":[-4,0,-4],"max":[4,0,4]}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
    "extensionsUsed":["KHR_lights_punctual"],
    "extensions":{"KHR_lights_punctual":{"lights":[
        {"type":"point","color":[1,0.5,0.25],"intensity":40},
        {"type":"spot","intensity":60,"spot":{"outerConeAngle":0.7}}]}},
    "nodes":[{"mesh":0},{"translation":[-1,2,1],"extensions":{"KHR_lights_punctual":{"light":0}}},
        {"rotation":[0,0.70710678,0,0.70710678],"scale":[2,1,2],"translation":[0,0,-1],"children":[3]},
        {"translation":[0,1.5,1],"extensions":{"KHR_lights_punctual":{"light":0}}},
        {"rotation":[-0.4472136,0,0,0.8944272],"translation":[-2,3,-2],"children":[5]},
        {"extensions":{"KHR_lights_punctual":{"light":1}}}]}"#;

/// Bakes the scene and opens it.
fn bake_scene(folder: &Path, light: LightRequest, light_scale: f32) -> Octree {
    let corners = [[-4.0f32, -4.0], [-4.0, 4.0], [4.0, 4.0], [-4.0, -4.0], [4.0, 4.0], [4.0, -4.0]];
    let bytes = corners.iter().flat_map(|[x, z]| [*x, 0.0, *z]).flat_map(f32::to_le_bytes);
    std::fs::write(folder.join("ground.bin"), bytes.collect::<Vec<u8>>()).unwrap();
    let input = folder.join("scene.gltf");
    std::fs::write(&input, SCENE).unwrap();
    let request = BakeRequest {
        inputs: vec![input.to_str().unwrap().to_owned()],
        output: folder.join("scene.pbgi"),
        force: true,
        sampling: Sampling::Surfels(40_000),
        light,
        light_scale,
        ..BakeRequest::default()
    };
    let progress = Progress::new(ProgressMode::None, Verbosity::Quiet, 1);
    let report = bake(&request, &progress, &AtomicBool::new(false)).unwrap();
    assert_eq!(report.lights, 3 * u64::from(light_scale > 0.0));
    let options = OpenOptions { readers: 2, ..OpenOptions::default() };
    Octree::open(&request.output, &options).unwrap()
}

/// Irradiance of the ground at `place`, by I cos θ / d².
fn exact_irradiance(place: Vec3) -> f32 {
    let bulb = |position: Vec3| {
        let to = position - place;
        40.0 * to.y / to.length().powi(3)
    };
    let to = Vec3::new(-2.0, 3.0, -2.0) - place;
    let along = Vec3::new(0.0, -0.8, -0.6).dot(-to).max(0.0) / to.length();
    let spot = 60.0 * along * to.y / to.length().powi(3);
    bulb(Vec3::new(-1.0, 2.0, 1.0)) + bulb(Vec3::new(2.0, 1.5, -1.0)) + spot
}

/// Mean and root mean square of E/exact − 1 over the ground, of the red channel.
fn errors(octree: &Octree, raster_edge: usize, solid_angle_sr: f32) -> (f32, f32) {
    let settings = GatherSettings { raster_edge, solid_angle_sr, ..GatherSettings::default() };
    let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
    let (mut sum, mut squares) = (0.0, 0.0);
    for i in 0..400u32 {
        let place = Vec3::new((i % 20) as f32 * 0.37 - 3.5, 0.0, (i / 20) as f32 * 0.37 - 3.5);
        let found = gatherer.gather(&Receiver::diffuse(place, Vec3::Y)).unwrap().surface_irradiance;
        let error = found[0] / exact_irradiance(place) - 1.0;
        sum += error / 400.0;
        squares += error * error / 400.0;
    }
    (sum, squares.sqrt())
}

/// Surfel by surfel what is left is the light's own shape, within 5 %, and that a texel has but one cosine; as clusters, a little more.
#[test]
fn a_ground_under_lights_has_their_irradiance() {
    let folder = tempfile::tempdir().unwrap();
    let octree = bake_scene(folder.path(), LightRequest::default(), 1.0);
    for (raster_edge, solid_angle_sr, mean_max, rms_max) in
        [(32, 0.0, 0.01, 0.03), (8, 0.0, 0.01, 0.07), (16, 0.08, 0.03, 0.05), (8, 0.08, 0.03, 0.08)]
    {
        let (mean, rms) = errors(&octree, raster_edge, solid_angle_sr);
        assert!(
            mean.abs() < mean_max && rms < rms_max,
            "{raster_edge} {solid_angle_sr}: {mean}, {rms}"
        );
    }
}

#[test]
fn lights_are_scaled_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let place = Receiver::diffuse(Vec3::new(0.5, 0.0, -0.5), Vec3::Y);
    let [whole, half, none] = [1.0, 0.5, 0.0].map(|light_scale| {
        let octree = bake_scene(folder.path(), LightRequest::default(), light_scale);
        let mut gatherer = Gatherer::new(octree.reader(), &GatherSettings::default(), None);
        gatherer.gather(&place).unwrap().surface_irradiance[1]
    });
    assert!((half / whole - 0.5).abs() < 0.01 && none == 0.0, "{whole} {half} {none}");
}
