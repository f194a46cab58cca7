//! A picture: what a camera sees, shaded, as an image with many channels.

pub(crate) mod band;
pub(crate) mod camera_choice;
pub(crate) mod camera_file;
pub(crate) mod contact;
pub(crate) mod output;
pub(crate) mod preview;
pub(crate) mod request;
pub(crate) mod splat;

use crate::budget::split::MemorySplit;
use crate::frame::band::{Band, Piece};
use crate::frame::camera_choice::CameraContext;
use crate::frame::preview::Preview;
use crate::frame::request::FrameRequest;
use crate::frame::splat::hide_surfels;
use crate::shade::target::spread;
use crate::shade::{Session, ShadeReport, read_header, up_axis};
use crate::{PbgiError, Progress};
use output::FrameImage;
use pbgi_format::Header;
use pbgi_gather::{Receiver, Shading};
use pbgi_image::{
    Aov, AovNames, AttributeValue, Image, ImageWindow, Planes, StoredChannel, exr_write_bytes,
    write_planes_exr,
};
use pbgi_math::{Aabb, DVec3};
use pbgi_scene::{CameraView, Micropolygon, PixelWindow, Scene, hide};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A shaded picture with what is known of it.
#[derive(Debug)]
pub struct Frame {
    /// Attributes for the EXR file: camera, settings, measured error. They depend on the request only.
    pub attributes: Vec<(String, AttributeValue)>,
    /// What shading did.
    pub report: ShadeReport,
    /// The channels.
    pub(crate) planes: Planes,
    /// Where the pixels lie in what the camera saw.
    pub(crate) window: ImageWindow,
    /// The quantities, each with the names of its channels.
    pub(crate) layers: Vec<(Aov, Vec<String>)>,
    /// Channels of another file that go along as they are.
    pub(crate) passed: Vec<StoredChannel>,
    pub(crate) preview: Preview,
}

impl Frame {
    /// All channels, in memory.
    ///
    /// # Errors
    ///
    /// If those that wait on disk cannot be read.
    pub fn image(&self) -> Result<Image, PbgiError> {
        Ok(self.planes.to_image()?)
    }

    /// Writes all channels and attributes as an EXR file, whole or not at all.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_exr(&self, path: &Path) -> Result<(), PbgiError> {
        let Self { planes, passed, window, attributes, .. } = self;
        Ok(write_planes_exr(path, planes, passed, window, attributes)?)
    }

    /// Writes the beauty as an 8-bit picture with a filmic curve, or ambient occlusion as it is where
    /// there is no light. `exposure` is in stops; without it, one that suits the surfaces is chosen.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write_preview(&self, path: &Path, exposure: Option<f32>) -> Result<(), PbgiError> {
        self.preview.write(path, exposure)
    }
}

/// Makes a picture.
///
/// The image does not depend on threads or memory limit. It is made in bands of 64 rows, which wait on disk
/// ([`FrameRequest::scratch`]) where the limit does not hold the whole image.
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
    /// Where rows that are done wait, if the limit does not hold them.
    scratch: Option<&'a Path>,
    /// Surfels that the band before has shown.
    shown: Shown,
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

/// Pixels along an edge of a tile of hiding: bands and windows of whole tiles shade nothing twice.
const TILE_EDGE: u32 = 64;

/// Most columns of a window of a band. Pieces share within a window, so that its size must not follow the memory limit.
const WINDOW_COLUMNS_MAX: u32 = 1024;

/// Most surfels that are shaded at once.
const SURFELS_AT_ONCE: usize = (TILE_EDGE * WINDOW_COLUMNS_MAX) as usize;

/// Windows of about equal parts that a band consists of: first column and number of columns. Each has its turn for micropolygons. Surfels,
/// for which the whole file is read, are drawn all along the band.
fn windows_of(request: &FrameRequest<'_>) -> Vec<(u32, u32)> {
    if request.scene.is_none() {
        return vec![(0, request.width)];
    }
    let tiles = request.width.div_ceil(TILE_EDGE);
    let count = tiles.div_ceil(WINDOW_COLUMNS_MAX / TILE_EDGE);
    let start = |window: u32| {
        let tile = u64::from(window) * u64::from(tiles) / u64::from(count);
        (tile as u32 * TILE_EDGE).min(request.width)
    };
    (0..count).map(|window| (start(window), start(window + 1) - start(window))).collect()
}

impl<'a> FrameJob<'a> {
    fn prepare(request: &'a FrameRequest<'a>, cancel: &'a AtomicBool) -> Result<Self, PbgiError> {
        let start = Instant::now();
        let settings = &request.settings;
        // What memory is asked for follows from it.
        request.hide_options(None).check_shading_rate()?;
        let header = read_header(request.octree)?;
        let environment = settings.load_environment(&header)?;
        let split = MemorySplit::measure(settings);
        let needs = FrameBytes::of(request, header.surfel_count);
        let (split, scratch) = needs.grant(split, request.scratch)?;
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
        let shown = Shown::default();
        Ok(Self { request, header, session, view, origin, scratch, shown, cancel, start })
    }

    fn run(mut self, progress: &Progress) -> Result<Frame, PbgiError> {
        let mut image = FrameImage::new(self.request, self.session.is_lit(), self.scratch)?;
        let (bands, windows) = (self.request.height.div_ceil(TILE_EDGE), windows_of(self.request));
        let mut seen = Seen::default();
        let extra = u32::from(self.request.settings.check_receivers > 0)
            + u32::from(self.session.wants_calibration());
        progress.set_phase_count(2 * bands * windows.len() as u32 + extra);
        self.calibrate(progress)?;
        for y in (0..self.request.height).step_by(TILE_EDGE as usize) {
            let height = TILE_EDGE.min(self.request.height - y);
            image.start_band(y, height);
            for (x, width) in &windows {
                let window = PixelWindow { x: *x, y, width: *width, height };
                self.add_window(&mut image, window, &mut seen, progress)?;
            }
            image.finish_band()?;
        }
        self.judge(&seen)?;
        self.finish(image, progress)
    }

    /// Hides and shades a window of a band.
    fn add_window(
        &mut self,
        image: &mut FrameImage,
        window: PixelWindow,
        seen: &mut Seen,
        progress: &Progress,
    ) -> Result<(), PbgiError> {
        if self.cancel.load(Ordering::Relaxed) {
            return Err(PbgiError::Interrupted);
        }
        let phase = progress.start_phase("hide", "rows", Some(u64::from(window.height)));
        let visible = self.hide(window)?;
        phase.set_done(u64::from(window.height));
        drop(phase);
        seen.count(&visible);
        let count = visible.pieces.len() as u64;
        let phase = progress.start_phase("shade", "receivers", Some(count));
        let shadings = self.shade(&visible, &|done| phase.set_done(done))?;
        drop(phase);
        let background = self.session.environment.as_ref();
        image.put(&visible, &shadings, background, &self.view, self.origin);
        if self.request.scene.is_none() {
            self.shown = Shown { ids: visible.ids, shadings };
        }
        Ok(())
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

    /// Shades the pieces of a window. Surfels that the band before has shown are not shaded again.
    fn shade(
        &mut self,
        band: &Band,
        advance: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Shading>, PbgiError> {
        if band.ids.is_empty() {
            let receivers: Vec<Receiver> =
                band.pieces.iter().map(|piece| self.receiver_of(piece)).collect();
            return self.session.shade(&receivers, None, advance);
        }
        let mut shadings: Vec<Shading> =
            band.ids.iter().map(|id| self.shown.find(*id).unwrap_or_default()).collect();
        let new: Vec<usize> =
            (0..band.ids.len()).filter(|i| self.shown.find(band.ids[*i]).is_none()).collect();
        let mut done = 0;
        for chunk in new.chunks(SURFELS_AT_ONCE) {
            let receivers: Vec<Receiver> =
                chunk.iter().map(|i| self.receiver_of(&band.pieces[*i])).collect();
            let ids: Vec<u64> = chunk.iter().map(|i| band.ids[*i]).collect();
            let shaded =
                self.session.shade(&receivers, Some(&ids), &|count| advance(done + count))?;
            chunk.iter().zip(shaded).for_each(|(i, shading)| shadings[*i] = shading);
            done += chunk.len() as u64;
        }
        Ok(shadings)
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
        let mut report = self.session.finish(progress)?;
        report.total_seconds = self.start.elapsed().as_secs_f64();
        let attributes = output::frame_attributes(self.request, &self.view, self.origin, &report);
        let (planes, preview) = image.finish();
        let window = ImageWindow::whole(planes.width(), planes.height());
        let passed = Vec::new();
        let layers = layers_of(&self.request.aovs, &self.request.names);
        Ok(Frame { planes, attributes, report, window, layers, passed, preview })
    }
}

/// Surfels that a band has shown, in the order of their numbers in the file, with their results.
#[derive(Default)]
struct Shown {
    ids: Vec<u64>,
    shadings: Vec<Shading>,
}

impl Shown {
    fn find(&self, id: u64) -> Option<Shading> {
        self.ids.binary_search(&id).ok().map(|index| self.shadings[index])
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

/// Estimated bytes of a picture.
#[derive(Clone, Copy, Debug)]
struct FrameBytes {
    /// The whole image.
    image: u64,
    /// What is held while a band is made, or while the image is written.
    work: u64,
}

impl FrameBytes {
    /// Those of a picture of an octree of so many surfels.
    fn of(request: &FrameRequest<'_>, surfel_count: u64) -> Self {
        let (width, height) = (u64::from(request.width), u64::from(request.height));
        let channels = output::channel_count(&request.aovs);
        let planes = (channels + output::preview_channel_count(true)) as u64;
        let pixel = planes * size_of::<f32>() as u64;
        let band = width * u64::from(TILE_EDGE);
        let window = match request.scene {
            Some(_) => micropolygon_bytes(request),
            None => surfel_bytes(request, band, surfel_count),
        };
        let writing =
            exr_write_bytes(request.width as usize, request.height as usize, channels) as u64;
        Self { image: width * height * pixel, work: (band * pixel + window).max(writing) }
    }

    /// Grants the image in memory where as much is left for the page cache, else in a scratch file if there is a folder for it; returns that
    /// folder, too.
    fn grant<'a>(
        &self,
        split: MemorySplit,
        folder: Option<&'a Path>,
    ) -> Result<(MemorySplit, Option<&'a Path>), PbgiError> {
        let grant = |bytes: u64| split.grant(bytes, bytes);
        let in_memory = self.image + self.work;
        let is_roomy = grant(in_memory.saturating_add(self.image)).is_ok();
        let scratch = folder.filter(|_| !is_roomy);
        let bytes = if scratch.is_some() { self.work } else { in_memory };
        let hint = |e| PbgiError::budget(format!("{e}; fewer quantities take less (--aovs)"));
        Ok((grant(bytes).map_err(hint)?, scratch))
    }
}

/// Bytes of a window of micropolygons.
fn micropolygon_bytes(request: &FrameRequest<'_>) -> u64 {
    let columns = windows_of(request).into_iter().map(|(_, columns)| columns).max().unwrap_or(0);
    // A piece, its receiver and its result, with what hiding holds while it makes them.
    let piece = size_of::<Piece>()
        + size_of::<Micropolygon>()
        + size_of::<Shading>()
        + size_of::<Receiver>()
        + 16;
    let piece = piece as u64 + request.settings.record_bytes();
    let pieces_per_pixel = 0.7 + 1.0 / f64::from(request.shading_rate.clamp(1e-3, 1e3));
    let per_pixel = (piece as f64 * pieces_per_pixel) as u64 + PIXEL_BYTES;
    u64::from(columns * TILE_EDGE) * per_pixel
}

/// Bytes of a pixel with its fragments and what they mix to.
const PIXEL_BYTES: u64 = 160;

/// Bytes of a band of so many pixels of an octree of so many surfels: about one per pixel is seen, if there are as many.
fn surfel_bytes(request: &FrameRequest<'_>, pixels: u64, surfel_count: u64) -> u64 {
    let depth = 12 * u64::from(request.samples);
    // Of the band before, too, there are results.
    let result = 8 + size_of::<Shading>() as u64;
    let surfel = size_of::<Piece>() as u64 + 8 + 2 * result;
    let receiver = 8 + (size_of::<Receiver>() + size_of::<Shading>()) as u64;
    let receiver = receiver + request.settings.record_bytes();
    let seen = pixels.min(surfel_count);
    let at_once = seen.min(SURFELS_AT_ONCE as u64);
    pixels * (depth + PIXEL_BYTES) + seen * surfel + at_once * receiver
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::camera_choice::CameraChoice;
    use crate::frame::request::FRAME_AOVS;
    use crate::shade::ShadeSettings;
    use crate::{BakeRequest, EnvironmentSpec, LightSource, Sampling, bake, load_scene};
    use std::path::PathBuf;
    use std::sync::atomic::AtomicU64;

    /// A picture of 4K of a small octree with all quantities takes little more than its channels, and a band of it little, whatever the
    /// octree's size.
    #[test]
    fn pictures_take_what_their_channels_take_and_bands_of_them_little() {
        let scene = load_scene("demo:cornell").unwrap();
        for (scene, most) in [(None, 300), (Some(&scene), 140)] {
            let mut request = request(Path::new("a.pbgi"), scene);
            (request.width, request.height, request.shading_rate) = (3840, 2160, 1.0);
            let pixels = 3840 * 2160;
            let needs = FrameBytes::of(&request, 1 << 40);
            let channels = pixels * 4 * output::channel_count(&request.aovs) as u64;
            assert!(needs.image > channels && needs.image < channels + 18 * pixels, "{needs:?}");
            assert!(needs.work < most << 20, "{needs:?}");
            request.height *= 2;
            assert_eq!(FrameBytes::of(&request, 1 << 40).work, needs.work);
        }
        let few = FrameBytes::of(&request(Path::new("a.pbgi"), None), 20);
        let many = FrameBytes::of(&request(Path::new("a.pbgi"), None), 2000);
        assert!(few.work <= many.work);
    }

    #[test]
    fn windows_are_about_equal_and_whole_tiles() {
        let scene = load_scene("demo:cornell").unwrap();
        let mut request = request(Path::new("a.pbgi"), Some(&scene));
        for (width, count) in [(1, 1), (1024, 1), (1025, 2), (2000, 2), (3840, 4), (65_536, 64)] {
            request.width = width;
            let windows = windows_of(&request);
            assert_eq!(windows.len(), count);
            let mut end = 0;
            for (x, columns) in &windows {
                assert!(*x == end && x % 64 == 0 && (1..=1024).contains(columns), "{windows:?}");
                end += columns;
            }
            assert_eq!(end, width);
        }
        request.scene = None;
        assert_eq!(windows_of(&request), [(0, 65_536)]);
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
            scratch: None,
            settings: ShadeSettings {
                environment: Some(EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 }),
                solid_angle_sr: 0.3,
                check_receivers: 9,
                ..ShadeSettings::default()
            },
        }
    }

    /// The picture of an octree that is baked for a test.
    fn bake_box(folder: &Path) -> PathBuf {
        let octree = folder.join("box.pbgi");
        let bake_request = BakeRequest {
            inputs: vec!["demo:cornell".into()],
            output: octree.clone(),
            sampling: Sampling::Surfels(2000),
            ..BakeRequest::default()
        };
        bake(&bake_request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
        octree
    }

    fn make(request: &FrameRequest<'_>, threads: usize, memory_bytes: u64) -> Frame {
        let mut request = request.clone();
        request.settings = ShadeSettings { threads, memory_bytes, ..request.settings };
        let cancel = AtomicBool::new(false);
        FrameJob::prepare(&request, &cancel).unwrap().run(&Progress::silent()).unwrap()
    }

    #[test]
    fn neither_threads_nor_memory_change_the_image() {
        let folder = tempfile::tempdir().unwrap();
        let octree = bake_box(folder.path());
        let scene = load_scene("demo:cornell").unwrap();
        for scene in [Some(&scene), None] {
            let request = request(&octree, scene);
            let (one, many) = (make(&request, 1, 4 << 30), make(&request, 3, 2 << 30));
            assert!(one.image().unwrap() == many.image().unwrap());
            assert_eq!(one.attributes, many.attributes);
            assert_eq!(one.report.receivers, many.report.receivers);
        }
    }

    /// Several windows, in memory and in a scratch file: all files are the same.
    #[test]
    fn rows_that_wait_on_disk_are_those_of_memory() {
        let folder = tempfile::tempdir().unwrap();
        let octree = bake_box(folder.path());
        let scene = load_scene("demo:cornell").unwrap();
        let waiting = folder.path().join("waiting");
        std::fs::create_dir(&waiting).unwrap();
        for scene in [Some(&scene), None] {
            let mut request = request(&octree, scene);
            (request.width, request.height, request.samples) = (1300, 70, 1);
            request.shading_rate = 64.0;
            request.settings.interpolation = 0.1;
            request.scratch = Some(&waiting);
            let needs = FrameBytes::of(&request, 2000);
            let split = MemorySplit::measure(&request.settings);
            let is_scratch = |spare: u64| {
                let mut split = split;
                split.limit_bytes = split.held_bytes + spare;
                needs.grant(split, Some(&waiting)).unwrap().1.is_some()
            };
            let roomy = needs.work + 3 * needs.image;
            let tight = needs.work + needs.image + (5 << 20);
            assert!(is_scratch(tight) && !is_scratch(roomy), "{needs:?}");
            let files = [(2, 4 << 30, true), (1, 4 << 30, false), (3, 4 << 30, false)].map(
                |(threads, memory_bytes, scratch)| {
                    let mut request = request.clone();
                    request.settings = ShadeSettings { threads, memory_bytes, ..request.settings };
                    let (cancel, progress) = (AtomicBool::new(false), Progress::silent());
                    let mut job = FrameJob::prepare(&request, &cancel).unwrap();
                    job.scratch = scratch.then_some(&waiting);
                    let frame = job.run(&progress).unwrap();
                    ["a.exr", "a.png", "c.png"].map(|name| {
                        let path = folder.path().join(name);
                        match name {
                            "a.exr" => frame.write_exr(&path).unwrap(),
                            "a.png" => frame.write_preview(&path, None).unwrap(),
                            _ => frame.write_contact_sheet(&path, None).unwrap(),
                        }
                        std::fs::read(path).unwrap()
                    })
                },
            );
            assert!(files[0] == files[1] && files[0] == files[2]);
            assert!(files[0].iter().all(|file| file.len() > 1000));
        }
        assert_eq!(std::fs::read_dir(&waiting).unwrap().count(), 0);
    }

    /// Where each receiver gathers for itself, a surfel that two bands show has one result.
    #[test]
    fn surfels_of_the_band_before_keep_their_results() {
        let folder = tempfile::tempdir().unwrap();
        let octree = bake_box(folder.path());
        let request = request(&octree, None);
        let cancel = AtomicBool::new(false);
        let mut job = FrameJob::prepare(&request, &cancel).unwrap();
        let [above, below] =
            [0, 64].map(|y| job.hide(PixelWindow { x: 0, y, width: 40, height: 64 }).unwrap());
        let shadings = job.shade(&above, &|_| ()).unwrap();
        let fresh = job.shade(&below, &|_| ()).unwrap();
        job.shown = Shown { ids: above.ids, shadings };
        let known = below.ids.iter().filter(|id| job.shown.find(**id).is_some()).count();
        assert!((1..below.ids.len()).contains(&known), "{known} of {}", below.ids.len());
        let done = AtomicU64::new(0);
        let kept = job.shade(&below, &|count| done.store(count, Ordering::Relaxed)).unwrap();
        assert!(kept == fresh);
        assert_eq!(done.into_inner() as usize, below.ids.len() - known);
    }

    /// Windows show what the whole picture shows.
    #[test]
    fn windows_stand_where_they_belong() {
        let folder = tempfile::tempdir().unwrap();
        let octree = bake_box(folder.path());
        let scene = load_scene("demo:cornell").unwrap();
        let mut request = request(&octree, Some(&scene));
        (request.width, request.height, request.samples) = (1300, 70, 1);
        request.shading_rate = 64.0;
        request.aovs = vec![Aov::Depth];
        let image = make(&request, 2, 4 << 30).image().unwrap();
        let view = FrameJob::prepare(&request, &AtomicBool::new(false)).unwrap().view;
        let visible = hide(&scene, &view, &request.hide_options(None)).unwrap();
        let pieces: Vec<Piece> = visible.micropolygons.iter().map(Piece::from).collect();
        let whole = Band { pieces, ids: Vec::new(), coverage: visible.coverage };
        let expected: Vec<f32> = (0..whole.coverage.pixel_count())
            .map(|pixel| output::PixelSurface::new(&whole, pixel, &view, scene.origin).depth)
            .collect();
        assert!(image.channels[0].data == expected);
    }
}
