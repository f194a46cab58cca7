//! Cloud files that are open only while they are read.

use crate::robust::{Mass, PlaceSample};
use crate::{CloudError, CloudOptions, LeftOut, Surfel, SurfelSource, open_cloud};
use pbgi_math::{Aabb, DVec3, Vec3};
use std::path::{Path, PathBuf};

/// A cloud file whose header was read, and which is closed until its first surfels are asked for: hundreds of them
/// can wait for their turn without holding files open or buffers.
///
/// A few points far away from all others, such as a sensor's glitch at the origin of a survey grid, are left out with a warning once
/// the bounds were asked for: they would take the digits and the levels of all others.
pub struct LazyCloud {
    path: PathBuf,
    options: CloudOptions,
    origin: DVec3,
    bounds: Option<Aabb>,
    count: Option<u64>,
    source: Option<Box<dyn SurfelSource>>,
    /// Whether strays were looked for.
    is_searched: bool,
    /// What strays are beyond, if there are any, and the first of them.
    limits: Option<Aabb>,
    first_stray: Vec3,
    strays: u64,
}

/// Surfels that tell whether a cloud's bounds may be those of strays.
const PROBE_SURFELS: usize = 1 << 16;
/// Extent of bounds over that of the first surfels' mass from which on strays are looked for.
const SUSPICIOUS_EXTENTS: f64 = 256.0;

impl LazyCloud {
    /// Looks at the header of the file `path`.
    ///
    /// # Errors
    ///
    /// Those of [`open_cloud`].
    pub fn open(path: &Path, options: &CloudOptions) -> Result<Self, CloudError> {
        let source = open_cloud(path, options)?;
        Ok(Self {
            path: path.to_owned(),
            options: options.clone(),
            origin: source.origin(),
            bounds: source.bounds(),
            count: source.count(),
            source: None,
            is_searched: false,
            limits: None,
            first_stray: Vec3::ZERO,
            strays: 0,
        })
    }

    fn reopen(&self) -> Result<Box<dyn SurfelSource>, CloudError> {
        let source = open_cloud(&self.path, &self.options)?;
        let is_same_count = self.limits.is_some() || source.count() == self.count;
        if source.origin() != self.origin || !is_same_count {
            return Err(CloudError::malformed(
                &self.path,
                "the file has changed while others were read; run again when nobody writes it",
            ));
        }
        Ok(source)
    }
}

impl SurfelSource for LazyCloud {
    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn bounds(&self) -> Option<Aabb> {
        self.bounds
    }

    fn find_bounds(&mut self) -> Result<Option<Aabb>, CloudError> {
        if !self.is_searched {
            self.is_searched = true;
            let mut source = self.reopen()?;
            let known = source.find_bounds()?;
            let most = if known.is_some() { PROBE_SURFELS } else { usize::MAX };
            let (read, mass) = sample(source.as_mut(), most)?;
            let bounds = known.unwrap_or(read);
            self.bounds = Some(bounds);
            let is_wide = |mass: &Mass| {
                f64::from(bounds.extent().max_element()) > SUSPICIOUS_EXTENTS * mass.extent()
            };
            if mass.as_ref().is_some_and(is_wide) {
                self.find_strays(bounds)?;
            }
        }
        Ok(self.bounds)
    }

    fn count(&self) -> Option<u64> {
        self.count
    }

    fn skipped(&self) -> u64 {
        self.source.as_ref().map_or(0, |source| source.skipped())
    }

    fn left_out(&self) -> LeftOut {
        let own = LeftOut { strays: self.strays, ..LeftOut::default() };
        self.source.as_ref().map_or(own, |source| source.left_out().plus(own))
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.source.as_ref().map_or_else(Vec::new, |source| source.warnings());
        if self.strays > 0 {
            let place = self.first_stray.as_dvec3() + self.origin;
            warnings.push(format!(
                "{}: {} points lie far away from all others, the first at {place}; they are left out, as they would cost all others \
                 their digits (bake them alone, or remove them from the file)",
                self.path.display(),
                self.strays
            ));
        }
        warnings
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let source = match self.source.take() {
            Some(source) => source,
            None => self.reopen()?,
        };
        let start = out.len();
        let more = self.source.insert(source).read_chunk(out)?;
        if let Some(limits) = self.limits {
            let mut kept = start;
            for index in start..out.len() {
                let is_stray = !limits.contains(out[index].center());
                if is_stray && self.strays == 0 {
                    self.first_stray = out[index].center();
                }
                self.strays += u64::from(is_stray);
                if !is_stray {
                    out[kept] = out[index];
                    kept += 1;
                }
            }
            out.truncate(kept);
        }
        Ok(more)
    }
}

impl LazyCloud {
    /// Looks at all points for strays; leaves them out from now on if there are some, and they are few.
    fn find_strays(&mut self, bounds: Aabb) -> Result<(), CloudError> {
        let (_, mass) = sample(self.reopen()?.as_mut(), usize::MAX)?;
        let Some(mass) = mass else { return Ok(()) };
        let [min, max] = mass.limits().map(|corner| corner.as_vec3());
        let limits = Aabb { min, max };
        if limits.contains(bounds.min) && limits.contains(bounds.max) {
            return Ok(());
        }
        let (mut strays, mut total, mut kept) = (0u64, 0u64, Aabb::EMPTY);
        let mut source = self.reopen()?;
        let (mut chunk, mut more) = (Vec::new(), true);
        while more {
            chunk.clear();
            more = source.read_chunk(&mut chunk)?;
            total += chunk.len() as u64;
            for center in chunk.iter().map(Surfel::center) {
                match limits.contains(center) {
                    true => kept = kept.with_point(center),
                    false => strays += 1,
                }
            }
        }
        if mass.are_strays(strays, total) {
            (self.limits, self.bounds, self.count) = (Some(limits), Some(kept), None);
        }
        Ok(())
    }
}

/// Box and mass of the surfels ahead, of the first `most` about.
fn sample(source: &mut dyn SurfelSource, most: usize) -> Result<(Aabb, Option<Mass>), CloudError> {
    let (mut bounds, mut sample, mut seen) = (Aabb::EMPTY, PlaceSample::default(), 0);
    let (mut chunk, mut more) = (Vec::new(), true);
    while more && seen < most {
        chunk.clear();
        more = source.read_chunk(&mut chunk)?;
        seen += chunk.len();
        for center in chunk.iter().map(Surfel::center) {
            bounds = bounds.with_point(center);
            sample.add(center.as_dvec3());
        }
    }
    Ok((bounds, sample.mass()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RawKind, SliceSource, write_raw_file};
    use pbgi_math::Vec3;

    fn write(path: &Path, count: usize) {
        let surfels = vec![Surfel::new(Vec3::ONE, Vec3::Z, 1.0, 1.0); count];
        write_raw_file(path, RawKind::Full, &mut SliceSource::new(&surfels)).unwrap();
    }

    #[test]
    fn files_are_opened_when_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud");
        write(&path, 5000);
        let mut cloud = LazyCloud::open(&path, &CloudOptions::default()).unwrap();
        assert!(cloud.source.is_none());
        assert_eq!(cloud.count(), Some(5000));
        let mut surfels = Vec::new();
        let point = Aabb { min: Vec3::ONE, max: Vec3::ONE };
        assert_eq!(cloud.find_bounds().unwrap(), Some(point));
        while cloud.read_chunk(&mut surfels).unwrap() {}
        assert_eq!(surfels.len(), 5000);
    }

    /// A grid with a few points far away.
    fn write_with_strays(path: &Path, strays: u32) {
        let grid = (0..10_000u32).map(|i| Vec3::new((i % 100) as f32, (i / 100) as f32, 0.0));
        let far = (0..strays).map(|i| Vec3::new(-1e6 - i as f32, 0.0, 0.0));
        let surfels: Vec<Surfel> =
            far.chain(grid).map(|place| Surfel::new(place, Vec3::Z, 1.0, 1.0)).collect();
        write_raw_file(path, RawKind::Full, &mut SliceSource::new(&surfels)).unwrap();
    }

    #[test]
    fn strays_are_left_out_with_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud");
        for (strays, left_out) in [(0, 0), (3, 3), (500, 0)] {
            write_with_strays(&path, strays);
            let mut cloud = LazyCloud::open(&path, &CloudOptions::default()).unwrap();
            let bounds = cloud.find_bounds().unwrap().unwrap();
            assert_eq!(bounds.min.x < -1e5, strays != 0 && left_out == 0);
            let mut surfels = Vec::new();
            while cloud.read_chunk(&mut surfels).unwrap() {}
            assert_eq!(surfels.len() as u32, 10_000 + strays - left_out);
            assert_eq!(cloud.left_out().strays, u64::from(left_out));
            assert_eq!(cloud.count().is_none(), left_out > 0);
            let warnings = cloud.warnings();
            assert_eq!(warnings.len(), usize::from(left_out > 0));
            assert!(
                warnings
                    .iter()
                    .all(|w| w.contains("3 points lie far away") && w.contains("-1000000"))
            );
        }
    }

    #[test]
    fn files_that_change_meanwhile_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud");
        write(&path, 5);
        let mut cloud = LazyCloud::open(&path, &CloudOptions::default()).unwrap();
        write(&path, 6);
        let message = cloud.read_chunk(&mut Vec::new()).unwrap_err().to_string();
        assert!(message.contains("has changed"), "{message}");
        std::fs::remove_file(&path).unwrap();
        assert!(cloud.read_chunk(&mut Vec::new()).is_err());
    }
}
