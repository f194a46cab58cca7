//! Walls with openings, and the windows, shutters and doors in them.

use super::StreetPaints;
use crate::builder::{PLAIN, Pen};
use crate::random::Random;
use pbgi_math::Vec3;

/// How deep windows and doors lie in the wall.
const REVEAL: f32 = 0.20;

/// A rectangle on a facade, in meters from its lower left corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opening {
    pub x0: f32,
    pub x1: f32,
    pub y0: f32,
    pub y1: f32,
}

impl Opening {
    fn width(&self) -> f32 {
        self.x1 - self.x0
    }
}

/// Color choices of one house.
#[derive(Clone, Copy, Debug)]
pub(super) struct HouseColors {
    pub wall: [f32; 3],
    pub trim: [f32; 3],
    pub frame: [f32; 3],
    pub shutter: [f32; 3],
    pub door: [f32; 3],
}

/// A stretch of wall in the plane z = 0 between `x` and `y`, with openings side by side from left
/// to right.
pub(super) fn pierced_wall(
    pen: &mut Pen,
    paints: &StreetPaints,
    tint: [f32; 3],
    [x0, x1]: [f32; 2],
    [y0, y1]: [f32; 2],
    openings: &[Opening],
) {
    let mut panel = |xa: f32, xb: f32, ya: f32, yb: f32| {
        let corners = [
            Vec3::new(xa, ya, 0.0),
            Vec3::new(xb, ya, 0.0),
            Vec3::new(xb, yb, 0.0),
            Vec3::new(xa, yb, 0.0),
        ];
        pen.polygon(paints.plaster, tint, &corners);
    };
    let mut left = x0;
    for opening in openings {
        panel(left, opening.x0, y0, y1);
        panel(opening.x0, opening.x1, y0, opening.y0);
        panel(opening.x0, opening.x1, opening.y1, y1);
        left = opening.x1;
    }
    panel(left, x1, y0, y1);
    for opening in openings {
        reveal(pen, paints, tint, opening);
    }
}

/// The four inner sides of an opening.
fn reveal(pen: &mut Pen, paints: &StreetPaints, tint: [f32; 3], o: &Opening) {
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let back = -REVEAL;
    let sides = [
        [at(o.x0, o.y0, 0.0), at(o.x0, o.y0, back), at(o.x0, o.y1, back), at(o.x0, o.y1, 0.0)],
        [at(o.x1, o.y0, back), at(o.x1, o.y0, 0.0), at(o.x1, o.y1, 0.0), at(o.x1, o.y1, back)],
        [at(o.x0, o.y0, 0.0), at(o.x1, o.y0, 0.0), at(o.x1, o.y0, back), at(o.x0, o.y0, back)],
        [at(o.x0, o.y1, back), at(o.x1, o.y1, back), at(o.x1, o.y1, 0.0), at(o.x0, o.y1, 0.0)],
    ];
    for side in sides {
        pen.polygon(paints.plaster, tint, &side);
    }
}

/// A casement window: glass or a curtain, frame, glazing bars, sill and surround.
pub(super) fn window(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    o: Opening,
) {
    glazing(pen, paints, colors, random, o, [2, 3]);
    let trim = |pen: &mut Pen, min: Vec3, max: Vec3| {
        pen.tinted_block(paints.trim, colors.trim, min, max);
    };
    trim(pen, Vec3::new(o.x0 - 0.14, o.y0 - 0.10, -0.02), Vec3::new(o.x1 + 0.14, o.y0, 0.14));
    trim(pen, Vec3::new(o.x0 - 0.12, o.y1, -0.02), Vec3::new(o.x1 + 0.12, o.y1 + 0.16, 0.07));
    trim(
        pen,
        Vec3::new(o.x0 - 0.17, o.y1 + 0.16, -0.02),
        Vec3::new(o.x1 + 0.17, o.y1 + 0.21, 0.13),
    );
    for (a, b) in [(o.x0 - 0.10, o.x0), (o.x1, o.x1 + 0.10)] {
        trim(pen, Vec3::new(a, o.y0, -0.02), Vec3::new(b, o.y1, 0.04));
    }
}

/// Glass behind a frame with `bars[0]` columns and `bars[1]` rows of panes.
pub(super) fn glazing(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    o: Opening,
    bars: [u32; 2],
) {
    let z = -REVEAL;
    let mut pane = |paint, y0: f32, y1: f32| {
        let corners = [
            Vec3::new(o.x0, y0, z),
            Vec3::new(o.x1, y0, z),
            Vec3::new(o.x1, y1, z),
            Vec3::new(o.x0, y1, z),
        ];
        pen.polygon(paint, PLAIN, &corners);
    };
    let blind =
        o.y1 - (o.y1 - o.y0) * if random.chance(0.4) { random.range(0.2, 0.8) } else { 0.0 };
    pane(paints.glass, o.y0, blind);
    pane(paints.curtain, blind, o.y1);
    let mut bar = |x0: f32, x1: f32, y0: f32, y1: f32, depth: f32| {
        let (min, max) = (Vec3::new(x0, y0, z - 0.01), Vec3::new(x1, y1, z + depth));
        pen.tinted_block(paints.wood, colors.frame, min, max);
    };
    let rim = 0.07;
    bar(o.x0, o.x0 + rim, o.y0, o.y1, 0.06);
    bar(o.x1 - rim, o.x1, o.y0, o.y1, 0.06);
    bar(o.x0 + rim, o.x1 - rim, o.y0, o.y0 + rim, 0.06);
    bar(o.x0 + rim, o.x1 - rim, o.y1 - rim, o.y1, 0.06);
    for k in 1..bars[0] {
        let x = o.x0 + o.width() * k as f32 / bars[0] as f32;
        bar(x - 0.03, x + 0.03, o.y0 + rim, o.y1 - rim, 0.045);
    }
    for k in 1..bars[1] {
        let y = o.y0 + (o.y1 - o.y0) * k as f32 / bars[1] as f32;
        bar(o.x0 + rim, o.x1 - rim, y - 0.02, y + 0.02, 0.03);
    }
}

/// Open shutters on both sides of a window: a frame with slats.
pub(super) fn shutters(pen: &mut Pen, paints: &StreetPaints, colors: &HouseColors, o: Opening) {
    let width = o.width() * 0.5;
    for x0 in [o.x0 - 0.12 - width, o.x1 + 0.12] {
        let mut part = |xa: f32, xb: f32, ya: f32, yb: f32, za: f32, zb: f32| {
            let (min, max) = (Vec3::new(xa, ya, za), Vec3::new(xb, yb, zb));
            pen.tinted_block(paints.wood, colors.shutter, min, max);
        };
        let (x1, y0, y1) = (x0 + width, o.y0 - 0.02, o.y1 + 0.02);
        part(x0, x0 + 0.05, y0, y1, 0.03, 0.08);
        part(x1 - 0.05, x1, y0, y1, 0.03, 0.08);
        let middle = (y0 + y1) * 0.5;
        for y in [y0, middle - 0.04, y1 - 0.08] {
            part(x0 + 0.05, x1 - 0.05, y, y + 0.08, 0.03, 0.075);
        }
        let slat_count = 9;
        for half in [[y0 + 0.08, middle - 0.04], [middle + 0.04, y1 - 0.08]] {
            let step = (half[1] - half[0]) / slat_count as f32;
            for k in 0..slat_count {
                // Slats slope outward to shed rain.
                let y = half[0] + step * k as f32;
                let corners = [
                    Vec3::new(x0 + 0.05, y, 0.065),
                    Vec3::new(x1 - 0.05, y, 0.065),
                    Vec3::new(x1 - 0.05, y + step, 0.035),
                    Vec3::new(x0 + 0.05, y + step, 0.035),
                ];
                pen.polygon(paints.wood, colors.shutter, &corners);
            }
        }
    }
}

/// A paneled door with a light above it, a surround and two steps.
pub(super) fn door(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    o: Opening,
) {
    let light = Opening { y0: o.y1 - 0.5, ..o };
    glazing(pen, paints, colors, random, light, [3, 1]);
    let z = -REVEAL;
    let top = light.y0;
    let leaf = |pen: &mut Pen, x0: f32, x1: f32, y0: f32, y1: f32, depth: f32| {
        let (min, max) = (Vec3::new(x0, y0, z - 0.02), Vec3::new(x1, y1, z + depth));
        pen.tinted_block(paints.lacquer, colors.door, min, max);
    };
    leaf(pen, o.x0, o.x1, o.y0, top, 0.03);
    let half = o.width() * 0.5;
    for column in 0..2 {
        let x = o.x0 + half * column as f32;
        for (y0, y1) in [(0.12, 0.42), (0.48, 0.94)] {
            let height = top - o.y0;
            leaf(pen, x + 0.10, x + half - 0.10, o.y0 + height * y0, o.y0 + height * y1, 0.055);
        }
    }
    let knob = Vec3::new(o.x0 + half + 0.07, o.y0 + 1.0, z + 0.09);
    pen.ellipsoid(paints.gilt, PLAIN, knob, Vec3::splat(0.035), 6);
    let trim = |pen: &mut Pen, min: Vec3, max: Vec3| {
        pen.tinted_block(paints.trim, colors.trim, min, max);
    };
    for (a, b) in [(o.x0 - 0.20, o.x0), (o.x1, o.x1 + 0.20)] {
        trim(pen, Vec3::new(a, o.y0, -0.02), Vec3::new(b, o.y1, 0.09));
    }
    trim(pen, Vec3::new(o.x0 - 0.24, o.y1, -0.02), Vec3::new(o.x1 + 0.24, o.y1 + 0.22, 0.12));
    trim(
        pen,
        Vec3::new(o.x0 - 0.36, o.y1 + 0.22, -0.02),
        Vec3::new(o.x1 + 0.36, o.y1 + 0.30, 0.42),
    );
    for (k, reach) in [(0, 0.72), (1, 0.36)] {
        let (low, high) = (o.y0 - 0.34 + 0.17 * k as f32, o.y0 - 0.17 + 0.17 * k as f32);
        pen.block(
            paints.stone,
            Vec3::new(o.x0 - 0.25, low, -0.2),
            Vec3::new(o.x1 + 0.25, high, reach),
        );
    }
}
