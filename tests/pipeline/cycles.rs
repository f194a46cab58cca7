//! Against values that Cycles computed: `tests/cycles/record.py` makes the scenes and the values beside it.

use pbgi::{
    BakeRequest, EnvironmentPlacement, EnvironmentSpec, LightRequest, LightSource, Positions,
    Progress, ReceiversRequest, Sampling, ShadeSettings, Shading, bake, shade_receivers,
};
use pbgi_image::{RgbImage, write_environment_exr};
use std::f32::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

fn recorded(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("cycles").join(name)
}

/// A place, and light there over π, as Blender's passes without color have it.
struct Point {
    position: [f64; 3],
    normal: [f32; 3],
    openness: f32,
    direct: [f32; 3],
    indirect: [f32; 3],
}

fn read_points(name: &str) -> Vec<Point> {
    let text = std::fs::read_to_string(recorded(name)).unwrap();
    let mut lines = text.lines();
    let columns = "x,y,z,nx,ny,nz,ao,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b";
    assert_eq!(lines.next(), Some(columns));
    let of_line = |line: &str| {
        let v: Vec<f32> = line.split(',').map(|word| word.parse().unwrap()).collect();
        Point {
            position: [v[0], v[1], v[2]].map(f64::from),
            normal: [v[3], v[4], v[5]],
            openness: v[6],
            direct: [v[7], v[8], v[9]],
            indirect: [v[10], v[11], v[12]],
        }
    };
    lines.map(of_line).collect()
}

/// Bakes a scene and shades the points.
fn shade(scene: &str, points: &[Point], light: LightRequest) -> Vec<Shading> {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        ShadeSettings { environment: light.environment.clone(), ..ShadeSettings::default() };
    let request = BakeRequest {
        inputs: vec![recorded(scene).to_str().unwrap().to_owned()],
        output: folder.path().join("scene.pbgi"),
        sampling: Sampling::Surfels(40_000),
        light,
        ..BakeRequest::default()
    };
    let (progress, cancel) = (Progress::silent(), AtomicBool::new(false));
    bake(&request, &progress, &cancel).unwrap();
    let positions: Vec<[f64; 3]> = points.iter().map(|p| p.position).collect();
    let normals: Vec<[f32; 3]> = points.iter().map(|p| p.normal).collect();
    let request = ReceiversRequest {
        octree: &request.output,
        positions: Positions::F64(&positions),
        normals: &normals,
        skip_empty: false,
        eye: None,
        settings,
    };
    let mut shadings = vec![Shading::default(); points.len()];
    let take = |index: usize, shading: &Shading| shadings[index] = *shading;
    shade_receivers(&request, take, &progress, &cancel).unwrap();
    shadings
}

/// Mean of what was recorded, and how far what was found is from it: the mean of the differences, and their root mean square, over that mean.
fn compare(pairs: impl Iterator<Item = (f32, f32)>) -> [f64; 3] {
    let (mut count, mut recorded, mut bias, mut square) = (0.0, 0.0, 0.0, 0.0);
    for (expected, found) in pairs {
        let difference = f64::from(found) - f64::from(expected);
        count += 1.0;
        recorded += f64::from(expected);
        bias += difference;
        square += difference * difference;
    }
    let mean = recorded / count;
    [mean, bias / count / mean, (square / count).sqrt() / mean]
}

/// Fails where the mean is off by more than `bias`, or single points by more than `spread`, both as shares of the recorded mean.
fn check(what: &str, pairs: impl Iterator<Item = (f32, f32)>, bias: f64, spread: f64) {
    let [mean, found_bias, found_spread] = compare(pairs);
    println!("{what}: {mean:.4}, {:+.2} %, {:.2} %", found_bias * 100.0, found_spread * 100.0);
    assert!(mean > 0.0 && found_bias.abs() <= bias, "{what}: the mean is off by {found_bias}");
    assert!(found_spread <= spread, "{what}: points are off by {found_spread}");
}

fn channels<'a>(
    points: &'a [Point],
    shadings: &'a [Shading],
    expected: impl Fn(&Point) -> [f32; 3] + 'a,
    found: impl Fn(&Shading) -> [f32; 3] + 'a,
) -> impl Iterator<Item = (f32, f32)> + 'a {
    points.iter().zip(shadings).flat_map(move |(point, shading)| {
        let found = found(shading).map(|irradiance| irradiance / PI);
        expected(point).into_iter().zip(found).collect::<Vec<_>>()
    })
}

fn openness<'a>(
    points: &'a [Point],
    shadings: &'a [Shading],
) -> impl Iterator<Item = (f32, f32)> + 'a {
    points.iter().zip(shadings).map(|(p, s)| (p.openness, s.ambient_occlusion))
}

fn check_sky(name: &str, environment: EnvironmentSpec) {
    let points = read_points(&format!("{name}.csv"));
    let light = LightRequest { environment: Some(environment), ..LightRequest::default() };
    let shadings = shade(&format!("{name}.obj"), &points, light);
    check("ambient occlusion", openness(&points, &shadings), 0.005, 0.01);
    let direct = channels(&points, &shadings, |p| p.direct, |s| s.environment_irradiance);
    check("diffuse direct", direct, 0.005, 0.01);
    let indirect = channels(&points, &shadings, |p| p.indirect, |s| s.surface_irradiance);
    check("diffuse indirect", indirect, 0.03, 0.1);
}

#[test]
fn sky_light_and_its_bounce_are_those_of_cycles() {
    let source = LightSource::Uniform([1.0, 0.8, 0.6]);
    let environment = EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 };
    check_sky("constant-world", environment);
}

/// Radiance at a place of the picture, from the top left, as `sky` in record.py.
fn sky(u: f32, v: f32) -> [f32; 3] {
    let side = (2.0 * PI * (u - 0.15)).cos().max(0.0).powi(4) * (PI * v).sin();
    [0.1 + 4.0 * side, 0.2 + 3.0 * side, 0.4 + side]
}

#[test]
fn environments_are_placed_as_in_blender() {
    let (width, height) = (128, 64);
    let texel = |i: usize| {
        let (x, y) = (i % width, i / width);
        sky((x as f32 + 0.5) / width as f32, (y as f32 + 0.5) / height as f32)
    };
    let pixels = (0..width * height).map(texel).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.exr");
    write_environment_exr(&path, &RgbImage { width, height, pixels }, &[]).unwrap();
    let placement = EnvironmentPlacement::from_name("blender").unwrap();
    let source = LightSource::File(path);
    let rotate_degrees = placement.rotate_degrees();
    check_sky("bright-side", EnvironmentSpec { source, rotate_degrees, scale: 1.0 });
}

#[test]
fn a_lamp_in_a_box_shines_as_in_cycles() {
    let points = read_points("lamp-in-box.csv");
    let shade = |bounces| {
        let light = LightRequest { bounces, ..LightRequest::default() };
        shade("lamp-in-box.glb", &points, light)
    };
    let (emitted, bounced) = (shade(0), shade(1));
    // Nodes hide a little less than their surfels, and little is open.
    check("ambient occlusion", openness(&points, &bounced), 0.02, 0.03);
    let direct = channels(&points, &emitted, |p| p.direct, |s| s.surface_irradiance);
    check("diffuse direct", direct, 0.005, 0.01);
    let sum = |p: &Point| [0, 1, 2].map(|k| p.direct[k] + p.indirect[k]);
    let both = channels(&points, &bounced, sum, |s| s.surface_irradiance);
    check("diffuse direct and indirect", both, 0.01, 0.02);
}
