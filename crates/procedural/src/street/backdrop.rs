//! What stands behind the street: the church, houses of the town, woods on the hills.

use super::path::{LOT_END, StreetPath};
use super::{StreetPaints, TownPaints};
use crate::builder::{PLAIN, Paint, Pen, SceneBuilder};
use crate::random::Random;
use pbgi_math::{Affine3A, Mat3, Vec3};

/// Draws the surroundings of a street that ends at `end`.
pub(super) fn backdrop(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    seed: u64,
    end: f32,
) {
    let mut random = Random::for_part(seed, 3);
    let (x, z) = (-8.0, -(end.clamp(60.0, 110.0) + 18.0));
    let foot = Vec3::new(x, path.land_height(x, z) - 1.0, z);
    let frame = Affine3A::from_translation(foot) * Affine3A::from_mat3(Mat3::from_rotation_y(0.35));
    church(&mut builder.pen(frame), paints);
    town(builder, paints, path, &mut random, end);
    woods(builder, paints, path, &mut random);
}

/// A tower of 6 × 6 m with belfry, clock and spire, and a nave behind it; the tower faces +Z.
fn church(pen: &mut Pen, paints: &StreetPaints) {
    let stone = [1.30, 1.18, 0.98];
    let half = 3.0;
    let mut part = |paint: Paint, tint: [f32; 3], min: [f32; 3], max: [f32; 3]| {
        pen.tinted_block(paint, tint, Vec3::from_array(min), Vec3::from_array(max));
    };
    part(paints.stone, stone, [-half, -4.0, -half], [half, 27.0, half]);
    for (y, reach) in [(9.0, 0.22), (17.0, 0.22), (26.6, 0.30), (27.0, 0.50)] {
        let r = half + reach;
        part(paints.stone, stone, [-r, y, -r], [r, y + 0.4, r]);
    }
    for (x, z) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let (a, b) = (half - 0.55, half + 0.28);
        let range = |s: f32| if s > 0.0 { (a, b) } else { (-b, -a) };
        let ((x0, x1), (z0, z1)) = (range(x), range(z));
        part(paints.stone, stone, [x0, -4.0, z0], [x1, 26.6, z1]);
    }
    part(paints.stone, stone, [-5.0, -4.0, -26.0], [5.0, 9.0, -half]);
    for turn in 0..4 {
        let angle = turn as f32 * std::f32::consts::FRAC_PI_2;
        let frame = Affine3A::from_mat3(Mat3::from_rotation_y(angle));
        tower_face(&mut pen.within(frame), paints, half);
    }
    spire(pen, paints, half);
    for side in [-1.0f32, 1.0] {
        let mut roof = [
            Vec3::new(side * 5.6, 8.4, -2.9),
            Vec3::new(side * 5.6, 8.4, -26.4),
            Vec3::new(0.0, 14.6, -26.4),
            Vec3::new(0.0, 14.6, -2.9),
        ];
        if side < 0.0 {
            roof.reverse();
        }
        pen.polygon(paints.tile, PLAIN, &roof);
    }
    let gable =
        [Vec3::new(-5.0, 9.0, -26.0), Vec3::new(0.0, 14.5, -26.0), Vec3::new(5.0, 9.0, -26.0)];
    pen.polygon(paints.stone, stone, &gable);
}

/// Belfry openings with louvers, a clock and slit windows on one face of the tower.
fn tower_face(pen: &mut Pen, paints: &StreetPaints, half: f32) {
    for x in [-1.15, 1.15] {
        let (min, max) = (Vec3::new(x - 0.62, 18.6, half), Vec3::new(x + 0.62, 22.4, half + 0.02));
        pen.block(paints.glass, min, max);
        pen.disk(paints.glass, Vec3::new(x, 22.4, half + 0.02), Vec3::Z, 0.62, 20);
        for k in 0..8 {
            let y = 18.7 + 0.45 * k as f32;
            let (min, max) =
                (Vec3::new(x - 0.6, y, half), Vec3::new(x + 0.6, y + 0.14, half + 0.16));
            pen.tinted_block(paints.wood, [0.40, 0.36, 0.32], min, max);
        }
        for edge in [-0.74, 0.62] {
            let (min, max) = (
                Vec3::new(x + edge, 18.5, half - 0.02),
                Vec3::new(x + edge + 0.12, 22.5, half + 0.12),
            );
            pen.block(paints.trim, min, max);
        }
    }
    let center = Vec3::new(0.0, 24.7, half + 0.1);
    pen.disk(paints.metal, center, Vec3::Z, 1.45, 32);
    pen.disk(paints.trim, center + Vec3::Z * 0.04, Vec3::Z, 1.30, 32);
    let hands = Affine3A::from_translation(center + Vec3::Z * 0.07);
    for (angle, length, width) in [(-0.6f32, 0.75, 0.09), (1.9, 1.1, 0.06)] {
        let turn = Affine3A::from_mat3(Mat3::from_rotation_z(angle));
        let (min, max) = (Vec3::new(-width, -0.15, 0.0), Vec3::new(width, length, 0.03));
        pen.within(hands * turn).block(paints.metal, min, max);
    }
    for y in [11.0, 14.0] {
        let (min, max) = (Vec3::new(-0.4, y, half), Vec3::new(0.4, y + 1.8, half + 0.03));
        pen.block(paints.glass, min, max);
        let (min, max) = (Vec3::new(-0.6, y - 0.2, half), Vec3::new(0.6, y, half + 0.15));
        pen.block(paints.trim, min, max);
    }
}

/// A copper helm that turns from the square tower into an octagon, with a gilt ball.
fn spire(pen: &mut Pen, paints: &StreetPaints, half: f32) {
    let base = half + 0.35;
    let ring = |y: f32, r: f32| -> Vec<Vec3> {
        (0..8)
            .map(|k| {
                let (sin, cos) = ((k as f32 + 0.5) * std::f32::consts::TAU / 8.0).sin_cos();
                Vec3::new(r * sin, y, r * cos)
            })
            .collect()
    };
    let levels = [ring(27.4, base * 1.08), ring(29.6, 2.3), ring(30.2, 1.9), ring(43.5, 0.12)];
    for pair in levels.windows(2) {
        for k in 0..8 {
            let next = (k + 1) % 8;
            let tint = [0.92 + 0.03 * (k % 3) as f32; 3];
            let corners = [pair[0][k], pair[0][next], pair[1][next], pair[1][k]];
            pen.polygon(paints.copper, tint, &corners);
        }
    }
    pen.ellipsoid(paints.gilt, PLAIN, Vec3::Y * 43.8, Vec3::splat(0.42), 10);
    let (min, max) = (Vec3::new(-0.06, 44.1, -0.06), Vec3::new(0.06, 46.2, 0.06));
    pen.block(paints.gilt, min, max);
    pen.block(paints.gilt, Vec3::new(-0.55, 45.2, -0.06), Vec3::new(0.55, 45.35, 0.06));
}

/// Plain houses on the land behind both rows and beyond the street's end.
fn town(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    random: &mut Random,
    end: f32,
) {
    let walls = [[1.0, 0.94, 0.82], [0.95, 0.72, 0.48], [0.90, 0.84, 0.76], [0.80, 0.52, 0.40]];
    for number in 0..74 {
        let s = random.range(-20.0, end + 50.0);
        let side = if number % 2 == 0 { -1.0 } else { 1.0 };
        let out = LOT_END + 10.0 + 130.0 * random.unit().powi(2);
        let place = path.point(s, side * out, 0.0);
        let near_church = (place.x + 8.0).abs() < 16.0 && place.z < -end - 2.0;
        if near_church {
            continue;
        }
        let foot = Vec3::new(place.x, path.land_height(place.x, place.z) - 0.5, place.z);
        let turn = Mat3::from_rotation_y(random.range(0.0, 3.1));
        let frame = Affine3A::from_mat3_translation(turn, foot);
        let size = [random.range(7.0, 11.0), random.range(5.0, 7.5), random.range(7.0, 9.0)];
        plain_house(
            &mut builder.pen(frame),
            paints.town,
            random.pick(&walls),
            random.shade(0.2),
            size,
        );
    }
}

fn plain_house(
    pen: &mut Pen,
    paints: TownPaints,
    wall: [f32; 3],
    roof: [f32; 3],
    [w, h, d]: [f32; 3],
) {
    let (x, z) = (w * 0.5, d * 0.5);
    pen.tinted_block(paints.plaster, wall, Vec3::new(-x, -2.0, -z), Vec3::new(x, h, z));
    let ridge = h + d * 0.42;
    for side in [-1.0f32, 1.0] {
        let eave = side * (z + 0.4);
        let mut slope = [
            Vec3::new(-x - 0.3, h - 0.3, eave),
            Vec3::new(x + 0.3, h - 0.3, eave),
            Vec3::new(x + 0.3, ridge, 0.0),
            Vec3::new(-x - 0.3, ridge, 0.0),
        ];
        let mut gable = [
            Vec3::new(side * x, h, z),
            Vec3::new(side * x, h, -z),
            Vec3::new(side * x, ridge - 0.1, 0.0),
        ];
        if side < 0.0 {
            slope.reverse();
            gable.reverse();
        }
        pen.polygon(paints.tile, roof, &slope);
        pen.polygon(paints.plaster, wall, &gable);
        for k in 0..3 {
            let cx = w * (k as f32 / 3.0 - 1.0 / 3.0);
            for y in [1.2, 3.8] {
                let reach = z + 0.03;
                let (near, far) = (side * (reach - 0.1), side * reach);
                let min = Vec3::new(cx - 0.5, y, near.min(far));
                let max = Vec3::new(cx + 0.5, y + 1.4, near.max(far));
                pen.block(paints.glass, min, max);
            }
        }
    }
    let foot = Vec3::new(x * 0.4, ridge - 1.0, 0.6);
    pen.block(paints.brick, foot, foot + Vec3::new(0.8, 1.9, 0.6));
}

/// Round tree crowns on the land, denser up the slopes.
fn woods(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    random: &mut Random,
) {
    let mut pen = builder.pen(Affine3A::IDENTITY);
    for _ in 0..800 {
        let angle = random.range(0.0, std::f32::consts::TAU);
        let radius = 60.0 * (random.unit() * 2.6f32).exp();
        let (x, z) = (radius * angle.cos(), radius * angle.sin());
        let height = path.land_height(x, z);
        let clear = path.point((-z).clamp(-30.0, 140.0), 0.0, 0.0);
        let near_street = (x - clear.x).abs() < LOT_END + 12.0 && (-60.0..180.0).contains(&-z);
        if near_street || random.unit() > 0.25 + height / 30.0 {
            continue;
        }
        let size = random.range(2.2, 4.6) * (1.0 + radius / 900.0);
        let shade = random.range(0.45, 0.85);
        let haze = (radius / 1500.0).min(1.0);
        let tint = [shade * 0.8, shade * (1.0 - 0.2 * haze), shade * (0.8 + 2.0 * haze)];
        let radii = Vec3::new(size, size * random.range(0.9, 1.4), size);
        let center = Vec3::new(x, height + radii.y * 0.7, z);
        pen.ellipsoid(paints.land, tint, center, radii, 5);
    }
}
