//! Several clouds as one.

use crate::{CloudError, LeftOut, Surfel, SurfelSource};
use pbgi_math::{Aabb, DVec3, Vec3};
use std::collections::VecDeque;

/// The surfels of several sources one after another, around the origin of the first.
pub struct ConcatSource<'a> {
    sources: VecDeque<Box<dyn SurfelSource + 'a>>,
    origin: DVec3,
    bounds: Option<Aabb>,
    count: Option<u64>,
    /// Records dropped and left out by sources already read to their end.
    skipped: u64,
    left_out: LeftOut,
    warnings: Vec<String>,
}

impl<'a> ConcatSource<'a> {
    /// One source of many, in the given order; none gives an empty cloud.
    #[must_use]
    pub fn new(sources: Vec<Box<dyn SurfelSource + 'a>>) -> Self {
        let origin = sources.first().map_or(DVec3::ZERO, |s| s.origin());
        let bounds = sources.iter().try_fold(Aabb::EMPTY, |all, source| {
            Some(joined(all, source.bounds()?, source.origin() - origin))
        });
        let mut all = Self {
            sources: sources.into(),
            origin,
            bounds,
            count: None,
            skipped: 0,
            left_out: LeftOut::default(),
            warnings: Vec::new(),
        };
        all.count = all.sum_counts();
        all
    }

    fn sum_counts(&self) -> Option<u64> {
        self.sources.iter().try_fold(0u64, |sum, s| s.count().and_then(|c| sum.checked_add(c)))
    }
}

/// `all` and the bounds of one more source, whose origin is `shift` from that of all.
fn joined(all: Aabb, own: Aabb, shift: DVec3) -> Aabb {
    if own.is_empty() {
        return all;
    }
    all.union(Aabb { min: shifted(own.min, shift), max: shifted(own.max, shift) })
}

/// A position seen from another origin. Monotonic, so shifted bounds hold shifted positions.
fn shifted(position: Vec3, shift: DVec3) -> Vec3 {
    if shift == DVec3::ZERO { position } else { (position.as_dvec3() + shift).as_vec3() }
}

impl SurfelSource for ConcatSource<'_> {
    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn bounds(&self) -> Option<Aabb> {
        self.bounds
    }

    fn find_bounds(&mut self) -> Result<Option<Aabb>, CloudError> {
        // Also where they are known: some may be those of strays.
        let mut all = Aabb::EMPTY;
        for source in &mut self.sources {
            let Some(own) = source.find_bounds()? else { return Ok(None) };
            all = joined(all, own, source.origin() - self.origin);
        }
        self.bounds = Some(all);
        // Strays are left out.
        self.count = self.sum_counts();
        Ok(self.bounds)
    }

    fn count(&self) -> Option<u64> {
        self.count
    }

    fn skipped(&self) -> u64 {
        self.skipped + self.sources.iter().map(|s| s.skipped()).sum::<u64>()
    }

    fn left_out(&self) -> LeftOut {
        self.sources.iter().fold(self.left_out, |sum, source| sum.plus(source.left_out()))
    }

    fn warnings(&self) -> Vec<String> {
        let ahead = self.sources.iter().flat_map(|source| source.warnings());
        self.warnings.iter().cloned().chain(ahead).collect()
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let Some(source) = self.sources.front_mut() else { return Ok(false) };
        let start = out.len();
        let more = source.read_chunk(out)?;
        let shift = source.origin() - self.origin;
        for surfel in &mut out[start..] {
            surfel.position = shifted(surfel.center(), shift).to_array();
        }
        if !more {
            self.skipped += source.skipped();
            self.left_out = self.left_out.plus(source.left_out());
            self.warnings.extend(source.warnings());
            self.sources.pop_front();
        }
        Ok(!self.sources.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SliceSource;

    struct Moved<'a>(SliceSource<'a>, DVec3);

    impl SurfelSource for Moved<'_> {
        fn origin(&self) -> DVec3 {
            self.1
        }
        fn bounds(&self) -> Option<Aabb> {
            self.0.bounds()
        }
        fn count(&self) -> Option<u64> {
            self.0.count()
        }
        fn skipped(&self) -> u64 {
            3
        }
        fn left_out(&self) -> LeftOut {
            LeftOut { by_class: 2, withheld: 5, strays: 1 }
        }
        fn warnings(&self) -> Vec<String> {
            vec!["odd".into()]
        }
        fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
            self.0.read_chunk(out)
        }
    }

    fn read_all(source: &mut dyn SurfelSource) -> Vec<Surfel> {
        let mut out = Vec::new();
        while source.read_chunk(&mut out).unwrap() {}
        out
    }

    #[test]
    fn sources_share_the_first_origin() {
        let a = [Surfel::new(Vec3::new(1.0, 2.0, 3.0), Vec3::Z, 1.0, 1.0)];
        let b = vec![Surfel::new(Vec3::new(-1.0, 0.5, 0.0), Vec3::Z, 1.0, 1.0); 5000];
        let mut all = ConcatSource::new(vec![
            Box::new(Moved(SliceSource::new(&a), DVec3::splat(1e6))),
            Box::new(Moved(SliceSource::new(&[]), DVec3::ZERO)),
            Box::new(Moved(SliceSource::new(&b), DVec3::splat(1e6 + 10.0))),
        ]);
        assert_eq!(all.origin(), DVec3::splat(1e6));
        assert_eq!(all.count(), Some(5001));
        let bounds = Aabb { min: Vec3::new(1.0, 2.0, 3.0), max: Vec3::new(9.0, 10.5, 10.0) };
        assert_eq!(all.bounds(), Some(bounds));
        let surfels = read_all(&mut all);
        assert_eq!(surfels.len(), 5001);
        assert_eq!(surfels[0].position, [1.0, 2.0, 3.0]);
        assert_eq!(surfels[5000].position, [9.0, 10.5, 10.0]);
        assert_eq!(all.skipped(), 9);
        assert_eq!(all.left_out(), LeftOut { by_class: 6, withheld: 15, strays: 3 });
        assert_eq!(all.warnings(), ["odd"; 3]);
    }

    #[test]
    fn no_sources_are_an_empty_cloud() {
        let mut none = ConcatSource::new(Vec::new());
        assert_eq!(none.count(), Some(0));
        assert!(read_all(&mut none).is_empty());
    }
}
