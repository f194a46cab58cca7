//! The engine's side: bakes, gathers, settings from coarse to fine.

use crate::cases::{Case, Light};
use crate::paths::SECONDS_MIN;
use crate::workers::spread;
use anyhow::Result;
use pbgi_benches::{ThreadTimer, bake, bake_settings, light_up};
use pbgi_cloud::Surfel;
use pbgi_gather::{
    GatherParts, GatherSettings, Gatherer, PreparedLight, Receiver, Shading, lobe_directions,
};
use pbgi_light::{Environment, EnvironmentOptions};
use pbgi_store::Octree;
use std::path::Path;

/// Quality of a run of the engine.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Surfels over those of the default.
    pub density: f64,
    pub solid_angle_sr: f32,
    pub raster_edge: usize,
    pub lobe_level: u32,
}

const fn setting(
    density: f64,
    solid_angle_sr: f32,
    raster_edge: usize,
    lobe_level: u32,
) -> Setting {
    Setting { density, solid_angle_sr, raster_edge, lobe_level }
}

/// Settings beside the default, from coarse to fine; those of one density follow each other.
pub const LADDER: [Setting; 8] = [
    setting(0.1, 0.3, 4, 1),
    setting(1.0, 0.2, 6, 2),
    setting(1.0, 0.08, 8, 3),
    setting(1.0, 0.01, 16, 4),
    setting(4.0, 0.2, 8, 2),
    setting(4.0, 0.08, 8, 2),
    setting(4.0, 0.02, 16, 3),
    setting(4.0, 0.008, 24, 5),
];

impl Default for Setting {
    fn default() -> Self {
        let plain = GatherSettings::default();
        setting(1.0, plain.solid_angle_sr, plain.raster_edge, plain.lobe_level)
    }
}

impl Setting {
    pub fn gather(&self, case: &Case) -> GatherSettings {
        let parts = if case.gloss.is_some() { GatherParts::Sharp } else { GatherParts::All };
        GatherSettings {
            solid_angle_sr: self.solid_angle_sr,
            raster_edge: self.raster_edge,
            lobe_level: self.lobe_level,
            parts,
            ..GatherSettings::default()
        }
    }

    /// The light of a case's sky.
    ///
    /// # Errors
    ///
    /// If it is no environment.
    pub fn light(&self, case: &Case) -> Result<Option<PreparedLight>> {
        let Some(image) = case.sky.clone() else { return Ok(None) };
        let environment = Environment::from_image(image, EnvironmentOptions::default())?;
        Ok(Some(PreparedLight::new(&environment, self.raster_edge)))
    }

    /// What tells it from others.
    pub fn label(&self, case: &Case) -> String {
        format!("surfels x {}, {}", self.density, self.quality(case))
    }

    /// The same of settings of one density.
    pub fn quality(&self, case: &Case) -> String {
        let sharpness = match case.gloss {
            Some(_) => format!("{} directions", lobe_directions(self.lobe_level)),
            None => format!("raster {}", self.raster_edge),
        };
        format!("{} sr, {sharpness}", self.solid_angle_sr)
    }
}

/// Bakes the surfels of a scene with light that bounces among them.
///
/// # Errors
///
/// If a step fails.
pub fn bake_case(case: &Case, surfels: &[Surfel], path: &Path) -> Result<Octree> {
    let mut octree = bake(surfels, path)?;
    if case.bounces == 0 {
        return Ok(octree);
    }
    let settings = bake_settings();
    let light = Setting { raster_edge: settings.raster_edge, ..Setting::default() }.light(case)?;
    for _ in 0..case.bounces {
        octree = bake(&light_up(&octree, light.as_ref(), surfels, &settings)?, path)?;
    }
    Ok(octree)
}

/// What receivers get, and the core-microseconds each takes.
///
/// # Errors
///
/// If the octree cannot be read.
pub fn gather_all(
    case: &Case,
    octree: &Octree,
    setting: &Setting,
    places: &[(usize, Receiver)],
) -> Result<(Vec<Light>, f64)> {
    let settings = setting.gather(case);
    let light = setting.light(case)?;
    let some = |places: &[(usize, Receiver)]| -> Result<(Vec<Light>, f64)> {
        let mut gatherer = Gatherer::new(octree.reader(), &settings, light.as_ref());
        // The first receiver pays for pages and tables.
        places.first().map(|(_, receiver)| gatherer.gather(receiver)).transpose()?;
        let (timer, mut rounds) = (ThreadTimer::start(), 0.0);
        loop {
            let found = places.iter().map(|(_, r)| Ok(light_of(&gatherer.gather(r)?)));
            let found = found.collect::<Result<Vec<Light>>>()?;
            rounds += 1.0;
            let seconds = timer.seconds();
            if seconds >= SECONDS_MIN || places.is_empty() {
                return Ok((found, seconds / rounds));
            }
        }
    };
    let (mut all, mut seconds) = (Vec::with_capacity(places.len()), 0.0);
    for part in spread(places, some) {
        let (found, took) = part?;
        all.extend(found);
        seconds += took;
    }
    Ok((all, seconds * 1e6 / places.len().max(1) as f64))
}

/// What of a result is compared.
pub fn light_of(shading: &Shading) -> Light {
    Light {
        openness: shading.ambient_occlusion,
        irradiance: shading.irradiance(),
        reflected: shading.reflected,
    }
}
