//! Raw surfel streams: the quickest way into and out of the engine, also through pipes.
//!
//! Little-endian. A 64-byte header, then records until the count is reached or, if the count is
//! unknown, until the end of the file:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `PBGISURF` |
//! | 8 | 4 | version, u32: 3, 2 or 1 |
//! | 12 | 4 | record kind, u32: 1 or 2 |
//! | 16 | 8 | number of records, u64; 2⁶⁴ − 1 where unknown |
//! | 24 | 24 | world position of the coordinate origin, 3 × f64, finite |
//! | 48 | 12 | smallest corner of a cube that holds all positions, 3 × f32; before version 3 zero |
//! | 60 | 4 | edge of that cube, f32; 0 where it is unknown |
//!
//! | kind 1, 32 bytes | kind 2, 44 bytes | bytes | field |
//! |---|---|---|---|
//! | 0 | 0 | 12 | position relative to the origin, 3 × f32, finite, at most 10¹⁸ |
//! | 12 | 12 | 4 | radius, f32, ≥ 0; 0 where unknown |
//! | 16 | 16 | 4 | area, f32, ≥ 0; 0 where unknown |
//! | 20 | 20 | 4 | orientation, u32: see below |
//! | 24 | – | 6 | radiance, 3 × f16, finite, ≥ 0 |
//! | – | 24 | 12 | radiance, 3 × f32, finite, ≥ 0 |
//! | – | 36 | 6 | albedo, 3 × f16, finite |
//! | 30 | 42 | 2 | flags, u16: 1 isotropic, 2 front only; bits 8–14 of triangles ([`pbgi_math::FootCode`]); other bits zero |
//!
//! The orientation of versions 2 and 3 is that of a [`Surfel`]: the normal, octahedral, two 12-bit signed normalized numbers; in
//! bits 24–31 the direction of the long edge of a rectangle with half the diagonal `radius`, or of the longest edge of a triangle whose
//! farthest corner is `radius` from its centroid ([`pbgi_math::TileCode`]), or 0.
//! That of version 1 is the normal alone, in two 16-bit numbers; such streams are read, not written.

use crate::output::{commit_output, create_output};
use crate::record::{Defect, Record, is_sound};
use crate::source::CHUNK_SURFELS;
use crate::{CloudError, CloudOptions, Surfel, SurfelFlags, SurfelSource};
use half::f16;
use pbgi_math::{Aabb, DVec3, Vec3, decode_octahedral, decode_octahedral24};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// First bytes of a raw surfel stream.
pub const RAW_MAGIC: [u8; 8] = *b"PBGISURF";
const VERSION: u32 = 3;
const VERSION_WITHOUT_CUBE: u32 = 2;
const VERSION_WIDE_NORMALS: u32 = 1;
const HEADER_BYTES: usize = 64;
const COUNT_OFFSET: u64 = 16;
const CUBE_OFFSET: usize = 48;
const COUNT_UNKNOWN: u64 = u64::MAX;

/// What a raw record holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RawKind {
    /// 32 bytes: no albedo, radiance in half precision.
    Compact,
    /// 44 bytes: everything a [`Surfel`] holds.
    Full,
}

impl RawKind {
    /// Bytes of a record.
    #[must_use]
    pub fn record_bytes(self) -> usize {
        match self {
            Self::Compact => 32,
            Self::Full => 44,
        }
    }

    fn code(self) -> u32 {
        match self {
            Self::Compact => 1,
            Self::Full => 2,
        }
    }
}

/// A raw surfel stream being read.
pub struct RawSource<R> {
    reader: R,
    path: PathBuf,
    options: CloudOptions,
    kind: RawKind,
    wide_normals: bool,
    origin: DVec3,
    /// Holds all centers, if the header says so.
    cube: Option<Aabb>,
    count: Option<u64>,
    next: u64,
    skipped: u64,
    bytes: Vec<u8>,
}

impl<R: Read + Send> RawSource<R> {
    /// Reads the header. `path` is for messages; call standard input `-`.
    ///
    /// # Errors
    ///
    /// If reading fails or the header is not valid.
    pub fn new(mut reader: R, path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let mut header = [0u8; HEADER_BYTES];
        let malformed = |message: String| CloudError::malformed(path, message);
        let read =
            read_up_to(&mut reader, &mut header).map_err(|e| CloudError::io(path, "read", e))?;
        if read < RAW_MAGIC.len() || header[..8] != RAW_MAGIC {
            return Err(malformed(
                "not a raw surfel stream: expected `PBGISURF` at its start".into(),
            ));
        }
        if read < HEADER_BYTES {
            return Err(malformed(format!("the header ends after {read} of {HEADER_BYTES} bytes")));
        }
        let u32_at = |at: usize| u32::from_le_bytes(array_at(&header, at));
        let version = u32_at(8);
        if !(VERSION_WIDE_NORMALS..=VERSION).contains(&version) {
            return Err(malformed(format!("version {version}, expected 1 to {VERSION}")));
        }
        let kind = match u32_at(12) {
            1 => RawKind::Compact,
            2 => RawKind::Full,
            other => return Err(malformed(format!("record kind {other}, expected 1 or 2"))),
        };
        let count = u64::from_le_bytes(array_at(&header, 16));
        let origin =
            DVec3::from_array([24, 32, 40].map(|at| f64::from_le_bytes(array_at(&header, at))));
        if !origin.is_finite() {
            return Err(malformed("the origin is not finite".into()));
        }
        let cube = [48, 52, 56, 60].map(|at| f32::from_le_bytes(array_at(&header, at)));
        let [x, y, z, edge] = cube;
        if !cube.iter().all(|c| c.is_finite()) || edge < 0.0 {
            return Err(malformed(format!(
                "the cube {x} {y} {z}, edge {edge}, is none; expected finite numbers, the edge not below 0"
            )));
        }
        let is_known = version > VERSION_WITHOUT_CUBE && edge > 0.0;
        if !is_known && header[CUBE_OFFSET..].iter().any(|&b| b != 0) {
            return Err(malformed("reserved header bytes are not zero".into()));
        }
        let corner = Vec3::new(x, y, z);
        let cube = is_known.then(|| Aabb { min: corner, max: corner + edge });
        Ok(Self {
            reader,
            path: path.to_owned(),
            options: options.clone(),
            kind,
            wide_normals: version == VERSION_WIDE_NORMALS,
            origin,
            cube,
            count: (count != COUNT_UNKNOWN).then_some(count),
            next: 0,
            skipped: 0,
            bytes: vec![0; CHUNK_SURFELS * kind.record_bytes()],
        })
    }

    /// Appends the surfels of whole records.
    fn push_records(&mut self, bytes: &[u8], out: &mut Vec<Surfel>) -> Result<(), CloudError> {
        if self.wide_normals || !push_sound(bytes, self.kind, &self.options, out) {
            return self.push_doubtful(bytes, out);
        }
        self.next += (bytes.len() / self.kind.record_bytes()) as u64;
        Ok(())
    }

    /// Appends surfels whose fields must be completed, clamped or refused.
    fn push_doubtful(&mut self, bytes: &[u8], out: &mut Vec<Surfel>) -> Result<(), CloudError> {
        for bytes in bytes.chunks_exact(self.kind.record_bytes()) {
            let normal = match self.wide_normals {
                true => decode_octahedral(orientation_at(bytes)),
                false => decode_octahedral24(orientation_at(bytes)),
            };
            let surfel = record_from_le_bytes(bytes, self.kind, normal, &self.options)
                .and_then(|record| record.to_surfel(self.options.disk_overlap));
            match surfel {
                // The code itself, so that copying a stream changes no bit.
                Ok(surfel) if !self.wide_normals => {
                    out.push(Surfel { orientation: orientation_at(bytes), ..surfel });
                }
                Ok(surfel) => out.push(surfel),
                Err(defect) => {
                    let place = || format!("record {}", self.next);
                    defect.apply(self.options.invalid, &mut self.skipped, &self.path, place)?;
                }
            }
            self.next += 1;
        }
        Ok(())
    }

    /// Errors unless the stream ends here.
    fn check_end(&mut self) -> Result<(), CloudError> {
        match read_up_to(&mut self.reader, &mut [0]) {
            Ok(0) => Ok(()),
            Ok(_) => Err(CloudError::malformed(
                &self.path,
                format!("data follows the {} records its header counts", self.next),
            )),
            Err(e) => Err(CloudError::io(&self.path, "read", e)),
        }
    }
}

impl<R: Read + Send> SurfelSource for RawSource<R> {
    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn bounds(&self) -> Option<Aabb> {
        self.cube
    }

    fn count(&self) -> Option<u64> {
        self.count.filter(|_| self.options.invalid == crate::InvalidPolicy::Refuse)
    }

    fn skipped(&self) -> u64 {
        self.skipped
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let (size, start) = (self.kind.record_bytes(), out.len());
        let left = self.count.map_or(u64::MAX, |count| count - self.next);
        let wanted = left.min(CHUNK_SURFELS as u64) as usize * size;
        let read = read_up_to(&mut self.reader, &mut self.bytes[..wanted])
            .map_err(|e| CloudError::io(&self.path, "read", e))?;
        if (self.count.is_some() && read < wanted) || !read.is_multiple_of(size) {
            let record = self.next + (read / size) as u64;
            let expected = self.count.map_or("whole records".into(), |c| format!("{c} records"));
            return Err(CloudError::malformed(
                &self.path,
                format!(
                    "record {record}: the stream ends here, expected {expected}; it is cut short"
                ),
            ));
        }
        let bytes = std::mem::take(&mut self.bytes);
        let pushed = self.push_records(&bytes[..read], out);
        self.bytes = bytes;
        pushed?;
        if let Some(cube) = &self.cube
            && let Some(surfel) = out[start..].iter().find(|s| !cube.contains(s.center()))
        {
            return Err(CloudError::malformed(
                &self.path,
                format!(
                    "a position, {}, is outside of the cube its header states",
                    surfel.center()
                ),
            ));
        }
        let more = read == wanted && self.count != Some(self.next);
        if !more && self.count.is_some() {
            self.check_end()?;
        }
        Ok(more)
    }
}

/// Writes a raw surfel stream to any writer, such as standard output.
pub struct RawWriter<W> {
    writer: W,
    path: PathBuf,
    kind: RawKind,
    /// Records promised in the header, if any.
    count: Option<u64>,
    written: u64,
    bytes: Vec<u8>,
}

impl<W: Write> RawWriter<W> {
    /// Writes the header. `path` is for messages; `count` is the number of records, if known.
    ///
    /// # Errors
    ///
    /// If writing fails.
    pub fn new(
        mut writer: W,
        path: &Path,
        kind: RawKind,
        origin: DVec3,
        count: Option<u64>,
    ) -> Result<Self, CloudError> {
        let mut header = [0u8; HEADER_BYTES];
        header[..8].copy_from_slice(&RAW_MAGIC);
        header[8..12].copy_from_slice(&VERSION.to_le_bytes());
        header[12..16].copy_from_slice(&kind.code().to_le_bytes());
        header[16..24].copy_from_slice(&count.unwrap_or(COUNT_UNKNOWN).to_le_bytes());
        for (at, x) in [24, 32, 40].into_iter().zip(origin.to_array()) {
            header[at..at + 8].copy_from_slice(&x.to_le_bytes());
        }
        writer.write_all(&header).map_err(|e| CloudError::io(path, "write", e))?;
        Ok(Self { writer, path: path.to_owned(), kind, count, written: 0, bytes: Vec::new() })
    }

    /// Appends surfels. [`RawKind::Compact`] drops their albedo and rounds their radiance to f16,
    /// saturating at its largest number, 65504.
    ///
    /// # Errors
    ///
    /// If writing fails.
    pub fn write(&mut self, surfels: &[Surfel]) -> Result<(), CloudError> {
        for chunk in surfels.chunks(CHUNK_SURFELS) {
            self.bytes.clear();
            for surfel in chunk {
                surfel_to_le_bytes(surfel, self.kind, &mut self.bytes);
            }
            self.writer
                .write_all(&self.bytes)
                .map_err(|e| CloudError::io(&self.path, "write", e))?;
        }
        self.written += surfels.len() as u64;
        Ok(())
    }

    /// Flushes and gives the writer back.
    ///
    /// # Errors
    ///
    /// If writing fails, or fewer or more records were written than the header promises.
    pub fn finish(mut self) -> Result<W, CloudError> {
        if let Some(count) = self.count.filter(|&c| c != self.written) {
            return Err(CloudError::malformed(
                &self.path,
                format!("{} records were written, {count} promised", self.written),
            ));
        }
        self.writer.flush().map_err(|e| CloudError::io(&self.path, "write", e))?;
        Ok(self.writer)
    }
}

/// Writes all surfels of `source` into the file `path`, which appears when complete, and returns
/// their number.
///
/// # Errors
///
/// If reading or writing fails.
pub fn write_raw_file(
    path: &Path,
    kind: RawKind,
    source: &mut dyn SurfelSource,
) -> Result<u64, CloudError> {
    let file = create_output(path)?;
    let mut writer = RawWriter::new(file, path, kind, source.origin(), None)?;
    let mut surfels = Vec::new();
    let mut bounds = Aabb::EMPTY;
    loop {
        surfels.clear();
        let more = source.read_chunk(&mut surfels)?;
        bounds = surfels.iter().fold(bounds, |all, s| all.with_point(s.center()));
        writer.write(&surfels)?;
        if !more {
            break;
        }
    }
    let count = writer.written;
    let mut file = writer.finish()?;
    file.seek(SeekFrom::Start(COUNT_OFFSET))
        .and_then(|_| file.write_all(&count.to_le_bytes()))
        .and_then(|()| file.seek(SeekFrom::Start(CUBE_OFFSET as u64)))
        .and_then(|_| {
            file.write_all(bytemuck::cast_slice(&cube_around(&bounds).map(f32::to_le_bytes)))
        })
        .map_err(|e| CloudError::io(path, "write", e))?;
    commit_output(file)?;
    Ok(count)
}

/// Corner and edge of a cube that holds all of a box; zeros for an empty box.
fn cube_around(bounds: &Aabb) -> [f32; 4] {
    if bounds.is_empty() {
        return [0.0; 4];
    }
    let [x, y, z] = bounds.min.to_array();
    // Up, so that corner + edge is not rounded below the box.
    let mut edge = bounds.extent().max_element().next_up();
    while !bounds.max.cmple(bounds.min + edge).all() {
        edge *= 1.0 + 4.0 * f32::EPSILON;
    }
    if edge.is_finite() { [x, y, z, edge] } else { [0.0; 4] }
}

/// Reads until `buffer` is full or the stream ends; returns the bytes read.
fn read_up_to(reader: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}

fn array_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    std::array::from_fn(|i| bytes[at + i])
}

fn orientation_at(record: &[u8]) -> u32 {
    u32::from_le_bytes(array_at(record, 20))
}

/// Appends the surfels of whole records if every one is a surfel as it stands; else appends none and returns `false`.
fn push_sound(bytes: &[u8], kind: RawKind, options: &CloudOptions, out: &mut Vec<Surfel>) -> bool {
    let first = out.len();
    match kind {
        RawKind::Full => out.extend(bytes.as_chunks().0.iter().map(full_from_le_bytes)),
        RawKind::Compact => {
            let albedo = options.default_albedo.map(f16::from_f32);
            let surfel = |bytes| compact_from_le_bytes(bytes, albedo);
            out.extend(bytes.as_chunks().0.iter().map(surfel));
        }
    }
    let all_sound = out[first..].iter().fold(true, |all, surfel| all & is_sound(surfel));
    if !all_sound {
        out.truncate(first);
    }
    all_sound
}

fn full_from_le_bytes(bytes: &[u8; 44]) -> Surfel {
    let f32_at = |at: usize| f32::from_le_bytes(array_at(bytes, at));
    Surfel {
        position: [f32_at(0), f32_at(4), f32_at(8)],
        radius: f32_at(12),
        area: f32_at(16),
        orientation: orientation_at(bytes),
        radiance: [f32_at(24), f32_at(28), f32_at(32)],
        albedo: [36, 38, 40].map(|at| f16::from_le_bytes(array_at(bytes, at))),
        flags: SurfelFlags(u16::from_le_bytes([bytes[42], bytes[43]])),
    }
}

fn compact_from_le_bytes(bytes: &[u8; 32], albedo: [f16; 3]) -> Surfel {
    let f32_at = |at: usize| f32::from_le_bytes(array_at(bytes, at));
    let radiance_at = |at: usize| widen_radiance(u16::from_le_bytes(array_at(bytes, at)));
    Surfel {
        position: [f32_at(0), f32_at(4), f32_at(8)],
        radius: f32_at(12),
        area: f32_at(16),
        orientation: orientation_at(bytes),
        radiance: [radiance_at(24), radiance_at(26), radiance_at(28)],
        albedo,
        flags: SurfelFlags(u16::from_le_bytes([bytes[30], bytes[31]])),
    }
}

/// The number of f16 bits, exactly; NaN for those that are no radiance: negative, infinite or NaN.
///
/// Exponent and mantissa keep their places in f32, whose exponent is biased by 112 more.
#[inline]
fn widen_radiance(bits: u16) -> f32 {
    const BIAS: f32 = (1u128 << 112) as f32;
    let wide = f32::from_bits(u32::from(bits) << 13) * BIAS;
    if bits < f16::INFINITY.to_bits() { wide } else { f32::NAN }
}

fn record_from_le_bytes(
    bytes: &[u8],
    kind: RawKind,
    normal: Vec3,
    options: &CloudOptions,
) -> Result<Record, Defect> {
    let f32_at = |at: usize| f32::from_le_bytes(array_at(bytes, at));
    let f16_at = |at: usize| f16::from_le_bytes(array_at(bytes, at)).to_f32();
    let (radiance, albedo) = match kind {
        RawKind::Compact => ([24, 26, 28].map(f16_at), options.default_albedo),
        RawKind::Full => ([24, 28, 32].map(f32_at), [36, 38, 40].map(f16_at)),
    };
    let flags = SurfelFlags(u16::from_le_bytes(array_at(bytes, bytes.len() - 2)));
    if !SurfelFlags::KNOWN.contains(flags) {
        return Err(Defect::Flags);
    }
    Ok(Record {
        position: Vec3::from_array([0, 4, 8].map(f32_at)),
        normal: match flags.contains(SurfelFlags::ISOTROPIC) {
            true => Vec3::ZERO,
            false => normal,
        },
        radius: f32_at(12),
        area: f32_at(16),
        radiance,
        albedo,
        flags,
    })
}

fn surfel_to_le_bytes(surfel: &Surfel, kind: RawKind, out: &mut Vec<u8>) {
    for x in surfel.position.into_iter().chain([surfel.radius, surfel.area]) {
        out.extend_from_slice(&x.to_le_bytes());
    }
    out.extend_from_slice(&surfel.orientation.to_le_bytes());
    for l in surfel.radiance {
        match kind {
            RawKind::Compact => {
                out.extend_from_slice(&f16::from_f32(l.min(f16::MAX.to_f32())).to_le_bytes());
            }
            RawKind::Full => out.extend_from_slice(&l.to_le_bytes()),
        }
    }
    if kind == RawKind::Full {
        for a in surfel.albedo {
            out.extend_from_slice(&a.to_le_bytes());
        }
    }
    out.extend_from_slice(&surfel.flags.0.to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{InvalidPolicy, SliceSource};

    fn surfels(count: usize) -> Vec<Surfel> {
        (0..count)
            .map(|i| {
                let x = i as f32;
                let surfel = Surfel::new(
                    Vec3::new(x, -2.0 * x, 0.5),
                    Vec3::new(1.0, x, -3.0).normalize(),
                    0.25,
                    0.125,
                );
                let surfel = if i % 2 == 0 { surfel.with_tile(Vec3::Y, 1.5) } else { surfel };
                surfel.with_radiance([x, 1.0, 0.5]).with_albedo([0.5, 0.25, 1.0])
            })
            .collect()
    }

    fn stream_of(surfels: &[Surfel], kind: RawKind, count: Option<u64>) -> Vec<u8> {
        let origin = DVec3::new(1e6, 2e6, 3.0);
        let mut writer = RawWriter::new(Vec::new(), Path::new("-"), kind, origin, count).unwrap();
        writer.write(surfels).unwrap();
        writer.finish().unwrap()
    }

    fn read_all(bytes: &[u8]) -> Result<Vec<Surfel>, CloudError> {
        let mut source = RawSource::new(bytes, Path::new("-"), &CloudOptions::default())?;
        assert_eq!(source.origin(), DVec3::new(1e6, 2e6, 3.0));
        let mut out = Vec::new();
        while source.read_chunk(&mut out)? {}
        Ok(out)
    }

    #[test]
    fn full_records_round_trip_bit_for_bit() {
        for count in [0, 1, 4096, 4097, 10_000] {
            let surfels = surfels(count);
            for known in [None, Some(count as u64)] {
                let bytes = stream_of(&surfels, RawKind::Full, known);
                assert_eq!(bytes.len(), 64 + 44 * count);
                assert!(read_all(&bytes).unwrap() == surfels);
            }
        }
    }

    #[test]
    fn compact_records_keep_all_but_albedo() {
        let surfels = surfels(100);
        let bytes = stream_of(&surfels, RawKind::Compact, None);
        assert_eq!(bytes.len(), 64 + 32 * 100);
        for (read, written) in read_all(&bytes).unwrap().iter().zip(&surfels) {
            assert_eq!(*read, written.with_albedo([0.5; 3]));
        }
    }

    #[test]
    fn wide_normals_of_version_1_are_read() {
        let surfels = surfels(5);
        let mut bytes = stream_of(&surfels, RawKind::Full, None);
        bytes[8] = 1;
        for (record, surfel) in bytes[64..].chunks_exact_mut(44).zip(&surfels) {
            let wide = pbgi_math::encode_octahedral(surfel.normal());
            record[20..24].copy_from_slice(&wide.to_le_bytes());
        }
        for (read, written) in read_all(&bytes).unwrap().iter().zip(&surfels) {
            assert!((read.normal() - written.normal()).length() < 1e-6);
            assert!(!read.tile().is_known());
        }
    }

    #[test]
    fn files_round_trip_with_their_count() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.pbgisurf");
        let surfels = surfels(5000);
        write_raw_file(&path, RawKind::Full, &mut SliceSource::new(&surfels)).unwrap();
        let file = std::fs::File::open(&path).unwrap();
        let source = RawSource::new(file, &path, &CloudOptions::default()).unwrap();
        assert_eq!(source.count(), Some(5000));
        let (bounds, cube) = (surfels.iter().map(Surfel::center), source.bounds().unwrap());
        let bounds = Aabb::from_points(bounds);
        assert!(cube.contains_box(&bounds) && cube.extent().max_element() < 9998.01);
        // A cube that does not hold all is found out.
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[60..64].copy_from_slice(&9000f32.to_le_bytes());
        let mut source = RawSource::new(&bytes[..], &path, &CloudOptions::default()).unwrap();
        let mut out = Vec::new();
        let error = std::iter::repeat_with(|| source.read_chunk(&mut out)).find_map(Result::err);
        assert!(error.unwrap().to_string().contains("outside of the cube"));
    }

    #[test]
    fn cubes_hold_their_boxes() {
        for (min, max) in [
            (Vec3::ZERO, Vec3::ZERO),
            (Vec3::splat(1e6), Vec3::splat(1e6) + 0.1),
            (Vec3::new(-1e18, 0.0, 3.0), Vec3::new(1e18, 1.0, 3.0)),
            (Vec3::splat(1e-30), Vec3::splat(1.3e-30)),
        ] {
            let [x, y, z, edge] = cube_around(&Aabb { min, max });
            let corner = Vec3::new(x, y, z);
            let cube = Aabb { min: corner, max: corner + edge };
            assert!(edge > 0.0 && cube.contains(min) && cube.contains(max), "{min} {max} {edge}");
        }
        assert_eq!(cube_around(&Aabb::EMPTY), [0.0; 4]);
    }

    #[test]
    fn streams_cut_anywhere_are_refused() {
        let bytes = stream_of(&surfels(3), RawKind::Full, Some(3));
        for length in 0..bytes.len() {
            assert!(read_all(&bytes[..length]).is_err(), "{length}");
        }
        let open_ended = stream_of(&surfels(3), RawKind::Full, None);
        for length in (0..open_ended.len()).filter(|l| *l < 64 || (l - 64) % 44 != 0) {
            assert!(read_all(&open_ended[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn damaged_headers_are_refused() {
        let bytes = stream_of(&surfels(3), RawKind::Full, Some(3));
        for at in (0..24).chain(48..64) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x40;
            assert!(read_all(&damaged).is_err(), "byte {at}");
        }
        let mut longer = bytes;
        longer.push(0);
        assert!(read_all(&longer).unwrap_err().to_string().contains("data follows the 3"));
    }

    #[test]
    fn half_radiances_widen_exactly_or_not_at_all() {
        for bits in 0..=u16::MAX {
            let (wide, half) = (widen_radiance(bits), f16::from_bits(bits));
            let is_radiance = half.is_finite() && half.is_sign_positive();
            assert!(if is_radiance { wide == half.to_f32() } else { wide.is_nan() }, "{bits:#x}");
        }
    }

    /// One doubtful record among sound ones changes nothing about those.
    #[test]
    fn sound_and_doubtful_records_agree() {
        for kind in [RawKind::Full, RawKind::Compact] {
            let surfels = surfels(50);
            let sound = read_all(&stream_of(&surfels, kind, None)).unwrap();
            let mut doubtful = surfels.clone();
            doubtful.push(Surfel { area: 0.0, ..surfels[1] });
            let read = read_all(&stream_of(&doubtful, kind, None)).unwrap();
            assert_eq!(read[..50], sound);
            assert_eq!(read[50].area, std::f32::consts::PI * 0.0625);
        }
    }

    #[test]
    fn invalid_records_are_named_or_skipped() {
        let mut surfels = surfels(3);
        surfels[1].radius = -1.0;
        surfels[2].flags = SurfelFlags(4);
        let bytes = stream_of(&surfels, RawKind::Full, None);
        assert!(read_all(&bytes).unwrap_err().to_string().contains("record 1: radius"));
        let options = CloudOptions { invalid: InvalidPolicy::Skip, ..CloudOptions::default() };
        let mut source = RawSource::new(bytes.as_slice(), Path::new("-"), &options).unwrap();
        let mut out = Vec::new();
        while source.read_chunk(&mut out).unwrap() {}
        assert_eq!((out.len(), source.skipped()), (1, 2));
    }
}
