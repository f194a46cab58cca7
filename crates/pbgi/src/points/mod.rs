//! Shading of points: receivers from a file, or all surfels of an octree, streamed through in chunks, with results as a table or in the scan
//! itself.

pub(crate) mod export;
pub(crate) mod in_memory;
pub(crate) mod results;
pub(crate) mod rows;
pub(crate) mod scan;
pub(crate) mod scatter;
pub(crate) mod table_receivers;

use crate::budget::split::MemorySplit;
use crate::output_path::check_suffix;
use crate::outputs::{Output, OutputKind, RunFiles};
use crate::points::results::ResultWriter;
use crate::points::rows::PointRows;
use crate::points::scan::{ScanReader, is_scan, is_scan_name};
use crate::points::table_receivers::{RowRules, TableReceivers, no_eye};
use crate::shade::nearness::FarReceivers;
use crate::shade::target::spread;
use crate::shade::{
    CHUNK_RECEIVERS, LightSource, Session, ShadeReport, ShadeSettings, chunk_bytes, gloss_toward,
    read_header, up_axis,
};
use crate::{PbgiError, Progress};
use pbgi_cloud::ReceiverTable;
use pbgi_file::folder_of;
use pbgi_format::LeafSurfel;
use pbgi_gather::{Material, Receiver};
use pbgi_math::{DVec3, Vec3};
use pbgi_store::{Octree, try_for_each_leaf};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Where to gather light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PointSource {
    /// At the vertices of a PLY file with positions and normals, whose other columns pass through, or at all points of a
    /// LAS or LAZ file, whose normals are estimated.
    File(PathBuf),
    /// At every surfel of the octree file, in file order. A surfel without a normal looks up.
    Surfels,
}

/// Which points to shade.
#[derive(Clone, Debug)]
pub struct PointsRequest<'a> {
    /// The octree file that lights and blocks.
    pub octree: &'a Path,
    /// The receivers.
    pub source: PointSource,
    /// The file to write: `.npy`, `.csv`, else PLY; `.las` or `.laz` for the scan itself with more dimensions.
    pub target: &'a Path,
    /// Place of the eye that glossy reflections are seen from, in the world.
    pub eye: Option<DVec3>,
    /// Quality, light and resources.
    pub settings: ShadeSettings,
}

impl PointsRequest<'_> {
    /// Refuses a target that is an input, or a file of another kind.
    fn check_files(&self) -> Result<(), PbgiError> {
        let mut files = RunFiles::default();
        files.add_input(self.octree)?;
        if let PointSource::File(path) = &self.source {
            files.add_input(path)?;
        }
        if let Some(LightSource::File(path)) =
            self.settings.environment.as_ref().map(|spec| &spec.source)
        {
            files.add_input(path)?;
        }
        let (path, kind) = (self.target, OutputKind::Points);
        files.add_output(&Output { option: "-o", path, kind, replace: true })
    }
}

/// Bytes of a surfel beside its receiver until it is written: radius, area, albedo.
const SURFEL_BYTES: usize = size_of::<[f32; 5]>();
/// Bytes of a row beside its receiver: position and normal, rounded and as given, and each column.
const ROW_BYTES: usize = 24 + 48;
const COLUMN_BYTES: usize = 12;
/// Bytes that writing a scan may hold: points as they were and as they will be, and a chunk of the compressor.
const SCAN_WRITER_BYTES: u64 = 12 << 20;

/// Shades points and writes position, normal, irradiance in W·m⁻², ambient occlusion (1 is open), sky
/// visibility and bent normal of each, in the order of the source, as a table. The file appears when it is
/// complete. Receivers and results are held a chunk at a time, whatever their number. Columns of the input with the name of a result are replaced by it. A scan that is to come back as LAS or
/// LAZ keeps all it has and gets the dimensions `pbgi_irradiance` (luminance), `pbgi_irradiance_r` to `_b`, `pbgi_ao`
/// and `pbgi_sky_visibility`.
///
/// # Errors
///
/// If a file cannot be read, is damaged, or a setting is out of range; if the result cannot be
/// written; on cancellation.
pub fn shade_points(
    request: &PointsRequest<'_>,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ShadeReport, PbgiError> {
    let start = Instant::now();
    let settings = &request.settings;
    settings.validate()?;
    check_suffix(request.target, &["ply", "npy", "csv", "las", "laz"], "tables")?;
    request.check_files()?;
    let header = read_header(request.octree)?;
    let environment = settings.load_environment(&header)?;
    let mut rows = open_rows(request, up_axis(&header), progress, cancel)?;
    let origin = rows.as_ref().map_or(header.origin, PointRows::origin);
    if rows.is_none() && settings.gloss.is_some() && request.eye.is_none() {
        return Err(no_eye());
    }
    let rules = RowRules { origin: header.origin, eye: request.eye, gloss: settings.gloss };
    let mut writer = ResultWriter::create(request, rows.as_ref(), origin)?;
    let attached =
        rows.as_ref().map_or(SURFEL_BYTES, |rows| ROW_BYTES + COLUMN_BYTES * rows.columns().len());
    let chunk_bytes = chunk_bytes(attached, &request.settings);
    let writer_bytes = if is_scan_name(request.target) { SCAN_WRITER_BYTES } else { 0 };
    let frame_bytes = chunk_bytes + writer_bytes;
    let split = MemorySplit::measure(settings).grant(frame_bytes, frame_bytes)?;
    let extra_readers = usize::from(rows.is_none());
    let mut session =
        Session::open(request.octree, settings, environment, split, extra_readers, cancel)?;
    session.warnings.extend(lost_elements(rows.as_ref(), request.target));
    session.warnings.extend(rows.as_ref().and_then(lost_lists));
    let job = PointsJob { rules, progress, cancel };
    match &mut rows {
        Some(rows) => {
            let sample = job.sample_rows(rows)?;
            let far = job.warn_of_far(&session.octree, &sample, &request.source)?;
            session.warnings.extend(far);
            if session.wants_calibration() {
                session.calibrate(&sample, progress)?;
            }
            job.shade_rows(&mut session, rows, &mut writer)?;
        }
        None => {
            if session.wants_calibration() {
                let sample = job.sample_surfels(&session)?;
                session.calibrate(&sample, progress)?;
            }
            job.shade_surfels(&mut session, &mut writer)?;
        }
    }
    let mut report = session.finish(progress)?;
    writer.finish()?;
    report.total_seconds = start.elapsed().as_secs_f64();
    Ok(report)
}

/// Columns of a file of receivers that its results do not have.
fn lost_lists(rows: &PointRows) -> Option<String> {
    let names = rows.list_columns().join(", ");
    (!names.is_empty()).then(|| format!("columns of lists do not come back: {names}"))
}

/// What of a file of receivers its results do not have, where they are not a PLY file.
fn lost_elements(rows: Option<&PointRows>, target: &Path) -> Option<String> {
    let is_ply = target.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
    let elements = rows.map_or(&[][..], PointRows::other_elements);
    if is_ply || elements.is_empty() {
        return None;
    }
    let names: Vec<String> =
        elements.iter().map(|e| format!("{} rows of `{}`", e.count, e.name)).collect();
    Some(format!(
        "{} has no place for {}; a .ply file keeps them",
        target.display(),
        names.join(", ")
    ))
}

/// The file of receivers, if they come from one, and the number of phases of the run.
fn open_rows(
    request: &PointsRequest<'_>,
    up: Vec3,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<Option<PointRows>, PbgiError> {
    let settings = &request.settings;
    let phases =
        1 + u32::from(settings.target_error.is_some()) + u32::from(settings.check_receivers > 0);
    progress.set_phase_count(phases);
    let PointSource::File(path) = &request.source else { return Ok(None) };
    if !is_scan(path)? {
        return Ok(Some(PointRows::open_table(path)?));
    }
    progress.set_phase_count(phases + 1);
    let temp_dir = folder_of(request.target);
    let scan = ScanReader::open(path, settings, temp_dir, up, progress, cancel)?;
    Ok(Some(PointRows::Scan(scan)))
}

/// What shading of points has at hand besides the session.
struct PointsJob<'a> {
    rules: RowRules,
    /// Receivers handed to the workers at once.
    progress: &'a Progress,
    cancel: &'a AtomicBool,
}

/// Turns surfels into receivers.
#[derive(Clone, Copy)]
struct SurfelReceivers {
    rules: RowRules,
    /// Where surfels without a normal look, and the eye relative to the octree's origin.
    up: Vec3,
    eye: Vec3,
}

impl SurfelReceivers {
    fn receiver(&self, surfel: &LeafSurfel) -> Receiver {
        let material = Material { base_color: surfel.albedo, ..Material::default() };
        let gloss = gloss_toward(self.rules.gloss, material, surfel.center, self.eye);
        let normal = if surfel.isotropic { self.up } else { surfel.normal };
        Receiver { gloss, ..Receiver::diffuse(surfel.center, normal) }
    }
}

impl PointsJob<'_> {
    fn surfel_receivers(&self, session: &Session<'_>) -> SurfelReceivers {
        let RowRules { origin, eye, .. } = self.rules;
        let eye = eye.map_or(Vec3::ZERO, |eye| (eye - origin).as_vec3());
        SurfelReceivers { rules: self.rules, up: session.up(), eye }
    }

    fn check_cancelled(&self) -> Result<(), PbgiError> {
        if self.cancel.load(Ordering::Relaxed) { Err(PbgiError::Interrupted) } else { Ok(()) }
    }

    /// Surfels spread over the file.
    fn sample_surfels(&self, session: &Session<'_>) -> Result<Vec<Receiver>, PbgiError> {
        let receivers = self.surfel_receivers(session);
        let mut wanted = spread(session.octree.header().surfel_count as usize).peekable();
        let mut sample = Vec::new();
        try_for_each_leaf(&mut session.octree.reader(), |first, surfels| {
            self.check_cancelled()?;
            while let Some(index) = wanted.peek() {
                let Some(surfel) = surfels.get(*index - first as usize) else { break };
                sample.push(receivers.receiver(surfel));
                wanted.next();
            }
            Ok::<(), PbgiError>(())
        })?;
        Ok(sample)
    }

    /// Receivers spread over a file, which is read from its start and then starts over.
    fn sample_rows(&self, rows: &mut PointRows) -> Result<Vec<Receiver>, PbgiError> {
        let mut wanted = spread(usize::try_from(rows.count()).unwrap_or(usize::MAX)).peekable();
        let (mut sample, mut table, mut first) = (Vec::new(), ReceiverTable::default(), 0);
        loop {
            self.check_cancelled()?;
            let more = rows.read_chunk(CHUNK_RECEIVERS, &mut table)?;
            let receivers = TableReceivers::new(&table, first as u64, &self.rules)?;
            while let Some(index) = wanted.next_if(|index| *index - first < table.len()) {
                sample.push(receivers.receiver(index - first));
            }
            first += table.len();
            if !more || wanted.peek().is_none() {
                rows.rewind()?;
                return Ok(sample);
            }
        }
    }

    /// What to say where these receivers of a file are not where the surfels are.
    fn warn_of_far(
        &self,
        octree: &Octree,
        sample: &[Receiver],
        source: &PointSource,
    ) -> Result<Option<String>, PbgiError> {
        let PointSource::File(path) = source else { return Ok(None) };
        let place = |receiver: &Receiver| receiver.position.as_dvec3() + self.rules.origin;
        let places: Vec<DVec3> = sample.iter().map(place).collect();
        FarReceivers::warn_of_points(octree, &path.display().to_string(), &places)
    }

    /// Shades the receivers of a file in the order of its rows.
    fn shade_rows(
        &self,
        session: &mut Session<'_>,
        rows: &mut PointRows,
        writer: &mut ResultWriter,
    ) -> Result<(), PbgiError> {
        let passed_columns = writer.passed_columns.clone();
        let phase = self.progress.start_phase("shade", "receivers", Some(rows.count()));
        let mut first = 0;
        session.stream(
            &|done| phase.set_done(done),
            |feed| {
                let mut more = true;
                while more {
                    self.check_cancelled()?;
                    let mut table = ReceiverTable::default();
                    more = rows.read_chunk(CHUNK_RECEIVERS, &mut table)?;
                    let of_table = TableReceivers::new(&table, first, &self.rules)?;
                    first += table.len() as u64;
                    let receivers = (0..table.len()).map(|row| of_table.receiver(row)).collect();
                    feed.push(Cow::Owned(receivers), table)?;
                }
                Ok(())
            },
            |chunk| {
                let table = &chunk.attached;
                for (row, shading) in chunk.shadings.iter().enumerate() {
                    let others = passed_columns.iter().map(|i| table.columns[*i].value(row));
                    writer.write(table.given[row], shading, others)?;
                }
                Ok(())
            },
        )
    }

    /// Shades every surfel in the order of the file.
    fn shade_surfels(
        &self,
        session: &mut Session<'_>,
        writer: &mut ResultWriter,
    ) -> Result<(), PbgiError> {
        let receiver_of = self.surfel_receivers(session);
        let octree = Arc::clone(&session.octree);
        let total = octree.header().surfel_count;
        let phase = self.progress.start_phase("shade", "surfels", Some(total));
        session.stream(
            &|done| phase.set_done(done),
            |feed| {
                let (mut receivers, mut others) = (Vec::new(), Vec::new());
                try_for_each_leaf(&mut octree.reader(), |_, surfels| {
                    self.check_cancelled()?;
                    for surfel in surfels {
                        receivers.push(receiver_of.receiver(surfel));
                        let [r, g, b] = surfel.albedo;
                        others.push([surfel.radius, surfel.area, r, g, b]);
                        if receivers.len() == CHUNK_RECEIVERS {
                            let receivers = std::mem::take(&mut receivers);
                            feed.push(Cow::Owned(receivers), std::mem::take(&mut others))?;
                        }
                    }
                    Ok::<(), PbgiError>(())
                })?;
                feed.push(Cow::Owned(receivers), others)
            },
            |chunk| {
                let results = chunk.receivers.iter().zip(&chunk.shadings).zip(chunk.attached);
                for ((receiver, shading), others) in results {
                    let place = receiver.position.as_dvec3() + self.rules.origin;
                    let [nx, ny, nz] = receiver.normal.as_dvec3().to_array();
                    let given = [place.x, place.y, place.z, nx, ny, nz];
                    writer.write(given, shading, others.map(f64::from))?;
                }
                Ok(())
            },
        )
    }
}
