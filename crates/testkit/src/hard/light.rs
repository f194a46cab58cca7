//! Light of all strengths.

use super::forms::{polygon_share, rectangle, sky_texel, small_lamp};
use super::shapes::{disk, sheet};
use super::{
    CaseReceiver, CaseScene, CaseSky, Engine, HardCase, KnownLimit, Refusal, largest_error,
    largest_relative, refused, worse,
};
use crate::scenes::{SurfelForm, closed_room};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{DVec3, Vec3};
use std::f64::consts::PI;

/// Why irradiance of a plain shape is right within 1 %, whatever its radiance.
const ROUNDED: &str = "radiance is kept as a shared exponent, within 2⁻⁹; a floor of 0.6 of the hemisphere is placed within 0.008 of it";

/// Why light of a texel of the sky is right within 2 %.
const TEXEL: &str = "the texel's light is moved to a raster of 1/16, in which a cosine changes by 1/16 at most and is kept to second order: \
    (1/16)²/2 of 1, over a cosine of 0.2 and more";

/// The sky's width.
const WIDTH: usize = 64;

pub(super) const CASES: [HardCase; 22] = [
    HardCase {
        name: "hidden-1e15",
        about: "a wall of radiance 1, and behind it a surfel of 10¹⁵ that no receiver sees; irradiance of the wall, relative",
        promise: 0.02,
        why: ROUNDED,
        limit: Some(KnownLimit {
            today: 1.0,
            because: "lobes hold 40 octaves below the brightest of the file: clusters of the wall are black, and the bake says so, with a count",
        }),
        measure: |engine| bright_behind_wall(engine, 1e15),
    },
    HardCase {
        name: "hidden-1e4",
        about: "`hidden-1e15` with 10⁴",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_behind_wall(engine, 1e4),
    },
    HardCase {
        name: "hidden-1e8",
        about: "`hidden-1e15` with 10⁸",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_behind_wall(engine, 1e8),
    },
    HardCase {
        name: "lamp-below-ceiling",
        about: "a lamp a quarter as wide as a black ceiling and a hundredth of it below, both of two sides; irradiance of the floor, relative",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| lamp_below_ceiling(engine, Vec3::Y, Vec3::X),
    },
    HardCase {
        name: "lamp-below-slanted-ceiling",
        about: "`lamp-below-ceiling`, all of it turned",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| {
            let up = Vec3::new(0.3, 0.9, -0.2).normalize();
            lamp_below_ceiling(engine, up, up.cross(Vec3::new(0.5, 0.1, 0.8)).normalize())
        },
    },
    HardCase {
        name: "one-of-1600",
        about: "a floor of 1600 tiles of radiance 0, one of 1; irradiance above it, relative",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_tile(engine, 40, 0.0, 1.0, None),
    },
    HardCase {
        name: "one-of-a-million-1e9",
        about: "a floor of a million tiles of radiance 1, one of 10⁹; irradiance above it, relative",
        promise: 0.02,
        why: ROUNDED,
        limit: Some(KnownLimit {
            today: 0.037,
            because: "a node shines from the whole of its outline, so that a bright surfel in it is off its place by up to a node's radius",
        }),
        measure: |engine| bright_tile(engine, 1000, 1.0, 1e9, None),
    },
    HardCase {
        name: "one-of-a-million-fine",
        about: "`one-of-a-million-1e9` surfel by surfel",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_tile(engine, 1000, 1.0, 1e9, Some(0.0)),
    },
    HardCase {
        name: "radiance-1e-30",
        about: "a floor of radiance 10⁻³⁰; irradiance above it, relative",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_floor(engine, 1e-30),
    },
    HardCase {
        name: "radiance-1e-15",
        about: "`radiance-1e-30` of 10⁻¹⁵",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_floor(engine, 1e-15),
    },
    HardCase {
        name: "radiance-1e20",
        about: "`radiance-1e-30` of 10²⁰",
        promise: 0.02,
        why: ROUNDED,
        limit: None,
        measure: |engine| bright_floor(engine, 1e20),
    },
    HardCase {
        name: "radiance-1e38",
        about: "`radiance-1e-30` of 10³⁸, whose sums are no numbers: refused, or right",
        promise: 0.02,
        why: "what is no number never reaches an output: a bake or a run that would give it ends with 3",
        limit: None,
        measure: too_bright_floor,
    },
    HardCase {
        name: "infinite-radiance",
        about: "a surfel of infinite radiance: refused (1 if it is shaded to numbers)",
        promise: 0.0,
        why: "records are checked when they are read",
        limit: None,
        measure: |engine| refused(engine, &floor_scene(f32::INFINITY), 3, "radiance"),
    },
    HardCase {
        name: "dim-room",
        about: "a closed room of radiance 10⁻³⁰; irradiance over π 10⁻³⁰, 1",
        promise: 0.02,
        why: "a closed room has no outline; radiance within 2⁻⁹, the horizon within 0.01",
        limit: None,
        measure: dim_room,
    },
    HardCase {
        name: "grazing-lamp",
        about: "a lamp from a tenth down to a hundredth of its distance above the horizon; irradiance, relative",
        promise: 0.03,
        why: "light of what is far smaller than a texel is weighted by the cosine at its place, which lies on a grid of 1/256 of a texel of 1/8: \
            half a step is 0.00024 of a cosine of 0.0096, and energy is right within 2⁻⁹",
        limit: None,
        measure: grazing_lamp,
    },
    HardCase {
        name: "open-sky",
        about: "nothing but a far crumb below a sky of radiance 1; irradiance over π, and openness, 1",
        promise: 1e-3,
        why: "the sum over texels is scaled to π for each normal; single precision leaves 10⁻⁴",
        limit: None,
        measure: |engine| open_sky(engine, 1.0),
    },
    HardCase {
        name: "sky-1e-30",
        about: "`open-sky` with a sky of 10⁻³⁰, relative",
        promise: 1e-3,
        why: "single precision holds 10⁻³⁸ and more",
        limit: None,
        measure: |engine| open_sky(engine, 1e-30),
    },
    HardCase {
        name: "sky-1e30",
        about: "`open-sky` with a sky of 10³⁰, relative",
        promise: 1e-3,
        why: "single precision holds 10³⁸ and less",
        limit: None,
        measure: |engine| open_sky(engine, 1e30),
    },
    HardCase {
        name: "sky-texel-1e8",
        about: "a sky of 0 but for one texel of 10⁸ high up; irradiance of receivers that face it more or less, relative",
        promise: 0.02,
        why: TEXEL,
        limit: None,
        measure: |engine| texel_of_sky(engine, 8),
    },
    HardCase {
        name: "sky-texel-low",
        about: "`sky-texel-1e8` with a texel 8° above the horizon",
        promise: 0.02,
        why: TEXEL,
        limit: None,
        measure: |engine| texel_of_sky(engine, 14),
    },
    HardCase {
        name: "sky-texel-below",
        about: "`sky-texel-1e8` with a texel below the horizon; irradiance over that of facing it, 0",
        promise: 0.0,
        why: "what is below the horizon gives nothing",
        limit: None,
        measure: texel_below,
    },
    HardCase {
        name: "sky-texel-hidden",
        about: "a texel of 10⁸ behind a lid, and beside one; irradiance over that without a lid, 0 and 1",
        promise: 0.01,
        why: "the lid's edges are 20° away from the texel; a piece of a closed sheet lets nothing through",
        limit: None,
        measure: texel_behind_lid,
    },
];

/// A dark or bright floor of edge 2, and receivers above it that look down.
fn floor_scene(radiance: f32) -> CaseScene {
    let floor = sheet(Vec3::ZERO, Vec3::Y, Vec3::X, [1.0; 2], [40; 2], radiance);
    CaseScene::new(floor.collect(), above_floor())
}

const ABOVE: [DVec3; 3] =
    [DVec3::new(0.0, 0.5, 0.0), DVec3::new(0.61, 0.3, -0.17), DVec3::new(-0.9, 1.0, 0.8)];

fn above_floor() -> Vec<CaseReceiver> {
    ABOVE.map(|place| CaseReceiver::diffuse(place, Vec3::NEG_Y)).to_vec()
}

/// Irradiance there from a floor of radiance 1.
fn from_floor() -> [f64; 3] {
    let floor = rectangle(DVec3::ZERO, DVec3::X, DVec3::Z);
    ABOVE.map(|place| PI * polygon_share(&floor, place, DVec3::NEG_Y))
}

fn bright_behind_wall(engine: &mut dyn Engine, radiance: f32) -> Result<f64, Refusal> {
    let mut scene = floor_scene(1.0);
    let bright = disk(Vec3::new(0.01, -0.002, 0.012), Vec3::NEG_Y, 0.01, radiance);
    if let super::CaseCloud::Surfels { surfels, .. } = &mut scene.cloud {
        surfels.push(bright);
    }
    let found = engine.shade(&scene)?;
    Ok(largest_relative(found.iter().map(|f| f.surfaces).zip(from_floor())))
}

/// One tile in the middle of a floor of so many along an edge.
fn bright_tile(
    engine: &mut dyn Engine,
    edge: usize,
    dim: f32,
    bright: f32,
    solid_angle_sr: Option<f32>,
) -> Result<f64, Refusal> {
    let mut surfels: Vec<Surfel> =
        sheet(Vec3::ZERO, Vec3::Y, Vec3::X, [1.0; 2], [edge; 2], dim).collect();
    let tile = &mut surfels[edge * edge / 2 + edge / 3];
    *tile = tile.with_radiance([bright; 3]);
    let (lamp, area) = (tile.center().as_dvec3(), f64::from(tile.area));
    let scene = CaseScene::new(surfels, above_floor());
    let found = engine.shade(&CaseScene { solid_angle_sr, ..scene })?;
    let right = ABOVE.into_iter().zip(from_floor()).map(|(place, floor)| {
        let more = f64::from(bright - dim);
        f64::from(dim) * floor + more * small_lamp(lamp, DVec3::Y, area, place, DVec3::NEG_Y)
    });
    Ok(largest_relative(found.iter().map(|f| f.surfaces).zip(right)))
}

fn bright_floor(engine: &mut dyn Engine, radiance: f32) -> Result<f64, Refusal> {
    let found = engine.shade(&floor_scene(radiance))?;
    let right = from_floor().map(|floor| floor * f64::from(radiance));
    Ok(largest_relative(found.iter().map(|f| f.surfaces).zip(right)))
}

fn too_bright_floor(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    match bright_floor(engine, 1e38) {
        Err(refusal) if refusal.exit_code == 3 => Ok(0.0),
        other => other,
    }
}

fn dim_room(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let room = closed_room(Vec3::ONE, 20, 1e-30, SurfelForm::Rectangles);
    let places = [Vec3::ZERO, Vec3::new(0.7, -0.3, 0.2), Vec3::new(-0.9, 0.8, 0.95)];
    let at = |place: Vec3| CaseReceiver::diffuse(place.as_dvec3(), Vec3::ONE);
    let found = engine.shade(&CaseScene::new(room, places.map(at).to_vec()))?;
    Ok(largest_relative(found.iter().map(|f| (f.surfaces, PI * f64::from(1e-30f32)))))
}

/// Of a lamp below a ceiling at the height 2, above receivers on the ground of this normal.
fn lamp_below_ceiling(engine: &mut dyn Engine, up: Vec3, along: Vec3) -> Result<f64, Refusal> {
    let across = up.cross(along);
    let mut surfels = Vec::new();
    for (height, half, count, radiance) in [(2.0, 1.0, 200, 0.0), (1.98, 0.25, 50, 1.0)] {
        for (normal, radiance) in [(-up, radiance), (up, 0.0)] {
            let side = sheet(up * height, normal, along, [half; 2], [count; 2], radiance);
            surfels.extend(side.map(|tile| tile.with_flags(SurfelFlags::FRONT_ONLY)));
        }
    }
    let places = [[0.0, 0.0], [0.9, 0.3], [-0.4, 0.7], [-1.5, -1.1]];
    let place = |[x, y]: [f32; 2]| (along * x + across * y).as_dvec3();
    let receivers = places.map(|at| CaseReceiver::diffuse(place(at), up)).to_vec();
    let found = engine.shade(&CaseScene::new(surfels, receivers))?;
    let [u, v] = [along, across].map(|edge| edge.as_dvec3() * 0.25);
    let lamp = rectangle(up.as_dvec3() * 1.98, u, v);
    let right = places.map(|at| PI * polygon_share(&lamp, place(at), up.as_dvec3()));
    Ok(largest_relative(found.iter().map(|f| f.surfaces).zip(right)))
}

fn grazing_lamp(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let mut worst = 0.0;
    for height in [0.1f32, 0.03, 0.01] {
        let at = Vec3::new(1.0, height, 0.3);
        let facing = -at.normalize();
        let receivers = vec![CaseReceiver::diffuse(DVec3::ZERO, Vec3::Y)];
        let found = engine.shade(&CaseScene::new(vec![disk(at, facing, 1e-3, 1e6)], receivers))?;
        let area = PI * 1e-6 * 1e6;
        let right = small_lamp(at.as_dvec3(), facing.as_dvec3(), area, DVec3::ZERO, DVec3::Y);
        worst = worse(worst, largest_relative(found.iter().map(|f| (f.surfaces, right))));
    }
    Ok(worst)
}

/// A crumb that is in nobody's way.
fn crumb() -> Vec<Surfel> {
    vec![disk(Vec3::NEG_Y * 100.0, Vec3::Y, 1e-3, 0.0)]
}

/// Normals of receivers, at the origin.
fn facing() -> [Vec3; 4] {
    [Vec3::Y, Vec3::new(0.3, 1.0, 0.2), Vec3::new(-0.5, 0.7, 0.1), Vec3::new(0.1, 0.6, -0.7)]
        .map(Vec3::normalize)
}

fn toward(normals: impl IntoIterator<Item = Vec3>) -> Vec<CaseReceiver> {
    normals.into_iter().map(|normal| CaseReceiver::diffuse(DVec3::ZERO, normal)).collect()
}

fn open_sky(engine: &mut dyn Engine, radiance: f32) -> Result<f64, Refusal> {
    let scene = CaseScene::new(crumb(), toward(facing())).under(CaseSky::Uniform(radiance));
    let found = engine.shade(&scene)?;
    let sky = largest_relative(found.iter().map(|f| (f.sky, PI * f64::from(radiance))));
    Ok(worse(sky, largest_error(found.iter().map(|f| (f.open, 1.0)))))
}

/// A sky of one texel of 10⁸ in the middle column.
fn one_texel(row: usize) -> CaseSky {
    let mut texels = vec![0.0; WIDTH * WIDTH / 2];
    texels[row * WIDTH + WIDTH / 2] = 1e8;
    CaseSky::Image { width: WIDTH, texels }
}

/// Its irradiance of a receiver that faces `normal`.
fn from_texel(row: usize, normal: DVec3) -> f64 {
    let texel = sky_texel(WIDTH, WIDTH / 2, row, 16);
    texel.map(|(d, solid_angle)| 1e8 * d.dot(normal).max(0.0) * solid_angle).sum()
}

fn texel_of_sky(engine: &mut dyn Engine, row: usize) -> Result<f64, Refusal> {
    let normals = facing().into_iter().filter(|n| from_texel(row, n.as_dvec3()) > 2e5);
    let normals: Vec<Vec3> = normals.collect();
    let scene = CaseScene::new(crumb(), toward(normals.iter().copied())).under(one_texel(row));
    let found = engine.shade(&scene)?;
    let right = normals.iter().map(|normal| from_texel(row, normal.as_dvec3()));
    Ok(largest_relative(found.iter().map(|f| f.sky).zip(right)))
}

fn texel_below(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let scene = CaseScene::new(crumb(), toward([Vec3::NEG_Y, Vec3::NEG_Z])).under(one_texel(8));
    let found = engine.shade(&scene)?;
    let whole = from_texel(8, sky_texel(WIDTH, WIDTH / 2, 8, 1).map(|(d, _)| d).sum());
    Ok(largest_error(found.iter().map(|f| (f.sky / whole, 0.0))))
}

fn texel_behind_lid(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    // The texel is 45° high, along +Z.
    let lid = |along: Vec3| {
        let (normal, middle) = (-along, along * 0.5);
        sheet(middle, normal, Vec3::X, [0.25; 2], [24; 2], 0.0).collect::<Vec<_>>()
    };
    let up = toward([Vec3::Y]);
    let sky = |engine: &mut dyn Engine, surfels: Vec<Surfel>| {
        let scene = CaseScene::new(surfels, up.clone()).under(one_texel(8));
        Ok(engine.shade(&scene)?.iter().map(|f| f.sky).sum::<f64>())
    };
    let slanted = Vec3::new(0.0, 1.0, 1.0).normalize();
    let beside = Vec3::new(0.0, 1.0, -1.0).normalize();
    let whole = from_texel(8, DVec3::Y);
    let (hidden, open) = (sky(engine, lid(slanted))?, sky(engine, lid(beside))?);
    Ok(largest_error([(hidden / whole, 0.0), (open / whole, 1.0)]))
}

#[cfg(test)]
mod tests {
    use super::super::forms::disk_share;
    use super::*;

    #[test]
    fn floors_hide_what_disks_as_large_do() {
        let floor = from_floor()[0] / PI;
        assert!(floor > disk_share(1.0, 0.5) && floor < disk_share(2f64.sqrt(), 0.5), "{floor}");
    }
}
