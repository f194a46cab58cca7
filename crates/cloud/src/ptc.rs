//! RenderMan's point clouds, `.ptc`: reading. The layout is that of Partio's reader and writer.
//!
//! Little-endian. A header of binary fields and lines of text, then points of equal size:
//!
//! | bytes | field |
//! |---|---|
//! | 4 | magic `pptc` |
//! | 4 | version, i32: 0, 1 or 2 |
//! | 8 | number of points, **f64** |
//! | 24 | box of the positions, 6 × f32: smallest, then largest |
//! | 16 | from version 1: unknown |
//! | 132 | from version 2: largest radius, f32; 32 unknown words |
//! | 128 | world to eye, eye to screen: 2 × 16 × f32 |
//! | 12 | width, height and depth of the image, 3 × f32 |
//! | 8 | number of channels, number of their floats per point: 2 × i32 |
//! | | per channel a line: `float`, `color`, `point`, `vector`, `normal` or `matrix`, a blank, its name, `\n` |
//! | 8 | from version 1: unknown |
//!
//! | bytes of a point | field |
//! |---|---|
//! | 12 | position, 3 × f32 |
//! | 4 | normal, 2 × u16: φ = 2π (a/65535 − ½), z = 2b/65535 − 1, x = √(1 − z²) sin φ, y = √(1 − z²) cos φ; both 65535: none |
//! | 4 | radius, f32 |
//! | 4 per float | channels |

use crate::ply_columns::BinaryRows;
use crate::record_batch::{BATCH_RECORDS, RecordBatch, field};
use crate::source::CHUNK_SURFELS;
use crate::{CloudError, CloudOptions, InvalidPolicy, Surfel, SurfelSource};
use pbgi_file::open_input;
use pbgi_math::{Aabb, Vec3};
use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// First bytes of a `.ptc` file.
pub(crate) const PTC_MAGIC: [u8; 4] = *b"pptc";
/// Bytes of a point before its channels.
pub(crate) const POINT_BYTES: usize = 20;
/// Most channels of a file, and most bytes of a channel's line.
const CHANNELS_MAX: u32 = 1024;
const LINE_BYTES_MAX: u64 = 1024;
/// Both halves of a normal that is none.
const NO_NORMAL: u16 = u16::MAX;

/// The points of a `.ptc` file as surfels. Channels that mean something:
///
/// | channel | meaning |
/// |---|---|
/// | `float _area` or `area` | area of the surface a point stands for; without it, see [`CloudOptions::disk_overlap`] |
/// | `color _radiosity` or `radiosity` | radiosity, W·m⁻²; the radiance is 1/π of it |
/// | `color _albedo` or `albedo` | albedo |
///
/// Others are skipped. Points have no origin but 0: positions are as fine as `f32`.
pub struct PtcPoints {
    reader: BufReader<File>,
    path: PathBuf,
    options: CloudOptions,
    header: PtcHeader,
    next: u64,
    skipped: u64,
    batch: RecordBatch,
    bytes: Vec<u8>,
}

impl PtcPoints {
    /// Opens the file and reads its header.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is no `.ptc` file, or claims more than it holds.
    pub fn open(path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
        let file_bytes = file.metadata().map_err(|e| CloudError::io(path, "read", e))?.len();
        let mut reader = BufReader::with_capacity(1 << 18, file);
        let header = PtcHeader::read(&mut reader, path)?;
        // Pipes have no length; a cut stream is found out at its end.
        if file_bytes > 0 && header.count > file_bytes / header.point_bytes() as u64 {
            return Err(CloudError::malformed(
                path,
                format!(
                    "{} points of {} bytes do not fit into {file_bytes} bytes; the file is cut short or its header is \
                     damaged",
                    header.count,
                    header.point_bytes()
                ),
            ));
        }
        Ok(Self {
            reader,
            path: path.to_owned(),
            options: options.clone(),
            header,
            next: 0,
            skipped: 0,
            batch: RecordBatch::new(options),
            bytes: Vec::new(),
        })
    }

    /// Reads up to `count` whole points into `self.bytes`.
    fn fill_bytes(&mut self, count: usize) -> Result<(), CloudError> {
        let wanted = count * self.header.point_bytes();
        self.bytes.clear();
        let read = self
            .reader
            .by_ref()
            .take(wanted as u64)
            .read_to_end(&mut self.bytes)
            .map_err(|e| CloudError::io(&self.path, "read", e))?;
        if read < wanted {
            let point = self.next + (read / self.header.point_bytes()) as u64;
            let message = format!(
                "point {point}: the file ends here, expected {} points; it is cut short",
                self.header.count
            );
            return Err(CloudError::malformed(&self.path, message));
        }
        Ok(())
    }

    /// Appends the surfels of a batch of whole points, the first of which is point `first`.
    fn push_points(
        &mut self,
        bytes: &[u8],
        first: u64,
        out: &mut Vec<Surfel>,
    ) -> Result<(), CloudError> {
        let Self { batch, header, options, skipped, path, .. } = self;
        let rows = BinaryRows { bytes, stride: header.point_bytes(), big_endian: false };
        batch.set_len(bytes.len() / rows.stride);
        read_columns(&rows, &header.channels, batch);
        batch.push_surfels(options, out, |index, defect| {
            let place = || format!("point {}", first + index as u64);
            defect.apply(options.invalid, skipped, path, place)
        })
    }
}

impl SurfelSource for PtcPoints {
    /// Boxes in headers are not to be trusted.
    fn bounds(&self) -> Option<Aabb> {
        None
    }

    fn count(&self) -> Option<u64> {
        Some(self.header.count).filter(|_| self.options.invalid == InvalidPolicy::Refuse)
    }

    fn skipped(&self) -> u64 {
        self.skipped
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        // Points with many channels are read fewer at a time.
        let fitting = ((1 << 20) / self.header.point_bytes()).max(1);
        let left = self.header.count - self.next;
        self.fill_bytes(left.min(CHUNK_SURFELS.min(fitting) as u64) as usize)?;
        let bytes = std::mem::take(&mut self.bytes);
        let batch_bytes = BATCH_RECORDS * self.header.point_bytes();
        for batch in bytes.chunks(batch_bytes) {
            self.push_points(batch, self.next, out)?;
            self.next += (batch.len() / self.header.point_bytes()) as u64;
        }
        self.bytes = bytes;
        Ok(self.next < self.header.count)
    }
}

/// Fills the columns of a batch from its points.
fn read_columns(rows: &BinaryRows<'_>, channels: &[Channel], batch: &mut RecordBatch) {
    let number = |offset: usize, target: &mut [f32], factor: f32| {
        rows.fill(offset, target, |bytes| f32::from_le_bytes(bytes) * factor);
    };
    let mut normals = [[0.0; BATCH_RECORDS]; 3];
    for (index, point) in rows.bytes.chunks_exact(rows.stride).enumerate() {
        let normal = decode_normal([point[12], point[13], point[14], point[15]]);
        normals.iter_mut().zip(normal).for_each(|(column, x)| column[index] = x);
    }
    for (k, normals) in normals.iter().enumerate() {
        number(4 * k, batch.column_mut(field::POSITION + k), 1.0);
        let target = batch.column_mut(field::NORMAL + k);
        target.copy_from_slice(&normals[..target.len()]);
    }
    number(16, batch.column_mut(field::RADIUS), 1.0);
    for channel in channels {
        match (channel.floats, channel.name.trim_start_matches('_')) {
            (1, "area") => number(channel.offset, batch.column_mut(field::AREA), 1.0),
            (3, "radiosity") => {
                for k in 0..3 {
                    let target = batch.column_mut(field::RADIANCE + k);
                    number(channel.offset + 4 * k, target, FRAC_1_PI);
                }
            }
            (3, "albedo") => {
                for k in 0..3 {
                    number(channel.offset + 4 * k, batch.column_mut(field::ALBEDO + k), 1.0);
                }
            }
            _ => {}
        }
    }
}

/// Unit normal of its code; 0 for none.
pub(crate) fn decode_normal(code: [u8; 4]) -> [f32; 3] {
    let [a, b] = [u16::from_le_bytes([code[0], code[1]]), u16::from_le_bytes([code[2], code[3]])];
    if (a, b) == (NO_NORMAL, NO_NORMAL) {
        return [0.0; 3];
    }
    let z = 2.0 * (f32::from(b) / 65535.0) - 1.0;
    let (sin, cos) = (TAU * (f32::from(a) / 65535.0) - PI).sin_cos();
    let across = (1.0 - z * z).max(0.0).sqrt();
    [across * sin, across * cos, z]
}

/// Code of a unit normal; that of none for 0.
pub(crate) fn encode_normal(normal: Vec3) -> [u8; 4] {
    let [mut a, mut b] = [NO_NORMAL; 2];
    if normal != Vec3::ZERO {
        a = ((normal.x.atan2(normal.y) / TAU + 0.5) * 65535.0).round() as u16;
        b = ((normal.z + 1.0) * 0.5 * 65535.0).round() as u16;
        // Straight up, every φ means the same.
        if b == NO_NORMAL {
            a = 0;
        }
    }
    let ([a0, a1], [b0, b1]) = (a.to_le_bytes(), b.to_le_bytes());
    [a0, a1, b0, b1]
}

/// Values that go with each point.
struct Channel {
    name: String,
    floats: usize,
    /// Bytes of a point before them.
    offset: usize,
}

/// What is needed of a header.
struct PtcHeader {
    count: u64,
    channels: Vec<Channel>,
}

impl PtcHeader {
    fn point_bytes(&self) -> usize {
        self.channels.last().map_or(POINT_BYTES, |c| c.offset + 4 * c.floats)
    }

    fn read(reader: &mut impl BufRead, path: &Path) -> Result<Self, CloudError> {
        let malformed = |message: String| CloudError::malformed(path, message);
        let magic = read_array(reader, path)?;
        if magic[..2] == [0x1f, 0x8b] {
            return Err(malformed("the file is compressed; unpack it with gunzip first".into()));
        }
        if magic != PTC_MAGIC {
            return Err(malformed("not a .ptc file: expected `pptc` at its start".into()));
        }
        let version = u32::from_le_bytes(read_array(reader, path)?);
        if version > 2 {
            return Err(malformed(format!("version {version}, expected 0 to 2")));
        }
        let count = f64::from_le_bytes(read_array(reader, path)?);
        if !((0.0..=9e15).contains(&count) && count.fract() == 0.0) {
            return Err(malformed(format!("{count} points, expected a whole number")));
        }
        let unknown_bytes = [0, 16, 16 + 132][version as usize];
        skip(reader, path, 24 + unknown_bytes + 128 + 12)?;
        let channel_count = u32::from_le_bytes(read_array(reader, path)?);
        let float_count = u32::from_le_bytes(read_array(reader, path)?);
        if channel_count > CHANNELS_MAX {
            let message = format!("{channel_count} channels, expected at most {CHANNELS_MAX}");
            return Err(malformed(message));
        }
        let mut header = Self { count: count as u64, channels: Vec::new() };
        for number in 0..channel_count {
            let offset = header.point_bytes();
            let (floats, name) = read_channel(reader, path)?.ok_or_else(|| {
                malformed(format!(
                    "channel {number}: expected a line such as `float _area` of a known type"
                ))
            })?;
            header.channels.push(Channel { name, floats, offset });
        }
        let found = (header.point_bytes() - POINT_BYTES) / 4;
        if found != float_count as usize {
            let message = format!("channels of {found} floats, expected {float_count}");
            return Err(malformed(message + "; the header is damaged"));
        }
        skip(reader, path, if version > 0 { 8 } else { 0 })?;
        Ok(header)
    }
}

/// Number of floats and name of a channel from its line; `None` if it makes no sense.
fn read_channel(
    reader: &mut impl BufRead,
    path: &Path,
) -> Result<Option<(usize, String)>, CloudError> {
    let mut line = Vec::new();
    reader
        .by_ref()
        .take(LINE_BYTES_MAX)
        .read_until(b'\n', &mut line)
        .map_err(|e| CloudError::io(path, "read", e))?;
    let text = line.strip_suffix(b"\n").and_then(|line| std::str::from_utf8(line).ok());
    let Some((kind, name)) = text.and_then(|text| text.split_once(' ')) else { return Ok(None) };
    let floats = match kind {
        "float" => 1,
        "color" | "point" | "vector" | "normal" => 3,
        "matrix" => 16,
        _ => return Ok(None),
    };
    Ok(Some((floats, name.trim().to_owned())))
}

fn read_array<const N: usize>(reader: &mut impl Read, path: &Path) -> Result<[u8; N], CloudError> {
    let mut bytes = [0; N];
    match reader.read_exact(&mut bytes) {
        Ok(()) => Ok(bytes),
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            Err(CloudError::malformed(path, "the file ends in its header; it is cut short"))
        }
        Err(e) => Err(CloudError::io(path, "read", e)),
    }
}

fn skip(reader: &mut impl Read, path: &Path, count: usize) -> Result<(), CloudError> {
    (0..count).try_for_each(|_| read_array::<1>(reader, path).map(drop))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two points as Partio writes them: version 0, `_area` and `_radiosity`.
    fn golden() -> Vec<u8> {
        let mut bytes = b"pptc\0\0\0\0\0\0\0\0\0\0\0\x40".to_vec();
        for x in [-1.0f32, 0.0, 0.0, 2.0, 3.0, 4.0] {
            bytes.extend(x.to_le_bytes());
        }
        bytes.extend([0; 128 + 12]);
        bytes.extend(b"\x02\0\0\0\x04\0\0\0float _area\ncolor _radiosity\n");
        // (2, 3, 4), +Y: φ = 0 and z = 0 lie between two codes each; radius 0.5.
        bytes.extend(b"\0\0\0\x40\0\0\x40\x40\0\0\x80\x40\0\x80\0\x80\0\0\0\x3f");
        // Area 0.75, radiosity (1, 2, 0).
        bytes.extend(b"\0\0\x40\x3f\0\0\x80\x3f\0\0\0\x40\0\0\0\0");
        // (−1, 0, 0), no normal, radius 1, area 0, radiosity 0.
        bytes.extend(b"\0\0\x80\xbf\0\0\0\0\0\0\0\0\xff\xff\xff\xff\0\0\x80\x3f");
        bytes.extend([0; 16]);
        bytes
    }

    /// The same as another version, which has words of its own.
    fn golden_of(version: u8) -> Vec<u8> {
        let mut bytes = golden();
        bytes[4] = version;
        let points = bytes.len() - 2 * (POINT_BYTES + 16);
        if version >= 1 {
            bytes.splice(points..points, [0xde; 8]);
        }
        let unknown = [0, 16, 16 + 132][usize::from(version)];
        bytes.splice(40..40, std::iter::repeat_n(0xad, unknown));
        bytes
    }

    fn read(bytes: &[u8]) -> Result<Vec<Surfel>, CloudError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let mut source = PtcPoints::open(file.path(), &CloudOptions::default())?;
        let mut out = Vec::new();
        while source.read_chunk(&mut out)? {}
        Ok(out)
    }

    #[test]
    fn files_of_all_versions_are_read() {
        for version in 0..=2 {
            let surfels = read(&golden_of(version)).unwrap();
            assert_eq!(surfels.len(), 2);
            let [first, second] = [surfels[0], surfels[1]];
            assert_eq!(first.position, [2.0, 3.0, 4.0]);
            assert!((first.normal() - Vec3::Y).length() < 1e-3, "{}", first.normal());
            assert_eq!((first.radius, first.area), (0.5, 0.75));
            assert_eq!(first.radiance, [FRAC_1_PI, 2.0 * FRAC_1_PI, 0.0]);
            assert!(!first.is_isotropic() && second.is_isotropic());
            assert_eq!((second.radius, second.area), (1.0, PI));
            assert_eq!(second.albedo_rgb(), [0.5; 3]);
        }
    }

    #[test]
    fn files_cut_anywhere_are_refused() {
        for version in 0..=2 {
            let bytes = golden_of(version);
            for length in 0..bytes.len() {
                assert!(read(&bytes[..length]).is_err(), "version {version}, {length} bytes");
            }
        }
    }

    #[test]
    fn damaged_bytes_never_panic() {
        for version in 0..=2 {
            let bytes = golden_of(version);
            for at in 0..bytes.len() {
                for flip in [0x40, 0xff] {
                    let mut damaged = bytes.clone();
                    damaged[at] ^= flip;
                    // Either an error or at most as many points as the file has room for.
                    let count = read(&damaged).map_or(0, |surfels| surfels.len());
                    assert!(count <= bytes.len() / POINT_BYTES, "byte {at}");
                }
            }
        }
    }

    #[test]
    fn claims_are_compared_with_the_file() {
        let with = |at: usize, bytes: &[u8]| {
            let mut file = golden();
            file[at..at + bytes.len()].copy_from_slice(bytes);
            read(&file).unwrap_err().to_string()
        };
        for (count, expected) in [
            (1e15, "do not fit into"),
            (1e300, "expected a whole number"),
            (-1.0, "expected a whole number"),
            (1.5, "expected a whole number"),
            (f64::NAN, "expected a whole number"),
        ] {
            let message = with(8, &f64::to_le_bytes(count));
            assert!(message.contains(expected), "{message}");
        }
        let channels = 40 + 140;
        assert!(with(channels, &[0xff; 4]).contains("at most 1024"));
        assert!(with(channels + 4, &[5]).contains("channels of 4 floats, expected 5"));
        assert!(with(channels + 8, b"double").contains("channel 0: expected a line"));
        assert!(with(4, &[3]).contains("version 3"));
        assert!(with(0, &[0x1f, 0x8b]).contains("gunzip"));
    }

    #[test]
    fn normals_survive_their_code() {
        for i in 0..20_000u32 {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 20_000.0;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let normal = Vec3::new(across * sin, across * cos, z);
            let decoded = Vec3::from_array(decode_normal(encode_normal(normal)));
            // Half a step of z turns a normal near a pole by √(2 · 2/65535).
            assert!((decoded - normal).length() < 0.008, "{normal}");
        }
        for axis in [Vec3::Z, Vec3::NEG_Z, Vec3::NEG_Y] {
            let decoded = Vec3::from_array(decode_normal(encode_normal(axis)));
            assert!((decoded - axis).length() < 1e-4, "{axis} {decoded}");
        }
        assert_eq!(decode_normal(encode_normal(Vec3::ZERO)), [0.0; 3]);
    }
}
