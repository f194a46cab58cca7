//! Records by column: what [`Record::to_surfel`] does to one, done to hundreds by vector code.

use crate::Surfel;
use crate::record::{Defect, MAGNITUDE_MAX, Record, are_sound_sizes};
use crate::{CloudOptions, SurfelFlags};
use half::f16;
use half::slice::HalfFloatSliceExt;
use pbgi_math::{Aabb, Vec3, encode_octahedral24};
use std::f32::consts::PI;

/// Records of a batch, at most: its columns stay in the first-level cache.
pub(crate) const BATCH_RECORDS: usize = 256;

/// Columns a [`Record`] is made of, in the order of [`RecordBatch::column_mut`].
pub(crate) mod field {
    pub const POSITION: usize = 0;
    pub const NORMAL: usize = 3;
    pub const RADIUS: usize = 6;
    pub const AREA: usize = 7;
    pub const RADIANCE: usize = 8;
    pub const ALBEDO: usize = 11;
    pub const COUNT: usize = 14;
}

type Column = [f32; BATCH_RECORDS];

/// Up to [`BATCH_RECORDS`] records, as columns of numbers.
pub(crate) struct RecordBatch {
    len: usize,
    columns: Box<[Column; field::COUNT]>,
    /// Whether normals and albedos are those of a file rather than constants.
    has_normals: bool,
    has_albedos: bool,
    /// Radius and area, completed.
    sizes: [[f32; 2]; BATCH_RECORDS],
    orientations: [u32; BATCH_RECORDS],
    flags: [SurfelFlags; BATCH_RECORDS],
    albedos: [[f16; BATCH_RECORDS]; 3],
}

impl RecordBatch {
    /// Records whose columns are those of an unknown normal, unknown sizes, no light, and the default albedo.
    pub fn new(options: &CloudOptions) -> Self {
        let mut columns = Box::new([[0.0; BATCH_RECORDS]; field::COUNT]);
        for (column, albedo) in columns[field::ALBEDO..].iter_mut().zip(options.default_albedo) {
            column.fill(albedo);
        }
        Self {
            len: 0,
            columns,
            has_normals: false,
            has_albedos: false,
            sizes: [[0.0; 2]; BATCH_RECORDS],
            orientations: [encode_octahedral24(Vec3::Z); BATCH_RECORDS],
            flags: [SurfelFlags::ISOTROPIC; BATCH_RECORDS],
            albedos: options.default_albedo.map(|a| [f16::from_f32(a); BATCH_RECORDS]),
        }
    }

    /// Sets the number of records; columns keep what they hold.
    ///
    /// # Panics
    ///
    /// If there are more than [`BATCH_RECORDS`].
    pub fn set_len(&mut self, len: usize) {
        assert!(len <= BATCH_RECORDS, "a batch has at most {BATCH_RECORDS} records");
        self.len = len;
    }

    /// The numbers of a [`field`], to be overwritten.
    pub fn column_mut(&mut self, field: usize) -> &mut [f32] {
        self.has_normals |= (field::NORMAL..field::NORMAL + 3).contains(&field);
        self.has_albedos |= field >= field::ALBEDO;
        &mut self.columns[field][..self.len]
    }

    /// Appends the surfels of all records. `report` is told of each record that is none, by its place in the batch.
    ///
    /// # Errors
    ///
    /// Those of `report`.
    pub fn push_surfels<E>(
        &mut self,
        options: &CloudOptions,
        out: &mut Vec<Surfel>,
        mut report: impl FnMut(usize, Defect) -> Result<(), E>,
    ) -> Result<(), E> {
        let all_sound = self.encode_normals() & self.encode_albedos();
        if all_sound & self.complete_sizes(options.disk_overlap) & self.check_numbers() {
            out.extend((0..self.len).map(|i| self.surfel(i)));
            return Ok(());
        }
        for index in 0..self.len {
            match self.record(index).to_surfel(options.disk_overlap) {
                Ok(surfel) => out.push(surfel),
                Err(defect) => report(index, defect)?,
            }
        }
        Ok(())
    }

    /// Box of all positions; `None` where one is not that of a surfel.
    pub fn position_bounds(&self) -> Option<Aabb> {
        let [x, y, z] = [0, 1, 2].map(|k| &self.columns[field::POSITION + k][..self.len]);
        let (mut bounds, mut all_sound) = (Aabb::EMPTY, true);
        for ((x, y), z) in x.iter().zip(y).zip(z) {
            all_sound &= [x, y, z].iter().all(|x| x.abs() <= MAGNITUDE_MAX);
            bounds = bounds.with_point(Vec3::new(*x, *y, *z));
        }
        all_sound.then_some(bounds)
    }

    /// Whether all places and all light are those of surfels.
    fn check_numbers(&self) -> bool {
        let all = |field: usize, is_sound: fn(f32) -> bool| {
            self.columns[field..field + 3]
                .iter()
                .flat_map(|column| &column[..self.len])
                .fold(true, |all, x| all & is_sound(*x))
        };
        all(field::POSITION, |x| x.abs() <= MAGNITUDE_MAX)
            & all(field::RADIANCE, |l| (0.0..f32::INFINITY).contains(&l))
    }

    /// Derives sizes from each other where one is unknown; returns whether all are those of surfels.
    fn complete_sizes(&mut self, disk_overlap: f32) -> bool {
        let [radii, areas] = [field::RADIUS, field::AREA].map(|f| &self.columns[f][..self.len]);
        let mut all_sound = true;
        for ((radius, area), sizes) in radii.iter().zip(areas).zip(&mut self.sizes) {
            let (radius, area) = (*radius, *area);
            let disk_area = (PI * radius * radius / disk_overlap).max(f32::MIN_POSITIVE);
            let square_radius = (area * 0.5).sqrt();
            let complete_radius =
                if (radius == 0.0) & (area > 0.0) { square_radius } else { radius };
            let complete_area = if (area == 0.0) & (radius > 0.0) { disk_area } else { area };
            *sizes = [complete_radius, complete_area];
            all_sound &= are_sound_sizes(complete_radius, complete_area);
        }
        all_sound
    }

    /// Codes of all normals; returns whether all are finite.
    fn encode_normals(&mut self) -> bool {
        if !self.has_normals {
            return true;
        }
        let [x, y, z] = [0, 1, 2].map(|k| &self.columns[field::NORMAL + k][..self.len]);
        let (orientations, flags) = (&mut self.orientations[..], &mut self.flags[..]);
        let mut all_finite = true;
        for ((((x, y), z), orientation), flags) in
            x.iter().zip(y).zip(z).zip(orientations).zip(flags)
        {
            let (ax, ay, az) = (x.abs(), y.abs(), z.abs());
            all_finite &= (ax < f32::INFINITY) & (ay < f32::INFINITY) & (az < f32::INFINITY);
            let scale = ax.max(ay).max(az);
            let is_known = scale > 0.0;
            let scale = if is_known { scale } else { 1.0 };
            let up = if is_known { *z / scale } else { 1.0 };
            let unit = Vec3::new(x / scale, y / scale, up).normalize();
            *orientation = encode_octahedral24(unit);
            *flags = SurfelFlags(if is_known { 0 } else { SurfelFlags::ISOTROPIC.0 });
        }
        all_finite
    }

    /// Codes of all albedos; returns whether all are finite.
    fn encode_albedos(&mut self) -> bool {
        if !self.has_albedos {
            return true;
        }
        let (mut all_finite, mut clamped) = (true, [0.0; BATCH_RECORDS]);
        for (codes, column) in self.albedos.iter_mut().zip(&self.columns[field::ALBEDO..]) {
            for (clamped, albedo) in clamped.iter_mut().zip(&column[..self.len]) {
                all_finite &= albedo.abs() < f32::INFINITY;
                *clamped = albedo.clamp(0.0, 1.0);
            }
            codes[..self.len].convert_from_f32_slice(&clamped[..self.len]);
        }
        all_finite
    }

    /// The surfel of a record, once all codes and sizes are known.
    #[inline]
    fn surfel(&self, i: usize) -> Surfel {
        let triple = |field: usize| [0, 1, 2].map(|k| self.columns[field + k][i]);
        let [radius, area] = self.sizes[i];
        Surfel {
            position: triple(field::POSITION),
            radius,
            area,
            orientation: self.orientations[i],
            radiance: triple(field::RADIANCE),
            albedo: [0, 1, 2].map(|k| self.albedos[k][i]),
            flags: self.flags[i],
        }
    }

    fn record(&self, i: usize) -> Record {
        let triple = |field: usize| [0, 1, 2].map(|k| self.columns[field + k][i]);
        Record {
            position: Vec3::from_array(triple(field::POSITION)),
            normal: known_normal(Vec3::from_array(triple(field::NORMAL))),
            radius: self.columns[field::RADIUS][i],
            area: self.columns[field::AREA][i],
            radiance: triple(field::RADIANCE),
            albedo: triple(field::ALBEDO),
            flags: SurfelFlags::default(),
        }
    }
}

/// A normal as it is, or 0, an unknown one, for what is no number: programs write that where they know none.
fn known_normal(normal: Vec3) -> Vec3 {
    if normal.is_finite() { normal } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of every kind, from a simple generator.
    fn numbers() -> impl Iterator<Item = f32> {
        let odd = [0.0, -0.0, 1e-45, -1.0, 2.0, 1e19, 3e38, f32::INFINITY, f32::NAN, 1e-20];
        let mut state = 7u32;
        std::iter::repeat_with(move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            match state >> 16 {
                high if high % 61 == 0 => odd[high as usize / 61 % odd.len()],
                high => high as f32 / 65_536.0,
            }
        })
    }

    /// One by one and all at once, surfels have the same bits and records the same defects.
    #[test]
    fn batches_agree_with_single_records() {
        let options = CloudOptions { disk_overlap: 1.7, ..CloudOptions::default() };
        let (mut numbers, mut defects) = (numbers(), 0);
        for round in 0..2000 {
            let mut batch = RecordBatch::new(&options);
            batch.set_len(1 + round % 9);
            for field in (0..field::COUNT).filter(|f| (round >> (f % 8)) & 1 == 0) {
                for (number, value) in batch.column_mut(field).iter_mut().zip(&mut numbers) {
                    *number = if field == field::RADIUS && round % 3 == 0 { 0.0 } else { value };
                }
            }
            let (mut expected, mut expected_defects) = (Vec::new(), Vec::new());
            for i in 0..batch.len {
                match batch.record(i).to_surfel(options.disk_overlap) {
                    Ok(surfel) => expected.push(surfel),
                    Err(defect) => expected_defects.push((i, defect)),
                }
            }
            let (mut found, mut found_defects) = (Vec::new(), Vec::new());
            let report = |i, defect| {
                found_defects.push((i, defect));
                Ok::<(), ()>(())
            };
            batch.push_surfels(&options, &mut found, report).unwrap();
            let bits = |surfels: &[Surfel]| bytemuck::cast_slice::<_, u8>(surfels).to_vec();
            assert_eq!(bits(&found), bits(&expected), "round {round}");
            assert_eq!(found_defects, expected_defects);
            defects += found_defects.len();
        }
        assert!(defects > 100, "{defects} defects");
    }
}
