//! Writing tables of named columns as PLY.

use crate::output::{commit_output, create_output};
use crate::row_writer::{TypedColumn, check_names};
use crate::{CloudError, PlyElement, PlyKind, PlyReader, PlyRow};
use pbgi_file::{AtomicFile, open_input};
use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Writes a PLY file of an element `vertex` with columns of any types, binary little-endian, row by
/// row; the number of rows need not be known before. The file appears when it is complete.
///
/// ```
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("points.ply");
/// let mut writer = pbgi_cloud::PlyWriter::create(&path, &["x", "y", "z", "AO"])?;
/// writer.write_rows(&[0.0, 0.0, 0.0, 1.0])?;
/// assert_eq!(writer.finish()?, 1);
/// # Ok::<(), pbgi_cloud::CloudError>(())
/// ```
pub struct PlyWriter {
    file: AtomicFile,
    columns: Vec<TypedColumn>,
    value_count: u64,
    bytes: Vec<u8>,
    /// A file whose other elements follow, and these.
    source: Option<(PathBuf, Vec<PlyElement>)>,
}

impl PlyWriter {
    /// Starts the file `path` with the given columns of type `float`.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written, or a column name is empty, has blanks, or comes twice.
    pub fn create(path: &Path, columns: &[impl AsRef<str>]) -> Result<Self, CloudError> {
        Self::create_with_doubles(path, columns, 0)
    }

    /// Starts the file `path` with the given columns, the first `double_count` of which are of type
    /// `double`, the others of type `float`: for coordinates far from the origin.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written, or a column name is empty, has blanks, or comes twice.
    pub fn create_with_doubles(
        path: &Path,
        columns: &[impl AsRef<str>],
        double_count: usize,
    ) -> Result<Self, CloudError> {
        Self::create_typed(path, TypedColumn::floats(columns, double_count), None)
    }

    /// Starts the file `path` with columns of any types. The elements of the PLY file `source` but `vertex`, such as faces, follow
    /// behind the rows as they are.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written, a column name is empty, has blanks, or comes twice, or `source` cannot be read.
    pub fn create_typed(
        path: &Path,
        columns: Vec<TypedColumn>,
        source: Option<&Path>,
    ) -> Result<Self, CloudError> {
        check_names(path, &columns)?;
        let source = source
            .map(|source| {
                let mut elements = open(source)?.header().elements.clone();
                elements.retain(|element| element.name != "vertex");
                Ok::<_, CloudError>((source.to_owned(), elements))
            })
            .transpose()?;
        let file = create_output(path)?;
        let mut writer = Self { file, columns, value_count: 0, bytes: Vec::new(), source };
        writer.write_header()?;
        Ok(writer)
    }

    /// Appends rows: the values of all columns, row after row.
    ///
    /// # Errors
    ///
    /// If writing fails.
    ///
    /// # Panics
    ///
    /// If `values` is not whole rows.
    pub fn write_rows(&mut self, values: &[f32]) -> Result<(), CloudError> {
        self.write_values(values.iter().map(|value| f64::from(*value)), values.len())
    }

    /// Appends rows as [`PlyWriter::write_rows`], rounded to the types of their columns.
    ///
    /// # Errors
    ///
    /// If writing fails.
    ///
    /// # Panics
    ///
    /// If `values` is not whole rows.
    pub fn write_double_rows(&mut self, values: &[f64]) -> Result<(), CloudError> {
        self.write_values(values.iter().copied(), values.len())
    }

    fn write_values(
        &mut self,
        values: impl Iterator<Item = f64>,
        count: usize,
    ) -> Result<(), CloudError> {
        assert!(count.is_multiple_of(self.columns.len().max(1)), "values must be whole rows");
        self.bytes.clear();
        for (value, column) in values.zip(self.columns.iter().cycle()) {
            column.kind.encode(value, &mut self.bytes);
        }
        self.value_count += count as u64;
        self.flush()
    }

    /// Completes the file; it appears under its name. Returns the number of rows.
    ///
    /// # Errors
    ///
    /// If writing fails; the file's name is then as it was.
    pub fn finish(mut self) -> Result<u64, CloudError> {
        if let Some((source, _)) = &self.source {
            let source = source.clone();
            self.copy_elements(&source)?;
        }
        self.file
            .seek(SeekFrom::Start(0))
            .map_err(|e| CloudError::io(self.file.path(), "write", e))?;
        self.write_header()?;
        let rows = self.row_count();
        commit_output(self.file)?;
        Ok(rows)
    }

    fn row_count(&self) -> u64 {
        self.value_count / self.columns.len().max(1) as u64
    }

    /// The header has the same length whatever the number of rows: a comment fills it up.
    fn write_header(&mut self) -> Result<(), CloudError> {
        let rows = self.row_count().to_string();
        let mut header = format!(
            "ply\nformat binary_little_endian 1.0\ncomment written by pbgi{:1$}\nelement vertex \
             {rows}\n",
            "",
            20 - rows.len(),
        );
        for TypedColumn { name, kind } in &self.columns {
            header.push_str(&format!("property {} {name}\n", kind.name()));
        }
        for element in self.source.iter().flat_map(|(_, elements)| elements) {
            header.push_str(&format!("element {} {}\n", element.name, element.count));
            for property in &element.properties {
                let kind = match property.kind {
                    PlyKind::Scalar(kind) => kind.name().to_owned(),
                    PlyKind::List { count, item } => {
                        format!("list {} {}", count.name(), item.name())
                    }
                };
                header.push_str(&format!("property {kind} {}\n", property.name));
            }
        }
        header.push_str("end_header\n");
        self.bytes = header.into_bytes();
        self.flush()
    }

    /// Appends the rows of all elements of `source` but its vertices.
    fn copy_elements(&mut self, source: &Path) -> Result<(), CloudError> {
        let mut reader = open(source)?;
        let mut row = PlyRow::default();
        while let Some(element) = reader.element().cloned() {
            while element.name != "vertex" && reader.read_row(&mut row)? {
                self.bytes.clear();
                for (index, property) in element.properties.iter().enumerate() {
                    let values = row.list(index);
                    let item = match property.kind {
                        PlyKind::Scalar(item) => item,
                        PlyKind::List { count, item } => {
                            count.encode(values.len() as f64, &mut self.bytes);
                            item
                        }
                    };
                    values.iter().for_each(|value| item.encode(*value, &mut self.bytes));
                }
                self.flush()?;
            }
            reader.next_element()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), CloudError> {
        self.file.write_all(&self.bytes).map_err(|e| CloudError::io(self.file.path(), "write", e))
    }
}

fn open(path: &Path) -> Result<PlyReader<BufReader<File>>, CloudError> {
    let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
    PlyReader::new(BufReader::new(file), path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PlyType;

    #[test]
    fn written_rows_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        let mut writer = PlyWriter::create(&path, &["x", "ref_r"]).unwrap();
        for i in 0..1000 {
            writer.write_rows(&[i as f32, -0.5 * i as f32]).unwrap();
        }
        assert!(!path.exists());
        assert_eq!(writer.finish().unwrap(), 1000);
        let bytes = std::fs::read(&path).unwrap();
        let mut reader = PlyReader::new(bytes.as_slice(), &path).unwrap();
        assert_eq!(reader.element().unwrap().count, 1000);
        let mut row = PlyRow::default();
        for i in 0..1000 {
            assert!(reader.read_row(&mut row).unwrap());
            assert_eq!((row.scalar(0), row.scalar(1)), (f64::from(i), -0.5 * f64::from(i)));
        }
    }

    #[test]
    fn double_columns_keep_their_digits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        let mut writer = PlyWriter::create_with_doubles(&path, &["x", "y", "r"], 2).unwrap();
        let row = [4_512_345.123_456, -0.1, 0.1];
        writer.write_double_rows(&row).unwrap();
        assert_eq!(writer.finish().unwrap(), 1);
        let bytes = std::fs::read(&path).unwrap();
        let mut reader = PlyReader::new(bytes.as_slice(), &path).unwrap();
        let mut values = PlyRow::default();
        assert!(reader.read_row(&mut values).unwrap());
        assert_eq!([0, 1].map(|i| values.scalar(i)), [row[0], row[1]]);
        assert_eq!(values.scalar(2), f64::from(0.1f32));
    }

    #[test]
    fn columns_keep_their_types_and_other_elements_follow() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("in.ply"), folder.path().join("out.ply"));
        let faces = "3 0 1 2 0.1\n4 2 1 0 3 -1\n";
        let text = format!(
            "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int vertex_indices\n\
             property double weight\nelement vertex 1\nproperty float x\nelement end 1\n\
             property char c\nend_header\n{faces}7\n-3\n"
        );
        std::fs::write(&input, text).unwrap();
        let kinds = [
            PlyType::I8,
            PlyType::U8,
            PlyType::I16,
            PlyType::U16,
            PlyType::I32,
            PlyType::U32,
            PlyType::F32,
            PlyType::F64,
        ];
        let columns = kinds
            .iter()
            .map(|kind| TypedColumn { name: format!("c_{}", kind.name()), kind: *kind })
            .collect();
        let mut writer = PlyWriter::create_typed(&output, columns, Some(&input)).unwrap();
        let values = [-5.0, 255.0, -300.0, 65_535.0, 16_777_217.0, 4e9, 0.5, 1e100];
        writer.write_double_rows(&values).unwrap();
        writer.write_double_rows(&[f64::NAN; 8]).unwrap();
        assert_eq!(writer.finish().unwrap(), 2);
        let bytes = std::fs::read(&output).unwrap();
        let mut reader = PlyReader::new(bytes.as_slice(), &output).unwrap();
        let header = reader.header().clone();
        let found: Vec<(&str, u64)> =
            header.elements.iter().map(|e| (e.name.as_str(), e.count)).collect();
        assert_eq!(found, [("vertex", 2), ("face", 2), ("end", 1)]);
        for (property, kind) in header.elements[0].properties.iter().zip(kinds) {
            assert_eq!(property.kind, PlyKind::Scalar(kind));
        }
        let mut row = PlyRow::default();
        assert!(reader.read_row(&mut row).unwrap());
        assert_eq!((0..8).map(|i| row.scalar(i)).collect::<Vec<_>>(), values);
        reader.next_element().unwrap();
        assert!(reader.read_row(&mut row).unwrap() && reader.read_row(&mut row).unwrap());
        assert_eq!((row.list(0), row.scalar(1)), ([2.0, 1.0, 0.0, 3.0].as_slice(), -1.0));
        reader.next_element().unwrap();
        assert!(reader.read_row(&mut row).unwrap());
        assert_eq!(row.scalar(0), -3.0);
    }

    #[test]
    fn unusable_column_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        for names in [vec!["x", "x"], vec![""], vec!["a b"], vec!["é"]] {
            assert!(PlyWriter::create(&path, &names).is_err());
        }
    }
}
