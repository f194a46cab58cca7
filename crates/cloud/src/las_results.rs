//! A scan that comes back with more: LAS and LAZ files with extra dimensions, everything else untouched.
//!
//! Extra dimensions are floats behind the fields of each point, described by a record of 192 bytes each (LAS 1.4,
//! "Extra Bytes", user `LASF_Spec`, record 4), which readers of all versions know.

use crate::CloudError;
use crate::las_decoder::{LasDecoder, array_at, guard};
use crate::output::{commit_output, create_output};
use crate::robust::PlaceSample;
use las::PointData;
use laz::{LasZipCompressor, LazItemRecordBuilder, LazVlrBuilder};
use pbgi_file::{AtomicFile, open_input};
use pbgi_math::DVec3;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Points decoded at once, at most.
const CHUNK_POINTS: u64 = 4096;
/// Bytes of points decoded at once, at most.
const CHUNK_BYTES: usize = 4 << 20;
/// Bytes of the description of an extra dimension.
pub(crate) const DIMENSION_BYTES: usize = 192;
/// Bytes before the data of a record, and of an extended one behind the points.
const RECORD_HEAD_BYTES: usize = 54;
const EXTENDED_HEAD_BYTES: usize = 60;
/// Type of an extra dimension: bytes without meaning, and `float`.
const TYPE_UNDOCUMENTED: u8 = 0;
/// Most bytes of an undocumented dimension, as written.
const UNDOCUMENTED_BYTES_MAX: usize = 7;
const TYPE_FLOAT: u8 = 9;

/// The places of all points of a LAS or LAZ file, whatever their class.
pub struct LasPlaces {
    decoder: LasDecoder,
    points: PointData,
    count: u64,
    next: u64,
    /// Corners of the header's box.
    bounds: [DVec3; 2],
}

impl LasPlaces {
    /// Opens the file and checks its header against its length.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or is no valid LAS or LAZ file.
    pub fn open(path: &Path) -> Result<Self, CloudError> {
        let (decoder, header) = LasDecoder::open(path)?;
        let points = las::PointDataBuilder::new().for_header(&header).build();
        let (min, max) = (header.bounds().min, header.bounds().max);
        let bounds = [min, max].map(|corner| DVec3::new(corner.x, corner.y, corner.z));
        Ok(Self { decoder, points, count: header.number_of_points(), next: 0, bounds })
    }

    /// Number of points.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Appends the places of the next points, at most a few thousand; `false` when there are no more.
    ///
    /// # Errors
    ///
    /// If the points cannot be read on.
    pub fn read_chunk(&mut self, out: &mut Vec<DVec3>) -> Result<bool, CloudError> {
        let fitting = (CHUNK_BYTES / self.points.record_len().max(1)) as u64;
        let count = CHUNK_POINTS.min(fitting).min(self.count - self.next);
        let place = || format!("point {} of {}", self.next, self.count);
        self.decoder.read(self.points.resize_for(count as usize), place)?;
        let places = self.points.x().zip(self.points.y()).zip(self.points.z());
        out.extend(places.map(|((x, y), z)| DVec3::new(x, y, z)));
        self.next += count;
        Ok(self.next < self.count)
    }
}

/// Where the points of a LAS or LAZ file are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LasSurvey {
    /// An origin near most points: places relative to it keep their digits.
    pub origin: DVec3,
    /// Least and greatest corner of what a few strays are beyond; `None` where there are none.
    pub limits: Option<[DVec3; 2]>,
}

/// Extent of a header's box over that of the first points from which on strays are looked for.
const SUSPICIOUS_EXTENTS: f64 = 256.0;

impl LasPlaces {
    /// Finds out where the points of a file are: by its header and its first points, or where these do not fit together, by all.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn survey(path: &Path) -> Result<LasSurvey, CloudError> {
        let mut places = Self::open(path)?;
        let (mut sample, mut chunk) = (PlaceSample::default(), Vec::new());
        let more = places.read_chunk(&mut chunk)?;
        chunk.iter().for_each(|place| sample.add(*place));
        let Some(first) = sample.mass() else {
            return Ok(LasSurvey { origin: DVec3::ZERO, limits: None });
        };
        let near = chunk.first().filter(|place| place.is_finite());
        let origin = first.choose_origin(near.map_or(first.median, |place| place.round()));
        let [min, max] = places.bounds;
        let holds = chunk.iter().all(|p| p.cmpge(min - 1.0).all() && p.cmple(max + 1.0).all());
        if holds && (max - min).max_element() <= SUSPICIOUS_EXTENTS * first.extent() {
            return Ok(LasSurvey { origin, limits: None });
        }
        let mut rest = more;
        while rest {
            chunk.clear();
            rest = places.read_chunk(&mut chunk)?;
            chunk.iter().for_each(|place| sample.add(*place));
        }
        let Some(mass) = sample.mass() else { return Ok(LasSurvey { origin, limits: None }) };
        let origin = mass.choose_origin(origin);
        let limits = mass.limits();
        let [min, max] = limits;
        let mut strays = 0;
        let mut again = Self::open(path)?;
        let mut rest = true;
        while rest {
            chunk.clear();
            rest = again.read_chunk(&mut chunk)?;
            let is_stray = |p: &&DVec3| !(p.cmpge(min).all() && p.cmple(max).all());
            strays += chunk.iter().filter(is_stray).count() as u64;
        }
        let limits = mass.are_strays(strays, again.count).then_some(limits);
        Ok(LasSurvey { origin, limits })
    }
}

/// Writes the points of a LAS or LAZ file again, each with more dimensions. Header, records and fields stay as they
/// are; only the order of a COPC file's points loses its index, which is left out. The file appears when it is complete.
pub struct LasResultWriter {
    decoder: LasDecoder,
    input: PathBuf,
    head: Head,
    file: Output,
    dimensions: usize,
    count: u64,
    written: u64,
    /// Bytes of a point as it is written.
    new_bytes: usize,
    /// Points as they were, and as they are written.
    old: Vec<u8>,
    new: Vec<u8>,
}

enum Output {
    Plain(AtomicFile),
    Compressed(Box<LasZipCompressor<'static, AtomicFile>>),
}

impl LasResultWriter {
    /// Starts the file `output`, compressed if its extension is `laz`, for the points of `input`. `dimensions` are
    /// names of at most 32 ASCII characters.
    ///
    /// # Errors
    ///
    /// If `input` is no valid LAS or LAZ file or has a dimension of such a name, or `output` cannot be written.
    pub fn create(input: &Path, output: &Path, dimensions: &[&str]) -> Result<Self, CloudError> {
        let malformed = |message: String| CloudError::malformed(input, message);
        let (decoder, header) = LasDecoder::open_whole(input)?;
        let mut head = Head::read(input)?;
        head.describe(dimensions, usize::from(header.point_format().extra_bytes))
            .map_err(malformed)?;
        let point_bytes = usize::from(head.point_bytes());
        let added = 4 * dimensions.len();
        let Ok(new_bytes) = u16::try_from(point_bytes + added) else {
            return Err(malformed(format!("points of {point_bytes} bytes have no room for more")));
        };
        let compress = output.extension().is_some_and(|e| e.eq_ignore_ascii_case("laz"));
        let format = header.point_format().to_u8().map_err(|e| malformed(e.to_string()))?;
        let vlr = compress
            .then(|| {
                let extra = header.point_format().extra_bytes + added as u16;
                let items = LazItemRecordBuilder::default_for_point_format_id(format, extra)?;
                Ok(LazVlrBuilder::new(items).build())
            })
            .transpose()
            .map_err(|e: laz::LasZipError| malformed(e.to_string()))?;
        if let Some(vlr) = &vlr {
            let mut data = Vec::new();
            vlr.write_to(&mut data).map_err(|e| malformed(e.to_string()))?;
            head.records.push(Record::new(LASZIP_USER, LASZIP_RECORD, data));
        }
        let bytes = head.to_bytes(format | if compress { 0x80 } else { 0 }, new_bytes);
        let mut file = create_output(output)?;
        let bytes = bytes.map_err(malformed)?;
        file.write_all(&bytes).map_err(|e| CloudError::io(output, "write", e))?;
        let file = match vlr {
            None => Output::Plain(file),
            Some(vlr) => Output::Compressed(Box::new(
                LasZipCompressor::new(file, vlr).map_err(|e| malformed(e.to_string()))?,
            )),
        };
        Ok(Self {
            decoder,
            input: input.to_owned(),
            head,
            file,
            dimensions: dimensions.len(),
            count: header.number_of_points(),
            written: 0,
            new_bytes: usize::from(new_bytes),
            old: Vec::new(),
            new: Vec::new(),
        })
    }

    /// Appends points: the values of their dimensions, point after point.
    ///
    /// # Errors
    ///
    /// If reading or writing fails, or the file has no more points.
    ///
    /// # Panics
    ///
    /// If `values` is not whole points.
    pub fn write(&mut self, values: &[f32]) -> Result<(), CloudError> {
        assert!(values.len().is_multiple_of(self.dimensions.max(1)), "values must be whole points");
        let points = (CHUNK_BYTES / self.new_bytes).max(1);
        values.chunks(points * self.dimensions.max(1)).try_for_each(|v| self.write_chunk(v))
    }

    fn write_chunk(&mut self, values: &[f32]) -> Result<(), CloudError> {
        let count = values.len() / self.dimensions.max(1);
        if count as u64 > self.count - self.written {
            return Err(CloudError::malformed(&self.input, "more results than points"));
        }
        let place = || format!("point {} of {}", self.written, self.count);
        let old_bytes = self.new_bytes - 4 * self.dimensions;
        self.old.resize(count * old_bytes, 0);
        self.decoder.read(&mut self.old, place)?;
        self.new.clear();
        let values = values.chunks_exact(self.dimensions.max(1));
        for (point, values) in self.old.chunks_exact(old_bytes).zip(values) {
            self.new.extend_from_slice(point);
            self.new.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
        let written = match &mut self.file {
            Output::Plain(file) => file.write_all(&self.new),
            // The compressor subtracts neighboring fields, which damaged ones may not bear.
            Output::Compressed(compressor) => guard(&self.input, place, || {
                Ok::<_, std::convert::Infallible>(compressor.compress_many(&self.new))
            })?,
        };
        written.map_err(|e| CloudError::io(&self.input, "write with results", e))?;
        self.written += count as u64;
        Ok(())
    }

    /// Completes the file; it appears under its name. Returns the number of points.
    ///
    /// # Errors
    ///
    /// If writing fails or points are missing; the file's name is then as it was.
    pub fn finish(self) -> Result<u64, CloudError> {
        if self.written != self.count {
            let message = format!("{} results for {} points", self.written, self.count);
            return Err(CloudError::malformed(&self.input, message));
        }
        let mut file = match self.file {
            Output::Plain(file) => file,
            Output::Compressed(mut compressor) => {
                compressor.done().map_err(|e| CloudError::io(&self.input, "compress", e))?;
                compressor.into_inner()
            }
        };
        let io = |e| CloudError::io(&self.input, "copy the records of", e);
        self.head.copy_extended(&self.input, &mut file).map_err(io)?;
        commit_output(file)?;
        Ok(self.written)
    }
}

const LASZIP_USER: &str = "laszip encoded";
const LASZIP_RECORD: u16 = 22204;
const SPEC_USER: &str = "LASF_Spec";
const EXTRA_BYTES_RECORD: u16 = 4;
const WAVEFORM_RECORD: u16 = 65535;

/// Everything before the points.
struct Head {
    /// The public header.
    header: Vec<u8>,
    records: Vec<Record>,
    /// What lies between the records and the points.
    rest: Vec<u8>,
    /// Extended records: the place of each in the file, and its bytes.
    extended: Vec<(u64, u64)>,
    /// Place of the one that holds waveforms, if it is among them.
    waveforms: u64,
}

/// A variable length record.
struct Record {
    /// The record's head, but for the length of its data.
    head: [u8; RECORD_HEAD_BYTES],
    data: Vec<u8>,
}

impl Record {
    fn new(user: &str, id: u16, data: Vec<u8>) -> Self {
        let mut head = [0; RECORD_HEAD_BYTES];
        head[2..2 + user.len()].copy_from_slice(user.as_bytes());
        head[18..20].copy_from_slice(&id.to_le_bytes());
        Self { head, data }
    }

    fn is(&self, user: &str, id: u16) -> bool {
        is_user(&self.head[2..18], user) && self.head[18..20] == id.to_le_bytes()
    }
}

fn is_user(field: &[u8], user: &str) -> bool {
    field.split(|b| *b == 0).next() == Some(user.as_bytes())
}

/// Whether this is the head of an extended record of such a user and number.
fn is_extended(head: &[u8; EXTENDED_HEAD_BYTES], user: &str, id: u16) -> bool {
    is_user(&head[2..18], user) && head[18..20] == id.to_le_bytes()
}

/// Head and bytes in all of the extended record at a place, whose data is what is read next; none where the file has no room for it.
fn read_extended_head(
    file: &mut File,
    file_bytes: u64,
    at: u64,
) -> std::io::Result<Option<([u8; EXTENDED_HEAD_BYTES], u64)>> {
    if at > file_bytes.saturating_sub(EXTENDED_HEAD_BYTES as u64) {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(at))?;
    let mut head = [0; EXTENDED_HEAD_BYTES];
    file.read_exact(&mut head)?;
    let length = u64::from_le_bytes(array_at(&head, 20));
    let bytes = length.saturating_add(EXTENDED_HEAD_BYTES as u64);
    Ok((bytes <= file_bytes - at).then_some((head, bytes)))
}

impl Head {
    /// Reads what lies before the points of a file whose header was checked.
    fn read(path: &Path) -> Result<Self, CloudError> {
        let mut file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
        Self::read_from(&mut file)
            .map_err(|e| CloudError::io(path, "read", e))?
            .map_err(|message| CloudError::malformed(path, message))
    }

    fn read_from(file: &mut File) -> std::io::Result<Result<Self, String>> {
        let file_bytes = file.metadata()?.len();
        let mut start = [0; 104];
        file.read_exact(&mut start)?;
        let header_bytes = usize::from(u16::from_le_bytes(array_at(&start, 94)));
        let offset = u32::from_le_bytes(array_at(&start, 96)) as usize;
        let count = u32::from_le_bytes(array_at(&start, 100));
        file.seek(SeekFrom::Start(0))?;
        let mut bytes = Vec::new();
        Read::by_ref(file).take(offset as u64).read_to_end(&mut bytes)?;
        if bytes.len() < offset || header_bytes > offset {
            return Ok(Err("the file ends before its points; it is cut short".into()));
        }
        let mut rest = &bytes[header_bytes..];
        let mut records = Vec::new();
        for number in 0..count {
            let length = rest.get(20..22).map(|b| usize::from(u16::from_le_bytes(array_at(b, 0))));
            let record =
                length.and_then(|length| rest.split_at_checked(RECORD_HEAD_BYTES + length));
            let Some((record, later)) = record else {
                return Ok(Err(format!("record {number} reaches into the points; it is damaged")));
            };
            let (head, data) = (array_at(record, 0), record[RECORD_HEAD_BYTES..].to_vec());
            records.push(Record { head, data });
            rest = later;
        }
        let rest = rest.to_vec();
        bytes.truncate(header_bytes);
        let mut head = Self { header: bytes, records, rest, extended: Vec::new(), waveforms: 0 };
        // Of compression and of the index of COPC nothing stays true.
        head.records
            .retain(|r| !r.is(LASZIP_USER, LASZIP_RECORD) && !is_user(&r.head[2..18], "copc"));
        Ok(head.find_extended(file, file_bytes)?.map(|()| head))
    }

    /// Finds the records behind the points: the extended ones of LAS 1.4, and that of waveforms, which LAS 1.3 has there, too. Descriptions
    /// of extra dimensions go to those before the points, where all readers look for them.
    fn find_extended(
        &mut self,
        file: &mut File,
        file_bytes: u64,
    ) -> std::io::Result<Result<(), String>> {
        let (mut at, mut count) = (0, 0);
        if self.has_extended_fields() {
            at = u64::from_le_bytes(array_at(&self.header, 235));
            count = u32::from_le_bytes(array_at(&self.header, 243));
        }
        for number in 0..count {
            let Some((head, bytes)) = read_extended_head(file, file_bytes, at)? else {
                return Ok(Err(format!("extended record {number} is damaged")));
            };
            if is_extended(&head, SPEC_USER, EXTRA_BYTES_RECORD) {
                let mut data = Vec::new();
                let most = u64::from(u16::MAX) + 1;
                Read::by_ref(file)
                    .take(most.min(bytes - EXTENDED_HEAD_BYTES as u64))
                    .read_to_end(&mut data)?;
                self.records.push(Record::new(SPEC_USER, EXTRA_BYTES_RECORD, data));
            } else if !is_user(&head[2..18], "copc") {
                self.extended.push((at, bytes));
            }
            at += bytes;
        }
        if self.has_waveform_field() {
            self.waveforms = u64::from_le_bytes(array_at(&self.header, 227));
        }
        if self.waveforms != 0 && self.extended.iter().all(|(at, _)| *at != self.waveforms) {
            // Else they are in a file of their own, or nowhere.
            let found = read_extended_head(file, file_bytes, self.waveforms)?;
            let found = found.filter(|(head, _)| is_extended(head, SPEC_USER, WAVEFORM_RECORD));
            self.extended.extend(found.map(|(_, bytes)| (self.waveforms, bytes)));
        }
        Ok(Ok(()))
    }

    fn has_waveform_field(&self) -> bool {
        self.header[25] >= 3 && self.header.len() >= 235
    }

    fn has_extended_fields(&self) -> bool {
        self.header[25] >= 4 && self.header.len() >= 375
    }

    fn point_bytes(&self) -> u16 {
        u16::from_le_bytes(array_at(&self.header, 105))
    }

    /// Adds descriptions of `dimensions` behind those of the `known` extra bytes of each point. All go into one record, in the order
    /// of the bytes: readers take them so from however many records there are.
    fn describe(&mut self, dimensions: &[&str], known: usize) -> Result<(), String> {
        let (described, others): (Vec<Record>, Vec<Record>) = std::mem::take(&mut self.records)
            .into_iter()
            .partition(|r| r.is(SPEC_USER, EXTRA_BYTES_RECORD));
        self.records = others;
        let mut data: Vec<u8> = Vec::new();
        for record in described {
            let whole = record.data.len() / DIMENSION_BYTES * DIMENSION_BYTES;
            data.extend(&record.data[..whole]);
        }
        let told: usize = data.chunks_exact(DIMENSION_BYTES).map(bytes_of).sum();
        // Bytes nobody has described come before those that are added. A common reader takes their number for flags from 8 on.
        let mut untold = known.saturating_sub(told);
        let mut number = 1;
        while untold > 0 {
            let bytes = untold.min(UNDOCUMENTED_BYTES_MAX);
            data.extend(dimension(
                TYPE_UNDOCUMENTED,
                bytes as u8,
                &format!("undocumented_{number}"),
            ));
            (untold, number) = (untold - bytes, number + 1);
        }
        for name in dimensions {
            let is_same = |d: &[u8]| is_user(&d[4..36], name);
            if data.chunks_exact(DIMENSION_BYTES).any(is_same) {
                return Err(format!(
                    "it has a dimension `{name}` already; shade the scan it was made from"
                ));
            }
            data.extend(dimension(TYPE_FLOAT, 0, name));
        }
        if data.len() > usize::from(u16::MAX) {
            return Err("there is no room to describe more dimensions".into());
        }
        self.records.push(Record::new(SPEC_USER, EXTRA_BYTES_RECORD, data));
        Ok(())
    }

    /// Header and records, for points of another format and size.
    fn to_bytes(&self, format: u8, point_bytes: u16) -> Result<Vec<u8>, String> {
        let mut bytes = self.header.clone();
        for record in &self.records {
            let mut head = record.head;
            head[20..22].copy_from_slice(&(record.data.len() as u16).to_le_bytes());
            bytes.extend(head);
            bytes.extend(&record.data);
        }
        bytes.extend(&self.rest);
        let offset = u32::try_from(bytes.len()).map_err(|_| "its records are too long")?;
        bytes[96..100].copy_from_slice(&offset.to_le_bytes());
        bytes[100..104].copy_from_slice(&(self.records.len() as u32).to_le_bytes());
        bytes[104] = format;
        bytes[105..107].copy_from_slice(&point_bytes.to_le_bytes());
        if self.has_extended_fields() {
            // Where they begin is known when the points are written.
            bytes[235..247].fill(0);
        }
        if self.has_waveform_field() {
            bytes[227..235].fill(0);
        }
        Ok(bytes)
    }

    /// Copies the extended records of `input` behind the points.
    fn copy_extended(&self, input: &Path, output: &mut AtomicFile) -> std::io::Result<()> {
        if self.extended.is_empty() {
            return Ok(());
        }
        let start = output.seek(SeekFrom::End(0))?;
        let (mut next, mut waveforms) = (start, 0);
        let mut input = open_input(input)?;
        for (at, bytes) in &self.extended {
            if *at == self.waveforms {
                waveforms = next;
            }
            input.seek(SeekFrom::Start(*at))?;
            std::io::copy(&mut Read::by_ref(&mut input).take(*bytes), output)?;
            next += bytes;
        }
        if waveforms != 0 {
            output.seek(SeekFrom::Start(227))?;
            output.write_all(&waveforms.to_le_bytes())?;
        }
        if self.has_extended_fields() {
            output.seek(SeekFrom::Start(235))?;
            output.write_all(&start.to_le_bytes())?;
            output.write_all(&(self.extended.len() as u32).to_le_bytes())?;
        }
        Ok(())
    }
}

/// Bytes of each point that a description is of (LAS 1.4, table 24): types 1 to 10 are numbers, up to 20 pairs and up to 30 triples
/// of them.
fn bytes_of(description: &[u8]) -> usize {
    const SIZES: [usize; 10] = [1, 1, 2, 2, 4, 4, 8, 8, 4, 8];
    match description[2] {
        0 => usize::from(description[3]),
        kind @ 1..=30 => SIZES[usize::from(kind - 1) % 10] * (usize::from(kind - 1) / 10 + 1),
        _ => 0,
    }
}

/// The description of an extra dimension.
fn dimension(kind: u8, options: u8, name: &str) -> [u8; DIMENSION_BYTES] {
    let mut bytes = [0; DIMENSION_BYTES];
    (bytes[2], bytes[3]) = (kind, options);
    for (target, byte) in bytes[4..36].iter_mut().zip(name.bytes()) {
        *target = byte;
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use las::point::Format;
    use las::{Builder, Point, Vlr, Writer};

    const NAMES: [&str; 2] = ["pbgi_irradiance", "pbgi_ao"];

    fn points(format: Format) -> Vec<Point> {
        (0..300u16)
            .map(|i| Point {
                x: 637_380.0 + f64::from(i) * 0.25,
                y: 851_950.0,
                z: 400.0 - f64::from(i % 7),
                intensity: i,
                classification: las::point::Classification::new((i % 8) as u8).unwrap(),
                gps_time: format.has_gps_time.then_some(f64::from(i)),
                color: format.has_color.then(|| las::Color::new(i, 2 * i, 3 * i)),
                user_data: (i % 251) as u8,
                is_withheld: i % 9 == 0,
                extra_bytes: (0..format.extra_bytes).map(|k| (i + k) as u8).collect(),
                ..Default::default()
            })
            .collect()
    }

    /// A file with a record of its own before the points and, in LAS 1.4, one behind them.
    fn write(path: &Path, id: u8, version: (u8, u8), extra: u16, compress: bool) -> Vec<Point> {
        let mut builder = Builder::from(version);
        let mut format = Format::new(id).unwrap();
        format.extra_bytes = extra;
        let points = points(format);
        format.is_compressed = compress;
        builder.point_format = format;
        let record = |description: &str| Vlr {
            user_id: "surveyor".to_owned(),
            record_id: 7,
            description: description.to_owned(),
            data: b"who and when".to_vec(),
        };
        builder.vlrs.push(record("before"));
        if version == (1, 4) {
            builder.evlrs.push(record("behind"));
        }
        for axis in
            [&mut builder.transforms.x, &mut builder.transforms.y, &mut builder.transforms.z]
        {
            *axis = las::Transform { scale: 0.01, offset: 637_000.0 };
        }
        let mut writer = Writer::from_path(path, builder.into_header().unwrap()).unwrap();
        points.iter().for_each(|point| writer.write_point(point.clone()).unwrap());
        writer.close().unwrap();
        points
    }

    fn values(point: usize) -> [f32; 2] {
        [point as f32 * 0.5, -1.0 / (1.0 + point as f32)]
    }

    fn add_results(input: &Path, output: &Path) -> Result<u64, CloudError> {
        let mut writer = LasResultWriter::create(input, output, &NAMES)?;
        let all: Vec<f32> = (0..300).flat_map(values).collect();
        all.chunks(2 * 77).try_for_each(|values| writer.write(values))?;
        writer.finish()
    }

    #[test]
    fn points_come_back_with_more_and_else_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        for (id, version, extra) in [(0, (1, 2), 0), (3, (1, 2), 5), (7, (1, 4), 0), (6, (1, 4), 3)]
        {
            for (from, to) in [("a.las", "b.las"), ("a.laz", "b.laz"), ("a.laz", "b.las")] {
                let [input, output] = [from, to].map(|name| folder.path().join(name));
                let written = write(&input, id, version, extra, from == "a.laz");
                assert_eq!(add_results(&input, &output).unwrap(), 300);
                let mut reader = las::Reader::from_path(&output).unwrap();
                let before = las::Reader::from_path(&input).unwrap().header().clone();
                let header = reader.header().clone();
                assert_eq!(header.point_format().extra_bytes, extra + 8, "{id} {from} {to}");
                assert_eq!(header.bounds(), before.bounds());
                assert!(header.vlrs().iter().any(|v| v.description == "before"));
                assert_eq!(header.evlrs().len(), before.evlrs().len());
                let points = reader.read_points(300).unwrap();
                assert_eq!(points.len(), 300);
                for (index, (point, written)) in points.points().zip(&written).enumerate() {
                    let mut point = point.unwrap();
                    let added = point.extra_bytes.split_off(usize::from(extra));
                    let expected: Vec<u8> =
                        values(index).iter().flat_map(|v| v.to_le_bytes()).collect();
                    assert_eq!(added, expected);
                    point.x = written.x;
                    assert!(
                        (point.z - written.z).abs() < 0.01 && (point.y - written.y).abs() < 0.01
                    );
                    (point.y, point.z) = (written.y, written.z);
                    assert_eq!(point, *written);
                }
            }
        }
    }

    #[test]
    fn dimensions_are_described_by_name_once() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output, again] = ["a.las", "b.las", "c.las"].map(|n| folder.path().join(n));
        write(&input, 3, (1, 2), 5, false);
        add_results(&input, &output).unwrap();
        let head = Head::read(&output).unwrap();
        let record = head.records.iter().find(|r| r.is(SPEC_USER, EXTRA_BYTES_RECORD)).unwrap();
        let described: Vec<(u8, &[u8])> =
            record.data.chunks(DIMENSION_BYTES).map(|d| (d[2], &d[4..20])).collect();
        assert_eq!(described.len(), 3);
        assert_eq!((described[0].0, described[1].0, described[2].0), (0, TYPE_FLOAT, TYPE_FLOAT));
        assert!(described[1].1.starts_with(b"pbgi_irradiance\0"));
        assert!(described[2].1.starts_with(b"pbgi_ao\0"));
        let message = add_results(&output, &again).unwrap_err().to_string();
        assert!(message.contains("`pbgi_irradiance` already") && !again.exists(), "{message}");
    }

    /// An extended record.
    fn extended(user: &str, id: u16, data: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; EXTENDED_HEAD_BYTES];
        bytes[2..2 + user.len()].copy_from_slice(user.as_bytes());
        bytes[18..20].copy_from_slice(&id.to_le_bytes());
        bytes[20..28].copy_from_slice(&(data.len() as u64).to_le_bytes());
        [&bytes, data].concat()
    }

    #[test]
    fn dimensions_described_behind_the_points_are_described_before_them() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["a.las", "b.las"].map(|name| folder.path().join(name));
        write(&input, 6, (1, 4), 4, false);
        let mut bytes = std::fs::read(&input).unwrap();
        // The one record behind the points gets a neighbor.
        bytes.extend(extended(SPEC_USER, EXTRA_BYTES_RECORD, &dimension(TYPE_FLOAT, 0, "height")));
        bytes[243..247].copy_from_slice(&2u32.to_le_bytes());
        std::fs::write(&input, bytes).unwrap();
        add_results(&input, &output).unwrap();
        let head = Head::read(&output).unwrap();
        assert_eq!(head.extended.len(), 1);
        let record = head.records.iter().find(|r| r.is(SPEC_USER, EXTRA_BYTES_RECORD)).unwrap();
        let names: Vec<&[u8]> = record
            .data
            .chunks(DIMENSION_BYTES)
            .map(|d| d[4..36].split(|byte| *byte == 0).next().unwrap())
            .collect();
        assert_eq!(names, [b"height".as_slice(), NAMES[0].as_bytes(), NAMES[1].as_bytes()]);
        let reader = las::Reader::from_path(&output).unwrap();
        assert_eq!(reader.header().evlrs().len(), 1);
    }

    /// In LAS 1.4 they are one of the extended records, in LAS 1.3 the only one, which only their own field names.
    #[test]
    fn waveforms_come_back_and_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["a.las", "b.las"].map(|name| folder.path().join(name));
        let waveforms = extended(SPEC_USER, WAVEFORM_RECORD, b"some waves");
        for (id, version) in [(3, (1, 3)), (6, (1, 4))] {
            write(&input, id, version, 0, false);
            let mut bytes = std::fs::read(&input).unwrap();
            let place = bytes.len() as u64;
            bytes.extend(&waveforms);
            bytes[227..235].copy_from_slice(&place.to_le_bytes());
            if version == (1, 4) {
                bytes[243..247].copy_from_slice(&2u32.to_le_bytes());
            }
            std::fs::write(&input, &bytes).unwrap();
            add_results(&input, &output).unwrap();
            let written = std::fs::read(&output).unwrap();
            let place = u64::from_le_bytes(array_at(&written, 227)) as usize;
            assert_eq!(written[place..], waveforms, "{version:?}");
            // A field that leads nowhere, such as to a file of their own, stays behind.
            bytes[227..235].copy_from_slice(&7u64.to_le_bytes());
            std::fs::write(&input, &bytes).unwrap();
            add_results(&input, &output).unwrap();
            let written = std::fs::read(&output).unwrap();
            assert_eq!(written[227..235], [0; 8], "{version:?}");
        }
    }

    #[test]
    fn damaged_files_end_in_errors_and_leave_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["a.laz", "b.laz"].map(|name| folder.path().join(name));
        for version in [(1, 2), (1, 4)] {
            write(&input, if version == (1, 4) { 7 } else { 3 }, version, 0, true);
            let bytes = std::fs::read(&input).unwrap();
            for at in (0..bytes.len()).step_by(1 + bytes.len() / 400) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 0xff;
                std::fs::write(&input, &damaged).unwrap();
                // Other points or an error; never a panic.
                let _ = add_results(&input, &output);
            }
            let _ = std::fs::remove_file(&output);
            for length in (0..bytes.len()).step_by(1 + bytes.len() / 100) {
                std::fs::write(&input, &bytes[..length]).unwrap();
                assert!(add_results(&input, &output).is_err(), "{length} of {}", bytes.len());
            }
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        }
    }

    #[test]
    fn places_are_those_of_all_points() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.laz");
        let written = write(&path, 7, (1, 4), 0, true);
        let mut places = LasPlaces::open(&path).unwrap();
        assert_eq!(places.count(), 300);
        let mut found = Vec::new();
        while places.read_chunk(&mut found).unwrap() {}
        assert_eq!(found.len(), 300);
        for (found, point) in found.iter().zip(&written) {
            assert!((*found - DVec3::new(point.x, point.y, point.z)).length() < 0.02);
        }
    }

    /// Descriptions of a file, whatever records they are in: type, options and name.
    fn descriptions(path: &Path) -> Vec<(u8, u8, String)> {
        let reader = las::Reader::from_path(path).unwrap();
        let of_spec = |v: &&Vlr| v.user_id == SPEC_USER && v.record_id == EXTRA_BYTES_RECORD;
        let records = reader.header().vlrs().iter().filter(of_spec);
        records
            .flat_map(|record| record.data.chunks_exact(DIMENSION_BYTES))
            .map(|d| {
                let name = d[4..36].split(|b| *b == 0).next().unwrap();
                (d[2], d[3], String::from_utf8(name.to_vec()).unwrap())
            })
            .collect()
    }

    #[test]
    fn descriptions_keep_the_order_of_the_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["a.las", "b.las"].map(|name| folder.path().join(name));
        // Two records, as files have that passed through two programs, and three bytes of neither.
        let mut builder = Builder::from((1, 2));
        builder.point_format = Format::new(0).unwrap();
        builder.point_format.extra_bytes = 9;
        for (kind, name) in [(4, "Amplitude"), (9, "Deviation")] {
            builder.vlrs.push(Vlr {
                user_id: SPEC_USER.into(),
                record_id: EXTRA_BYTES_RECORD,
                description: String::new(),
                data: dimension(kind, 0, name).to_vec(),
            });
        }
        let format = builder.point_format;
        let mut writer = Writer::from_path(&input, builder.into_header().unwrap()).unwrap();
        points(format).into_iter().for_each(|point| writer.write_point(point).unwrap());
        writer.close().unwrap();
        assert_eq!(add_results(&input, &output).unwrap(), 300);
        let found = descriptions(&output);
        let names: Vec<&str> = found.iter().map(|(_, _, name)| name.as_str()).collect();
        let added = NAMES;
        assert_eq!(names[..3], ["Amplitude", "Deviation", "undocumented_1"]);
        assert_eq!(names[3..], added);
        assert_eq!((found[2].0, found[2].1), (TYPE_UNDOCUMENTED, 3));
    }

    #[test]
    fn undescribed_bytes_are_told_in_parts_that_readers_open() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["a.las", "b.las"].map(|name| folder.path().join(name));
        write(&input, 0, (1, 2), 16, false);
        assert_eq!(add_results(&input, &output).unwrap(), 300);
        let found = descriptions(&output);
        let parts: Vec<u8> = found.iter().filter(|d| d.0 == 0).map(|d| d.1).collect();
        assert_eq!(parts, [7, 7, 2]);
    }

    #[test]
    fn surveys_find_strays_and_an_origin_near_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las");
        for strays in [0, 1] {
            let mut builder = Builder::from((1, 2));
            builder.point_format = Format::new(0).unwrap();
            builder.transforms.x = las::Transform { scale: 0.01, offset: 600_000.0 };
            let mut writer = Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
            for i in 0..2000 + strays {
                let x = if i == 2000 { 0.0 } else { 600_000.0 + f64::from(i % 50) };
                let point = Point { x, y: f64::from(i / 50), ..Default::default() };
                writer.write_point(point).unwrap();
            }
            writer.close().unwrap();
            let survey = LasPlaces::survey(&path).unwrap();
            assert!((survey.origin.x - 600_000.0).abs() < 100.0, "{survey:?}");
            assert_eq!(survey.limits.is_some(), strays == 1);
            if let Some([min, max]) = survey.limits {
                assert!(min.x > 1e5 && max.x > 600_049.0 && max.x < 700_000.0);
            }
        }
    }

    #[test]
    fn results_must_match_the_points() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["a.las", "b.las"].map(|name| folder.path().join(name));
        write(&input, 0, (1, 2), 0, false);
        let mut writer = LasResultWriter::create(&input, &output, &NAMES).unwrap();
        writer.write(&[1.0, 2.0]).unwrap();
        assert!(writer.finish().unwrap_err().to_string().contains("1 results for 300 points"));
        let mut writer = LasResultWriter::create(&input, &output, &NAMES).unwrap();
        let message = writer.write(&[0.0; 602]).unwrap_err().to_string();
        assert!(message.contains("more results"), "{message}");
        assert!(!output.exists());
    }
}
