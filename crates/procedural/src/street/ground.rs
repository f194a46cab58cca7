//! Road, curbs, sidewalks, lots, and the land to the horizon.

use super::StreetPaints;
use super::path::{CURB, FACADE, LOT_END, ROAD_HALF, START, StreetPath, smooth};
use crate::builder::SceneBuilder;
use crate::random::Random;
use pbgi_math::{Affine3A, Vec3};

/// Draws the street's surfaces from its start to `end`.
pub(super) fn pave(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    random: &mut Random,
    end: f32,
) {
    road(builder, paints, path, random, end);
    for side in [-1.0, 1.0] {
        let mut s = START;
        while s < end {
            let length = slab_length(s);
            sidewalk_row(builder, paints, path, random, side, [s, s + length]);
            s += length;
        }
    }
}

/// Stones near the camera are small; far ones, which nobody can tell apart, are larger.
fn slab_length(s: f32) -> f32 {
    if (-8.0..45.0).contains(&s) { 0.8 } else { 2.4 }
}

fn road(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    random: &mut Random,
    end: f32,
) {
    let mut pen = builder.pen(Affine3A::IDENTITY);
    let mut s = START;
    let mut row = 0u32;
    while s < end {
        let fine = (-4.0..32.0).contains(&s);
        let length = if fine { 0.26 } else { 1.2 };
        let columns = if fine { 24 } else { 7 };
        let width = 2.0 * ROAD_HALF / columns as f32;
        // Courses are set half a stone apart, so each row has one stone more or less.
        let shift = if fine && row % 2 == 1 { 0.5 } else { 0.0 };
        for k in 0..=columns {
            let edge = |k: f32| ((k - shift) * width - ROAD_HALF).clamp(-ROAD_HALF, ROAD_HALF);
            let (o0, o1) = (edge(k as f32), edge(k as f32 + 1.0));
            let at = |s: f32, o: f32| path.point(s, o, 0.0);
            let corners = [at(s, o0), at(s, o1), at(s + length, o1), at(s + length, o0)];
            pen.polygon(paints.cobble, random.shade(0.17), &corners);
        }
        s += length;
        row += 1;
    }
}

fn sidewalk_row(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    random: &mut Random,
    side: f32,
    [s0, s1]: [f32; 2],
) {
    let mut pen = builder.pen(Affine3A::IDENTITY);
    let curb_width = 0.22;
    let mut strip = |paint, tint, from: (f32, f32), to: (f32, f32)| {
        let at = |s: f32, (offset, rise): (f32, f32)| path.point(s, side * offset, rise);
        let mut corners = [at(s0, from), at(s0, to), at(s1, to), at(s1, from)];
        if side < 0.0 {
            corners.reverse();
        }
        pen.polygon(paint, tint, &corners);
    };
    let inner = ROAD_HALF + curb_width;
    strip(paints.curb, random.shade(0.08), (ROAD_HALF, -0.05), (ROAD_HALF, CURB));
    strip(paints.curb, random.shade(0.08), (ROAD_HALF, CURB), (inner, CURB));
    let slabs = 3;
    let width = (FACADE - inner) / slabs as f32;
    for k in 0..slabs {
        let o = inner + k as f32 * width;
        strip(paints.slab, random.shade(0.10), (o, CURB), (o + width, CURB));
    }
    let lot_tint = random.shade(0.06);
    strip(paints.lot, lot_tint, (FACADE, CURB), (LOT_END, CURB));
    strip(paints.lot, lot_tint, (LOT_END, CURB), (LOT_END + 3.0, -1.6));
}

/// Land from the street to the horizon, on a polar grid around the camera.
pub(super) fn land(builder: &mut SceneBuilder, paints: &StreetPaints, path: &StreetPath) {
    let (sectors, rings) = (144u32, 66u32);
    let rows: Vec<Vec<(Vec3, [f32; 3])>> = (0..=rings)
        .map(|ring| {
            // From 2 m to 5 km, each ring an eighth wider than the last.
            let radius = 2.0 * (ring as f32 / rings as f32 * (2500f32).ln()).exp();
            let at = |sector: u32| {
                let angle = (sector % sectors) as f32 / sectors as f32 * std::f32::consts::TAU;
                let (x, z) = (radius * angle.cos(), radius * angle.sin());
                let height = path.land_height(x, z);
                (Vec3::new(x, height, z), land_tint(radius, height))
            };
            (0..=sectors).map(at).collect()
        })
        .collect();
    builder.pen(Affine3A::IDENTITY).surface(paints.land, &rows);
}

/// Meadow near by, woods on the slopes, blue distance: a substitute for haze.
fn land_tint(radius: f32, height: f32) -> [f32; 3] {
    let meadow = [1.0, 1.0, 1.0];
    let woods = [0.62, 0.72, 0.95];
    let far = [1.35, 1.30, 4.2];
    let mix = |a: [f32; 3], b: [f32; 3], t: f32| -> [f32; 3] {
        std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
    };
    let near = mix(meadow, woods, smooth(6.0, 26.0, height));
    mix(near, far, smooth(350.0, 2400.0, radius))
}
