//! Receivers read from PLY: places to gather light at, with whatever else the file knows of them.

use crate::ply_columns::{Column, NORMAL_NAMES};
use crate::ply_points::open_ply;
use crate::{CloudError, PlyElement, PlyKind, PlyRow, PlyType};
use pbgi_math::{DVec3, Vec3};
use std::path::Path;

/// Receivers in file order, in memory.
#[derive(Clone, Debug, Default)]
pub struct ReceiverTable {
    /// World position of the coordinate origin; not 0 only where the file has `double` positions.
    pub origin: DVec3,
    /// Positions relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// The other scalar columns, as `f32`, each as long as `positions`.
    pub columns: Vec<ReceiverColumn>,
}

/// A named column of numbers.
#[derive(Clone, Debug)]
pub struct ReceiverColumn {
    /// Name as written.
    pub name: String,
    /// One value per receiver.
    pub values: Vec<f32>,
}

impl ReceiverTable {
    /// Reads the vertices of a PLY file; `x y z` and `nx ny nz` (or `normal_x` …) are required.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, lacks those columns, or has a position that is not finite or a
    /// normal without direction.
    pub fn read(path: &Path) -> Result<Self, CloudError> {
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
        let others = other_columns(&element, &[position, normal].concat());
        let mut table = Self {
            columns: others
                .iter()
                .map(|(_, name)| ReceiverColumn { name: name.clone(), values: Vec::new() })
                .collect(),
            ..Self::default()
        };
        let mut row = PlyRow::default();
        while reader.read_row(&mut row)? {
            let index = table.positions.len();
            let p = DVec3::from_array(position.map(|c| row.scalar(c.index)));
            let n = DVec3::from_array(normal.map(|c| row.scalar(c.index)));
            if !p.is_finite() {
                return Err(malformed(format!("vertex row {index}: position is not finite")));
            }
            let unit = (n / n.abs().max_element()).normalize();
            if !unit.is_finite() {
                return Err(malformed(format!("vertex row {index}: normal has no direction")));
            }
            if index == 0 && position.iter().any(|c| c.ty == PlyType::F64) {
                table.origin = p.round();
            }
            table.positions.push((p - table.origin).as_vec3());
            table.normals.push(unit.as_vec3());
            for (column, (source, _)) in table.columns.iter_mut().zip(&others) {
                column.values.push(row.scalar(*source) as f32);
            }
        }
        Ok(table)
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

/// Index and name of every scalar column but those of `used`.
fn other_columns(element: &PlyElement, used: &[Column]) -> Vec<(usize, String)> {
    element
        .properties
        .iter()
        .enumerate()
        .filter(|(index, p)| {
            matches!(p.kind, PlyKind::Scalar(_)) && used.iter().all(|c| c.index != *index)
        })
        .map(|(index, p)| (index, p.name.clone()))
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
