//! From the fields a file gives to a valid surfel: what is derived, what is refused.

use crate::{CloudError, Surfel, SurfelFlags};
use half::f16;
use pbgi_math::{Vec3, encode_octahedral24};
use std::f32::consts::PI;
use std::path::Path;

/// Largest magnitude of a coordinate or size: squares stay finite in f32.
pub(crate) const MAGNITUDE_MAX: f32 = 1e18;

/// What to do with a record that holds no valid surfel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InvalidPolicy {
    /// Stop with an error that names the record.
    #[default]
    Refuse,
    /// Drop the record and count it ([`crate::SurfelSource::skipped`]).
    Skip,
}

/// Which LAS points are read, by their class (LAS 1.4, tables 9 and 17).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ClassFilter {
    /// All but those of these classes.
    Skip(Vec<u8>),
    /// Those of these classes only.
    Only(Vec<u8>),
}

impl Default for ClassFilter {
    /// All but noise: 7, low, and 18, high.
    fn default() -> Self {
        Self::Skip(vec![7, 18])
    }
}

impl ClassFilter {
    /// Whether points of `class` are read.
    #[must_use]
    pub fn keeps(&self, class: u8) -> bool {
        match self {
            Self::Skip(classes) => !classes.contains(&class),
            Self::Only(classes) => classes.contains(&class),
        }
    }
}

/// How a cloud's records become surfels.
#[derive(Clone, Debug)]
pub struct CloudOptions {
    /// What to do with invalid records.
    pub invalid: InvalidPolicy,
    /// Sum of disk areas per surface area where a file gives radii and no areas: the area of a
    /// surfel is `π r² / disk_overlap`. 1 for disks that tile, above 1 for disks that overlap.
    pub disk_overlap: f32,
    /// Albedo where a file has no color, linear Rec. 709.
    pub default_albedo: [f32; 3],
    /// Which points of LAS files are read, by their class.
    pub classes: ClassFilter,
}

impl Default for CloudOptions {
    fn default() -> Self {
        Self {
            invalid: InvalidPolicy::Refuse,
            disk_overlap: 1.0,
            default_albedo: [0.5; 3],
            classes: ClassFilter::default(),
        }
    }
}

/// The fields of one record, as read.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Record {
    pub position: Vec3,
    /// Of any length; zero where unknown.
    pub normal: Vec3,
    /// 0 where unknown.
    pub radius: f32,
    /// 0 where unknown.
    pub area: f32,
    pub radiance: [f32; 3],
    pub albedo: [f32; 3],
    pub flags: SurfelFlags,
}

impl Record {
    /// The surfel of this record, or what is wrong with it.
    ///
    /// A zero normal makes it isotropic. A missing area is `π r² / disk_overlap`; a missing radius
    /// is `√(area / 2)`, the disk around a square of that area; where both are missing both stay 0,
    /// to be estimated from the neighborhood. Albedo is clamped to 0..=1.
    #[inline]
    pub fn to_surfel(self, disk_overlap: f32) -> Result<Surfel, Defect> {
        let reach = self.position.abs().max_element();
        if !(self.position.is_finite() && reach <= MAGNITUDE_MAX) {
            return Err(Defect::Position);
        }
        if !self.normal.is_finite() {
            return Err(Defect::Normal);
        }
        let size = |x: f32| (0.0..=MAGNITUDE_MAX).contains(&x);
        if !size(self.radius) {
            return Err(Defect::Radius);
        }
        let (radius, area) = match (self.radius > 0.0, self.area > 0.0) {
            (true, false) => (self.radius, PI * self.radius * self.radius / disk_overlap),
            (false, true) => ((self.area.max(f32::MIN_POSITIVE) * 0.5).sqrt(), self.area),
            _ => (self.radius, self.area),
        };
        // A radius so small that its square vanishes still has an area.
        let area = if radius > 0.0 { area.max(f32::MIN_POSITIVE) } else { area };
        if !(0.0..f32::INFINITY).contains(&area) || self.area < 0.0 || self.area.is_nan() {
            return Err(Defect::Area);
        }
        if !self.radiance.iter().all(|l| (0.0..f32::INFINITY).contains(l)) {
            return Err(Defect::Radiance);
        }
        if !self.albedo.iter().all(|a| a.is_finite()) {
            return Err(Defect::Albedo);
        }
        // Scaled first, so that neither tiny nor huge normals lose their direction.
        let scale = self.normal.abs().max_element();
        let (orientation, flags) = if scale > 0.0 {
            (encode_octahedral24((self.normal / scale).normalize()), self.flags)
        } else {
            (encode_octahedral24(Vec3::Z), self.flags.with(SurfelFlags::ISOTROPIC))
        };
        Ok(Surfel {
            position: self.position.to_array(),
            radius,
            area,
            orientation,
            radiance: self.radiance,
            albedo: self.albedo.map(|a| f16::from_f32(a.clamp(0.0, 1.0))),
            flags,
        })
    }
}

/// Whether a surfel's fields are what [`Record::to_surfel`] would make of them, so that nothing is left to do.
#[inline]
pub(crate) fn is_sound(surfel: &Surfel) -> bool {
    // Without branches: compilers turn it into vector code.
    let sizes = are_sound_sizes(surfel.radius, surfel.area);
    let places = surfel.position.iter().fold(true, |all, x| all & (x.abs() <= MAGNITUDE_MAX));
    let light =
        surfel.radiance.iter().fold(true, |all, l| all & (*l >= 0.0) & (*l < f32::INFINITY));
    let one = f16::ONE.to_bits();
    let albedo = surfel.albedo.iter().fold(true, |all, a| all & (a.to_bits() <= one));
    sizes & places & light & albedo & (surfel.flags.0 & !SurfelFlags::KNOWN.0 == 0)
}

/// Whether both sizes are known and in range, or both unknown.
#[inline]
pub(crate) fn are_sound_sizes(radius: f32, area: f32) -> bool {
    let known = (radius > 0.0) & (area >= f32::MIN_POSITIVE);
    let unknown = (radius == 0.0) & (area == 0.0);
    (known | unknown) & (radius <= MAGNITUDE_MAX) & (area < f32::INFINITY)
}

/// What makes a record invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Defect {
    Position,
    Normal,
    Radius,
    Area,
    Radiance,
    Albedo,
    Flags,
}

impl Defect {
    /// Either counts the record as skipped or makes it an error; `place` says where it lies.
    pub fn apply(
        self,
        policy: InvalidPolicy,
        skipped: &mut u64,
        path: &Path,
        place: impl FnOnce() -> String,
    ) -> Result<(), CloudError> {
        if policy == InvalidPolicy::Skip {
            *skipped += 1;
            return Ok(());
        }
        let what = match self {
            Self::Position => "position is not finite, or beyond 1e18",
            Self::Normal => "normal is not finite",
            Self::Radius => "radius is negative, not finite, or beyond 1e18",
            Self::Area => "area is negative, or not finite",
            Self::Radiance => "radiance is negative, or not finite",
            Self::Albedo => "color is not finite",
            Self::Flags => "reserved flag bits are set",
        };
        Err(CloudError::malformed(
            path,
            format!("{}: {what}; mend it, or drop invalid records (--skip-invalid)", place()),
        ))
    }
}

/// Linear value of an sRGB-encoded one in 0..=1 (IEC 61966-2-1).
pub(crate) fn srgb_to_linear(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// [`srgb_to_linear`] of every 8-bit code.
pub(crate) fn srgb8_table() -> [f32; 256] {
    std::array::from_fn(|code| srgb_to_linear(code as f32 / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_sizes_are_derived_from_each_other() {
        let record = Record { normal: Vec3::X * 1e-30, radius: 2.0, ..Record::default() };
        let surfel = record.to_surfel(2.0).unwrap();
        assert_eq!(surfel.area, PI * 2.0);
        assert_eq!(surfel.normal(), Vec3::X);
        let surfel = Record { area: 8.0, ..Record::default() }.to_surfel(1.0).unwrap();
        assert_eq!((surfel.radius, surfel.area), (2.0, 8.0));
        assert!(surfel.is_isotropic());
        let surfel = Record::default().to_surfel(1.0).unwrap();
        assert_eq!((surfel.radius, surfel.area), (0.0, 0.0));
        // Found by fuzzing: half of the smallest number there is, is 0.
        let surfel = Record { area: 1e-45, ..Record::default() }.to_surfel(1.0).unwrap();
        assert!(surfel.radius > 0.0 && is_sound(&surfel), "{surfel:?}");
        let tiny = Record { radius: 1e-30, ..Record::default() }.to_surfel(1.0).unwrap();
        assert!(tiny.area > 0.0);
    }

    #[test]
    fn invalid_records_are_refused() {
        let good = Record { radius: 1.0, ..Record::default() };
        for (record, defect) in [
            (Record { position: Vec3::splat(f32::NAN), ..good }, Defect::Position),
            (Record { position: Vec3::splat(1e20), ..good }, Defect::Position),
            (Record { normal: Vec3::new(0.0, f32::INFINITY, 0.0), ..good }, Defect::Normal),
            (Record { radius: -1.0, ..good }, Defect::Radius),
            (Record { radius: f32::NAN, ..good }, Defect::Radius),
            (Record { area: -1.0, ..good }, Defect::Area),
            (Record { area: f32::NAN, ..good }, Defect::Area),
            (Record { area: f32::INFINITY, ..good }, Defect::Area),
            (Record { radiance: [-1.0, 0.0, 0.0], ..good }, Defect::Radiance),
            (Record { albedo: [f32::NAN, 0.0, 0.0], ..good }, Defect::Albedo),
        ] {
            assert_eq!(record.to_surfel(1.0), Err(defect));
        }
        assert!(good.to_surfel(1.0).is_ok());
    }
}
