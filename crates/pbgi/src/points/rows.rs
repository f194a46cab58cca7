//! Receivers from a file, in parts of bounded size.

use crate::PbgiError;
use crate::points::scan::ScanReader;
use pbgi_cloud::{PlyElement, PlyType, ReceiverReader, ReceiverTable, TypedColumn};
use pbgi_math::DVec3;
use std::path::{Path, PathBuf};

/// A file of receivers.
pub(crate) enum PointRows {
    /// Vertices of a PLY file.
    Table(PathBuf, ReceiverReader),
    /// Points of a scan.
    Scan(ScanReader),
}

impl PointRows {
    /// The vertices of a PLY file.
    pub fn open_table(path: &Path) -> Result<Self, PbgiError> {
        Ok(Self::Table(path.to_owned(), ReceiverReader::open(path)?))
    }

    /// Number of receivers the file claims to have.
    pub fn count(&self) -> u64 {
        match self {
            Self::Table(_, reader) => reader.count(),
            Self::Scan(reader) => reader.count(),
        }
    }

    /// World position of the coordinate origin.
    pub fn origin(&self) -> DVec3 {
        match self {
            Self::Table(_, reader) => reader.origin(),
            Self::Scan(reader) => reader.origin(),
        }
    }

    /// Types of positions and normals: those of the file; of scans, whose normals are estimated, double and single.
    pub fn given_kinds(&self) -> [PlyType; 6] {
        match self {
            Self::Table(_, reader) => reader.given_kinds(),
            Self::Scan(_) => {
                std::array::from_fn(|k| if k < 3 { PlyType::F64 } else { PlyType::F32 })
            }
        }
    }

    /// The columns besides positions and normals.
    pub fn columns(&self) -> &[TypedColumn] {
        match self {
            Self::Table(_, reader) => reader.columns(),
            Self::Scan(_) => &[],
        }
    }

    /// Columns of lists, which no table has.
    pub fn list_columns(&self) -> &[String] {
        match self {
            Self::Table(_, reader) => reader.list_columns(),
            Self::Scan(_) => &[],
        }
    }

    /// The elements of the file besides its vertices, such as faces.
    pub fn other_elements(&self) -> &[PlyElement] {
        match self {
            Self::Table(_, reader) => reader.other_elements(),
            Self::Scan(_) => &[],
        }
    }

    /// Replaces `table` by the next rows, at most `rows_max`; `false` when there are no more.
    pub fn read_chunk(
        &mut self,
        rows_max: usize,
        table: &mut ReceiverTable,
    ) -> Result<bool, PbgiError> {
        match self {
            Self::Table(_, reader) => Ok(reader.read_chunk(rows_max, table)?),
            Self::Scan(reader) => reader.read_chunk(rows_max, table),
        }
    }

    /// Starts over.
    pub fn rewind(&mut self) -> Result<(), PbgiError> {
        match self {
            Self::Table(path, reader) => *reader = ReceiverReader::open(path)?,
            Self::Scan(reader) => reader.rewind()?,
        }
        Ok(())
    }
}
