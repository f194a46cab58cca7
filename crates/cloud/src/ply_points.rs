//! Point clouds in PLY files as streams of surfels.

use crate::forward_file::ForwardFile;
use crate::ply_columns::{BinaryRows, PlyColumns};
use crate::record_batch::{BATCH_RECORDS, RecordBatch};
use crate::robust::PlaceSample;
use crate::source::CHUNK_SURFELS;
use crate::{
    CloudError, CloudOptions, InvalidPolicy, PlyElement, PlyFormat, PlyReader, PlyRow, Surfel,
    SurfelSource,
};
use pbgi_math::{Aabb, DVec3};
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Rows that tell where a cloud is and how it encodes colors.
const PROBE_ROWS: usize = 4096;
/// Colors as floats are linear, from 0 to 1; where one is above this, all are codes of a display up to 255.
const FLOAT_COLOR_MAX: f64 = 1.5;

/// What the first rows tell.
struct Probe {
    origin: DVec3,
    color_max: f64,
    /// Rows whose alpha is below one half.
    clear_count: u64,
}

/// What of a cloud of Gaussian splats is left out.
fn splat_warning(path: &Path, element: &PlyElement) -> Option<String> {
    let has = |name: &str| element.property(name).is_some();
    (has("f_dc_0") && has("opacity")).then(|| {
        format!(
            "{}: a cloud of Gaussian splats; their centers and base colors are read, their opacities, scales, rotations and \
             the colors that depend on direction are not: each is an opaque disk",
            path.display()
        )
    })
}

/// Bytes of rows read at once, at most, unless one row has more.
const CHUNK_BYTES: usize = 1 << 20;

/// The `vertex` rows of a PLY file as surfels, whatever the order and type of its columns:
///
/// | columns | meaning |
/// |---|---|
/// | `x y z` | position, required; as `double` the cloud's origin is the first vertex, or where that strays, the median of the first, rounded |
/// | `nx ny nz` or `normal_x normal_y normal_z` | normal, any length; zero or absent: isotropic |
/// | `radius`, `area` | size; see [`CloudOptions`] for what is derived where one is absent |
/// | `albedo_r albedo_g albedo_b`, or `red green blue` or `r g b` as floats | linear albedo |
/// | `red green blue`, `diffuse_red …` or `r g b` as integers, or as floats above 1 | sRGB-encoded albedo |
/// | `f_dc_0 f_dc_1 f_dc_2` | base color of Gaussian splats: ½ + *f* / (2√π), sRGB-encoded |
/// | `radiance_r radiance_g radiance_b` | outgoing radiance, W·m⁻²·sr⁻¹ |
///
/// Other columns and elements are skipped.
pub struct PlyPoints {
    reader: PlyReader<BufReader<ForwardFile>>,
    path: PathBuf,
    columns: PlyColumns,
    /// The column of alpha, and its value where a point is opaque.
    alpha: Option<(usize, f64)>,
    batch: RecordBatch,
    options: CloudOptions,
    origin: DVec3,
    count: u64,
    skipped: u64,
    /// Bytes of a binary row of fixed stride and whether they are swapped.
    stride: Option<(usize, bool)>,
    warnings: Vec<String>,
    /// Box of all centers, once found.
    bounds: Option<Aabb>,
    bytes: Vec<u8>,
    row: PlyRow,
}

impl PlyPoints {
    /// Opens the file and reads its header.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is no PLY file, or has no vertex positions.
    pub fn open(path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let mut points = Self::open_start(path, options)?;
        let is_far = points.columns.has_double_positions();
        let has_float_colors = points.columns.has_float_colors();
        if is_far || has_float_colors || points.alpha.is_some() {
            let probe = points.probe()?;
            points = Self::open_start(path, options)?;
            if is_far {
                points.origin = probe.origin;
                points.columns.set_origin(points.origin);
            }
            if probe.clear_count > 0 {
                points.warnings.push(format!(
                    "{}: {} of the first {PROBE_ROWS} points have an alpha below one half; all points are opaque",
                    path.display(),
                    probe.clear_count
                ));
            }
            if has_float_colors && probe.color_max > FLOAT_COLOR_MAX {
                points.columns.take_colors_as_codes();
                points.warnings.push(format!(
                    "{}: colors are floats of up to {}; they are taken as those of a display, from 0 to 255",
                    path.display(),
                    probe.color_max
                ));
            }
        }
        Ok(points)
    }

    fn open_start(path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let mut reader = open_ply(path)?;
        if !reader.seek_element("vertex")? {
            return Err(CloudError::malformed(path, "no element `vertex`; not a point cloud"));
        }
        let format = reader.header().format;
        let element = reader.element().expect("seek_element found it");
        let columns =
            PlyColumns::of(element).map_err(|message| CloudError::malformed(path, message))?;
        let stride = match format {
            PlyFormat::Ascii => None,
            _ => element.stride_bytes().map(|s| (s, format == PlyFormat::BinaryBigEndian)),
        };
        let count = element.count;
        let mut warnings: Vec<String> = splat_warning(path, element).into_iter().collect();
        let unread = element.describe_unread(false);
        warnings.extend(unread.iter().map(|text| format!("{}: {text}", path.display())));
        let alpha = element.alpha();
        Ok(Self {
            reader,
            path: path.to_owned(),
            columns,
            alpha,
            batch: RecordBatch::new(options),
            options: options.clone(),
            origin: DVec3::ZERO,
            count,
            skipped: 0,
            stride,
            warnings,
            bounds: None,
            bytes: Vec::new(),
            row: PlyRow::default(),
        })
    }

    /// What the first rows tell.
    fn probe(&mut self) -> Result<Probe, CloudError> {
        let (mut row, mut sample) = (PlyRow::default(), PlaceSample::default());
        let mut probe = Probe { origin: DVec3::ZERO, color_max: 0.0, clear_count: 0 };
        let mut first = None;
        for _ in 0..PROBE_ROWS {
            if !self.reader.read_row(&mut row)? {
                break;
            }
            let place = self.columns.position(&row);
            first = first.or(Some(place).filter(|place| place.is_finite()));
            sample.add(place);
            let is_clear = self.alpha.is_some_and(|(i, opaque)| row.scalar(i) < 0.5 * opaque);
            probe.clear_count += u64::from(is_clear);
            probe.color_max = self.columns.colors(&row).fold(probe.color_max, f64::max);
        }
        if let (Some(first), Some(mass)) = (first, sample.mass()) {
            probe.origin = mass.choose_origin(first.round());
        }
        Ok(probe)
    }

    /// Appends the surfels of the batch, whose first record is the row `first`.
    fn push_batch(&mut self, first: u64, out: &mut Vec<Surfel>) -> Result<(), CloudError> {
        let Self { batch, options, skipped, path, .. } = self;
        batch.push_surfels(options, out, |index, defect| {
            let place = || format!("vertex row {}", first + index as u64);
            defect.apply(options.invalid, skipped, path, place)
        })
    }

    /// Reads the next rows of a fixed stride and calls `take` with these, a batch at a time, the batch to put them into, and the
    /// number of the first; `false` when there are no more.
    fn for_batches(
        &mut self,
        stride: usize,
        big_endian: bool,
        mut take: impl FnMut(&mut Self, &BinaryRows<'_>, u64) -> Result<(), CloudError>,
    ) -> Result<bool, CloudError> {
        let mut bytes = std::mem::take(&mut self.bytes);
        let mut row = self.reader.row_index();
        // Rows with thousands of columns are read fewer at a time.
        let rows = CHUNK_SURFELS.min((CHUNK_BYTES / stride.max(1)).max(1));
        self.reader.fill_rows(rows, &mut bytes)?;
        for bytes in bytes.chunks(BATCH_RECORDS * stride) {
            let count = bytes.len() / stride;
            self.batch.set_len(count);
            take(self, &BinaryRows { bytes, stride, big_endian }, row)?;
            row += count as u64;
        }
        self.bytes = bytes;
        Ok(row < self.count)
    }

    fn read_fixed(
        &mut self,
        stride: usize,
        big_endian: bool,
        out: &mut Vec<Surfel>,
    ) -> Result<bool, CloudError> {
        self.for_batches(stride, big_endian, |points, rows, first| {
            points.columns.read_binary(rows, &mut points.batch);
            points.push_batch(first, out)
        })
    }

    /// Box of the positions of all rows ahead; `None` where one is not that of a surfel.
    fn read_bounds(&mut self, stride: usize, big_endian: bool) -> Result<Option<Aabb>, CloudError> {
        let (mut bounds, mut more) = (Some(Aabb::EMPTY), true);
        while more && bounds.is_some() {
            more = self.for_batches(stride, big_endian, |points, rows, _| {
                points.columns.read_positions(rows, &mut points.batch);
                let own = points.batch.position_bounds();
                bounds = bounds.zip(own).map(|(all, own)| all.union(own));
                Ok(())
            })?;
        }
        Ok(bounds)
    }

    fn read_rows(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let mut row = std::mem::take(&mut self.row);
        let (first, mut len) = (self.reader.row_index(), 0);
        while len < BATCH_RECORDS && self.reader.read_row(&mut row)? {
            self.batch.set_len(len + 1);
            self.columns.read_row(&row, len, &mut self.batch);
            len += 1;
        }
        self.row = row;
        self.batch.set_len(len);
        self.push_batch(first, out)?;
        Ok(len == BATCH_RECORDS)
    }
}

impl SurfelSource for PlyPoints {
    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn bounds(&self) -> Option<Aabb> {
        self.bounds
    }

    /// Reads the positions only of binary rows. Where a row may have to be dropped for another column, or its position is not that of
    /// a surfel, whole rows must tell.
    fn find_bounds(&mut self) -> Result<Option<Aabb>, CloudError> {
        if let (None, Some((stride, big_endian)), InvalidPolicy::Refuse) =
            (self.bounds, self.stride, self.options.invalid)
        {
            let mut again = Self::open(&self.path, &self.options)?;
            self.bounds = again.read_bounds(stride, big_endian)?;
        }
        Ok(self.bounds)
    }

    fn count(&self) -> Option<u64> {
        (self.options.invalid == InvalidPolicy::Refuse).then_some(self.count)
    }

    fn skipped(&self) -> u64 {
        self.skipped
    }

    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        match self.stride {
            Some((stride, big_endian)) => self.read_fixed(stride, big_endian, out),
            None => self.read_rows(out),
        }
    }
}

/// Opens a PLY file for buffered reading.
pub(crate) fn open_ply(path: &Path) -> Result<PlyReader<BufReader<ForwardFile>>, CloudError> {
    PlyReader::new(BufReader::with_capacity(1 << 18, ForwardFile::open(path)?), path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::Vec3;

    fn read_all(source: &mut dyn SurfelSource) -> Result<Vec<Surfel>, CloudError> {
        let mut surfels = Vec::new();
        while source.read_chunk(&mut surfels)? {}
        Ok(surfels)
    }

    fn file(contents: &[u8]) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), contents).unwrap();
        file
    }

    fn points(contents: &[u8]) -> Result<Vec<Surfel>, CloudError> {
        let file = file(contents);
        read_all(&mut PlyPoints::open(file.path(), &CloudOptions::default())?)
    }

    const ASCII: &str = "ply\nformat ascii 1.0\nelement camera 1\nproperty list uchar float m\n\
        element vertex 2\nproperty uchar blue\nproperty uchar green\nproperty float nz\n\
        property float ny\nproperty float nx\nproperty float extra\nproperty float z\n\
        property float y\nproperty float x\nproperty uchar red\nproperty float radius\n\
        property float radiance_r\nproperty float radiance_g\nproperty float radiance_b\n\
        element face 0\nproperty list uchar int vertex_indices\nend_header\n\
        2 7 8\n0 255 0 0 2 9 3 2 1 128 0.5 4 5 6\n0 0 0 0 0 9 6 5 4 0 0 0 0 0\n";

    #[test]
    fn columns_are_found_in_any_order() {
        let surfels = points(ASCII.as_bytes()).unwrap();
        assert_eq!(surfels.len(), 2);
        let [first, second] = [surfels[0], surfels[1]];
        assert_eq!(first.position, [1.0, 2.0, 3.0]);
        assert_eq!(first.normal(), Vec3::X);
        assert_eq!(first.radius, 0.5);
        assert!((first.area - std::f32::consts::PI * 0.25).abs() < 1e-6);
        assert_eq!(first.radiance, [4.0, 5.0, 6.0]);
        assert!((first.albedo_rgb()[0] - 0.2158).abs() < 1e-3);
        assert_eq!(first.albedo_rgb()[1..], [1.0, 0.0]);
        assert!(!first.is_isotropic() && second.is_isotropic());
        assert_eq!((second.radius, second.area), (0.0, 0.0));
    }

    /// As programs write a normal that they do not know.
    #[test]
    fn normals_that_are_no_numbers_are_not_known() {
        let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
            property float nx\nproperty float ny\nproperty float nz\nend_header\n";
        for normal in ["nan nan nan", "-nan(ind) 0 1", "1.#QNAN 1.#QNAN 1.#QNAN", "0 inf 0"] {
            let surfels =
                points(format!("{header}0 0 0 {normal}\n1 0 0 0 1 0\n").as_bytes()).unwrap();
            assert!(surfels[0].is_isotropic(), "{normal}");
            assert_eq!(surfels[1].normal(), Vec3::Y);
        }
    }

    #[test]
    fn what_changes_light_and_is_not_read_is_named() {
        let warnings = |columns: &[&str], row: &str| {
            let columns: String = columns.iter().map(|c| format!("property {c}\n")).collect();
            let text = format!(
                "ply\nformat ascii 1.0\nelement vertex 2\nproperty float X\nproperty float Y\nproperty float Z\n{columns}end_header\n\
                 0 0 0 {row}\n1 0 0 {row}\n"
            );
            let file = file(text.as_bytes());
            PlyPoints::open(file.path(), &CloudOptions::default()).unwrap().warnings()
        };
        let color = ["uchar red", "uchar green", "uchar blue"];
        for (columns, row, expected) in [
            (&["float scalar_Intensity"][..], "5", "scalar_Intensity; albedo is gray"),
            (&["float rgb"], "1e-38", "rgb; colors packed"),
            (&["float emission_r"], "5", "nothing shines"),
            (&["float pscale"], "5", "sizes are estimated"),
            (&["uchar alpha"], "127", "2 of the first 4096 points have an alpha"),
        ] {
            let warnings = warnings(columns, row);
            assert!(warnings.len() == 1 && warnings[0].contains(expected), "{warnings:?}");
        }
        let colored =
            [&color[..], &["uchar alpha", "float intensity", "float confidence"]].concat();
        assert!(warnings(&colored, "1 2 3 255 4 5").is_empty());
        let packed = "ply\nformat ascii 1.0\nelement vertex 1\nproperty uint packed_position\nend_header\n0\n";
        assert!(
            points(packed.as_bytes())
                .unwrap_err()
                .to_string()
                .contains("compressed Gaussian splats")
        );
    }

    #[test]
    fn binary_and_ascii_agree() {
        let values = [[0.5f32, 1.5, -2.0], [3.0, 4.0, 5.0]];
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                 property float z\nend_header\n"
            )
        };
        let mut ascii = header("ascii").into_bytes();
        let mut little = header("binary_little_endian").into_bytes();
        let mut big = header("binary_big_endian").into_bytes();
        for [x, y, z] in values {
            ascii.extend(format!("{x} {y} {z}\n").bytes());
            for v in [x, y, z] {
                little.extend(v.to_le_bytes());
                big.extend(v.to_be_bytes());
            }
        }
        let expected = points(&ascii).unwrap();
        assert_eq!(expected[1].position, values[1]);
        assert_eq!(points(&little).unwrap(), expected);
        assert_eq!(points(&big).unwrap(), expected);
        for length in 0..little.len() {
            assert!(points(&little[..length]).is_err());
        }
    }

    fn colored(columns: &str, row: &str) -> ([f32; 3], Vec<String>) {
        let properties: String =
            columns.split(' ').map(|c| format!("property float {c}\n")).collect();
        let text =
            format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n{row}\n");
        let file = file(text.as_bytes());
        let mut source = PlyPoints::open(file.path(), &CloudOptions::default()).unwrap();
        (read_all(&mut source).unwrap()[0].albedo_rgb(), source.warnings())
    }

    #[test]
    fn colors_as_floats_are_linear_or_codes_by_their_range() {
        let near = |found: [f32; 3], expected: [f32; 3]| {
            (0..3).all(|c| (found[c] - expected[c]).abs() < 1e-3)
        };
        let (albedo, warnings) = colored("x y z red green blue", "0 0 0 0.25 0.5 1");
        assert!(near(albedo, [0.25, 0.5, 1.0]) && warnings.is_empty(), "{albedo:?}");
        let (albedo, warnings) = colored("x y z red green blue", "0 0 0 0 128 255");
        assert!(near(albedo, [0.0, 0.215_9, 1.0]) && warnings.len() == 1, "{albedo:?}");
        let (albedo, _) = colored("x y z albedo_r albedo_g albedo_b", "0 0 0 0 1 2");
        assert!(near(albedo, [0.0, 1.0, 1.0]));
    }

    #[test]
    fn base_colors_of_splats_are_read_and_the_rest_is_named() {
        // ½ + f / (2√π): 1.7724539 is white, 0 is middle gray.
        let (albedo, warnings) =
            colored("x y z f_dc_0 f_dc_1 f_dc_2 opacity", "0 0 0 0 1.7724539 -5 0");
        assert!((albedo[0] - 0.214).abs() < 1e-2 && albedo[1..] == [1.0, 0.0], "{albedo:?}");
        assert!(warnings[0].contains("opacities"), "{warnings:?}");
    }

    #[test]
    fn strays_at_the_start_cost_no_digits() {
        let mut text = String::from(
            "ply\nformat ascii 1.0\nelement vertex 101\nproperty double x\n\
            property double y\nproperty double z\nend_header\n0 0 0\n",
        );
        (0..100).for_each(|i| text.push_str(&format!("637380.2{i:02} 851950.5 400\n")));
        let file = file(text.as_bytes());
        let source = PlyPoints::open(file.path(), &CloudOptions::default()).unwrap();
        assert_eq!(source.origin(), DVec3::new(637_380.0, 851_951.0, 400.0));
    }

    #[test]
    fn doubles_keep_their_digits_by_an_origin() {
        let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\n\
            property double y\nproperty double z\nend_header\n\
            637380.25 851950.5 400\n637381.375 851950.5 401\n";
        let file = file(text.as_bytes());
        let mut source = PlyPoints::open(file.path(), &CloudOptions::default()).unwrap();
        assert_eq!(source.origin(), DVec3::new(637_380.0, 851_951.0, 400.0));
        let surfels = read_all(&mut source).unwrap();
        assert_eq!(surfels[0].position, [0.25, -0.5, 0.0]);
        assert_eq!(surfels[1].position, [1.375, -0.5, 1.0]);
    }

    #[test]
    fn invalid_rows_are_named_or_skipped() {
        let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
            property float z\nproperty float radius\nend_header\n0 0 0 1\nnan 0 0 1\n0 0 0 -1\n";
        let message = points(text.as_bytes()).unwrap_err().to_string();
        assert!(message.contains("vertex row 1: position"), "{message}");
        let file = file(text.as_bytes());
        let options = CloudOptions { invalid: InvalidPolicy::Skip, ..CloudOptions::default() };
        let mut source = PlyPoints::open(file.path(), &options).unwrap();
        assert_eq!(read_all(&mut source).unwrap().len(), 1);
        assert_eq!(source.skipped(), 2);
        assert_eq!(source.count(), None);
    }

    /// Positions alone tell the bounds, unless rows may have to be dropped.
    #[test]
    fn bounds_are_those_of_all_surfels() {
        for (ty, radius, policy, is_found) in [
            ("float", 1.0, InvalidPolicy::Refuse, true),
            ("double", 1.0, InvalidPolicy::Refuse, true),
            ("double", 1.0, InvalidPolicy::Skip, false),
            ("float", -1.0, InvalidPolicy::Skip, false),
        ] {
            let mut contents = format!(
                "ply\nformat binary_little_endian 1.0\nelement vertex 9000\nproperty {ty} x\n\
                 property {ty} y\nproperty {ty} z\nproperty float radius\nend_header\n"
            )
            .into_bytes();
            for i in 0..9000 {
                let x = f64::from(i * 7919 % 9001) * 0.37 - 800.0;
                for x in [x, -x, 5.0] {
                    match ty {
                        "float" => contents.extend((x as f32).to_le_bytes()),
                        _ => contents.extend((x + 6e5).to_le_bytes()),
                    }
                }
                // The smallest x.
                let radius = if i == 0 { radius } else { 1.0f32 };
                contents.extend(radius.to_le_bytes());
            }
            let file = file(&contents);
            let options = CloudOptions { invalid: policy, ..CloudOptions::default() };
            let mut source = PlyPoints::open(file.path(), &options).unwrap();
            let found = source.find_bounds().unwrap();
            let surfels = read_all(&mut source).unwrap();
            assert_eq!(surfels.len(), if radius < 0.0 { 8999 } else { 9000 });
            let expected = Aabb::from_points(surfels.iter().map(Surfel::center));
            assert_eq!(found, is_found.then_some(expected), "{ty} {radius}");
            let mut lazy = crate::LazyCloud::open(file.path(), &options).unwrap();
            assert_eq!(lazy.find_bounds().unwrap(), Some(expected));
        }
    }

    #[test]
    fn bad_positions_are_found_out_by_whole_rows() {
        let mut contents =
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n\
            property float y\nproperty float z\nend_header\n"
                .to_vec();
        contents
            .extend([0.0f32, 1.0, 2.0, 3.0, f32::NAN, 5.0].map(f32::to_le_bytes).as_flattened());
        let file = file(&contents);
        let mut source = PlyPoints::open(file.path(), &CloudOptions::default()).unwrap();
        assert_eq!(source.find_bounds().unwrap(), None);
        let mut lazy = crate::LazyCloud::open(file.path(), &CloudOptions::default()).unwrap();
        let message = lazy.find_bounds().unwrap_err().to_string();
        assert!(message.contains("vertex row 1: position"), "{message}");
    }

    #[test]
    fn files_without_positions_are_refused() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n";
        assert!(points(text.as_bytes()).unwrap_err().to_string().contains("`x`, `y`, `z`"));
        let text = "ply\nformat ascii 1.0\nend_header\n";
        assert!(points(text.as_bytes()).unwrap_err().to_string().contains("no element `vertex`"));
    }

    #[test]
    fn stanford_scans_are_read() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
        for (name, count) in [("stanford_bunny.ply", 35_947), ("stanford_dragon_res2.ply", 100_250)]
        {
            let path = Path::new(folder).join(name);
            if !path.exists() {
                println!("skipped: {name} is not here");
                continue;
            }
            let mut source = PlyPoints::open(&path, &CloudOptions::default()).unwrap();
            assert_eq!(source.count(), Some(count));
            let surfels = read_all(&mut source).unwrap();
            assert_eq!(surfels.len() as u64, count);
            assert!(surfels.iter().all(|s| s.center().length() < 0.5 && s.is_isotropic()));
        }
    }
}
