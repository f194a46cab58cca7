//! Decoding of LAS and LAZ points that survives damaged files.
//!
//! The `las` and `laz` crates decode headers and points. They allocate what a file claims, so every
//! claim is compared with the length of the file first: header and point count by
//! [`check_header`], the table of chunks by [`check_chunk_table`], the layers of each chunk by
//! [`LayerGuard`]. Extended records, which nothing here needs and which would be read whole, are
//! hidden by [`GuardedFile`]; panics on nonsense are caught by [`guard`]. The decoder of GPS times
//! calls itself as often as the data say: layers that nothing here needs are skipped, and where
//! there are no layers, [`Shallow`] ends it.

use crate::CloudError;
use crate::las::LAS_MAGIC;
use las::Header;
use laz::{DecompressionSelection, LasZipDecompressor, LazItem, LazItemType, LazVlr};
use pbgi_file::{catch_decoder_panic, open_input};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::thread;

/// Bytes of the longest public header, that of LAS 1.4.
const HEADER_BYTES_MAX: usize = 375;
/// Largest distance from the file's start to its points.
const POINTS_OFFSET_MAX: u64 = 64 << 20;

/// Gives the bytes of points in file order.
pub(crate) struct LasDecoder {
    points: Points,
    path: PathBuf,
    /// Points that there is room for behind those that the header counts.
    pub uncounted: u64,
}

enum Points {
    Plain(BufReader<GuardedFile>),
    Compressed(Box<Compressed>),
}

/// Points of a LAZ file.
struct Compressed {
    decompressor: LasZipDecompressor<'static, Shallow<BufReader<GuardedFile>>>,
    layers: LayerGuard,
    /// Whether the decoder may call itself.
    is_recursive: bool,
}

impl Compressed {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<()> {
        self.decompressor.get_mut().begin();
        let mut rest = bytes;
        while !rest.is_empty() {
            let reader = &mut self.decompressor.get_mut().source;
            let take = self.layers.bytes_before_check(reader, rest.len())?;
            let (now, later) = rest.split_at_mut(take);
            self.decompressor.decompress_many(now)?;
            rest = later;
        }
        Ok(())
    }
}

/// Bytes by which the stack may grow while points are decoded. Sound points make the decoder call itself three times.
const DEPTH_BYTES_MAX: usize = 1 << 20;

/// Stack of a thread on which the decoder may call itself: it reads a byte after 36 000 calls at the latest, each of some hundred bytes.
const STACK_BYTES: usize = 64 << 20;

/// Gives bytes to a decoder that calls itself, as long as it is not too deep.
struct Shallow<R> {
    source: R,
    /// Where the stack was when decoding began.
    top: usize,
}

impl<R> Shallow<R> {
    #[inline(never)]
    fn begin(&mut self) {
        let here = 0u8;
        self.top = std::ptr::from_ref(&here).addr();
    }
}

impl<R: Read> Read for Shallow<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let here = 0u8;
        if self.top.abs_diff(std::ptr::from_ref(&here).addr()) > DEPTH_BYTES_MAX {
            return Err(std::io::Error::other("a GPS time that refers to others without end"));
        }
        self.source.read(out)
    }
}

impl<R: Seek> Seek for Shallow<R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.source.seek(to)
    }
}

impl LasDecoder {
    /// Opens a file for what surfels are made of, checks and reads its header, and stands at its first point.
    pub fn open(path: &Path) -> Result<(Self, Header), CloudError> {
        Self::open_for(path, what_surfels_have())
    }

    /// The same for all that points have. Where layers of compressed points are made to have their decoder call itself without end, it overflows the stack.
    pub fn open_whole(path: &Path) -> Result<(Self, Header), CloudError> {
        Self::open_for(path, DecompressionSelection::all())
    }

    fn open_for(
        path: &Path,
        selection: DecompressionSelection,
    ) -> Result<(Self, Header), CloudError> {
        let mut reader = BufReader::with_capacity(1 << 18, GuardedFile::open(path)?);
        let header = guard(path, || "header".into(), || Header::new(&mut reader))?;
        let uncounted = reader.get_ref().uncounted;
        let points = match header.point_format().is_compressed {
            false => Points::Plain(reader),
            true => open_compressed(reader, &header, path, selection)?,
        };
        Ok((Self { points, path: path.to_owned(), uncounted }, header))
    }

    /// Fills `bytes`, a whole number of points. `place` is for messages.
    pub fn read(
        &mut self,
        bytes: &mut [u8],
        place: impl Fn() -> String + Send,
    ) -> Result<(), CloudError> {
        let path = &self.path;
        let points = match &mut self.points {
            Points::Plain(reader) => return guard(path, place, || reader.read_exact(bytes)),
            Points::Compressed(points) => points,
        };
        let is_recursive = points.is_recursive;
        let read = || guard(path, place, || points.read(bytes));
        if !is_recursive {
            return read();
        }
        thread::scope(|scope| {
            let thread = thread::Builder::new()
                .stack_size(STACK_BYTES)
                .spawn_scoped(scope, read)
                .map_err(|e| CloudError::io(path, "start a thread for", e))?;
            thread.join().unwrap_or_else(|panic| resume_unwind(panic))
        })
    }
}

/// Starts decompressing at the points of a LAZ file.
fn open_compressed(
    mut reader: BufReader<GuardedFile>,
    header: &Header,
    path: &Path,
    selection: DecompressionSelection,
) -> Result<Points, CloudError> {
    let vlr = guard(path, || "header".into(), || header.laz_vlr())?;
    let point_bytes = u64::from(header.point_format().len());
    // Not by `items_size`, whose sum has 16 bits.
    let item_bytes: u64 = vlr.items().iter().map(|item| u64::from(item.size())).sum();
    if item_bytes != point_bytes {
        return Err(CloudError::malformed(
            path,
            format!(
                "compressed points are {item_bytes} bytes, expected {point_bytes} by the header"
            ),
        ));
    }
    // Compressor 1 writes a single chunk and no table.
    let record = header.vlrs().iter().find(|vlr| las::laz::is_laszip_vlr(vlr));
    if record.is_some_and(|vlr| !vlr.data.starts_with(&[1, 0])) {
        check_chunk_table(&mut reader)
            .map_err(|e| CloudError::io(path, "read", e))?
            .map_err(|message| CloudError::malformed(path, message))?;
    }
    let layers = LayerGuard::new(&vlr, &mut reader).map_err(|e| CloudError::io(path, "read", e))?;
    let may_recur = |item: &LazItem| match item.item_type() {
        LazItemType::GpsTime => item.version() > 1,
        LazItemType::Point14 => selection.should_decompress_gps_time(),
        _ => false,
    };
    let is_recursive = vlr.items().iter().any(may_recur);
    let mut reader = Shallow { source: reader, top: 0 };
    reader.begin();
    let start = || LasZipDecompressor::selective(reader, vlr, selection);
    let decompressor = guard(path, || "header".into(), start)?;
    Ok(Points::Compressed(Box::new(Compressed { decompressor, layers, is_recursive })))
}

/// The layers that surfels are made of.
fn what_surfels_have() -> DecompressionSelection {
    DecompressionSelection::base()
        .decompress_z()
        .decompress_classification()
        .decompress_flags()
        .decompress_intensity()
        .decompress_rgb()
}

/// Checks the layer sizes of each chunk of a layered LAZ file (point formats 6 and up) before the
/// decompressor allocates them.
///
/// A chunk begins with its first point, uncompressed, the number of its points (u32), and the size
/// of each layer (u32).
struct LayerGuard {
    point_bytes: usize,
    /// Layers per chunk; 0 where points are not layered and nothing needs checking.
    layers: usize,
    /// Points per chunk where that is fixed.
    chunk_points: Option<u64>,
    /// Bytes of points left in the current chunk.
    left_bytes: u64,
    file_bytes: u64,
}

impl LayerGuard {
    fn new(vlr: &LazVlr, reader: &mut (impl Read + Seek)) -> std::io::Result<Self> {
        let here = reader.stream_position()?;
        let file_bytes = reader.seek(SeekFrom::End(0))?;
        reader.seek(SeekFrom::Start(here))?;
        let layers_of = |item: LazItemType| match item {
            LazItemType::Point14 => 9,
            LazItemType::RGB14 | LazItemType::WavePacket14 => 1,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(count) => usize::from(count),
            _ => 0,
        };
        Ok(Self {
            point_bytes: vlr.items_size() as usize,
            layers: vlr.items().iter().map(|item| layers_of(item.item_type())).sum(),
            chunk_points: (!vlr.uses_variable_size_chunks()).then_some(vlr.chunk_size().into()),
            left_bytes: 0,
            file_bytes,
        })
    }

    /// Bytes of points, at most `wanted`, that may be decompressed before the next check; `reader`
    /// stands at the start of a chunk whenever one ended.
    fn bytes_before_check(
        &mut self,
        reader: &mut BufReader<GuardedFile>,
        wanted: usize,
    ) -> std::io::Result<usize> {
        if self.layers == 0 {
            return Ok(wanted);
        }
        if self.left_bytes == 0 {
            let points = self.check_chunk(reader)?;
            self.left_bytes = points.saturating_mul(self.point_bytes as u64);
        }
        let take = self.left_bytes.min(wanted as u64);
        self.left_bytes -= take;
        Ok(take as usize)
    }

    /// Compares the layers of the chunk at `reader` with the file; returns its number of points.
    fn check_chunk(&self, reader: &mut BufReader<GuardedFile>) -> std::io::Result<u64> {
        let start = reader.stream_position()?;
        let mut head = vec![0u8; self.point_bytes + 4 + 4 * self.layers];
        reader.read_exact(&mut head)?;
        let end = reader.stream_position()?;
        reader.seek_relative(start as i64 - end as i64)?;
        let (words, _) = head[self.point_bytes..].as_chunks::<4>();
        let points = u64::from(u32::from_le_bytes(words[0]));
        let layers: u64 = words[1..].iter().map(|w| u64::from(u32::from_le_bytes(*w))).sum();
        if layers > self.file_bytes.saturating_sub(end) || points == 0 {
            return Err(std::io::Error::other(format!(
                "a chunk of {points} points and {layers} bytes at byte {start} of {}",
                self.file_bytes
            )));
        }
        Ok(self.chunk_points.unwrap_or(points))
    }
}

/// Runs a decoder step; its errors, and its panics on damaged data, become errors of ours.
pub(crate) fn guard<T, E: std::fmt::Display>(
    path: &Path,
    place: impl Fn() -> String,
    step: impl FnOnce() -> Result<T, E>,
) -> Result<T, CloudError> {
    // After an error the source is not read on.
    match catch_decoder_panic(step) {
        Some(Ok(value)) => Ok(value),
        Some(Err(error)) => Err(CloudError::malformed(
            path,
            format!("{}: {error}; the file is damaged or cut short", place()),
        )),
        None => Err(CloudError::malformed(
            path,
            format!("{}: the compressed data make no sense; the file is damaged", place()),
        )),
    }
}

/// A LAS file whose header was checked and claims no extended records.
struct GuardedFile {
    uncounted: u64,
    file: File,
    header: Vec<u8>,
    position: u64,
}

impl GuardedFile {
    fn open(path: &Path) -> Result<Self, CloudError> {
        let io = |e| CloudError::io(path, "read", e);
        let mut file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
        let length = file.seek(SeekFrom::End(0)).map_err(io)?;
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        let mut header = Vec::with_capacity(HEADER_BYTES_MAX);
        file.by_ref().take(HEADER_BYTES_MAX as u64).read_to_end(&mut header).map_err(io)?;
        check_header(&header, length).map_err(|message| CloudError::malformed(path, message))?;
        let uncounted = count_uncounted(&header, length);
        hide_extended_records(&mut header);
        prefer_long_count(&mut header);
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        Ok(Self { uncounted, file, header, position: 0 })
    }
}

impl Read for GuardedFile {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let read = match usize::try_from(self.position) {
            Ok(at) if at < self.header.len() => {
                let n = out.len().min(self.header.len() - at);
                out[..n].copy_from_slice(&self.header[at..at + n]);
                self.file.seek_relative(n as i64)?;
                n
            }
            _ => self.file.read(out)?,
        };
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for GuardedFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.position = self.file.seek(to)?;
        Ok(self.position)
    }
}

/// Compares the sizes a LAS header claims with the `length` of its file. Offsets are those of the
/// LAS 1.4 specification, section 2.4.
fn check_header(header: &[u8], length: u64) -> Result<(), String> {
    if header.len() < 227 || header[..4] != LAS_MAGIC {
        return Err("not a LAS file: expected `LASF` and a header of 227 bytes at its start".into());
    }
    let u16_at = |at: usize| u64::from(u16::from_le_bytes(array_at(header, at)));
    let u32_at = |at: usize| u64::from(u32::from_le_bytes(array_at(header, at)));
    let (major, minor) = (header[24], header[25]);
    if major != 1 || minor > 4 {
        return Err(format!("version {major}.{minor}, expected 1.0 to 1.4"));
    }
    let header_size_min = match minor {
        0..=2 => 227,
        3 => 235,
        _ => 375,
    };
    let (header_size, offset) = (u16_at(94), u32_at(96));
    if header_size < header_size_min || (header.len() as u64) < header_size_min {
        return Err(format!("header of {header_size} bytes, expected {header_size_min}"));
    }
    if offset < header_size || offset > length.min(POINTS_OFFSET_MAX) {
        return Err(format!("points at byte {offset} of {length}; the file is damaged"));
    }
    let records = u32_at(100);
    if records.saturating_mul(54) > offset {
        return Err(format!("{records} records before the points at byte {offset}"));
    }
    let is_compressed = header[104] & 0xc0 != 0;
    let count = long_count(header).unwrap_or(u32_at(107));
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let scale = f64::from_le_bytes(array_at(header, 131 + 8 * axis));
        if count > 0 && (scale == 0.0 || !scale.is_finite()) {
            return Err(format!(
                "the scale of {name} is {scale}, which leaves no coordinates; write the file again"
            ));
        }
    }
    // Even the best compression leaves a bit per 8 points in each chunk.
    let fits = match is_compressed {
        false => count.checked_mul(u16_at(105)).is_some_and(|b| b <= length - offset),
        true => count / 64 <= length,
    };
    if !fits {
        return Err(format!(
            "{count} points do not fit into {length} bytes; the file is cut short or its header \
             is damaged"
        ));
    }
    Ok(())
}

/// Uncompressed points that there is room for between those that a header counts and what it places behind them.
fn count_uncounted(header: &[u8], length: u64) -> u64 {
    let u16_at = |at: usize| u64::from(u16::from_le_bytes(array_at(header, at)));
    let u32_at = |at: usize| u64::from(u32::from_le_bytes(array_at(header, at)));
    let (offset, record_bytes) = (u32_at(96), u16_at(105));
    if header[104] & 0xc0 != 0 || record_bytes == 0 {
        return 0;
    }
    let has_place = |at: usize, minor: u8| {
        (header[25] >= minor).then(|| u64::from_le_bytes(array_at(header, at)))
    };
    // Waveforms since version 1.3, extended records since 1.4.
    let places = [has_place(227, 3), has_place(235, 4)].into_iter().flatten();
    let end = places.filter(|place| *place > offset).fold(length, u64::min);
    let count = long_count(header).unwrap_or(u32_at(107));
    (end.saturating_sub(offset) / record_bytes).saturating_sub(count)
}

/// Refuses a LAZ chunk table with more chunks than the file has room for. `reader` stands at the
/// first compressed byte, and stands there again afterwards.
fn check_chunk_table(reader: &mut (impl Read + Seek)) -> std::io::Result<Result<(), String>> {
    let offset = reader.stream_position()?;
    let length = reader.seek(SeekFrom::End(0))?;
    let mut read_at = |at: u64| -> std::io::Result<Option<[u8; 8]>> {
        let mut bytes = [0u8; 8];
        if at > length.saturating_sub(8) {
            return Ok(None);
        }
        reader.seek(SeekFrom::Start(at))?;
        reader.read_exact(&mut bytes)?;
        Ok(Some(bytes))
    };
    let Some(first) = read_at(offset)? else {
        return Ok(Err("the file ends before its compressed points".into()));
    };
    let mut table = i64::from_le_bytes(first);
    if table <= offset as i64 {
        // Streamed files keep the place at their end.
        table = read_at(length - 8)?.map_or(0, i64::from_le_bytes);
    }
    let Some(start) = u64::try_from(table).ok().filter(|&t| t > offset) else {
        return Ok(Err("the table of compressed chunks is missing; the file is cut short".into()));
    };
    let Some(head) = read_at(start)? else {
        return Ok(Err(format!("chunk table at byte {start} of {length}; the file is cut short")));
    };
    let chunks = u32::from_le_bytes(array_at(&head, 4));
    if u64::from(chunks) > length / 8 {
        return Ok(Err(format!("{chunks} compressed chunks in a file of {length} bytes")));
    }
    reader.seek(SeekFrom::Start(offset))?;
    Ok(Ok(()))
}

/// The number of points of 64 bits, which must be right since version 1.4; 0 where a writer left it out.
fn long_count(header: &[u8]) -> Option<u64> {
    let count = (header[25] >= 4).then(|| u64::from_le_bytes(array_at(header, 247)));
    count.filter(|count| *count > 0)
}

/// Programs that change a file update one number of points; readers look at the old one first.
fn prefer_long_count(header: &mut [u8]) {
    if long_count(header).is_some() {
        header[107..111].fill(0);
    }
}

/// Sets the place of waveforms and extended records to none.
fn hide_extended_records(header: &mut [u8]) {
    let end = match header[25] {
        0..=2 => return,
        3 => 235,
        _ => 247,
    };
    header[227..end].fill(0);
}

pub(crate) fn array_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    std::array::from_fn(|i| bytes[at + i])
}
