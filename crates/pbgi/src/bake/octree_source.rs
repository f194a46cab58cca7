//! The surfels of an octree file as a cloud, to be lit anew.

use crate::PbgiError;
use pbgi_cloud::{CloudError, Surfel, SurfelFlags, SurfelSource};
use pbgi_format::{Channels, Header, LeafSurfel};
use pbgi_math::{Aabb, DVec3};
use pbgi_store::{LeafWalk, Octree, OpenOptions, StoreError, for_each_leaf};
use std::path::{Path, PathBuf};

/// Bytes of the page cache of an octree that is read as a cloud: one path of the tree.
pub(crate) const OCTREE_CACHE_BYTES: u64 = 16 << 20;

/// Surfels appended per chunk, give or take a leaf.
const CHUNK_SURFELS: usize = 4096;

/// The surfels of an octree file in its order, as its leaves have rounded them.
pub(crate) struct OctreeSource {
    path: PathBuf,
    octree: Octree,
    walk: LeafWalk,
}

impl OctreeSource {
    /// Opens an octree file.
    ///
    /// # Errors
    ///
    /// If it cannot be read, or its pages are too large for [`OCTREE_CACHE_BYTES`].
    pub fn open(path: &Path) -> Result<Self, PbgiError> {
        let options = OpenOptions { cache_bytes: OCTREE_CACHE_BYTES, ..OpenOptions::default() };
        let octree = Octree::open(path, &options)?;
        let walk = LeafWalk::new(&octree);
        Ok(Self { path: path.to_owned(), octree, walk })
    }

    /// Its header.
    pub fn header(&self) -> &Header {
        self.octree.header()
    }

    /// Refuses a file that cannot be lit: without albedo nothing reflects, and radiance may be light that was received, unless
    /// `is_unlit` says that it is emission.
    pub fn check_relightable(&self, is_unlit: bool) -> Result<(), PbgiError> {
        let (header, path) = (self.header(), self.path.display());
        if !header.flags.albedo {
            return Err(PbgiError::input(format!(
                "{path}: stores no albedo, without which surfels reflect no light; bake its scene again without --occlusion-only"
            )));
        }
        if header.channels == Channels::Rgb && !is_unlit {
            return Err(PbgiError::input(format!(
                "{path}: stores light, and not whether its surfels emit or reflect it; if it was baked without --env and --bounces, say \
                 so by --unlit, else bake its scene again"
            )));
        }
        Ok(())
    }
}

impl SurfelSource for OctreeSource {
    fn origin(&self) -> DVec3 {
        self.header().origin
    }

    /// Reads the file once: rounded centers may lie a little outside the cube of the octree.
    fn find_bounds(&mut self) -> Result<Option<Aabb>, CloudError> {
        let mut bounds = Aabb::EMPTY;
        let centers = for_each_leaf(&mut self.octree.reader(), |_, surfels| {
            bounds = bounds.union(Aabb::from_points(surfels.iter().map(|s| s.center)));
        });
        centers.map_err(|e| read_error(&self.path, e))?;
        Ok(Some(bounds))
    }

    fn count(&self) -> Option<u64> {
        Some(self.header().surfel_count)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let Self { path, octree, walk } = self;
        let end = out.len() + CHUNK_SURFELS;
        let mut reader = octree.reader();
        while out.len() < end {
            let leaf = walk.next_leaf(&mut reader).map_err(|e| read_error(path, e))?;
            let Some((_, surfels)) = leaf else { return Ok(false) };
            out.extend(surfels.iter().map(surfel_of));
        }
        Ok(true)
    }
}

fn read_error(path: &Path, source: StoreError) -> CloudError {
    CloudError::io(path, "read", std::io::Error::other(source))
}

/// A surfel as it was before it was stored, up to rounding.
fn surfel_of(stored: &LeafSurfel) -> Surfel {
    let mut surfel = Surfel::new(stored.center, stored.normal, stored.radius, stored.area)
        .with_radiance(stored.radiance)
        .with_albedo(stored.albedo);
    if stored.is_triangle() {
        let [base, _] = stored.tile.axes(stored.normal);
        surfel = surfel.with_triangle(base * (2.0 * stored.half_long), stored.foot.share());
    } else if stored.is_rectangle() {
        let [long_edge, _] = stored.tile.edges(stored.normal);
        let aspect = 4.0 * stored.half_long * stored.half_long / stored.area;
        surfel = surfel.with_tile(long_edge, aspect.max(1.0));
    }
    if stored.isotropic {
        surfel = surfel.with_flags(SurfelFlags::ISOTROPIC);
    }
    if stored.front_only {
        surfel = surfel.with_flags(SurfelFlags::FRONT_ONLY);
    }
    surfel
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::Vec3;

    fn stored(surfel: &Surfel) -> LeafSurfel {
        LeafSurfel {
            center: surfel.center(),
            normal: surfel.normal(),
            radius: surfel.radius,
            area: surfel.area,
            tile: surfel.tile(),
            foot: surfel.foot(),
            half_long: surfel.half_long(),
            radiance: surfel.radiance,
            albedo: surfel.albedo_rgb(),
            isotropic: surfel.is_isotropic(),
            front_only: surfel.is_front_only(),
        }
    }

    #[test]
    fn surfels_come_back_with_their_outlines_and_flags() {
        let normal = Vec3::new(0.3, -0.8, 0.5).normalize();
        let disk = Surfel::new(Vec3::new(1.0, 2.0, 3.0), normal, 0.3, 0.1)
            .with_albedo([0.5, 0.25, 1.0])
            .with_radiance([3.0, 2.0, 1.0]);
        let oblong = disk.with_tile(normal.cross(Vec3::X), 1.7);
        let square = disk.with_tile(normal.cross(Vec3::X), 1.0);
        let sheet = oblong.with_flags(SurfelFlags::FRONT_ONLY);
        let point = disk.with_flags(SurfelFlags::ISOTROPIC);
        let triangle = sheet.with_triangle(normal.cross(Vec3::X).normalize() * 0.6, 0.3);
        for surfel in [disk, oblong, square, sheet, triangle, point] {
            let found = surfel_of(&stored(&surfel));
            assert!((found.radius / surfel.radius - 1.0).abs() < 1e-4, "{found:?} {surfel:?}");
            assert_eq!(Surfel { radius: surfel.radius, ..found }, surfel);
        }
    }
}
