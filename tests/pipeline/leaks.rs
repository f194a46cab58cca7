//! Light that comes through closed walls.

use crate::support::bake_and_open;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelSource};
use pbgi_gather::{GatherSettings, Gatherer, PreparedLight, Receiver};
use pbgi_light::{Environment, EnvironmentOptions, SkyParameters, synthetic_sky};
use pbgi_math::{Affine3A, Mat3, Vec3};
use pbgi_scene::{DiceOptions, DicedScene, Instance, Material, Mesh, Scene, Spacing, TwoSided};
use std::f32::consts::PI;

/// Half edges of the inside of the box.
const HALF: Vec3 = Vec3::new(2.0, 1.3, 1.7);

/// A box whose faces look outward, or inward.
fn box_mesh(half: Vec3, inward: bool, material: u32) -> Mesh {
    let corner = |i: u32| {
        let sign = |axis: u32| if i >> axis & 1 == 0 { -1.0 } else { 1.0 };
        half * Vec3::new(sign(0), sign(1), sign(2))
    };
    let faces =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles =
        faces.iter().flat_map(
            |&[a, b, c, d]| {
                if inward { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] }
            },
        );
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles: triangles.collect(),
        material,
        ..Mesh::default()
    }
}

/// A box without light inside; outside it shines as white does under a sky of radiance 1.
fn dark_box(thickness: f32, turn: Mat3, count: u64) -> Vec<Surfel> {
    let is_thick = thickness > 0.0;
    let material = |emission: [f32; 3]| Material { emission, ..Material::default() };
    let outside = box_mesh(HALF + thickness, false, 0);
    let inside = box_mesh(HALF, true, 1);
    let transform = Affine3A::from_mat3(turn);
    let scene = Scene {
        meshes: vec![outside, inside],
        instances: (0..1 + u32::from(is_thick)).map(|mesh| Instance { mesh, transform }).collect(),
        materials: vec![material([1.0; 3]), material([0.0; 3])],
        ..Scene::default()
    };
    let two_sided = if is_thick { TwoSided::None } else { TwoSided::All };
    let options = DiceOptions { spacing: Spacing::Count(count), two_sided };
    let mut diced = DicedScene::new(&scene, options).unwrap();
    let mut surfels = Vec::new();
    while diced.read_chunk(&mut surfels).unwrap() {}
    surfels
}

/// Receivers on the floor and on one wall, at distances from their edges of these shares of the spacing, and between.
fn receivers(turn: Mat3, spacing: f32) -> Vec<Receiver> {
    let along = |half: f32| {
        let near = [0.01, 0.3, 0.5, 1.3, 4.0].map(|share| (half - share * spacing).max(0.0));
        near.into_iter().chain(near.map(|x| -x)).chain([0.0, 0.317 * half])
    };
    let mut receivers = Vec::new();
    for axis in 0..2 {
        let (ua, va) = ((axis + 1) % 3, (axis + 2) % 3);
        for u in along(HALF[ua]) {
            for v in along(HALF[va]) {
                let mut place = Vec3::ZERO;
                (place[axis], place[ua], place[va]) = (-HALF[axis], u, v);
                receivers.push(Receiver::diffuse(turn * place, turn * Vec3::AXES[axis]));
            }
        }
    }
    receivers
}

/// A sky with a sun.
fn environment() -> Environment {
    let sun_direction = Vec3::new(0.3, 0.8, 0.5).normalize();
    let sky = SkyParameters { sun_direction, ..SkyParameters::default() };
    Environment::from_image(synthetic_sky(512, 256, &sky), EnvironmentOptions::default()).unwrap()
}

/// Largest and mean irradiance in a dark box over that outside: of an upward receiver from the environment, and of a wall of radiance 1
/// from its light.
fn leaks(thickness: f32, turn: Mat3, count: u64, solid_angle_sr: f32) -> (f32, f32) {
    let environment = environment();
    let light = PreparedLight::new(&environment, GatherSettings::default().raster_edge);
    let outside = environment.irradiance(Vec3::Y)[0];
    let surfels = dark_box(thickness, turn, count);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
    let mut gatherer = Gatherer::new(octree.reader(), &settings, Some(&light));
    let receivers = receivers(turn, surfels[0].area.sqrt());
    let (mut worst, mut sum) = (0f32, 0.0);
    for receiver in &receivers {
        let found = gatherer.gather(receiver).unwrap();
        let leak = found.environment_irradiance[0] / outside + found.surface_irradiance[0] / PI;
        worst = worst.max(leak);
        sum += leak;
    }
    (worst, sum / receivers.len() as f32)
}

/// Straight and slanted, coarse and fine.
fn boxes() -> impl Iterator<Item = (Mat3, u64)> {
    let slanted = Mat3::from_axis_angle(Vec3::new(1.0, 2.0, -0.7).normalize(), 0.7);
    let turns = [Mat3::IDENTITY, slanted];
    turns.into_iter().flat_map(|turn| [1000, 8000, 40_000].map(|count| (turn, count)))
}

/// Surfel by surfel, walls with an inside and an outside are closed: no ray finds a way through both.
#[test]
fn thick_walls_are_closed() {
    for (turn, count) in boxes() {
        let (worst, _) = leaks(0.2, turn, count, 0.0);
        assert!(worst < 1e-4, "{turn} {count}: {worst}");
    }
}

/// A sheet lets a ray through here and there: rounded rectangles do not quite meet. The mean stays below 10⁻⁴, a single receiver's
/// below 10⁻³.
#[test]
fn sheets_are_closed_but_for_single_rays() {
    for (turn, count) in boxes() {
        let (worst, mean) = leaks(0.0, turn, count, 0.0);
        assert!(worst < 1e-3 && mean < 1e-4, "{turn} {count}: {worst}, {mean}");
    }
}

/// Clusters of the default size at the edges of a box hold walls of several orientations and are veiled in part.
#[test]
fn clusters_at_edges_leak_little() {
    for (thickness, worst_max, mean_max) in [(0.2, 6e-3, 2e-3), (0.0, 6e-2, 2e-2)] {
        for (turn, count) in boxes() {
            let (worst, mean) = leaks(thickness, turn, count, 0.08);
            assert!(worst < worst_max && mean < mean_max, "{turn} {count}: {worst}, {mean}");
        }
    }
}

/// Irregular octahedra of sheets, whose triangles have no right angles, coarse and fine: surfel by surfel nothing is seen through them, but for
/// single rays between rounded outlines.
#[test]
fn triangles_without_right_angles_are_closed() {
    let corners = [
        Vec3::new(1.3, 0.1, -0.2),
        Vec3::new(-0.9, 0.2, 0.3),
        Vec3::new(0.1, 1.1, 0.2),
        Vec3::new(0.3, -1.4, -0.1),
        Vec3::new(-0.2, 0.3, 0.8),
        Vec3::new(0.2, -0.1, -1.2),
    ];
    let faces: Vec<[u32; 3]> = (0..8u32)
        .map(|i| {
            let [a, b, c] = [i & 1, 2 + (i >> 1 & 1), 4 + (i >> 2)];
            if i.count_ones() % 2 == 0 { [a, b, c] } else { [a, c, b] }
        })
        .collect();
    let mesh = Mesh { positions: corners.to_vec(), triangles: faces.clone(), ..Mesh::default() };
    let scene = Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, transform: Affine3A::IDENTITY }],
        materials: vec![Material::default()],
        ..Scene::default()
    };
    for spacing in [9.0, 0.4, 0.05] {
        let options = DiceOptions { spacing: Spacing::Length(spacing), two_sided: TwoSided::All };
        let (mut surfels, mut diced) = (Vec::new(), DicedScene::new(&scene, options).unwrap());
        while diced.read_chunk(&mut surfels).unwrap() {}
        let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
        let settings = GatherSettings { solid_angle_sr: 0.0, ..GatherSettings::default() };
        let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
        let (mut worst, mut sum, mut count) = (0f32, 0.0, 0);
        let planes = faces.iter().map(|face| {
            let [a, b, c] = face.map(|k| corners[k as usize]);
            (a, b, c, (c - a).cross(b - a).normalize())
        });
        for (a, b, c, inward) in planes.clone() {
            for [u, v] in [[0.33, 0.33], [0.02, 0.02], [0.9, 0.05], [0.1, 0.7], [0.004, 0.5]] {
                // On the face, and a little before it.
                for height in [0.0, 0.01, 0.2] {
                    let place = a + (b - a) * u + (c - a) * v + inward * height;
                    if planes.clone().any(|(a, .., normal)| normal.dot(place - a) < -1e-4) {
                        continue;
                    }
                    let found = gatherer.gather(&Receiver::diffuse(place, inward)).unwrap();
                    worst = worst.max(found.ambient_occlusion);
                    (sum, count) = (sum + found.ambient_occlusion, count + 1);
                }
            }
        }
        let mean = sum / count as f32;
        assert!(worst < 1e-2 && mean < 3e-4, "{spacing}: {worst}, {mean}");
    }
}
