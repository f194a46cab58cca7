//! Rows of numbers as PLY, NumPy array or CSV.

use crate::output::{commit_output, create_output};
use crate::{CloudError, PlyType, PlyWriter};
use pbgi_file::AtomicFile;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

/// Digits of the longest row count in a NumPy header.
const COUNT_DIGITS: usize = 20;
/// Headers of NumPy files are multiples of this.
const NPY_ALIGN: usize = 64;

/// A column of a table that is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypedColumn {
    /// Its name.
    pub name: String,
    /// Type of its values.
    pub kind: PlyType,
}

impl TypedColumn {
    /// Columns of the type `float`, but the first `double_count` of `double`.
    #[must_use]
    pub fn floats(names: &[impl AsRef<str>], double_count: usize) -> Vec<Self> {
        let kind = |index| if index < double_count { PlyType::F64 } else { PlyType::F32 };
        let names = names.iter().enumerate();
        names.map(|(i, name)| Self { name: name.as_ref().to_owned(), kind: kind(i) }).collect()
    }

    /// How NumPy names the type.
    fn numpy_kind(&self) -> &'static str {
        match self.kind {
            PlyType::I8 => "<i1",
            PlyType::U8 => "<u1",
            PlyType::I16 => "<i2",
            PlyType::U16 => "<u2",
            PlyType::I32 => "<i4",
            PlyType::U32 => "<u4",
            PlyType::F32 => "<f4",
            PlyType::F64 => "<f8",
        }
    }
}

/// Writes rows of named columns, in a format told by the extension: `.npy`, a one-dimensional
/// structured array for NumPy; `.csv`, a line of names and a line per row, in the fewest digits that read back the same;
/// a binary PLY file for everything else. The file appears when it is complete.
///
/// ```
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("points.csv");
/// let mut writer = pbgi_cloud::RowWriter::create(&path, &["x", "AO"], 1)?;
/// writer.write_rows(&[0.1, 0.1])?;
/// assert_eq!(writer.finish()?, 1);
/// assert_eq!(std::fs::read_to_string(&path).unwrap(), "x,AO\n0.1,0.1\n");
/// # Ok::<(), pbgi_cloud::CloudError>(())
/// ```
pub struct RowWriter(Format);

enum Format {
    Ply(PlyWriter),
    Npy(Table),
    Csv(Table),
}

/// A file of rows under way.
struct Table {
    file: AtomicFile,
    columns: Vec<TypedColumn>,
    row_count: u64,
    bytes: Vec<u8>,
}

impl RowWriter {
    /// Starts the file `path`. The first `double_count` columns are doubles, the others floats.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written, or a column name is empty, has blanks, or comes twice.
    pub fn create(
        path: &Path,
        columns: &[impl AsRef<str>],
        double_count: usize,
    ) -> Result<Self, CloudError> {
        Self::create_typed(path, TypedColumn::floats(columns, double_count), None)
    }

    /// Starts the file `path` with columns of any types. In a PLY file, the elements of the PLY file `source` but `vertex` follow.
    ///
    /// # Errors
    ///
    /// Those of [`RowWriter::create`], and if `source` cannot be read.
    pub fn create_typed(
        path: &Path,
        columns: Vec<TypedColumn>,
        source: Option<&Path>,
    ) -> Result<Self, CloudError> {
        let extension = path.extension().unwrap_or_default();
        if extension.eq_ignore_ascii_case("npy") {
            let mut table = Table::create(path, columns)?;
            table.put_npy_header()?;
            return Ok(Self(Format::Npy(table)));
        }
        if extension.eq_ignore_ascii_case("csv") {
            let mut table = Table::create(path, columns)?;
            table.put_names()?;
            return Ok(Self(Format::Csv(table)));
        }
        Ok(Self(Format::Ply(PlyWriter::create_typed(path, columns, source)?)))
    }

    /// Appends rows: the values of all columns, row after row, rounded to their types.
    ///
    /// # Errors
    ///
    /// If writing fails.
    ///
    /// # Panics
    ///
    /// If `values` is not whole rows.
    pub fn write_rows(&mut self, values: &[f64]) -> Result<(), CloudError> {
        match &mut self.0 {
            Format::Ply(writer) => writer.write_double_rows(values),
            Format::Npy(table) => table.write_rows(values, push_binary),
            Format::Csv(table) => table.write_rows(values, push_text),
        }
    }

    /// Completes the file; it appears under its name. Returns the number of rows.
    ///
    /// # Errors
    ///
    /// If writing fails; the file's name is then as it was.
    pub fn finish(self) -> Result<u64, CloudError> {
        match self.0 {
            Format::Ply(writer) => writer.finish(),
            Format::Csv(table) => table.commit(),
            Format::Npy(mut table) => {
                let start = table.file.seek(SeekFrom::Start(0));
                start.map_err(|e| CloudError::io(table.file.path(), "write", e))?;
                table.put_npy_header()?;
                table.commit()
            }
        }
    }
}

/// A row as NumPy keeps it.
fn push_binary(columns: &[TypedColumn], row: &[f64], bytes: &mut Vec<u8>) {
    for (column, value) in columns.iter().zip(row) {
        column.kind.encode(*value, bytes);
    }
}

/// A row as a line of text.
fn push_text(columns: &[TypedColumn], row: &[f64], bytes: &mut Vec<u8>) {
    let word = |(column, value): (&TypedColumn, &f64)| match column.kind {
        PlyType::F32 => (*value as f32).to_string(),
        _ => value.to_string(),
    };
    let words: Vec<String> = columns.iter().zip(row).map(word).collect();
    bytes.extend(words.join(",").bytes());
    bytes.push(b'\n');
}

impl Table {
    fn create(path: &Path, columns: Vec<TypedColumn>) -> Result<Self, CloudError> {
        check_names(path, &columns)?;
        let file = create_output(path)?;
        Ok(Self { file, columns, row_count: 0, bytes: Vec::new() })
    }

    fn write_rows(
        &mut self,
        values: &[f64],
        push: fn(&[TypedColumn], &[f64], &mut Vec<u8>),
    ) -> Result<(), CloudError> {
        let width = self.columns.len().max(1);
        assert!(values.len().is_multiple_of(width), "values must be whole rows");
        for row in values.chunks_exact(width) {
            self.bytes.clear();
            push(&self.columns, row, &mut self.bytes);
            self.flush()?;
        }
        self.row_count += (values.len() / width) as u64;
        Ok(())
    }

    /// The header of NumPy's format, version 1.0: of the same length whatever the number of rows.
    fn put_npy_header(&mut self) -> Result<(), CloudError> {
        let mut fields = String::new();
        for column in &self.columns {
            let kind = column.numpy_kind();
            let name = column.name.replace('\\', "\\\\").replace('\'', "\\'");
            fields.push_str(&format!("('{name}', '{kind}'), "));
        }
        let rows = self.row_count.to_string();
        let padding = COUNT_DIGITS.saturating_sub(rows.len());
        let mut text = format!(
            "{{'descr': [{fields}], 'fortran_order': False, 'shape': ({rows},), }}{:1$}",
            "", padding
        );
        let bytes = (10 + text.len() + 1).next_multiple_of(NPY_ALIGN) - 10;
        text.push_str(&" ".repeat(bytes - 1 - text.len()));
        text.push('\n');
        let Ok(length) = u16::try_from(text.len()) else {
            let message = format!("{} columns have too long names for .npy", self.columns.len());
            return Err(CloudError::malformed(self.file.path(), message));
        };
        self.bytes.clear();
        self.bytes.extend(b"\x93NUMPY\x01\x00");
        self.bytes.extend(length.to_le_bytes());
        self.bytes.extend(text.bytes());
        self.flush()
    }

    /// The first line of a CSV file; names with commas or quotes are quoted.
    fn put_names(&mut self) -> Result<(), CloudError> {
        let quoted = |TypedColumn { name, .. }: &TypedColumn| match name.contains([',', '"']) {
            true => format!("\"{}\"", name.replace('"', "\"\"")),
            false => name.clone(),
        };
        let names: Vec<String> = self.columns.iter().map(quoted).collect();
        self.bytes = (names.join(",") + "\n").into_bytes();
        self.flush()
    }

    fn flush(&mut self) -> Result<(), CloudError> {
        self.file.write_all(&self.bytes).map_err(|e| CloudError::io(self.file.path(), "write", e))
    }

    fn commit(self) -> Result<u64, CloudError> {
        commit_output(self.file)?;
        Ok(self.row_count)
    }
}

/// Refuses names that are empty, have blanks, or come twice.
pub(crate) fn check_names(path: &Path, columns: &[TypedColumn]) -> Result<(), CloudError> {
    for (index, TypedColumn { name, .. }) in columns.iter().enumerate() {
        let usable = !name.is_empty() && name.bytes().all(|b| b.is_ascii_graphic());
        if !usable || columns[..index].iter().any(|other| other.name == *name) {
            return Err(CloudError::malformed(
                path,
                format!("column name `{name}` is empty, has blanks, or comes twice"),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 3] = ["x", "it's", "a,b"];

    fn write(name: &str, rows: &[[f64; 3]]) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let mut writer = RowWriter::create(&path, &NAMES, 1).unwrap();
        rows.iter().for_each(|row| writer.write_rows(row).unwrap());
        assert!(!path.exists());
        assert_eq!(writer.finish().unwrap(), rows.len() as u64);
        std::fs::read(&path).unwrap()
    }

    const ROWS: [[f64; 3]; 2] = [[4_512_345.123_456, 0.1, -2.0], [f64::NAN, 1e-7, 3e38]];

    #[test]
    fn numpy_files_have_the_layout_of_their_format() {
        let bytes = write("t.NPY", &ROWS);
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!((10 + length) % 64, 0);
        let text = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
        let expected = "{'descr': [('x', '<f8'), ('it\\'s', '<f4'), ('a,b', '<f4'), ], \
                        'fortran_order': False, 'shape': (2,), }";
        assert_eq!(text.trim_end(), expected);
        assert!(text.ends_with('\n'));
        let mut data = Vec::new();
        let columns = TypedColumn::floats(&NAMES, 1);
        ROWS.iter().for_each(|row| push_binary(&columns, row, &mut data));
        assert_eq!(bytes[10 + length..], data);
        assert_eq!(data.len(), 2 * 16);
        // The header does not depend on the number of rows.
        assert_eq!(write("t.npy", &[]).len(), 10 + length);
    }

    #[test]
    fn whole_numbers_stay_whole() {
        let folder = tempfile::tempdir().unwrap();
        let columns = vec![
            TypedColumn { name: "id".into(), kind: PlyType::I32 },
            TypedColumn { name: "time".into(), kind: PlyType::F64 },
            TypedColumn { name: "red".into(), kind: PlyType::U8 },
        ];
        let write = |name: &str| {
            let path = folder.path().join(name);
            let mut writer = RowWriter::create_typed(&path, columns.clone(), None).unwrap();
            writer.write_rows(&[16_777_217.0, 0.1, 10.0]).unwrap();
            writer.finish().unwrap();
            std::fs::read(path).unwrap()
        };
        assert_eq!(write("t.csv"), b"id,time,red\n16777217,0.1,10\n");
        let array = write("t.npy");
        let kinds = b"('id', '<i4'), ('time', '<f8'), ('red', '<u1')";
        assert!(array.windows(kinds.len()).any(|window| window == kinds));
        assert!(array.ends_with(&[1, 0, 0, 1, 0x9a, 0x99, 0x99, 0x99, 0x99, 0x99, 0xb9, 0x3f, 10]));
    }

    #[test]
    fn csv_files_read_back_the_same() {
        let text = String::from_utf8(write("t.csv", &ROWS)).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "x,it's,\"a,b\"");
        assert_eq!(lines[1], "4512345.123456,0.1,-2");
        let numbers: Vec<f32> = lines[2].split(',').map(|word| word.parse().unwrap()).collect();
        assert!(numbers[0].is_nan() && numbers[1..] == [1e-7, 3e38], "{numbers:?}");
    }

    #[test]
    fn everything_else_is_ply() {
        assert!(write("t.ply", &ROWS).starts_with(b"ply\n"));
        let path = Path::new("x.csv");
        assert!(RowWriter::create(path, &["a", "a"], 0).is_err() && !path.exists());
    }
}
