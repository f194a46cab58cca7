//! What is neither open nor closed.

use super::shapes::Chance;
use super::{CaseReceiver, CaseScene, Engine, HardCase, KnownLimit, Refusal, largest_relative};
use pbgi_cloud::Surfel;
use pbgi_math::{DVec3, Vec3};
use std::f32::consts::PI;

/// Why a random crowd is open by the exponential of its depth, and how nearly.
const CROWD: &str = "disks of random place and direction hide as a medium (Beer and Lambert); that a million are not endlessly many is worth \
    √(τ/10⁶) < 0.2 %; 3 % is what the clusters' transmittance may cost";

pub(super) const CASES: [HardCase; 6] = [
    HardCase {
        name: "sparse-0.1",
        about: "a million random disks all around, of optical depth 0.1; openness, e^−0.1, relative",
        promise: 0.03,
        why: CROWD,
        limit: None,
        measure: |engine| crowd(engine, 0.1, None),
    },
    HardCase {
        name: "sparse-1",
        about: "`sparse-0.1` of optical depth 1",
        promise: 0.03,
        why: CROWD,
        limit: None,
        measure: |engine| crowd(engine, 1.0, None),
    },
    HardCase {
        name: "sparse-1-coarse",
        about: "`sparse-1` with nodes of 0.2 sr",
        promise: 0.03,
        why: CROWD,
        limit: None,
        measure: |engine| crowd(engine, 1.0, Some(0.2)),
    },
    HardCase {
        name: "sparse-1-fine",
        about: "`sparse-1` with nodes of 0.003 sr",
        promise: 0.03,
        why: CROWD,
        limit: None,
        measure: |engine| crowd(engine, 1.0, Some(0.003)),
    },
    HardCase {
        name: "sparse-3",
        about: "`sparse-0.1` of optical depth 3, at defaults",
        promise: 0.03,
        why: CROWD,
        limit: Some(KnownLimit {
            today: 0.1,
            because: "0.5 % of the whole, as 5 % are open: a tenth of the surfels have neighbors by chance, and a cluster of them hides as cloth does",
        }),
        measure: |engine| crowd(engine, 3.0, None),
    },
    HardCase {
        name: "smoke",
        about: "a million particles without normals, of optical depth 1; openness, e^−1, relative",
        promise: 0.03,
        why: CROWD,
        limit: None,
        measure: smoke,
    },
];

/// Disks of the crowd.
const COUNT: usize = 1_000_000;

/// The empty ball in the middle.
const HOLLOW: f32 = 0.05;

/// Places even over a ball of radius 1 without its middle, and the radius of disks that hide the area `PI r² / 2` on the mean and are of this depth.
fn places(depth: f32) -> (Vec<(Vec3, Vec3)>, f32) {
    let mut chance = Chance::new(11);
    let mut places = Vec::with_capacity(COUNT);
    while places.len() < COUNT {
        let place = chance.place();
        if (HOLLOW * HOLLOW..1.0).contains(&place.length_squared()) {
            places.push((place, chance.direction()));
        }
    }
    let density = COUNT as f32 / (4.0 / 3.0 * PI * (1.0 - HOLLOW.powi(3)));
    let shown = depth / (density * (1.0 - HOLLOW));
    (places, (2.0 * shown / PI).sqrt())
}

/// Receivers in the middle, facing six ways.
fn receivers() -> Vec<CaseReceiver> {
    let axes = Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]);
    axes.map(|normal| CaseReceiver::diffuse(DVec3::ZERO, normal)).collect()
}

fn crowd(engine: &mut dyn Engine, depth: f32, solid_angle_sr: Option<f32>) -> Result<f64, Refusal> {
    let (places, radius) = places(depth);
    let piece = |(place, normal)| Surfel::new(place, normal, radius, PI * radius * radius);
    let scene = CaseScene::new(places.into_iter().map(piece).collect(), receivers());
    mean_error(engine, &CaseScene { solid_angle_sr, ..scene }, depth)
}

/// Particles show half their area to every direction.
fn smoke(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (places, radius) = places(1.0);
    let piece = |(place, _)| {
        let surfel = Surfel::new(place, Vec3::Y, radius, PI * radius * radius);
        surfel.with_flags(pbgi_cloud::SurfelFlags::ISOTROPIC)
    };
    let scene = CaseScene::new(places.into_iter().map(piece).collect(), receivers());
    mean_error(engine, &scene, 1.0)
}

/// Error of the mean over the six: single ones see different halves of one crowd.
fn mean_error(engine: &mut dyn Engine, scene: &CaseScene, depth: f32) -> Result<f64, Refusal> {
    let found = engine.shade(scene)?;
    let mean = found.iter().map(|f| f.open).sum::<f64>() / found.len() as f64;
    Ok(largest_relative([(mean, f64::from(-depth).exp())]))
}
