//! A picture: what a camera sees, shaded, as an image with many channels.

pub(crate) mod band;
pub(crate) mod camera_choice;
pub(crate) mod camera_file;
pub(crate) mod contact;
pub(crate) mod output;
pub(crate) mod request;
pub(crate) mod splat;

use crate::budget::split::MemorySplit;
use crate::frame::band::{Band, Piece};
use crate::frame::camera_choice::CameraContext;
use crate::frame::request::FrameRequest;
use crate::frame::splat::hide_surfels;
use crate::shade::target::spread;
use crate::shade::{Session, ShadeReport, read_header, up_axis};
use crate::{PbgiError, Progress};
use output::FrameImage;
use pbgi_format::Header;
use pbgi_gather::{Receiver, Shading};
use pbgi_image::{
    Aov, AovNames, AttributeValue, Image, ImageWindow, StoredChannel, ToneMap, auto_exposure,
    write_png, write_windowed_exr,
};
use pbgi_math::{Aabb, DVec3};
use pbgi_scene::{CameraView, Micropolygon, PixelWindow, Scene, hide};
use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A shaded picture with what is known of it.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The channels.
    pub image: Image,
    /// Attributes for the EXR file: camera, settings, measured error. They depend on the request only.
    pub attributes: Vec<(String, AttributeValue)>,
    /// What shading did.
    pub report: ShadeReport,
    /// Where the pixels lie in what the camera saw.
    pub(crate) window: ImageWindow,
    /// The quantities, each with the names of its channels.
    pub(crate) layers: Vec<(Aov, Vec<String>)>,
    /// Channels of another file that go along as they are.
    pub(crate) passed: Vec<StoredChannel>,
    /// What the preview shows.
    pub(crate) preview: Vec<[f32; 3]>,
    /// Where the preview shows surfaces.
    pub(crate) covered: Vec<bool>,
    /// Whether the preview shows light, not just occlusion.
    pub(crate) is_lit: bool,
}

impl Frame {
    /// Writes all channels and attributes as an EXR file, whole or not at all.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_exr(&self, path: &Path) -> Result<(), PbgiError> {
        let Self { image, passed, window, attributes, .. } = self;
        Ok(write_windowed_exr(path, image, passed, window, attributes)?)
    }

    /// Writes the beauty as an 8-bit picture with a filmic curve, or ambient occlusion as it is where
    /// there is no light. `exposure` is in stops; without it, one that suits the surfaces is chosen.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_preview(&self, path: &Path, exposure: Option<f32>) -> Result<(), PbgiError> {
        let (width, height) = (self.image.width, self.image.height);
        let automatic = || match self.is_lit {
            true => auto_exposure(&self.preview, Some(&self.covered)),
            false => 0.0,
        };
        let exposure = exposure.unwrap_or_else(automatic);
        let tone = ToneMap { exposure, filmic: self.is_lit };
        Ok(write_png(path, width, height, &self.preview, tone)?)
    }
}

/// Makes a picture.
///
/// The image does not depend on threads or memory limit. Where the limit does not hold what the whole
/// image needs at once, it is made in bands of rows.
///
/// Both sides of a surface are shaded: the back of a single-sided surface gathers light on the
/// camera's side, though in the octree it is black. Surfels drawn without a scene face the camera,
/// unless they are visible from one side only; those without a normal are shaded as if they looked up.
///
/// # Errors
///
/// If a file cannot be read, is damaged, or a setting is out of range; if nothing is visible and there
/// is no environment to show instead; on cancellation.
pub fn shade_frame(
    request: &FrameRequest<'_>,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<Frame, PbgiError> {
    request.settings.validate()?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(request.settings.threads)
        .build()
        .map_err(|e| PbgiError::failed(format!("threads cannot be started: {e}")))?;
    pool.install(|| FrameJob::prepare(request, cancel)?.run(progress))
}

/// A frame under way.
struct FrameJob<'a> {
    request: &'a FrameRequest<'a>,
    header: Header,
    session: Session<'a>,
    view: CameraView,
    /// World position of the origin of the view's and the pieces' coordinates.
    origin: DVec3,
    /// Results of the surfels shown so far, by their numbers in the file.
    shaded_surfels: HashMap<u64, Shading>,
    cancel: &'a AtomicBool,
    start: Instant,
}

/// How many times as large as the octree a scene may be, or the other way round, before it is doubted.
const SIZE_RATIO: f32 = 20.0;

/// A warning where a scene is much larger or smaller than the octree, as if their units were not the same.
fn unlike_size(scene: &Scene, header: &Header) -> Option<String> {
    let size = |bounds: Aabb| bounds.extent().length();
    let (scene, octree) = (size(scene.bounds()), size(header.bounds));
    let ratio = scene.max(octree) / scene.min(octree);
    (ratio.is_finite() && ratio > SIZE_RATIO).then(|| {
        format!(
            "the scene measures {scene:.3} units and the octree {octree:.3}, {ratio:.0} times as much or as little, \
             as centimeters against meters; shade the scene that was baked, or bake this one"
        )
    })
}

/// Pixels along the longer edge of the picture whose receivers are measured to choose settings.
const CALIBRATION_EDGE: u32 = 160;

/// Rows of a band, and of a tile of hiding: bands of whole tiles shade nothing twice. Pieces share within a band, so that its size must not follow the
/// memory limit.
const TILE_ROWS: u32 = 64;

impl<'a> FrameJob<'a> {
    fn prepare(request: &'a FrameRequest<'a>, cancel: &'a AtomicBool) -> Result<Self, PbgiError> {
        let start = Instant::now();
        let settings = &request.settings;
        // What memory is asked for follows from it.
        request.hide_options(None).check_shading_rate()?;
        let header = read_header(request.octree)?;
        let environment = settings.load_environment(&header)?;
        let split = MemorySplit::measure(settings);
        let (image, per_row) = frame_bytes(request, header.surfel_count);
        let frame = image + per_row * u64::from(TILE_ROWS);
        let hint = |e| PbgiError::budget(format!("{e}; fewer quantities take less (--aovs)"));
        let split = split.grant(frame, frame).map_err(hint)?;
        let extra_readers = usize::from(request.scene.is_none());
        let mut session =
            Session::open(request.octree, settings, environment, split, extra_readers, cancel)?;
        session.warnings.extend(request.scene.and_then(|scene| unlike_size(scene, &header)));
        let origin = request.scene.map_or(header.origin, |scene| scene.origin);
        let context = CameraContext {
            scene: request.scene,
            bounds: request.scene.map_or(header.bounds, Scene::bounds),
            up: up_axis(&header),
            aspect: request.width as f32 / request.height.max(1) as f32,
            origin,
        };
        let camera = context.find(&request.camera)?;
        let view = CameraView { camera, width: request.width, height: request.height };
        let shaded_surfels = HashMap::new();
        Ok(Self { request, header, session, view, origin, shaded_surfels, cancel, start })
    }

    fn run(mut self, progress: &Progress) -> Result<Frame, PbgiError> {
        let mut image = FrameImage::new(self.request);
        let bands = self.request.height.div_ceil(TILE_ROWS);
        let mut seen = Seen::default();
        let extra = u32::from(self.request.settings.check_receivers > 0)
            + u32::from(self.session.wants_calibration());
        progress.set_phase_count(2 * bands + extra);
        self.calibrate(progress)?;
        for band in 0..bands {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(PbgiError::Interrupted);
            }
            let y = band * TILE_ROWS;
            let height = TILE_ROWS.min(self.request.height - y);
            let window = PixelWindow { x: 0, y, width: self.request.width, height };
            let phase = progress.start_phase("hide", "rows", Some(u64::from(height)));
            let visible = self.hide(window)?;
            phase.set_done(u64::from(height));
            drop(phase);
            seen.count(&visible);
            let count = visible.pieces.len() as u64;
            let phase = progress.start_phase("shade", "receivers", Some(count));
            let shadings = self.shade(&visible, &|done| phase.set_done(done))?;
            drop(phase);
            let background = self.session.environment.as_ref();
            image.append(&visible, &shadings, background, &self.view, self.origin);
        }
        self.judge(&seen)?;
        self.finish(image, progress)
    }

    /// Chooses the solid angle for the error that was asked for, by what a small picture of the whole shows: bands do not change it.
    fn calibrate(&mut self, progress: &Progress) -> Result<(), PbgiError> {
        if !self.session.wants_calibration() {
            return Ok(());
        }
        let scale =
            (CALIBRATION_EDGE as f32 / self.view.width.max(self.view.height) as f32).min(1.0);
        let small = |edge: u32| ((edge as f32 * scale) as u32).max(1);
        let (width, height) = (small(self.view.width), small(self.view.height));
        let view = CameraView { width, height, ..self.view.clone() };
        // Slivers at edges err most, and only samples within pixels see as many of them as the picture does.
        let options = self.request.hide_options(None);
        let pieces: Vec<Piece> = match self.request.scene {
            Some(scene) => {
                hide(scene, &view, &options)?.micropolygons.iter().map(Piece::from).collect()
            }
            None => {
                let (octree, up) = (&self.session.octree, self.session.up());
                hide_surfels(octree, &view, &options, up, self.cancel)?.pieces
            }
        };
        let sample: Vec<Receiver> =
            spread(pieces.len()).map(|i| self.receiver_of(&pieces[i])).collect();
        self.session.calibrate(&sample, progress)
    }

    fn hide(&self, window: PixelWindow) -> Result<Band, PbgiError> {
        let options = self.request.hide_options(Some(window));
        let Some(scene) = self.request.scene else {
            let (octree, up) = (&self.session.octree, self.session.up());
            return hide_surfels(octree, &self.view, &options, up, self.cancel);
        };
        let visible = hide(scene, &self.view, &options)?;
        let pieces = visible.micropolygons.iter().map(Piece::from).collect();
        Ok(Band { pieces, ids: Vec::new(), coverage: visible.coverage })
    }

    /// The receiver of a piece, with what it reflects toward the camera.
    fn receiver_of(&self, piece: &Piece) -> Receiver {
        let gloss = self.session.gloss(piece.material, piece.position, self.view.eye());
        let shift = self.origin - self.header.origin;
        let position = (piece.position.as_dvec3() + shift).as_vec3();
        // Normals may be interpolated over an edge; the surface faces the camera.
        let plane = if piece.plane.dot(piece.normal) < 0.0 { -piece.plane } else { piece.plane };
        Receiver { position, normal: piece.normal, plane, gloss }
    }

    /// Shades the pieces of a band. Surfels that an earlier band has shown are not shaded again.
    fn shade(
        &mut self,
        band: &Band,
        advance: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Shading>, PbgiError> {
        let receiver = |piece: &Piece| self.receiver_of(piece);
        if band.ids.is_empty() {
            let receivers: Vec<Receiver> = band.pieces.iter().map(receiver).collect();
            return self.session.shade(&receivers, None, advance);
        }
        let is_new = |(id, _): &(&u64, &Piece)| !self.shaded_surfels.contains_key(*id);
        let (ids, receivers): (Vec<u64>, Vec<Receiver>) = (band.ids.iter().zip(&band.pieces))
            .filter(is_new)
            .map(|(id, piece)| (*id, receiver(piece)))
            .unzip();
        let shadings = self.session.shade(&receivers, Some(&ids), advance)?;
        self.shaded_surfels.extend(ids.into_iter().zip(shadings));
        Ok(band.ids.iter().map(|id| self.shaded_surfels[id]).collect())
    }

    /// Turns pictures of nothing into errors and doubtful ones into warnings.
    fn judge(&mut self, seen: &Seen) -> Result<(), PbgiError> {
        let eye = self.view.eye().as_dvec3() + self.origin;
        let toward = self.view.forward();
        if seen.covered == 0 {
            let message = format!(
                "the camera at {eye} looking along {toward} sees no surface; move it or turn it \
                 around (everything lies within {:?} to {:?})",
                (self.header.bounds.min.as_dvec3() + self.header.origin).to_array(),
                (self.header.bounds.max.as_dvec3() + self.header.origin).to_array(),
            );
            if self.session.environment.is_none() {
                return Err(PbgiError::failed(message));
            }
            self.session.warnings.push(message + "; only the environment is shown");
        } else if seen.backs * 2 > seen.covered {
            self.session.warnings.push(format!(
                "{:.0} % of what the camera at {eye} sees are backs of surfaces; it may stand inside \
                 of an object",
                100.0 * seen.backs as f64 / seen.covered as f64
            ));
        }
        Ok(())
    }

    fn finish(self, image: FrameImage, progress: &Progress) -> Result<Frame, PbgiError> {
        let is_lit = self.session.is_lit();
        let mut report = self.session.finish(progress)?;
        report.total_seconds = self.start.elapsed().as_secs_f64();
        let attributes = output::frame_attributes(self.request, &self.view, self.origin, &report);
        let (preview, covered) = image.preview(is_lit);
        let image = image.into_image(&self.request.names);
        let window = ImageWindow::whole(image.width, image.height);
        let passed = Vec::new();
        let layers = layers_of(&self.request.aovs, &self.request.names);
        Ok(Frame { image, attributes, report, window, layers, passed, preview, covered, is_lit })
    }
}

/// The quantities with the names of their channels.
pub(crate) fn layers_of(aovs: &[Aov], names: &AovNames) -> Vec<(Aov, Vec<String>)> {
    aovs.iter().map(|aov| (*aov, names.channels(*aov))).collect()
}

/// Samples by what they show.
#[derive(Default)]
struct Seen {
    covered: u64,
    backs: u64,
}

impl Seen {
    fn count(&mut self, band: &Band) {
        for pixel in 0..band.coverage.pixel_count() {
            for fragment in band.coverage.fragments(pixel) {
                let samples = u64::from(fragment.samples);
                self.covered += samples;
                let is_back = band.pieces[fragment.index as usize].is_back;
                self.backs += if is_back { samples } else { 0 };
            }
        }
    }
}

/// Estimated bytes of the image, and of what a row needs while it is made, of an octree of so many surfels.
fn frame_bytes(request: &FrameRequest<'_>, surfel_count: u64) -> (u64, u64) {
    let width = u64::from(request.width);
    let pixels = width * u64::from(request.height);
    // Surfels keep their results until the end: about one per pixel if there are as many, in a table half full.
    let kept_count = if request.scene.is_none() { pixels.min(surfel_count) } else { 0 };
    let kept = kept_count * 2 * (8 + size_of::<Shading>() as u64);
    let image = pixels * (output::channel_count(&request.aovs) as u64 * 4 + 16) + kept;
    // A piece, its receiver and its result, with what hiding holds while it makes them.
    let piece = (size_of::<Piece>()
        + size_of::<Micropolygon>()
        + size_of::<Shading>()
        + size_of::<Receiver>()
        + 16) as f64;
    let pieces_per_pixel = match request.scene {
        Some(_) => 0.7 + 1.0 / f64::from(request.shading_rate.clamp(1e-3, 1e3)),
        None => 1.0,
    };
    let depth = if request.scene.is_none() { 12 * u64::from(request.samples) } else { 0 };
    let per_pixel = (piece * pieces_per_pixel) as u64 + depth + 160;
    let records = request.settings.record_bytes() as f64 * pieces_per_pixel;
    (image, width * (per_pixel + records as u64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::camera_choice::CameraChoice;
    use crate::frame::request::FRAME_AOVS;
    use crate::shade::ShadeSettings;
    use crate::{BakeRequest, EnvironmentSpec, LightSource, Sampling, bake, load_scene};

    /// A picture of 4K of a small octree with all quantities takes little more than its channels.
    #[test]
    fn pictures_take_what_their_channels_and_surfels_take() {
        let mut request = request(Path::new("a.pbgi"), None);
        (request.width, request.height) = (3840, 2160);
        let pixels = 3840 * 2160;
        let (few, _) = frame_bytes(&request, 20_000);
        let channels = pixels * 4 * output::channel_count(&request.aovs) as u64;
        assert!(few > channels && few < channels + 18 * pixels, "{few} {channels}");
        let (many, _) = frame_bytes(&request, 1 << 40);
        assert!(many > few + 2 * size_of::<Shading>() as u64 * (pixels - 20_000));
    }

    fn request<'a>(octree: &'a Path, scene: Option<&'a Scene>) -> FrameRequest<'a> {
        let source = LightSource::Uniform([1.0, 2.0, 3.0]);
        FrameRequest {
            octree,
            scene,
            camera: CameraChoice::Default,
            width: 40,
            height: 150,
            samples: 4,
            shading_rate: 4.0,
            aovs: FRAME_AOVS.to_vec(),
            names: AovNames::default(),
            settings: ShadeSettings {
                environment: Some(EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 }),
                solid_angle_sr: 0.3,
                check_receivers: 9,
                ..ShadeSettings::default()
            },
        }
    }

    #[test]
    fn neither_threads_nor_memory_change_the_image() {
        let folder = tempfile::tempdir().unwrap();
        let octree = folder.path().join("box.pbgi");
        let bake_request = BakeRequest {
            inputs: vec!["demo:cornell".into()],
            output: octree.clone(),
            sampling: Sampling::Surfels(2000),
            ..BakeRequest::default()
        };
        let (progress, cancel) = (Progress::silent(), AtomicBool::new(false));
        bake(&bake_request, &progress, &cancel).unwrap();
        let scene = load_scene("demo:cornell").unwrap();
        for scene in [Some(&scene), None] {
            let make = |threads: usize, memory_bytes: u64| {
                let mut request = request(&octree, scene);
                request.settings = ShadeSettings { threads, memory_bytes, ..request.settings };
                FrameJob::prepare(&request, &cancel).unwrap().run(&progress).unwrap()
            };
            let (one, many) = (make(1, 4 << 30), make(3, 2 << 30));
            assert!(one.image == many.image);
            assert_eq!(one.attributes, many.attributes);
            assert_eq!(one.report.receivers, many.report.receivers);
        }
    }
}
