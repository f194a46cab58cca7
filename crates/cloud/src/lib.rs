//! The surfel, and reading and writing of point clouds as streams of surfels.
//!
//! Readers yield bounded chunks; none holds a whole cloud. This crate must never know how surfels are sorted, stored or lit.
#![forbid(unsafe_code)]

mod concat;
mod forward_file;
mod las;
mod las_decoder;
mod las_results;
mod lazy;
mod number;
mod open;
mod output;
mod ply;
mod ply_columns;
mod ply_points;
mod ply_writer;
mod ptc;
mod ptc_writer;
pub mod raw;
mod receiver_table;
mod record;
mod record_batch;
mod robust;
mod row_writer;
mod source;
mod surfel;

pub use concat::ConcatSource;
pub use las::{LAS_MAGIC, LasPoints};
pub use las_results::{LasPlaces, LasResultWriter, LasSurvey};
pub use lazy::LazyCloud;
pub use number::parse_number;
pub use open::open_cloud;
pub use ply::{PlyElement, PlyFormat, PlyHeader, PlyKind, PlyProperty, PlyReader, PlyRow, PlyType};
pub use ply_points::PlyPoints;
pub use ply_writer::PlyWriter;
pub use ptc::PtcPoints;
pub use ptc_writer::{PtcPoint, PtcWriter};
pub use raw::{RawKind, RawSource, RawWriter, write_raw_file};
pub use receiver_table::{ReceiverColumn, ReceiverReader, ReceiverTable};
pub use record::{ClassFilter, CloudOptions, InvalidPolicy};
pub use row_writer::{RowWriter, TypedColumn};
pub use source::{CloudError, LeftOut, SliceSource, SurfelSource};
pub use surfel::{Surfel, SurfelFlags};
