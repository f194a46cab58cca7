//! Neighbors on one surface that share what is gathered for one of them.
//!
//! Light that falls on surfels is only ever seen from afar, in clusters: few gathers per surface
//! piece suffice. Groups follow from the sorted order alone, never from how it is chunked.

use pbgi_cloud::Surfel;
use pbgi_math::{MORTON_AXIS_BITS, MortonCode, Vec3};

/// Cosine between normals above which surfels may lie on one surface.
const SAME_SURFACE_COSINE: f32 = 0.8;

/// How far from a common plane surfels of one surface may lie, in radii per square root of how many may share: half the
/// extent of as many surfels side by side.
const SAME_PLANE_RADII: f32 = 0.5;

/// The surfels gathered for, and who shares with whom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shared {
    /// Surfels to gather for.
    pub chosen: Vec<u32>,
    /// For each surfel the place of its own in `chosen`.
    pub place: Vec<u32>,
}

/// How many of `ahead`'s first surfels are in one cell of an octree with at most `most` surfels per
/// leaf. `ahead` is not empty and holds more than `most` surfels, or all that are left; `previous`
/// is the code of the surfel before them.
pub fn cell_len(
    ahead: &[(MortonCode, Surfel)],
    previous: Option<MortonCode>,
    most: usize,
) -> usize {
    let code = ahead[0].0;
    // Larger cells began before this surfel.
    let levels = 0..=MORTON_AXIS_BITS;
    let fits = |level: &u32| {
        let cell = code.cell_at(*level);
        previous.is_none_or(|p| p.cell_at(*level) != cell)
            && ahead.get(most).is_none_or(|s| s.0.cell_at(*level) != cell)
    };
    let level = levels.into_iter().find(fits);
    let inside = |s: &&(MortonCode, Surfel)| {
        // More surfels at one place than fit are cut where the room ends.
        level.is_none_or(|level| s.0.cell_at(level) == code.cell_at(level))
    };
    ahead.iter().take(most).take_while(inside).count()
}

impl Shared {
    /// Surfels at both ends of the groups that are asked for again, by their places in `chosen`: the first and the last of each that was not gathered
    /// for, with the group's place.
    pub fn ends(&self, is_asked_again: impl Fn(usize) -> bool) -> Vec<(u32, u32)> {
        let mut ends = vec![[None; 2]; self.chosen.len()];
        for (surfel, &place) in self.place.iter().enumerate() {
            let (surfel, group) = (surfel as u32, place as usize);
            if self.chosen[group] != surfel && is_asked_again(group) {
                ends[group][0].get_or_insert(surfel);
                ends[group][1] = Some(surfel);
            }
        }
        let mut found = Vec::new();
        for (group, [first, last]) in ends.into_iter().enumerate() {
            found.extend(first.map(|surfel| (group as u32, surfel)));
            found.extend(last.filter(|_| first != last).map(|surfel| (group as u32, surfel)));
        }
        found
    }

    /// Adds the surfels of one cell: those on one surface share the gather of the one nearest to
    /// their middle.
    ///
    /// `most` is how many may share.
    pub fn add_cell(&mut self, cell: &[(MortonCode, Surfel)], most: usize) {
        let radii = (SAME_PLANE_RADII * (most as f32).sqrt()).max(1.0);
        let first = self.place.len() as u32;
        const NONE: u32 = u32::MAX;
        self.place.resize(self.place.len() + cell.len(), NONE);
        for leader in 0..cell.len() {
            if self.place[first as usize + leader] != NONE {
                continue;
            }
            let is_member = |&i: &usize| {
                self.place[first as usize + i] == NONE
                    && are_on_one_surface(&cell[leader].1, &cell[i].1, radii)
            };
            let members: Vec<usize> = (leader..cell.len()).filter(is_member).collect();
            let place = self.chosen.len() as u32;
            self.chosen.push(first + middle_of(cell, &members) as u32);
            for i in members {
                self.place[first as usize + i] = place;
            }
        }
    }
}

/// Whether both face the same way and lie in one plane, give or take so many radii. A surfel is on one
/// surface with itself.
fn are_on_one_surface(a: &Surfel, b: &Surfel, radii: f32) -> bool {
    if a.flags != b.flags {
        return false;
    }
    let offset = b.center() - a.center();
    if a.is_isotropic() {
        return true;
    }
    let normal = a.normal();
    offset.dot(normal).abs() <= radii * a.radius && normal.dot(b.normal()) >= SAME_SURFACE_COSINE
        || offset == Vec3::ZERO && a.orientation == b.orientation
}

/// The member nearest to the mean of all; the first of equals.
fn middle_of(cell: &[(MortonCode, Surfel)], members: &[usize]) -> usize {
    let sum: Vec3 = members.iter().map(|&i| cell[i].1.center()).sum();
    let mean = sum / members.len().max(1) as f32;
    let distance = |i: &usize| cell[*i].1.center().distance_squared(mean);
    let nearest = members.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    nearest.copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::{Aabb, RootCube};

    fn coded(surfels: Vec<Surfel>) -> Vec<(MortonCode, Surfel)> {
        let root = RootCube::from_bounds(&Aabb::from_points(surfels.iter().map(Surfel::center)));
        let mut coded: Vec<_> = surfels.iter().map(|s| (root.code(s.center()), *s)).collect();
        coded.sort_by_key(|s| s.0);
        coded
    }

    fn plane(edge: usize) -> Vec<Surfel> {
        let at = |i: usize| Vec3::new((i % edge) as f32, 0.0, (i / edge) as f32);
        (0..edge * edge).map(|i| Surfel::new(at(i), Vec3::Y, 0.7, 1.0)).collect()
    }

    fn cells(surfels: &[(MortonCode, Surfel)], most: usize) -> Vec<usize> {
        let (mut start, mut lengths) = (0, Vec::new());
        while start < surfels.len() {
            let previous = start.checked_sub(1).map(|i| surfels[i].0);
            lengths.push(cell_len(&surfels[start..], previous, most));
            start += lengths.last().unwrap();
        }
        lengths
    }

    #[test]
    fn cells_hold_at_most_as_many_as_asked() {
        let surfels = coded(plane(32));
        assert_eq!(cells(&surfels, 1), vec![1; 1024]);
        for most in [4, 7, 16, 100] {
            let lengths = cells(&surfels, most);
            assert!(lengths.iter().all(|&len| (1..=most).contains(&len)));
            assert!(lengths.len() * most < 1024 * 5, "{most}: {}", lengths.len());
            // No more is looked at than the surfels asked for and one.
            let window = &surfels[..=most];
            assert_eq!(cell_len(window, None, most), lengths[0]);
        }
    }

    #[test]
    fn ends_are_those_that_were_not_chosen() {
        let shared = Shared { chosen: vec![1, 4, 5], place: vec![0, 0, 0, 0, 1, 2, 2] };
        assert_eq!(shared.ends(|group| group != 1), [(0, 0), (0, 3), (2, 6)]);
        assert!(shared.ends(|group| group == 1).is_empty());
    }

    #[test]
    fn many_at_one_place_are_cut() {
        let surfels = coded(vec![Surfel::new(Vec3::ONE, Vec3::Y, 1.0, 1.0); 10]);
        assert_eq!(cells(&surfels, 4), [4, 4, 2]);
    }

    #[test]
    fn only_one_surface_shares() {
        let mut surfels = plane(4);
        // A parallel floor above, and the back of the first.
        surfels.extend(
            plane(4).iter().map(|s| Surfel::new(s.center() + Vec3::Y * 2.0, Vec3::Y, 0.7, 1.0)),
        );
        surfels.extend(plane(4).iter().map(|s| Surfel::new(s.center(), Vec3::NEG_Y, 0.7, 1.0)));
        let surfels = coded(surfels);
        let mut shared = Shared::default();
        shared.add_cell(&surfels, 4);
        assert_eq!(shared.chosen.len(), 3);
        for (i, place) in shared.place.iter().enumerate() {
            let (own, other) = (&surfels[i].1, &surfels[shared.chosen[*place as usize] as usize].1);
            assert_eq!(own.orientation, other.orientation);
            assert_eq!(own.position[1], other.position[1]);
            // The middle of four by four.
            assert!(other.position[0] == 1.0 || other.position[0] == 2.0);
        }
    }
}
