//! Light on the surfels themselves: an environment, and bounces between surfaces.
//!
//! A pass streams the sorted surfels, gathers light at each of them from the octree of the pass
//! before, and hands them on with radiance *L* = emission + albedo/π · *E*. Surfels are shaded in the
//! order of the file; threads, memory and cache never change the result.

use crate::PbgiError;
use crate::progress::Phase;
use crate::shade::{CHUNK_RECEIVERS, EnvironmentSpec, LoadedEnvironment};
use pbgi_bounce::{Shared, SurfelLight, cell_len, light_on_surfels};
use pbgi_build::{Piece, PieceSource, PieceTask, SortedStream, StreamError};
use pbgi_cloud::Surfel;
use pbgi_gather::{GatherSettings, PreparedLight};
use pbgi_math::{MortonCode, Vec3};
use pbgi_schedule::ShadeOptions;
use pbgi_sort::{SortedPiece, SortedSurfels};
use pbgi_store::Octree;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

/// Light to be stored in the surfels.
#[derive(Clone, Debug, PartialEq)]
pub struct LightRequest {
    /// Distant light that falls on the surfels.
    pub environment: Option<EnvironmentSpec>,
    /// How often light passes from surfel to surfel, 0 to [`BOUNCES_MAX`].
    pub bounces: u32,
    /// Largest solid angle of a node taken as one, in steradians.
    pub solid_angle_sr: f32,
    /// Texels along a face of the cube raster, 1 to 64.
    pub raster_edge: usize,
    /// Most neighbors on one surface that share a gather, 1 to 256; 1 gathers for every surfel.
    pub share: usize,
}

/// Most bounces: light that passed between surfaces that often is not seen.
pub const BOUNCES_MAX: u32 = 64;

impl Default for LightRequest {
    fn default() -> Self {
        Self { environment: None, bounces: 0, solid_angle_sr: 0.2, raster_edge: 6, share: 1 }
    }
}

impl LightRequest {
    /// Whether surfels are to be lit at all.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.environment.is_some() || self.bounces > 0
    }

    /// Refuses values out of range.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`], naming the option and its range.
    pub fn check(&self) -> Result<(), PbgiError> {
        if self.bounces > BOUNCES_MAX {
            return Err(PbgiError::usage(format!(
                "--bounces {} is out of range; expected 0 to {BOUNCES_MAX}",
                self.bounces
            )));
        }
        if !(0.0..=4.0 * PI).contains(&self.solid_angle_sr) {
            return Err(PbgiError::usage(format!(
                "--bounce-solid-angle {} is out of range; expected 0 to 12.566 steradians",
                self.solid_angle_sr
            )));
        }
        if !(1..=256).contains(&self.share) {
            return Err(PbgiError::usage(format!(
                "--bounce-share {} is out of range; expected 1 to 256 surfels",
                self.share
            )));
        }
        if !(1..=64).contains(&self.raster_edge) {
            return Err(PbgiError::usage(format!(
                "--bounce-raster {} is out of range; expected 1 to 64 texels",
                self.raster_edge
            )));
        }
        Ok(())
    }
}

/// Directions among which the largest irradiance of an environment is sought.
const BOUND_DIRECTIONS: usize = 200;

/// Irradiance varies slowly: no direction exceeds the best of 200 by more than this, and the gather,
/// which resolves the environment only coarsely, does not exceed the truth by more.
const BOUND_MARGIN: f32 = 1.05 * 1.5;

/// What the gather needs of the environment, and bounds.
pub(crate) struct Light {
    pub settings: GatherSettings,
    environment: Option<PreparedLight>,
    /// No surfel receives more from the environment, W·m⁻².
    irradiance_max: f32,
    bounces: u32,
    /// Most surfels that share a gather.
    pub share: usize,
    /// What of the environment's file was left out or read differently.
    pub warnings: Vec<String>,
}

impl Light {
    /// Reads and prepares the environment; its full detail is dropped again.
    pub fn load(request: &LightRequest, z_up: bool, memory_limit: u64) -> Result<Self, PbgiError> {
        let up = if z_up { Vec3::Z } else { Vec3::Y };
        let settings = GatherSettings {
            solid_angle_sr: request.solid_angle_sr,
            raster_edge: request.raster_edge,
            up,
            ..GatherSettings::default()
        };
        let (bounces, share) = (request.bounces, request.share);
        let Some(spec) = &request.environment else {
            let warnings = Vec::new();
            let (environment, irradiance_max) = (None, 0.0);
            return Ok(Self { settings, environment, irradiance_max, bounces, share, warnings });
        };
        let LoadedEnvironment { environment, warnings } = spec.load(z_up, memory_limit)?;
        let irradiance_max = spread_directions(BOUND_DIRECTIONS)
            .flat_map(|direction| environment.irradiance(direction))
            .fold(0.0, f32::max);
        Ok(Self {
            settings,
            environment: Some(PreparedLight::new(&environment, request.raster_edge)),
            irradiance_max: irradiance_max * BOUND_MARGIN,
            bounces,
            share,
            warnings,
        })
    }

    pub fn has_environment(&self) -> bool {
        self.environment.is_some()
    }

    /// Passes over all surfels: one for the environment, one for each bounce.
    pub fn pass_count(&self) -> u32 {
        u32::from(self.has_environment()) + self.bounces
    }

    /// Most radiance a surfel can have after a pass over an octree whose surfels have at most
    /// `source_max`. A closed room of radiance *L* gives the irradiance π*L*.
    pub fn radiance_bound(&self, emission_max: f32, source_max: f32) -> f32 {
        let irradiance = self.irradiance_max + PI * source_max * BOUND_MARGIN;
        (emission_max + irradiance / PI).min(f32::MAX)
    }
}

/// `count` unit directions spread evenly over the sphere, on a spiral of golden angles.
fn spread_directions(count: usize) -> impl Iterator<Item = Vec3> {
    const GOLDEN_ANGLE: f32 = 2.399_963_2;
    (0..count).map(move |i| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (GOLDEN_ANGLE * i as f32).sin_cos();
        let radius = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(radius * cos, radius * sin, z)
    })
}

/// The sorted surfels as they are.
pub(crate) struct EmissionPieces<'a> {
    pub sorted: &'a mut SortedSurfels,
}

impl PieceSource for EmissionPieces<'_> {
    fn next_piece(&mut self) -> Result<Option<PieceTask>, StreamError> {
        let piece = self.sorted.next_piece().map_err(PbgiError::from)?;
        Ok(piece.map(|piece| -> PieceTask {
            Box::new(move || {
                let SortedPiece { codes, surfels, whole } = piece.sort();
                Piece { codes, surfels, whole }
            })
        }))
    }
}

/// The sorted surfels with the light they receive.
pub(crate) struct RelitStream<'a> {
    sorted: &'a mut SortedSurfels,
    pass: PassSettings<'a>,
    /// Sorted surfels read, yet to be shaded.
    ahead: Vec<(MortonCode, Surfel)>,
    is_read: bool,
    /// Code of the last surfel handed on.
    previous: Option<MortonCode>,
    done: u64,
    /// Gathers so far.
    pub gathers: u64,
    /// Largest radiance handed on so far.
    pub radiance_max: f32,
}

/// What a pass of light needs.
pub(crate) struct PassSettings<'a> {
    /// Surfels of the pass before, which block and shine.
    pub octree: &'a Octree,
    pub light: &'a Light,
    pub threads: usize,
    /// No radiance handed on exceeds this.
    pub radiance_bound: f32,
    pub phase: &'a Phase<'a>,
    pub cancel: &'a AtomicBool,
}

impl<'a> RelitStream<'a> {
    pub fn new(sorted: &'a mut SortedSurfels, pass: PassSettings<'a>) -> Self {
        Self {
            sorted,
            pass,
            ahead: Vec::new(),
            is_read: false,
            previous: None,
            done: 0,
            gathers: 0,
            radiance_max: 0.0,
        }
    }

    /// Divides the surfels read into cells that share, as far as none can reach beyond them.
    fn share(&mut self) -> Shared {
        let most = self.pass.light.share;
        let mut shared = Shared::default();
        loop {
            let rest = &self.ahead[shared.place.len()..];
            if rest.is_empty() || (rest.len() <= most && !self.is_read) {
                return shared;
            }
            let len = cell_len(rest, self.previous, most);
            self.previous = Some(rest[len - 1].0);
            shared.add_cell(&rest[..len], most);
        }
    }

    /// What falls on the chosen surfels.
    fn gather(&self, shared: &Shared) -> Result<Vec<SurfelLight>, PbgiError> {
        let Shared { chosen, place } = shared;
        let PassSettings { light, octree, .. } = self.pass;
        let surfel = |index: u32| &self.ahead[index as usize].1;
        let leaders: Vec<&Surfel> = chosen.iter().map(|&index| surfel(index)).collect();
        // Surfels done with each receiver, on average.
        let surfels = |done: u64| done * place.len() as u64 / chosen.len().max(1) as u64;
        let options = ShadeOptions {
            gather: light.settings,
            threads: self.pass.threads,
            cancel: self.pass.cancel,
            progress: &|done| self.pass.phase.set_done(self.done + surfels(done)),
            ..ShadeOptions::default()
        };
        let environment = light.environment.as_ref();
        let mut found = light_on_surfels(octree, environment, &leaders, &options)?;
        // Those that share with one that is buried may be seen.
        let ends = shared.ends(|group| found[group].is_buried);
        let members: Vec<&Surfel> = ends.iter().map(|&(_, index)| surfel(index)).collect();
        let again = ShadeOptions { progress: &|_| {}, ..options };
        let seen = light_on_surfels(octree, environment, &members, &again)?;
        for (&(group, _), light) in ends.iter().zip(seen).filter(|(_, light)| !light.is_buried) {
            found[group as usize] = light;
        }
        Ok(found)
    }
}

impl SortedStream for RelitStream<'_> {
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError> {
        while !self.is_read && self.ahead.len() < CHUNK_RECEIVERS {
            self.is_read = !self.sorted.read_chunk(&mut self.ahead).map_err(PbgiError::from)?;
        }
        let shared = self.share();
        let found = self.gather(&shared)?;
        for ((code, surfel), place) in self.ahead.drain(..shared.place.len()).zip(&shared.place) {
            let surfel = found[*place as usize].shine_on(&surfel, self.pass.radiance_bound);
            self.radiance_max = surfel.radiance.iter().fold(self.radiance_max, |m, &c| m.max(c));
            out.push((code, surfel));
        }
        self.done += shared.place.len() as u64;
        self.gathers += shared.chosen.len() as u64;
        self.pass.phase.set_done(self.done);
        Ok(!(self.is_read && self.ahead.is_empty()))
    }
}

/// Ends a long loop once the user asked to stop.
pub(crate) fn check_canceled(cancel: &AtomicBool) -> Result<(), PbgiError> {
    if cancel.load(Ordering::Relaxed) { Err(PbgiError::Interrupted) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::LightSource;

    fn uniform(rgb: [f32; 3]) -> LightRequest {
        let source = LightSource::Uniform(rgb);
        let spec = EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 };
        LightRequest { environment: Some(spec), ..LightRequest::default() }
    }

    #[test]
    fn bounds_hold_what_an_open_surfel_receives() {
        let light = Light::load(&uniform([1.0, 2.0, 0.5]), false, 1 << 30).unwrap();
        // Under a uniform sky of radiance 2 a white surfel has radiance 2.
        let bound = light.radiance_bound(0.0, 0.0);
        assert!((2.0..4.0).contains(&bound), "{bound}");
        let bound = light.radiance_bound(10.0, 5.0);
        assert!((17.0..25.0).contains(&bound), "{bound}");
    }

    #[test]
    fn directions_are_spread_over_the_sphere() {
        let mean = spread_directions(200).sum::<Vec3>() / 200.0;
        assert!(mean.length() < 0.01, "{mean}");
        assert!(spread_directions(200).all(|d| (d.length() - 1.0).abs() < 1e-5));
    }

    #[test]
    fn values_out_of_range_are_misuse() {
        let good = LightRequest::default();
        for bad in [
            LightRequest { bounces: 65, ..good.clone() },
            LightRequest { solid_angle_sr: f32::NAN, ..good.clone() },
            LightRequest { raster_edge: 0, ..good.clone() },
            LightRequest { share: 0, ..good.clone() },
        ] {
            assert_eq!(bad.check().unwrap_err().exit_code(), crate::EXIT_MISUSED);
        }
        good.check().unwrap();
    }
}
