//! Smooth and rough metals.

use super::shapes::{disk, sheet};
use super::{
    CaseGloss, CaseReceiver, CaseScene, CaseSky, Engine, HardCase, Refusal, largest_error,
    largest_relative,
};
use crate::scenes::{SurfelForm, closed_room};
use pbgi_math::{DVec3, Vec3};

/// Why a white furnace comes back.
const FURNACE: &str = "what single scattering loses is put back by the sum of the directions' own weights; 1024 sums in single precision leave 10⁻⁴";

pub(super) const CASES: [HardCase; 8] = [
    HardCase {
        name: "furnace-roughness-0",
        about: "a white metal of roughness 0 under a sky of 1, seen at cosines from 1 to 0.1; reflected radiance, 1",
        promise: 1e-3,
        why: FURNACE,
        limit: None,
        measure: |engine| furnace(engine, &[0.0], &[1.0, 0.7, 0.3, 0.1]),
    },
    HardCase {
        name: "furnace-roughness-half",
        about: "`furnace-roughness-0` of roughness 0.3, 0.5 and 0.7",
        promise: 1e-3,
        why: FURNACE,
        limit: None,
        measure: |engine| furnace(engine, &[0.3, 0.5, 0.7], &[1.0, 0.7, 0.3, 0.1]),
    },
    HardCase {
        name: "furnace-roughness-1",
        about: "`furnace-roughness-0` of roughness 1",
        promise: 1e-3,
        why: FURNACE,
        limit: None,
        measure: |engine| furnace(engine, &[1.0], &[1.0, 0.7, 0.3, 0.1]),
    },
    HardCase {
        name: "furnace-grazing",
        about: "roughness 0.3, 0.7 and 1 at cosines of 0.03, 0.01 and 0.002",
        promise: 1e-3,
        why: FURNACE,
        limit: None,
        measure: |engine| furnace(engine, &[0.3, 0.7, 1.0], &[0.03, 0.01, 0.002]),
    },
    HardCase {
        name: "mirror-grazing",
        about: "roughness 0 at cosines of 0.03, 0.01 and 0.002",
        promise: 1e-3,
        why: FURNACE,
        limit: None,
        measure: |engine| furnace(engine, &[0.0], &[0.03, 0.01, 0.002]),
    },
    HardCase {
        name: "mirror-lamp",
        about: "a mirror that shows a lamp of radiance 10⁴ across 11°, at cosines of 0.9 and 0.1; its radiance, relative",
        promise: 0.02,
        why: "all of a lobe of 0.05° lies on the lamp: only the furnace's error is left, and radiance within 2⁻⁹",
        limit: None,
        measure: mirrored_lamp,
    },
    HardCase {
        name: "mirror-beside-lamp",
        about: "`mirror-lamp` beside the lamp, where it shows a dark wall; over the lamp's radiance, 0",
        promise: 1e-3,
        why: "at 5° from the mirror direction a lobe of α = 0.0004 is (α/0.04)² = 10⁻⁴ of its peak over 1.6 sr·10⁻⁵ of it: 10⁻⁸ over the lamp",
        limit: None,
        measure: beside_lamp,
    },
    HardCase {
        name: "furnace-room",
        about: "a white metal of roughness 0.2, 0.6 and 1 in a closed room of radiance 1; reflected radiance, 1",
        promise: 0.03,
        why: "pieces of walls at the rim of a lobe shine by the reflectance in their middle, by the table of albedos within 0.5 %; 1024 directions \
            sum to the lobe within 1 %, and a lobe at the horizon ends in pieces",
        limit: None,
        measure: furnace_in_room,
    },
];

/// A white metal at the origin that faces up.
fn metal(roughness: f32, cosine: f32, turn: f32) -> CaseReceiver {
    let sine = (1.0 - f64::from(cosine).powi(2)).sqrt() as f32;
    let toward_eye = Vec3::new(sine * turn.cos(), cosine, sine * turn.sin()).normalize();
    let gloss = Some(CaseGloss { color: 1.0, roughness, toward_eye });
    CaseReceiver { gloss, ..CaseReceiver::diffuse(DVec3::ZERO, Vec3::Y) }
}

fn metals(roughness: &[f32], cosines: &[f32]) -> Vec<CaseReceiver> {
    let of = |r: &f32| {
        let r = *r;
        cosines.iter().enumerate().map(move |(i, c)| metal(r, *c, 0.7 + i as f32))
    };
    roughness.iter().flat_map(of).collect()
}

fn furnace(engine: &mut dyn Engine, roughness: &[f32], cosines: &[f32]) -> Result<f64, Refusal> {
    let crumb = vec![disk(Vec3::NEG_Y * 100.0, Vec3::Y, 1e-3, 0.0)];
    let scene = CaseScene::new(crumb, metals(roughness, cosines));
    let found = engine.shade(&scene.under(CaseSky::Uniform(1.0)))?;
    Ok(largest_error(found.iter().map(|f| (f.reflected, 1.0))))
}

fn furnace_in_room(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let room = closed_room(Vec3::new(2.0, 1.3, 1.7), 40, 1.0, SurfelForm::Rectangles);
    let receivers = metals(&[0.2, 0.6, 1.0], &[1.0, 0.5, 0.2]);
    let found = engine.shade(&CaseScene::new(room, receivers))?;
    Ok(largest_error(found.iter().map(|f| (f.reflected, 1.0))))
}

/// A lamp in the mirror direction of an eye at this cosine, turned away by an angle.
fn lamp(engine: &mut dyn Engine, cosine: f32, away: f32) -> Result<f64, Refusal> {
    let receiver = metal(0.0, cosine, 0.0);
    let height = cosine.asin() + away;
    let toward = Vec3::new(-height.cos(), height.sin(), 0.0);
    let lamp = sheet(toward, -toward, Vec3::Z, [0.1; 2], [8; 2], 1e4);
    let found = engine.shade(&CaseScene::new(lamp.collect(), vec![receiver]))?;
    Ok(found[0].reflected / 1e4)
}

fn mirrored_lamp(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let found = [lamp(engine, 0.9, 0.0)?, lamp(engine, 0.1, 0.01)?];
    Ok(largest_relative(found.map(|found| (found, 1.0))))
}

fn beside_lamp(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let found = [lamp(engine, 0.9, 0.25)?, lamp(engine, 0.1, 0.25)?];
    Ok(largest_error(found.map(|found| (found, 0.0))))
}
