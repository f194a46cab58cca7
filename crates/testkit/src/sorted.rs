//! The obvious sort, to compare the external one with.

use pbgi_cloud::Surfel;
use pbgi_math::{Aabb, MortonCode, RootCube};

/// Surfels with their codes, by code and then input order.
#[must_use]
pub fn sort_in_memory(surfels: &[Surfel]) -> (RootCube, Vec<(MortonCode, Surfel)>) {
    let root = RootCube::from_bounds(&Aabb::from_points(surfels.iter().map(Surfel::center)));
    let mut coded: Vec<_> = surfels.iter().map(|s| (root.code(s.center()), *s)).collect();
    coded.sort_by_key(|s| s.0);
    (root, coded)
}

/// Largest radius, area and radiance.
#[must_use]
pub fn summarize(surfels: &[Surfel]) -> (f32, f32, f32) {
    surfels.iter().fold((0.0, 0.0, 0.0), |(r, a, l), s| {
        let radiance = s.radiance.iter().fold(l, |m: f32, &c| m.max(c));
        (s.radius.max(r), s.area.max(a), radiance)
    })
}
