//! Cloud files that are open only while they are read.

use crate::{CloudError, CloudOptions, LeftOut, Surfel, SurfelSource, open_cloud};
use pbgi_math::{Aabb, DVec3};
use std::path::{Path, PathBuf};

/// A cloud file whose header was read, and which is closed until its first surfels are asked for: hundreds of them
/// can wait for their turn without holding files open or buffers.
pub struct LazyCloud {
    path: PathBuf,
    options: CloudOptions,
    origin: DVec3,
    bounds: Option<Aabb>,
    count: Option<u64>,
    source: Option<Box<dyn SurfelSource>>,
}

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
        })
    }

    fn reopen(&self) -> Result<Box<dyn SurfelSource>, CloudError> {
        let source = open_cloud(&self.path, &self.options)?;
        if (source.origin(), source.count()) != (self.origin, self.count) {
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
        if self.bounds.is_none() {
            let mut source = self.reopen()?;
            self.bounds = match source.find_bounds()? {
                Some(bounds) => Some(bounds),
                None => Some(read_bounds(source.as_mut())?),
            };
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
        self.source.as_ref().map_or_else(LeftOut::default, |source| source.left_out())
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let source = match self.source.take() {
            Some(source) => source,
            None => self.reopen()?,
        };
        self.source.insert(source).read_chunk(out)
    }
}

/// Box of all centers ahead.
fn read_bounds(source: &mut dyn SurfelSource) -> Result<Aabb, CloudError> {
    let mut bounds = Aabb::EMPTY;
    let (mut chunk, mut more) = (Vec::new(), true);
    while more {
        chunk.clear();
        more = source.read_chunk(&mut chunk)?;
        bounds = chunk.iter().fold(bounds, |all, s| all.with_point(s.center()));
    }
    Ok(bounds)
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
