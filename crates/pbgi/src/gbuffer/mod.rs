//! Shading of a G-buffer: the surfaces another renderer saw, lit by an octree.

pub(crate) mod surfaces;

use crate::budget::split::MemorySplit;
use crate::frame::camera_choice::{CameraChoice, CameraContext};
use crate::frame::output::{channel_count, settings_attributes};
use crate::frame::preview::Preview;
use crate::frame::{Frame, layers_of};
use crate::gbuffer::surfaces::{GBuffer, GBufferSpace};
use crate::points::table_receivers::{RowRules, TableReceivers};
use crate::shade::nearness::{FarReceivers, letter, placement};
use crate::shade::target::spread;
use crate::shade::{CHUNK_RECEIVERS, Session, ShadeSettings, read_header, up_axis};
use crate::{PbgiError, Progress};
use pbgi_format::Header;
use pbgi_gather::{Receiver, Shading};
use pbgi_image::{Aov, AovNames, AttributeValue, Image, LAYOUT_ATTRIBUTES, StoredChannel};
use pbgi_light::UpAxis;
use pbgi_math::{DMat4, DVec3, Vec3};
use pbgi_schedule::{CHUNKS_IN_FLIGHT, RECEIVER_BYTES_IN_FLIGHT};
use pbgi_store::Octree;
use std::borrow::Cow;
use std::f32::consts::FRAC_1_PI;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Which G-buffer to shade.
#[derive(Clone, Debug)]
pub struct GBufferRequest<'a> {
    /// The octree file that lights and blocks.
    pub octree: &'a Path,
    /// An EXR image with positions and normals, and with albedo and other properties of the surfaces where it has them.
    pub gbuffer: &'a Path,
    /// The camera that saw it; [`CameraChoice::Default`] is that of the image's attributes, if there is one.
    pub camera: CameraChoice,
    /// The space of its vectors.
    pub space: GBufferSpace,
    /// The axis that is up in its world; that of the octree where not given.
    pub up: Option<UpAxis>,
    /// Factor from the units of its world to those of the octree.
    pub scale: f64,
    /// Whether its channels and attributes go into the result as they are.
    pub pass_through: bool,
    /// Channels to make, of [`GBUFFER_AOVS`].
    pub aovs: Vec<Aov>,
    /// Names of the channels, and those the G-buffer is searched for first.
    pub names: AovNames,
    /// Quality, light and resources.
    pub settings: ShadeSettings,
}

/// The quantities a shaded G-buffer can have. What it brings itself passes through on request.
pub const GBUFFER_AOVS: [Aov; 8] = [
    Aov::Beauty,
    Aov::DiffuseDirect,
    Aov::DiffuseIndirect,
    Aov::SpecularIndirect,
    Aov::Irradiance,
    Aov::Occlusion,
    Aov::SkyVisibility,
    Aov::BentNormal,
];

/// Attributes of the camera, which always go along.
const CAMERA_ATTRIBUTES: [&str; 2] = ["worldToCamera", "worldToNDC"];

/// Shades the surfaces in the pixels of a G-buffer, each pixel once. The result has the same pixels and the same
/// windows; a pixel without surface, by alpha or normal 0, is 0 in all of it.
///
/// # Errors
///
/// If a file cannot be read, is damaged, or a setting is out of range; if no pixel shows a surface; on cancellation.
pub fn shade_gbuffer(
    request: &GBufferRequest<'_>,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<Frame, PbgiError> {
    let start = Instant::now();
    let settings = &request.settings;
    settings.validate()?;
    if let Some(aov) = request.aovs.iter().find(|aov| !GBUFFER_AOVS.contains(aov)) {
        return Err(PbgiError::usage(format!(
            "{} is not made from a G-buffer; --pass-through takes its own along",
            request.names.layer(*aov)
        )));
    }
    if !(request.scale > 0.0 && request.scale.is_finite()) {
        return Err(PbgiError::usage(format!(
            "--gbuffer-scale is {}, expected a factor above 0, such as 0.01",
            request.scale
        )));
    }
    let header = read_header(request.octree)?;
    let environment = settings.load_environment(&header)?;
    let eye = find_eye(request, &header)?;
    let limit = settings.memory_bytes;
    let to_octree = request.to_octree(&header);
    let gbuffer = GBuffer::read(
        request.gbuffer,
        request.space,
        &request.names,
        &to_octree,
        header.origin,
        eye,
        limit,
    )?;
    if gbuffer.pixels.is_empty() {
        return Err(PbgiError::input(format!(
            "{}: no pixel shows a surface: alpha or normal are 0 everywhere",
            request.gbuffer.display()
        )));
    }
    let bytes = result_bytes(&gbuffer, &request.aovs, settings);
    let split = MemorySplit::measure(settings).grant(bytes, bytes)?;
    let mut session = Session::open(request.octree, settings, environment, split, 0, cancel)?;
    let far = far_pixels(&session.octree, &gbuffer, request, &to_octree)?;
    session.warnings.extend(far);
    let rules = RowRules { origin: header.origin, eye: None, gloss: settings.gloss };
    let rows = TableReceivers::new(&gbuffer.surfaces, 0, &rules)?;
    let extra =
        u32::from(settings.check_receivers > 0) + u32::from(settings.target_error.is_some());
    progress.set_phase_count(1 + extra);
    if session.wants_calibration() {
        let sample: Vec<Receiver> =
            spread(gbuffer.surfaces.len()).map(|row| rows.receiver(row)).collect();
        session.calibrate(&sample, progress)?;
    }
    let image = shade_pixels(&mut session, &gbuffer, &rows, request, progress)?;
    let is_lit = session.is_lit();
    warn_of(&gbuffer, &request.aovs, &request.names, &mut session.warnings);
    let mut report = session.finish(progress)?;
    report.empty_pixels = gbuffer.empty_pixels();
    report.total_seconds = start.elapsed().as_secs_f64();
    let own = settings_attributes(request.octree, settings, &report);
    let mut attributes = passed_attributes(request, gbuffer.metadata.attributes, &own);
    attributes.extend(own);
    let passed = match request.pass_through {
        true => passed_channels(gbuffer.channels, &image.image, &mut report.warnings),
        false => Vec::new(),
    };
    let window = gbuffer.window;
    let size = [gbuffer.width, gbuffer.height];
    let PixelImage { image, beauty, occlusion, covered, .. } = image;
    let preview = Preview::of_pixels(size, is_lit, &beauty, occlusion, &covered);
    let layers = layers_of(&request.aovs, &request.names);
    Ok(Frame { planes: image.into(), attributes, report, window, layers, passed, preview })
}

impl GBufferRequest<'_> {
    /// From the world of the G-buffer to that of the octree.
    fn to_octree(&self, header: &Header) -> DMat4 {
        let up = if header.flags.z_up { UpAxis::Z } else { UpAxis::Y };
        placement(self.up.unwrap_or(up), up, self.scale)
    }
}

/// What to say where the pixels do not show the surfaces of the octree.
fn far_pixels(
    octree: &Octree,
    gbuffer: &GBuffer,
    request: &GBufferRequest<'_>,
    to_octree: &DMat4,
) -> Result<Option<String>, PbgiError> {
    let back = to_octree.inverse();
    let surfaces = &gbuffer.surfaces;
    let place = |position: &Vec3| back.transform_point3(position.as_dvec3() + surfaces.origin);
    let places: Vec<DVec3> = surfaces.positions.iter().map(place).collect();
    let Some(FarReceivers { sample, far, cure }) = FarReceivers::find(octree, &places, to_octree)?
    else {
        return Ok(None);
    };
    let name = request.gbuffer.display();
    let text = format!("{name}: {far} of {sample} pixels looked at are far from all surfels");
    let Some(cure) = cure else {
        return Ok(Some(format!(
            "{text}; check that it shows the scene of {}, and the space of its positions (--gbuffer-space)",
            request.octree.display()
        )));
    };
    let up = cure.up.map(|up| format!("--gbuffer-up {}", letter(up)));
    let scale = (cure.scale != 1.0).then(|| format!("--gbuffer-scale {}", cure.scale));
    let options = up.into_iter().chain(scale).collect::<Vec<_>>().join(" ");
    let (near, causes) = (cure.near, cure.causes());
    Ok(Some(format!("{text}; {near} of them are near if {causes}: add {options}")))
}

/// Place of the eye in the G-buffer's world, where a camera was chosen.
fn find_eye(request: &GBufferRequest<'_>, header: &Header) -> Result<Option<DVec3>, PbgiError> {
    if request.camera == CameraChoice::Default {
        return Ok(None);
    }
    let context = CameraContext {
        scene: None,
        bounds: header.bounds,
        up: up_axis(header),
        aspect: 1.0,
        origin: header.origin,
    };
    let camera = context.find(&request.camera)?;
    Ok(Some(camera.transform.translation.as_dvec3() + header.origin))
}

/// Bytes of the result and of what making it takes beside the G-buffer.
fn result_bytes(gbuffer: &GBuffer, aovs: &[Aov], settings: &ShadeSettings) -> u64 {
    let pixels = (gbuffer.width * gbuffer.height) as u64;
    let each = (CHUNKS_IN_FLIGHT * RECEIVER_BYTES_IN_FLIGHT) as u64 + settings.record_bytes();
    pixels * (4 * channel_count(aovs) as u64 + 12 + 4 + 1) + CHUNK_RECEIVERS as u64 * each
}

/// Shades the pixels in their order.
fn shade_pixels(
    session: &mut Session<'_>,
    gbuffer: &GBuffer,
    rows: &TableReceivers<'_>,
    request: &GBufferRequest<'_>,
    progress: &Progress,
) -> Result<PixelImage, PbgiError> {
    let surfaces = &gbuffer.surfaces;
    let header = session.octree.header();
    let mut image = PixelImage::new(gbuffer, request, header);
    let albedos = ["albedo_r", "albedo_g", "albedo_b"].map(|name| surfaces.column(name));
    let phase = progress.start_phase("shade", "receivers", Some(surfaces.len() as u64));
    session.stream(
        &|done| phase.set_done(done),
        |feed| {
            (0..surfaces.len()).step_by(CHUNK_RECEIVERS).try_for_each(|first| {
                let chunk = first..(first + CHUNK_RECEIVERS).min(surfaces.len());
                let receivers = chunk.clone().map(|i| rows.receiver(i)).collect();
                feed.push(Cow::Owned(receivers), chunk)
            })
        },
        |chunk| {
            for (index, shading) in chunk.attached.zip(&chunk.shadings) {
                let albedo = albedos.map(|albedo| albedo.map_or(1.0, |albedo| albedo[index]));
                let pixel = gbuffer.pixels[index] as usize;
                image.set(pixel, gbuffer.alphas[index], albedo, shading);
            }
            Ok(())
        },
    )?;
    Ok(image)
}

/// What the user should know of a G-buffer.
fn warn_of(gbuffer: &GBuffer, aovs: &[Aov], names: &AovNames, warnings: &mut Vec<String>) {
    if gbuffer.damaged > 0 {
        warnings.push(format!(
            "{} pixels with alpha have a position or normal that is not finite; they are left out",
            gbuffer.damaged
        ));
    }
    let needs_albedo = aovs.iter().any(|aov| match aov {
        Aov::Beauty => true,
        Aov::DiffuseDirect | Aov::DiffuseIndirect => !names.is_without_color(*aov),
        _ => false,
    });
    if needs_albedo && gbuffer.surfaces.column("albedo_r").is_none() {
        let reason = "the G-buffer has no albedo; reflected light is that of white surfaces";
        warnings.push(reason.to_owned());
    }
    if !gbuffer.metadata.parts_left_out.is_empty() {
        let parts = gbuffer.metadata.parts_left_out.join(", ");
        warnings.push(format!("parts of another size than the first are left out: {parts}"));
    }
}

/// Attributes of the G-buffer that go along: those of the camera, or all but those of layout and our `own`.
fn passed_attributes(
    request: &GBufferRequest<'_>,
    attributes: Vec<(String, AttributeValue)>,
    own: &[(String, AttributeValue)],
) -> Vec<(String, AttributeValue)> {
    let passes = |name: &str| {
        let is_own = own.iter().any(|(own, _)| own == name);
        let is_passed = request.pass_through && !LAYOUT_ATTRIBUTES.contains(&name);
        !is_own && (is_passed || CAMERA_ATTRIBUTES.contains(&name))
    };
    attributes.into_iter().filter(|(name, _)| passes(name)).collect()
}

/// Channels of the G-buffer that go along: all whose names the result does not have.
fn passed_channels(
    channels: Vec<StoredChannel>,
    image: &Image,
    warnings: &mut Vec<String>,
) -> Vec<StoredChannel> {
    let (replaced, passed): (Vec<_>, Vec<_>) =
        channels.into_iter().partition(|c| image.channel(&c.name).is_some());
    if !replaced.is_empty() {
        let names: Vec<String> = replaced.into_iter().map(|c| c.name).collect();
        warnings.push(format!(
            "channels of the G-buffer replaced by results of the same names: {} (--aovs chooses results)",
            names.join(", ")
        ));
    }
    passed
}

/// A result that grows pixel by pixel; pixels that are never set are 0.
struct PixelImage {
    image: Image,
    names: AovNames,
    /// From directions in the octree's world to those in the G-buffer's.
    from_octree: DMat4,
    /// Of each quantity, its first channel.
    planes: Vec<(Aov, usize)>,
    beauty: Vec<[f32; 3]>,
    occlusion: Vec<f32>,
    covered: Vec<bool>,
}

impl PixelImage {
    fn new(gbuffer: &GBuffer, request: &GBufferRequest<'_>, header: &Header) -> Self {
        let pixels = gbuffer.width * gbuffer.height;
        let mut image = Image::new(gbuffer.width, gbuffer.height);
        let mut planes = Vec::new();
        for aov in &request.aovs {
            planes.push((*aov, image.channels.len()));
            for name in request.names.channels(*aov) {
                image.push(name, vec![0.0; pixels]);
            }
        }
        Self {
            image,
            names: request.names.clone(),
            from_octree: GBufferRequest { scale: 1.0, ..request.clone() }
                .to_octree(header)
                .inverse(),
            planes,
            beauty: vec![[0.0; 3]; pixels],
            occlusion: vec![0.0; pixels],
            covered: vec![false; pixels],
        }
    }

    /// Sets a pixel. Reflected radiance of a Lambertian surface is `albedo/π · E`.
    fn set(&mut self, pixel: usize, alpha: f32, albedo: [f32; 3], shading: &Shading) {
        let irradiance = shading.irradiance();
        let through = shading.gloss_albedo.map(|gloss| 1.0 - gloss);
        let diffuse = [0, 1, 2].map(|c| through[c] * albedo[c] * FRAC_1_PI * irradiance[c]);
        let gloss = shading.reflected;
        let part = |aov: Aov, light: [f32; 3]| {
            let without = self.names.is_without_color(aov);
            let of = |c: usize| {
                through[c] * if without { 1.0 } else { albedo[c] } * FRAC_1_PI * light[c]
            };
            [of(0), of(1), of(2), 0.0]
        };
        let [r, g, b] = [0, 1, 2].map(|c| diffuse[c] + gloss[c]);
        for (aov, first) in &self.planes {
            let (values, count) = match aov {
                Aov::Beauty => ([r, g, b, alpha], 4),
                Aov::DiffuseDirect => (part(*aov, shading.environment_irradiance), 3),
                Aov::DiffuseIndirect => (part(*aov, shading.surface_irradiance), 3),
                Aov::SpecularIndirect => ([gloss[0], gloss[1], gloss[2], 0.0], 3),
                Aov::Irradiance => ([irradiance[0], irradiance[1], irradiance[2], 0.0], 3),
                Aov::Occlusion => {
                    ([self.names.value(*aov, shading.ambient_occlusion), 0.0, 0.0, 0.0], 1)
                }
                Aov::SkyVisibility => ([shading.sky_visibility, 0.0, 0.0, 0.0], 1),
                _ => {
                    let bent = self.from_octree.transform_vector3(shading.bent_normal.as_dvec3());
                    (bent.as_vec3().extend(0.0).to_array(), 3)
                }
            };
            for (channel, value) in self.image.channels[*first..].iter_mut().zip(&values[..count]) {
                channel.data[pixel] = *value;
            }
        }
        self.beauty[pixel] = [r, g, b];
        self.occlusion[pixel] = shading.ambient_occlusion;
        self.covered[pixel] = true;
    }
}
