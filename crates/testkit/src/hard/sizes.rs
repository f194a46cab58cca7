//! Sizes far apart, and surfels that are no surface.

use super::forms::{disk_share, polygon_share, rectangle, small_lamp};
use super::shapes::{Chance, disk, sheet, tile};
use super::{
    CaseReceiver, CaseScene, Engine, HardCase, KnownLimit, Refusal, largest_error,
    largest_relative, worse,
};
use crate::scenes::{SurfelForm, closed_room, sphere_directions};
use pbgi_cloud::Surfel;
use pbgi_math::{DVec3, Vec3};
use std::f64::consts::PI;

/// Why shares may be off by 0.01.
const OUTLINE: &str = "an outline of 2π rad crosses 50 texels of 1/64 sr, placed within half a sample in each: 0.008, and 0.002 of quadrature";

/// Why light of a small lamp is right within 1 %.
const SMALL: &str = "energy is exact by the true area; the solid angle of a disk far away is right within 1 % from eleven radii on, and here \
    within (r/d)², and the lamp's light is weighted by the cosine at its middle, kept within 0.3 %";

/// Why half open slats are open by half.
const PICKETS: &str = "a hundred edges of 1.5 rad along twelve texels of 1/64 sr each, placed within half a sample, 1/32, alike along an edge and at \
    random from edge to edge: √100 · 12/(32 · 64 π) = 0.019";

pub(super) const CASES: [HardCase; 13] = [
    HardCase {
        name: "one-surfel",
        about: "a disk of radius 1 half a unit above a receiver, and nothing else; openness and irradiance over π, 0.2 and 0.8",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| disks_at_one_place(engine, 1),
    },
    HardCase {
        name: "one-place-1e3",
        about: "`one-surfel` with a thousand such disks at one place",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| disks_at_one_place(engine, 1000),
    },
    HardCase {
        name: "one-place-1e6",
        about: "`one-surfel` with a million such disks at one place",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| disks_at_one_place(engine, 1_000_000),
    },
    HardCase {
        name: "on-a-line",
        about: "a strip of a thousand tiles in a row; share that it hides, and its irradiance over π",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| strip(engine, [1000, 1], [1.0, 0.02]),
    },
    HardCase {
        name: "on-a-plane",
        about: "ten thousand tiles in a plane of no thickness; share that it hides, and its irradiance over π",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: |engine| strip(engine, [100, 100], [1.0, 1.0]),
    },
    HardCase {
        name: "needle",
        about: "one tile a thousand times longer than wide; share that it hides, and its irradiance over π",
        promise: 0.003,
        why: "two edges of 2.2 rad along a row of 18 texels of 1/64 sr, each placed within half a sample, 1/32 of a texel, in all of them alike: \
            2 · 18/(32 · 64 π) = 0.0056 where both are off, and the tile is narrower than one of 32",
        limit: None,
        measure: |engine| strip(engine, [1, 1], [1.0, 0.001]),
    },
    HardCase {
        name: "plate-among-crumbs",
        about: "a plate among ten thousand crumbs a million times smaller; share that it hides, and its irradiance over π",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: plate_among_crumbs,
    },
    HardCase {
        name: "crumb-lamp",
        about: "a lamp 10⁻⁶ as large as the dark floor it stands over; its irradiance, A cos cos/d², relative",
        promise: 0.01,
        why: SMALL,
        limit: None,
        measure: crumb_lamp,
    },
    HardCase {
        name: "far-lamp",
        about: "a lamp 10⁵ radii away from a receiver in a ball of dark crumbs; its irradiance, relative",
        promise: 0.01,
        why: SMALL,
        limit: None,
        measure: far_lamp,
    },
    HardCase {
        name: "ball",
        about: "a ball of 4 000 tiles; share that it hides of a receiver below, (r/d)²",
        promise: 0.01,
        why: OUTLINE,
        limit: None,
        measure: under_ball,
    },
    HardCase {
        name: "pickets",
        about: "fifty slats and as many gaps of a hundredth; openness below",
        promise: 0.02,
        why: PICKETS,
        limit: Some(KnownLimit {
            today: 0.22,
            because: "cells of a node's stencil are as covered as its surfels' areas say, and hide at random what slats hide in order",
        }),
        measure: |engine| pickets(engine, None),
    },
    HardCase {
        name: "pickets-fine",
        about: "`pickets` surfel by surfel",
        promise: 0.02,
        why: PICKETS,
        limit: None,
        measure: |engine| pickets(engine, Some(0.0)),
    },
    HardCase {
        name: "flat-room",
        about: "a closed room a thousand times wider than high, of radiance 1; irradiance over π, 1",
        promise: 0.01,
        why: "a closed room has no outline: only the horizon is one, where cosines are 1/16 at most",
        limit: None,
        measure: flat_room,
    },
];

fn disks_at_one_place(engine: &mut dyn Engine, count: usize) -> Result<f64, Refusal> {
    let surfels = vec![disk(Vec3::Y * 0.5, Vec3::NEG_Y, 1.0, 1.0); count];
    let receivers = vec![CaseReceiver::diffuse(DVec3::ZERO, Vec3::Y)];
    let found = engine.shade(&CaseScene::new(surfels, receivers))?;
    let share = disk_share(1.0, 0.5);
    let pairs = found.iter().flat_map(|f| [(f.open, 1.0 - share), (f.surfaces / PI, share)]);
    Ok(largest_error(pairs))
}

/// A rectangle of these half edges, half a unit above some receivers.
fn strip(engine: &mut dyn Engine, counts: [usize; 2], half: [f32; 2]) -> Result<f64, Refusal> {
    let tiles = sheet(Vec3::Y * 0.5, Vec3::NEG_Y, Vec3::X, half, counts, 1.0);
    let places = [DVec3::ZERO, DVec3::new(0.31, 0.0, 0.017), DVec3::new(-0.9, 0.1, 0.23)];
    let receivers = places.map(|place| CaseReceiver::diffuse(place, Vec3::Y)).to_vec();
    let found = engine.shade(&CaseScene::new(tiles.collect(), receivers))?;
    let [u, v] = half.map(f64::from);
    let whole = rectangle(DVec3::Y * 0.5, DVec3::X * u, DVec3::Z * v);
    let shares = places.map(|place| polygon_share(&whole, place, DVec3::Y));
    let pairs = found.iter().zip(shares);
    Ok(largest_error(
        pairs.flat_map(|(f, share)| [(1.0 - f.open, share), (f.surfaces / PI, share)]),
    ))
}

fn plate_among_crumbs(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let mut chance = Chance::new(5);
    let mut crumb = || disk(chance.place() * 0.02 + Vec3::Y * 0.5, chance.direction(), 1e-6, 1.0);
    let mut surfels: Vec<Surfel> = (0..10_000).map(|_| crumb()).collect();
    surfels.push(tile(Vec3::Y * 0.5, Vec3::NEG_Y, Vec3::X, [2.0; 2], 1.0));
    let receivers = vec![CaseReceiver::diffuse(DVec3::ZERO, Vec3::Y)];
    let found = engine.shade(&CaseScene::new(surfels, receivers))?;
    let plate = rectangle(DVec3::Y * 0.5, DVec3::X, DVec3::Z);
    let share = polygon_share(&plate, DVec3::ZERO, DVec3::Y);
    let pairs = found.iter().flat_map(|f| [(f.open, 1.0 - share), (f.surfaces / PI, share)]);
    Ok(largest_error(pairs))
}

fn crumb_lamp(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let mut surfels: Vec<Surfel> =
        sheet(Vec3::ZERO, Vec3::Y, Vec3::X, [5.0; 2], [50; 2], 0.0).collect();
    let at = Vec3::new(0.3, 1.0, -0.2);
    surfels.push(disk(at, Vec3::NEG_Y, 1e-5, 1e9));
    let places = [DVec3::ZERO, DVec3::new(1.3, 0.0, 0.7), DVec3::new(-4.1, 0.0, 3.9)];
    let receivers = places.map(|place| CaseReceiver::diffuse(place, Vec3::Y)).to_vec();
    let found = engine.shade(&CaseScene::new(surfels, receivers))?;
    let area = PI * 1e-10 * 1e9;
    let right = places.map(|p| small_lamp(at.as_dvec3(), DVec3::NEG_Y, area, p, DVec3::Y));
    Ok(largest_relative(found.iter().map(|f| f.surfaces).zip(right)))
}

fn far_lamp(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let mut surfels: Vec<Surfel> = sphere_directions(1000)
        .filter(|d| d.y < 0.0)
        .map(|d| disk(d * 10.0, d, 1e-3, 0.0))
        .collect();
    let toward = Vec3::new(0.3, 0.9, 0.1).normalize();
    surfels.push(disk(toward * 100.0, -toward, 1e-3, 1e7));
    let receivers = vec![CaseReceiver::diffuse(DVec3::ZERO, Vec3::Y)];
    let found = engine.shade(&CaseScene::new(surfels, receivers))?;
    let (lamp, facing) = (toward.as_dvec3() * 100.0, -toward.as_dvec3());
    let right = small_lamp(lamp, facing, PI * 1e-6 * 1e7, DVec3::ZERO, DVec3::Y);
    Ok(largest_relative(found.iter().map(|f| (f.surfaces, right))))
}

fn under_ball(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let edge = (4.0 * PI / 4000.0).sqrt() as f32;
    let piece = |d: Vec3| tile(d, d, d.any_orthonormal_vector(), [edge; 2], 0.0);
    let surfels = sphere_directions(4000).map(piece).collect();
    let receivers = [1.3, 2.0, 5.0].map(|d| CaseReceiver::diffuse(DVec3::NEG_Y * d, Vec3::Y));
    let found = engine.shade(&CaseScene::new(surfels, receivers.to_vec()))?;
    let right = receivers.iter().map(|r| 1.0 - r.position.length_squared().recip());
    Ok(largest_error(found.iter().map(|f| f.open).zip(right)))
}

fn pickets(engine: &mut dyn Engine, solid_angle_sr: Option<f32>) -> Result<f64, Refusal> {
    let middle = |i: i32| (i as f32 + 0.5) * 0.02 - 0.5;
    let slat = |i: i32| {
        let middle = Vec3::new(middle(i), 0.5, 0.0);
        sheet(middle, Vec3::NEG_Y, Vec3::Z, [0.5, 0.005], [100, 1], 0.0)
    };
    let surfels = (0..50).flat_map(slat).collect();
    let places = [DVec3::ZERO, DVec3::new(0.27, 0.0, 0.11), DVec3::new(-0.41, 0.1, 0.4)];
    let receivers = places.map(|place| CaseReceiver::diffuse(place, Vec3::Y)).to_vec();
    let scene = CaseScene { solid_angle_sr, ..CaseScene::new(surfels, receivers) };
    let found = engine.shade(&scene)?;
    let hidden = |place: DVec3| -> f64 {
        let slat = |i: i32| {
            let middle = DVec3::new(f64::from(middle(i)), 0.5, 0.0);
            polygon_share(&rectangle(middle, DVec3::X * 0.005, DVec3::Z * 0.5), place, DVec3::Y)
        };
        (0..50).map(slat).sum()
    };
    Ok(largest_error(found.iter().zip(places).map(|(f, place)| (f.open, 1.0 - hidden(place)))))
}

fn flat_room(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let half = Vec3::new(50.0, 0.05, 50.0);
    let room = closed_room(half, 200, 1.0, SurfelForm::Rectangles);
    let mut worst = 0.0;
    let places = [DVec3::ZERO, DVec3::new(33.3, -0.02, 17.1), DVec3::new(-49.0, 0.03, 48.0)];
    let normals = [Vec3::Y, Vec3::X, Vec3::ONE];
    let at = |place| normals.map(|normal| CaseReceiver::diffuse(place, normal));
    let receivers = places.into_iter().flat_map(at).collect();
    for found in engine.shade(&CaseScene::new(room, receivers))? {
        worst = worse(worst, (found.surfaces / PI - 1.0).abs());
    }
    Ok(worst)
}
