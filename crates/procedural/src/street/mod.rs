//! A street of painted houses that bends uphill under a low sun.

mod backdrop;
mod furniture;
mod ground;
mod house;
mod opening;
mod path;
mod roof;

use super::ProceduralScene;
use super::builder::{Paint, SceneBuilder};
use super::plants::{PlantPaints, TreeShape, tree};
use super::random::Random;
use path::{CURB, FACADE, ROAD_HALF, StreetPath};
use pbgi_math::{Affine3A, Mat3, Vec3};
use pbgi_scene::Camera;

/// Paints of the street.
pub(super) struct StreetPaints {
    cobble: Paint,
    curb: Paint,
    slab: Paint,
    lot: Paint,
    land: Paint,
    plaster: Paint,
    trim: Paint,
    stone: Paint,
    glass: Paint,
    curtain: Paint,
    wood: Paint,
    tile: Paint,
    slate: Paint,
    brick: Paint,
    copper: Paint,
    metal: Paint,
    lacquer: Paint,
    rubber: Paint,
    cloth: Paint,
    gilt: Paint,
    town: TownPaints,
    plants: PlantPaints,
}

/// Paints of the plain houses behind the street.
#[derive(Clone, Copy)]
pub(super) struct TownPaints {
    plaster: Paint,
    tile: Paint,
    glass: Paint,
    brick: Paint,
}

/// How much coarser than the street its surroundings are diced: the town, and the land, whose triangles
/// grow with the distance and are small enough as they are.
const TOWN_COARSENESS: f32 = 6.0;
const LAND_COARSENESS: f32 = 200.0;

impl TownPaints {
    fn new(builder: &mut SceneBuilder) -> Self {
        let mut paint = |name, color| builder.coarse_paint(name, color, TOWN_COARSENESS);
        Self {
            plaster: paint("town plaster", PLASTER),
            tile: paint("town tile", TILE),
            glass: paint("town glass", GLASS),
            brick: paint("town brick", BRICK),
        }
    }
}

const PLASTER: [f32; 3] = [0.80, 0.80, 0.80];
const TILE: [f32; 3] = [0.44, 0.17, 0.10];
const GLASS: [f32; 3] = [0.06, 0.075, 0.09];
const BRICK: [f32; 3] = [0.42, 0.18, 0.12];

impl StreetPaints {
    fn new(builder: &mut SceneBuilder) -> Self {
        Self {
            cobble: builder.paint("cobble", [0.30, 0.28, 0.26]),
            curb: builder.paint("curb", [0.46, 0.44, 0.41]),
            slab: builder.paint("slab", [0.50, 0.46, 0.41]),
            lot: builder.paint("lot", [0.30, 0.29, 0.16]),
            land: builder.coarse_paint("land", [0.21, 0.25, 0.09], LAND_COARSENESS),
            plaster: builder.paint("plaster", PLASTER),
            trim: builder.paint("trim", [0.76, 0.72, 0.64]),
            stone: builder.paint("stone", [0.50, 0.47, 0.43]),
            glass: builder.paint("glass", GLASS),
            curtain: builder.paint("curtain", [0.58, 0.52, 0.44]),
            wood: builder.paint("wood", [0.80, 0.80, 0.80]),
            tile: builder.paint("tile", TILE),
            slate: builder.paint("slate", [0.17, 0.18, 0.21]),
            brick: builder.paint("brick", BRICK),
            copper: builder.paint("copper", [0.26, 0.46, 0.38]),
            metal: builder.paint("metal", [0.10, 0.11, 0.11]),
            lacquer: builder.paint("lacquer", [0.80, 0.80, 0.80]),
            rubber: builder.paint("rubber", [0.05, 0.05, 0.05]),
            cloth: builder.cloth("cloth", [0.80, 0.80, 0.80]),
            gilt: builder.paint("gilt", [0.70, 0.50, 0.16]),
            town: TownPaints::new(builder),
            plants: PlantPaints::new(builder),
        }
    }
}

/// What stands where on one side of the street.
struct Plot {
    start: f32,
    width: f32,
    is_gap: bool,
}

/// A street with `houses` plots on each side.
pub(super) fn street(seed: u64, houses: u32) -> ProceduralScene {
    let mut builder = SceneBuilder::default();
    let paints = StreetPaints::new(&mut builder);
    let mut random = Random::for_part(seed, 1);
    let sides = [-1.0f32, 1.0].map(|side| lay_out(side, houses, &mut random));
    let end = sides.iter().flatten().map(|plot| plot.start + plot.width).fold(40.0, f32::max);
    let path = StreetPath::new(end + 60.0);
    ground::pave(&mut builder, &paints, &path, &mut random, end + 40.0);
    ground::land(&mut builder, &paints, &path);
    for (index, plots) in sides.iter().enumerate() {
        let side = if index == 0 { -1.0 } else { 1.0 };
        for (number, plot) in plots.iter().enumerate() {
            let part = 1000 * (index as u64 + 1) + number as u64;
            let mut random = Random::for_part(seed, part);
            let frame = plot_frame(&path, side, plot);
            if plot.is_gap {
                furniture::garden(&mut builder.pen(frame), &paints, &mut random, plot.width);
            } else {
                let is_free = |neighbor: Option<&Plot>| neighbor.is_none_or(|plot| plot.is_gap);
                let before = is_free(number.checked_sub(1).and_then(|n| plots.get(n)));
                let after = is_free(plots.get(number + 1));
                // Houses on the right stand with their left end ahead.
                let free_sides = if side < 0.0 { [before, after] } else { [after, before] };
                let lot = house::Lot { width: plot.width, number: number * 2 + index, free_sides };
                house::house(&mut builder.pen(frame), &paints, &mut random, lot);
            }
        }
    }
    plant_trees(&mut builder, &paints, &path, seed, &sides);
    furniture::furnish(&mut builder, &paints, &path, seed, end);
    backdrop::backdrop(&mut builder, &paints, &path, seed, end);
    ProceduralScene {
        scene: builder.finish(camera(&path)),
        sun_direction: Vec3::new(0.66, 0.43, 0.52).normalize(),
        up: Vec3::Y,
    }
}

/// Divides a side into plots. The right side opens to a garden beside the camera, which lets the
/// sun in; the left has an alley.
fn lay_out(side: f32, houses: u32, random: &mut Random) -> Vec<Plot> {
    let mut start = if side < 0.0 { -27.0 } else { -24.0 };
    let mut plots = Vec::new();
    let gaps: &[(f32, f32)] =
        if side < 0.0 { &[(47.0, 4.5)] } else { &[(-6.0, 19.0), (46.0, 7.0)] };
    let mut gaps = gaps.iter().peekable();
    for _ in 0..houses {
        if let Some((_, width)) = gaps.next_if(|(place, _)| start + 3.0 > *place) {
            plots.push(Plot { start, width: *width, is_gap: true });
            start += width;
        }
        let width = random.range(7.2, 11.2);
        plots.push(Plot { start, width, is_gap: false });
        start += width;
    }
    plots
}

/// Frame of a plot: X along the facade to the right as seen from the street, Z toward the street,
/// origin at the left end of the facade line, on the sidewalk's highest level.
fn plot_frame(path: &StreetPath, side: f32, plot: &Plot) -> Affine3A {
    let middle = path.frame(plot.start + plot.width * 0.5);
    let quarter_turn = -side * std::f32::consts::FRAC_PI_2;
    let turn = Mat3::from(middle.matrix3) * Mat3::from_rotation_y(quarter_turn);
    let mut origin = middle.transform_point3(Vec3::new(side * FACADE, 0.0, 0.0))
        - turn.x_axis * plot.width * 0.5;
    let level = path.height(plot.start).max(path.height(plot.start + plot.width));
    origin.y = level + CURB;
    Affine3A::from_mat3_translation(turn, origin)
}

fn plant_trees(
    builder: &mut SceneBuilder,
    paints: &StreetPaints,
    path: &StreetPath,
    seed: u64,
    sides: &[Vec<Plot>; 2],
) {
    let mut places: Vec<(f32, f32)> = Vec::new();
    for (side, plots) in [-1.0, 1.0].into_iter().zip(sides) {
        for plot in plots.iter().filter(|plot| plot.is_gap && plot.width > 6.0) {
            places.push((plot.start + plot.width * 0.62, side * (FACADE + 4.0)));
            places.push((plot.start + plot.width * 0.84, side * (FACADE + 6.5)));
            if plot.width > 12.0 {
                places.push((plot.start + plot.width * 0.28, side * (FACADE + 6.0)));
            }
        }
    }
    let end = sides.iter().flatten().map(|plot| plot.start + plot.width).fold(0.0, f32::max);
    let mut s = 21.0;
    let mut side = -1.0;
    while s < end {
        places.push((s, side * (ROAD_HALF + 0.75)));
        s += if side < 0.0 { 6.0 } else { 9.0 };
        side = -side;
    }
    for (number, (s, offset)) in places.into_iter().enumerate() {
        let mut random = Random::for_part(seed, 500 + number as u64);
        let in_garden = offset.abs() > FACADE;
        let shape = TreeShape {
            height: if in_garden { random.range(6.0, 7.5) } else { random.range(4.6, 5.8) },
            crown_radius: if in_garden { random.range(1.9, 2.3) } else { random.range(1.25, 1.6) },
            leaf_count: if in_garden {
                4000
            } else if s < 45.0 {
                3000
            } else {
                1600
            },
        };
        let frame = Affine3A::from_translation(path.point(s, offset, CURB));
        tree(&mut builder.pen(frame), paints.plants, &mut random, shape);
    }
}

/// Eye a little above head height, near the sunny sidewalk, looking into the bend.
fn camera(path: &StreetPath) -> Camera {
    let eye = path.point(-1.0, 1.5, 2.5);
    let target = path.point(34.0, -1.6, 3.1);
    Camera::look_at(eye, target, Vec3::Y, 47f32.to_radians())
}
