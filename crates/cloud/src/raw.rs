//! Raw surfel streams: the quickest way into and out of the engine, also through pipes.
//!
//! Little-endian. A 64-byte header, then records until the count is reached or, if the count is
//! unknown, until the end of the file:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `PBGISURF` |
//! | 8 | 4 | version, u32: 2, or 1 |
//! | 12 | 4 | record kind, u32: 1 or 2 |
//! | 16 | 8 | number of records, u64; 2⁶⁴ − 1 where unknown |
//! | 24 | 24 | world position of the coordinate origin, 3 × f64, finite |
//! | 48 | 16 | reserved, zero |
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
//! | 30 | 42 | 2 | flags, u16: 1 isotropic, 2 front only; other bits zero |
//!
//! The orientation of version 2 is that of a [`Surfel`]: the normal, octahedral, two 12-bit signed normalized numbers; in
//! bits 24–31 the direction of the long edge of a rectangle with half the diagonal `radius` ([`pbgi_math::TileCode`]), or 0.
//! That of version 1 is the normal alone, in two 16-bit numbers; such streams are read, not written.

use crate::record::{Defect, MAGNITUDE_MAX, Record};
use crate::source::CHUNK_SURFELS;
use crate::{AtomicFile, CloudError, CloudOptions, Surfel, SurfelFlags, SurfelSource};
use half::f16;
use pbgi_math::{Aabb, DVec3, Vec3, decode_octahedral, decode_octahedral24};
use rayon::prelude::*;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// First bytes of a raw surfel stream.
pub const RAW_MAGIC: [u8; 8] = *b"PBGISURF";
const VERSION: u32 = 2;
const VERSION_WIDE_NORMALS: u32 = 1;
const HEADER_BYTES: usize = 64;
const COUNT_OFFSET: u64 = 16;
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

/// How the records of a stream become surfels.
struct Decoder {
    kind: RawKind,
    wide_normals: bool,
    options: CloudOptions,
}

impl Decoder {
    /// The surfel of a record.
    #[inline]
    fn surfel(&self, bytes: &[u8]) -> Result<Surfel, Defect> {
        if !self.wide_normals
            && let Some(surfel) = self.plain_surfel(bytes)
        {
            return Ok(surfel);
        }
        let normal = match self.wide_normals {
            true => decode_octahedral(orientation_at(bytes)),
            false => decode_octahedral24(orientation_at(bytes)),
        };
        let surfel = record_from_le_bytes(bytes, self.kind, normal, &self.options)
            .and_then(|record| record.to_surfel(self.options.disk_overlap))?;
        // The code itself, so that copying a stream changes no bit.
        let kept = if self.wide_normals { surfel.orientation } else { orientation_at(bytes) };
        Ok(Surfel { orientation: kept, ..surfel })
    }

    /// The surfel of a record that needs neither repair nor anything derived; `None` for all others.
    #[inline]
    fn plain_surfel(&self, bytes: &[u8]) -> Option<Surfel> {
        let f32_at = |at: usize| f32::from_le_bytes(array_at(bytes, at));
        let u16_at = |at: usize| u16::from_le_bytes(array_at(bytes, at));
        let position = [f32_at(0), f32_at(4), f32_at(8)];
        let (radius, area) = (f32_at(12), f32_at(16));
        let flags = u16_at(self.kind.record_bytes() - 2);
        let mut is_plain = position.iter().all(|p| p.abs() <= MAGNITUDE_MAX)
            && (f32::MIN_POSITIVE..=MAGNITUDE_MAX).contains(&radius)
            && (f32::MIN_POSITIVE..f32::INFINITY).contains(&area)
            // An isotropic one is given a normal of its own.
            && flags & !SurfelFlags::FRONT_ONLY.0 == 0;
        let (radiance, albedo) = match self.kind {
            RawKind::Compact => {
                let halves = [24, 26, 28].map(u16_at);
                is_plain &= halves.iter().all(|&h| h < f16::INFINITY.to_bits());
                let albedo = self.options.default_albedo;
                (halves.map(f32_of_positive_half), albedo.map(|a| f16::from_f32(a.clamp(0.0, 1.0))))
            }
            RawKind::Full => {
                let (radiance, albedo) = ([24, 28, 32].map(f32_at), [36, 38, 40].map(u16_at));
                is_plain &= radiance.iter().all(|l| (0.0..f32::INFINITY).contains(l))
                    && albedo.iter().all(|&a| a <= f16::ONE.to_bits());
                (radiance, albedo.map(f16::from_bits))
            }
        };
        let orientation = orientation_at(bytes);
        let flags = SurfelFlags(flags);
        is_plain.then_some(Surfel { position, radius, area, orientation, radiance, albedo, flags })
    }

    /// Box of the valid centers of records `records` of a file; what is cut short is left for reading to find.
    fn scan_bounds(&self, file: &File, records: Range<u64>) -> std::io::Result<Aabb> {
        let size = self.kind.record_bytes();
        let mut bytes = vec![0; SCAN_RECORDS.min((records.end - records.start) as usize) * size];
        let mut bounds = Aabb::EMPTY;
        let mut first = records.start;
        while first < records.end {
            let wanted = SCAN_RECORDS.min((records.end - first) as usize) * size;
            let offset = HEADER_BYTES as u64 + first * size as u64;
            let read = read_up_to_at(file, offset, &mut bytes[..wanted])?;
            for record in bytes[..read].chunks_exact(size) {
                if let Ok(surfel) = self.surfel(record) {
                    bounds = bounds.with_point(surfel.center());
                }
            }
            if read < wanted {
                break;
            }
            first += SCAN_RECORDS as u64;
        }
        Ok(bounds)
    }
}

/// The number a half-precision number stands for that is neither negative nor infinite. Exact: it is scaled by a power of two.
#[inline]
fn f32_of_positive_half(bits: u16) -> f32 {
    const EXPONENTS_BETWEEN: f32 = f32::from_bits((127 + 112) << 23);
    f32::from_bits(u32::from(bits) << 13) * EXPONENTS_BETWEEN
}

/// A raw surfel stream being read.
pub struct RawSource<R> {
    reader: R,
    /// The same file once more, where it is one that can be read twice.
    file: Option<File>,
    path: PathBuf,
    decoder: Decoder,
    origin: DVec3,
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
        if version != VERSION && version != VERSION_WIDE_NORMALS {
            return Err(malformed(format!("version {version}, expected {VERSION}")));
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
        if header[48..].iter().any(|&b| b != 0) {
            return Err(malformed("reserved header bytes are not zero".into()));
        }
        Ok(Self {
            reader,
            file: None,
            path: path.to_owned(),
            decoder: Decoder {
                kind,
                wide_normals: version == VERSION_WIDE_NORMALS,
                options: options.clone(),
            },
            origin,
            count: (count != COUNT_UNKNOWN).then_some(count),
            next: 0,
            skipped: 0,
            bytes: vec![0; CHUNK_SURFELS * kind.record_bytes()],
        })
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

    fn find_bounds(&mut self) -> Result<Option<Aabb>, CloudError> {
        let Self { file: Some(file), decoder, count, .. } = &*self else { return Ok(None) };
        let io = |e| CloudError::io(&self.path, "read", e);
        let length = file.metadata().map_err(io)?.len();
        let held = length.saturating_sub(HEADER_BYTES as u64) / decoder.kind.record_bytes() as u64;
        let records = count.unwrap_or(held).min(held);
        let scan = |task: u64| {
            let start = task * SCAN_TASK_RECORDS;
            decoder.scan_bounds(file, start..records.min(start + SCAN_TASK_RECORDS))
        };
        (0..records.div_ceil(SCAN_TASK_RECORDS))
            .into_par_iter()
            .map(scan)
            .try_reduce(|| Aabb::EMPTY, |a, b| Ok(a.union(b)))
            .map(Some)
            .map_err(io)
    }

    fn count(&self) -> Option<u64> {
        self.count.filter(|_| self.decoder.options.invalid == crate::InvalidPolicy::Refuse)
    }

    fn skipped(&self) -> u64 {
        self.skipped
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let size = self.decoder.kind.record_bytes();
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
        for bytes in self.bytes[..read].chunks_exact(size) {
            match self.decoder.surfel(bytes) {
                Ok(surfel) => out.push(surfel),
                Err(defect) => {
                    let place = || format!("record {}", self.next);
                    defect.apply(
                        self.decoder.options.invalid,
                        &mut self.skipped,
                        &self.path,
                        place,
                    )?;
                }
            }
            self.next += 1;
        }
        let more = read == wanted && self.count != Some(self.next);
        if !more && self.count.is_some() {
            self.check_end()?;
        }
        Ok(more)
    }
}

impl RawSource<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    ///
    /// If it cannot be read or its header is not valid.
    pub fn open(path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let open = || File::open(path).map_err(|e| CloudError::io(path, "open", e));
        let mut source = Self::new(BufReader::with_capacity(1 << 18, open()?), path, options)?;
        source.file = Some(open()?).filter(|f| f.metadata().is_ok_and(|m| m.is_file()));
        Ok(source)
    }
}

/// Records read at once to find bounds.
const SCAN_RECORDS: usize = 1 << 15;

/// Records scanned by one task.
const SCAN_TASK_RECORDS: u64 = 1 << 20;

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
    let file = AtomicFile::create(path)?;
    let mut writer = RawWriter::new(file, path, kind, source.origin(), None)?;
    let mut surfels = Vec::new();
    loop {
        surfels.clear();
        let more = source.read_chunk(&mut surfels)?;
        writer.write(&surfels)?;
        if !more {
            break;
        }
    }
    let count = writer.written;
    let mut file = writer.finish()?;
    file.seek(SeekFrom::Start(COUNT_OFFSET))
        .and_then(|_| file.write_all(&count.to_le_bytes()))
        .map_err(|e| CloudError::io(path, "write", e))?;
    file.commit()?;
    Ok(count)
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

/// Reads from `offset` until `buffer` is full or the file ends; returns the bytes read.
fn read_up_to_at(file: &File, offset: u64, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match file.read_at(&mut buffer[filled..], offset + filled as u64) {
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
    if !SurfelFlags::ISOTROPIC.with(SurfelFlags::FRONT_ONLY).contains(flags) {
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
        let file = File::open(&path).unwrap();
        let source = RawSource::new(file, &path, &CloudOptions::default()).unwrap();
        assert_eq!(source.count(), Some(5000));
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
    fn halves_are_decoded_exactly() {
        for bits in 0..f16::INFINITY.to_bits() {
            assert_eq!(f32_of_positive_half(bits), f16::from_bits(bits).to_f32(), "{bits:x}");
        }
    }

    #[test]
    fn bounds_of_files_are_found_without_moving_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud.surf");
        let surfels: Vec<Surfel> = (0..1000)
            .map(|i| Surfel::new(Vec3::new(i as f32, (i * 7 % 13) as f32, -1.0), Vec3::X, 1.0, 2.0))
            .collect();
        write_raw_file(&path, RawKind::Compact, &mut crate::SliceSource::new(&surfels)).unwrap();
        let expected = Aabb::from_points(surfels.iter().map(Surfel::center));
        // A record that is not valid counts only where it is not dropped.
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[HEADER_BYTES..HEADER_BYTES + 4].copy_from_slice(&(-50f32).to_le_bytes());
        bytes[HEADER_BYTES + 12..HEADER_BYTES + 16].copy_from_slice(&(-1f32).to_le_bytes());
        let options =
            CloudOptions { invalid: crate::InvalidPolicy::Skip, ..CloudOptions::default() };
        for (damaged, start) in [(false, 0.0), (true, 1.0)] {
            if damaged {
                std::fs::write(&path, &bytes).unwrap();
            }
            let mut source = RawSource::open(&path, &options).unwrap();
            let mut read = Vec::new();
            let found = source.find_bounds().unwrap().unwrap();
            assert_eq!((found.min.x, found.max), (start, expected.max));
            while source.read_chunk(&mut read).unwrap() {}
            assert_eq!(read.len() as f32, 1000.0 - start);
        }
        let mut piped = RawSource::new(bytes.as_slice(), &path, &options).unwrap();
        assert_eq!(piped.find_bounds().unwrap(), None);
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
