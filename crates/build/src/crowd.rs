//! How much the loose surfels of a node hide of each other.

use crate::lobe_sum::lobe_area;
use pbgi_cloud::Surfel;
use pbgi_math::{Aabb, DVec3, thick_half};
use std::f64::consts::PI;

/// Loose surfels, and what they hide of each other, on the mean over all directions.
///
/// From a surfel, another that shows the area *b* at the distance *r* takes the share *b*/(4π*r*²) of all directions, and hides it from there. So, to the first
/// order, Σ *a* *b*/(4π*r*²) over all ordered pairs is hidden of the area Σ *a* that all show, whatever their number and however they lie. Sums of parts are exact but for
/// pairs of which each is in another part: of these the mean of 1/*r*² follows from the parts' places and variances, to the second order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Crowd {
    /// Σ *a*: areas that they show, on the mean over all directions.
    shown: f64,
    /// Σ *a* **x** / Σ *a*.
    place: DVec3,
    /// Mean variance of places along an axis.
    variance: f64,
    /// Area that is hidden.
    hidden: f64,
}

/// Share of all directions that what shows this area takes at a distance; `more` is added to 1 for how it and who sees it are spread.
fn share(area: f64, distance2: f64, more: f64) -> f64 {
    (area * (1.0 + more) / (4.0 * PI * distance2.max(f64::MIN_POSITIVE))).min(1.0)
}

impl Crowd {
    fn of_surfel(surfel: &Surfel) -> Self {
        let sides = if surfel.is_isotropic() || surfel.is_front_only() { 1.0 } else { 2.0 };
        let (shown, place) = (0.25 * sides * lobe_area(surfel), surfel.center().as_dvec3());
        Self { shown, place, variance: 0.0, hidden: 0.0 }
    }

    /// Of a leaf's surfels those that are loose, if there are any.
    pub fn of_surfels(surfels: &[Surfel], loose: &[bool]) -> Option<Self> {
        let of_loose = surfels.iter().zip(loose).filter(|(_, loose)| **loose);
        let parts: Vec<Self> = of_loose.map(|(surfel, _)| Self::of_surfel(surfel)).collect();
        Self::of_parts(parts.iter())
    }

    /// All of a node's parts together, if there are any.
    pub fn of_parts<'s>(parts: impl Iterator<Item = &'s Self> + Clone) -> Option<Self> {
        let shown: f64 = parts.clone().map(|part| part.shown).sum();
        if shown == 0.0 {
            return None;
        }
        let place = parts.clone().map(|part| part.place * (part.shown / shown)).sum();
        let mut sum = Self { shown, place, ..Self::default() };
        for (before, part) in parts.clone().enumerate() {
            for other in parts.clone().take(before) {
                sum.hidden += part.hidden_with(other);
            }
            let apart = (part.place - place).length_squared() * (1.0 / 3.0);
            sum.variance += (part.variance + apart) * (part.shown / shown);
            sum.hidden += part.hidden;
        }
        Some(sum)
    }

    /// Area that two parts hide of each other.
    fn hidden_with(&self, other: &Self) -> f64 {
        let distance2 = (self.place - other.place).length_squared();
        // 1/r² has the Laplacian 2/r⁴. Parts that reach into each other are near as well.
        let more = (self.variance + other.variance) / distance2.max(f64::MIN_POSITIVE);
        let more = more.min(1.0);
        self.shown * share(other.shown, distance2, more)
            + other.shown * share(self.shown, distance2, more)
    }

    /// The clumping index of a node with this box: with Ωτ, where the box's silhouette, on the mean over all directions, has 1/τ of the area that all show, the share
    /// (1 − e^(−Ωτ))/Ωτ ≈ 1 − ½ Ωτ of it is not hidden.
    pub fn clumping(&self, bounds: &Aabb) -> f32 {
        let half = thick_half(bounds.min, bounds.max).as_dvec3();
        // A quarter of the box's surface.
        let silhouette = 2.0 * (half.x * half.y + half.y * half.z + half.z * half.x);
        (2.0 * self.hidden / self.shown * (silhouette / self.shown)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::SurfelFlags;
    use pbgi_math::Vec3;

    /// Particles of radius `radius` evenly in the unit cube, by the additive recurrence of the plastic number's powers.
    fn cube(count: usize, radius: f32) -> Vec<Surfel> {
        let part = |i: usize, step: f64| (0.5 + step * i as f64).fract() as f32;
        let place = |i| Vec3::new(part(i, 0.819_172_5), part(i, 0.671_043_6), part(i, 0.549_700_5));
        let area = 2.0 * std::f32::consts::PI * radius * radius;
        let particle = |i| Surfel::new(place(i), Vec3::Y, radius, area);
        (0..count).map(|i| particle(i).with_flags(SurfelFlags::ISOTROPIC)).collect()
    }

    fn of(surfels: &[Surfel]) -> Crowd {
        Crowd::of_surfels(surfels, &vec![true; surfels.len()]).unwrap()
    }

    #[test]
    fn a_particle_alone_hides_nothing_of_itself() {
        let one = of(&cube(1, 0.1));
        assert_eq!(
            (one.hidden, one.clumping(&Aabb { min: Vec3::ZERO, max: Vec3::ONE })),
            (0.0, 0.0)
        );
        assert_eq!(Crowd::of_surfels(&cube(2, 0.1), &[false; 2]), None);
    }

    #[test]
    fn two_hide_their_shares_of_all_directions_from_each_other() {
        let at = |x: f32, radius: f32| {
            let area = 2.0 * std::f32::consts::PI * radius * radius;
            Surfel::new(Vec3::X * x, Vec3::Y, radius, area).with_flags(SurfelFlags::ISOTROPIC)
        };
        let two = of(&[at(0.0, 0.1), at(2.0, 0.2)]);
        // Each shows its disk; twice a b / (4π r²).
        let [a, b] = [0.01 * PI, 0.04 * PI];
        assert!((two.hidden / (2.0 * a * b / (16.0 * PI)) - 1.0).abs() < 1e-5, "{two:?}");
        assert!((two.shown / (a + b) - 1.0).abs() < 1e-6);
    }

    /// Parts of parts, in cells of a cube, hide what all pairs do.
    #[test]
    fn parts_hide_what_all_of_their_surfels_do() {
        let surfels = cube(2000, 0.003);
        let exact = of(&surfels);
        let mut nodes: Vec<(Vec3, Crowd)> =
            surfels.iter().map(|s| (s.center(), Crowd::of_surfel(s))).collect();
        for cells in [8.0f32, 4.0, 2.0, 1.0] {
            let key = |place: &Vec3| {
                (*place * cells).floor().min(Vec3::splat(cells - 1.0)).to_array().map(|x| x as u32)
            };
            nodes.sort_by_key(|(place, _)| key(place));
            let groups = nodes.chunk_by(|a, b| key(&a.0) == key(&b.0));
            let sum = |group: &[(Vec3, Crowd)]| {
                (group[0].0, Crowd::of_parts(group.iter().map(|part| &part.1)).unwrap())
            };
            nodes = groups.map(sum).collect();
        }
        let [(_, whole)] = nodes[..] else { panic!("one cube") };
        let relative = whole.hidden / exact.hidden;
        assert!((relative - 1.0).abs() < 0.04, "{relative}");
    }
}
