//! What a pass over all surfels tells about them.

use pbgi_cloud::Surfel;
use pbgi_math::{Aabb, DVec3, RootCube, Vec3};

/// What the whole stream holds, known before its first surfel is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfelSummary {
    /// Cube the Morton codes refer to.
    pub root: RootCube,
    /// World position of the coordinate origin.
    pub origin: DVec3,
    /// Number of surfels.
    pub count: u64,
    /// Box of all centers; empty when there are none.
    pub bounds: Aabb,
    /// Largest radius.
    pub radius_max: f32,
    /// Largest area.
    pub area_max: f32,
    /// Sum of all areas.
    pub area_sum: f64,
    /// Largest radiance of any channel; 0 where nothing shines.
    pub radiance_max: f32,
    /// Whether any albedo is above 0.
    pub any_albedo: bool,
    /// Whether any surfel is isotropic.
    pub any_isotropic: bool,
    /// Whether any surfel has a front only.
    pub any_front_only: bool,
    /// Whether any surfel has radius and area 0, to be estimated ([`crate::estimate_surfels`]).
    pub any_missing_size: bool,
}

impl SurfelSummary {
    /// A summary of nothing yet.
    pub(crate) fn new(origin: DVec3) -> Self {
        Self {
            root: RootCube { min: Vec3::ZERO, edge: 1.0 },
            origin,
            count: 0,
            bounds: Aabb::EMPTY,
            radius_max: 0.0,
            area_max: 0.0,
            area_sum: 0.0,
            radiance_max: 0.0,
            any_albedo: false,
            any_isotropic: false,
            any_front_only: false,
            any_missing_size: false,
        }
    }

    /// Takes one more surfel into account.
    #[inline]
    pub(crate) fn add(&mut self, surfel: &Surfel) {
        self.count += 1;
        self.bounds = self.bounds.with_point(surfel.center());
        self.radius_max = self.radius_max.max(surfel.radius);
        self.area_max = self.area_max.max(surfel.area);
        self.area_sum += f64::from(surfel.area);
        let [r, g, b] = surfel.radiance;
        self.radiance_max = self.radiance_max.max(r).max(g).max(b);
        // The bits of an f16 are 0 only for the number 0.
        self.any_albedo |= surfel.albedo.iter().any(|a| a.to_bits() != 0);
        self.any_isotropic |= surfel.is_isotropic();
        self.any_front_only |= surfel.is_front_only();
        self.any_missing_size |= surfel.radius == 0.0;
    }
}
