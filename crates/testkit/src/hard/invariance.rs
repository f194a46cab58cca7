//! What changes nothing must change nothing.

use super::scale::difference;
use super::shapes::{Chance, crowd, sheet};
use super::{CaseCloud, CaseReceiver, CaseScene, CaseSky, Engine, HardCase, Refusal};
use pbgi_cloud::Surfel;
use pbgi_math::{DVec3, Vec3};

/// Why another order of axes is worth 1 %.
const AXES: &str = "the cube raster, stencils and the octree are the same along each axis but for the places of samples in a texel: outlines of \
    0.008 of the hemisphere, of radiance 2 at most, over a largest irradiance of 1.9: 0.008 · 2 π/1.9 = 0.026; light within 2⁻⁹";

pub(super) const CASES: [HardCase; 10] = [
    HardCase {
        name: "permuted-input",
        about: "a crowd in another order; results of the crowd, largest difference over the largest result",
        promise: 0.0,
        why: "surfels are sorted by their place; no two of the crowd are at one",
        limit: None,
        measure: permuted,
    },
    HardCase {
        name: "permuted-receivers",
        about: "receivers of a crowd in another order",
        promise: 0.0,
        why: "receivers that share nothing do not know of each other",
        limit: None,
        measure: permuted_receivers,
    },
    HardCase {
        name: "doubled-radiance",
        about: "a crowd twice as bright; twice the irradiance from surfels, all else the same",
        promise: 0.0,
        why: "radiance is stored and summed relative to its scale, a power of two",
        limit: None,
        measure: doubled,
    },
    HardCase {
        name: "halves",
        about: "each surfel of the crowd as two at its place with half its area; irradiance from surfels and openness of the whole ones",
        promise: 0.03,
        why: "areas sum to the same, and two alike at one place hide as one; outlines as for turned axes",
        limit: None,
        measure: halved,
    },
    HardCase {
        name: "side-by-side",
        about: "each tile of a ceiling as two side by side; openness and irradiance below of the whole ones",
        promise: 0.016,
        why: "both ceilings are the same rectangle: each is placed within 0.008 of the hemisphere",
        limit: None,
        measure: split_in_two,
    },
    HardCase {
        name: "axes-turned",
        about: "a crowd whose x, y, z become y, z, x; results of the crowd as it was",
        promise: 0.03,
        why: AXES,
        limit: None,
        measure: |engine| turned(engine, None, |v| Vec3::new(v.y, v.z, v.x)),
    },
    HardCase {
        name: "axes-swapped",
        about: "`axes-turned` where x and z change places, surfel by surfel",
        promise: 0.03,
        why: AXES,
        limit: None,
        measure: |engine| turned(engine, Some(0.0), |v| Vec3::new(v.z, v.y, v.x)),
    },
    HardCase {
        name: "mirrored",
        about: "`axes-turned` where x becomes −x, surfel by surfel",
        promise: 0.03,
        why: AXES,
        limit: None,
        measure: |engine| turned(engine, Some(0.0), |v| Vec3::new(-v.x, v.y, v.z)),
    },
    HardCase {
        name: "moved-a-little",
        about: "the crowd and its receivers moved by 0.37 of its edge; results of the crowd as it was",
        promise: 0.01,
        why: "the root's cube moves with the crowd, so that cells are the same but for what rounding by 2⁻²⁴ puts over their edges",
        limit: None,
        measure: moved,
    },
    HardCase {
        name: "sky-and-surfels-apart",
        about: "the crowd under a sky, and without; irradiance from surfels the same",
        promise: 0.0,
        why: "without importance of a sky, light from it and from surfels is summed apart",
        limit: None,
        measure: apart,
    },
];

/// Crowded places, and receivers among them.
fn scene() -> (Vec<Surfel>, Vec<CaseReceiver>) {
    let mut chance = Chance::new(17);
    let mut place = || CaseReceiver::diffuse(chance.place().as_dvec3(), chance.direction());
    (crowd(3000, 0.03, 23), (0..40).map(|_| place()).collect())
}

fn under_sky(surfels: Vec<Surfel>, receivers: Vec<CaseReceiver>) -> CaseScene {
    CaseScene::new(surfels, receivers).under(CaseSky::Uniform(1.0))
}

/// Another order of the same.
fn shuffle<T>(items: &mut [T]) {
    let mut chance = Chance::new(41);
    for i in (1..items.len()).rev() {
        let other = ((0.5 + 0.5 * chance.signed()) * (i + 1) as f32) as usize;
        items.swap(i, other.min(i));
    }
}

fn permuted(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (mut surfels, receivers) = scene();
    let right = engine.shade(&under_sky(surfels.clone(), receivers.clone()))?;
    shuffle(&mut surfels);
    Ok(difference(&engine.shade(&under_sky(surfels, receivers))?, &right, 1.0))
}

fn permuted_receivers(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (surfels, receivers) = scene();
    let mut right = engine.shade(&under_sky(surfels.clone(), receivers.clone()))?;
    let mut order: Vec<usize> = (0..receivers.len()).collect();
    shuffle(&mut order);
    let other = order.iter().map(|i| receivers[*i]).collect();
    let found = engine.shade(&under_sky(surfels, other))?;
    right = order.iter().map(|i| right[*i]).collect();
    Ok(difference(&found, &right, 1.0))
}

fn doubled(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (surfels, receivers) = scene();
    let right = engine.shade(&CaseScene::new(surfels.clone(), receivers.clone()))?;
    let double = |s: Surfel| s.with_radiance(s.radiance.map(|c| 2.0 * c));
    let bright = surfels.into_iter().map(double).collect();
    Ok(difference(&engine.shade(&CaseScene::new(bright, receivers))?, &right, 2.0))
}

fn halved(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (surfels, receivers) = scene();
    let right = engine.shade(&under_sky(surfels.clone(), receivers.clone()))?;
    let half = |s: Surfel| [Surfel { area: 0.5 * s.area, ..s }; 2];
    let halves = surfels.into_iter().flat_map(half).collect();
    Ok(difference(&engine.shade(&under_sky(halves, receivers))?, &right, 1.0))
}

/// A ceiling of edge 1, of tiles or of halves of them.
fn split_in_two(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let ceiling = |counts: [usize; 2]| {
        let tiles = sheet(Vec3::Y * 0.4, Vec3::NEG_Y, Vec3::X, [0.5; 2], counts, 1.0);
        let places = [DVec3::ZERO, DVec3::new(0.31, 0.0, 0.1), DVec3::new(-0.47, 0.1, 0.23)];
        let receivers = places.map(|place| CaseReceiver::diffuse(place, Vec3::Y));
        CaseScene::new(tiles.collect(), receivers.to_vec())
    };
    let right = engine.shade(&ceiling([16, 16]))?;
    Ok(difference(&engine.shade(&ceiling([32, 16]))?, &right, 1.0))
}

fn turned(
    engine: &mut dyn Engine,
    solid_angle_sr: Option<f32>,
    turn: impl Fn(Vec3) -> Vec3,
) -> Result<f64, Refusal> {
    let (surfels, receivers) = scene();
    let plain = under_sky(surfels.clone(), receivers.clone());
    let right = engine.shade(&CaseScene { solid_angle_sr, ..plain })?;
    let other = |s: Surfel| {
        let other = Surfel::new(turn(s.center()), turn(s.normal()), s.radius, s.area);
        other.with_radiance(s.radiance)
    };
    let surfels = surfels.into_iter().map(other).collect();
    let other = |r: CaseReceiver| {
        CaseReceiver::diffuse(turn(r.position.as_vec3()).as_dvec3(), turn(r.normal))
    };
    let receivers = receivers.into_iter().map(other).collect();
    let other = CaseScene { solid_angle_sr, ..under_sky(surfels, receivers) };
    Ok(difference(&engine.shade(&other)?, &right, 1.0))
}

fn moved(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (surfels, receivers) = scene();
    let right = engine.shade(&under_sky(surfels.clone(), receivers.clone()))?;
    let by = Vec3::new(0.74, -0.74, 0.74);
    let other = |s: Surfel| Surfel { position: (s.center() + by).to_array(), ..s };
    let surfels = surfels.into_iter().map(other).collect();
    let other = |r: CaseReceiver| CaseReceiver { position: r.position + by.as_dvec3(), ..r };
    let receivers = receivers.into_iter().map(other).collect();
    Ok(difference(&engine.shade(&under_sky(surfels, receivers))?, &right, 1.0))
}

fn apart(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let (surfels, receivers) = scene();
    let cloud = CaseCloud::Surfels { origin: DVec3::ZERO, surfels };
    let sky = CaseSky::Uniform(1.0);
    let lit = CaseScene { cloud, receivers, sky, solid_angle_sr: Some(0.0) };
    let mut found = engine.shade(&lit)?;
    let right = engine.shade(&lit.under(CaseSky::Black))?;
    // The sky's own light is not compared.
    found.iter_mut().for_each(|f| f.sky = 0.0);
    Ok(difference(&found, &right, 1.0))
}
