//! Receivers read from PLY: places to gather light at, with whatever else the file knows of them.

use crate::forward_file::ForwardFile;
use crate::ply_columns::{Column, NORMAL_NAMES};
use crate::ply_points::open_ply;
use crate::{
    CloudError, PlyElement, PlyKind, PlyProperty, PlyReader, PlyRow, PlyType, TypedColumn,
};
use pbgi_math::{DVec3, Vec3};
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Receivers in file order, all or a part of them.
#[derive(Clone, Debug, Default)]
pub struct ReceiverTable {
    /// World position of the coordinate origin; not 0 only where the file has `double` positions.
    pub origin: DVec3,
    /// Positions relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// Position in the world and normal of each as the file has them, with all their digits and of any length; empty where no file does.
    pub given: Vec<[f64; 6]>,
    /// The other scalar columns, each as long as `positions`.
    pub columns: Vec<ReceiverColumn>,
}

/// A named column of numbers.
#[derive(Clone, Debug, Default)]
pub struct ReceiverColumn {
    /// Name as written.
    pub name: String,
    /// Type of the values as written.
    pub kind: PlyType,
    /// One value per receiver, as `f32`.
    pub values: Vec<f32>,
    /// The same with all their digits, empty where `f32` holds these.
    pub exact: Vec<f64>,
}

impl ReceiverColumn {
    /// The value of a receiver, with all its digits.
    ///
    /// # Panics
    ///
    /// If there is no such row.
    #[must_use]
    pub fn value(&self, row: usize) -> f64 {
        self.exact.get(row).copied().unwrap_or_else(|| f64::from(self.values[row]))
    }
}

impl ReceiverTable {
    /// Reads the vertices of a PLY file; `x y z` and `nx ny nz` (or `normal_x` …) are required.
    ///
    /// # Errors
    ///
    /// As [`ReceiverReader`].
    pub fn read(path: &Path) -> Result<Self, CloudError> {
        let mut reader = ReceiverReader::open(path)?;
        let mut table = Self::default();
        reader.read_chunk(usize::MAX, &mut table)?;
        Ok(table)
    }

    /// Drops all rows and columns; their memory stays.
    fn reset(&mut self, origin: DVec3, columns: &[TypedColumn]) {
        self.origin = origin;
        self.positions.clear();
        self.normals.clear();
        self.given.clear();
        self.columns.truncate(columns.len());
        self.columns.resize_with(columns.len(), ReceiverColumn::default);
        for (column, TypedColumn { name, kind }) in self.columns.iter_mut().zip(columns) {
            column.name.clone_from(name);
            column.kind = *kind;
            column.values.clear();
            column.exact.clear();
        }
    }

    /// Number of receivers.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Values of the column `name`.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f32]> {
        self.columns.iter().find(|c| c.name == name).map(|c| c.values.as_slice())
    }
}

/// Reads receivers from a PLY file in parts of bounded size.
pub struct ReceiverReader {
    path: PathBuf,
    reader: PlyReader<BufReader<ForwardFile>>,
    position: [Column; 3],
    normal: [Column; 3],
    /// Places of the other columns in a row, and what they are.
    others: Vec<usize>,
    columns: Vec<TypedColumn>,
    /// Columns of lists.
    lists: Vec<String>,
    /// Elements of the file besides its vertices.
    elements: Vec<PlyElement>,
    origin: DVec3,
    count: u64,
    /// The row read last, yet to be handed out if there is one.
    row: PlyRow,
    has_row: bool,
    next: u64,
}

impl ReceiverReader {
    /// Opens a file whose vertices have `x y z` and `nx ny nz` (or `normal_x` …).
    ///
    /// # Errors
    ///
    /// If the file cannot be read or lacks those columns.
    pub fn open(path: &Path) -> Result<Self, CloudError> {
        let malformed = |message: String| CloudError::malformed(path, message);
        let mut reader = open_ply(path)?;
        if !reader.seek_element("vertex")? {
            return Err(malformed("no element `vertex`; receivers are vertices".into()));
        }
        let element = reader.element().expect("seek_element found it").clone();
        let position = Column::find_triple(&element, &[["x", "y", "z"]])
            .ok_or_else(|| malformed("vertices have no columns `x`, `y`, `z`".into()))?;
        let normal = Column::find_triple(&element, &NORMAL_NAMES).ok_or_else(|| {
            malformed("vertices have no columns `nx`, `ny`, `nz`; receivers need normals".into())
        })?;
        let (others, columns) =
            other_columns(&element, &[position, normal].concat()).into_iter().unzip();
        let is_list = |p: &&PlyProperty| matches!(p.kind, PlyKind::List { .. });
        let lists = element.properties.iter().filter(is_list).map(|p| p.name.clone()).collect();
        let mut row = PlyRow::default();
        let has_row = reader.read_row(&mut row)?;
        let mut origin = DVec3::ZERO;
        if has_row && position.iter().any(|c| c.ty == PlyType::F64) {
            let first = DVec3::from_array(position.map(|c| row.scalar(c.index)));
            origin = if first.is_finite() { first.round() } else { origin };
        }
        let (path, count) = (path.to_owned(), element.count);
        let mut elements = reader.header().elements.clone();
        elements.retain(|element| element.name != "vertex" && element.count > 0);
        Ok(Self {
            path,
            reader,
            position,
            normal,
            others,
            columns,
            lists,
            elements,
            origin,
            count,
            row,
            has_row,
            next: 0,
        })
    }

    /// Number of receivers the file claims to have.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// World position of the coordinate origin; not 0 only where the file has `double` positions.
    #[must_use]
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Types of the columns of positions and normals.
    #[must_use]
    pub fn given_kinds(&self) -> [PlyType; 6] {
        let ([x, y, z], [nx, ny, nz]) = (self.position, self.normal);
        [x, y, z, nx, ny, nz].map(|column| column.ty)
    }

    /// The columns besides positions and normals.
    #[must_use]
    pub fn columns(&self) -> &[TypedColumn] {
        &self.columns
    }

    /// Columns of lists, which no table has.
    #[must_use]
    pub fn list_columns(&self) -> &[String] {
        &self.lists
    }

    /// The elements of the file besides its vertices that have rows, such as faces.
    #[must_use]
    pub fn other_elements(&self) -> &[PlyElement] {
        &self.elements
    }

    /// Replaces `table` by the next rows, at most `rows_max` of them; `false` when there are no more.
    ///
    /// # Errors
    ///
    /// If the file cannot be read on, or has a position that is not finite or a normal without direction.
    pub fn read_chunk(
        &mut self,
        rows_max: usize,
        table: &mut ReceiverTable,
    ) -> Result<bool, CloudError> {
        table.reset(self.origin, &self.columns);
        while self.has_row && table.len() < rows_max {
            self.append_row(table)?;
            self.has_row = self.reader.read_row(&mut self.row)?;
            self.next += 1;
        }
        Ok(self.has_row)
    }

    fn append_row(&self, table: &mut ReceiverTable) -> Result<(), CloudError> {
        let scalars = |columns: &[Column; 3]| {
            DVec3::from_array(columns.map(|column| self.row.scalar(column.index)))
        };
        let malformed = |what: &str| {
            CloudError::malformed(&self.path, format!("vertex row {}: {what}", self.next))
        };
        let (p, n) = (scalars(&self.position), scalars(&self.normal));
        if !p.is_finite() {
            return Err(malformed("position is not finite"));
        }
        let unit = (n / n.abs().max_element()).normalize();
        if !unit.is_finite() {
            return Err(malformed("normal has no direction"));
        }
        table.positions.push((p - self.origin).as_vec3());
        table.normals.push(unit.as_vec3());
        table.given.push([p.x, p.y, p.z, n.x, n.y, n.z]);
        for (column, source) in table.columns.iter_mut().zip(&self.others) {
            let value = self.row.scalar(*source);
            column.values.push(value as f32);
            if !column.kind.fits_f32() {
                column.exact.push(value);
            }
        }
        Ok(())
    }
}

/// Index of every scalar column but those of `used`, and what it is.
fn other_columns(element: &PlyElement, used: &[Column]) -> Vec<(usize, TypedColumn)> {
    element
        .properties
        .iter()
        .enumerate()
        .filter(|(index, _)| used.iter().all(|c| c.index != *index))
        .filter_map(|(index, p)| match p.kind {
            PlyKind::Scalar(kind) => Some((index, TypedColumn { name: p.name.clone(), kind })),
            PlyKind::List { .. } => None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PlyWriter;

    fn table_of(names: &[&str], rows: &[f32]) -> Result<ReceiverTable, CloudError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        let mut writer = PlyWriter::create(&path, names).unwrap();
        writer.write_rows(rows).unwrap();
        writer.finish().unwrap();
        ReceiverTable::read(&path)
    }

    #[test]
    fn other_columns_pass_through() {
        let names = ["ref_r", "x", "y", "z", "nz", "nx", "ny", "ref_g"];
        let table =
            table_of(&names, &[9., 1., 2., 3., 0., 2., 0., 8., 7., 4., 5., 6., -3., 0., 0., 6.])
                .unwrap();
        assert_eq!(table.len(), 2);
        assert_eq!(table.positions[1], Vec3::new(4.0, 5.0, 6.0));
        assert_eq!(table.normals, [Vec3::X, Vec3::NEG_Z]);
        assert_eq!(table.column("ref_r"), Some([9.0, 7.0].as_slice()));
        assert_eq!(table.column("ref_g"), Some([8.0, 6.0].as_slice()));
        assert_eq!(table.column("x"), None);
    }

    #[test]
    fn other_columns_keep_their_types_and_digits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
            property float z\nproperty float nx\nproperty float ny\nproperty float nz\n\
            property int id\nproperty double time\nproperty uchar red\nproperty list uchar int near\n\
            element face 1\nproperty list uchar int vertex_indices\nelement edge 0\nproperty int a\n\
            end_header\n1 2 3 0 0 1 16777217 0.1 200 1 0\n3 0 0 0\n";
        std::fs::write(&path, text).unwrap();
        let table = ReceiverTable::read(&path).unwrap();
        let values: Vec<f64> = table.columns.iter().map(|column| column.value(0)).collect();
        assert_eq!(values, [16_777_217.0, 0.1, 200.0]);
        assert_eq!(table.column("red"), Some([200.0].as_slice()));
        let reader = ReceiverReader::open(&path).unwrap();
        let kinds: Vec<PlyType> = reader.columns().iter().map(|column| column.kind).collect();
        assert_eq!(kinds, [PlyType::I32, PlyType::F64, PlyType::U8]);
        let elements = reader.other_elements();
        assert_eq!((elements.len(), elements[0].name.as_str()), (1, "face"));
        assert_eq!(reader.list_columns(), ["near"]);
    }

    #[test]
    fn positions_and_normals_are_kept_as_given() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\n\
            property double z\nproperty float nx\nproperty float ny\nproperty double nz\nend_header\n\
            500000.123456789 0.1 -3 0 0.5 0.3\n";
        std::fs::write(&path, text).unwrap();
        let table = ReceiverTable::read(&path).unwrap();
        assert_eq!(table.given, [[500_000.123_456_789, 0.1, -3.0, 0.0, 0.5, 0.3]]);
        let kinds = ReceiverReader::open(&path).unwrap().given_kinds();
        let [single, double] = [PlyType::F32, PlyType::F64];
        assert_eq!(kinds, [double, double, double, single, single, double]);
    }

    #[test]
    fn parts_are_those_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.ply");
        let names = ["x", "y", "z", "nx", "ny", "nz", "a"];
        let mut writer = PlyWriter::create_with_doubles(&path, &names, 3).unwrap();
        for i in 0..23 {
            let x = 5e5 + f64::from(i);
            writer.write_double_rows(&[x, 1.0, 0.0, 0.0, 0.0, 1.0, f64::from(i)]).unwrap();
        }
        writer.finish().unwrap();
        let whole = ReceiverTable::read(&path).unwrap();
        assert_eq!((whole.len(), whole.origin.x), (23, 5e5));
        let mut reader = ReceiverReader::open(&path).unwrap();
        assert_eq!((reader.count(), reader.origin()), (23, whole.origin));
        assert_eq!(reader.columns(), [TypedColumn { name: "a".into(), kind: PlyType::F32 }]);
        let (mut part, mut positions, mut values) = (ReceiverTable::default(), vec![], vec![]);
        let mut sizes = Vec::new();
        loop {
            let more = reader.read_chunk(10, &mut part).unwrap();
            sizes.push(part.len());
            positions.extend_from_slice(&part.positions);
            values.extend_from_slice(part.column("a").unwrap());
            if !more {
                break;
            }
        }
        assert_eq!(sizes, [10, 10, 3]);
        assert_eq!(
            (positions, values.as_slice()),
            (whole.positions.clone(), whole.column("a").unwrap())
        );
    }

    #[test]
    fn receivers_need_positions_and_normals() {
        for (names, row, expected) in [
            (["x", "y", "z", "a", "b", "c"], [0.0; 6], "need normals"),
            (["x", "y", "w", "nx", "ny", "nz"], [0.0; 6], "`x`, `y`, `z`"),
            (["x", "y", "z", "nx", "ny", "nz"], [0.0; 6], "row 0: normal"),
            (["x", "y", "z", "nx", "ny", "nz"], [f32::NAN; 6], "row 0: position"),
        ] {
            let message = table_of(&names, &row).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
