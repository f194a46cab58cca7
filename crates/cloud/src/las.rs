//! LiDAR clouds in LAS and LAZ files.

use crate::las_decoder::LasDecoder;
use crate::las_results::DIMENSION_BYTES;
use crate::record::{Defect, Record, srgb_to_linear};
use crate::robust::PlaceSample;
use crate::source::CHUNK_SURFELS;
use crate::{CloudError, CloudOptions, InvalidPolicy, LeftOut, Surfel, SurfelSource};
use las::{Header, PointData};
use pbgi_math::{DVec3, Vec3};
use std::path::{Path, PathBuf};

/// First bytes of LAS and LAZ files.
pub const LAS_MAGIC: [u8; 4] = *b"LASF";
/// Points that tell how a file encodes color and intensity.
const PROBE_POINTS: u64 = 65_536;
/// Bytes of points decoded at once.
const DECODE_BYTES_MAX: usize = 4 << 20;
/// Albedo of the brightest percentile where only intensity is known.
const INTENSITY_ALBEDO: f32 = 0.9;

/// Points of a LAS or LAZ file as surfels without normal (isotropic) and without size (radius and
/// area 0): both are to be estimated from the neighborhood. Z is up.
///
/// The origin is the center of the header's box, or where that is far from the first points, their median, rounded to whole units.
/// Albedo comes from RGB,
/// read as sRGB; 16 bits per channel, or 8 where the first 65,536 points nowhere exceed 255.
/// Without RGB it is gray and proportional to intensity, 0.9 at the 99th percentile of those
/// points; without intensity it is [`CloudOptions::default_albedo`]. Withheld points, and those whose class
/// [`CloudOptions::classes`] does not keep, are left out. A COPC file is a LAZ file with its points in another order.
///
/// Headers often lie about the box, so [`SurfelSource::bounds`] is unknown.
pub struct LasPoints {
    decoder: LasDecoder,
    path: PathBuf,
    options: CloudOptions,
    origin: DVec3,
    point_count: u64,
    /// Points decoded so far.
    next: u64,
    skipped: u64,
    left_out: LeftOut,
    /// Unknown before the first read.
    color: Option<Color>,
    points: PointData,
    warnings: Vec<String>,
}

/// How albedo is found.
enum Color {
    /// sRGB-encoded: the linear value of each code.
    Rgb { linear: Vec<f32> },
    /// Proportional to intensity.
    Intensity { albedo_per_unit: f32 },
    /// Nothing is known.
    Default,
}

impl LasPoints {
    /// Opens the file and checks its header against its length.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or is no valid LAS or LAZ file.
    pub fn open(path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let (decoder, header) = LasDecoder::open(path)?;
        let mut points = Self {
            decoder,
            path: path.to_owned(),
            options: options.clone(),
            origin: origin_of(&header),
            point_count: header.number_of_points(),
            next: 0,
            skipped: 0,
            left_out: LeftOut::default(),
            color: None,
            points: las::PointDataBuilder::new().for_header(&header).build(),
            warnings: Vec::new(),
        };
        points.warn_of_unread(&header);
        points.check_origin()?;
        Ok(points)
    }

    /// Says what the file holds and is not read.
    fn warn_of_unread(&mut self, header: &Header) {
        let path = self.path.display();
        if self.decoder.uncounted > 0 {
            self.warnings.push(format!(
                "{path}: its header counts {} points, and there is room for {} behind them; if these are points, its header is damaged: \
                 they are left out",
                self.point_count, self.decoder.uncounted
            ));
        }
        let normals: Vec<String> =
            extra_names(header).into_iter().filter(|name| is_normal(name)).collect();
        if !normals.is_empty() {
            self.warnings.push(format!(
                "{path}: normals in extra bytes are not read ({}); normals are estimated (those of PLY files are read)",
                normals.join(", ")
            ));
        }
    }

    /// Takes another origin where the header's box is not that of the first points, and stands at the first again.
    fn check_origin(&mut self) -> Result<(), CloudError> {
        let mut sample = PlaceSample::default();
        if self.decode(CHUNK_SURFELS as u64)? == 0 {
            return Ok(());
        }
        let places = self.points.x().zip(self.points.y()).zip(self.points.z());
        places.for_each(|((x, y), z)| sample.add(DVec3::new(x, y, z)));
        if let Some(mass) = sample.mass() {
            self.origin = mass.choose_origin(self.origin);
        }
        (self.decoder, _) = LasDecoder::open(&self.path)?;
        self.next = 0;
        Ok(())
    }

    /// Looks at the first points, once, and stands at the first again.
    fn find_color(&mut self) -> Result<(), CloudError> {
        if self.color.is_none() {
            self.color = Some(self.probe_color()?);
            if self.next > 0 {
                (self.decoder, _) = LasDecoder::open(&self.path)?;
                self.next = 0;
            }
        }
        Ok(())
    }

    /// Decodes the next points into `self.points`, at most `count`; returns their number.
    fn decode(&mut self, count: u64) -> Result<u64, CloudError> {
        // Points may be padded up to 64 KiB each.
        let fitting = DECODE_BYTES_MAX / self.points.record_len().max(1);
        let count = count.min(self.point_count - self.next).min(fitting as u64);
        self.decoder.read(self.points.resize_for(count as usize), || {
            format!("point {} of {}", self.next, self.point_count)
        })?;
        self.next += count;
        Ok(count)
    }

    /// Finds out how the file encodes color from its first points.
    fn probe_color(&mut self) -> Result<Color, CloudError> {
        let (mut brightest, mut intensities) = (0, Vec::new());
        while self.next < PROBE_POINTS && self.decode(CHUNK_SURFELS as u64)? > 0 {
            if let Some(colors) = self.points.rgb() {
                brightest = colors.fold(brightest, |m, (r, g, b)| m.max(r).max(g).max(b));
            }
            intensities.extend(self.points.intensity());
        }
        if brightest > 0 {
            let white = if brightest > 255 { 65535u16 } else { 255 };
            let linear = |code| srgb_to_linear(f32::from(code) / f32::from(white));
            return Ok(Color::Rgb { linear: (0..=white).map(linear).collect() });
        }
        let rank = intensities.len() * 99 / 100;
        if rank == 0 {
            return Ok(Color::Default);
        }
        let (_, percentile, _) = intensities.select_nth_unstable(rank);
        Ok(match *percentile {
            0 => Color::Default,
            bright => Color::Intensity { albedo_per_unit: INTENSITY_ALBEDO / f32::from(bright) },
        })
    }

    /// Appends the surfels of the decoded points, the first of which is point `first`.
    fn push_points(&mut self, first: u64, out: &mut Vec<Surfel>) -> Result<(), CloudError> {
        let points = &self.points;
        let mut colors = points.rgb();
        let places = points.x().zip(points.y()).zip(points.z());
        let records = points.raw_bytes().chunks_exact(points.record_len().max(1));
        let marks = records.map(|record| is_withheld(record, points.format().is_extended));
        let attributes = points.classification().zip(points.intensity()).zip(marks);
        for (index, (((x, y), z), ((class, intensity), withheld))) in
            places.zip(attributes).enumerate()
        {
            let rgb = colors.as_mut().and_then(Iterator::next);
            if withheld {
                self.left_out.withheld += 1;
                continue;
            }
            if !self.options.classes.keeps(class) {
                self.left_out.by_class += 1;
                continue;
            }
            let albedo = match (&self.color, rgb) {
                (Some(Color::Rgb { linear }), Some((r, g, b))) => {
                    [r, g, b].map(|code| linear[usize::from(code).min(linear.len() - 1)])
                }
                (Some(Color::Intensity { albedo_per_unit }), _) => {
                    [f32::from(intensity) * albedo_per_unit; 3]
                }
                _ => self.options.default_albedo,
            };
            let position = (DVec3::new(x, y, z) - self.origin).as_vec3();
            let record = Record { position, normal: Vec3::ZERO, albedo, ..Record::default() };
            match record.to_surfel(self.options.disk_overlap) {
                Ok(surfel) => out.push(surfel),
                Err(defect) => report(
                    defect,
                    self.options.invalid,
                    &mut self.skipped,
                    &self.path,
                    first + index as u64,
                )?,
            }
        }
        Ok(())
    }
}

/// Whether a point is marked as deleted: bit 7 of byte 15 before point format 6, bit 2 since.
fn is_withheld(record: &[u8], is_extended: bool) -> bool {
    let mask = if is_extended { 0b100 } else { 0x80 };
    record.get(15).is_some_and(|flags| flags & mask != 0)
}

/// Names of the extra bytes that a header describes (LAS 1.4, section 2.6).
fn extra_names(header: &Header) -> Vec<String> {
    let described =
        header.vlrs().iter().filter(|vlr| vlr.user_id == "LASF_Spec" && vlr.record_id == 4);
    let records = described.flat_map(|vlr| vlr.data.chunks_exact(DIMENSION_BYTES));
    let name = |record: &[u8]| {
        let bytes = record[4..36].split(|byte| *byte == 0).next().unwrap_or_default();
        String::from_utf8_lossy(bytes).trim().to_owned()
    };
    records.map(name).collect()
}

/// Whether extra bytes of this name are a part of a normal, as CloudCompare, PDAL and others call it.
fn is_normal(name: &str) -> bool {
    let plain: String = name.to_lowercase().chars().filter(char::is_ascii_alphanumeric).collect();
    ["nx", "ny", "nz", "normalx", "normaly", "normalz"].contains(&plain.as_str())
}

fn report(
    defect: Defect,
    policy: InvalidPolicy,
    skipped: &mut u64,
    path: &Path,
    point: u64,
) -> Result<(), CloudError> {
    defect.apply(policy, skipped, path, || format!("point {point}"))
}

impl SurfelSource for LasPoints {
    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn skipped(&self) -> u64 {
        self.skipped
    }

    fn left_out(&self) -> LeftOut {
        self.left_out
    }

    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        self.find_color()?;
        let first = self.next;
        if self.decode(CHUNK_SURFELS as u64)? > 0 {
            self.push_points(first, out)?;
        }
        Ok(self.next < self.point_count)
    }
}

/// Center of the header's box, or where that is not finite the offset of its coordinates, rounded.
fn origin_of(header: &Header) -> DVec3 {
    let (bounds, transforms) = (header.bounds(), header.transforms());
    let center = DVec3::new(
        (bounds.min.x + bounds.max.x) * 0.5,
        (bounds.min.y + bounds.max.y) * 0.5,
        (bounds.min.z + bounds.max.z) * 0.5,
    );
    let offset = DVec3::new(transforms.x.offset, transforms.y.offset, transforms.z.offset);
    [center, offset].into_iter().find(|o| o.is_finite()).unwrap_or_default().round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ClassFilter;
    use las::point::Format;
    use las::{Builder, Point, Writer};

    fn points(count: u32, colors: u16) -> Vec<Point> {
        (0..count)
            .map(|i| Point {
                x: 637_380.0 + f64::from(i) * 0.25,
                y: 851_950.0 - f64::from(i) * 0.5,
                z: 400.0 + f64::from(i % 7),
                intensity: i as u16,
                classification: las::point::Classification::new((i % 8) as u8).unwrap(),
                color: (colors > 0).then(|| las::Color::new(colors, 0, colors / 2)),
                ..Default::default()
            })
            .collect()
    }

    fn file_of(points: &[Point], format: u8, version: (u8, u8), compress: bool) -> Vec<u8> {
        let mut builder = Builder::from(version);
        builder.point_format = Format::new(format).unwrap();
        builder.point_format.is_compressed = compress;
        for axis in
            [&mut builder.transforms.x, &mut builder.transforms.y, &mut builder.transforms.z]
        {
            *axis = las::Transform { scale: 0.01, offset: 637_000.0 };
        }
        let cursor = std::io::Cursor::new(Vec::new());
        let mut writer = Writer::new(cursor, builder.into_header().unwrap()).unwrap();
        for point in points {
            let has_time = Format::new(format).unwrap().has_gps_time;
            let gps_time = has_time.then_some(point.gps_time.unwrap_or(1.5));
            let color = point.color.filter(|_| Format::new(format).unwrap().has_color);
            writer.write_point(Point { gps_time, color, ..point.clone() }).unwrap();
        }
        writer.close().unwrap();
        writer.into_inner().unwrap().into_inner()
    }

    fn read(bytes: &[u8]) -> Result<(DVec3, Vec<Surfel>), CloudError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let mut source = LasPoints::open(file.path(), &CloudOptions::default())?;
        let mut out = Vec::new();
        while source.read_chunk(&mut out)? {}
        let seen = source.left_out().total() + source.skipped() + out.len() as u64;
        assert_eq!(seen, source.point_count);
        Ok((source.origin(), out))
    }

    #[test]
    fn las_and_laz_give_the_same_surfels() {
        let points = points(1000, 0xff00);
        let (origin, plain) = read(&file_of(&points, 2, (1, 2), false)).unwrap();
        assert!(read(&file_of(&points, 2, (1, 2), true)).unwrap() == (origin, plain.clone()));
        assert!(read(&file_of(&points, 7, (1, 4), false)).unwrap() == (origin, plain.clone()));
        assert!(read(&file_of(&points, 7, (1, 4), true)).unwrap() == (origin, plain.clone()));
        // Class 7 is noise.
        let kept: Vec<_> = (0..1000).filter(|i| i % 8 != 7).map(|i| &points[i]).collect();
        assert_eq!(plain.len(), kept.len());
        for (surfel, point) in plain.iter().zip(kept) {
            let world = surfel.center().as_dvec3() + origin;
            assert!((world - DVec3::new(point.x, point.y, point.z)).length() < 0.02);
            assert!(surfel.is_isotropic() && surfel.radius == 0.0 && surfel.area == 0.0);
            assert!((surfel.albedo_rgb()[0] - 0.99).abs() < 0.01);
        }
    }

    #[test]
    fn withheld_points_and_unwanted_classes_are_left_out() {
        let mut points = points(80, 0xff00);
        points.iter_mut().step_by(10).for_each(|point| point.is_withheld = true);
        for (format, version) in [(2, (1, 2)), (7, (1, 4))] {
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), file_of(&points, format, version, true)).unwrap();
            let count = |classes: ClassFilter| {
                let options = CloudOptions { classes, ..CloudOptions::default() };
                let mut source = LasPoints::open(file.path(), &options).unwrap();
                let mut out = Vec::new();
                while source.read_chunk(&mut out).unwrap() {}
                (out.len(), source.left_out().by_class, source.left_out().withheld)
            };
            // Withheld are 0, 10, 20 … of classes 0, 2, 4, 6, twice each.
            assert_eq!(count(ClassFilter::default()), (62, 10, 8));
            assert_eq!(count(ClassFilter::Only(vec![2, 6])), (16, 56, 8));
            assert_eq!(count(ClassFilter::Skip(Vec::new())), (72, 0, 8));
        }
    }

    /// Puts numbers into a header from a byte on.
    fn with_doubles(mut bytes: Vec<u8>, at: usize, values: &[f64]) -> Vec<u8> {
        for (k, value) in values.iter().enumerate() {
            bytes[at + 8 * k..at + 8 * k + 8].copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    #[test]
    fn headers_whose_box_is_wrong_cost_no_digits() {
        let points = points(1000, 0xff00);
        for box_of_header in [[0.0; 6], [f64::NAN; 6], [-1e300, 1e300, -1.0, 1.0, 7e8, 8e8]] {
            let bytes = with_doubles(file_of(&points, 2, (1, 2), false), 179, &box_of_header);
            let (origin, surfels) = read(&bytes).unwrap();
            let places: Vec<DVec3> =
                surfels.iter().map(|s| s.center().as_dvec3() + origin).collect();
            let kept = points.iter().enumerate().filter(|(i, _)| i % 8 != 7).map(|(_, p)| p);
            for (place, point) in places.iter().zip(kept) {
                assert!(
                    (*place - DVec3::new(point.x, point.y, point.z)).length() < 0.01,
                    "{place}"
                );
            }
        }
    }

    #[test]
    fn what_is_not_read_is_named() {
        let bytes = file_of(&points(1000, 1), 2, (1, 2), false);
        let warnings = |bytes: &[u8]| {
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), bytes).unwrap();
            LasPoints::open(file.path(), &CloudOptions::default()).unwrap().warnings()
        };
        assert_eq!(warnings(&bytes), [""; 0]);
        let mut short = bytes;
        short[107..111].copy_from_slice(&77u32.to_le_bytes());
        let [warning] = &warnings(&short)[..] else { panic!() };
        assert!(
            warning.contains("counts 77 points") && warning.contains("room for 923"),
            "{warning}"
        );
        // Extended records behind the points are no points.
        let mut long = file_of(&points(1000, 1), 7, (1, 4), false);
        let end = long.len() as u64;
        long[235..243].copy_from_slice(&end.to_le_bytes());
        long.extend([0; 600]);
        assert_eq!(warnings(&long), [""; 0]);
        let mut builder = Builder::from((1, 4));
        builder.point_format = Format::new(2).unwrap();
        builder.point_format.extra_bytes = 12;
        let record = |name: &str| {
            let mut record = vec![0; 192];
            record[2] = 9;
            record[4..4 + name.len()].copy_from_slice(name.as_bytes());
            record
        };
        builder.vlrs.push(las::Vlr {
            user_id: "LASF_Spec".into(),
            record_id: 4,
            data: ["NormalX", "normal y", "Amplitude"].map(record).concat(),
            ..Default::default()
        });
        let cursor = std::io::Cursor::new(Vec::new());
        let mut writer = Writer::new(cursor, builder.into_header().unwrap()).unwrap();
        let color = Some(las::Color::default());
        writer
            .write_point(Point { color, extra_bytes: vec![0; 12], ..Default::default() })
            .unwrap();
        writer.close().unwrap();
        let bytes = writer.into_inner().unwrap().into_inner();
        let [warning] = &warnings(&bytes)[..] else { panic!() };
        assert!(warning.contains("(NormalX, normal y)"), "{warning}");
    }

    #[test]
    fn scales_of_0_are_refused() {
        for scale in [0.0, f64::NAN, f64::INFINITY] {
            let bytes = with_doubles(file_of(&points(9, 1), 2, (1, 2), false), 139, &[scale]);
            let message = read(&bytes).unwrap_err().to_string();
            assert!(message.contains("scale of y"), "{message}");
        }
    }

    #[test]
    fn the_count_of_64_bits_is_that_of_version_1_4() {
        for format in [2, 7] {
            let mut bytes = file_of(&points(1000, 0xff00), format, (1, 4), false);
            bytes[107..111].copy_from_slice(&77u32.to_le_bytes());
            assert_eq!(read(&bytes).unwrap().1.len(), 875, "{format}");
        }
        // Where there is none, the old field counts.
        let mut bytes = file_of(&points(1000, 0xff00), 2, (1, 4), false);
        bytes[247..255].fill(0);
        bytes[107..111].copy_from_slice(&1000u32.to_le_bytes());
        assert_eq!(read(&bytes).unwrap().1.len(), 875);
    }

    #[test]
    fn sizes_of_compressed_items_that_add_up_beyond_16_bits_are_refused() {
        let mut bytes = file_of(&points(10, 0xff00), 2, (1, 4), true);
        let user = bytes.windows(14).position(|b| b == b"laszip encoded").unwrap();
        // The record's data are behind its user (16), number and length (4) and description (32); items are behind 34 bytes of them, each of a type, a
        // size and a version.
        let items = user + 16 + 4 + 32 + 34;
        let size = |bytes: &[u8], item: usize| {
            u16::from_le_bytes([bytes[items + 6 * item + 2], bytes[items + 6 * item + 3]])
        };
        assert_eq!([size(&bytes, 0), size(&bytes, 1)], [20, 6]);
        // 65 536 more than they should be.
        for (item, size) in [(0, 0xffffu16), (1, 27)] {
            bytes[items + 6 * item + 2..][..2].copy_from_slice(&size.to_le_bytes());
        }
        let error = read(&bytes).unwrap_err().to_string();
        assert!(error.contains("65562 bytes, expected 26"), "{error}");
    }

    /// A COPC file begins with a record of its own, cuts its points into chunks of any length, and has its hierarchy
    /// behind them.
    fn copc_file_of(points: &[Point], chunks: &[usize]) -> Vec<u8> {
        let plain = file_of(points, 7, (1, 4), false);
        let (mut header, records) = (plain[..375].to_vec(), &plain[375..]);
        let point_bytes = records.len() / points.len();
        let items = laz::LazItemRecordBuilder::default_for_point_format_id(7, 0).unwrap();
        let vlr = laz::LazVlrBuilder::new(items).with_variable_chunk_size().build();
        let mut laszip = Vec::new();
        vlr.write_to(&mut laszip).unwrap();
        let mut record = |user: &str, id: u16, data: &[u8]| {
            header.extend([0; 2]);
            header.extend(user.bytes().chain(std::iter::repeat(0)).take(16));
            header.extend(id.to_le_bytes());
            header.extend((data.len() as u16).to_le_bytes());
            header.extend([0; 32]);
            header.extend(data);
        };
        record("copc", 1, &[0; 160]);
        record("laszip encoded", 22204, &laszip);
        let offset = header.len() as u32;
        header[96..100].copy_from_slice(&offset.to_le_bytes());
        header[100..104].copy_from_slice(&2u32.to_le_bytes());
        header[104] |= 0x80;
        let mut file = std::io::Cursor::new(header);
        file.set_position(offset.into());
        let mut compressor = laz::LasZipCompressor::new(&mut file, vlr).unwrap();
        let mut rest = records;
        for count in chunks {
            let (chunk, later) = rest.split_at(count * point_bytes);
            compressor.compress_many(chunk).unwrap();
            compressor.finish_current_chunk().unwrap();
            rest = later;
        }
        compressor.done().unwrap();
        drop(compressor);
        let mut bytes = file.into_inner();
        // One extended record, as the hierarchy is.
        let end = bytes.len() as u64;
        bytes[235..243].copy_from_slice(&end.to_le_bytes());
        bytes[243..247].copy_from_slice(&1u32.to_le_bytes());
        bytes.extend([0; 60 + 32]);
        bytes
    }

    #[test]
    fn copc_files_are_read_like_laz_files() {
        let points = points(1000, 0xff00);
        let expected = read(&file_of(&points, 7, (1, 4), true)).unwrap();
        let bytes = copc_file_of(&points, &[1, 499, 30, 470]);
        assert!(read(&bytes).unwrap() == expected);
        for at in (0..bytes.len()).step_by(23) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0xff;
            let _ = read(&damaged);
        }
        // What lies behind the points is not needed.
        for length in (0..bytes.len() - 200).step_by(31) {
            assert!(read(&bytes[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn eight_bit_colors_are_recognized() {
        let (_, surfels) = read(&file_of(&points(100, 255), 2, (1, 2), false)).unwrap();
        assert_eq!(surfels[0].albedo_rgb()[0], 1.0);
    }

    #[test]
    fn intensity_stands_in_for_color() {
        let (_, surfels) = read(&file_of(&points(1001, 0), 0, (1, 2), false)).unwrap();
        let last = surfels.last().unwrap().albedo_rgb();
        assert!((last[0] - 0.9).abs() < 0.02 && last[0] == last[2], "{last:?}");
    }

    /// The decoder of GPS times calls itself where the time is that of another sequence, which all bits set say again and again.
    #[test]
    fn gps_times_that_refer_to_others_without_end_are_no_way_down() {
        let mut points = points(3000, 0xff00);
        for (i, point) in points.iter_mut().enumerate() {
            point.gps_time = Some(1.5 + ((i * i) % 1013) as f64);
        }
        let layered = file_of(&points, 6, (1, 4), true);
        let expected = read(&layered).unwrap();
        for format in [1, 3, 6] {
            let version = if format < 6 { (1, 2) } else { (1, 4) };
            let mut bytes = file_of(&points, format, version, true);
            let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
            let table = u64::from_le_bytes(bytes[start..start + 8].try_into().unwrap()) as usize;
            // The last layer of a chunk is that of GPS times; without layers, all points are in one stream.
            let damaged = if format < 6 { start + 100..table } else { table - 1000..table };
            bytes[damaged].fill(0xff);
            let found = read(&bytes);
            if format < 6 {
                let error = found.unwrap_err().to_string();
                assert!(error.contains("damaged"), "{format}: {error}");
            } else {
                assert!(found.unwrap() == expected);
            }
        }
    }

    #[test]
    fn files_cut_anywhere_are_refused() {
        for compress in [false, true] {
            let bytes = file_of(&points(50, 0xff00), 2, (1, 2), compress);
            for length in 0..bytes.len() {
                assert!(read(&bytes[..length]).is_err(), "{compress} {length}");
            }
        }
    }

    #[test]
    fn damaged_bytes_never_panic() {
        for (format, version) in [(2, (1, 2)), (7, (1, 4))] {
            for compress in [false, true] {
                let bytes = file_of(&points(300, 0xff00), format, version, compress);
                for at in 0..bytes.len().min(1500) {
                    let mut damaged = bytes.clone();
                    damaged[at] ^= 0xff;
                    // Either an error or other surfels; counts are checked by `read`.
                    let _ = read(&damaged);
                }
            }
        }
    }

    #[test]
    fn autzen_stadium_is_read_whole() {
        let path = Path::new(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../shared/data/autzen_stadium.laz"
        ));
        if !path.exists() {
            println!("skipped: autzen_stadium.laz is not here");
            return;
        }
        let start = std::time::Instant::now();
        let mut source = LasPoints::open(path, &CloudOptions::default()).unwrap();
        let (mut chunk, mut count, mut bounds) = (Vec::new(), 0, pbgi_math::Aabb::EMPTY);
        loop {
            chunk.clear();
            let more = source.read_chunk(&mut chunk).unwrap();
            count += chunk.len() as u64;
            bounds = chunk.iter().fold(bounds, |b, s| b.with_point(s.center()));
            if !more {
                break;
            }
        }
        println!("{count} points in {:?}, origin {}", start.elapsed(), source.origin());
        assert_eq!(count + source.left_out().total(), 2_163_989);
        let extent = bounds.extent();
        assert!((extent.x - 1800.0).abs() < 2.0 && (extent.y - 1800.0).abs() < 2.0);
        assert!(bounds.center().truncate().length() < 2.0);
    }
}
