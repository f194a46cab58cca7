//! Shading of receivers against an octree file: settings, light, the session that does the work,
//! and the report of what it did.

pub(crate) mod check;
pub(crate) mod nearness;
pub(crate) mod statistics;
pub(crate) mod target;

use crate::PbgiError;
use crate::budget::reading::read_within;
use crate::budget::split::{MemorySplit, node_bytes, worker_bytes};
use crate::figures::{format_bytes, format_count, format_seconds};
use crate::progress::Progress;
use crate::shade::check::{CheckReport, CheckSample, PartReport};
use crate::shade::statistics::{CacheReport, CutReport, LevelReport};
use crate::shade::target::{Calibration, TargetReport};
use pbgi_file::platform::{peak_resident_bytes, processor_seconds};
use pbgi_format::{Channels, Header};
use pbgi_gather::{
    GatherParts, GatherSettings, Gloss, ImportanceTerms, LOBE_LEVEL_MAX, Material, PreparedLight,
    Receiver, Shading, lobe_directions, lobe_level,
};
use pbgi_image::read_environment_noting_within;
use pbgi_light::{Environment, EnvironmentOptions, UpAxis};
use pbgi_math::Vec3;
use pbgi_schedule::{
    CHUNKS_IN_FLIGHT, Feed, KeptRecords, RECEIVER_BYTES_IN_FLIGHT, RECORD_BYTES, ShadeOptions,
    ShadeReport as ScheduleReport, Shaded, shade_receivers, shade_stream,
};
use pbgi_store::{Backend, Octree, OpenOptions};
use serde::Serialize;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Receivers handed to the workers at once.
pub(crate) const CHUNK_RECEIVERS: usize = 1 << 14;

/// Bytes of all chunks under way, where each receiver has `attached_bytes` beside it.
pub(crate) fn chunk_bytes(attached_bytes: usize, settings: &ShadeSettings) -> u64 {
    // What is read into the next chunk and written from the last is held besides those in flight.
    let each =
        CHUNKS_IN_FLIGHT * RECEIVER_BYTES_IN_FLIGHT + (CHUNKS_IN_FLIGHT + 2) * attached_bytes;
    CHUNK_RECEIVERS as u64 * (each as u64 + settings.record_bytes())
}

/// Where distant light comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum LightSource {
    /// An equirectangular EXR or Radiance HDR image.
    File(PathBuf),
    /// The same radiance from every direction, W·m⁻²·sr⁻¹.
    Uniform([f32; 3]),
}

/// Distant light, ready to be used.
#[derive(Clone, Debug)]
pub struct LoadedEnvironment {
    /// The light.
    pub environment: Environment,
    /// What of its file was left out or read differently, one sentence each.
    pub warnings: Vec<String>,
}

/// Where an environment image lies in the world, as other programs place it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EnvironmentPlacement {
    /// Middle along +Z, or -Y with +Z up; a quarter from the left edge is +X
    #[default]
    Openexr,
    /// As OpenEXR has it
    Mitsuba,
    /// Middle along +X; a quarter from the left edge is -Z, or +Y with +Z up
    Blender,
    /// As Blender has it
    Three,
}

impl EnvironmentPlacement {
    /// The rotation that places an image so, to be added to any other ([`EnvironmentSpec::rotate_degrees`]).
    #[must_use]
    pub fn rotate_degrees(self) -> f32 {
        match self {
            Self::Openexr | Self::Mitsuba => 0.0,
            Self::Blender | Self::Three => 90.0,
        }
    }

    /// The placement called `name`: `openexr`, `mitsuba`, `blender` or `three`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "openexr" => Some(Self::Openexr),
            "mitsuba" => Some(Self::Mitsuba),
            "blender" => Some(Self::Blender),
            "three" => Some(Self::Three),
            _ => None,
        }
    }
}

/// Distant light and how it is placed.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentSpec {
    /// The light.
    pub source: LightSource,
    /// Rotation about the up axis in degrees, counterclockwise seen from above.
    pub rotate_degrees: f32,
    /// Factor on its radiance.
    pub scale: f32,
}

impl std::fmt::Display for EnvironmentSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.source {
            LightSource::File(path) => {
                write!(f, "{}", Path::new(path.file_name().unwrap_or(path.as_os_str())).display())?;
            }
            LightSource::Uniform([r, g, b]) => write!(f, "uniform ({r}, {g}, {b})")?,
        }
        write!(f, " rotated by {} degrees, scaled by {}", self.rotate_degrees, self.scale)
    }
}

impl EnvironmentSpec {
    /// Light from the image `path`, as it is.
    #[must_use]
    pub fn from_file(path: impl Into<PathBuf>) -> Self {
        Self { source: LightSource::File(path.into()), rotate_degrees: 0.0, scale: 1.0 }
    }

    /// Reads and prepares the environment. `z_up` is the octree header's flag; an image that `memory_limit` does not hold is refused.
    ///
    /// # Errors
    ///
    /// If the image cannot be read, is not equirectangular, or has a negative or non-finite pixel; if a
    /// uniform color, the rotation or the scale is out of range.
    pub fn load(&self, z_up: bool, memory_limit: u64) -> Result<LoadedEnvironment, PbgiError> {
        match &self.source {
            LightSource::Uniform(rgb) => {
                let radiance = rgb.map(|c| c * self.scale);
                if radiance.iter().all(|c| c.is_finite() && *c >= 0.0) {
                    let environment = Environment::uniform(radiance);
                    return Ok(LoadedEnvironment { environment, warnings: Vec::new() });
                }
                Err(PbgiError::usage(format!(
                    "the environment's color is ({}, {}, {}), expected finite values of at least 0",
                    radiance[0], radiance[1], radiance[2]
                )))
            }
            LightSource::File(path) => {
                let read = read_within(memory_limit, |allowance| {
                    read_environment_noting_within(path, allowance)
                })?;
                let named = |warning| format!("{}: {warning}", path.display());
                let warnings = read.warnings.into_iter().map(named).collect();
                let options = EnvironmentOptions {
                    rotate_degrees: self.rotate_degrees,
                    scale: self.scale,
                    up: if z_up { UpAxis::Z } else { UpAxis::Y },
                    ..EnvironmentOptions::default()
                };
                let environment = Environment::from_image(read.image, options)
                    .map_err(|source| PbgiError::Environment { path: path.clone(), source })?;
                Ok(LoadedEnvironment { environment, warnings })
            }
        }
    }
}

/// Numbers of materials that are the same for all receivers, whatever their own are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GlossSettings {
    /// Perceptual roughness, 0..=1.
    pub roughness: Option<f32>,
    /// 0 for dielectrics, 1 for metals.
    pub metalness: Option<f32>,
    /// Strength of a dielectric's gloss, 0..=1.
    pub specular: Option<f32>,
}

impl GlossSettings {
    /// `own` with these numbers in place of its own.
    #[must_use]
    pub fn apply(&self, own: Material) -> Material {
        Material {
            base_color: own.base_color,
            metalness: self.metalness.unwrap_or(own.metalness),
            roughness: self.roughness.unwrap_or(own.roughness),
            specular: self.specular.unwrap_or(own.specular),
        }
    }

    fn check(&self) -> Result<(), PbgiError> {
        for (name, value) in [
            ("roughness", self.roughness),
            ("metalness", self.metalness),
            ("specular", self.specular),
        ] {
            if let Some(value) = value.filter(|v| !(0.0..=1.0).contains(v)) {
                return Err(PbgiError::usage(format!(
                    "--{name} is {value}, expected a number from 0 to 1"
                )));
            }
        }
        Ok(())
    }
}

/// Quality, light and resources of a shading run.
#[derive(Clone, Debug)]
pub struct ShadeSettings {
    /// Largest solid angle in steradians of a node that stands for its surfels; 0 takes every surfel.
    pub solid_angle_sr: f32,
    /// Relative root mean square error to choose the solid angle for, by measuring a sample of the receivers; `solid_angle_sr` then
    /// does not count.
    pub target_error: Option<f64>,
    /// Share of what a receiver gathers, but for peaks of the environment and gloss, that interpolating it between neighbors may be wrong by, 0..=1;
    /// 0 gathers for each receiver by itself.
    pub interpolation: f32,
    /// Which terms make the solid angle smaller or larger by direction.
    pub importance: ImportanceTerms,
    /// Texels along a face of the cube raster, 1 to 64.
    pub raster_edge: usize,
    /// Directions of a reflection: 16, 64, 256, 1024, 4096 or 16 384. More of them see smaller things, and what hides what among them.
    pub directions: usize,
    /// Glossy reflections, if any.
    pub gloss: Option<GlossSettings>,
    /// Surfels that rise less than this share of their radius above a receiver's tangent plane are its
    /// own surface.
    pub bias: f32,
    /// Distant light, if any.
    pub environment: Option<EnvironmentSpec>,
    /// Receivers to gather again exhaustively, to measure the error; 0 for none.
    pub check_receivers: usize,
    /// Worker threads, at least 1.
    pub threads: usize,
    /// Bytes the whole process may take.
    pub memory_bytes: u64,
    /// How the octree file is read.
    pub io: StoreSettings,
}

/// How an octree file is read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StoreSettings {
    /// By reads or from a map.
    pub backend: Backend,
    /// Whether to shade on without pages that are damaged: what lies in them counts as nothing.
    pub skip_damaged: bool,
    /// A file to record all requests for pages in.
    pub trace: Option<PathBuf>,
}

impl Default for ShadeSettings {
    fn default() -> Self {
        let gather = GatherSettings::default();
        Self {
            solid_angle_sr: gather.solid_angle_sr,
            target_error: None,
            interpolation: 0.0,
            importance: gather.importance,
            raster_edge: gather.raster_edge,
            directions: lobe_directions(gather.lobe_level),
            gloss: None,
            bias: gather.bias,
            environment: None,
            check_receivers: 0,
            threads: 1,
            memory_bytes: 1 << 30,
            io: StoreSettings::default(),
        }
    }
}

impl ShadeSettings {
    /// The `interpolation` that programs use where none is asked for: with a target for the error four times that, as what interpolation adds is about a
    /// tenth of it, but no more than a fifth. With two fifths a street of 960 × 540 gathers for 18 instead of 20 % of its receivers and misses things a pixel
    /// high: occlusion has 13 % of error from interpolation, not 1.8 %.
    #[must_use]
    pub fn usual_interpolation(target_error: Option<f64>) -> f32 {
        const USUAL: f32 = 0.1;
        const MOST: f32 = 0.2;
        target_error.map_or(USUAL, |target| (4.0 * target as f32).min(MOST))
    }

    /// Checks the ranges of all numbers.
    ///
    /// # Errors
    ///
    /// [`PbgiError`] of misuse, naming the setting.
    pub fn validate(&self) -> Result<(), PbgiError> {
        let out_of_range = |what: &str, found: &dyn std::fmt::Display, expected: &str| {
            Err(PbgiError::usage(format!("{what} is {found}, expected {expected}")))
        };
        if !(self.solid_angle_sr >= 0.0 && self.solid_angle_sr.is_finite()) {
            let expected = "steradians of at least 0, such as 0.03";
            return out_of_range("the solid angle", &self.solid_angle_sr, expected);
        }
        if !(0.0..=1.0).contains(&self.interpolation) {
            return out_of_range("the interpolation", &self.interpolation, "a share from 0 to 1");
        }
        if !(1..=64).contains(&self.raster_edge) {
            return out_of_range("the raster", &self.raster_edge, "1 to 64 texels along a face");
        }
        if let Err(expected) = lobe_level(self.directions) {
            return out_of_range("the number of directions", &self.directions, expected);
        }
        if !(0.0..=10.0).contains(&self.bias) {
            return out_of_range("the bias", &self.bias, "a share of a radius from 0 to 10");
        }
        if self.threads == 0 {
            return out_of_range("the number of threads", &0, "at least 1");
        }
        if let Some(target) = self.target_error.filter(|t| !(1e-4..=1.0).contains(t)) {
            return out_of_range("the target error", &target, "a share from 0.0001 to 1");
        }
        self.gloss.map_or(Ok(()), |gloss| gloss.check())
    }

    /// The distant light, read within the memory limit.
    pub(crate) fn load_environment(
        &self,
        header: &Header,
    ) -> Result<Option<LoadedEnvironment>, PbgiError> {
        let load = |spec: &EnvironmentSpec| spec.load(header.flags.z_up, self.memory_bytes);
        self.environment.as_ref().map(load).transpose()
    }

    /// Bytes of irradiance records per receiver of what is shaded as one.
    pub(crate) fn record_bytes(&self) -> u64 {
        if self.interpolation > 0.0 { RECORD_BYTES as u64 } else { 0 }
    }

    /// Bytes that a worker holds besides decoded nodes.
    pub(crate) fn worker_bytes(&self) -> u64 {
        worker_bytes(self.raster_edge, self.lobe_level())
    }

    fn lobe_level(&self) -> u32 {
        lobe_level(self.directions).unwrap_or(LOBE_LEVEL_MAX)
    }

    fn gather(&self, header: &Header) -> GatherSettings {
        GatherSettings {
            solid_angle_sr: self.solid_angle_sr,
            importance: self.importance,
            raster_edge: self.raster_edge,
            lobe_level: self.lobe_level(),
            bias: self.bias,
            node_bytes: node_bytes(self.memory_bytes, self.threads),
            up: up_axis(header),
            tolerance: self.interpolation,
            ..GatherSettings::default()
        }
    }
}

/// The direction of the sky in a file.
pub(crate) fn up_axis(header: &Header) -> Vec3 {
    if header.flags.z_up { Vec3::Z } else { Vec3::Y }
}

/// Reads the header of a file.
pub(crate) fn read_header(path: &Path) -> Result<Header, PbgiError> {
    Ok(Octree::read_header(path)?)
}

/// An open octree under its light, and counts of what has been shaded.
pub(crate) struct Session<'a> {
    pub octree: Arc<Octree>,
    pub environment: Option<Environment>,
    light: Option<PreparedLight>,
    gather: GatherSettings,
    gloss: Option<GlossSettings>,
    threads: usize,
    cancel: &'a AtomicBool,
    sample: CheckSample,
    target_error: Option<f64>,
    /// The file that requests for pages are recorded in.
    trace: Option<PathBuf>,
    target: Option<TargetReport>,
    done: ScheduleReport,
    /// Records of what was shaded last.
    records: KeptRecords,
    memory: MemorySplit,
    /// What the process had used of processors when the session began, and what it has used to shade.
    processor_start: Option<f64>,
    processor_shade: f64,
    /// What the user should know of, one sentence each.
    pub warnings: Vec<String>,
}

/// Processor seconds this process has used since it had used `before`, where the system tells.
fn seconds_since(before: Option<f64>) -> Option<f64> {
    Some(processor_seconds()? - before?)
}

impl<'a> Session<'a> {
    /// Opens `path` with the cache that `memory` grants; besides the workers there may be
    /// `extra_readers`.
    pub fn open(
        path: &Path,
        settings: &ShadeSettings,
        environment: Option<LoadedEnvironment>,
        memory: MemorySplit,
        extra_readers: usize,
        cancel: &'a AtomicBool,
    ) -> Result<Self, PbgiError> {
        let (environment, warnings) =
            environment.map(|loaded| (loaded.environment, loaded.warnings)).unzip();
        let mut warnings: Vec<String> = warnings.unwrap_or_default();
        let options = OpenOptions {
            cache_bytes: memory.cache_bytes,
            readers: settings.threads + extra_readers,
            backend: settings.io.backend,
            skip_damaged: settings.io.skip_damaged,
        };
        let mut octree = Octree::open(path, &options)?;
        if let Some(trace) = &settings.io.trace {
            let recorded = octree.record_trace(trace);
            recorded.map_err(|source| PbgiError::output(trace, "create", source))?;
        }
        let octree = Arc::new(octree);
        let prepare = match settings.gloss {
            Some(_) => PreparedLight::for_reflections,
            None => PreparedLight::new,
        };
        let light = environment.as_ref().map(|e| prepare(e, settings.raster_edge));
        if light.is_none() && octree.header().channels == Channels::Occlusion {
            warnings.push(
                "there is no light: the file stores none and no environment is given; AO, sky \
                 visibility and bent normals are written, irradiance is 0 (add --env or --env-color)"
                    .to_owned(),
            );
        }
        Ok(Self {
            gather: settings.gather(octree.header()),
            gloss: settings.gloss,
            octree,
            environment,
            light,
            threads: settings.threads,
            cancel,
            sample: CheckSample::new(settings.check_receivers),
            target_error: settings.target_error,
            trace: settings.io.trace.clone(),
            target: None,
            done: ScheduleReport::default(),
            records: KeptRecords::default(),
            memory,
            processor_start: processor_seconds(),
            processor_shade: 0.0,
            warnings,
        })
    }

    /// Whether anything shines.
    pub fn is_lit(&self) -> bool {
        self.light.is_some() || self.octree.header().channels != Channels::Occlusion
    }

    /// What a receiver at `position` reflects toward `eye`, if anything reflects glossily; both in the same coordinates.
    pub fn gloss(&self, material: Material, position: Vec3, eye: Vec3) -> Option<Gloss> {
        gloss_toward(self.gloss, material, position, eye)
    }

    /// The direction of the sky.
    pub fn up(&self) -> Vec3 {
        self.gather.up
    }

    /// Whether a sample of receivers is wanted before shading starts, for [`Self::calibrate`].
    pub fn wants_calibration(&self) -> bool {
        self.target_error.is_some()
    }

    /// Chooses the solid angle for the error that was asked for, by measuring some receivers.
    pub fn calibrate(
        &mut self,
        receivers: &[Receiver],
        progress: &Progress,
    ) -> Result<(), PbgiError> {
        let Some(target) = self.target_error else { return Ok(()) };
        let calibration = Calibration {
            octree: &self.octree,
            light: self.light.as_ref(),
            gather: self.gather,
            threads: self.threads,
            cancel: self.cancel,
        };
        let report = calibration.choose(target, receivers, progress)?;
        self.gather.solid_angle_sr = report.solid_angle_sr;
        self.target = Some(report);
        Ok(())
    }

    /// Shades `receivers`, positions relative to the octree's origin; `advance` is told how many have
    /// been done in this call. `ids` tell receivers apart whatever the order they come in; without
    /// them, that order counts.
    pub fn shade(
        &mut self,
        receivers: &[Receiver],
        ids: Option<&[u64]>,
        advance: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Shading>, PbgiError> {
        let shadings = self.gather(receivers, GatherParts::All, advance)?;
        self.count(receivers, ids, &shadings);
        Ok(shadings)
    }

    /// Counts receivers as shaded and offers them to the check. `ids` as for [`Self::shade`].
    pub fn count(&mut self, receivers: &[Receiver], ids: Option<&[u64]>, shadings: &[Shading]) {
        self.sample.offer_all(receivers, ids, shadings);
    }

    /// Gathers some of the light for `receivers`, not counting them as shaded.
    pub fn gather(
        &mut self,
        receivers: &[Receiver],
        parts: GatherParts,
        advance: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Shading>, PbgiError> {
        let options = self.options(parts, advance);
        let mut shadings = Vec::with_capacity(receivers.len());
        let mut records = std::mem::take(&mut self.records);
        // What shares records is shaded as one.
        let chunk = if self.gather.tolerance > 0.0 { receivers.len() } else { CHUNK_RECEIVERS };
        let before = processor_seconds();
        let report = shade_stream(
            &self.octree,
            self.light.as_ref(),
            &options,
            &mut records,
            |feed: &mut Feed<'_, '_, (), PbgiError>| {
                let mut chunks = receivers.chunks(chunk.max(1));
                chunks.try_for_each(|chunk| feed.push(Cow::Borrowed(chunk), ()))
            },
            |chunk| {
                check_finite(chunk.receivers, &chunk.shadings)?;
                shadings.extend(chunk.shadings);
                Ok(())
            },
        )?;
        self.records = records;
        self.note(&report, before);
        Ok(shadings)
    }

    /// Adds what was done since the process had used so many processor seconds.
    fn note(&mut self, report: &ScheduleReport, before: Option<f64>) {
        self.done.add(report);
        self.processor_shade += seconds_since(before).unwrap_or(0.0);
    }

    /// Shades receivers chunk by chunk as `fill` pushes them and hands them to `take` with their results, in the order of pushing, which
    /// also tells them apart. `advance` is told how many are done.
    pub fn stream<T>(
        &mut self,
        advance: &(dyn Fn(u64) + Sync),
        fill: impl FnOnce(&mut Feed<'_, 'static, T, PbgiError>) -> Result<(), PbgiError>,
        mut take: impl FnMut(Shaded<'_, T>) -> Result<(), PbgiError>,
    ) -> Result<(), PbgiError> {
        let options = self.options(GatherParts::All, advance);
        let Self { octree, light, sample, .. } = self;
        let mut records = std::mem::take(&mut self.records);
        let take = |chunk: Shaded<'_, T>| {
            check_finite(chunk.receivers, &chunk.shadings)?;
            sample.offer_all(chunk.receivers, None, &chunk.shadings);
            take(chunk)
        };
        let before = processor_seconds();
        let report = shade_stream(octree, light.as_ref(), &options, &mut records, fill, take)?;
        self.note(&report, before);
        Ok(())
    }

    fn options<'o>(
        &self,
        parts: GatherParts,
        progress: &'o (dyn Fn(u64) + Sync),
    ) -> ShadeOptions<'o>
    where
        'a: 'o,
    {
        let gather = GatherSettings { parts, ..self.gather };
        let (threads, cancel) = (self.threads, self.cancel);
        ShadeOptions { gather, threads, cancel, progress, ..ShadeOptions::default() }
    }

    /// Measures the error, if asked to, and closes the file.
    pub fn finish(mut self, progress: &Progress) -> Result<ShadeReport, PbgiError> {
        let cache = CacheReport::new(&self.octree.stats(), self.octree.pages().len() as u64);
        let receivers = self.sample.offered;
        let sample = std::mem::take(&mut self.sample).into_sorted();
        let check = if sample.is_empty() { None } else { self.check(&sample, progress)? };
        if let Some(trace) = &self.trace {
            let written = self.octree.finish_trace();
            written.map_err(|source| PbgiError::output(trace, "write", source))?;
        }
        let damaged_pages = self.damaged_pages();
        let ScheduleReport { cut, cut_sizes, seconds, .. } = self.done;
        Ok(ShadeReport {
            receivers,
            shade_seconds: seconds,
            shade_processor_seconds: self.processor_start.map(|_| self.processor_shade),
            receivers_per_second: receivers as f64 / seconds.max(1e-9),
            cut_mean: cut_sizes.mean(),
            nodes_visited_mean: cut.nodes_visited as f64 / cut_sizes.count.max(1) as f64,
            cuts: CutReport::new(&self.done),
            levels: LevelReport::all(&cut.levels),
            cache,
            memory: self.memory,
            memory_peak_bytes: peak_resident_bytes(),
            check,
            empty_pixels: 0,
            surfels: self.octree.header().surfel_count,
            solid_angle_sr: self.gather.solid_angle_sr,
            interpolation: self.gather.tolerance,
            target: self.target,
            importance: self.gather.importance.to_string(),
            raster_edge: self.gather.raster_edge,
            directions: lobe_directions(self.gather.lobe_level),
            threads: self.threads,
            environment_peaks: self.environment.as_ref().map_or(0, |e| e.peaks().len()),
            total_seconds: 0.0,
            processor_seconds: seconds_since(self.processor_start),
            damaged_pages,
            warnings: self.warnings,
        })
    }

    /// The numbers of the pages that were left out, with a warning if there are any.
    fn damaged_pages(&mut self) -> Vec<u32> {
        let pages: Vec<u32> = self.octree.damaged_pages().iter().map(|page| page.0).collect();
        if !pages.is_empty() {
            self.warnings.push(format!(
                "{} of {} pages of {} are damaged and were left out, with all that lies in them and below: {}; bake it again",
                pages.len(),
                self.octree.pages().len(),
                self.octree.path().display(),
                list_pages(&pages)
            ));
        }
        pages
    }

    fn check(
        &mut self,
        sample: &[check::Sampled],
        progress: &Progress,
    ) -> Result<Option<CheckReport>, PbgiError> {
        let start = Instant::now();
        let receivers: Vec<Receiver> = sample.iter().map(|s| s.receiver).collect();
        let phase = progress.start_phase("check", "receivers", Some(receivers.len() as u64));
        let alone = GatherSettings { tolerance: 0.0, ..self.gather };
        let options = ShadeOptions {
            gather: GatherSettings { solid_angle_sr: 0.0, ..alone },
            threads: self.threads,
            cancel: self.cancel,
            progress: &|done| phase.set_done(done),
            ..ShadeOptions::default()
        };
        let light = self.light.as_ref();
        let (references, _) = shade_receivers(&self.octree, light, &receivers, &options)?;
        let seconds = start.elapsed().as_secs_f64();
        let same_cut = if self.gather.tolerance > 0.0 {
            let options = ShadeOptions { gather: alone, progress: &|_| (), ..options };
            Some(shade_receivers(&self.octree, light, &receivers, &options)?.0)
        } else {
            None
        };
        drop(phase);
        match CheckReport::new(sample, &references) {
            Ok(mut report) => {
                report.seconds = seconds;
                report.interpolation =
                    same_cut.and_then(|alone| PartReport::of_light(sample, &alone));
                Ok(Some(report))
            }
            Err(error) => {
                self.warnings.push(format!("the error could not be measured: {error}"));
                Ok(None)
            }
        }
    }
}

/// Refuses results that are no numbers: they never reach an output.
fn check_finite(receivers: &[Receiver], shadings: &[Shading]) -> Result<(), PbgiError> {
    let is_bad = |shading: &Shading| {
        let sums = shading.irradiance().iter().chain(&shading.reflected).sum::<f32>()
            + shading.ambient_occlusion
            + shading.sky_visibility
            + shading.bent_normal.element_sum();
        !sums.is_finite()
    };
    match shadings.iter().position(is_bad) {
        None => Ok(()),
        Some(index) => Err(PbgiError::input(format!(
            "the light at {} (relative to the octree's origin) is no number: octree, receivers or environment have sizes or radiances out \
             of range; check the octree with pbgi info --verify, and scale the scene or its light",
            receivers[index].position
        ))),
    }
}

/// Numbers of pages, the first few of many.
pub(crate) fn list_pages(pages: &[u32]) -> String {
    const SHOWN_MAX: usize = 20;
    let shown: Vec<String> = pages.iter().take(SHOWN_MAX).map(u32::to_string).collect();
    let rest = pages.len().saturating_sub(SHOWN_MAX);
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    shown.join(", ") + &more
}

/// What a receiver at `position` reflects toward `eye`, if anything reflects glossily; both in the same coordinates.
pub(crate) fn gloss_toward(
    gloss: Option<GlossSettings>,
    material: Material,
    position: Vec3,
    eye: Vec3,
) -> Option<Gloss> {
    let material = gloss?.apply(material);
    let toward_eye = (eye - position).try_normalize()?;
    Some(Gloss { material, toward_eye })
}

/// What a shading run did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShadeReport {
    /// Receivers shaded.
    pub receivers: u64,
    /// Seconds the workers took, without hiding, reading of scenes, writing and the check.
    pub shade_seconds: f64,
    /// Seconds of processors in them, of all threads of the process, where the system tells; to hundredths.
    pub shade_processor_seconds: Option<f64>,
    /// Receivers per second of those.
    pub receivers_per_second: f64,
    /// Mean entries of a cut.
    pub cut_mean: f64,
    /// Mean nodes whose bounds were tested.
    pub nodes_visited_mean: f64,
    /// Batches and their cuts.
    pub cuts: CutReport,
    /// Requests for pages by level of the tree, from the root's on.
    pub levels: Vec<LevelReport>,
    /// The page cache while shading.
    pub cache: CacheReport,
    /// How the memory limit was divided.
    pub memory: MemorySplit,
    /// Most memory the process held at once, where the system tells.
    pub memory_peak_bytes: Option<u64>,
    /// Measured error, if asked for.
    pub check: Option<CheckReport>,
    /// Pixels of a G-buffer that show no surface.
    pub empty_pixels: u64,
    /// Surfels of the octree file.
    pub surfels: u64,
    /// Largest solid angle of a node in steradians.
    pub solid_angle_sr: f32,
    /// Share that interpolation might be wrong by; 0 where each receiver gathered by itself.
    pub interpolation: f32,
    /// How that was chosen, if an error was asked for.
    pub target: Option<TargetReport>,
    /// Terms of importance, separated by commas, or `off`.
    pub importance: String,
    /// Texels along a face of the cube raster.
    pub raster_edge: usize,
    /// Directions of a reflection.
    pub directions: usize,
    /// Worker threads.
    pub threads: usize,
    /// Small bright lights the environment was found to have.
    pub environment_peaks: usize,
    /// Seconds of the whole run.
    pub total_seconds: f64,
    /// Seconds of processors from when the octree was opened, with hiding and the check, where the system tells.
    pub processor_seconds: Option<f64>,
    /// Pages that are damaged and were left out.
    pub damaged_pages: Vec<u32>,
    /// What the user should know of, one sentence each.
    pub warnings: Vec<String>,
}

impl ShadeReport {
    /// Statistics of cuts, levels and page cache as rows of a table: label and value.
    #[must_use]
    pub fn statistics(&self) -> Vec<(String, String)> {
        let levels = self.levels.iter().map(LevelReport::row);
        self.cuts.rows().into_iter().chain(self.cache.rows()).chain(levels).collect()
    }

    /// How many receivers gathered by themselves.
    fn gathers_text(&self) -> String {
        let gathers = self.cuts.gathers as f64;
        let share = gathers / self.receivers.max(1) as f64 * 100.0;
        let count = format_count(gathers);
        if self.interpolation > 0.0 {
            format!("{count} ({share:.1} % of receivers)")
        } else {
            count
        }
    }

    /// The report as rows of a table: label and value.
    #[must_use]
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let percent = |share: f64| format!("{:.2} %", share * 100.0);
        let error_text = |rrmse: f64, bias: f64, p99: f64| {
            let [rrmse, bias, p99] = [rrmse, bias, p99].map(percent);
            format!("{rrmse} relative rmse, {bias} bias, {p99} p99")
        };
        let mut rows = vec![
            ("surfels", format_count(self.surfels as f64)),
            ("receivers", format_count(self.receivers as f64)),
            ("receivers per second", format_count(self.receivers_per_second.round())),
            ("gathers", self.gathers_text()),
            ("mean cut size", format_count(self.cut_mean.round())),
            ("cache hit rate", format!("{:.3} %", self.cache.hit_rate * 100.0)),
            ("read amplification", format!("{:.2}", self.cache.read_amplification)),
            ("bytes read", format_bytes(self.cache.bytes_read)),
            ("memory split", self.memory.to_string()),
        ];
        if self.empty_pixels > 0 {
            rows.push(("empty pixels", format_count(self.empty_pixels as f64)));
        }
        let limit = format_bytes(self.memory.limit_bytes);
        let peak = self.memory_peak_bytes.map_or("unknown".to_owned(), format_bytes);
        rows.push(("peak memory", format!("{peak} of {limit}")));
        if let Some(target) = &self.target {
            let chosen = format!(
                "{:.4} sr: {} (at most {}) measured with {} receivers, {} asked for",
                target.solid_angle_sr,
                percent(target.error),
                percent(target.error_bound),
                target.receivers,
                percent(target.target)
            );
            rows.push(("chosen solid angle", chosen));
        }
        if let Some(check) = &self.check {
            let error = format!(
                "{} ({} of {} receivers, every surfel in {})",
                error_text(check.rrmse, check.bias, check.p99),
                check.quantity,
                check.receivers,
                format_seconds(check.seconds)
            );
            rows.push((if check.interpolation.is_some() { "error" } else { "cut error" }, error));
            if let Some(part) = &check.interpolation {
                let error = error_text(part.rrmse, part.bias, part.p99);
                rows.push(("of interpolation alone", error));
            }
            if let Some(gloss) = &check.gloss {
                let error = error_text(gloss.rrmse, gloss.bias, gloss.p99);
                rows.push(("cut error of gloss", error));
            }
        }
        rows.push(("total time", format_seconds(self.total_seconds)));
        rows
    }
}
