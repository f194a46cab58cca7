//! Which surfels of a leaf make no surface.

use pbgi_cloud::Surfel;
use pbgi_math::Vec3;

/// Surfels with fewer neighbors than this are loose. The last of a row has one. That makes 2.5 and 5 % of the surfels of the street and the foliage
/// loose, and 99 and 94 % of a crowd of a million disks of optical depth 1 and 3. With twice as many it would be 11 and 15, 100 and 100 %.
const NEIGHBORS: usize = 1;

/// Distance up to which a surfel is a neighbor, over the sum of both covering radii. The nearest of a square lattice whose disks have the area of its
/// cells are 0.89 of it apart; of dicing, whose disks reach to the corners of theirs, those at a corner 1 and those behind the next one 1.4. Half of
/// it: 28 and 18, 100 and 99 %; twice: 1 and 3, 92 and 70 %.
const REACH: f32 = 1.1;

/// Least cosine between the normals of neighbors: those of a box meet at right angles, if not to the last digit. 60°: 7 and 8, 99 and 97 %.
const COSINE: f32 = -0.1;

/// Largest height of each of two neighbors over the other's plane, as a share of that distance: as much as those at an edge of a box have. Half of it:
/// 6 and 8, 99 and 98 %; twice: 2 and 4, 97 and 89 %.
const HEIGHT: f32 = 0.5;

/// What is asked of a surfel again and again.
#[derive(Clone, Copy, Debug)]
struct Place {
    center: Vec3,
    normal: Vec3,
    radius: f32,
    neighbors: usize,
}

/// Finds the loose surfels of a leaf, in memory that is used again for the next one.
#[derive(Debug, Default)]
pub(crate) struct LooseFinder {
    places: Vec<Place>,
}

impl LooseFinder {
    /// Tells of each surfel whether it is loose: a particle, or one with too few neighbors. Of a leaf of few surfels all others suffice,
    /// as the rest of their surface lies in other leaves.
    pub fn find(&mut self, surfels: &[Surfel], loose: &mut Vec<bool>) {
        self.places.clear();
        self.places.extend(surfels.iter().map(|surfel| Place {
            center: surfel.center(),
            normal: surfel.normal(),
            radius: surfel.radius,
            neighbors: 0,
        }));
        let mut rest = &mut self.places[..];
        while let Some((own, others)) = rest.split_first_mut() {
            for other in others.iter_mut() {
                if are_neighbors(own, other) {
                    own.neighbors += 1;
                    other.neighbors += 1;
                }
            }
            rest = others;
        }
        let wanted = NEIGHBORS.min(surfels.len().saturating_sub(1));
        let is_loose =
            |(surfel, place): (&Surfel, &Place)| surfel.is_isotropic() || place.neighbors < wanted;
        loose.clear();
        loose.extend(surfels.iter().zip(&self.places).map(is_loose));
    }
}

/// Whether one surfel goes on the other's surface.
#[inline]
fn are_neighbors(own: &Place, other: &Place) -> bool {
    let apart = other.center - own.center;
    let reach = REACH * (own.radius + other.radius);
    apart.length_squared() <= reach * reach
        && own.normal.dot(other.normal) >= COSINE
        && own.normal.dot(apart).abs() <= HEIGHT * reach
        && other.normal.dot(apart).abs() <= HEIGHT * reach
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::SurfelFlags;

    fn count_loose(surfels: &[Surfel]) -> usize {
        let mut loose = Vec::new();
        LooseFinder::default().find(surfels, &mut loose);
        assert_eq!(loose.len(), surfels.len());
        loose.into_iter().filter(|loose| *loose).count()
    }

    /// Disks of a sheet, each of the area of its cell.
    fn sheet(columns: usize, rows: usize, bend: f32) -> Vec<Surfel> {
        let at = |k: usize| (k % columns, k / columns);
        let disk = |(i, j): (usize, usize)| {
            let (sin, cos) = (bend * i as f32).sin_cos();
            let place = match bend {
                0.0 => Vec3::new(i as f32, 0.0, j as f32),
                _ => Vec3::new(sin / bend, cos / bend, j as f32),
            };
            Surfel::new(place, Vec3::new(sin, cos, 0.0), 0.5642, 1.0)
        };
        (0..columns * rows).map(at).map(disk).collect()
    }

    #[test]
    fn surfaces_are_not_loose_wherever_their_leaf_ends() {
        for (columns, rows) in [(5, 5), (2, 2), (1, 1), (2, 1), (16, 2)] {
            for bend in [0.0, 0.3, 0.8] {
                assert_eq!(
                    count_loose(&sheet(columns, rows, bend)),
                    0,
                    "{columns} × {rows}, {bend}"
                );
            }
        }
    }

    #[test]
    fn surfaces_are_not_loose_at_the_edges_of_a_box() {
        let box_of_six: Vec<Surfel> = Vec3::AXES
            .into_iter()
            .flat_map(|axis| [axis, -axis])
            .map(|normal| Surfel::new(normal * 0.5, normal, 0.5642, 1.0))
            .collect();
        assert_eq!(count_loose(&box_of_six), 0);
        // A card of two sides is no surface that goes on.
        assert_eq!(count_loose(&box_of_six[..2]), 2);
    }

    #[test]
    fn disks_anywhere_are_loose() {
        // The dark squares of a chessboard, and disks far above each other.
        let sparse: Vec<Surfel> = sheet(7, 7, 0.0).into_iter().step_by(2).collect();
        assert_eq!(count_loose(&sparse), 25);
        let mut above = sheet(4, 1, 0.0);
        for (k, surfel) in above.iter_mut().enumerate() {
            surfel.position[1] = 3.0 * k as f32;
        }
        assert_eq!(count_loose(&above), 4);
        // Turned away from each other.
        let mut turned = sheet(3, 1, 0.0);
        turned[1] = Surfel::new(turned[1].center(), Vec3::X, 0.5642, 1.0);
        assert_eq!(count_loose(&turned), 3);
    }

    #[test]
    fn particles_are_loose() {
        let smoke: Vec<Surfel> = sheet(4, 4, 0.0)
            .into_iter()
            .map(|surfel| surfel.with_flags(SurfelFlags::ISOTROPIC))
            .collect();
        assert_eq!(count_loose(&smoke), 16);
        assert_eq!(count_loose(&smoke[..1]), 1);
    }
}
