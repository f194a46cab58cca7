//! Closed forms and the ray-cast oracle.

use crate::support::bake_and_open;
use pbgi_build::BuildOptions;
use pbgi_math::Vec3;
use pbgi_schedule::{GatherSettings, Gatherer, Receiver};
use pbgi_store::Octree;
use pbgi_testkit::{closed_room, random_soup, ray_cast_gather};
use std::f32::consts::{FRAC_1_PI, PI};

fn gather(
    octree: &Octree,
    settings: &GatherSettings,
    receiver: Receiver,
) -> pbgi_schedule::Shading {
    Gatherer::new(octree.reader(), settings, None).gather(&receiver).unwrap()
}

/// A closed room of uniform radiance L gives E = πL at every place and orientation, however
/// coarse the cut. What is missing is the leak between the footprints of neighboring clusters.
#[test]
fn a_uniform_closed_room_gives_pi_times_its_radiance() {
    let half = Vec3::new(2.0, 1.3, 1.7);
    let surfels = closed_room(half, 40, 2.0);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for (solid_angle_sr, tolerance) in [(0.3, 0.02), (0.03, 0.01), (0.0, 0.005)] {
        let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
        for (i, normal) in pbgi_testkit::sphere_directions(40).enumerate() {
            let f = |k: usize| ((i * k) % 37) as f32 / 37.0 * 1.8 - 0.9;
            let position = half * Vec3::new(f(5), f(11), f(17));
            let found = gather(&octree, &settings, Receiver { position, normal });
            let relative = found.surface_irradiance[0] / (2.0 * PI);
            assert!((relative - 1.0).abs() < tolerance, "{solid_angle_sr} {position}: {relative}");
            assert!(found.ambient_occlusion < tolerance, "{}", found.ambient_occlusion);
        }
    }
}

/// Receivers on the walls themselves see the room, not their own wall.
#[test]
fn receivers_on_the_walls_of_a_closed_room_see_all_of_it() {
    let half = Vec3::new(2.0, 1.3, 1.7);
    let surfels = closed_room(half, 40, 1.0);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for solid_angle_sr in [0.1, 0.01] {
        let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
        for (i, surfel) in surfels.iter().enumerate().step_by(97) {
            // Not at the surfels' centers only.
            let slide = surfel.normal().any_orthonormal_vector() * 0.3 * surfel.radius;
            let offset = if i % 2 == 0 { Vec3::ZERO } else { slide };
            let receiver = Receiver { position: surfel.center() + offset, normal: surfel.normal() };
            let found = gather(&octree, &settings, receiver);
            let relative = found.surface_irradiance[0] / PI;
            assert!((relative - 1.0).abs() < 0.02, "{solid_angle_sr} {receiver:?}: {relative}");
        }
    }
}

/// With nothing to hide it, every surfel of a random soup is found; with a zero threshold the gather is that of rays against the
/// disks, up to the raster's resolution and the order within a texel.
#[test]
fn a_zero_threshold_matches_rays_against_all_disks() {
    let surfels = random_soup(600, 0.05, 7);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings =
        GatherSettings { solid_angle_sr: 0.0, raster_edge: 32, ..GatherSettings::default() };
    for (i, normal) in pbgi_testkit::sphere_directions(12).enumerate() {
        let position = normal * (0.2 + 0.15 * i as f32);
        let found = gather(&octree, &settings, Receiver { position, normal });
        // Far surfels are area-true, near ones cover: the truth lies between the two radii.
        let rays = |radius: &dyn Fn(&pbgi_cloud::Surfel) -> f32| {
            ray_cast_gather(&surfels, position, normal, 20_000, radius)
        };
        let near = rays(&|s| s.radius);
        let far = rays(&|s| (s.area * FRAC_1_PI).sqrt());
        let (low, high) = (near.ambient_occlusion, far.ambient_occlusion);
        let slack = 0.012;
        assert!(
            (low - slack..=high + slack).contains(&found.ambient_occlusion),
            "{} not in {low}..{high}",
            found.ambient_occlusion
        );
        let (low, high) = (far.surface_irradiance[0], near.surface_irradiance[0]);
        assert!(
            (low * 0.96 - 0.01..=high * 1.04 + 0.01).contains(&found.surface_irradiance[0]),
            "{} not in {low}..{high}",
            found.surface_irradiance[0]
        );
    }
}

/// A coarse cut of a soup comes near the exhaustive one, and nearer the finer it is.
#[test]
fn error_falls_with_the_threshold() {
    let surfels = random_soup(20_000, 0.02, 3);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let error = |solid_angle_sr: f32| {
        let mut sum = 0.0;
        for normal in pbgi_testkit::sphere_directions(30) {
            let receiver = Receiver { position: normal * 1.4, normal: -normal };
            let at = |s: f32| {
                let settings = GatherSettings { solid_angle_sr: s, ..GatherSettings::default() };
                gather(&octree, &settings, receiver)
            };
            let (found, truth) = (at(solid_angle_sr), at(0.0));
            let relative = found.surface_irradiance[0] / truth.surface_irradiance[0] - 1.0;
            sum += relative * relative;
        }
        (sum / 30.0f32).sqrt()
    };
    let (coarse, fine) = (error(0.1), error(0.003));
    assert!(coarse < 0.06 && fine < 0.02 && fine < coarse, "{coarse} {fine}");
}
