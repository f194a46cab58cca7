//! Results of points on their way into a file: a table, or the scan itself with more dimensions.

use crate::PbgiError;
use crate::points::rows::PointRows;
use crate::points::scan::{is_scan, is_scan_name};
use crate::points::{PointSource, PointsRequest};
use pbgi_cloud::{LasResultWriter, PlyType, RowWriter, TypedColumn};
use pbgi_gather::Shading;
use pbgi_math::{DVec3, luminance};

/// Values collected before they go into a scan.
const SCAN_VALUES: usize = 1 << 16;

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
pub(crate) struct ResultWriter {
    target: Target,
    /// Whether rows have columns of glossy reflections.
    has_gloss: bool,
    /// Columns of the input that pass through.
    pub passed_columns: Vec<usize>,
}

enum Target {
    /// A table, and the row under way.
    Rows(RowWriter, Vec<f64>),
    /// The scan again, and values to be written.
    Scan(Box<LasResultWriter>, Vec<f32>),
}

impl ResultWriter {
    /// Starts the file: the scan of the source again where the target is named as one; else rows of results, then the columns
    /// of the input in their own types, or those of surfels without one. Positions and normals have the types of the input; surfels' positions
    /// are doubles where the octree's `origin` is not 0. Elements of a PLY file besides its vertices follow in another.
    pub fn create(
        request: &PointsRequest<'_>,
        rows: Option<&PointRows>,
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
        let mut names: Vec<&str> = RESULT_COLUMNS.to_vec();
        let has_gloss = request.settings.gloss.is_some();
        names.extend(GLOSS_COLUMNS.iter().filter(|_| has_gloss));
        let mut passed_columns = Vec::new();
        if rows.is_none() {
            names.extend(SURFEL_COLUMNS);
        }
        let mut columns = TypedColumn::floats(&names, 0);
        for (column, kind) in columns.iter_mut().zip(given_kinds(rows, origin)) {
            column.kind = kind;
        }
        for (index, column) in rows.map_or(&[][..], PointRows::columns).iter().enumerate() {
            if columns.iter().all(|own| own.name != column.name) {
                columns.push(column.clone());
                passed_columns.push(index);
            }
        }
        let has_elements = rows.is_some_and(|rows| !rows.other_elements().is_empty());
        let source = match &request.source {
            PointSource::File(path) if has_elements => Some(path.as_path()),
            _ => None,
        };
        let writer = RowWriter::create_typed(target, columns, source)?;
        let target = Target::Rows(writer, Vec::new());
        Ok(Self { target, has_gloss, passed_columns })
    }

    /// Appends the result of a receiver and, in tables, its position and normal as given, and what goes with it.
    pub fn write(
        &mut self,
        given: [f64; 6],
        shading: &Shading,
        others: impl IntoIterator<Item = f64>,
    ) -> Result<(), PbgiError> {
        let irradiance = shading.irradiance();
        let open = [shading.ambient_occlusion, shading.sky_visibility];
        match &mut self.target {
            Target::Rows(writer, row) => {
                row.clear();
                row.extend(given);
                let floats = irradiance.into_iter().chain(open);
                let reflected = shading.reflected.into_iter().filter(|_| self.has_gloss);
                let floats = floats.chain(shading.bent_normal.to_array());
                row.extend(floats.chain(reflected).map(f64::from));
                row.extend(others);
                writer.write_rows(row)?;
            }
            Target::Scan(writer, values) => {
                values.push(luminance(irradiance));
                values.extend(irradiance);
                values.extend(open);
                if values.len() >= SCAN_VALUES {
                    writer.write(values)?;
                    values.clear();
                }
            }
        }
        Ok(())
    }

    /// Completes the file.
    pub fn finish(self) -> Result<u64, PbgiError> {
        match self.target {
            Target::Rows(writer, _) => Ok(writer.finish()?),
            Target::Scan(mut writer, values) => {
                writer.write(&values)?;
                Ok(writer.finish()?)
            }
        }
    }
}

/// Types of the columns of positions and normals.
fn given_kinds(rows: Option<&PointRows>, origin: DVec3) -> [PlyType; 6] {
    let place = if origin == DVec3::ZERO { PlyType::F32 } else { PlyType::F64 };
    let surfels = std::array::from_fn(|k| if k < 3 { place } else { PlyType::F32 });
    rows.map_or(surfels, PointRows::given_kinds)
}
