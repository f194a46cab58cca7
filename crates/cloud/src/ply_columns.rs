//! Which columns of PLY rows are read, and how they get into a batch of records.

use crate::record::{srgb_to_linear, srgb8_table};
use crate::record_batch::{RecordBatch, field};
use crate::{PlyElement, PlyKind, PlyRow, PlyType};
use pbgi_math::DVec3;

/// A scalar column: where it lies in a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    pub index: usize,
    /// Bytes before it in a binary row; meaningful for rows of fixed stride only.
    pub offset: usize,
    pub ty: PlyType,
}

impl Column {
    /// The scalar column `name`.
    pub fn find(element: &PlyElement, name: &str) -> Option<Self> {
        let index = element.property(name)?;
        let size = |kind: PlyKind| match kind {
            PlyKind::Scalar(ty) => ty.size_bytes(),
            PlyKind::List { .. } => 0,
        };
        match element.properties[index].kind {
            PlyKind::Scalar(ty) => {
                let before = &element.properties[..index];
                Some(Self { index, offset: before.iter().map(|p| size(p.kind)).sum(), ty })
            }
            PlyKind::List { .. } => None,
        }
    }

    /// Three scalar columns: the first of `names` that is complete.
    pub fn find_triple(element: &PlyElement, names: &[[&str; 3]]) -> Option<[Self; 3]> {
        names.iter().find_map(|triple| {
            let [a, b, c] = triple.map(|name| Self::find(element, name));
            Some([a?, b?, c?])
        })
    }
}

/// Names of normals.
pub(crate) const NORMAL_NAMES: [[&str; 3]; 2] =
    [["nx", "ny", "nz"], ["normal_x", "normal_y", "normal_z"]];

/// Names of albedos.
const COLOR_NAMES: [[&str; 3]; 4] = [
    ["albedo_r", "albedo_g", "albedo_b"],
    ["red", "green", "blue"],
    ["diffuse_red", "diffuse_green", "diffuse_blue"],
    ["r", "g", "b"],
];

/// Names of columns that would change light and are not read, in lower case and without the `scalar_` of CloudCompare; what of the others
/// makes up for them; and what is used instead.
const UNREAD: [(&[&str], &[&str], &str); 4] = [
    (
        &["intensity", "reflectance", "gray", "grey", "luminance"],
        &["red", "diffuse_red", "r", "albedo_r", "f_dc_0"],
        "albedo is gray; name them red, green and blue to have them as albedo",
    ),
    (
        &["rgb", "rgba"],
        &["red", "diffuse_red", "r", "albedo_r"],
        "colors packed into one number are gray; write them as red, green and blue",
    ),
    (
        &[
            "emission",
            "emissive",
            "emission_r",
            "emissive_r",
            "emission_red",
            "emissive_red",
            "radiosity_r",
        ],
        &["radiance_r"],
        "nothing shines; what surfels send out is called radiance_r, radiance_g, radiance_b",
    ),
    (
        &["pscale", "psize", "point_size", "pointsize", "size", "width", "scale"],
        &["radius", "area"],
        "sizes are estimated; half the width of a point is called radius",
    ),
];

impl PlyElement {
    /// Columns of normals.
    #[must_use]
    pub fn normals(&self) -> Option<[usize; 3]> {
        Column::find_triple(self, &NORMAL_NAMES).map(|columns| columns.map(|c| c.index))
    }

    /// Columns of colors.
    #[must_use]
    pub fn colors(&self) -> Option<[usize; 3]> {
        Column::find_triple(self, &COLOR_NAMES).map(|columns| columns.map(|c| c.index))
    }

    /// The column of alpha, and its value where something is opaque.
    #[must_use]
    pub fn alpha(&self) -> Option<(usize, f64)> {
        let column = Column::find(self, "alpha")?;
        let opaque = match column.ty {
            PlyType::F32 | PlyType::F64 => 1.0,
            PlyType::U16 => 65_535.0,
            _ => 255.0,
        };
        Some((column.index, opaque))
    }

    /// What columns would change light or sizes and are not read, one sentence each; `has_sizes` where points have none.
    #[must_use]
    pub fn describe_unread(&self, has_sizes: bool) -> Vec<String> {
        let plain = |name: &str| {
            let name = name.to_ascii_lowercase();
            name.strip_prefix("scalar_").map(str::to_owned).unwrap_or(name)
        };
        let kinds = &UNREAD[..UNREAD.len() - usize::from(has_sizes)];
        let of_kind = |(names, others, effect): &(&[&str], &[&str], &str)| {
            let found = self.properties.iter().map(|property| property.name.as_str());
            let found: Vec<&str> =
                found.filter(|name| names.contains(&plain(name).as_str())).collect();
            let is_made_up = others.iter().any(|other| self.property(other).is_some());
            (!found.is_empty() && !is_made_up).then(|| {
                format!(
                    "columns of element {} that are not read: {}; {effect}",
                    self.name,
                    found.join(", ")
                )
            })
        };
        kinds.iter().filter_map(of_kind).collect()
    }
}

/// What becomes of a value.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reading {
    /// Itself.
    Plain,
    /// Its distance from this number.
    From(f64),
    /// Linear value of an 8-bit sRGB code.
    Srgb8,
    /// Linear value of a 16-bit sRGB code.
    Srgb16,
    /// Linear value of an sRGB code given by its coefficient of the constant spherical harmonic, around one half.
    Harmonic,
}

impl Reading {
    /// Floats are linear, integers sRGB-encoded over their range.
    fn of_color(ty: PlyType) -> Self {
        match ty {
            PlyType::F32 | PlyType::F64 => Self::Plain,
            PlyType::U16 => Self::Srgb16,
            // Signed and wide integers hold 8-bit codes in the files that use them.
            _ => Self::Srgb8,
        }
    }
}

/// The columns a surfel is read from: which field of a record each gives, and how.
pub(crate) struct PlyColumns {
    /// Those of the position come first.
    columns: Vec<(usize, Column, Reading)>,
    /// Whether the names of colors are those of display colors.
    are_codes: bool,
    srgb8: Box<[f32; 256]>,
}

impl PlyColumns {
    /// The columns of a table of vertices that mean something.
    ///
    /// # Errors
    ///
    /// If there are no positions.
    pub fn of(element: &PlyElement) -> Result<Self, String> {
        let position =
            Column::find_triple(element, &[["x", "y", "z"]]).ok_or_else(|| {
                match element.property("packed_position") {
                    Some(_) => "compressed Gaussian splats are not read; write them uncompressed",
                    None => "vertices have no columns `x`, `y`, `z`",
                }
            })?;
        let mut columns = Vec::new();
        let mut add =
            |field: usize, found: Option<[Column; 3]>, reading: fn(PlyType) -> Reading| {
                let found = found.into_iter().flatten().enumerate();
                columns.extend(found.map(|(k, column)| (field + k, column, reading(column.ty))));
            };
        let plain = |_| Reading::Plain;
        let triple = |names: &[[&str; 3]]| Column::find_triple(element, names);
        add(field::POSITION, Some(position), plain);
        add(field::NORMAL, triple(&NORMAL_NAMES), plain);
        add(field::RADIANCE, triple(&[["radiance_r", "radiance_g", "radiance_b"]]), plain);
        add(field::ALBEDO, triple(&COLOR_NAMES), Reading::of_color);
        for (field, name) in [(field::RADIUS, "radius"), (field::AREA, "area")] {
            columns.extend(Column::find(element, name).map(|c| (field, c, Reading::Plain)));
        }
        if triple(&COLOR_NAMES).is_none() {
            let splats = triple(&[["f_dc_0", "f_dc_1", "f_dc_2"]]).into_iter().flatten();
            let reading = Reading::Harmonic;
            columns.extend(splats.enumerate().map(|(k, c)| (field::ALBEDO + k, c, reading)));
        }
        let are_codes = triple(&COLOR_NAMES[..1]).is_none();
        Ok(Self { columns, are_codes, srgb8: Box::new(srgb8_table()) })
    }

    /// Whether colors are floats that may be codes all the same.
    pub fn has_float_colors(&self) -> bool {
        let is_float = |(field, _, reading): &(usize, Column, Reading)| {
            (field::ALBEDO..field::ALBEDO + 3).contains(field) && *reading == Reading::Plain
        };
        self.are_codes && self.columns.iter().any(is_float)
    }

    /// The color values of a row, as written.
    pub fn colors<'a>(&'a self, row: &'a PlyRow) -> impl Iterator<Item = f64> + 'a {
        let colors = self
            .columns
            .iter()
            .filter(|(field, _, _)| (field::ALBEDO..field::ALBEDO + 3).contains(field));
        colors.map(|(_, column, _)| row.scalar(column.index))
    }

    /// Takes colors for sRGB codes up to 255 from now on.
    pub fn take_colors_as_codes(&mut self) {
        for (field, _, reading) in &mut self.columns {
            if (field::ALBEDO..field::ALBEDO + 3).contains(field) {
                *reading = Reading::Srgb8;
            }
        }
    }

    /// Whether positions have more digits than `f32`.
    pub fn has_double_positions(&self) -> bool {
        self.columns[..3].iter().any(|(_, column, _)| column.ty == PlyType::F64)
    }

    /// Position of a row.
    pub fn position(&self, row: &PlyRow) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|k| row.scalar(self.columns[k].1.index)))
    }

    /// Reads positions relative to `origin` from now on.
    pub fn set_origin(&mut self, origin: DVec3) {
        for ((_, _, reading), shift) in self.columns.iter_mut().zip(origin.to_array()) {
            *reading = if shift == 0.0 { Reading::Plain } else { Reading::From(shift) };
        }
    }

    /// Puts a row into the place `index` of a batch.
    pub fn read_row(&self, row: &PlyRow, index: usize, batch: &mut RecordBatch) {
        for (field, column, reading) in &self.columns {
            let value = row.scalar(column.index);
            batch.column_mut(*field)[index] = match *reading {
                Reading::Plain => value as f32,
                Reading::From(shift) => (value - shift) as f32,
                Reading::Srgb8 => self.linear8(value),
                Reading::Srgb16 => linear16(value),
                Reading::Harmonic => linear_harmonic(value),
            };
        }
    }

    /// Fills a batch with as many whole binary rows as it has records: column by column, so that type, place and meaning
    /// of a column are looked up once.
    pub fn read_binary(&self, rows: &BinaryRows<'_>, batch: &mut RecordBatch) {
        self.read_columns(&self.columns, rows, batch);
    }

    /// Fills the positions of a batch only, else as [`Self::read_binary`].
    pub fn read_positions(&self, rows: &BinaryRows<'_>, batch: &mut RecordBatch) {
        self.read_columns(&self.columns[..3], rows, batch);
    }

    fn read_columns(
        &self,
        columns: &[(usize, Column, Reading)],
        rows: &BinaryRows<'_>,
        batch: &mut RecordBatch,
    ) {
        for (field, column, reading) in columns {
            let target = batch.column_mut(*field);
            match *reading {
                Reading::Plain => rows.read(*column, target, |value| value as f32),
                Reading::From(shift) => {
                    rows.read(*column, target, |value| (value - shift) as f32);
                }
                Reading::Srgb8 => rows.read(*column, target, |value| self.linear8(value)),
                Reading::Srgb16 => rows.read(*column, target, linear16),
                Reading::Harmonic => rows.read(*column, target, linear_harmonic),
            }
        }
    }

    #[inline]
    fn linear8(&self, code: f64) -> f32 {
        self.srgb8[code.clamp(0.0, 255.0) as usize]
    }
}

fn linear16(code: f64) -> f32 {
    srgb_to_linear(code as f32 / 65535.0)
}

fn linear_harmonic(coefficient: f64) -> f32 {
    let constant = 0.5 / std::f64::consts::PI.sqrt();
    srgb_to_linear((0.5 + constant * coefficient).clamp(0.0, 1.0) as f32)
}

/// Whole binary rows of a fixed stride.
pub(crate) struct BinaryRows<'a> {
    pub bytes: &'a [u8],
    pub stride: usize,
    pub big_endian: bool,
}

impl BinaryRows<'_> {
    /// Fills `target` with a column's values, in the order of the rows.
    fn read(&self, column: Column, target: &mut [f32], to: impl Fn(f64) -> f32 + Copy) {
        let at = column.offset;
        match column.ty {
            PlyType::I8 => self.fill(at, target, |b| to(i8::from_le_bytes(b).into())),
            PlyType::U8 => self.fill(at, target, |b| to(u8::from_le_bytes(b).into())),
            PlyType::I16 => self.fill(at, target, |b| to(i16::from_le_bytes(b).into())),
            PlyType::U16 => self.fill(at, target, |b| to(u16::from_le_bytes(b).into())),
            PlyType::I32 => self.fill(at, target, |b| to(i32::from_le_bytes(b).into())),
            PlyType::U32 => self.fill(at, target, |b| to(u32::from_le_bytes(b).into())),
            PlyType::F32 => self.fill(at, target, |b| to(f32::from_le_bytes(b).into())),
            PlyType::F64 => self.fill(at, target, |b| to(f64::from_le_bytes(b))),
        }
    }

    /// Fills `target` from the `N` bytes at `offset` of each row, lowest byte first.
    pub fn fill<const N: usize>(
        &self,
        offset: usize,
        target: &mut [f32],
        value: impl Fn([u8; N]) -> f32,
    ) {
        let rows = self.bytes.get(offset..).unwrap_or_default().chunks(self.stride);
        let values = rows.filter_map(|row| row.first_chunk::<N>());
        if self.big_endian {
            target.iter_mut().zip(values).for_each(|(target, bytes)| {
                let mut bytes = *bytes;
                bytes.reverse();
                *target = value(bytes);
            });
        } else {
            target.iter_mut().zip(values).for_each(|(target, bytes)| *target = value(*bytes));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CloudOptions, PlyReader};
    use std::path::Path;

    /// The page of formats names every column that is read.
    #[test]
    fn columns_are_documented() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/formats.md");
        let page = std::fs::read_to_string(page).unwrap();
        for names in COLOR_NAMES.iter().chain(&NORMAL_NAMES) {
            assert!(page.contains(&names.join(" ")), "{names:?}");
        }
        for name in ["`x y z`", "`radius`", "`area`", "`radiance_r ", "`f_dc_0 "] {
            assert!(page.contains(name), "{name}");
        }
    }

    /// Every type in both byte orders gives what its rows give one by one.
    #[test]
    fn columns_and_rows_agree_for_every_type() {
        let names = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double"];
        for (format, big_endian) in [("little", false), ("big", true)] {
            for (k, ty) in names.iter().enumerate() {
                let other = names[(k + 3) % names.len()];
                let header = format!(
                    "ply\nformat binary_{format}_endian 1.0\nelement vertex 20\nproperty {other} w\n\
                     property {ty} x\nproperty {ty} y\nproperty {ty} z\nproperty {ty} red\n\
                     property {ty} green\nproperty {ty} blue\nproperty {ty} radius\nend_header\n"
                );
                let stride = 7 * PlyType::from_name(ty).unwrap().size_bytes()
                    + PlyType::from_name(other).unwrap().size_bytes();
                let rows: Vec<u8> = (0..20 * stride).map(|i| (i * 37 % 101) as u8).collect();
                let file = [header.as_bytes(), &rows].concat();
                let mut reader = PlyReader::new(file.as_slice(), Path::new("t.ply")).unwrap();
                let mut columns = PlyColumns::of(reader.element().unwrap()).unwrap();
                columns.set_origin(DVec3::new(0.0, 3.0, -5.0));
                let batch = || {
                    let mut batch = RecordBatch::new(&CloudOptions::default());
                    batch.set_len(20);
                    batch
                };
                let (mut by_row, mut by_column) = (batch(), batch());
                let mut row = PlyRow::default();
                for index in 0..20 {
                    assert!(reader.read_row(&mut row).unwrap());
                    columns.read_row(&row, index, &mut by_row);
                }
                let bytes = rows.as_slice();
                columns.read_binary(&BinaryRows { bytes, stride, big_endian }, &mut by_column);
                for field in 0..field::COUNT {
                    assert_eq!(
                        by_row.column_mut(field),
                        by_column.column_mut(field),
                        "{ty} {field}"
                    );
                }
            }
        }
    }
}
