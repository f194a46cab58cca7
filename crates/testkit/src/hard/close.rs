//! Surfaces that all but touch.

use super::forms::{disk_share, polygon_share, rectangle};
use super::shapes::{disk, sheet, tile};
use super::{
    CaseCloud, CaseReceiver, CaseScene, CaseSky, Engine, Found, HardCase, KnownLimit, Refusal,
    largest_error, worse,
};
use crate::scenes::{SurfelForm, closed_room};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{DVec3, Vec3};
use std::f64::consts::PI;
use std::fmt::Write;

/// Why shares of rectangles may be off by 0.01.
const OUTLINE: &str = "an outline of 2π rad crosses 50 texels of 1/64 sr, and is placed within half a sample, 1/32 of a texel, in each: \
    50/(32 · 64 π) = 0.008; a texel's own quadrature adds 0.002";

/// Why sheets very close to each other do not hide each other.
const ONE_SHEET: &str = "codes of normals are off by up to 0.07°: a tile that faces the receiver from no farther than twice that, times its radius, \
    7·10⁻⁵ here, is taken for the other side of the receiver's own sheet";

/// Why a small hole is open by its share.
const HOLE: &str = "four edges of 0.1 rad cross four texels of 1/64 sr, placed within half a sample: 4/(32 · 64 π) = 0.0006; each is drawn 2 % \
    longer at both of its sides than it is, 0.1 · 0.04 of 0.0064, and so are pieces beside it";

pub(super) const CASES: [HardCase; 18] = [
    HardCase {
        name: "sheets-1e-3",
        about: "two sheets that face each other, 10⁻³ of their size apart; openness between them, 0 but for their rims",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| between_sheets(engine, 1e-3),
    },
    HardCase {
        name: "sheets-1e-4",
        about: "`sheets-1e-3`, 10⁻⁴ apart",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| between_sheets(engine, 1e-4),
    },
    HardCase {
        name: "sheets-1e-5",
        about: "`sheets-1e-3`, 10⁻⁵ apart",
        promise: 0.01,
        why: OUTLINE,
        limit: Some(KnownLimit { today: 1.0, because: ONE_SHEET }),
        measure: |engine| between_sheets(engine, 1e-5),
    },
    HardCase {
        name: "sheets-of-points",
        about: "`sheets-1e-3`, 10⁻³ apart, as points whose sizes are not known",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: between_points,
    },
    HardCase {
        name: "sheets-same-way",
        about: "two sheets that face the same way, 10⁻³ apart; openness on the lower, which the back of the upper hides",
        promise: 0.01,
        why: OUTLINE,
        limit: Some(KnownLimit {
            today: 1.0,
            because: "0.05 of a tile's radius for tiles that look the same way as the receiver: receivers of G-buffers lie below bent surfaces",
        }),
        measure: under_a_back,
    },
    HardCase {
        name: "facing-disk",
        about: "a lamp from 10⁻³ to a tenth of its radius before a receiver; openness, and irradiance over π, 1/(1 + h²)",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| near_disk(engine, Vec3::NEG_Y),
    },
    HardCase {
        name: "facing-tile",
        about: "`facing-disk` with a square of edge 2 in place of the disk",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: near_tile,
    },
    HardCase {
        name: "behind-disk",
        about: "`facing-disk` seen from behind: no light, and as little openness",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| near_disk(engine, Vec3::Y),
    },
    HardCase {
        name: "behind-disk-sky",
        about: "`behind-disk` under a sky; its irradiance over π, which does not come through",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: behind_disk_in_sky,
    },
    HardCase {
        name: "corner-1e-5",
        about: "a floor before a wall, from a tenth down to 10⁻⁵ of its height away; openness",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: beside_wall,
    },
    HardCase {
        name: "corner-of-three",
        about: "the corner of a closed room of radiance 1, receivers 10⁻⁵ from all three walls; irradiance over π, 1",
        promise: 0.01,
        why: "a closed room has no outline; the nearest tiles are seen under π/2 each and cut at the horizon, where a texel's cosine is 1/16 at \
            most and its samples place the cut within 1/32: 50/(32 · 16 · 64 π) < 0.001, and what floats above the tile of its own is left out \
            below a slope of 0.4/20",
        limit: None,
        measure: corner_of_three,
    },
    HardCase {
        name: "wedge-10-degrees",
        about: "a lid hinged 10° above a floor; openness down to 10⁻³ from the hinge",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: in_wedge,
    },
    HardCase {
        name: "coincident-floors",
        about: "two floors at one place; openness on them, 1",
        promise: 0.0,
        why: "what lies in the receiver's own plane, facing its way, hides nothing, however often it is there",
        limit: None,
        measure: on_coincident_floors,
    },
    HardCase {
        name: "opposed-pair",
        about: "two sheets' sides at one place, of radiance 1 below and 5 above; openness below, and irradiance over π from 1",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: opposed_pair,
    },
    HardCase {
        name: "flipped-normals",
        about: "a ceiling whose tiles face up and down in turns, black; openness below, as if they all faced down",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| flipped_normals(engine, None),
    },
    HardCase {
        name: "flipped-normals-fine",
        about: "`flipped-normals` surfel by surfel",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| flipped_normals(engine, Some(0.0)),
    },
    HardCase {
        name: "hole-in-lid",
        about: "a closed room with a hole of a hundredth of its lid; openness of the floor",
        promise: 0.0015,
        why: HOLE,
        limit: Some(KnownLimit {
            today: 0.0033,
            because: "a node that is larger than the hole has it in its stencil as cells that are half covered",
        }),
        measure: |engine| through_hole(engine, None),
    },
    HardCase {
        name: "hole-in-lid-fine",
        about: "`hole-in-lid` surfel by surfel",
        promise: 0.0015,
        why: HOLE,
        limit: None,
        measure: |engine| through_hole(engine, Some(0.0)),
    },
];

/// Places on a floor, off the middles of tiles.
fn floor_places() -> impl Iterator<Item = Vec3> {
    let step = |i: i32| (i - 1) as f32 * 0.1;
    (0..9).map(move |i| Vec3::new(step(i % 3) + 0.013, 0.0, step(i / 3) + 0.007))
}

/// Upward receivers at these places.
fn upward(places: impl IntoIterator<Item = Vec3>) -> Vec<CaseReceiver> {
    let up = |place: Vec3| CaseReceiver::diffuse(place.as_dvec3(), Vec3::Y);
    places.into_iter().map(up).collect()
}

/// Openness of upward receivers below a square of edge 1 at a height.
fn open_below(receivers: &[CaseReceiver], height: f64) -> impl Iterator<Item = f64> {
    let square = rectangle(DVec3::Y * height, DVec3::X * 0.5, DVec3::Z * 0.5);
    receivers.iter().map(move |r| 1.0 - polygon_share(&square, r.position, DVec3::Y))
}

/// A square of edge 1 at a height.
fn square(height: f32, normal: Vec3) -> impl Iterator<Item = Surfel> {
    sheet(Vec3::Y * height, normal, Vec3::X, [0.5; 2], [24; 2], 0.0)
}

/// Largest error of openness below a square.
fn open_errors(found: &[Found], receivers: &[CaseReceiver], height: f64) -> f64 {
    largest_error(found.iter().map(|f| f.open).zip(open_below(receivers, height)))
}

fn between_sheets(engine: &mut dyn Engine, apart: f32) -> Result<f64, Refusal> {
    let surfels = square(0.0, Vec3::Y).chain(square(apart, Vec3::NEG_Y)).collect();
    let receivers = upward(floor_places());
    let found = engine.shade(&CaseScene::new(surfels, receivers.clone()))?;
    Ok(open_errors(&found, &receivers, f64::from(apart)))
}

fn under_a_back(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let surfels = square(0.0, Vec3::Y).chain(square(1e-3, Vec3::Y)).collect();
    let receivers = upward(floor_places());
    let found = engine.shade(&CaseScene::new(surfels, receivers.clone()))?;
    Ok(open_errors(&found, &receivers, 1e-3))
}

fn between_points(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let mut text = "ply\nformat ascii 1.0\nelement vertex 4608\n".to_owned();
    for column in ["x", "y", "z", "nx", "ny", "nz"] {
        text += &format!("property float {column}\n");
    }
    text += "end_header\n";
    for (height, facing) in [(0.0, 1), (1e-3, -1)] {
        for i in 0..48 * 48 {
            let place = |i: i32| (f64::from(i) + 0.5) / 48.0 - 0.5;
            let _ = writeln!(text, "{} {height} {} 0 {facing} 0", place(i % 48), place(i / 48));
        }
    }
    let receivers = upward(floor_places());
    let scene = CaseScene::new(Vec::new(), receivers.clone());
    let found = engine.shade(&CaseScene { cloud: CaseCloud::Ply(text), ..scene })?;
    Ok(open_errors(&found, &receivers, 1e-3))
}

/// How far what is near is from its receivers.
const NEAR: [f32; 5] = [1e-3, 1e-2, 0.049, 0.051, 0.1];

/// Receivers below a disk of radius 1.
fn below_disk() -> (Vec<CaseReceiver>, impl Iterator<Item = f64>) {
    let receivers = upward(NEAR.map(|height| Vec3::NEG_Y * height));
    (receivers, NEAR.into_iter().map(|height| disk_share(1.0, f64::from(height))))
}

fn near_tile(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let receivers = upward(NEAR.map(|height| Vec3::NEG_Y * height));
    let square = tile(Vec3::ZERO, Vec3::NEG_Y, Vec3::X, [2.0; 2], 1.0);
    let found = engine.shade(&CaseScene::new(vec![square], receivers.clone()))?;
    let square = rectangle(DVec3::ZERO, DVec3::X, DVec3::Z);
    let shares = receivers.iter().map(|r| polygon_share(&square, r.position, DVec3::Y));
    let pairs = found.iter().zip(shares);
    Ok(largest_error(
        pairs.flat_map(|(f, share)| [(f.open, 1.0 - share), (f.surfaces / PI, share)]),
    ))
}

fn near_disk(engine: &mut dyn Engine, facing: Vec3) -> Result<f64, Refusal> {
    let (receivers, shares) = below_disk();
    let found =
        engine.shade(&CaseScene::new(vec![disk(Vec3::ZERO, facing, 1.0, 1.0)], receivers))?;
    let lit = if facing == Vec3::Y { 0.0 } else { 1.0 };
    let pairs = found.iter().zip(shares);
    Ok(largest_error(
        pairs.flat_map(|(f, share)| [(f.open, 1.0 - share), (f.surfaces / PI, lit * share)]),
    ))
}

fn behind_disk_in_sky(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (receivers, shares) = below_disk();
    let scene = CaseScene::new(vec![disk(Vec3::ZERO, Vec3::Y, 1.0, 1.0)], receivers);
    let found = engine.shade(&scene.under(CaseSky::Uniform(1.0)))?;
    Ok(largest_error(found.iter().zip(shares).map(|(f, share)| (f.sky / PI, 1.0 - share))))
}

fn beside_wall(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let floor = sheet(Vec3::X, Vec3::Y, Vec3::X, [1.0; 2], [20; 2], 0.0);
    let wall = sheet(Vec3::Y * 0.5, Vec3::X, Vec3::Y, [0.5, 1.0], [10, 20], 0.0);
    let away = [0.1f32, 1e-2, 1e-3, 1e-4, 1e-5];
    let receivers = upward(away.map(|x| Vec3::new(x, 0.0, 0.013)));
    let found = engine.shade(&CaseScene::new(floor.chain(wall).collect(), receivers.clone()))?;
    let wall = rectangle(DVec3::Y * 0.5, DVec3::Y * 0.5, DVec3::Z);
    let right = receivers.iter().map(|r| 1.0 - polygon_share(&wall, r.position, DVec3::Y));
    Ok(largest_error(found.iter().map(|f| f.open).zip(right)))
}

fn corner_of_three(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let corner = Vec3::ONE - 1e-5;
    let facing = [Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z, Vec3::NEG_ONE];
    let receivers =
        facing.map(|normal| CaseReceiver::diffuse(corner.as_dvec3(), normal.normalize()));
    let room = closed_room(Vec3::ONE, 20, 1.0, SurfelForm::Rectangles);
    let found = engine.shade(&CaseScene::new(room, receivers.to_vec()))?;
    Ok(largest_error(found.iter().map(|f| (f.surfaces / PI, 1.0))))
}

fn in_wedge(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (sin, cos) = 10f32.to_radians().sin_cos();
    let along = Vec3::new(cos, sin, 0.0);
    let lid_normal = Vec3::new(sin, -cos, 0.0);
    let floor = sheet(Vec3::X * 0.5, Vec3::Y, Vec3::X, [0.5; 2], [20; 2], 0.0);
    let lid = sheet(along * 0.5, lid_normal, along, [0.5; 2], [20; 2], 0.0);
    let receivers = upward([0.3f32, 0.1, 1e-2, 1e-3].map(|x| Vec3::new(x, 0.0, 0.007)));
    let found = engine.shade(&CaseScene::new(floor.chain(lid).collect(), receivers.clone()))?;
    let lid = rectangle(along.as_dvec3() * 0.5, along.as_dvec3() * 0.5, DVec3::Z * 0.5);
    let right = receivers.iter().map(|r| 1.0 - polygon_share(&lid, r.position, DVec3::Y));
    Ok(largest_error(found.iter().map(|f| f.open).zip(right)))
}

fn on_coincident_floors(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let surfels = square(0.0, Vec3::Y).chain(square(0.0, Vec3::Y)).collect();
    let found = engine.shade(&CaseScene::new(surfels, upward(floor_places())))?;
    Ok(largest_error(found.iter().map(|f| (f.open, 1.0))))
}

fn opposed_pair(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let side = |normal: Vec3, radiance: f32| {
        let tiles = sheet(Vec3::Y * 0.3, normal, Vec3::X, [0.5; 2], [24; 2], radiance);
        tiles.map(|tile| tile.with_flags(SurfelFlags::FRONT_ONLY))
    };
    let surfels = side(Vec3::NEG_Y, 1.0).chain(side(Vec3::Y, 5.0)).collect();
    let receivers = upward(floor_places());
    let found = engine.shade(&CaseScene::new(surfels, receivers.clone()))?;
    let open = open_errors(&found, &receivers, 0.3);
    let right = open_below(&receivers, 0.3).map(|open| 1.0 - open);
    Ok(worse(open, largest_error(found.iter().map(|f| f.surfaces / PI).zip(right))))
}

fn flipped_normals(engine: &mut dyn Engine, solid_angle_sr: Option<f32>) -> Result<f64, Refusal> {
    let flip = |(i, down): (usize, Surfel)| {
        let is_flipped = (i + i / 24) % 2 == 0;
        let edges = [1.0 / 24.0; 2];
        if is_flipped { tile(down.center(), Vec3::Y, Vec3::X, edges, 0.0) } else { down }
    };
    let surfels = square(0.3, Vec3::NEG_Y).enumerate().map(flip).collect();
    let receivers = upward(floor_places());
    let scene = CaseScene::new(surfels, receivers.clone());
    let found = engine.shade(&CaseScene { solid_angle_sr, ..scene })?;
    Ok(open_errors(&found, &receivers, 0.3))
}

fn through_hole(engine: &mut dyn Engine, solid_angle_sr: Option<f32>) -> Result<f64, Refusal> {
    let mut room = closed_room(Vec3::ONE, 20, 0.0, SurfelForm::Rectangles);
    room.retain(|s| s.position[1] < 1.0 || s.position[0].abs() > 0.1 || s.position[2].abs() > 0.1);
    let receivers =
        upward([Vec3::NEG_Y, Vec3::new(0.43, -1.0, 0.21), Vec3::new(-0.77, -1.0, 0.68)]);
    let scene = CaseScene::new(room, receivers.clone());
    let found = engine.shade(&CaseScene { solid_angle_sr, ..scene })?;
    let hole = rectangle(DVec3::Y, DVec3::X * 0.1, DVec3::Z * 0.1);
    let right = receivers.iter().map(|r| polygon_share(&hole, r.position, DVec3::Y));
    Ok(largest_error(found.iter().map(|f| f.open).zip(right)))
}
