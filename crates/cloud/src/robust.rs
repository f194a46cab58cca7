//! Where the mass of a cloud is, and points that stray from it.

use pbgi_math::DVec3;

/// Places that are kept to tell where the mass is, at most twice as many.
const SAMPLE: usize = 1 << 15;
/// Share of places at either end of an axis that do not count as the mass.
const TAIL: f64 = 0.005;
/// A place strays where it is farther from the mass than this many times its extent …
const STRAY_EXTENTS: f64 = 64.0;
/// … and where such places are at most this share of all.
const STRAY_SHARE_MAX: f64 = 1e-3;
/// An origin farther from the mass than this many times its extent costs digits.
const ORIGIN_EXTENTS: f64 = 128.0;

/// A sample of places, evenly over their order, and the number of all; the same for any way they are divided into calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct PlaceSample {
    places: Vec<DVec3>,
    /// Every how many places one is kept, less 1.
    skip: u64,
    seen: u64,
}

impl PlaceSample {
    /// Looks at a place; those that are not finite do not count.
    pub fn add(&mut self, place: DVec3) {
        if !place.is_finite() {
            return;
        }
        if self.seen.is_multiple_of(self.skip + 1) {
            self.places.push(place);
            if self.places.len() == 2 * SAMPLE {
                let mut index = 0;
                self.places.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.skip = 2 * self.skip + 1;
            }
        }
        self.seen += 1;
    }

    /// The mass: median and extent of the places without those at the ends of each axis; `None` if there are none.
    pub fn mass(&self) -> Option<Mass> {
        if self.places.is_empty() {
            return None;
        }
        let last = self.places.len() - 1;
        let tail = ((last as f64 * TAIL).ceil() as usize).min(last / 2);
        let (mut min, mut median, mut max) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for axis in 0..3 {
            let mut values: Vec<f64> = self.places.iter().map(|p| p[axis]).collect();
            values.sort_unstable_by(f64::total_cmp);
            (min[axis], median[axis], max[axis]) =
                (values[tail], values[last / 2], values[last - tail]);
        }
        Some(Mass { min, median, max })
    }
}

/// Where most places are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Mass {
    min: DVec3,
    pub median: DVec3,
    max: DVec3,
}

impl Mass {
    /// Longest edge of its box.
    pub fn extent(&self) -> f64 {
        (self.max - self.min).max_element()
    }

    /// `preferred`, or where that is so far from the mass that numbers relative to it lose digits, the median, rounded.
    pub fn choose_origin(&self, preferred: DVec3) -> DVec3 {
        let distance = (preferred - self.median).abs().max_element();
        match distance <= ORIGIN_EXTENTS * self.extent().max(1.0) {
            true => preferred,
            false => self.median.round(),
        }
    }

    /// Box beyond which places stray: its least and its greatest corner.
    pub fn limits(&self) -> [DVec3; 2] {
        let margin = DVec3::splat(STRAY_EXTENTS * self.extent());
        [self.min - margin, self.max + margin]
    }

    /// Whether `count` of `total` places beyond the limits are few enough to stray.
    pub fn are_strays(&self, count: u64, total: u64) -> bool {
        self.extent() > 0.0
            && count > 0
            && count as f64 <= STRAY_SHARE_MAX * total as f64 + 1.0
            && total > 100
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(count: u32, shift: f64) -> impl Iterator<Item = DVec3> {
        (0..count).map(move |i| {
            DVec3::new(f64::from(i % 100) * 0.1 + shift, f64::from(i / 100) * 0.1, 5.0)
        })
    }

    #[test]
    fn strays_do_not_move_the_mass() {
        let mut sample = PlaceSample::default();
        sample.add(DVec3::ZERO);
        grid(10_000, 6e5).for_each(|p| sample.add(p));
        let mass = sample.mass().unwrap();
        assert!((mass.median.x - 600_005.0).abs() < 0.2 && mass.extent() < 10.0, "{mass:?}");
        let [min, max] = mass.limits();
        assert!(min.x > 5e5 && max.x < 7e5);
        assert!(mass.are_strays(1, 10_001) && !mass.are_strays(200, 10_001));
        assert_eq!(mass.choose_origin(DVec3::ZERO), DVec3::new(600_005.0, 5.0, 5.0));
        let near = DVec3::new(599_900.0, 7.0, 0.0);
        assert_eq!(mass.choose_origin(near), near);
    }

    #[test]
    fn samples_are_bounded_and_even() {
        let mut sample = PlaceSample::default();
        grid(300_000, 0.0).for_each(|p| sample.add(p));
        sample.add(DVec3::NAN);
        assert!(sample.places.len() < 2 * SAMPLE && sample.places.len() >= SAMPLE);
        assert_eq!((sample.seen, sample.skip), (300_000, 7));
        let mass = sample.mass().unwrap();
        assert!((mass.median.y - 150.0).abs() < 1.0, "{mass:?}");
        assert!(PlaceSample::default().mass().is_none());
    }
}
