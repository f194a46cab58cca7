//! Rows of a table as receivers, with what they reflect.

use crate::PbgiError;
use crate::shade::{GlossSettings, gloss_toward};
use pbgi_cloud::ReceiverTable;
use pbgi_gather::{Material, Receiver};
use pbgi_math::{DVec3, Vec3};

/// Names of columns that hold a number of a material; the first that is there counts.
const MATERIAL_COLUMNS: [&[&str]; 6] = [
    &["roughness"],
    &["metalness", "metallic"],
    &["specular"],
    &["base_color_r", "albedo_r"],
    &["base_color_g", "albedo_g"],
    &["base_color_b", "albedo_b"],
];

/// Columns of the unit direction to the eye.
const VIEW_COLUMNS: [&str; 3] = ["view_x", "view_y", "view_z"];

/// What all rows of a file of receivers have in common.
#[derive(Clone, Copy)]
pub(crate) struct RowRules {
    /// The octree's origin.
    pub origin: DVec3,
    /// Where the eye is, in the world.
    pub eye: Option<DVec3>,
    /// Glossy reflections, if any.
    pub gloss: Option<GlossSettings>,
}

/// The rows of a table.
pub(crate) struct TableReceivers<'a> {
    table: &'a ReceiverTable,
    gloss: Option<GlossSettings>,
    /// From the table's origin to the octree's.
    shift: DVec3,
    materials: [Option<&'a [f32]>; 6],
    views: Option<[&'a [f32]; 3]>,
    /// Relative to the octree's origin.
    eye: Option<Vec3>,
}

impl<'a> TableReceivers<'a> {
    /// The rows of a table, whose first is the `first`th of its file. The eye is that of `rules`, or else where the columns `view_x view_y
    /// view_z` lead.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`] where there is gloss and neither tells where the eye is, or a number of a material is not in 0..=1.
    pub fn new(table: &'a ReceiverTable, first: u64, rules: &RowRules) -> Result<Self, PbgiError> {
        let [x, y, z] = VIEW_COLUMNS.map(|name| table.column(name));
        let views = match (x, y, z) {
            (Some(x), Some(y), Some(z)) => Some([x, y, z]),
            _ => None,
        };
        let materials =
            MATERIAL_COLUMNS.map(|names| names.iter().find_map(|name| table.column(name)));
        let RowRules { origin, eye, gloss } = *rules;
        let eye = eye.map(|eye| (eye - origin).as_vec3());
        let rows = Self { table, gloss, shift: table.origin - origin, materials, views, eye };
        if gloss.is_some() {
            rows.check(first)?;
        }
        Ok(rows)
    }

    fn check(&self, first: u64) -> Result<(), PbgiError> {
        if self.views.is_none() && self.eye.is_none() {
            return Err(no_eye());
        }
        let Some(row) = (0..self.table.len()).find(|row| !self.material(*row).is_valid()) else {
            return Ok(());
        };
        let Material { roughness, metalness, specular, base_color: [r, g, b] } = self.material(row);
        Err(PbgiError::usage(format!(
            "row {} of the receivers has roughness {roughness}, metalness {metalness}, specular {specular} and base color \
             ({r}, {g}, {b}); expected numbers from 0 to 1",
            first + row as u64
        )))
    }

    fn material(&self, row: usize) -> Material {
        let own = Material::default();
        let at = |index: usize, otherwise: f32| {
            self.materials[index].map_or(otherwise, |column| column[row])
        };
        Material {
            roughness: at(0, own.roughness),
            metalness: at(1, own.metalness),
            specular: at(2, own.specular),
            base_color: std::array::from_fn(|c| at(3 + c, own.base_color[c])),
        }
    }

    /// The receiver of a row.
    pub fn receiver(&self, row: usize) -> Receiver {
        let position = (self.table.positions[row].as_dvec3() + self.shift).as_vec3();
        let eye = match (self.eye, self.views) {
            (Some(eye), _) => eye,
            (None, Some(views)) => position + Vec3::from_array(views.map(|view| view[row])),
            (None, None) => position,
        };
        let gloss = gloss_toward(self.gloss, self.material(row), position, eye);
        Receiver { gloss, ..Receiver::diffuse(position, self.table.normals[row]) }
    }
}

/// What to say where nothing tells where the eye is.
pub(crate) fn no_eye() -> PbgiError {
    PbgiError::usage(
        "glossy reflections depend on where they are seen from; add --eye X,Y,Z or columns view_x view_y view_z",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::ReceiverColumn;

    fn table(columns: &[(&str, f32)]) -> ReceiverTable {
        let column = |(name, value): &(&str, f32)| ReceiverColumn {
            name: (*name).to_owned(),
            values: vec![*value],
            ..ReceiverColumn::default()
        };
        ReceiverTable {
            origin: DVec3::ZERO,
            positions: vec![Vec3::ONE],
            normals: vec![Vec3::Y],
            given: Vec::new(),
            columns: columns.iter().map(column).collect(),
        }
    }

    fn rules(eye: Option<DVec3>) -> RowRules {
        RowRules { origin: DVec3::ZERO, eye, gloss: Some(GlossSettings::default()) }
    }

    #[test]
    fn materials_come_from_columns() {
        let table = table(&[("metallic", 0.25), ("roughness", 0.5), ("albedo_g", 0.125)]);
        let rows = TableReceivers::new(&table, 0, &rules(Some(DVec3::Y))).unwrap();
        let own = Material::default();
        let expected = Material {
            roughness: 0.5,
            metalness: 0.25,
            base_color: [own.base_color[0], 0.125, own.base_color[2]],
            ..own
        };
        assert_eq!(rows.material(0), expected);
    }

    #[test]
    fn gloss_needs_an_eye_and_numbers_in_their_range() {
        let error = |columns: &[(&str, f32)], eye: Option<DVec3>| {
            let table = table(columns);
            TableReceivers::new(&table, 40, &rules(eye)).err().map(|e| e.to_string())
        };
        assert!(error(&[], None).unwrap().contains("--eye"));
        assert_eq!(error(&[("view_x", 0.0), ("view_y", 1.0), ("view_z", 0.0)], None), None);
        assert!(error(&[("roughness", 1.5)], Some(DVec3::Y)).unwrap().contains("row 40"));
        let plain = RowRules { gloss: None, ..rules(None) };
        assert!(TableReceivers::new(&table(&[]), 0, &plain).is_ok());
    }
}
