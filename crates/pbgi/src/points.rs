//! Shading of points: receivers from a file, or all surfels of an octree, with results as a table or in the scan itself.

use crate::memory_split::MemorySplit;
use crate::output_path::folder_of;
use crate::scan::{is_scan, is_scan_name, read_scan};
use crate::shade::{CHUNK_RECEIVERS, Session, ShadeReport, ShadeSettings, read_header, up_axis};
use crate::table_receivers::{TableReceivers, no_eye};
use crate::target::spread;
use crate::{PbgiError, Progress};
use pbgi_cloud::{LasResultWriter, ReceiverTable, RowWriter};
use pbgi_format::LeafSurfel;
use pbgi_math::{DVec3, Vec3};
use pbgi_schedule::{Material, Receiver, Shading};
use pbgi_store::try_for_each_leaf;
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

/// Columns of every result, before those that pass through.
const RESULT_COLUMNS: [&str; 14] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "irradiance_r",
    "irradiance_g",
    "irradiance_b",
    "ao",
    "sky_visibility",
    "bent_nx",
    "bent_ny",
    "bent_nz",
];

/// Columns of glossy reflections, after those.
const GLOSS_COLUMNS: [&str; 3] =
    ["specular_indirect_r", "specular_indirect_g", "specular_indirect_b"];

/// Columns of a surfel that go with it.
const SURFEL_COLUMNS: [&str; 5] = ["radius", "area", "albedo_r", "albedo_g", "albedo_b"];

/// Bytes held per receiver of a table beyond its columns, and of a chunk beside it.
const RECEIVER_BYTES: u64 = size_of::<Receiver>() as u64;
const CHUNK_BYTES: u64 = (CHUNK_RECEIVERS * 4 * (size_of::<Shading>() + 64)) as u64;

/// Shades points and writes position, normal, irradiance in W·m⁻², ambient occlusion (1 is open), sky
/// visibility and bent normal of each, in the order of the source, as a table. The file appears when it is
/// complete. Columns of the input with the name of a result are replaced by it. A scan that is to come back as LAS or
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
    let header = read_header(request.octree)?;
    let environment =
        settings.environment.as_ref().map(|e| e.load(header.flags.z_up)).transpose()?;
    let has_normals = match &request.source {
        PointSource::File(path) => !is_scan(path)?,
        PointSource::Surfels => true,
    };
    let phases = 1
        + u32::from(!has_normals)
        + u32::from(settings.target_error.is_some())
        + u32::from(settings.check_receivers > 0);
    progress.set_phase_count(phases);
    let table = match &request.source {
        PointSource::File(path) if !has_normals => {
            let (temp_dir, up) = (folder_of(request.target), up_axis(&header));
            Some(read_scan(path, settings, temp_dir, up, progress, cancel)?)
        }
        PointSource::File(path) => Some(ReceiverTable::read(path)?),
        PointSource::Surfels => None,
    };
    let origin = table.as_ref().map_or(header.origin, |table| table.origin);
    let has_gloss = settings.gloss.is_some();
    let rows = table
        .as_ref()
        .map(|table| TableReceivers::new(table, header.origin, request.eye, has_gloss))
        .transpose()?;
    let eye = match request.eye {
        Some(eye) => (eye - header.origin).as_vec3(),
        None if has_gloss && rows.is_none() => return Err(no_eye()),
        None => Vec3::ZERO,
    };
    let mut writer = ResultWriter::create(request, table.as_ref(), origin)?;
    let count = table.as_ref().map_or(0, |t| t.len() as u64);
    let frame_bytes = count * RECEIVER_BYTES + CHUNK_BYTES;
    let split = MemorySplit::measure(settings.memory_bytes, settings.threads)
        .grant(frame_bytes, frame_bytes)?;
    let extra_readers = usize::from(table.is_none());
    let mut session =
        Session::open(request.octree, settings, environment, split, extra_readers, cancel)?;
    match (&table, &rows) {
        (Some(table), Some(rows)) => {
            if session.wants_calibration() {
                let sample: Vec<Receiver> =
                    spread(table.len()).map(|row| rows.receiver(&session, row)).collect();
                session.calibrate(&sample, progress)?;
            }
            shade_table(&mut session, table, rows, &mut writer, progress)?;
        }
        _ => {
            if session.wants_calibration() {
                let sample = sample_surfels(&session, eye, cancel)?;
                session.calibrate(&sample, progress)?;
            }
            shade_surfels(&mut session, eye, header.origin, &mut writer, progress, cancel)?;
        }
    }
    let mut report = session.finish(progress)?;
    writer.finish()?;
    report.total_seconds = start.elapsed().as_secs_f64();
    Ok(report)
}

/// A surfel as a receiver; one without a normal looks up.
fn surfel_receiver(session: &Session<'_>, surfel: &LeafSurfel, eye: Vec3) -> Receiver {
    let material = Material { base_color: surfel.albedo, ..Material::default() };
    let gloss = session.gloss(material, surfel.center, eye);
    let normal = if surfel.isotropic { session.up() } else { surfel.normal };
    Receiver { position: surfel.center, normal, gloss }
}

/// Surfels spread over the file.
fn sample_surfels(
    session: &Session<'_>,
    eye: Vec3,
    cancel: &AtomicBool,
) -> Result<Vec<Receiver>, PbgiError> {
    let mut wanted = spread(session.octree.header().surfel_count as usize).peekable();
    let mut sample = Vec::new();
    try_for_each_leaf(&mut session.octree.reader(), |first, surfels| {
        if cancel.load(Ordering::Relaxed) {
            return Err(PbgiError::Interrupted);
        }
        while let Some(index) = wanted.peek() {
            let Some(surfel) = surfels.get(*index - first as usize) else { break };
            sample.push(surfel_receiver(session, surfel, eye));
            wanted.next();
        }
        Ok(())
    })?;
    Ok(sample)
}

/// Shades the receivers of a table in the order of its rows.
fn shade_table(
    session: &mut Session<'_>,
    table: &ReceiverTable,
    receivers_of: &TableReceivers<'_>,
    writer: &mut ResultWriter,
    progress: &Progress,
) -> Result<(), PbgiError> {
    let passed_columns = writer.passed_columns.clone();
    let phase = progress.start_phase("shade", "receivers", Some(table.len() as u64));
    for first in (0..table.len()).step_by(CHUNK_RECEIVERS) {
        let rows = first..(first + CHUNK_RECEIVERS).min(table.len());
        let receivers: Vec<Receiver> =
            rows.clone().map(|row| receivers_of.receiver(session, row)).collect();
        let shadings =
            session.shade(&receivers, None, &|done| phase.set_done(first as u64 + done))?;
        for (row, shading) in rows.zip(&shadings) {
            let position = table.positions[row].as_dvec3() + table.origin;
            let others = passed_columns.iter().map(|index| table.columns[*index].values[row]);
            writer.write(position, table.normals[row], shading, others)?;
        }
    }
    Ok(())
}

/// Shades every surfel in the order of the file, a chunk at a time.
fn shade_surfels(
    session: &mut Session<'_>,
    eye: Vec3,
    origin: DVec3,
    writer: &mut ResultWriter,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<(), PbgiError> {
    let octree = Arc::clone(&session.octree);
    let phase = progress.start_phase("shade", "surfels", Some(octree.header().surfel_count));
    let mut done = 0;
    let mut shade = |chunk: &mut Vec<LeafSurfel>| -> Result<(), PbgiError> {
        let receivers: Vec<Receiver> =
            chunk.iter().map(|s| surfel_receiver(session, s, eye)).collect();
        let shadings = session.shade(&receivers, None, &|now| phase.set_done(done + now))?;
        done += chunk.len() as u64;
        for (surfel, (receiver, shading)) in chunk.iter().zip(receivers.iter().zip(&shadings)) {
            let position = surfel.center.as_dvec3() + origin;
            let others = [surfel.radius, surfel.area].into_iter().chain(surfel.albedo);
            writer.write(position, receiver.normal, shading, others)?;
        }
        chunk.clear();
        Ok(())
    };
    let mut chunk = Vec::with_capacity(CHUNK_RECEIVERS);
    try_for_each_leaf(&mut octree.reader(), |_, surfels| {
        if cancel.load(Ordering::Relaxed) {
            return Err(PbgiError::Interrupted);
        }
        // Leaves hold at most 255 surfels: a chunk is full before it has to grow.
        chunk.extend_from_slice(surfels);
        if chunk.len() + 255 > CHUNK_RECEIVERS { shade(&mut chunk) } else { Ok(()) }
    })?;
    shade(&mut chunk)
}

/// Dimensions that a scan comes back with: luminance of the irradiance (Rec. 709) and its channels, W·m⁻².
const SCAN_DIMENSIONS: [&str; 6] = [
    "pbgi_irradiance",
    "pbgi_irradiance_r",
    "pbgi_irradiance_g",
    "pbgi_irradiance_b",
    "pbgi_ao",
    "pbgi_sky_visibility",
];

/// Results on their way into a file.
struct ResultWriter {
    target: Target,
    /// Whether rows have columns of glossy reflections.
    has_gloss: bool,
    /// Columns of the input that pass through.
    passed_columns: Vec<usize>,
}

enum Target {
    /// A table, and the row under way.
    Rows(RowWriter, Vec<f64>),
    /// The scan again, and values to be written.
    Scan(Box<LasResultWriter>, Vec<f32>),
}

impl ResultWriter {
    /// Starts the file: the scan of the source again where `target` is named as one; else rows of results, then columns
    /// of `table`, or those of surfels without one. Positions are doubles where coordinates are relative to an `origin`.
    fn create(
        request: &PointsRequest<'_>,
        table: Option<&ReceiverTable>,
        origin: DVec3,
    ) -> Result<Self, PbgiError> {
        let target = request.target;
        if is_scan_name(target) {
            return match &request.source {
                PointSource::File(path) if is_scan(path)? => {
                    let writer = LasResultWriter::create(path, target, &SCAN_DIMENSIONS)?;
                    let target = Target::Scan(Box::new(writer), Vec::new());
                    Ok(Self { target, has_gloss: false, passed_columns: Vec::new() })
                }
                _ => Err(PbgiError::usage(format!(
                    "{}: only the points of LAS and LAZ files come back as such; name a .ply, .npy or .csv file",
                    target.display()
                ))),
            };
        }
        let double_count = if origin == DVec3::ZERO { 0 } else { 3 };
        let mut names: Vec<&str> = RESULT_COLUMNS.to_vec();
        let has_gloss = request.settings.gloss.is_some();
        names.extend(GLOSS_COLUMNS.iter().filter(|_| has_gloss));
        let mut passed_columns = Vec::new();
        match table {
            None => names.extend(SURFEL_COLUMNS),
            Some(table) => {
                for (index, column) in table.columns.iter().enumerate() {
                    if !names.contains(&column.name.as_str()) {
                        names.push(&column.name);
                        passed_columns.push(index);
                    }
                }
            }
        }
        let writer = RowWriter::create(target, &names, double_count)?;
        let target = Target::Rows(writer, Vec::new());
        Ok(Self { target, has_gloss, passed_columns })
    }

    /// Appends the result of a receiver and, in tables, what goes with it.
    fn write(
        &mut self,
        position: DVec3,
        normal: Vec3,
        shading: &Shading,
        others: impl IntoIterator<Item = f32>,
    ) -> Result<(), PbgiError> {
        let irradiance = shading.irradiance();
        let open = [shading.ambient_occlusion, shading.sky_visibility];
        match &mut self.target {
            Target::Rows(writer, row) => {
                row.clear();
                row.extend(position.to_array());
                let floats = normal.to_array().into_iter().chain(irradiance).chain(open);
                let reflected = shading.reflected.into_iter().filter(|_| self.has_gloss);
                let floats = floats.chain(shading.bent_normal.to_array());
                let floats = floats.chain(reflected).chain(others);
                row.extend(floats.map(f64::from));
                writer.write_rows(row)?;
            }
            Target::Scan(writer, values) => {
                let [r, g, b] = irradiance;
                values.extend([0.2126 * r + 0.7152 * g + 0.0722 * b, r, g, b]);
                values.extend(open);
                if values.len() >= CHUNK_RECEIVERS {
                    writer.write(values)?;
                    values.clear();
                }
            }
        }
        Ok(())
    }

    /// Completes the file.
    fn finish(self) -> Result<u64, PbgiError> {
        match self.target {
            Target::Rows(writer, _) => Ok(writer.finish()?),
            Target::Scan(mut writer, values) => {
                writer.write(&values)?;
                Ok(writer.finish()?)
            }
        }
    }
}
