//! Writing tables of named columns as PLY.

use crate::CloudError;
use crate::output::{commit_output, create_output};
use crate::row_writer::check_names;
use pbgi_file::AtomicFile;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

/// Writes a PLY file of one element `vertex` with `float` (and `double`) columns, binary little-endian, row by
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
    columns: Vec<String>,
    /// Columns of type `double`, before those of type `float`.
    double_count: usize,
    value_count: u64,
}

impl PlyWriter {
    /// Starts the file `path` with the given columns.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written, or a column name is empty, has blanks, or comes twice.
    pub fn create(path: &Path, columns: &[impl AsRef<str>]) -> Result<Self, CloudError> {
        Self::create_with_doubles(path, columns, 0)
    }

    /// Starts the file `path` with the given columns, the first `double_count` of which are of type
    /// `double`: for coordinates far from the origin.
    ///
    /// # Errors
    ///
    /// If the folder cannot be written, or a column name is empty, has blanks, or comes twice.
    pub fn create_with_doubles(
        path: &Path,
        columns: &[impl AsRef<str>],
        double_count: usize,
    ) -> Result<Self, CloudError> {
        let columns: Vec<String> = columns.iter().map(|c| c.as_ref().to_owned()).collect();
        check_names(path, &columns)?;
        let mut writer = Self { file: create_output(path)?, columns, double_count, value_count: 0 };
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
    /// If `values` is not whole rows, or there are `double` columns.
    pub fn write_rows(&mut self, values: &[f32]) -> Result<(), CloudError> {
        assert!(values.len().is_multiple_of(self.columns.len()), "values must be whole rows");
        assert!(self.double_count == 0, "double columns need double values");
        for value in values {
            self.write(&value.to_le_bytes())?;
        }
        self.value_count += values.len() as u64;
        Ok(())
    }

    /// Appends rows as [`PlyWriter::write_rows`], `float` columns rounded.
    ///
    /// # Errors
    ///
    /// If writing fails.
    ///
    /// # Panics
    ///
    /// If `values` is not whole rows.
    pub fn write_double_rows(&mut self, values: &[f64]) -> Result<(), CloudError> {
        assert!(values.len().is_multiple_of(self.columns.len()), "values must be whole rows");
        for row in values.chunks_exact(self.columns.len().max(1)) {
            let (doubles, floats) = row.split_at(self.double_count.min(row.len()));
            for value in doubles {
                self.write(&value.to_le_bytes())?;
            }
            for value in floats {
                self.write(&(*value as f32).to_le_bytes())?;
            }
        }
        self.value_count += values.len() as u64;
        Ok(())
    }

    /// Completes the file; it appears under its name. Returns the number of rows.
    ///
    /// # Errors
    ///
    /// If writing fails; the file's name is then as it was.
    pub fn finish(mut self) -> Result<u64, CloudError> {
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
        for (index, name) in self.columns.iter().enumerate() {
            let kind = if index < self.double_count { "double" } else { "float" };
            header.push_str(&format!("property {kind} {name}\n"));
        }
        header.push_str("end_header\n");
        self.write(header.as_bytes())
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), CloudError> {
        self.file.write_all(bytes).map_err(|e| CloudError::io(self.file.path(), "write", e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PlyReader, PlyRow};

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
    fn unusable_column_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        for names in [vec!["x", "x"], vec![""], vec!["a b"], vec!["é"]] {
            assert!(PlyWriter::create(&path, &names).is_err());
        }
    }
}
