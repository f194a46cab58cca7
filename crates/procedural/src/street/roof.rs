//! Roofs: pitched with courses of tiles, or flat with a parapet; chimneys and dormers.

use super::StreetPaints;
use super::opening::{HouseColors, Opening, glazing};
use crate::builder::{PLAIN, Paint, Pen};
use crate::random::Random;
use pbgi_math::{Affine3A, Vec3};

/// The block a roof covers: `width` along the street, `depth` away from it, eaves at `height`.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoofPlan {
    pub width: f32,
    pub depth: f32,
    pub height: f32,
}

/// A gable roof with its ridge along the street.
pub(super) fn pitched(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    plan: RoofPlan,
) {
    let paint = if random.chance(0.68) { paints.tile } else { paints.slate };
    let hue = random.range(0.8, 1.15);
    let pitch = random.range(0.70, 0.95);
    let ridge = plan.height + plan.depth * 0.5 * pitch;
    let overhang = 0.42;
    let eave = plan.height - overhang * pitch;
    let middle = -plan.depth * 0.5;
    for (x, outward) in [(0.0, -1.0), (plan.width, 1.0)] {
        let mut corners = [
            Vec3::new(x, plan.height, 0.0),
            Vec3::new(x, plan.height, -plan.depth),
            Vec3::new(x, ridge, middle),
        ];
        if outward < 0.0 {
            corners.reverse();
        }
        pen.polygon(paints.plaster, colors.wall, &corners);
    }
    let (x0, x1) = (-0.12, plan.width + 0.12);
    for (z_eave, z_ridge) in [(overhang, middle), (-plan.depth - overhang, middle)] {
        let slope = Slope {
            eave: [Vec3::new(x0, eave, z_eave), Vec3::new(x1, eave, z_eave)],
            rise: Vec3::new(0.0, ridge - eave, z_ridge - z_eave),
            facing_street: z_eave > middle,
        };
        slope.draw(pen, paint, hue, random);
    }
    let tint = [hue * 0.85; 3];
    let min = Vec3::new(x0, ridge - 0.03, middle - 0.12);
    pen.tinted_block(paint, tint, min, Vec3::new(x1, ridge + 0.13, middle + 0.12));
    pen.block(
        paints.metal,
        Vec3::new(x0, eave - 0.10, overhang - 0.02),
        Vec3::new(x1, eave + 0.01, overhang + 0.09),
    );
    for x in [0.9, plan.width - 1.1] {
        if random.chance(0.75) {
            chimney(pen, paints, random, Vec3::new(x, ridge - 0.9, middle - 0.5));
        }
    }
    if random.chance(0.55) && plan.width > 8.0 {
        for x in [plan.width * 0.3, plan.width * 0.7] {
            dormer(pen, paints, colors, random, Vec3::new(x, plan.height + 0.35, -0.5), paint);
        }
    }
}

/// One side of a pitched roof.
struct Slope {
    eave: [Vec3; 2],
    rise: Vec3,
    facing_street: bool,
}

impl Slope {
    /// Courses of tiles, each raised at its lower edge, over a soffit.
    fn draw(&self, pen: &mut Pen, paint: Paint, hue: f32, random: &mut Random) {
        let [a, b] = self.eave;
        let courses = (self.rise.length() / 0.34) as u32;
        let columns = ((b - a).length() / 0.55) as u32;
        let along = (b - a) / columns as f32;
        let up = self.rise / courses as f32;
        let normal = along.cross(up).normalize() * if self.facing_street { 1.0 } else { -1.0 };
        let lift = normal * 0.05;
        let mut face = |tint: [f32; 3], mut corners: [Vec3; 4]| {
            if !self.facing_street {
                corners.reverse();
            }
            pen.polygon(paint, tint, &corners);
        };
        for course in 0..courses {
            for column in 0..columns {
                let p = a + up * course as f32 + along * column as f32;
                let shade = hue * random.range(0.80, 1.16);
                let tint = [shade, shade * random.range(0.92, 1.05), shade];
                face(tint, [p + lift, p + along + lift, p + along + up, p + up]);
                face(tint, [p, p + along, p + along + lift, p + lift]);
            }
        }
        face([0.6; 3], [a + self.rise, b + self.rise, b, a]);
        // Verge boards close the ends between soffit and tiles.
        let side = (b - a).normalize() * 0.03;
        for (end, out) in [(a, -side), (b, side)] {
            let top = normal * 0.07;
            let (low, high) = (end + out, end + self.rise + out);
            let turn = |mut corners: [Vec3; 4]| {
                if out.dot(side) < 0.0 {
                    corners.reverse();
                }
                corners
            };
            face([0.75; 3], turn([low, high, high + top, low + top]));
            let inward = -out * 2.0;
            face([0.75; 3], turn([low + top, high + top, high + top + inward, low + top + inward]));
        }
    }
}

/// A flat roof behind a parapet with a coping.
pub(super) fn flat(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    plan: RoofPlan,
) {
    let (w, d, h) = (plan.width, plan.depth, plan.height);
    let top = h + 0.85;
    pen.rectangle(
        paints.stone,
        Vec3::new(0.0, h + 0.1, 0.0),
        Vec3::new(w, 0.0, 0.0),
        Vec3::new(0.0, 0.0, -d),
    );
    let thick = 0.28;
    for (min, max) in [
        (Vec3::new(0.0, h, -thick), Vec3::new(w, top, 0.0)),
        (Vec3::new(0.0, h, -d), Vec3::new(w, top, thick - d)),
        (Vec3::new(0.0, h, thick - d), Vec3::new(thick, top, -thick)),
        (Vec3::new(w - thick, h, thick - d), Vec3::new(w, top, -thick)),
    ] {
        pen.tinted_block(paints.plaster, colors.wall, min, max);
        let edge = Vec3::new(0.05, 0.0, 0.06);
        let low = Vec3::new(min.x, top, min.z) - edge;
        let high = Vec3::new(max.x, top + 0.09, max.z) + edge;
        pen.tinted_block(paints.trim, colors.trim, low, high);
    }
    // A raised middle piece and urns enliven the skyline.
    let (a, b) = (w * 0.36, w * 0.64);
    pen.tinted_block(
        paints.plaster,
        colors.wall,
        Vec3::new(a, top + 0.09, -thick),
        Vec3::new(b, top + 0.62, -0.01),
    );
    pen.tinted_block(
        paints.trim,
        colors.trim,
        Vec3::new(a - 0.08, top + 0.62, -thick - 0.06),
        Vec3::new(b + 0.08, top + 0.72, 0.06),
    );
    for x in [0.2, w - 0.2] {
        let urn = [0.10, 0.19, 0.22, 0.12, 0.03];
        let rings: Vec<(Vec3, f32)> = urn
            .iter()
            .enumerate()
            .map(|(k, r)| (Vec3::new(x, top + 0.09 + 0.14 * k as f32, -0.14), *r))
            .collect();
        pen.tube(paints.stone, PLAIN, &rings, 10);
    }
    chimney(pen, paints, random, Vec3::new(w * 0.78, h, -d * 0.6));
}

fn chimney(pen: &mut Pen, paints: &StreetPaints, random: &mut Random, foot: Vec3) {
    let height = random.range(1.9, 2.6);
    let (min, max) = (foot - Vec3::new(0.42, 0.0, 0.28), foot + Vec3::new(0.42, height, 0.28));
    pen.tinted_block(paints.brick, random.shade(0.15), min, max);
    let cap = Vec3::new(0.07, 0.0, 0.07);
    pen.block(
        paints.stone,
        Vec3::new(min.x, max.y, min.z) - cap,
        Vec3::new(max.x, max.y + 0.10, max.z) + cap,
    );
    for x in [-0.2, 0.2] {
        let base = Vec3::new(foot.x + x, max.y + 0.10, foot.z);
        let rings = [(base, 0.13), (base + Vec3::Y * 0.45, 0.10), (base + Vec3::Y * 0.5, 0.12)];
        pen.tube(paints.tile, PLAIN, &rings, 10);
        pen.disk(paints.rubber, base + Vec3::Y * 0.44, Vec3::Y, 0.10, 10);
    }
}

/// A small gabled window on the street side of a roof; `foot` is the middle of its sill.
fn dormer(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    foot: Vec3,
    roof: Paint,
) {
    let mut pen = pen.within(Affine3A::from_translation(foot));
    let (half, height, depth) = (0.72, 1.25, 2.4);
    let ridge = height + 0.62;
    pen.tinted_block(
        paints.plaster,
        colors.wall,
        Vec3::new(-half, -0.4, -depth),
        Vec3::new(half, height, -0.02),
    );
    // The window stands in front of the body by the depth of its reveal.
    let o = Opening { x0: -half + 0.14, x1: half - 0.14, y0: 0.05, y1: height - 0.1 };
    let mut front = pen.within(Affine3A::from_translation(Vec3::new(0.0, 0.0, 0.20)));
    glazing(&mut front, paints, colors, random, o, [2, 2]);
    let gable = [
        Vec3::new(-half, height, -0.02),
        Vec3::new(half, height, -0.02),
        Vec3::new(0.0, ridge - 0.06, -0.02),
    ];
    pen.polygon(paints.plaster, colors.wall, &gable);
    for side in [-1.0, 1.0] {
        let x = side * (half + 0.18);
        let y = height - 0.12;
        let mut top = [
            Vec3::new(x, y, 0.2),
            Vec3::new(0.0, ridge, 0.2),
            Vec3::new(0.0, ridge, -depth),
            Vec3::new(x, y, -depth),
        ];
        let drop = Vec3::Y * -0.10;
        let mut under = top.map(|corner| corner + drop);
        let mut front = [top[0], top[0] + drop, top[1] + drop, top[1]];
        let mut eave = [top[0], top[3], top[3] + drop, top[0] + drop];
        if side > 0.0 {
            top.reverse();
            front.reverse();
            eave.reverse();
        } else {
            under.reverse();
        }
        for face in [top, under, front, eave] {
            pen.polygon(roof, [0.9; 3], &face);
        }
    }
}
