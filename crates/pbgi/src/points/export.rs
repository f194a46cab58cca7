//! The surfels of an octree file in the formats of others.

use crate::PbgiError;
use crate::bake::relight::check_canceled;
use crate::budget::bake::reader_cache_bytes;
use crate::figures::format_count;
use crate::inspect::open;
use crate::outputs::{Output, OutputKind, RunFiles, check_writable};
use crate::progress::Progress;
use pbgi_cloud::{PlyWriter, PtcPoint, PtcWriter};
use pbgi_format::{Channels, Header, LeafSurfel};
use pbgi_math::{DVec3, Vec3};
use pbgi_store::try_for_each_leaf;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Surfels gathered before they are written.
const EXPORT_SURFELS: usize = 4096;

/// Writes all surfels of an octree file in its order. Positions are those of the world; isotropic surfels have the
/// normal 0. Returns the number of surfels.
///
/// The extension of `output` decides: `.ptc` makes a RenderMan point cloud, with `_area`, and `_radiosity` (π times the
/// radiance) and `_albedo` where the octree stores them; its positions are `f32`. Everything else makes a PLY file with
/// `x y z nx ny nz radius area`, then `radiance_r …` and `albedo_r …` where stored, positions being `double` where the
/// origin is not 0.
///
/// # Errors
///
/// If the octree is damaged, or `output` exists without `force` or cannot be written.
pub fn export_points(
    path: &Path,
    output: &Path,
    force: bool,
    memory_limit: u64,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<u64, PbgiError> {
    let mut files = RunFiles::default();
    files.add_input(path)?;
    let kind = OutputKind::Points;
    files.add_output(&Output { option: "--points", path: output, kind, replace: force })?;
    check_writable(output)?;
    let octree = open(path, reader_cache_bytes(memory_limit))?;
    let header = octree.header();
    let mut export = Export::create(output, header)?;
    if matches!(export, Export::Ptc { .. }) && header.origin != DVec3::ZERO {
        progress.warn("positions of .ptc files are f32: coordinates far from 0 lose digits");
    }
    let phase = progress.start_phase("export", "surfels", Some(header.surfel_count));
    let mut surfels = Vec::with_capacity(2 * EXPORT_SURFELS);
    try_for_each_leaf(&mut octree.reader(), |first, leaf| {
        surfels.extend_from_slice(leaf);
        if surfels.len() >= EXPORT_SURFELS {
            check_canceled(cancel)?;
            export.write(&surfels)?;
            surfels.clear();
            phase.set_done(first);
        }
        Ok::<(), PbgiError>(())
    })?;
    export.write(&surfels)?;
    let count = export.finish()?;
    phase.set_done(count);
    progress.detail(&format!("{} surfels in {}", format_count(count as f64), output.display()));
    Ok(count)
}

/// An export under way.
enum Export {
    Ply { writer: PlyWriter, columns: ExportColumns, rows: Vec<f64> },
    Ptc { writer: PtcWriter, origin: DVec3 },
}

impl Export {
    fn create(output: &Path, header: &Header) -> Result<Self, PbgiError> {
        let origin = header.origin;
        let (radiance, albedo) = (header.channels == Channels::Rgb, header.flags.albedo);
        if output.extension().is_some_and(|e| e.eq_ignore_ascii_case("ptc")) {
            let writer = PtcWriter::create(output, radiance, albedo)?;
            return Ok(Self::Ptc { writer, origin });
        }
        let columns = ExportColumns { origin, radiance, albedo };
        let double_count = if origin == DVec3::ZERO { 0 } else { 3 };
        let writer = PlyWriter::create_with_doubles(output, &columns.names(), double_count)?;
        Ok(Self::Ply { writer, columns, rows: Vec::new() })
    }

    fn write(&mut self, surfels: &[LeafSurfel]) -> Result<(), PbgiError> {
        match self {
            Self::Ply { writer, columns, rows } => {
                rows.clear();
                surfels.iter().for_each(|surfel| columns.push(surfel, rows));
                writer.write_double_rows(rows)?;
            }
            Self::Ptc { writer, origin } => {
                let points: Vec<PtcPoint> = surfels.iter().map(|s| ptc_point(s, *origin)).collect();
                writer.write(&points)?;
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<u64, PbgiError> {
        Ok(match self {
            Self::Ply { writer, .. } => writer.finish()?,
            Self::Ptc { writer, .. } => writer.finish()?,
        })
    }
}

fn ptc_point(surfel: &LeafSurfel, origin: DVec3) -> PtcPoint {
    PtcPoint {
        position: (surfel.center.as_dvec3() + origin).as_vec3(),
        normal: if surfel.isotropic { Vec3::ZERO } else { surfel.normal },
        radius: surfel.radius,
        area: surfel.area,
        radiance: surfel.radiance,
        albedo: surfel.albedo,
    }
}

/// Columns of an export.
struct ExportColumns {
    origin: DVec3,
    radiance: bool,
    albedo: bool,
}

impl ExportColumns {
    fn names(&self) -> Vec<&'static str> {
        let mut names = vec!["x", "y", "z", "nx", "ny", "nz", "radius", "area"];
        if self.radiance {
            names.extend(["radiance_r", "radiance_g", "radiance_b"]);
        }
        if self.albedo {
            names.extend(["albedo_r", "albedo_g", "albedo_b"]);
        }
        names
    }

    fn push(&self, surfel: &LeafSurfel, rows: &mut Vec<f64>) {
        rows.extend((surfel.center.as_dvec3() + self.origin).to_array());
        let normal = if surfel.isotropic { Vec3::ZERO } else { surfel.normal };
        rows.extend(normal.as_dvec3().to_array());
        rows.extend([f64::from(surfel.radius), f64::from(surfel.area)]);
        if self.radiance {
            rows.extend(surfel.radiance.map(f64::from));
        }
        if self.albedo {
            rows.extend(surfel.albedo.map(f64::from));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_match_their_values() {
        for (radiance, albedo) in [(false, false), (true, false), (true, true)] {
            let columns = ExportColumns { origin: DVec3::X, radiance, albedo };
            let mut rows = Vec::new();
            columns.push(&LeafSurfel { isotropic: true, ..LeafSurfel::default() }, &mut rows);
            assert_eq!(rows.len(), columns.names().len());
            assert_eq!(rows[..6], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
    }
}
