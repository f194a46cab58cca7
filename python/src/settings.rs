//! Settings as they come from Python, where every one is given.

use pbgi::figures;
use pbgi::{
    BakeRequest, EnvironmentPlacement, EnvironmentSpec, GlossSettings, LightRequest, LightSource,
    PbgiError, Sampling, ShadeSettings, UpAxis, check_memory_limit, resident_bytes, thread_count,
};
use pyo3::prelude::*;
use std::path::PathBuf;

/// Distant light.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Light {
    path: Option<PathBuf>,
    color: Option<[f32; 3]>,
    placement: String,
    rotate: f32,
    scale: f32,
}

impl Light {
    /// The environment asked for.
    pub fn spec(self) -> Result<Option<EnvironmentSpec>, PbgiError> {
        let Some(placement) = EnvironmentPlacement::from_name(&self.placement) else {
            return Err(PbgiError::usage(format!(
                "env_placement is `{}`, expected openexr, mitsuba, blender or three",
                self.placement
            )));
        };
        let file = self.path.map(LightSource::File);
        let Some(source) = file.or(self.color.map(LightSource::Uniform)) else { return Ok(None) };
        let rotate_degrees = placement.rotate_degrees() + self.rotate;
        Ok(Some(EnvironmentSpec { source, rotate_degrees, scale: self.scale }))
    }
}

/// What to bake, and how.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct BakeSettings {
    inputs: Vec<String>,
    output: PathBuf,
    surfels: Option<String>,
    spacing: Option<f32>,
    memory_limit: String,
    threads: usize,
    env: Light,
    bounces: u32,
    bounce_share: usize,
    up: Option<String>,
    temp_dir: Option<PathBuf>,
    force: bool,
}

impl BakeSettings {
    /// The request of the engine.
    pub fn request(self) -> Result<BakeRequest, PbgiError> {
        let sampling = match (&self.surfels, self.spacing) {
            (Some(_), Some(_)) => {
                return Err(PbgiError::usage(
                    "surfels and spacing exclude each other; leave one of them out",
                ));
            }
            (Some(count), None) => {
                Sampling::Surfels(figures::parse_count(count).map_err(PbgiError::usage)?)
            }
            (None, Some(spacing)) => Sampling::Spacing(spacing),
            (None, None) => Sampling::default(),
        };
        let up = match self.up.as_deref() {
            None => None,
            Some("y") => Some(UpAxis::Y),
            Some("z") => Some(UpAxis::Z),
            Some(other) => {
                return Err(PbgiError::usage(format!("up is `{other}`, expected `y` or `z`")));
            }
        };
        let memory_limit = parse_bytes(&self.memory_limit)?;
        Ok(BakeRequest {
            inputs: self.inputs,
            output: self.output,
            force: self.force,
            sampling,
            up,
            light: LightRequest {
                environment: self.env.spec()?,
                bounces: self.bounces,
                share: self.bounce_share,
                ..LightRequest::default()
            },
            temp_dir: self.temp_dir,
            threads: thread_count(self.threads, memory_limit),
            memory_limit,
            ..BakeRequest::default()
        })
    }
}

/// How to shade.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Shading {
    env: Light,
    solid_angle: Option<f32>,
    target_error: Option<f64>,
    interpolation: Option<f32>,
    raster: Option<usize>,
    directions: Option<usize>,
    check: usize,
    gloss: bool,
    roughness: Option<f32>,
    metalness: Option<f32>,
    specular: Option<f32>,
    memory_limit: String,
    threads: usize,
}

impl Shading {
    /// The settings of the engine.
    pub fn settings(self) -> Result<ShadeSettings, PbgiError> {
        let Self { roughness, metalness, specular, .. } = self;
        let numbers = GlossSettings { roughness, metalness, specular };
        let is_glossy = self.gloss || numbers != GlossSettings::default();
        let memory_bytes = parse_bytes(&self.memory_limit)?;
        let own = ShadeSettings::default();
        Ok(ShadeSettings {
            environment: self.env.spec()?,
            solid_angle_sr: self.solid_angle.unwrap_or(own.solid_angle_sr),
            target_error: self.target_error,
            interpolation: self
                .interpolation
                .unwrap_or_else(|| ShadeSettings::usual_interpolation(self.target_error)),
            raster_edge: self.raster.unwrap_or(own.raster_edge),
            directions: self.directions.unwrap_or(own.directions),
            check_receivers: self.check,
            gloss: is_glossy.then_some(numbers),
            threads: thread_count(self.threads, memory_bytes),
            memory_bytes,
            ..own
        })
    }
}

/// A limit for the process: so many bytes beside what the process holds already, arrays of the caller among them.
pub fn parse_bytes(text: &str) -> Result<u64, PbgiError> {
    let bytes = figures::parse_bytes(text).map_err(PbgiError::usage)?;
    check_memory_limit(bytes)?;
    Ok(bytes.saturating_add(resident_bytes().unwrap_or(0)))
}
