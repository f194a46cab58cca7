//! Irradiance of surfels, also of those that stand out of others in part.

use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{PreparedLight, Receiver, Shading};
use pbgi_math::Vec3;
use pbgi_schedule::{ScheduleError, ShadeOptions, shade_receivers};
use pbgi_store::Octree;
use std::f32::consts::PI;

/// Share of the directions from which on a place that sees backs there first is inside of something solid: in the walls of a street, where things are that
/// stick in them, backs fill 0.6 to 0.7, and 0.03 a centimeter outside.
const BURIED: f32 = 0.5;

/// Cosine-weighted share of the hemisphere that is open from which on a place is not inside, whatever it sees: below a roof that has no ceiling, or under
/// trees that were scanned from above. Inside of the walls of a street 0.002 to 0.007 are, by the nodes of a bake.
const OPEN: f32 = 0.05;

/// Where buried surfels are looked at once more, as a share of the way from the center to their corners.
const TOWARD_CORNERS: f32 = 2.0 / 3.0;

/// Buried surfels that are looked at once more together.
const BURIED_CHUNK: usize = 4096;

/// What falls on a surfel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfelLight {
    /// W·m⁻².
    pub irradiance: [f32; 3],
    /// Whether it lies inside of something solid as a whole, so that nobody sees its light.
    pub is_buried: bool,
}

impl SurfelLight {
    /// A surfel, whose radiance is its emission, in this light: of the radiance emission + albedo/π · irradiance, within 0 and `bound`, and marked if it is
    /// buried.
    #[must_use]
    pub fn shine_on(&self, surfel: &Surfel, bound: f32) -> Surfel {
        let albedo = surfel.albedo_rgb();
        let radiance = std::array::from_fn(|c| {
            let lit = surfel.radiance[c] + albedo[c] / PI * self.irradiance[c];
            lit.max(0.0).min(bound)
        });
        let buried = if self.is_buried { SurfelFlags::BURIED } else { SurfelFlags::default() };
        surfel.with_radiance(radiance).with_flags(buried)
    }
}

/// What falls on surfels from those of an octree and an environment.
///
/// Irradiance is that at the surfel's center; of a surfel whose center lies inside of something solid, as that of a ledge half of which is in its wall, the mean
/// of what arrives toward its corners, of those that are outside: it is lit as the part of it is that stands out. Progress counts surfels, each once.
///
/// # Errors
///
/// If a surfel is not finite, the octree file fails, or on cancellation.
pub fn light_on_surfels(
    octree: &Octree,
    light: Option<&PreparedLight>,
    surfels: &[&Surfel],
    options: &ShadeOptions<'_>,
) -> Result<Vec<SurfelLight>, ScheduleError> {
    let mut options = *options;
    options.gather.finds_backs = true;
    let at = |surfel: &Surfel, place: Vec3| {
        let normal = if surfel.is_isotropic() { options.gather.up } else { surfel.normal() };
        Receiver::diffuse(place, normal)
    };
    let receivers: Vec<Receiver> = surfels.iter().map(|s| at(s, s.center())).collect();
    let centers = shade_receivers(octree, light, &receivers, &options)?.0;
    drop(receivers);
    let found =
        |shading: &Shading| SurfelLight { irradiance: shading.irradiance(), is_buried: false };
    let mut found: Vec<SurfelLight> = centers.iter().map(found).collect();
    // Points of clouds stand for no closed surface.
    let is_buried = |i: &usize| is_inside(&centers[*i]) && surfels[*i].tile().is_known();
    let buried: Vec<usize> = (0..surfels.len()).filter(is_buried).collect();
    options.progress = &|_| {};
    for chunk in buried.chunks(BURIED_CHUNK) {
        let mut receivers = Vec::new();
        let mut ends = Vec::with_capacity(chunk.len());
        for &i in chunk {
            receivers.extend(places(surfels[i]).into_iter().flatten().map(|p| at(surfels[i], p)));
            ends.push(receivers.len());
        }
        let shadings = shade_receivers(octree, light, &receivers, &options)?.0;
        let mut start = 0;
        for (&i, end) in chunk.iter().zip(ends) {
            match mean_outside(&shadings[start..end]) {
                Some(irradiance) => found[i].irradiance = irradiance,
                None => found[i].is_buried = true,
            }
            start = end;
        }
    }
    Ok(found)
}

/// Whether a place is inside of something solid.
fn is_inside(shading: &Shading) -> bool {
    shading.backs > BURIED && shading.ambient_occlusion < OPEN
}

/// Mean irradiance of the places outside; none without any.
fn mean_outside(places: &[Shading]) -> Option<[f32; 3]> {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for shading in places.iter().filter(|shading| !is_inside(shading)) {
        count += 1.0;
        for (sum, light) in sum.iter_mut().zip(shading.irradiance()) {
            *sum += light;
        }
    }
    (count > 0.0).then(|| sum.map(|c| c / count))
}

/// Places of a micropolygon between its center and its corners.
fn places(surfel: &Surfel) -> [Option<Vec3>; 4] {
    let at = |offset: Vec3| Some(surfel.center() + offset * TOWARD_CORNERS);
    match (surfel.corners(), surfel.half_edges()) {
        (Some([a, b, c]), _) => [at(a), at(b), at(c), None],
        (None, Some([u, v])) => [at(u + v), at(u - v), at(-u - v), at(v - u)],
        (None, None) => [None; 4],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_lie_on_the_surfel() {
        let disk = Surfel::new(Vec3::ONE, Vec3::Y, 2.0, 12.0);
        let rectangle = disk.with_tile(Vec3::X, 4.0);
        let triangle = disk.with_triangle(Vec3::X * 3.0, 0.3);
        for (surfel, count) in [(disk, 0), (rectangle, 4), (triangle, 3)] {
            let found: Vec<Vec3> = places(&surfel).into_iter().flatten().collect();
            assert_eq!(found.len(), count);
            if count == 0 {
                continue;
            }
            let mean = found.iter().sum::<Vec3>() / found.len() as f32;
            assert!(mean.distance(surfel.center()) < 1e-3, "{mean}");
            for place in found {
                let offset = place - surfel.center();
                assert!(offset.y.abs() < 1e-3 && offset.length() <= surfel.radius, "{offset}");
            }
        }
    }

    #[test]
    fn radiance_is_emission_and_reflected_light() {
        let surfel = Surfel::new(Vec3::ZERO, Vec3::Y, 1.0, 1.0)
            .with_radiance([1.0, 0.0, 0.0])
            .with_albedo([0.5, 0.25, 0.0]);
        let light = SurfelLight { irradiance: [PI, 2.0 * PI, 2.0 * PI], is_buried: false };
        let lit = light.shine_on(&surfel, 9.0).radiance;
        assert!((lit[0] - 1.5).abs() < 1e-6 && (lit[1] - 0.5).abs() < 1e-6 && lit[2] == 0.0);
        assert_eq!(light.shine_on(&surfel, 1.0).radiance[0], 1.0);
        let broken = SurfelLight { irradiance: [f32::NAN; 3], is_buried: true };
        let lit = broken.shine_on(&surfel, 9.0);
        assert!(lit.radiance.iter().all(|c| *c == 0.0));
        assert!(lit.flags.contains(SurfelFlags::BURIED) && lit.albedo == surfel.albedo);
        assert!(!light.shine_on(&surfel, 9.0).flags.contains(SurfelFlags::BURIED));
    }

    #[test]
    fn what_is_inside_does_not_count() {
        let shading = |light: f32, backs: f32, openness: f32| Shading {
            environment_irradiance: [light; 3],
            ambient_occlusion: openness,
            backs,
            ..Shading::default()
        };
        let places = [shading(3.0, 0.0, 0.0), shading(0.1, 0.7, 0.01), shading(1.0, 0.7, 0.3)];
        assert_eq!(mean_outside(&places), Some([2.0; 3]));
        assert_eq!(mean_outside(&places[1..2]), None);
    }
}
