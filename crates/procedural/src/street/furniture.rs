//! What stands on the street: lamps, benches, cars, café tables, flowers, bunting.

use super::StreetPaints;
use super::path::{CURB, FACADE, ROAD_HALF, StreetPath};
use crate::builder::{PLAIN, Pen, SceneBuilder};
use crate::plants::shrub;
use crate::random::Random;
use pbgi_math::{Affine3A, Mat3, Vec3};

/// Cloth and lacquer colors, as multiples of 0.8.
const BRIGHT: [[f32; 3]; 6] = [
    [0.95, 0.16, 0.10],
    [1.02, 0.66, 0.10],
    [0.10, 0.40, 0.75],
    [0.98, 0.94, 0.84],
    [0.15, 0.52, 0.34],
    [0.85, 0.32, 0.50],
];

/// A box of flowers hung below a window; `corner` is its rear left upper corner.
pub(super) fn flower_box(
    pen: &mut Pen,
    paints: &StreetPaints,
    random: &mut Random,
    corner: Vec3,
    length: f32,
) {
    let max = corner + Vec3::new(length, 0.0, 0.22);
    pen.tinted_block(paints.wood, [0.34, 0.22, 0.14], corner - Vec3::Y * 0.2, max);
    let count = (length / 0.30) as u32;
    for k in 0..count {
        let x = (k as f32 + 0.5) / count as f32 * length;
        let place = corner + Vec3::new(x, 0.0, 0.12);
        let mut nested = pen.within(Affine3A::from_translation(place));
        shrub(&mut nested, paints.plants, random, 0.15, true);
    }
}

/// An open plot: lawn behind a low wall with a hedge, shrubs and a bench.
pub(super) fn garden(pen: &mut Pen, paints: &StreetPaints, random: &mut Random, width: f32) {
    let grass = [0.62, 0.95, 0.42];
    let lawn = [
        Vec3::new(0.0, 0.03, -0.6),
        Vec3::new(width, 0.03, -0.6),
        Vec3::new(width, 0.03, -13.5),
        Vec3::new(0.0, 0.03, -13.5),
    ];
    pen.polygon(paints.lot, grass, &lawn);
    let gate = width * 0.5;
    for (x0, x1) in [(0.1, gate - 0.8), (gate + 0.8, width - 0.1)] {
        if x1 - x0 < 0.3 {
            continue;
        }
        let (min, max) = (Vec3::new(x0, -0.6, -0.55), Vec3::new(x1, 0.50, -0.20));
        pen.block(paints.stone, min, max);
        let (min, max) = (Vec3::new(x0 - 0.05, 0.50, -0.60), Vec3::new(x1 + 0.05, 0.58, -0.15));
        pen.block(paints.trim, min, max);
        let mut x = x0 + 0.5;
        while x < x1 - 0.3 {
            let mut nested = pen.within(Affine3A::from_translation(Vec3::new(x, 0.0, -1.2)));
            let blooms = random.chance(0.5);
            shrub(&mut nested, paints.plants, random, hedge_radius(x), blooms);
            x += 0.85;
        }
    }
    for x in [gate - 0.8, gate + 0.8] {
        let (min, max) = (Vec3::new(x - 0.22, -0.6, -0.62), Vec3::new(x + 0.22, 1.25, -0.13));
        pen.block(paints.brick, min, max);
        let (min, max) = (Vec3::new(x - 0.28, 1.25, -0.68), Vec3::new(x + 0.28, 1.35, -0.07));
        pen.block(paints.stone, min, max);
        pen.ellipsoid(paints.stone, PLAIN, Vec3::new(x, 1.53, -0.375), Vec3::splat(0.18), 8);
    }
}

/// Shrub radii that vary along a hedge.
fn hedge_radius(x: f32) -> f32 {
    0.46 + 0.12 * (x * 2.7).sin()
}

/// Places everything along the street up to `end`.
pub(super) fn furnish(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    seed: u64,
    end: f32,
) {
    let mut random = Random::for_part(seed, 2);
    let place = |s: f32, offset: f32, rise: f32, turn: f32| {
        let frame = path.frame(s) * Affine3A::from_translation(Vec3::new(offset, rise, 0.0));
        frame * Affine3A::from_mat3(Mat3::from_rotation_y(turn))
    };
    let mut s = 9.5;
    let mut side = -1.0f32;
    while s < end {
        let frame = place(s, side * (ROAD_HALF + 0.55), CURB, 0.0);
        lamp_post(&mut builder.pen(frame), paints, -side);
        s += 8.5;
        side = -side;
    }
    let quarter = std::f32::consts::FRAC_PI_2;
    for (s, offset, color) in [
        (15.5, ROAD_HALF - 1.05, [0.12, 0.42, 0.46]),
        (27.0, 1.05 - ROAD_HALF, [0.92, 0.80, 0.52]),
        (33.5, ROAD_HALF - 1.05, [0.70, 0.10, 0.07]),
        (57.0, 1.05 - ROAD_HALF, [0.25, 0.40, 0.60]),
    ] {
        if s < end {
            car(&mut builder.pen(place(s, offset, 0.0, 0.0)), paints, color);
        }
    }
    for (s, side) in [(5.2, 1.0f32), (13.0, 1.0), (38.0, -1.0)] {
        let frame = place(s, side * (FACADE - 0.55), CURB, -side * quarter);
        bench(&mut builder.pen(frame), paints);
    }
    for (number, s) in [8.2, 11.2, 14.2].into_iter().enumerate() {
        let frame = place(s, -(FACADE - 1.35), CURB, random.range(0.0, 1.5));
        cafe_table(&mut builder.pen(frame), paints, number);
    }
    let mut s = 4.0;
    while s < end {
        for side in [-1.0, 1.0] {
            if random.chance(0.5) {
                let frame = place(s + 2.0 * side, side * (FACADE - 0.38), CURB, 0.0);
                planter(&mut builder.pen(frame), paints, &mut random);
            }
        }
        s += 5.5;
    }
    for s in [20.0, 31.0, 44.0].into_iter().filter(|s| *s < end) {
        bunting(&mut builder.pen(place(s, 0.0, 0.0, random.range(-0.2, 0.2))), paints);
    }
}

/// An iron post with a lantern on an arm that reaches toward `side`.
fn lamp_post(pen: &mut Pen, paints: &StreetPaints, side: f32) {
    let ring = |y: f32, r: f32| (Vec3::Y * y, r);
    let post = [
        ring(0.0, 0.17),
        ring(0.12, 0.16),
        ring(0.16, 0.11),
        ring(0.75, 0.09),
        ring(0.80, 0.12),
        ring(0.86, 0.06),
        ring(3.4, 0.042),
    ];
    pen.tube(paints.metal, PLAIN, &post, 12);
    let arm = [
        Vec3::new(0.0, 3.35, 0.0),
        Vec3::new(side * 0.12, 3.75, 0.0),
        Vec3::new(side * 0.40, 3.92, 0.0),
        Vec3::new(side * 0.68, 3.86, 0.0),
    ];
    for pair in arm.windows(2) {
        pen.tube(paints.metal, PLAIN, &[(pair[0], 0.032), (pair[1], 0.028)], 8);
    }
    let head = Vec3::new(side * 0.68, 3.84, 0.0);
    let glass = [
        (head - Vec3::Y * 0.58, 0.07),
        (head - Vec3::Y * 0.52, 0.13),
        (head - Vec3::Y * 0.20, 0.19),
    ];
    pen.tube(paints.curtain, [1.4, 1.5, 1.5], &glass, 8);
    let cap = [
        (head - Vec3::Y * 0.21, 0.21),
        (head - Vec3::Y * 0.17, 0.22),
        (head - Vec3::Y * 0.06, 0.08),
        (head + Vec3::Y * 0.06, 0.012),
    ];
    pen.tube(paints.metal, PLAIN, &cap, 8);
    pen.disk(paints.metal, head - Vec3::Y * 0.58, Vec3::NEG_Y, 0.07, 8);
}

/// A slatted bench that faces +Z.
fn bench(pen: &mut Pen, paints: &StreetPaints) {
    let oak = [0.50, 0.31, 0.17];
    for k in 0..4 {
        let z = 0.02 + 0.11 * k as f32;
        let (min, max) = (Vec3::new(-0.85, 0.42, z), Vec3::new(0.85, 0.46, z + 0.09));
        pen.tinted_block(paints.wood, oak, min, max);
    }
    for k in 0..3 {
        let y = 0.56 + 0.13 * k as f32;
        let z = -0.05 - 0.02 * k as f32;
        let (min, max) = (Vec3::new(-0.85, y, z), Vec3::new(0.85, y + 0.10, z + 0.035));
        pen.tinted_block(paints.wood, oak, min, max);
    }
    for x in [-0.75, 0.70] {
        let leg = |z0: f32, z1: f32, y: f32| (Vec3::new(x, 0.0, z0), Vec3::new(x + 0.05, y, z1));
        for (min, max) in [leg(0.38, 0.44, 0.42), leg(-0.06, 0.0, 0.92)] {
            pen.block(paints.metal, min, max);
        }
        let (min, max) = (Vec3::new(x, 0.37, 0.0), Vec3::new(x + 0.05, 0.42, 0.44));
        pen.block(paints.metal, min, max);
    }
}

/// A small rounded car, its front toward −Z.
fn car(pen: &mut Pen, paints: &StreetPaints, color: [f32; 3]) {
    // Profiles are drawn in x-y and turned so that x runs forward (−Z), z across.
    let turn = Mat3::from_cols(Vec3::NEG_Z, Vec3::Y, Vec3::X);
    let mut side = pen.within(Affine3A::from_mat3(turn));
    let body: [[f32; 2]; 10] = [
        [-1.78, 0.30],
        [1.70, 0.30],
        [1.84, 0.42],
        [1.84, 0.60],
        [1.70, 0.74],
        [0.95, 0.86],
        [-1.35, 0.88],
        [-1.70, 0.80],
        [-1.86, 0.62],
        [-1.86, 0.40],
    ];
    extrude_rounded(&mut side, paints, color, &body, 0.80);
    let cabin: [[f32; 2]; 6] =
        [[-1.50, 0.86], [0.92, 0.86], [0.42, 1.36], [0.22, 1.44], [-0.85, 1.44], [-1.12, 1.36]];
    extrude_rounded(&mut side, paints, color, &cabin, 0.66);
    windows_of_car(&mut side, paints);
    let chrome = [0.9; 3];
    for (x0, x1) in [(1.80, 1.94), (-1.95, -1.82)] {
        side.tinted_block(
            paints.trim,
            chrome,
            Vec3::new(x0, 0.34, -0.78),
            Vec3::new(x1, 0.46, 0.78),
        );
    }
    for z in [-0.55, 0.55] {
        side.ellipsoid(paints.trim, PLAIN, Vec3::new(1.78, 0.64, z), Vec3::splat(0.12), 8);
        side.tinted_block(
            paints.lacquer,
            [0.8, 0.05, 0.04],
            Vec3::new(-1.88, 0.58, z - 0.12),
            Vec3::new(-1.80, 0.72, z + 0.12),
        );
    }
    for (x, z) in [(1.15, 0.72), (1.15, -0.72), (-1.15, 0.72), (-1.15, -0.72)] {
        let hub = Vec3::new(x, 0.31, z);
        let out = Vec3::Z * z.signum();
        let rings = [(hub - out * 0.09, 0.31), (hub + out * 0.10, 0.31), (hub + out * 0.12, 0.27)];
        side.tube(paints.rubber, PLAIN, &rings, 18);
        side.disk(paints.rubber, hub + out * 0.12, out, 0.272, 18);
        side.disk(paints.trim, hub + out * 0.125, out, 0.17, 14);
        side.disk(paints.rubber, hub - out * 0.09, -out, 0.31, 18);
    }
}

/// A convex profile in the middle and a slightly smaller one at both flanks.
fn extrude_rounded(
    pen: &mut Pen,
    paints: &StreetPaints,
    color: [f32; 3],
    profile: &[[f32; 2]],
    half_width: f32,
) {
    let count = profile.len() as f32;
    let center = profile.iter().fold([0.0; 2], |c, p| [c[0] + p[0] / count, c[1] + p[1] / count]);
    let shrink = |p: &[f32; 2], by: f32| {
        [center[0] + (p[0] - center[0]) * by, center[1] + (p[1] - center[1]) * by]
    };
    let rings: Vec<(f32, f32)> = vec![
        (-half_width, 0.90),
        (-half_width + 0.07, 0.98),
        (-half_width + 0.2, 1.0),
        (half_width - 0.2, 1.0),
        (half_width - 0.07, 0.98),
        (half_width, 0.90),
    ];
    let at = |p: &[f32; 2], (z, by): (f32, f32)| {
        let [x, y] = shrink(p, by);
        Vec3::new(x, y, z)
    };
    for pair in rings.windows(2) {
        for (i, a) in profile.iter().enumerate() {
            let b = &profile[(i + 1) % profile.len()];
            let corners = [at(a, pair[0]), at(b, pair[0]), at(b, pair[1]), at(a, pair[1])];
            pen.polygon(paints.lacquer, color, &corners);
        }
    }
    let front: Vec<Vec3> = profile.iter().map(|p| at(p, rings[5])).collect();
    let back: Vec<Vec3> = profile.iter().rev().map(|p| at(p, rings[0])).collect();
    pen.polygon(paints.lacquer, color, &front);
    pen.polygon(paints.lacquer, color, &back);
}

fn windows_of_car(pen: &mut Pen, paints: &StreetPaints) {
    let pane = |pen: &mut Pen, corners: &[[f32; 2]], z: f32| {
        let mut corners: Vec<Vec3> = corners.iter().map(|p| Vec3::new(p[0], p[1], z)).collect();
        if z < 0.0 {
            corners.reverse();
        }
        pen.polygon(paints.glass, PLAIN, &corners);
    };
    for z in [-0.665, 0.665] {
        pane(pen, &[[-0.30, 0.93], [0.66, 0.93], [0.28, 1.32], [-0.30, 1.34]], z);
        pane(pen, &[[-1.22, 0.93], [-0.38, 0.93], [-0.38, 1.34], [-0.92, 1.33]], z);
    }
    let mut screen = |low: [f32; 2], high: [f32; 2], w0: f32, w1: f32| {
        let corners = [
            Vec3::new(low[0], low[1], -w0),
            Vec3::new(high[0], high[1], -w1),
            Vec3::new(high[0], high[1], w1),
            Vec3::new(low[0], low[1], w0),
        ];
        pen.polygon(paints.glass, PLAIN, &corners);
    };
    screen([0.875, 0.925], [0.47, 1.33], 0.55, 0.48);
    let rear = [[-1.47, 0.925], [-1.145, 1.33]];
    let corners = [
        Vec3::new(rear[0][0], rear[0][1], 0.52),
        Vec3::new(rear[1][0], rear[1][1], 0.46),
        Vec3::new(rear[1][0], rear[1][1], -0.46),
        Vec3::new(rear[0][0], rear[0][1], -0.52),
    ];
    pen.polygon(paints.glass, PLAIN, &corners);
}

/// A round table with two chairs under a parasol.
fn cafe_table(pen: &mut Pen, paints: &StreetPaints, number: usize) {
    let top = [(Vec3::Y * 0.70, 0.38), (Vec3::Y * 0.74, 0.38)];
    pen.tube(paints.wood, [0.95; 3], &top, 20);
    pen.disk(paints.wood, Vec3::Y * 0.74, Vec3::Y, 0.38, 20);
    pen.disk(paints.wood, Vec3::Y * 0.70, Vec3::NEG_Y, 0.38, 20);
    let pole = [(Vec3::ZERO, 0.025), (Vec3::Y * 2.55, 0.022)];
    pen.tube(paints.wood, [0.55, 0.36, 0.20], &pole, 8);
    pen.tube(paints.metal, PLAIN, &[(Vec3::ZERO, 0.24), (Vec3::Y * 0.05, 0.22)], 14);
    pen.disk(paints.metal, Vec3::Y * 0.05, Vec3::Y, 0.22, 14);
    let color = [BRIGHT[0], BRIGHT[3], BRIGHT[1]][number % 3];
    let rib = |k: u32, r: f32, y: f32| {
        let (sin, cos) = (k as f32 * std::f32::consts::TAU / 10.0).sin_cos();
        Vec3::new(cos * r, y, sin * r)
    };
    for k in 0..10 {
        let tint = if k % 2 == 0 { color } else { BRIGHT[3] };
        let peak = Vec3::Y * 2.56;
        let (a, b) = (rib(k, 1.3, 2.08), rib(k + 1, 1.3, 2.08));
        pen.polygon(paints.cloth, tint, &[peak, b, a]);
        let (c, d) = (rib(k, 1.31, 1.92), rib(k + 1, 1.31, 1.92));
        pen.polygon(paints.cloth, tint, &[a, b, d, c]);
    }
    for (x, turn) in [(-0.72f32, 0.2f32), (0.74, 3.0)] {
        let frame = Affine3A::from_translation(Vec3::new(x, 0.0, 0.08))
            * Affine3A::from_mat3(Mat3::from_rotation_y(turn));
        chair(&mut pen.within(frame), paints);
    }
}

/// A chair that faces +X.
fn chair(pen: &mut Pen, paints: &StreetPaints) {
    let tint = [0.16, 0.36, 0.30];
    let mut part = |min: [f32; 3], max: [f32; 3]| {
        pen.tinted_block(paints.wood, tint, Vec3::from_array(min), Vec3::from_array(max));
    };
    part([-0.2, 0.42, -0.2], [0.2, 0.46, 0.2]);
    for (x, z) in [(-0.2, -0.2), (0.16, -0.2), (-0.2, 0.16), (0.16, 0.16)] {
        part([x, 0.0, z], [x + 0.04, 0.42, z + 0.04]);
    }
    for z in [-0.2, 0.16] {
        part([-0.2, 0.46, z], [-0.16, 0.88, z + 0.04]);
    }
    for y in [0.58, 0.72, 0.84] {
        part([-0.195, y, -0.16], [-0.165, y + 0.06, 0.16]);
    }
}

/// A pot or crate with a blooming shrub.
fn planter(pen: &mut Pen, paints: &StreetPaints, random: &mut Random) {
    let height = random.range(0.36, 0.5);
    if random.chance(0.5) {
        let rings =
            [(Vec3::ZERO, 0.17), (Vec3::Y * height, 0.26), (Vec3::Y * (height + 0.05), 0.28)];
        pen.tube(paints.tile, [1.2, 1.3, 1.3], &rings, 14);
        pen.disk(paints.rubber, Vec3::Y * (height + 0.045), Vec3::Y, 0.279, 14);
    } else {
        let (min, max) = (Vec3::new(-0.24, 0.0, -0.4), Vec3::new(0.24, height, 0.4));
        pen.tinted_block(paints.wood, [0.48, 0.32, 0.19], min, max);
    }
    let mut nested = pen.within(Affine3A::from_translation(Vec3::Y * height));
    let radius = random.range(0.28, 0.42);
    let blooms = random.chance(0.7);
    shrub(&mut nested, paints.plants, random, radius, blooms);
}

/// A line of pennants across the street.
fn bunting(pen: &mut Pen, paints: &StreetPaints) {
    let (reach, height, sag) = (FACADE + 0.2, 6.4, 1.3);
    let at = |t: f32| {
        let x = (t * 2.0 - 1.0) * reach;
        Vec3::new(x, height - sag * 4.0 * t * (1.0 - t), 0.0)
    };
    let count = 26;
    for k in 0..count {
        let (a, b) = (at(k as f32 / count as f32), at((k + 1) as f32 / count as f32));
        pen.tube(paints.wood, PLAIN, &[(a, 0.012), (b, 0.012)], 4);
        let swing = 0.10 * (k as f32 * 1.7).sin();
        let tip = (a + b) * 0.5 + Vec3::new(0.0, -0.46, swing);
        let (a, b) = (a.lerp(b, 0.10), a.lerp(b, 0.90));
        pen.polygon(paints.cloth, BRIGHT[k as usize % 6], &[a, tip, b]);
    }
}
