//! One house of the row.

use super::StreetPaints;
use super::furniture::flower_box;
use super::opening::{HouseColors, Opening, door, glazing, pierced_wall, shutters, window};
use super::roof::{RoofPlan, flat, pitched};
use crate::builder::{PLAIN, Pen};
use crate::random::Random;
use pbgi_math::{Affine3A, Mat3, Vec3};

/// Wall colors as multiples of the plaster's 0.8: cream, ochre, brick red, rose, teal, pale
/// blue, gray, white, apricot, olive.
const WALLS: [[f32; 3]; 10] = [
    [0.92, 0.80, 0.58],
    [0.86, 0.55, 0.20],
    [0.60, 0.22, 0.14],
    [0.86, 0.47, 0.39],
    [0.22, 0.48, 0.45],
    [0.48, 0.64, 0.76],
    [0.58, 0.57, 0.55],
    [0.98, 0.95, 0.90],
    [0.94, 0.62, 0.36],
    [0.56, 0.58, 0.34],
];

/// Saturated colors of shutters, doors and awnings, as multiples of 0.8.
const ACCENTS: [[f32; 3]; 7] = [
    [0.10, 0.28, 0.20],
    [0.75, 0.12, 0.08],
    [0.12, 0.25, 0.52],
    [0.90, 0.58, 0.08],
    [0.16, 0.45, 0.50],
    [0.42, 0.12, 0.16],
    [0.35, 0.50, 0.24],
];

const GROUND_FLOOR: f32 = 3.6;

struct Facade {
    width: f32,
    floors: u32,
    floor_height: f32,
    bays: u32,
}

impl Facade {
    fn eaves(&self) -> f32 {
        GROUND_FLOOR + self.floor_height * (self.floors - 1) as f32 + 0.35
    }

    /// Height of the floor of an upper story.
    fn floor_base(&self, floor: u32) -> f32 {
        GROUND_FLOOR + self.floor_height * (floor as f32 - 1.0)
    }

    fn bay_center(&self, bay: u32) -> f32 {
        self.width * (bay as f32 + 0.5) / self.bays as f32
    }
}

/// Where a house stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lot {
    /// Width of the facade.
    pub width: f32,
    /// Number along the street, which picks the color.
    pub number: usize,
    /// Whether the left and the right wall stand free and need windows.
    pub free_sides: [bool; 2],
}

/// Draws a house on its lot.
pub(super) fn house(pen: &mut Pen, paints: &StreetPaints, random: &mut Random, lot: Lot) {
    let Lot { width, number, .. } = lot;
    // Setbacks differ, so that neighbors' walls never lie in one plane.
    let setback = 0.05 + 0.11 * (number % 4) as f32;
    let mut pen = pen.within(Affine3A::from_translation(Vec3::new(0.0, 0.0, -setback)));
    let pen = &mut pen;
    let colors = choose_colors(random, number);
    let facade = Facade {
        width,
        floors: if random.chance(0.4) { 4 } else { 3 } - u32::from(random.chance(0.3)),
        floor_height: random.range(2.9, 3.3),
        bays: ((width / random.range(2.3, 2.7)).round() as u32).max(2),
    };
    body(pen, paints, &colors, &facade, lot.free_sides);
    for side in [0, 1].into_iter().filter(|side| lot.free_sides[*side]) {
        free_wall(pen, paints, &colors, random, &facade, side == 1);
    }
    let is_shop = random.chance(0.6);
    if is_shop {
        shop_front(pen, paints, &colors, random, &facade);
    } else {
        hall_front(pen, paints, &colors, random, &facade);
    }
    let has_shutters = random.chance(0.5) && width / facade.bays as f32 > 2.2;
    let has_boxes = random.chance(0.45);
    for floor in 1..facade.floors {
        upper_floor(pen, paints, &colors, random, &facade, floor, has_shutters, has_boxes);
    }
    cornices(pen, paints, &colors, &facade);
    let plan = RoofPlan { width, depth: DEPTH, height: facade.eaves() };
    if random.chance(0.7) {
        pitched(pen, paints, &colors, random, plan);
    } else {
        flat(pen, paints, &colors, random, plan);
    }
}

const DEPTH: f32 = 9.5;

fn choose_colors(random: &mut Random, number: usize) -> HouseColors {
    // Steps of 3 through the ten colors: neighbors and opposite houses differ.
    let wall = WALLS[(number * 3 + random.below(2)) % WALLS.len()];
    let shade = random.range(0.9, 1.0);
    let light = wall[1] > 0.5;
    HouseColors {
        wall: wall.map(|c| c * shade),
        trim: if light { [1.05, 1.03, 1.0] } else { [1.1, 1.08, 1.02] },
        frame: if random.chance(0.7) { [0.98, 0.96, 0.92] } else { [0.30, 0.20, 0.13] },
        shutter: random.pick(&ACCENTS),
        door: random.pick(&ACCENTS),
    }
}

/// A side wall in the open: ledges, and windows in two of its bays.
fn free_wall(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    facade: &Facade,
    is_right: bool,
) {
    let quarter = std::f32::consts::FRAC_PI_2;
    let (x, z, turn) =
        if is_right { (facade.width, 0.0, quarter) } else { (0.0, -DEPTH, -quarter) };
    let frame = Affine3A::from_translation(Vec3::new(x, 0.0, z))
        * Affine3A::from_mat3(Mat3::from_rotation_y(turn));
    let mut pen = pen.within(frame);
    let pen = &mut pen;
    for floor in 0..facade.floors {
        let base = if floor == 0 { 0.2 } else { facade.floor_base(floor) };
        let low = if floor == 0 { -2.0 } else { base };
        let is_top = floor + 1 == facade.floors;
        let high = if is_top { facade.eaves() } else { facade.floor_base(floor + 1) };
        let openings = [0.27, 0.73].map(|t| {
            let (x, y) = (DEPTH * t, base + 0.95);
            Opening { x0: x - 0.48, x1: x + 0.48, y0: y, y1: y + 1.5 }
        });
        pierced_wall(pen, paints, colors.wall, [0.0, DEPTH], [low, high], &openings);
        for o in openings {
            window(pen, paints, colors, random, o);
        }
        if !is_top {
            let (min, max) = (Vec3::new(0.0, high - 0.05, -0.2), Vec3::new(DEPTH, high + 0.1, 0.1));
            pen.tinted_block(paints.trim, colors.trim, min, max);
        }
    }
}

/// Side and back walls and the plinth.
fn body(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    facade: &Facade,
    free_sides: [bool; 2],
) {
    let (w, h) = (facade.width, facade.eaves());
    let foot = -2.0;
    let corner = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let walls = [
        [
            corner(0.0, foot, -DEPTH),
            corner(0.0, foot, 0.0),
            corner(0.0, h, 0.0),
            corner(0.0, h, -DEPTH),
        ],
        [corner(w, foot, 0.0), corner(w, foot, -DEPTH), corner(w, h, -DEPTH), corner(w, h, 0.0)],
        [
            corner(w, foot, -DEPTH),
            corner(0.0, foot, -DEPTH),
            corner(0.0, h, -DEPTH),
            corner(w, h, -DEPTH),
        ],
    ];
    for (wall, is_drawn) in walls.iter().zip([!free_sides[0], !free_sides[1], true]) {
        if is_drawn {
            pen.polygon(paints.plaster, colors.wall, wall);
        }
    }
    pen.block(paints.stone, corner(-0.02, foot, -0.3), corner(w + 0.02, 0.02, 0.06));
}

/// A shop: two large windows, a door between them, a sign and an awning.
fn shop_front(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    facade: &Facade,
) {
    let w = facade.width;
    let (door_left, door_right) = (w * 0.5 - 0.55, w * 0.5 + 0.55);
    let left = Opening { x0: 0.55, x1: door_left - 0.35, y0: 0.62, y1: 2.72 };
    let right = Opening { x0: door_right + 0.35, x1: w - 0.55, ..left };
    let entry = Opening { x0: door_left, x1: door_right, y0: 0.02, y1: 2.72 };
    pierced_wall(pen, paints, colors.wall, [0.0, w], [0.0, GROUND_FLOOR], &[left, entry, right]);
    let woodwork = HouseColors { frame: colors.door, ..*colors };
    for o in [left, right] {
        glazing(pen, paints, &woodwork, random, o, [3, 1]);
        pen.tinted_block(
            paints.lacquer,
            colors.door,
            Vec3::new(o.x0 - 0.1, 0.04, -0.02),
            Vec3::new(o.x1 + 0.1, o.y0, 0.10),
        );
    }
    door(pen, paints, &woodwork, random, entry);
    let sign = random.pick(&ACCENTS);
    let (min, max) = (Vec3::new(0.35, 2.95, -0.02), Vec3::new(w - 0.35, 3.45, 0.10));
    pen.tinted_block(paints.lacquer, sign, min, max);
    let mut x = w * 0.5 - 1.3;
    while x < w * 0.5 + 1.3 {
        // Gilt letters, as far as one can read them.
        let step = random.range(0.12, 0.26);
        let (min, max) = (Vec3::new(x, 3.08, 0.09), Vec3::new(x + step - 0.05, 3.32, 0.12));
        pen.block(paints.gilt, min, max);
        x += step;
    }
    awning(pen, paints, random.pick(&ACCENTS), [0.4, w - 0.4], random.range(1.1, 1.5));
}

/// Striped cloth on a sloping frame, with a hanging edge.
fn awning(pen: &mut Pen, paints: &StreetPaints, color: [f32; 3], [x0, x1]: [f32; 2], reach: f32) {
    let (high, low) = (2.92, 2.38);
    let color = color.map(|c| (c * 1.25f32).min(1.1));
    let stripes = ((x1 - x0) / 0.38).round().max(2.0) as u32;
    let step = (x1 - x0) / stripes as f32;
    for k in 0..stripes {
        let tint = if k % 2 == 0 { color } else { [1.08, 1.04, 0.96] };
        let (a, b) = (x0 + step * k as f32, x0 + step * (k + 1) as f32);
        // Cloth hangs through a little between its bars.
        let profile = [
            (high, 0.08),
            (high * 0.52 + low * 0.48 - 0.05, reach * 0.52),
            (low, reach),
            (low - 0.24, reach + 0.01),
        ];
        for pair in profile.windows(2) {
            let ((ya, za), (yb, zb)) = (pair[0], pair[1]);
            let corners = [
                Vec3::new(a, yb, zb),
                Vec3::new(b, yb, zb),
                Vec3::new(b, ya, za),
                Vec3::new(a, ya, za),
            ];
            pen.polygon(paints.cloth, tint, &corners);
        }
    }
    for x in [x0 + 0.02, x1 - 0.02] {
        let side = [Vec3::new(x, high, 0.08), Vec3::new(x, low, 0.08), Vec3::new(x, low, reach)];
        pen.polygon(paints.cloth, color, &side);
    }
}

/// A ground floor to live in: windows, and a door in one bay.
fn hall_front(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    facade: &Facade,
) {
    let door_bay = random.below(facade.bays as usize) as u32;
    let openings: Vec<Opening> = (0..facade.bays)
        .map(|bay| {
            let x = facade.bay_center(bay);
            if bay == door_bay {
                Opening { x0: x - 0.58, x1: x + 0.58, y0: 0.34, y1: 2.95 }
            } else {
                Opening { x0: x - 0.52, x1: x + 0.52, y0: 1.05, y1: 2.75 }
            }
        })
        .collect();
    pierced_wall(pen, paints, colors.wall, [0.0, facade.width], [0.0, GROUND_FLOOR], &openings);
    for (bay, o) in openings.into_iter().enumerate() {
        if bay as u32 == door_bay {
            door(pen, paints, colors, random, o);
        } else {
            window(pen, paints, colors, random, o);
        }
    }
    // Rusticated base: courses of ashlar.
    for k in 0..2 {
        let y = 0.04 + 0.32 * k as f32;
        pen.block(
            paints.stone,
            Vec3::new(0.0, y, -0.02),
            Vec3::new(facade.bay_center(door_bay) - 0.85, y + 0.28, 0.05),
        );
        pen.block(
            paints.stone,
            Vec3::new(facade.bay_center(door_bay) + 0.85, y, -0.02),
            Vec3::new(facade.width, y + 0.28, 0.05),
        );
    }
}

#[expect(clippy::too_many_arguments, reason = "two switches of the house beside its usual parts")]
fn upper_floor(
    pen: &mut Pen,
    paints: &StreetPaints,
    colors: &HouseColors,
    random: &mut Random,
    facade: &Facade,
    floor: u32,
    has_shutters: bool,
    has_boxes: bool,
) {
    let y0 = facade.floor_base(floor);
    let is_top = floor + 1 == facade.floors;
    let y1 = if is_top { facade.eaves() } else { y0 + facade.floor_height };
    let height = if is_top { 1.35 } else { 1.62 };
    let openings: Vec<Opening> = (0..facade.bays)
        .map(|bay| {
            let x = facade.bay_center(bay);
            Opening { x0: x - 0.48, x1: x + 0.48, y0: y0 + 0.85, y1: y0 + 0.85 + height }
        })
        .collect();
    pierced_wall(pen, paints, colors.wall, [0.0, facade.width], [y0, y1], &openings);
    for o in openings {
        window(pen, paints, colors, random, o);
        if has_shutters {
            shutters(pen, paints, colors, o);
        }
        if has_boxes && random.chance(0.6) {
            flower_box(pen, paints, random, Vec3::new(o.x0, o.y0 - 0.02, 0.14), o.x1 - o.x0);
        }
    }
}

/// Ledges between floors, corner stones, the cornice under the eaves and a rain pipe.
fn cornices(pen: &mut Pen, paints: &StreetPaints, colors: &HouseColors, facade: &Facade) {
    let (w, top) = (facade.width, facade.eaves());
    let mut ledge = |y: f32, height: f32, reach: f32| {
        let (min, max) = (Vec3::new(-0.03, y, -0.25), Vec3::new(w + 0.03, y + height, reach));
        pen.tinted_block(paints.trim, colors.trim, min, max);
    };
    ledge(GROUND_FLOOR - 0.06, 0.16, 0.14);
    ledge(GROUND_FLOOR + 0.10, 0.07, 0.20);
    for floor in 2..facade.floors {
        let y = facade.floor_base(floor);
        ledge(y - 0.03, 0.12, 0.09);
    }
    ledge(top - 0.42, 0.16, 0.12);
    ledge(top - 0.26, 0.12, 0.22);
    ledge(top - 0.14, 0.14, 0.32);
    let mut y = GROUND_FLOOR + 0.25;
    let mut long = true;
    while y + 0.36 < top - 0.42 {
        let reach = if long { 0.55 } else { 0.34 };
        for (a, b) in [(-0.02, reach), (w - reach, w + 0.02)] {
            let (min, max) = (Vec3::new(a, y, -0.3), Vec3::new(b, y + 0.32, 0.035));
            pen.tinted_block(paints.trim, colors.trim, min, max);
        }
        y += 0.38;
        long = !long;
    }
    let pipe =
        [(Vec3::new(w - 0.12, 0.1, 0.16), 0.05), (Vec3::new(w - 0.12, top - 0.3, 0.16), 0.05)];
    pen.tube(paints.metal, PLAIN, &pipe, 8);
}
