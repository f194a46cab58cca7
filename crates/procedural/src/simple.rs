//! Small scenes with known answers: the Cornell box, a closed room, spheres under a sky.

use super::ProceduralScene;
use super::builder::{PLAIN, Paint, SceneBuilder};
use super::random::Random;
use pbgi_math::{Affine3A, Vec3};
use pbgi_scene::Camera;

/// The Cornell box of Cornell's measured data (graphics.cornell.edu/online/box/data.html) in
/// meters; albedos are the measured reflectance spectra as linear Rec. 709.
pub(super) fn cornell() -> ProceduralScene {
    let mut builder = SceneBuilder::default();
    let white = builder.paint("white", [0.73, 0.71, 0.68]);
    let red = builder.paint("red", [0.61, 0.06, 0.06]);
    let green = builder.paint("green", [0.12, 0.43, 0.11]);
    let lamp = builder.lamp("lamp", [17.0, 12.0, 4.0]);
    // Cornell's x runs to the left and z away from its camera; here x runs right and z toward it.
    let point = |x: f32, y: f32, z: f32| Vec3::new(556.0 - x, y, -z) * 0.001;
    let corners = [(0.0, 559.2), (556.0, 559.2), (552.8, 0.0), (0.0, 0.0)];
    let mut pen = builder.pen(Affine3A::IDENTITY);
    pen.polygon(white, PLAIN, &corners.map(|(x, z)| point(x, 0.0, z)));
    let ceiling = [(0.0, 0.0), (556.0, 0.0), (556.0, 559.2), (0.0, 559.2)];
    pen.polygon(white, PLAIN, &ceiling.map(|(x, z)| point(x, 548.8, z)));
    let back = [(0.0, 548.8), (556.0, 548.8), (556.0, 0.0), (0.0, 0.0)];
    pen.polygon(white, PLAIN, &back.map(|(x, y)| point(x, y, 559.2)));
    let right = [(548.8, 0.0), (548.8, 559.2), (0.0, 559.2), (0.0, 0.0)];
    pen.polygon(green, PLAIN, &right.map(|(y, z)| point(0.0, y, z)));
    let left = [
        point(556.0, 0.0, 559.2),
        point(556.0, 548.8, 559.2),
        point(556.0, 548.8, 0.0),
        point(552.8, 0.0, 0.0),
    ];
    pen.polygon(red, PLAIN, &left);
    let light = [(213.0, 227.0), (343.0, 227.0), (343.0, 332.0), (213.0, 332.0)];
    pen.polygon(lamp, PLAIN, &light.map(|(x, z)| point(x, 548.7, z)));
    let short = [(82.0, 225.0), (240.0, 272.0), (290.0, 114.0), (130.0, 65.0)];
    let tall = [(265.0, 296.0), (314.0, 456.0), (472.0, 406.0), (423.0, 247.0)];
    for (base, height) in [(short, 165.0), (tall, 330.0)] {
        pen.polygon(white, PLAIN, &base.map(|(x, z)| point(x, height, z)));
        for i in 0..4 {
            let ((x0, z0), (x1, z1)) = (base[i], base[(i + 1) % 4]);
            let low = [point(x0, 0.0, z0), point(x1, 0.0, z1)];
            let high = [point(x1, height, z1), point(x0, height, z0)];
            pen.polygon(white, PLAIN, &[low[0], low[1], high[0], high[1]]);
        }
    }
    let eye = Vec3::new(0.278, 0.273, 0.8);
    let camera = Camera::look_at(eye, Vec3::new(0.278, 0.273, 0.0), Vec3::Y, 0.6868);
    ProceduralScene {
        scene: builder.finish(camera),
        sun_direction: Vec3::new(0.2, 0.6, 0.8).normalize(),
        up: Vec3::Y,
    }
}

/// A closed box of 4 × 3 × 5 m whose sides face inward, albedo 0.8, with a lamp of 1 × 1 m just
/// below the ceiling.
pub(super) fn room() -> ProceduralScene {
    let mut builder = SceneBuilder::default();
    let white = builder.paint("white", [0.8; 3]);
    let lamp = builder.lamp("lamp", [10.0; 3]);
    let mut pen = builder.pen(Affine3A::IDENTITY);
    closed_box(&mut pen, white, Vec3::new(-2.0, 0.0, -2.5), Vec3::new(2.0, 3.0, 2.5));
    pen.rectangle(lamp, Vec3::new(-0.5, 2.999, -0.5), Vec3::X, Vec3::Z);
    let camera =
        Camera::look_at(Vec3::new(0.6, 1.5, 2.3), Vec3::new(-0.2, 1.2, -1.0), Vec3::Y, 0.95);
    ProceduralScene { scene: builder.finish(camera), sun_direction: Vec3::Y, up: Vec3::Y }
}

/// Six inward faces; neighbors share the corners bit for bit.
fn closed_box(pen: &mut super::builder::Pen, paint: Paint, min: Vec3, max: Vec3) {
    let corner = |i: usize| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { min[axis] } else { max[axis] };
        Vec3::new(pick(0), pick(1), pick(2))
    };
    for face in [[2, 6, 4, 0], [5, 7, 3, 1], [4, 5, 1, 0], [3, 7, 6, 2], [1, 3, 2, 0], [6, 7, 5, 4]]
    {
        pen.polygon(paint, PLAIN, &face.map(corner));
    }
}

/// Spheres and boxes of many colors on a plane of 60 m.
pub(super) fn spheres(seed: u64, count: u32) -> ProceduralScene {
    let mut builder = SceneBuilder::default();
    let ground = builder.paint("ground", [0.45, 0.43, 0.40]);
    let paint = builder.paint("painted", [0.8; 3]);
    let mut random = Random::new(seed);
    let mut pen = builder.pen(Affine3A::IDENTITY);
    let rows: Vec<Vec<(Vec3, [f32; 3])>> = (0..=30)
        .map(|i| {
            let z = 30.0 - 2.0 * i as f32;
            (0..=30).map(|k| (Vec3::new(2.0 * k as f32 - 30.0, 0.0, z), PLAIN)).collect()
        })
        .collect();
    pen.surface(ground, &rows);
    let tints = [
        [0.95, 0.30, 0.22],
        [0.98, 0.72, 0.22],
        [0.30, 0.62, 0.42],
        [0.26, 0.48, 0.85],
        [0.95, 0.92, 0.86],
        [0.62, 0.40, 0.72],
    ];
    let step = 2.1;
    for i in 0..count {
        // A spiral leaves room for each: the largest radius is below half the distance.
        let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
        let r = step * (i as f32 + 0.2).sqrt();
        let size = random.range(0.45, 0.95);
        let tint = random.pick(&tints);
        let center = Vec3::new(r * cos, 0.0, r * sin);
        if i % 4 == 3 {
            let (sin, cos) = random.range(0.0, 1.5).sin_cos();
            let turn = pbgi_math::Mat3::from_cols(
                Vec3::new(cos, 0.0, -sin),
                Vec3::Y,
                Vec3::new(sin, 0.0, cos),
            );
            let mut nested = pen.within(Affine3A::from_mat3_translation(turn, center));
            let half = size * 0.6;
            let top = size * random.range(1.0, 2.4);
            nested.tinted_block(
                paint,
                tint,
                Vec3::new(-half, 0.0, -half),
                Vec3::new(half, top, half),
            );
        } else {
            pen.ellipsoid(paint, tint, center + Vec3::Y * size, Vec3::splat(size), 32);
        }
    }
    let camera =
        Camera::look_at(Vec3::new(0.0, 5.5, 15.0), Vec3::new(0.0, 0.6, 0.0), Vec3::Y, 0.75);
    ProceduralScene {
        scene: builder.finish(camera),
        sun_direction: Vec3::new(0.6, 0.5, 0.35).normalize(),
        up: Vec3::Y,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_scene::{CameraView, HideOptions, hide};

    #[test]
    fn room_is_closed_from_every_side() {
        let made = room();
        for (x, y, z) in [(1.0, 0.2, 0.3), (-1.0, 0.1, 0.7), (0.1, 1.0, 0.2), (0.3, -1.0, -0.4)] {
            let eye = Vec3::new(0.31, 1.23, -0.77);
            let camera = Camera::look_at(eye, eye + Vec3::new(x, y, z), Vec3::Y, 2.0);
            let view = CameraView { camera, width: 64, height: 64 };
            let visible = hide(&made.scene, &view, &HideOptions::default()).unwrap();
            assert!(visible.coverage.alpha().iter().all(|alpha| *alpha == 1.0));
            assert!(visible.micropolygons.iter().all(|micropolygon| !micropolygon.back));
        }
    }

    #[test]
    fn cornell_walls_face_inward() {
        let made = cornell();
        let view = CameraView { camera: made.scene.cameras[0].clone(), width: 64, height: 64 };
        let visible = hide(&made.scene, &view, &HideOptions::default()).unwrap();
        assert!(visible.micropolygons.iter().all(|micropolygon| !micropolygon.back));
        let lit = visible.micropolygons.iter().filter(|m| m.emission[0] > 0.0).count();
        assert!(lit > 20, "{lit}");
    }
}
