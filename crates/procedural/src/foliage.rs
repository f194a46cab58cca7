//! A thicket on grass: much surface in little space.

use super::ProceduralScene;
use super::builder::{Paint, SceneBuilder};
use super::plants::{PlantPaints, TreeShape, shrub, tree};
use super::random::Random;
use pbgi_math::{Affine3A, Vec3};
use pbgi_scene::Camera;

/// `tree_count` trees and four times as many shrubs on a clearing of 30 m.
pub(super) fn foliage(seed: u64, tree_count: u32) -> ProceduralScene {
    let mut builder = SceneBuilder::default();
    let paints = PlantPaints::new(&mut builder);
    let ground = builder.paint("ground", [0.27, 0.24, 0.14]);
    let blade = builder.cloth("grass", [0.23, 0.33, 0.09]);
    let mut random = Random::new(seed);
    let rows: Vec<Vec<(Vec3, [f32; 3])>> = (0..=60)
        .map(|i| {
            let z = 15.0 - i as f32 * 0.5;
            let at = |k: i32| {
                let x = -15.0 + k as f32 * 0.5;
                (Vec3::new(x, ground_height(x, z), z), random.shade(0.12))
            };
            (0..=60).map(at).collect()
        })
        .collect();
    builder.pen(Affine3A::IDENTITY).surface(ground, &rows);
    // Golden-angle spiral: even spacing for any count.
    let place = |i: u32, count: u32, radius: f32| {
        let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
        let r = radius * ((i as f32 + 0.5) / count as f32).sqrt();
        Vec3::new(r * cos, ground_height(r * cos, r * sin), r * sin)
    };
    for i in 0..tree_count {
        let mut random = Random::for_part(seed, 100 + u64::from(i));
        let shape = TreeShape {
            height: random.range(4.5, 6.5),
            crown_radius: random.range(1.4, 2.0),
            leaf_count: 7500,
        };
        let frame = Affine3A::from_translation(place(i, tree_count, 4.2));
        tree(&mut builder.pen(frame), paints, &mut random, shape);
    }
    for i in 0..tree_count * 4 {
        let mut random = Random::for_part(seed, 5000 + u64::from(i));
        let frame = Affine3A::from_translation(place(i, tree_count * 4, 6.0));
        let radius = random.range(0.35, 0.8);
        shrub(&mut builder.pen(frame), paints, &mut random, radius, i % 3 == 0);
    }
    grass(&mut builder, blade, &mut random);
    let eye = Vec3::new(2.6, 1.7, 11.0);
    let camera = Camera::look_at(eye, Vec3::new(-0.2, 2.5, 0.0), Vec3::Y, 0.80);
    ProceduralScene {
        scene: builder.finish(camera),
        sun_direction: Vec3::new(0.7, 0.55, 0.35).normalize(),
        up: Vec3::Y,
    }
}

fn ground_height(x: f32, z: f32) -> f32 {
    0.18 * (x * 0.6 + 1.0).sin() * (z * 0.5).cos()
}

fn grass(builder: &mut SceneBuilder, paint: Paint, random: &mut Random) {
    let mut pen = builder.pen(Affine3A::IDENTITY);
    for _ in 0..14000 {
        let (x, z) = (random.range(-10.0, 10.0), random.range(-10.0, 11.0));
        let root = Vec3::new(x, ground_height(x, z) - 0.02, z);
        let (sin, cos) = (random.unit() * std::f32::consts::TAU).sin_cos();
        let side = Vec3::new(cos, 0.0, sin) * 0.012;
        let height = random.range(0.08, 0.26);
        let tip = root + Vec3::new(-sin * 0.3, 1.0, cos * 0.3) * height;
        let shade = random.range(0.7, 1.3);
        pen.polygon(paint, [shade, shade, shade * 0.8], &[root - side, root + side, tip]);
    }
}
