//! PLY headers and rows: ASCII and binary of both byte orders, any elements, properties and types.
//!
//! A PLY file is a text header, which names elements (`vertex`, `face` …) with their row counts and
//! properties, then the rows of each element in the header's order. [`PlyReader`] walks them with
//! bounded buffers: nothing is allocated on the word of a header.

use crate::{CloudError, parse_number};
use std::io::{BufRead, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Longest header line or ASCII row, in bytes.
const LINE_BYTES_MAX: u64 = 1 << 20;
/// Most lines of a header.
const HEADER_LINES_MAX: usize = 10_000;
/// Most values of one list property.
const LIST_LENGTH_MAX: f64 = (1u32 << 20) as f64;
/// The same, and longest ASCII row in bytes, where long rows are allowed.
const LONG_LIST_LENGTH_MAX: f64 = (1u32 << 31) as f64;
const LONG_LINE_BYTES_MAX: u64 = 1 << 34;

/// How the rows of a PLY file are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyFormat {
    /// One row a line, values separated by blanks.
    Ascii,
    /// Packed values, lowest byte first.
    BinaryLittleEndian,
    /// Packed values, highest byte first.
    BinaryBigEndian,
}

/// Type of a PLY value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlyType {
    /// `char`, `int8`.
    I8,
    /// `uchar`, `uint8`.
    U8,
    /// `short`, `int16`.
    I16,
    /// `ushort`, `uint16`.
    U16,
    /// `int`, `int32`.
    I32,
    /// `uint`, `uint32`.
    U32,
    /// `float`, `float32`.
    #[default]
    F32,
    /// `double`, `float64`.
    F64,
}

impl PlyType {
    /// The type of a PLY type name, old (`uchar`) or new (`uint8`).
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// The old name of the type, which all readers know.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Whether every value of the type is one of `f32`, too.
    #[must_use]
    pub fn fits_f32(self) -> bool {
        !matches!(self, Self::I32 | Self::U32 | Self::F64)
    }

    /// Appends a value, lowest byte first: rounded to the type, or its nearest end.
    pub fn encode(self, value: f64, bytes: &mut Vec<u8>) {
        match self {
            Self::I8 => bytes.extend((value as i8).to_le_bytes()),
            Self::U8 => bytes.extend((value as u8).to_le_bytes()),
            Self::I16 => bytes.extend((value as i16).to_le_bytes()),
            Self::U16 => bytes.extend((value as u16).to_le_bytes()),
            Self::I32 => bytes.extend((value as i32).to_le_bytes()),
            Self::U32 => bytes.extend((value as u32).to_le_bytes()),
            Self::F32 => bytes.extend((value as f32).to_le_bytes()),
            Self::F64 => bytes.extend(value.to_le_bytes()),
        }
    }

    /// Bytes of a binary value.
    #[must_use]
    pub fn size_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Value of the first [`PlyType::size_bytes`] bytes; f64 holds every PLY type exactly.
    ///
    /// # Panics
    ///
    /// If `bytes` is shorter than the type.
    #[must_use]
    #[inline]
    pub fn decode(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut b = [0u8; 8];
        let size = self.size_bytes();
        b[..size].copy_from_slice(&bytes[..size]);
        if big_endian {
            b[..size].reverse();
        }
        let low4 = [b[0], b[1], b[2], b[3]];
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes(low4)),
            Self::U32 => f64::from(u32::from_le_bytes(low4)),
            Self::F32 => f64::from(f32::from_le_bytes(low4)),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

/// One value or a list of values per row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyKind {
    /// One value.
    Scalar(PlyType),
    /// A count, then that many values.
    List {
        /// Type of the count.
        count: PlyType,
        /// Type of the values.
        item: PlyType,
    },
}

/// A column of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyProperty {
    /// Name as written.
    pub name: String,
    /// What each row holds.
    pub kind: PlyKind,
}

/// A table of rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyElement {
    /// Name as written: `vertex`, `face` …
    pub name: String,
    /// Rows the header claims; the file may be cut short.
    pub count: u64,
    /// Columns in file order.
    pub properties: Vec<PlyProperty>,
}

impl PlyElement {
    /// Index of the property called `name`, else of the only one so called in other case.
    #[must_use]
    pub fn property(&self, name: &str) -> Option<usize> {
        let exact = self.properties.iter().position(|p| p.name == name);
        exact.or_else(|| {
            let is_it = |p: &PlyProperty| p.name.eq_ignore_ascii_case(name);
            let first = self.properties.iter().position(is_it)?;
            let last = self.properties.iter().rposition(is_it)?;
            (first == last).then_some(first)
        })
    }

    /// Bytes of a binary row, `None` when a list makes rows differ.
    #[must_use]
    pub fn stride_bytes(&self) -> Option<usize> {
        self.properties
            .iter()
            .map(|p| match p.kind {
                PlyKind::Scalar(ty) => Some(ty.size_bytes()),
                PlyKind::List { .. } => None,
            })
            .sum()
    }
}

/// What a PLY file says it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyHeader {
    /// How rows are written.
    pub format: PlyFormat,
    /// Tables in file order.
    pub elements: Vec<PlyElement>,
}

impl PlyHeader {
    /// Reads a header and leaves `reader` at the first row.
    ///
    /// # Errors
    ///
    /// [`CloudError::Malformed`] naming the header line, [`CloudError::Io`] when reading fails.
    pub fn read(reader: &mut impl BufRead, path: &Path) -> Result<Self, CloudError> {
        let mut line = Vec::new();
        let mut format = None;
        let mut elements: Vec<PlyElement> = Vec::new();
        for number in 1..=HEADER_LINES_MAX {
            let bad = |message: String| {
                CloudError::malformed(path, format!("header line {number}: {message}"))
            };
            if !read_line(reader, &mut line, path, LINE_BYTES_MAX)? {
                return Err(bad("the file ends before `end_header`".into()));
            }
            // Comments are for people, in any encoding.
            if number > 1 && is_comment(&line) {
                continue;
            }
            let text = std::str::from_utf8(&line).map_err(|_| bad("not text".into()))?;
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["ply"] if number == 1 => {}
                _ if number == 1 => return Err(bad("expected `ply`; not a PLY file".into())),
                [] => {}
                ["format", name, _version] => {
                    format = Some(parse_format(name).ok_or_else(|| {
                        bad(format!(
                            "unknown format `{name}`, expected `ascii`, `binary_little_endian` or \
                             `binary_big_endian`"
                        ))
                    })?);
                }
                ["element", name, count] => elements.push(PlyElement {
                    name: (*name).to_owned(),
                    count: count
                        .parse()
                        .map_err(|_| bad(format!("row count `{count}` is not a number")))?,
                    properties: Vec::new(),
                }),
                ["property", rest @ ..] => elements
                    .last_mut()
                    .ok_or_else(|| bad("`property` before any `element`".into()))?
                    .properties
                    .push(parse_property(rest).map_err(bad)?),
                ["end_header"] => {
                    let format = format.ok_or_else(|| bad("no `format` line".into()))?;
                    if let Some(e) =
                        elements.iter().find(|e| e.count > 0 && e.properties.is_empty())
                    {
                        return Err(bad(format!("element `{}` has rows but no property", e.name)));
                    }
                    return Ok(Self { format, elements });
                }
                _ => return Err(bad(format!("`{}` is not understood", text.trim()))),
            }
        }
        Err(CloudError::malformed(path, format!("no `end_header` in {HEADER_LINES_MAX} lines")))
    }

    /// The element called `name`.
    #[must_use]
    pub fn element(&self, name: &str) -> Option<&PlyElement> {
        self.elements.iter().find(|e| e.name == name)
    }
}

fn is_comment(line: &[u8]) -> bool {
    let word = line.trim_ascii_start().split(u8::is_ascii_whitespace).next();
    matches!(word, Some(b"comment" | b"obj_info"))
}

fn parse_format(name: &str) -> Option<PlyFormat> {
    Some(match name {
        "ascii" => PlyFormat::Ascii,
        "binary_little_endian" => PlyFormat::BinaryLittleEndian,
        "binary_big_endian" => PlyFormat::BinaryBigEndian,
        _ => return None,
    })
}

fn parse_property(words: &[&str]) -> Result<PlyProperty, String> {
    let ty = |name: &str| {
        PlyType::from_name(name).ok_or_else(|| format!("unknown property type `{name}`"))
    };
    let (kind, name) = match words {
        ["list", count, item, name] => (PlyKind::List { count: ty(count)?, item: ty(item)? }, name),
        [scalar, name] => (PlyKind::Scalar(ty(scalar)?), name),
        _ => return Err("a property needs a type and a name".into()),
    };
    Ok(PlyProperty { name: (*name).to_owned(), kind })
}

/// Reads a line without its end into `line`; `false` at the end of the file.
fn read_line(
    reader: &mut impl BufRead,
    line: &mut Vec<u8>,
    path: &Path,
    bytes_max: u64,
) -> Result<bool, CloudError> {
    line.clear();
    let read = reader
        .by_ref()
        .take(bytes_max)
        .read_until(b'\n', line)
        .map_err(|e| CloudError::io(path, "read", e))?;
    if read as u64 == bytes_max && line.last() != Some(&b'\n') {
        return Err(CloudError::malformed(
            path,
            format!("a line is longer than {bytes_max} bytes; not a PLY file"),
        ));
    }
    while matches!(line.last(), Some(b'\n' | b'\r')) {
        line.pop();
    }
    Ok(read > 0)
}

/// The values of one row.
#[derive(Clone, Debug, Default)]
pub struct PlyRow {
    values: Vec<f64>,
    /// Where the values of each property end.
    ends: Vec<usize>,
}

impl PlyRow {
    /// Values of property `index`: one of a scalar, any number of a list.
    ///
    /// # Panics
    ///
    /// If the row has no property `index`.
    #[must_use]
    pub fn list(&self, index: usize) -> &[f64] {
        let start = if index == 0 { 0 } else { self.ends[index - 1] };
        &self.values[start..self.ends[index]]
    }

    /// Value of the scalar property `index`; the first of a list, NaN if that is empty.
    ///
    /// # Panics
    ///
    /// If the row has no property `index`.
    #[must_use]
    pub fn scalar(&self, index: usize) -> f64 {
        self.list(index).first().copied().unwrap_or(f64::NAN)
    }
}

/// Walks the rows of a PLY file, element by element.
pub struct PlyReader<R> {
    reader: R,
    path: PathBuf,
    header: PlyHeader,
    /// Index of the current element and of its next row.
    element: usize,
    row: u64,
    bytes: Vec<u8>,
    /// Most values of a list, and bytes of an ASCII row.
    list_length_max: f64,
    line_bytes_max: u64,
}

impl<R: BufRead> PlyReader<R> {
    /// Reads the header; the first element is current. `path` is for messages.
    ///
    /// # Errors
    ///
    /// As [`PlyHeader::read`].
    pub fn new(mut reader: R, path: &Path) -> Result<Self, CloudError> {
        let header = PlyHeader::read(&mut reader, path)?;
        Ok(Self {
            reader,
            path: path.to_owned(),
            header,
            element: 0,
            row: 0,
            bytes: Vec::new(),
            list_length_max: LIST_LENGTH_MAX,
            line_bytes_max: LINE_BYTES_MAX,
        })
    }

    /// Allows rows as long as the file, such as that of all strips of a mesh. Else one has at most 2²⁰ values and bytes of text.
    pub fn allow_long_rows(&mut self) {
        self.list_length_max = LONG_LIST_LENGTH_MAX;
        self.line_bytes_max = LONG_LINE_BYTES_MAX;
    }

    /// The header.
    #[must_use]
    pub fn header(&self) -> &PlyHeader {
        &self.header
    }

    /// The element whose rows are being read, `None` behind the last.
    #[must_use]
    pub fn element(&self) -> Option<&PlyElement> {
        self.header.elements.get(self.element)
    }

    /// Rows of the current element read so far.
    #[must_use]
    pub fn row_index(&self) -> u64 {
        self.row
    }

    /// Skips what is left of the current element; the next one becomes current.
    ///
    /// # Errors
    ///
    /// If a skipped row is malformed or missing.
    pub fn next_element(&mut self) -> Result<(), CloudError> {
        let mut row = PlyRow::default();
        let mut bytes = Vec::new();
        while self.fill_rows(4096, &mut bytes)? > 0 {}
        while self.read_row(&mut row)? {}
        self.element += 1;
        self.row = 0;
        Ok(())
    }

    /// Skips forward until the element called `name` is current; `false` if none is ahead.
    ///
    /// # Errors
    ///
    /// If a skipped row is malformed or missing.
    pub fn seek_element(&mut self, name: &str) -> Result<bool, CloudError> {
        while let Some(element) = self.element() {
            if element.name == name {
                return Ok(true);
            }
            self.next_element()?;
        }
        Ok(false)
    }

    /// Reads the next row of the current element; `false` when it has no more.
    ///
    /// # Errors
    ///
    /// If the row is malformed or missing; the message names it.
    pub fn read_row(&mut self, row: &mut PlyRow) -> Result<bool, CloudError> {
        row.values.clear();
        row.ends.clear();
        match self.element() {
            Some(element) if self.row < element.count => {}
            _ => return Ok(false),
        }
        match self.header.format {
            PlyFormat::Ascii => self.read_ascii_row(row)?,
            PlyFormat::BinaryLittleEndian => self.read_binary_row(row, false)?,
            PlyFormat::BinaryBigEndian => self.read_binary_row(row, true)?,
        }
        self.row += 1;
        Ok(true)
    }

    /// Reads up to `rows_max` whole rows as bytes into `out`, which is overwritten, and returns
    /// their number: 0 when there are no more, or when the current element is not of a fixed
    /// binary stride ([`PlyElement::stride_bytes`]) and must be read row by row.
    ///
    /// # Errors
    ///
    /// If a row is missing.
    pub fn fill_rows(&mut self, rows_max: usize, out: &mut Vec<u8>) -> Result<usize, CloudError> {
        out.clear();
        let Some(element) = self.element() else { return Ok(0) };
        let left = element.count - self.row;
        let Some(stride) = element.stride_bytes() else { return Ok(0) };
        if self.header.format == PlyFormat::Ascii || stride == 0 {
            return Ok(0);
        }
        let rows = rows_max.min(usize::try_from(left).unwrap_or(usize::MAX));
        let wanted = rows * stride;
        let read = self
            .reader
            .by_ref()
            .take(wanted as u64)
            .read_to_end(out)
            .map_err(|e| CloudError::io(&self.path, "read", e))?;
        if read < wanted {
            self.row += (read / stride) as u64;
            return Err(self.cut_short());
        }
        self.row += rows as u64;
        Ok(rows)
    }

    fn read_ascii_row(&mut self, row: &mut PlyRow) -> Result<(), CloudError> {
        let mut line = std::mem::take(&mut self.bytes);
        // Blank lines carry nothing.
        while {
            if !read_line(&mut self.reader, &mut line, &self.path, self.line_bytes_max)? {
                return Err(self.cut_short());
            }
            line.trim_ascii().is_empty()
        } {}
        let parsed = parse_ascii_row(&line, self.properties(), self.list_length_max, row);
        self.bytes = line;
        parsed.map_err(|message| self.bad_row(&message))
    }

    fn read_binary_row(&mut self, row: &mut PlyRow, big_endian: bool) -> Result<(), CloudError> {
        for index in 0..self.properties().len() {
            match self.properties()[index].kind {
                PlyKind::Scalar(ty) => self.read_values(1, ty, big_endian, row)?,
                PlyKind::List { count, item } => {
                    self.read_values(1, count, big_endian, row)?;
                    let length = row.values.pop().unwrap_or(f64::NAN);
                    let length = list_length(length, self.list_length_max)
                        .map_err(|message| self.bad_row(&message))?;
                    self.read_values(length, item, big_endian, row)?;
                }
            }
            row.ends.push(row.values.len());
        }
        Ok(())
    }

    fn read_values(
        &mut self,
        count: usize,
        ty: PlyType,
        big_endian: bool,
        row: &mut PlyRow,
    ) -> Result<(), CloudError> {
        let mut bytes = [0u8; 8];
        let bytes = &mut bytes[..ty.size_bytes()];
        for _ in 0..count {
            match self.reader.read_exact(bytes) {
                Ok(()) => row.values.push(ty.decode(bytes, big_endian)),
                Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Err(self.cut_short()),
                Err(e) => return Err(CloudError::io(&self.path, "read", e)),
            }
        }
        Ok(())
    }

    fn properties(&self) -> &[PlyProperty] {
        self.element().map_or(&[], |e| &e.properties)
    }

    fn bad_row(&self, message: &str) -> CloudError {
        let name = self.element().map_or("", |e| &e.name);
        CloudError::malformed(&self.path, format!("{name} row {}: {message}", self.row))
    }

    fn cut_short(&self) -> CloudError {
        let count = self.element().map_or(0, |e| e.count);
        self.bad_row(&format!(
            "the file ends here, expected {count} rows; it is cut short or its header is wrong"
        ))
    }
}

fn parse_ascii_row(
    line: &[u8],
    properties: &[PlyProperty],
    list_length_max: f64,
    row: &mut PlyRow,
) -> Result<(), String> {
    let text = std::str::from_utf8(line).map_err(|_| "not text".to_owned())?;
    let mut words = text.split_ascii_whitespace();
    let mut next = |name: &str| {
        let word = words.next().ok_or_else(|| format!("no value for `{name}`"))?;
        parse_number(word).ok_or_else(|| format!("`{word}` for `{name}` is not a number"))
    };
    for property in properties {
        let length = match property.kind {
            PlyKind::Scalar(_) => 1,
            PlyKind::List { .. } => list_length(next(&property.name)?, list_length_max)?,
        };
        for _ in 0..length {
            row.values.push(next(&property.name)?);
        }
        row.ends.push(row.values.len());
    }
    match words.next() {
        Some(_) => Err("more values than the header names".to_owned()),
        None => Ok(()),
    }
}

fn list_length(value: f64, max: f64) -> Result<usize, String> {
    if (0.0..=max).contains(&value) && value.fract() == 0.0 {
        Ok(value as usize)
    } else {
        Err(format!("list length {value}, expected a whole number in 0..={max}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MESH: &str = "ply\r\nformat ascii 1.0\ncomment c\nelement vertex 2\nproperty float x\n\
         property uchar c\nelement face 1\nproperty list uchar int vertex_indices\n\
         property double w\nend_header\n1.5 2\n\n-3 255\n3 0 1 1 0.25\n";

    fn header_of(text: &str) -> Result<PlyHeader, CloudError> {
        PlyHeader::read(&mut text.as_bytes(), Path::new("t.ply"))
    }

    fn read_all(bytes: &[u8]) -> Result<Vec<Vec<f64>>, CloudError> {
        let mut reader = PlyReader::new(bytes, Path::new("t.ply"))?;
        let (mut rows, mut row) = (Vec::new(), PlyRow::default());
        while reader.element().is_some() {
            while reader.read_row(&mut row)? {
                rows.push(row.values.clone());
            }
            reader.next_element()?;
        }
        Ok(rows)
    }

    /// The rows of `MESH` in binary.
    fn binary_mesh(big_endian: bool) -> Vec<u8> {
        let name = if big_endian { "binary_big_endian" } else { "binary_little_endian" };
        let header = MESH.split_once("end_header\n").unwrap().0.replace("ascii", name);
        let mut bytes = header.into_bytes();
        bytes.extend_from_slice(b"end_header\n");
        let mut put = |mut value: Vec<u8>| {
            if big_endian {
                value.reverse();
            }
            bytes.extend(value);
        };
        for (x, c) in [(1.5f32, 2u8), (-3.0, 255)] {
            put(x.to_le_bytes().to_vec());
            put(vec![c]);
        }
        put(vec![3]);
        for i in [0i32, 1, 1] {
            put(i.to_le_bytes().to_vec());
        }
        put(0.25f64.to_le_bytes().to_vec());
        bytes
    }

    #[test]
    fn every_format_gives_the_same_rows() {
        let expected = vec![vec![1.5, 2.0], vec![-3.0, 255.0], vec![0.0, 1.0, 1.0, 0.25]];
        assert_eq!(read_all(MESH.as_bytes()).unwrap(), expected);
        assert_eq!(read_all(&binary_mesh(false)).unwrap(), expected);
        assert_eq!(read_all(&binary_mesh(true)).unwrap(), expected);
    }

    #[test]
    fn comments_may_be_in_any_encoding() {
        let mut bytes = MESH.as_bytes().to_vec();
        let place = MESH.find("comment c").unwrap() + 8;
        bytes[place] = 0xfc;
        assert_eq!(read_all(&bytes).unwrap().len(), 3);
        let place = MESH.find("obj_info").unwrap_or(MESH.find("float x").unwrap());
        bytes[place] = 0xfc;
        assert!(read_all(&bytes).unwrap_err().to_string().contains("not text"));
    }

    #[test]
    fn rows_may_be_long_where_that_is_allowed() {
        let length = 1_100_000;
        let header = format!(
            "ply\nformat ascii 1.0\nelement tristrips 1\nproperty list int int vertex_indices\n\
             end_header\n{length}"
        );
        let bytes = [header.as_bytes(), &b" 1".repeat(length), b"\n"].concat();
        for allowed in [false, true] {
            let mut reader = PlyReader::new(bytes.as_slice(), Path::new("t.ply")).unwrap();
            if allowed {
                reader.allow_long_rows();
            }
            let mut row = PlyRow::default();
            assert_eq!(reader.read_row(&mut row).is_ok(), allowed);
            assert_eq!(row.values.len(), if allowed { length } else { 0 });
        }
    }

    #[test]
    fn elements_are_found_by_name() {
        for bytes in [MESH.as_bytes().to_vec(), binary_mesh(false)] {
            let mut reader = PlyReader::new(bytes.as_slice(), Path::new("t.ply")).unwrap();
            assert!(reader.seek_element("face").unwrap());
            let mut row = PlyRow::default();
            assert!(reader.read_row(&mut row).unwrap());
            assert_eq!(row.list(0), [0.0, 1.0, 1.0]);
            assert_eq!(row.scalar(1), 0.25);
            assert!(!reader.read_row(&mut row).unwrap());
            assert!(!reader.seek_element("vertex").unwrap());
        }
    }

    #[test]
    fn files_cut_anywhere_are_refused() {
        for bytes in [MESH.as_bytes().to_vec(), binary_mesh(false), binary_mesh(true)] {
            // The last line end of a text file may be missing, and its last digits cannot be missed.
            let end = if bytes == MESH.as_bytes() { bytes.len() - 5 } else { bytes.len() };
            for length in 0..end {
                assert!(read_all(&bytes[..length]).is_err(), "{length}");
            }
        }
    }

    #[test]
    fn header_errors_name_the_line() {
        for (text, expected) in [
            ("", "header line 1: the file ends"),
            ("plyx\n", "header line 1: expected `ply`"),
            ("ply\nformat latin 1.0\n", "header line 2: unknown format `latin`"),
            ("ply\nelement vertex -1\n", "header line 2: row count `-1`"),
            ("ply\nproperty float x\n", "header line 2: `property` before"),
            ("ply\nelement v 1\nproperty complex x\n", "unknown property type `complex`"),
            ("ply\nelement v 1\nproperty float\n", "needs a type and a name"),
            ("ply\nelement v 1\nend_header\n", "no `format`"),
            ("ply\nformat ascii 1.0\nelement v 9\nend_header\n", "rows but no property"),
            ("ply\nhello\n", "`hello` is not understood"),
        ] {
            let message = header_of(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn claimed_sizes_are_not_believed() {
        let text = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nend_header\n",
            u64::MAX
        );
        assert!(read_all(text.as_bytes()).unwrap_err().to_string().contains("vertex row 0"));
        let mut list = b"ply\nformat binary_little_endian 1.0\nelement face 1\n\
            property list uint double i\nend_header\n"
            .to_vec();
        list.extend(u32::MAX.to_le_bytes());
        assert!(read_all(&list).unwrap_err().to_string().contains("list length"));
    }
}
