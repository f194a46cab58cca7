//! Polygons as triangles.

use earcut::Earcut;
use pbgi_math::{DVec2, DVec3, Vec3};

/// Most corners of a polygon that is cut by ears, which may take the square of their number.
const EARCUT_CORNERS_MAX: usize = 1 << 14;

/// How far the triangles' area may be off from that of the outline, as a share of it.
const AREA_TOLERANCE: f64 = 1e-3;

/// Cuts polygons into triangles, and counts those whose outline is none.
#[derive(Default)]
pub(crate) struct Triangulator {
    earcut: Earcut<f64>,
    /// Corners in the polygon's plane, and triangles of them.
    flat: Vec<DVec2>,
    cut: Vec<u32>,
    /// Polygons that cross themselves.
    crossing_count: u64,
    /// Polygons of too many corners.
    large_count: u64,
}

impl Triangulator {
    /// Calls `push` with the corners of each triangle, which turn as the polygon does: a fan where all of the polygon is seen from
    /// its first corner, else what is cut off by ears in the polygon's plane.
    pub fn triangulate(&mut self, corners: &[Vec3], mut push: impl FnMut([usize; 3])) {
        let fan = |push: &mut dyn FnMut([usize; 3])| {
            (2..corners.len()).for_each(|k| push([0, k - 1, k]));
        };
        if corners.len() < 4 || !self.flatten(corners) || is_star(&self.flat) {
            return fan(&mut push);
        }
        if corners.len() > EARCUT_CORNERS_MAX {
            self.large_count += 1;
            return fan(&mut push);
        }
        self.cut.clear();
        self.earcut.earcut(self.flat.iter().map(|p| p.to_array()), &[], &mut self.cut);
        let flat = &self.flat;
        let area: f64 = (1..flat.len() - 1).map(|k| doubled_area(flat, [0, k, k + 1])).sum();
        let mut covered = 0.0;
        for triangle in self.cut.chunks_exact(3) {
            let [a, b, c] = [triangle[0], triangle[1], triangle[2]].map(|v| v as usize);
            let own = doubled_area(flat, [a, b, c]);
            covered += own.abs();
            push(if own < 0.0 { [a, c, b] } else { [a, b, c] });
        }
        self.crossing_count += u64::from((covered - area).abs() > AREA_TOLERANCE * area);
    }

    /// One sentence for each kind of polygon that was not read as it is meant.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.crossing_count > 0 {
            let count = self.crossing_count;
            warnings.push(format!(
                "{count} polygons cross themselves; which parts of them are inside is a guess"
            ));
        }
        if self.large_count > 0 {
            let count = self.large_count;
            warnings.push(format!(
                "{count} polygons of more than {EARCUT_CORNERS_MAX} corners are not convex; they are read as fans of \
                 triangles, which cover too much: triangulate them before"
            ));
        }
        warnings
    }

    /// Lays the corners into their plane, seen from the side from which they turn counterclockwise; `false` if they have none.
    fn flatten(&mut self, corners: &[Vec3]) -> bool {
        let first = corners[0].as_dvec3();
        let edge = |k: usize| corners[k].as_dvec3() - first;
        // The sum of the fan's triangles is the area vector of the outline, whatever the fan covers.
        let normal: DVec3 = (2..corners.len()).map(|k| edge(k - 1).cross(edge(k))).sum();
        let Some(normal) = normal.try_normalize() else { return false };
        let (u, v) = normal.any_orthonormal_pair();
        let (u, v) = if u.cross(v).dot(normal) < 0.0 { (v, u) } else { (u, v) };
        self.flat.clear();
        self.flat.extend((0..corners.len()).map(|k| DVec2::new(edge(k).dot(u), edge(k).dot(v))));
        true
    }
}

/// Whether no triangle of the fan from the first corner turns over: it then covers the outline, once if that is turned
/// around once.
fn is_star(flat: &[DVec2]) -> bool {
    (2..flat.len()).all(|k| doubled_area(flat, [0, k - 1, k]) >= 0.0)
        && (2..flat.len()).map(|k| turn(flat, k)).sum::<f64>() < std::f64::consts::TAU
}

/// Angle at the first corner between two that follow each other.
fn turn(flat: &[DVec2], k: usize) -> f64 {
    let (a, b) = (flat[k - 1] - flat[0], flat[k] - flat[0]);
    a.perp_dot(b).atan2(a.dot(b)).abs()
}

fn doubled_area(flat: &[DVec2], [a, b, c]: [usize; 3]) -> f64 {
    (flat[b] - flat[a]).perp_dot(flat[c] - flat[a])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles, their area, and the area vector's direction, of a polygon.
    fn cut(corners: &[Vec3]) -> (Vec<[usize; 3]>, f32, Vec<String>) {
        let mut triangulator = Triangulator::default();
        let mut triangles = Vec::new();
        triangulator.triangulate(corners, |t| triangles.push(t));
        let vector = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|v| corners[v]);
            (b - a).cross(c - a) * 0.5
        };
        let whole: Vec3 = triangles.iter().map(vector).sum();
        let area = triangles.iter().map(|t| vector(t).length()).sum::<f32>();
        let facing = triangles.iter().all(|t| vector(t).dot(whole) >= 0.0);
        assert!(facing || !triangulator.warnings().is_empty(), "{triangles:?}");
        (triangles, area, triangulator.warnings())
    }

    /// Corners given by x and z, in a tilted plane, far from the origin.
    fn tilted(corners: &[[f32; 2]]) -> Vec<Vec3> {
        let (u, v) = (Vec3::new(0.6, 0.8, 0.0), Vec3::new(0.0, 0.0, 1.0));
        corners.iter().map(|[x, z]| Vec3::new(50.0, -20.0, 7.0) + u * *x + v * *z).collect()
    }

    const L: [[f32; 2]; 6] = [[1., 1.], [2., 1.], [2., 0.], [0., 0.], [0., 2.], [1., 2.]];
    const ARROW: [[f32; 2]; 4] = [[0., 1.], [-2., -1.], [0., 0.], [2., -1.]];
    const COMB: [[f32; 2]; 8] =
        [[0., 0.], [5., 0.], [5., 3.], [4., 3.], [4., 1.], [1., 1.], [1., 3.], [0., 3.]];

    #[test]
    fn concave_polygons_are_covered_once() {
        for (outline, area) in [(&L[..], 3.0), (&ARROW[..], 2.0), (&COMB[..], 9.0)] {
            for start in 0..outline.len() {
                for flip in [false, true] {
                    let mut corners = outline.to_vec();
                    corners.rotate_left(start);
                    if flip {
                        corners.reverse();
                    }
                    let (triangles, found, warnings) = cut(&tilted(&corners));
                    assert!((found - area).abs() < 1e-4, "{corners:?}: {found}");
                    assert_eq!((triangles.len(), warnings.len()), (outline.len() - 2, 0));
                }
            }
        }
    }

    #[test]
    fn triangles_turn_as_their_polygon_does() {
        let corners: Vec<Vec3> = L.iter().map(|[x, z]| Vec3::new(*x, 0.0, *z)).collect();
        for reversed in [false, true] {
            let corners: Vec<Vec3> = match reversed {
                true => corners.iter().rev().copied().collect(),
                false => corners.clone(),
            };
            let mut up = Vec::new();
            Triangulator::default().triangulate(&corners, |[a, b, c]| {
                let [a, b, c] = [a, b, c].map(|v| corners[v]);
                up.push((b - a).cross(c - a).y > 0.0);
            });
            assert!(up.iter().all(|u| *u != reversed), "{up:?}");
        }
    }

    #[test]
    fn convex_polygons_stay_fans() {
        let octagon: Vec<Vec3> = (0..8)
            .map(|k| (k as f32 * std::f32::consts::FRAC_PI_4).sin_cos())
            .map(|(s, c)| Vec3::new(c, s, 0.3))
            .collect();
        let (triangles, ..) = cut(&octagon);
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 6], [0, 6, 7]]);
    }

    #[test]
    fn outlines_that_cross_themselves_are_counted() {
        let bow = [[0., 0.], [3., 2.], [3., 0.], [0., 2.], [-1., 1.]];
        let (_, _, warnings) = cut(&tilted(&bow));
        assert_eq!(warnings.len(), 1, "{warnings:?}");
    }

    #[test]
    fn degenerate_polygons_are_survived() {
        for corners in [
            vec![Vec3::ZERO; 7],
            vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::X],
            vec![Vec3::splat(1e30), Vec3::X, Vec3::splat(-1e30), Vec3::Y * 1e30, Vec3::Z],
            vec![Vec3::ZERO, Vec3::X, Vec3::X, Vec3::ONE, Vec3::Y, Vec3::ZERO],
        ] {
            let (triangles, area, _) = cut(&corners);
            assert!(area.is_finite() || corners[0].x > 1e20, "{triangles:?}");
        }
        let many: Vec<Vec3> =
            (0..40_000).map(|k| Vec3::new((k % 200) as f32, (k / 200) as f32, 0.0)).collect();
        let _ = cut(&many);
    }
}
