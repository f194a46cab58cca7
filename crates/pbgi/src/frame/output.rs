//! Results on their way into files: channels of a frame, and attributes.

use crate::PbgiError;
use crate::frame::band::{Band, Piece};
use crate::frame::preview::{Preview, preview_names};
use crate::frame::request::FrameRequest;
use crate::shade::{ShadeReport, ShadeSettings, list_pages};
use pbgi_gather::Shading;
use pbgi_image::{Aov, AovNames, AttributeValue, Planes};
use pbgi_light::Environment;
use pbgi_math::{DVec3, Mat4, Vec3, Vec4};
use pbgi_scene::CameraView;
use std::f32::consts::FRAC_1_PI;
use std::path::{Path, PathBuf};

/// Depth written where no surface is: finite, so that compositors can blend it.
const DEPTH_OF_NOTHING: f32 = 1e10;

/// Averaged over the samples of a pixel: beauty, reflected light of surfaces, irradiance, albedo,
/// occlusion, sky visibility, what is reflected glossily, reflected light of the environment.
const MIXED: usize = 20;
/// Of the largest fragment of a pixel: bent normal.
const NEAREST: usize = 3;

/// Number of channels that `aovs` make.
pub(crate) fn channel_count(aovs: &[Aov]) -> usize {
    let names = AovNames::default();
    aovs.iter().map(|aov| names.channels(*aov).len()).sum()
}

/// Planes of the preview.
pub(crate) fn preview_channel_count(is_lit: bool) -> usize {
    preview_names(is_lit).len()
}

/// The channels of a frame, growing from the top row down by bands, which grow by windows.
pub(crate) struct FrameImage {
    planes: Planes,
    preview: Planes,
    is_lit: bool,
    names: AovNames,
    /// Quantities, each with the number of its channels.
    layout: Vec<(Aov, usize)>,
    /// First row of the band under way.
    band_row: u32,
    /// Samples of the band under way, of each plane and then of each of the preview's.
    band: Vec<Vec<f32>>,
    /// Whether reflected light of surfaces, and of the environment, is written without the albedo.
    without_color: [bool; 2],
}

impl FrameImage {
    /// An empty image, in memory or in a scratch file in a folder.
    ///
    /// # Errors
    ///
    /// If the scratch file cannot be made.
    pub fn new(
        request: &FrameRequest<'_>,
        is_lit: bool,
        scratch: Option<&Path>,
    ) -> Result<Self, PbgiError> {
        let (width, height) = (request.width as usize, request.height as usize);
        let grow = |names: Vec<String>| match scratch {
            Some(folder) => Planes::in_scratch(folder, width, height, names),
            None => Ok(Planes::in_memory(width, height, names)),
        };
        let names = &request.names;
        let layout = request.aovs.iter().map(|aov| (*aov, names.channels(*aov).len())).collect();
        let planes = grow(request.aovs.iter().flat_map(|aov| names.channels(*aov)).collect())?;
        let preview = grow(preview_names(is_lit))?;
        let band = vec![Vec::new(); planes.names().len() + preview.names().len()];
        Ok(Self {
            planes,
            preview,
            is_lit,
            names: names.clone(),
            layout,
            band_row: 0,
            band,
            without_color: [Aov::DiffuseIndirect, Aov::DiffuseDirect]
                .map(|aov| names.is_without_color(aov)),
        })
    }

    /// Starts a band of so many rows.
    pub fn start_band(&mut self, row: u32, rows: u32) {
        self.band_row = row;
        let samples = self.planes.width() * rows as usize;
        self.band.iter_mut().for_each(|plane| plane.resize(samples, 0.0));
    }

    /// Puts a window of the band where it belongs. `origin` is the world position of the origin of its coordinates.
    pub fn put(
        &mut self,
        band: &Band,
        shadings: &[Shading],
        background: Option<&Environment>,
        view: &CameraView,
        origin: DVec3,
    ) {
        let coverage = &band.coverage;
        let mixed = coverage.resolve(
            |i| mixed_values(&band.pieces[i], &shadings[i], self.without_color),
            |direction| {
                let mut values = [0.0; MIXED];
                let radiance = background.map_or([0.0; 3], |e| e.radiance(direction));
                values[..3].copy_from_slice(&radiance);
                values
            },
        );
        let bent: Vec<[f32; NEAREST]> =
            coverage.resolve_nearest(|i| shadings[i].bent_normal.to_array(), [0.0; NEAREST]);
        let alpha = coverage.alpha();
        let (columns, [x, y]) = (coverage.width() as usize, coverage.origin());
        let first = (y - self.band_row) as usize * self.planes.width() + x as usize;
        for pixel in 0..coverage.pixel_count() {
            let surface = PixelSurface::new(band, pixel, view, origin);
            let values = &mixed[pixel];
            let place = first + pixel / columns * self.planes.width() + pixel % columns;
            let (band, mut plane) = (&mut self.band, 0);
            let mut set = |value: f32| {
                band[plane][place] = value;
                plane += 1;
            };
            for (aov, count) in &self.layout {
                let all = match aov {
                    Aov::Beauty => [values[0], values[1], values[2], alpha[pixel]],
                    Aov::DiffuseIndirect => with_zero(&values[3..6]),
                    Aov::DiffuseDirect => with_zero(&values[17..20]),
                    Aov::SpecularIndirect => with_zero(&values[14..17]),
                    Aov::Irradiance => with_zero(&values[6..9]),
                    Aov::Albedo => with_zero(&values[9..12]),
                    Aov::Occlusion => [values[12], 0.0, 0.0, 0.0],
                    Aov::SkyVisibility => [values[13], 0.0, 0.0, 0.0],
                    Aov::BentNormal => with_zero(&bent[pixel]),
                    Aov::Position => with_zero(&surface.position),
                    Aov::Normal => with_zero(&surface.normal),
                    Aov::Depth => [surface.depth, 0.0, 0.0, 0.0],
                    _ => [0.0; 4],
                };
                all[..*count].iter().for_each(|value| set(self.names.value(*aov, *value)));
            }
            let shown = if self.is_lit { &values[..3] } else { &values[12..13] };
            shown.iter().for_each(|value| set(*value));
            set(f32::from(alpha[pixel] > 0.5));
        }
    }

    /// Appends the band, all of which is put.
    ///
    /// # Errors
    ///
    /// If the scratch file cannot be written.
    pub fn finish_band(&mut self) -> Result<(), PbgiError> {
        let (own, preview) = self.band.split_at(self.planes.names().len());
        for (plane, samples) in own.iter().enumerate() {
            self.planes.append(plane, samples)?;
        }
        for (plane, samples) in preview.iter().enumerate() {
            self.preview.append(plane, samples)?;
        }
        Ok(())
    }

    /// All channels and the preview.
    pub fn finish(self) -> (Planes, Preview) {
        (self.planes, Preview::new(self.preview, self.is_lit))
    }
}

fn with_zero(values: &[f32]) -> [f32; 4] {
    [values[0], values[1], values[2], 0.0]
}

/// Values of a piece that are averaged over the samples of a pixel. Reflected radiance of a Lambertian
/// surface is `albedo/π · E`, of what the gloss above it lets through. `without_color` is of light of surfaces and of the environment.
fn mixed_values(piece: &Piece, shading: &Shading, without_color: [bool; 2]) -> [f32; MIXED] {
    let irradiance = shading.irradiance();
    let mut values = [0.0; MIXED];
    for c in 0..3 {
        let through = 1.0 - shading.gloss_albedo[c];
        let reflected = through * piece.albedo[c] * FRAC_1_PI * irradiance[c];
        values[c] = reflected + shading.reflected[c] + piece.emission[c];
        let colored = |without: bool| if without { 1.0 } else { piece.albedo[c] };
        let [of_surfaces, of_sky] = without_color;
        let scale = through * FRAC_1_PI;
        values[3 + c] = scale * colored(of_surfaces) * shading.surface_irradiance[c];
        values[17 + c] = scale * colored(of_sky) * shading.environment_irradiance[c];
        values[6 + c] = irradiance[c];
        values[9 + c] = piece.albedo[c];
    }
    values[12] = shading.ambient_occlusion;
    values[13] = shading.sky_visibility;
    values[14..17].copy_from_slice(&shading.reflected);
    values
}

/// Geometry in the middle of a pixel, which cannot be averaged: that of its largest fragment.
pub(crate) struct PixelSurface {
    position: [f32; 3],
    normal: [f32; 3],
    pub depth: f32,
}

impl PixelSurface {
    pub fn new(band: &Band, pixel: usize, view: &CameraView, origin: DVec3) -> Self {
        let Some(fragment) = band.coverage.fragments(pixel).first() else {
            return Self { position: [0.0; 3], normal: [0.0; 3], depth: DEPTH_OF_NOTHING };
        };
        let piece = &band.pieces[fragment.index as usize];
        let position = seen_point(piece, view.eye(), band.coverage.pixel_direction(pixel));
        Self {
            position: (position.as_dvec3() + origin).as_vec3().to_array(),
            normal: piece.normal.to_array(),
            depth: (position - view.eye()).dot(view.forward()),
        }
    }
}

/// Where the ray through the middle of a pixel meets the plane of `piece`; the piece's own place where
/// that is not near it, as along edges.
fn seen_point(piece: &Piece, eye: Vec3, direction: Vec3) -> Vec3 {
    let slope = direction.dot(piece.plane);
    let distance = (piece.position - eye).dot(piece.plane) / slope;
    let hit = eye + direction * distance;
    let reach = 1.5 * piece.radius;
    let is_near = hit.is_finite() && hit.distance_squared(piece.position) <= reach * reach;
    if is_near && distance > 0.0 { hit } else { piece.position }
}

/// Camera, settings and measured error as attributes of the EXR file. They are the same for any
/// number of threads and any memory limit.
pub(crate) fn frame_attributes(
    request: &FrameRequest<'_>,
    view: &CameraView,
    origin: DVec3,
    report: &ShadeReport,
) -> Vec<(String, AttributeValue)> {
    use AttributeValue::{Float, Int, Matrix};
    let to_local = |matrix: Mat4| {
        // Products with the origin in f64: it may be millions of units away.
        let m = matrix.as_dmat4();
        let shifted = m.w_axis - m.x_axis * origin.x - m.y_axis * origin.y - m.z_axis * origin.z;
        let shifted = Vec4::from_array(shifted.to_array().map(|x| x as f32));
        Mat4::from_cols(matrix.x_axis, matrix.y_axis, matrix.z_axis, shifted)
    };
    let mut attributes = vec![
        ("worldToCamera".to_owned(), Matrix(to_local(view.world_to_camera()))),
        ("worldToNDC".to_owned(), Matrix(to_local(view.world_to_ndc()))),
        ("pbgi:samples".to_owned(), Int(request.samples as i32)),
        ("pbgi:shadingRate".to_owned(), Float(request.shading_rate)),
    ];
    attributes.push(("pbgi:cutSizeMean".to_owned(), Float(report.cut_mean as f32)));
    attributes.extend(settings_attributes(request.octree, &request.settings, report));
    attributes
}

/// Settings and measured error as attributes. They are the same for any number of threads and any memory limit.
pub(crate) fn settings_attributes(
    octree: &Path,
    settings: &ShadeSettings,
    report: &ShadeReport,
) -> Vec<(String, AttributeValue)> {
    use AttributeValue::{Float, Int, Text};
    let mut attributes = vec![
        ("software".to_owned(), Text(format!("pbgi {}", env!("CARGO_PKG_VERSION")))),
        ("pbgi:octree".to_owned(), Text(file_name(octree))),
        ("pbgi:surfels".to_owned(), Text(report.surfels.to_string())),
        ("pbgi:solidAngle".to_owned(), Float(report.solid_angle_sr)),
        ("pbgi:interpolation".to_owned(), Float(report.interpolation)),
        ("pbgi:importance".to_owned(), Text(settings.importance.to_string())),
        ("pbgi:raster".to_owned(), Int(settings.raster_edge as i32)),
        ("pbgi:directions".to_owned(), Int(settings.directions as i32)),
        ("pbgi:bias".to_owned(), Float(settings.bias)),
        ("pbgi:receivers".to_owned(), Text(report.receivers.to_string())),
    ];
    if let Some(environment) = &settings.environment {
        attributes.push(("pbgi:environment".to_owned(), Text(environment.to_string())));
    }
    if !report.damaged_pages.is_empty() {
        let text = format!(
            "{} left out: {}",
            report.damaged_pages.len(),
            list_pages(&report.damaged_pages)
        );
        attributes.push(("pbgi:damagedPages".to_owned(), Text(text)));
    }
    if let Some(check) = &report.check {
        attributes.push(("pbgi:checkReceivers".to_owned(), Int(check.receivers as i32)));
        attributes.push(("pbgi:checkQuantity".to_owned(), Text(check.quantity.to_owned())));
        attributes.push(("pbgi:relativeRmse".to_owned(), Float(check.rrmse as f32)));
        attributes.push(("pbgi:bias".to_owned() + "OfMean", Float(check.bias as f32)));
        attributes.push(("pbgi:relativeErrorP99".to_owned(), Float(check.p99 as f32)));
        if let Some(gloss) = &check.gloss {
            attributes.push(("pbgi:glossRelativeRmse".to_owned(), Float(gloss.rrmse as f32)));
        }
    }
    attributes
}

/// The last part of a path: images go to other machines, where folders mean nothing.
fn file_name(path: &Path) -> String {
    PathBuf::from(path.file_name().unwrap_or(path.as_os_str())).display().to_string()
}
